"""The whole story: from a scenario to its images."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import thzcl
from thzcl import overview, plugins, scenario
from thzcl.clock import Clock, Progress
from thzcl.field_file import CubeError
from thzcl.geometry import FIRST_TARGET, ROTATIONS
from thzcl.plan import Plan, VariantPlan, by_key, make_plan
from thzcl.result import Cube, Result, VariantResult
from thzcl.scenario import Document, Scenario, ScenarioError, Trouble
from thzcl.sensor import Image, Radiances

if TYPE_CHECKING:
    from thzcl.compute import Sight
    from thzcl.device import Device
    from thzcl.field import Field

PACKAGES = ("numpy", "scipy", "pyopencl", "reikna", "pluggy", "pydantic", "h5netcdf")


class NumbersError(Exception):
    """A sensor failed, or a number is not finite; `result` keeps what was computed before."""

    def __init__(self, text: str, result: Result) -> None:
        super().__init__(text)
        self.result = result


def prepare(source: str | Path, settings: Mapping[str, Any] | None = None, variants: Sequence[str] = ()) -> Plan:
    """Reads and checks a scenario and plans its run. Raises ScenarioError with every problem at once."""
    document = scenario.read(source, settings)
    parsed = scenario.parse(document, plugins.troubles, variants)
    _check_together(document, parsed)
    try:
        return make_plan(parsed, [plugins.make(variant.scene.sensor) for variant in parsed.variants])
    except CubeError as error:
        raise ScenarioError([str(error)]) from None


def run(
    source: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | None = None,
    figure: bool = True,
    progress: Progress | None = None,
) -> Result:
    """Computes the images of a scenario: a TOML file, a result to run again, or the name of a shipped scene.

    `settings` changes keys ({"targets.box.temperature_k": 300.0}), `variants` picks some by name, `device` is a number or
    part of a name; `figure` says whether a picture will be wanted. Nothing is written: see Result.save and Result.figure.
    Raises ScenarioError for bad input, DeviceError without a usable device, NumbersError if a sensor fails.
    """
    clock = Clock(progress)
    with clock.stage("plan"):
        plan = prepare(source, settings, variants)
    with clock.stage("device"):
        from thzcl.device import open_device

        opened = open_device(device)
    _check_memory(plan, opened)
    sights, cubes, notes = _see(plan, opened, clock)
    result = _result(plan, opened, sights, cubes, notes, clock, figure)
    images = []
    for number, variant in enumerate(plan.variants):
        radiances = sights[variant.name].radiances
        with clock.stage("sensor"):
            image = _observe(variant, radiances, np.random.Generator(np.random.Philox(key=[result.seed, number])), result)
        images.append(VariantResult(variant.name, radiances, image))
    return replace(result, variants=tuple(images))


def _see(plan: Plan, device: Device, clock: Clock) -> tuple[dict[str, Sight], dict[str, Field], list[str]]:
    """What every variant's camera sees, by name; the cubes to be saved; and what there is to note about them."""
    from thzcl import compute

    sights: dict[str, Sight] = {}
    cubes: dict[str, Field] = {}
    notes: list[str] = []
    ends: dict[object, Any] = {}
    for sharing in by_key(plan.groups, lambda group: (group.first.field, group.first.precision)).values():
        cube = compute.make_field(device, sharing[0].first, clock)
        notes += cube.notes if cube else ()
        for group in sharing:
            key = group.first.rays_key
            if key not in ends:
                ends[key] = compute.find_ends(device, group, clock)
            for sight in compute.sights(device, group, cube, ends[key], clock):
                sights[sight.variant.name] = sight
                if cube is not None and sight.variant.scene.output.save_field:
                    cubes[sight.variant.name] = cube
    return sights, cubes, list(dict.fromkeys(notes))


def _check_together(document: Document, parsed: Scenario) -> None:
    """What the sensor asks of the scene, and the variants of each other. Raises ScenarioError."""
    troubles = []
    for variant in parsed.variants:
        scene = variant.scene
        if scene.ground is not None and scene.ground.temperature_k is None:
            troubles.append(Trouble(("ground", "temperature_k"), "missing; a passive sensor sees the ground's emission"))
        for name, target in scene.targets.items():
            if target.temperature_k is None:
                text = "missing; a passive sensor sees the target's emission"
                troubles.append(Trouble(("targets", name, "temperature_k"), text))
        if scene.camera.pixels != parsed.variants[0].scene.camera.pixels:
            text = "all variants must have the same pixels, to stand in one file; run them apart with --variant"
            troubles.append(Trouble(("camera", "pixels"), text))
    if troubles:
        raise ScenarioError(document.problems(troubles))


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


