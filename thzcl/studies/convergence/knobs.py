"""The knobs that trade error for run time: what each may be set to, how that is run.

And where it has no meaning.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from thzcl.air.expansion import Surrogate
from thzcl.clock import Clock
from thzcl.device.opencl import Device
from thzcl.paths import trace
from thzcl.plan import compute
from thzcl.plan.plan import Group, VariantPlan
from thzcl.plan import numerics as accuracy
from thzcl.plan import report as overview
from thzcl.sensing.develop import develop
from thzcl.sensor import Echoes
from thzcl.studies.convergence.subject import EXACT, Contrasts, Subject
from thzcl.turbulence.cube import Field
from thzcl.turbulence.spectra import Turbulence

TRACED = ("trace", "path-emission", "outgoing-path", "shading")
SURFACES = ("ground", "boxes", "billboards")
FITS = ("plan", "surrogate")
MOST_SAMPLES = 64  # rays to a pixel, each way eight: the reference for sampling
FINEST_GRID = 256
TABLE_STEPS = (10.0, 5.0, 2.0, 1.0, 0.5)  # % of relative humidity; the paper's table has the first


@dataclass(frozen=True)
class Setting:
    """One position of a knob; `run` computes the image, with its stages timed by the clock."""

    name: str
    default: bool
    run: Callable[[Clock], Contrasts]


@dataclass(frozen=True)
class Knob:
    """What is varied, the stages whose time it changes, and what its images are held against."""

    name: str
    stages: tuple[str, ...]
    settings: tuple[Setting, ...]
    reference: Callable[[], Contrasts]


class MeaninglessError(ValueError):
    """A knob that makes no difference to a scene; the text says why."""


def _simple(subject: Subject, name: str, default: bool, changes: dict[str, Any]) -> Setting:
    """A position that settings of the scenario describe."""

    def run(clock: Clock) -> Contrasts:
        with clock.stage("plan"):
            plan = subject.plan_with(changes)
        return subject.contrasts(plan, clock)

    return Setting(name, default, run)


def _exact(subject: Subject) -> Contrasts:
    return subject.exact


def arithmetic(subject: Subject) -> Knob:
    """float32 or float64 on the device."""
    chosen = subject.plan.variants[0].precision
    settings = [
        _simple(subject, p, p == chosen, {"numerics.precision": p}) for p in ("float32", "float64")
    ]
    return Knob("arithmetic", TRACED, tuple(settings), partial(_exact, subject))


def surrogate(subject: Subject) -> Knob:
    """The degree of the absorption polynomial."""
    _fluctuating(subject)
    degrees = sorted({*range(1, 9), subject.plan.moments})
    settings = [
        _simple(subject, f"degree {k}", k == subject.plan.moments, {"numerics.moments": k})
        for k in degrees
    ]
    return Knob("surrogate", (*FITS, *TRACED), tuple(settings), partial(_exact, subject))


def table(subject: Subject) -> Knob:
    """Absorption from a look-up table over humidity, linearly interpolated for every voxel.

    As the paper has it.
    """
    _fluctuating(subject)
    _plain_air(subject)
    if len(subject.plan.variants[0].frequency_hz) > 1:
        raise MeaninglessError(
            "the scene has many frequencies: each would need a table and a cube of its own"
        )
    settings = [
        Setting(f"{step:g} %", False, partial(_by_table, subject, step)) for step in TABLE_STEPS
    ]
    own = _simple(subject, "polynomial", True, {})
    return Knob("table", ("surrogate", *TRACED), (*settings, own), partial(_exact, subject))


def quadrature(subject: Subject) -> Knob:
    """Frequencies that a band is summed over."""
    variant = subject.plan.variants[0]
    if variant.scene.sensor.kind != "passive-broadband":
        raise MeaninglessError("the sensor has no band")
    fixed = {
        "numerics.precision": variant.precision,
        "numerics.cutoff_depth": variant.accuracy.cutoff,
        "numerics.ray_stride": 1,
    }
    settings = [
        _simple(
            subject,
            f"paper, {steps}",
            False,
            {"sensor.quadrature": "paper", "sensor.paper_steps": steps},
        )
        for steps in ("edges", "trapezoid", "bins")
    ]
    for power in (2, 3, 4, 6, 7):
        bearable = 10.0**-power / accuracy.BAND
        settings.append(
            _simple(
                subject, f"resolved to 1e-{power}", False, fixed | {"numerics.tolerance": bearable}
            )
        )
    settings.append(_simple(subject, "resolved to 1e-5", True, {}))
    reference = {"sensor.quadrature": "resolved", **EXACT}
    exact = cache(lambda: subject.contrasts(subject.plan_with(reference), Clock()))
    return Knob("quadrature", (*FITS, *TRACED), tuple(settings), exact)


def cutoff(subject: Subject) -> Knob:
    """The optical depth at which a ray ends."""
    deepest = max(float(g.sample.length.max()) * g.thinnest.thinnest for g in subject.plan.groups)
    depths = [depth for depth in (1.0, 2.0, 4.0, 8.0, 32.0) if depth < deepest]
    if not depths:
        raise MeaninglessError(f"no ray is deeper than {deepest:.2g}")
    settings = [
        _simple(subject, f"depth {d:g}", False, {"numerics.cutoff_depth": d}) for d in depths
    ]
    own = _simple(subject, f"depth {subject.plan.variants[0].accuracy.cutoff:.3g}", True, {})
    return Knob("cutoff", TRACED, (*settings, own), partial(_exact, subject))


def samples(subject: Subject) -> Knob:
    """Rays to a pixel."""
    own = subject.plan.variants[0].scene.camera.samples_per_pixel
    most = next((n for n in (MOST_SAMPLES, 16) if _fits(subject, n)), 0)
    if own * 4 > most:
        raise MeaninglessError("the device's memory holds no more samples than the scene has")
    numbers = sorted({n for n in (1, 4, 16) if 4 * n <= most} | {own})
    settings = [
        _simple(subject, f"{n} a pixel", n == own, {"camera.samples_per_pixel": n}) for n in numbers
    ]
    finest = {"camera.samples_per_pixel": most}
    exact = cache(lambda: subject.contrasts(subject.plan_with(finest), Clock()))
    return Knob("samples", (*SURFACES, *TRACED), tuple(settings), exact)


def _fits(subject: Subject, samples_per_pixel: int) -> bool:
    total, largest = overview.memory(
        subject.plan_with({"camera.samples_per_pixel": samples_per_pixel})
    )
    return 2 * total < subject.device.memory_bytes and largest < subject.device.largest_buffer


def voxel(subject: Subject) -> Knob:
    """The size of voxels, the cube's period and the large eddies kept.

    Finer cubes averaged to coarser ones.
    """
    source = _fluctuating(subject)
    finest = min(2 * source.grid, FINEST_GRID)
    if finest <= source.grid:
        raise MeaninglessError(f"the scene's grid is as fine as {finest} voxels already")
    grids = [n for n in (16, 32, 64, 128) if n <= source.grid]
    changes = {
        n: {
            "atmosphere.fluctuations.grid": n,
            "atmosphere.fluctuations.voxel_m": source.period_m / n,
        }
        for n in grids
    }
    fine = subject.plan_with(
        {
            "atmosphere.fluctuations.grid": finest,
            "atmosphere.fluctuations.voxel_m": source.period_m / finest,
        }
    )
    cube = cache(lambda: compute.make_field(subject.device, fine.variants[0], Clock()))

    def run(grid: int, clock: Clock) -> Contrasts:
        subject.contrasts(subject.plan_with(changes[grid]), clock)
        return _coarse(subject, cube(), grid)

    settings = [
        Setting(f"{n} cubed, {source.period_m / n:.3g} m", n == source.grid, partial(run, n))
        for n in grids
    ]
    return Knob(
        "voxel",
        ("humidity-field", "temperature-field", *TRACED),
        tuple(settings),
        cache(lambda: _coarse(subject, cube(), finest)),
    )


def _coarse(subject: Subject, cube: Field | None, grid: int) -> Contrasts:
    """The scene in a cube averaged down to fewer voxels."""

    def make(device: Device, variant: VariantPlan, _: Clock) -> Field | None:
        if cube is None:
            return None
        n, voxel_m = cube.grid // grid, cube.voxel_m * cube.grid / grid

        def mean(buffer: Any) -> Any:
            values = (
                buffer.host()
                .astype(np.float64)
                .reshape(grid, n, grid, n, grid, n)
                .mean(axis=(1, 3, 5))
            )
            return device.put(values, variant.precision)

        offset = None if cube.offset is None else mean(cube.offset)
        return replace(cube, grid=grid, voxel_m=voxel_m, delta=mean(cube.delta), offset=offset)

    return subject.contrasts(subject.plan, Clock(), make)


def march(subject: Subject) -> Knob:
    """Steps of equal length, in place of the voxels' own segments."""
    source = _fluctuating(subject)
    _plain_air(subject)

    def run(step_m: float, clock: Clock) -> Contrasts:
        def tracer(
            device: Device, group: Group, ends: Any, medium: Any, moments: int, guard: Any
        ) -> trace.Paths:
            del guard  # equal steps go to the end
            return trace.trace_steps(device, ends, medium, moments, step_m, group.first.precision)

        return subject.contrasts(subject.plan, clock, tracer=tracer)

    parts = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
    settings = [
        Setting(f"steps of {p:g} voxels", False, partial(run, p * source.voxel_m)) for p in parts
    ]
    return Knob(
        "march",
        TRACED,
        (*settings, _simple(subject, "exact segments", True, {})),
        partial(_exact, subject),
    )


