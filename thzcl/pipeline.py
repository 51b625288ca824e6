"""The whole story: from a scenario to its images."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import thzcl
from thzcl import scenario
from thzcl.clock import Clock, Progress
from thzcl.plan import checks
from thzcl.plan.plan import Plan, PlanError, VariantPlan, make_plan
from thzcl.plan import report as overview
from thzcl.plugins import loader as plugins
from thzcl.results.result import Cube, Result, VariantResult
from thzcl.scenario import ScenarioError
from thzcl.sensor import Echoes, Radiances
from thzcl.surfaces.geometry import FIRST_TARGET, ROTATIONS

if TYPE_CHECKING:
    from thzcl.air.expansion import Surrogate
    from thzcl.device.linker import Helper
    from thzcl.device.opencl import Device
    from thzcl.error.budget import Part
    from thzcl.plan.exposure import Exposed, Known
    from thzcl.turbulence.cube import Field

Sight = Radiances | Echoes
Array = NDArray[np.float64]
MANY = 20  # realisations
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
    checks.together(document, plan)
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
    helper: Helper | None = None,
) -> Result:
    """Computes the images of a scenario: a TOML file, a result to run again, or the name of a shipped scene.

    `settings` changes keys ({"targets.box.temperature_k": 300.0}), `variants` picks some by name, `device` is a number or
    part of a name; `figure` says whether a picture will be wanted; `allow_outside` lets pictures and tables lie outside the
    scenario's folder; `helper` is a process begun beforehand that builds kernels. Nothing is written: see Result.save and
    Result.figure. Raises ScenarioError for bad input, DeviceError without a usable device, SensorFailure and NumbersError if a
    sensor fails.
    """
    clock = Clock(progress)
    with clock.stage("plan"):
        plan = prepare(source, settings, variants, allow_outside=allow_outside)
    with clock.stage("device"):
        from thzcl.device.opencl import open_device
        from thzcl.plan.compute import recipes

        opened = open_device(device, recipes(plan), helper)
    return compute_images(plan, opened, clock, figure=figure)


def compute_images(plan: Plan, device: Device, clock: Clock, *, figure: bool = False) -> Result:
    """The images of a plan, on a device that is open already; `clock` is told what each stage takes.

    Raises ScenarioError if the device's memory is too small, and NumbersError if a sensor fails.
    """
    checks.memory(plan, device)
    lines: Known = {}
    seen = _see(plan, device, clock, lines)
    result = _result(plan, device, seen, clock, figure)
    if plan.realizations == 1:
        return replace(result, variants=tuple(_images(plan, seen, result, 0)))
    return _ensemble(plan, device, seen, lines, result, clock)


def _images(
    plan: Plan, seen: Mapping[str, Seen], result: Result, realization: int
) -> Iterator[VariantResult]:
    """Every variant as its sensor records it."""
    for number, variant in enumerate(plan.variants):
        sight = seen[variant.name].sight
        checks.finite(variant, sight, result)
        key = [result.seed, realization * len(plan.variants) + number]
        start = time.perf_counter()
        image = checks.observe(
            variant, sight, np.random.Generator(np.random.Philox(key=key)), result
        )
        result.seconds["sensor"] = result.seconds.get("sensor", 0.0) + time.perf_counter() - start
        yield VariantResult(variant.name, sight, image)


def _ensemble(
    plan: Plan, device: Device, seen: dict[str, Seen], lines: Known, result: Result, clock: Clock
) -> Result:
    """The mean over independent realisations of the air, with variance and spread.

    `seen` is the first.
    """
    from thzcl.studies.ensemble import Ensemble, realization

    kept, crossed = {variant.name: Ensemble() for variant in plan.variants}, 0
    for number in range(plan.realizations):
        clock.counted(number + 1, plan.realizations)
        if number:
            seen = _see(realization(plan, number), device, clock, lines, budget=False)
        for taken in _images(plan, seen, result, number):
            if taken.image is not None:
                kept[taken.name].add(taken.sight, taken.image)
        crossed += sum(one.segments for one in seen.values())
    means = tuple(VariantResult(name, *ensemble.mean()) for name, ensemble in kept.items())
    return replace(result, variants=means, voxel_segments=crossed)


def _see(
    plan: Plan, device: Device, clock: Clock, lines: Known, *, budget: bool = True
) -> dict[str, Seen]:
    """What every variant's camera sees, by name."""
    from thzcl.plan.exposure import expose
    from thzcl.plan import compute

    # With all cores SciPy transforms twice as fast; for a few cubes that does not make up for its
    # import.
    library = "scipy" if device.in_place and plan.realizations >= MANY else None
    make = partial(compute.make_field, library=library)
    seen: dict[str, Seen] = {}
    for exposed in expose(plan, device, clock, lines, make):
        cube = exposed.cube
        errors = _measured(device, plan, exposed, clock) if budget else {}
        for of_one, sight in zip(exposed.captures, exposed.sights, strict=True):
            variant = of_one[0].variant
            kept = cube if variant.scene.output.save_field else None
            segments = sum(capture.segments for capture in of_one)
            notes = cube.notes if cube else ()
            seen[variant.name] = Seen(sight, of_one[0].surrogate, kept, notes, segments, errors)
    return seen