def _observe(variant: VariantPlan, radiances: Radiances, rng: np.random.Generator, so_far: Result) -> Image:
    """The sensor's image, checked. Raises NumbersError naming the plugin, the radiances kept."""

    def failed(reason: str) -> NumbersError:
        return NumbersError(f"{plugins.describe(variant.scene.sensor.kind)}, {variant.name}: {reason}", so_far)

    try:
        image = variant.sensor.observe(radiances, rng)
    except Exception as error:  # whatever a stranger's sensor raises
        raise failed(f"{type(error).__name__}: {error}") from error
    if not isinstance(image, Image):
        raise failed(f"returned {type(image).__name__} instead of an Image")
    shape = radiances.target.shape
    layers = {"image": image.values} | {name: layer.values for name, layer in image.layers.items()}
    for name, values in layers.items():
        if np.shape(values) != shape:
            raise failed(f"returned {name} of shape {np.shape(values)}; the image has {shape}")
        if not np.isfinite(np.asarray(values, dtype=np.float64)).all():
            raise failed(f"returned {name} with values that are not finite")
    return image


def _result(
    plan: Plan,
    device: Device,
    sights: Mapping[str, Sight],
    cubes: Mapping[str, Field],
    notes: list[str],
    clock: Clock,
    figure: bool,
) -> Result:
    """Everything but the images."""
    scene = plan.variants[0].scene
    names = ("background", "ground", *max((v.scene.targets for v in plan.variants), key=len))
    errors = [sight.surrogate.measured_error() for sight in sights.values()]
    left_out = [stage for stage in overview.stages(plan, figure) if not stage.needed]
    return Result(
        scenario=plan.scenario.name,
        scenario_toml=plan.scenario.text,
        scenario_folder=str(plan.scenario.folder.resolve()),
        variants=tuple(VariantResult(v.name, sights[v.name].radiances, None) for v in plan.variants),
        targets=names,
        pixel_angles_mrad=_angles(scene.camera),
        conditions=tuple(_conditions(v, sights[v.name].radiances) for v in plan.variants),
        grid_rotation=ROTATIONS[plan.variants[0].orientation],
        device=f"{device.info.name} ({device.info.driver})",
        seed=plan.scenario.seed,
        build_options=tuple(device.build_options),
        seconds=clock.seconds,
        left_out=tuple({"stage": stage.name, "reason": stage.reason} for stage in left_out),
        warnings=tuple(overview.warnings(plan) + notes),
        error_budget={"surrogate": {"rms": max(errors), "max": max(errors), "unit": "of the mean absorption"}},
        voxel_segments=sum(sight.segments for sight in sights.values()),
        versions=_versions(),
        cubes=_cubes(plan, cubes),
    )


def _angles(camera: scenario.Camera) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Angles of the pixel columns and rows from the image centre, mrad, right and up positive."""
    (width, height), (columns, rows) = camera.focal_plane_mm, camera.pixels
    right = (np.arange(columns) + 0.5 - columns / 2) * width / columns
    up = (rows / 2 - np.arange(rows) - 0.5) * height / rows
    return 1e3 * np.arctan2(right, camera.focal_length_mm), 1e3 * np.arctan2(up, camera.focal_length_mm)


def _conditions(variant: VariantPlan, radiances: Radiances) -> str:
    """Frequency, range and air in words, for a picture's title."""
    air = variant.scene.atmosphere.air
    ghz = variant.frequency_hz / 1e9
    band = f"{ghz[0]:g} GHz" if len(ghz) == 1 else f"{len(ghz)} frequencies {ghz[0]:g}-{ghz[-1]:g} GHz"
    on_target = radiances.target >= FIRST_TARGET
    seen = on_target if on_target.any() else np.ones_like(on_target)
    metres = float(np.median(radiances.path_length[seen]))
    state = f"{air.temperature_k:g} K, {air.relative_humidity_percent:.3g} % RH, {air.absolute_humidity_g_m3:.3g} g/m³"
    return f"{band}, {metres:.3g} m, {state}, {air.pressure_hpa:g} hPa"


def _cubes(plan: Plan, cubes: Mapping[str, Field]) -> tuple[Cube, ...]:
    """The saved cubes: in the units of each variant's air, once if all are the same."""
    saved = []
    for variant in plan.variants:
        cube = cubes.get(variant.name)
        if cube is None:
            return ()
        air = variant.scene.atmosphere.air
        humidity = air.absolute_humidity_g_m3 * (1 + cube.delta.host().astype(np.float64))
        warmth = None if cube.offset is None else air.temperature_k + cube.offset.host().astype(np.float64)
        saved.append(Cube(humidity.astype(variant.precision), warmth, cube.voxel_m))
    same = len({(v.field, v.scene.atmosphere.air) for v in plan.variants}) == 1
    return tuple(saved[:1] if same else saved)


def _versions() -> dict[str, str]:
    return {"thzcl": thzcl.__version__, "python": platform.python_version()} | {name: version(name) for name in PACKAGES}