def stride(subject: Subject) -> Knob:
    """Rays that are traced, both ways; the others are interpolated."""
    _fluctuating(subject)
    _plain_air(subject)
    own = subject.plan.groups[0].stride
    steps = sorted({1, 2, 4, 8, 16, own})
    settings = [
        _simple(
            subject,
            "every ray" if s == 1 else f"every {s}th ray",
            s == own,
            {"numerics.ray_stride": s},
        )
        for s in steps
    ]
    return Knob("stride", TRACED, tuple(settings), partial(_exact, subject))


def fft(subject: Subject) -> Knob:
    """The library that transforms the field."""
    source = _fluctuating(subject)
    usual = subject.device.usual_library

    def run(library: str, clock: Clock) -> Contrasts:
        return subject.contrasts(subject.plan, clock, partial(compute.make_field, library=library))

    libraries = ("scipy", "reikna") if subject.device.in_place else ("reikna",)
    settings = [Setting(name, name == usual, partial(run, name)) for name in libraries]
    return Knob("fft", ("humidity-field",), tuple(settings), partial(_exact, subject))


KNOBS: dict[str, Callable[[Subject], Knob]] = {
    "arithmetic": arithmetic,
    "surrogate": surrogate,
    "table": table,
    "quadrature": quadrature,
    "cutoff": cutoff,
    "samples": samples,
    "voxel": voxel,
    "march": march,
    "stride": stride,
    "fft": fft,
}


