"""The whole story: from a scenario to its images."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import thzcl
from thzcl import overview, plugins, scenario
from thzcl.clock import Clock, Progress
from thzcl.geometry import FIRST_TARGET, ROTATIONS, camera_frame, directions
from thzcl.plan import Plan, PlanError, VariantPlan, by_key, make_plan
from thzcl.result import Cube, Result, VariantResult
from thzcl.scenario import Document, ScenarioError, Trouble
from thzcl.sensor import Echoes, Image, Layer, Radiances

if TYPE_CHECKING:
    from thzcl.absorption import Surrogate
    from thzcl.budget import Part
    from thzcl.compute import Capture, Lines
    from thzcl.device import Device
    from thzcl.field import Field

Sight = Radiances | Echoes
Array = NDArray[np.float64]
PACKAGES = ("numpy", "scipy", "pyopencl", "reikna", "pluggy", "pydantic", "h5netcdf")


@dataclass(frozen=True)
class Seen:
    """What one variant's camera sees, and what is to be known of how it was computed."""

    sight: Sight
    surrogate: Surrogate
    cube: Field | None  # where it is to be saved
    notes: tuple[str, ...]
    segments: int
    errors: Mapping[str, Part]


class NumbersError(Exception):
    """A sensor failed, or a number is not finite; `result` keeps what was computed before."""

    def __init__(self, text: str, result: Result) -> None:
        super().__init__(text)
        self.result = result


def prepare(
    source: str | Path,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    *,
    allow_outside: bool = False,
) -> Plan:
    """Reads and checks a scenario and plans its run.

    Raises ScenarioError with every problem at once, or SensorFailure.
    """
    document = scenario.read(source, settings)
    parsed = scenario.parse(document, plugins.troubles, variants, allow_outside=allow_outside)
    sensors = [plugins.make(variant.scene.sensor.model_dump()) for variant in parsed.variants]
    try:
        plan = make_plan(parsed, sensors)
    except PlanError as error:
        raise ScenarioError([str(error)]) from None
    _check_together(document, plan)
    return plan