def _measured(device: Device, plan: Plan, exposed: Exposed, clock: Clock) -> Mapping[str, Part]:
    """The error budget of the variants that share a trace, where it is wanted."""
    first = [of_one[0] for of_one in exposed.captures]
    if not first[0].variant.scene.numerics.error_budget:
        return {}
    from thzcl.error import budget

    with clock.stage("error-budget"):
        return budget.measure(
            device, exposed.cube, exposed.lines, first, exposed.sights, plan.scenario.seed
        )


def _result(
    plan: Plan, device: Device, seen: Mapping[str, Seen], clock: Clock, figure: bool
) -> Result:
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
    """What is known of the errors made, by part: of the fit and by the sensors' word.

    And as measured where that is wanted.
    """
    found = {
        "absorption-fit": max(
            (one.surrogate.measured, "of the mean absorption") for one in seen.values()
        )
    }
    for variant in plan.variants:
        for part, error in variant.needs.errors.items():
            found[part] = max(error, found.get(part, error))
    known = {part: {"rms": size, "max": size, "unit": unit} for part, (size, unit) in found.items()}
    unit = "of the power sent" if plan.variants[0].needs.reflection else "K"
    parts: dict[str, Part] = {}
    for one in seen.values():
        for name, measured in one.errors.items():
            parts[name] = type(measured)(*map(max, measured, parts.get(name, measured)))
    return known | {
        name: {"rms": p.rms, "max": p.max, "unit": unit, "relative": p.relative}
        for name, p in parts.items()
    }


def _missed(plan: Plan, seen: Mapping[str, Seen]) -> list[str]:
    """Of variants whose measured error is more than the tolerance."""
    found = []
    for variant in plan.variants:
        bearable, total = variant.scene.numerics.tolerance, seen[variant.name].errors.get("total")
        if bearable is not None and total is not None and total.relative > bearable:
            text = 'remove what [numerics] fixes, or set ray_stride = 1 and precision = "float64"'
            found.append(
                f"{variant.name}: error of {total.relative:.1e} of the contrast, tolerance {bearable:g}; {text}"
            )
    return found


def _angles(camera: scenario.Camera) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Angles of the pixel columns and rows from the image centre, mrad, right and up positive."""
    (width, height), (columns, rows) = camera.focal_plane_mm, camera.pixels
    right = (np.arange(columns) + 0.5 - columns / 2) * width / columns
    up = (rows / 2 - np.arange(rows) - 0.5) * height / rows
    return 1e3 * np.arctan2(right, camera.focal_length_mm), 1e3 * np.arctan2(
        up, camera.focal_length_mm
    )


def _conditions(variant: VariantPlan, sight: Sight) -> tuple[str, ...]:
    """Frequency, range and air in words, for a picture's titles."""
    air = variant.scene.atmosphere.air
    on_target = sight.target >= FIRST_TARGET
    lengths = sight.path_length[on_target if on_target.any() else ...].ravel()
    return (
        _band(variant.frequency_hz / 1e9),
        f"{np.partition(lengths, len(lengths) // 2)[len(lengths) // 2]:.3g} m",
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
        warmth = (
            None
            if cube.offset is None
            else air.temperature_k + cube.offset.host().astype(np.float64)
        )
        saved.append(Cube(humidity.astype(variant.precision), warmth, cube.voxel_m))
    same = len({(v.field, v.scene.atmosphere.air) for v in plan.variants}) == 1
    return tuple(saved[:1] if same else saved)


def versions() -> dict[str, str]:
    """Of thzcl, Python and the packages that numbers depend on."""
    own = {"thzcl": thzcl.__version__, "python": platform.python_version()}
    # A package that is loaded tells its version at once; the metadata of one that is not take
    # milliseconds to find.
    return own | {
        name: getattr(sys.modules.get(name), "__version__", None) or version(name)
        for name in PACKAGES
    }