def _fluctuating(subject: Subject) -> Turbulence:
    field = subject.plan.variants[0].field
    if field is None or not isinstance(field.source, Turbulence):
        raise MeaninglessError("the scene has no random air")
    return field.source


def _plain_air(subject: Subject) -> None:
    """Of one temperature, crossed once, at one time."""
    for variant in subject.plan.variants:
        if not variant.isothermal:
            raise MeaninglessError("the air's temperature fluctuates")
        if variant.times_s is not None or variant.needs.transmitter_m is not None:
            raise MeaninglessError("the scene's rays go through the air more than once")


def _by_table(subject: Subject, step_percent: float, clock: Clock) -> Contrasts:
    """Every variant through a cube of its own absorption, looked up."""
    found: Contrasts = {}
    cubes: dict[object, Field | None] = {}
    for group in subject.plan.groups:
        for variant in group.variants:
            if variant.field not in cubes:
                cubes[variant.field] = compute.make_field(subject.device, variant, clock)
            cube = cubes[variant.field]
            lines = compute.find_lines(subject.device, variant, clock)
            if cube is None:
                continue
            with clock.stage("surrogate"):
                mean, looked_up = _looked_up(variant, cube, step_percent)
                medium = compute.medium_of(subject.device, variant, cube, lines.camera, None)
                medium = replace(medium, delta=subject.device.put(looked_up, variant.precision))
            fitted = replace(variant.surrogate, coefficients=np.full((1, 2, 1), mean))
            captured = _captured(subject, variant, fitted, medium, lines, clock)
            sight = develop([captured], clock)
            seen = sight.returned if isinstance(sight, Echoes) else sight.contrast
            found[variant.name] = np.asarray(seen, dtype=np.float64)
    return found


def _captured(
    subject: Subject,
    variant: VariantPlan,
    fitted: Surrogate,
    medium: Any,
    lines: compute.Lines,
    clock: Clock,
) -> compute.Capture:
    def tracer(
        device: Device, group: Group, ends: Any, medium: Any, moments: int, guard: Any
    ) -> trace.Paths:
        return trace.trace(device, ends, medium, moments, guard, group.first.precision)

    return next(
        compute.isothermal(
            subject.device, Group((variant,)), [fitted], [medium], lines, clock, tracer
        )
    )


def _looked_up(variant: VariantPlan, cube: Field, step_percent: float) -> tuple[float, Any]:
    """The mean air's absorption in 1/m, and every voxel's relative to it less 1.

    From a table in steps of relative humidity.
    """
    air = variant.surrogate.air
    values = cube.delta.host()
    rows = math.ceil((1 + cube.humidity_span[1]) * air.relative_humidity_percent / step_percent) + 1
    delta = np.minimum(
        np.arange(rows) * step_percent / air.relative_humidity_percent - 1, air.most_vapour
    )
    mean = float(air.absorption(variant.frequency_hz)[0])
    absorption = air.absorption(variant.frequency_hz, delta)
    return mean, np.interp(values, delta, absorption) / mean - 1