def run(
    source: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | None = None,
    figure: bool = True,
    allow_outside: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Computes the images of a scenario: a TOML file, a result to run again, or the name of a shipped scene.

    `settings` changes keys ({"targets.box.temperature_k": 300.0}), `variants` picks some by name, `device` is a number or
    part of a name; `figure` says whether a picture will be wanted; `allow_outside` lets pictures and tables lie outside the
    scenario's folder. Nothing is written: see Result.save and Result.figure. Raises ScenarioError for bad input, DeviceError
    without a usable device, SensorFailure and NumbersError if a sensor fails.
    """
    clock = Clock(progress)
    with clock.stage("plan"):
        plan = prepare(source, settings, variants, allow_outside=allow_outside)
    with clock.stage("device"):
        from thzcl.device import open_device

        opened = open_device(device)
    return compute_images(plan, opened, clock, figure=figure)


def compute_images(plan: Plan, device: Device, clock: Clock, *, figure: bool = False) -> Result:
    """The images of a plan, on a device that is open already; `clock` is told what each stage takes.

    Raises ScenarioError if the device's memory is too small, and NumbersError if a sensor fails.
    """
    _check_memory(plan, device)
    seen = _see(plan, device, clock)
    result = _result(plan, device, seen, clock, figure)
    images = []
    for number, variant in enumerate(plan.variants):
        sight = seen[variant.name].sight
        _check_finite(variant, sight, result)
        with clock.stage("sensor"):
            image = _observe(variant, sight, np.random.Generator(np.random.Philox(key=[result.seed, number])), result)
        images.append(VariantResult(variant.name, sight, image))
    return replace(result, variants=tuple(images))


def _see(plan: Plan, device: Device, clock: Clock) -> dict[str, Seen]:
    """What every variant's camera sees, by name."""
    from thzcl import compute
    from thzcl.develop import develop

    seen: dict[str, Seen] = {}
    lines: dict[object, Any] = {}
    for sharing in by_key(plan.groups, lambda group: (group.first.field, group.first.precision)).values():
        cube = compute.make_field(device, sharing[0].first, clock)
        for group in sharing:
            key = group.first.rays_key
            if key not in lines:
                lines[key] = compute.find_lines(device, group.first, clock)
            taken = list(zip(*compute.captures(device, group, cube, lines[key], clock), strict=True))
            sights = [develop(of_one, clock) for of_one in taken]
            first = [of_one[0] for of_one in taken]
            errors = _measured(device, plan, cube, lines[key], first, sights, clock)
            for of_one, sight in zip(taken, sights, strict=True):
                variant = of_one[0].variant
                kept = cube if variant.scene.output.save_field else None
                segments = sum(capture.segments for capture in of_one)
                notes = cube.notes if cube else ()
                seen[variant.name] = Seen(sight, of_one[0].surrogate, kept, notes, segments, errors)
    return seen


def _measured(
    device: Device,
    plan: Plan,
    cube: Field | None,
    lines: Lines,
    captures: list[Capture],
    sights: list[Sight],
    clock: Clock,
) -> Mapping[str, Part]:
    """The error budget of the variants that share a trace, where it is wanted."""
    if not captures[0].variant.scene.numerics.error_budget:
        return {}
    from thzcl import budget

    with clock.stage("error-budget"):
        return budget.measure(device, cube, lines, captures, sights, plan.scenario.seed)


def _check_together(document: Document, plan: Plan) -> None:
    """What the sensors ask of the scenes, and the variants of each other. Raises ScenarioError."""
    troubles = []
    first = plan.variants[0]
    for variant in plan.variants:
        scene = variant.scene
        troubles += _transmitter_troubles(variant) if variant.needs.reflection else _temperature_troubles(scene)
        if scene.camera.pixels != first.scene.camera.pixels:
            text = "all variants must have the same pixels, to stand in one file; run them apart with --variant"
            troubles.append(Trouble(("camera", "pixels"), text))
        bands = [len(v.frequency_hz) if v.weights is None else len(v.weights) for v in (first, variant)]
        if bands[0] != bands[1] or variant.needs.reflection != first.needs.reflection:
            text = "all variants must be of one kind, with as many frequencies, to stand in one file; use --variant"
            troubles.append(Trouble(("sensor",), text))
    if troubles:
        raise ScenarioError(document.problems(troubles))


def _temperature_troubles(scene: scenario.Scene) -> list[Trouble]:
    """A passive sensor sees the emission of everything: all must have temperatures."""
    found = []
    if scene.ground is not None and scene.ground.temperature_k is None:
        found.append(Trouble(("ground", "temperature_k"), "missing; a passive sensor sees the ground's emission"))
    for name, target in scene.targets.items():
        if target.temperature_k is None and getattr(target, "quantity", "") != "temperature":
            text = "missing; a passive sensor sees the target's emission"
            found.append(Trouble(("targets", name, "temperature_k"), text))
    return found


def _transmitter_troubles(variant: VariantPlan) -> list[Trouble]:
    """A transmitter stands in the open."""
    place, found = variant.needs.transmitter_m, []
    if place is None:
        return []
    if variant.scene.ground is not None and place[2] <= 0:
        found.append(Trouble(("sensor",), f"the transmitter is at z = {place[2]:g} m, not above the ground; raise it"))
    for name, target in variant.scene.targets.items():
        if isinstance(target, scenario.Box) and target.holds(place):
            found.append(Trouble(("sensor",), f'the transmitter stands inside the target "{name}"; move it'))
    return found


def _check_memory(plan: Plan, device: Device) -> None:
    """Refuses what the device cannot hold, before anything is allocated. Raises ScenarioError."""
    total, largest = overview.memory(plan)
    advice = "lower grid, pixels, samples_per_pixel or the number of frequencies, or run variants apart with --variant"
    if total > device.memory_bytes:
        have = f"{device.info.name} has {device.memory_bytes / 2**30:.1f} GiB"
        raise ScenarioError([f"{plan.scenario.name}: needs {total / 2**30:.1f} GiB, but {have}; {advice}"])
    if largest > device.largest_buffer:
        have = f"{device.info.name} allows {device.largest_buffer / 2**30:.1f} GiB"
        raise ScenarioError([f"{plan.scenario.name}: needs one array of {largest / 2**30:.1f} GiB, but {have}; {advice}"])


def _check_finite(variant: VariantPlan, sight: Sight, so_far: Result) -> None:
    """No image with holes goes to a sensor. Raises NumbersError naming the first pixel that is not a number, and its ray."""
    planes = [sight.optical_depth, sight.returned if isinstance(sight, Echoes) else sight.contrast]
    if all(np.isfinite(plane.sum(dtype=np.float64)) or np.isfinite(plane).all() for plane in planes):
        return
    bad = ~np.all([np.isfinite(plane).all(axis=0) for plane in planes], axis=0)
    row, column = (int(n) for n in np.argwhere(bad)[0])
    rows, columns = bad.shape
    middle = replace(variant.geometry, raster=replace(variant.geometry.raster, rows=rows, columns=columns, margin=0))
    frame = camera_frame(variant.scene.camera, middle.raster)
    x, y, z = directions(replace(middle, frame=frame), np.array([row]), np.array([column]))[0]
    a, b, c = variant.scene.camera.position_m
    raise NumbersError(
        f"{variant.name}: {int(bad.sum())} pixels are not finite numbers; the first is row {row}, column {column}, whose ray "
        f"runs from ({a:g}, {b:g}, {c:g}) m along ({x:.6g}, {y:.6g}, {z:.6g}); please report the scene",
        so_far,
    )


def _observe(variant: VariantPlan, sight: Sight, rng: np.random.Generator, so_far: Result) -> Image:
    """The sensor's image, checked. Raises NumbersError naming the plugin, the radiances kept."""

    def failed(reason: str) -> NumbersError:
        return NumbersError(f"{plugins.describe(variant.scene.sensor.kind)}, {variant.name}: {reason}", so_far)

    try:
        image = variant.sensor.observe(sight, rng)
    except (Exception, SystemExit) as error:  # whatever a stranger's sensor raises
        raise failed(f"{type(error).__name__}: {error}") from error
    if not isinstance(image, Image) or not all(isinstance(layer, Layer) for layer in image.layers.values()):
        raise failed(f"returned {type(image).__name__} instead of an Image, and of Layers")
    shape = sight.target.shape
    planes = {"image": image.values} | {name: layer.values for name, layer in image.layers.items()}
    for name, values in planes.items():
        if np.shape(values) != shape:
            raise failed(f"returned {name} of shape {np.shape(values)}; the image has {shape}")
        if np.asarray(values).dtype.kind not in "fiub":
            raise failed(f"returned {name} whose values are not numbers")
        if not np.isfinite(values).all():
            raise failed(f"returned {name} with values that are not finite")
    return image


def _result(plan: Plan, device: Device, seen: Mapping[str, Seen], clock: Clock, figure: bool) -> Result:
    """Everything but the images."""
    first = plan.variants[0]
    names = ("background", "ground", *max((v.scene.targets for v in plan.variants), key=len))
    notes = dict.fromkeys(note for one in seen.values() for note in one.notes)
    left_out = [stage for stage in overview.stages(plan, figure) if not stage.needed]
    return Result(
        scenario=plan.scenario.name,
        scenario_toml=plan.scenario.text,
        scenario_folder=str(plan.scenario.folder.resolve()),
        variants=tuple(VariantResult(v.name, seen[v.name].sight, None) for v in plan.variants),
        targets=names,
        pixel_angles_mrad=_angles(first.scene.camera),
        conditions=tuple(_conditions(v, seen[v.name].sight) for v in plan.variants),
        figure_columns=first.scene.output.figure_columns,
        difference=first.scene.output.difference,
        grid_rotation=ROTATIONS[first.orientation],
        device=f"{device.info.name} ({device.info.driver})",
        seed=plan.scenario.seed,
        build_options=tuple(device.build_options),
        seconds=clock.seconds,
        left_out=tuple({"stage": stage.name, "reason": stage.reason} for stage in left_out),
        warnings=tuple(overview.warnings(plan) + list(notes) + _missed(plan, seen)),
        error_budget=_errors(plan, seen),
        voxel_segments=sum(one.segments for one in seen.values()),
        versions=versions(),
        cubes=_cubes(plan, seen),
    )


def _errors(plan: Plan, seen: Mapping[str, Seen]) -> dict[str, dict[str, Any]]:
    """What is known of the errors made, by part: of the fit and by the sensors' word, and as measured where that is wanted."""
    found = {"absorption-fit": max((one.surrogate.measured, "of the mean absorption") for one in seen.values())}
    for variant in plan.variants:
        for part, error in variant.needs.errors.items():
            found[part] = max(error, found.get(part, error))
    known = {part: {"rms": size, "max": size, "unit": unit} for part, (size, unit) in found.items()}
    unit = "of the power sent" if plan.variants[0].needs.reflection else "K"
    parts: dict[str, Part] = {}
    for one in seen.values():
        for name, measured in one.errors.items():
            parts[name] = type(measured)(*map(max, measured, parts.get(name, measured)))
    return known | {name: {"rms": p.rms, "max": p.max, "unit": unit, "relative": p.relative} for name, p in parts.items()}


def _missed(plan: Plan, seen: Mapping[str, Seen]) -> list[str]:
    """Of variants whose measured error is more than the tolerance."""
    found = []
    for variant in plan.variants:
        bearable, total = variant.scene.numerics.tolerance, seen[variant.name].errors.get("total")
        if bearable is not None and total is not None and total.relative > bearable:
            text = 'remove what [numerics] fixes, or set ray_stride = 1 and precision = "float64"'
            found.append(f"{variant.name}: error of {total.relative:.1e} of the contrast, tolerance {bearable:g}; {text}")
    return found


def _angles(camera: scenario.Camera) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Angles of the pixel columns and rows from the image centre, mrad, right and up positive."""
    (width, height), (columns, rows) = camera.focal_plane_mm, camera.pixels
    right = (np.arange(columns) + 0.5 - columns / 2) * width / columns
    up = (rows / 2 - np.arange(rows) - 0.5) * height / rows
    return 1e3 * np.arctan2(right, camera.focal_length_mm), 1e3 * np.arctan2(up, camera.focal_length_mm)


def _conditions(variant: VariantPlan, sight: Sight) -> tuple[str, ...]:
    """Frequency, range and air in words, for a picture's titles."""
    air = variant.scene.atmosphere.air
    on_target = sight.target >= FIRST_TARGET
    seen = on_target if on_target.any() else np.ones_like(on_target)
    return (
        _band(variant.frequency_hz / 1e9),
        f"{float(np.median(sight.path_length[seen])):.3g} m",
        f"{air.temperature_k:.5g} K",
        f"{air.relative_humidity_percent:.3g} % RH",
        f"{air.absolute_humidity_g_m3:.3g} g/m³",
        f"{air.pressure_hpa:g} hPa",
    )


def _band(ghz: Array) -> str:
    """A frequency, or the band that several lie in, to a twentieth of its width."""
    if len(ghz) == 1:
        return f"{ghz[0]:g} GHz"
    step = 10.0 ** np.ceil(np.log10((ghz[-1] - ghz[0]) / 20))
    return f"{np.floor(ghz[0] / step) * step:g}-{np.ceil(ghz[-1] / step) * step:g} GHz"


def _cubes(plan: Plan, seen: Mapping[str, Seen]) -> tuple[Cube, ...]:
    """The saved cubes: in the units of each variant's air, once if all are the same."""
    saved = []
    for variant in plan.variants:
        cube = seen[variant.name].cube
        if cube is None:
            return ()
        air = variant.scene.atmosphere.air
        humidity = air.absolute_humidity_g_m3 * (1 + cube.delta.host().astype(np.float64))
        warmth = None if cube.offset is None else air.temperature_k + cube.offset.host().astype(np.float64)
        saved.append(Cube(humidity.astype(variant.precision), warmth, cube.voxel_m))
    same = len({(v.field, v.scene.atmosphere.air) for v in plan.variants}) == 1
    return tuple(saved[:1] if same else saved)


def versions() -> dict[str, str]:
    """Of thzcl, Python and the packages that numbers depend on."""
    return {"thzcl": thzcl.__version__, "python": platform.python_version()} | {name: version(name) for name in PACKAGES}
