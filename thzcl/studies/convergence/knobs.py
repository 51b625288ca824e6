"""The knobs that trade error for run time: settings of a scene, or other specs in its graph.

Each function here returns a knob, or raises MeaninglessError for a scene where it changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

from thzcl.air import particles
from thzcl.air.expansion import ExpansionSpec
from thzcl.air.scattering import DIRECTIONS
from thzcl.air.sky import FINEST_M, POINTS
from thzcl.air.weather import THINNEST
from thzcl.clock import Clock
from thzcl.graph import everything, peak
from thzcl.paths.specs import EmissionSpec, TraceSpec
from thzcl.plan import numerics
from thzcl.plan.plan import Plan
from thzcl.plan.variant import PlannedVariant
from thzcl.sensing.weather import WeatherSpec
from thzcl.studies.convergence.specs import (
    Change,
    by_library,
    by_look_up,
    by_steps,
    by_table,
    in_coarse_air,
    in_weather,
    under_sky,
)
from thzcl.studies.convergence.subject import EXACT, Contrasts, Subject, pixels
from thzcl.surfaces.geometry import KINDS
from thzcl.surfaces.mirrors import TOLERANCE
from thzcl.turbulence.fields import AnyField, FieldSpec, LargeScalesSpec
from thzcl.turbulence.spectra import Turbulence

TRACED = ("trace", "path-emission", "outgoing-path", "shading")
FITS = ("plan", "surrogate")
MOST_SAMPLES = 64  # rays to a pixel, each way eight: the reference for sampling
FINEST_GRID = 256
TABLE_STEPS = (10.0, 5.0, 2.0, 1.0, 0.5)  # % of relative humidity; the paper's table has the first


@dataclass(frozen=True)
class Setting:
    """One position of a knob; `run` returns the image, and tells the clock its stages."""

    name: str
    default: bool
    run: Callable[[Clock], Contrasts]


@dataclass(frozen=True)
class Knob:
    """What is varied, the stages whose time it changes, and the image without error."""

    name: str
    stages: tuple[str, ...]
    settings: tuple[Setting, ...]
    reference: Callable[[], Contrasts]


class MeaninglessError(ValueError):
    """A knob makes no difference to a scene; the text says why."""


def _simple(subject: Subject, name: str, default: bool, changes: dict[str, Any]) -> Setting:
    """Returns a position of a knob that settings of the scene describe."""

    def run(clock: Clock) -> Contrasts:
        with clock.stage("plan"):
            plan = subject.plan_with(changes)
        return subject.contrasts(plan, clock)

    return Setting(name, default, run)


def _rewritten(subject: Subject, name: str, default: bool, change: Change) -> Setting:
    """Returns a position of a knob that puts other specs into the scene's graph."""

    def run(clock: Clock) -> Contrasts:
        return subject.contrasts(subject.plan, clock, change)

    return Setting(name, default, run)


def _exact(subject: Subject) -> Contrasts:
    return subject.exact


def arithmetic(subject: Subject) -> Knob:
    """Returns the knob of float32 or float64 on the device."""
    chosen = subject.plan.variants[0].settled.precision
    settings = [
        _simple(subject, p, p == chosen, {"numerics.precision": p}) for p in ("float32", "float64")
    ]
    return Knob("arithmetic", TRACED, tuple(settings), partial(_exact, subject))


def surrogate(subject: Subject) -> Knob:
    """Returns the knob of the absorption polynomial's degree."""
    _fluctuating(subject)
    own = subject.degree
    settings = [
        _simple(subject, f"degree {k}", k == own, {} if k == own else {"numerics.moments": k})
        for k in sorted({*range(1, 9), own})
    ]
    return Knob("surrogate", (*FITS, *TRACED), tuple(settings), partial(_exact, subject))


def table(subject: Subject) -> Knob:
    """Returns the knob of absorption from a table over humidity, in place of a polynomial.

    The table is interpolated linearly for every voxel, as in the paper.
    """
    _fluctuating(subject)
    _plain_air(subject)
    if _fluctuating(subject).large_scales:
        raise MeaninglessError("a table serves voxels, and large_scales has none")
    if any(v.image.spectrum.nodes_hz.shape[0] > 1 for v in subject.plan.variants):
        raise MeaninglessError(
            "the scene has many frequencies: each would need a table and a cube of its own"
        )
    settings = [_rewritten(subject, f"{step:g} %", False, by_table(step)) for step in TABLE_STEPS]
    own = _simple(subject, "polynomial", True, {})
    return Knob("table", ("surrogate", *TRACED), (*settings, own), partial(_exact, subject))


def quadrature(subject: Subject) -> Knob:
    """Returns the knob of the frequencies that a band is summed over."""
    variant = subject.plan.variants[0]
    if variant.scene.sensor.kind != "passive-broadband":
        raise MeaninglessError("the sensor has no band")
    fixed = {
        "numerics.precision": variant.settled.precision,
        "numerics.cutoff_depth": variant.settled.cutoff,
        "numerics.ray_stride": 1,
    }
    settings = []
    for steps in ("edges", "trapezoid", "bins"):
        paper = {"sensor.quadrature": "paper", "sensor.paper_steps": steps}
        settings.append(_simple(subject, f"paper, {steps}", False, paper))
    for power in (2, 3, 4, 6, 7):
        resolved = fixed | {"numerics.tolerance": 10.0**-power / numerics.BAND}
        settings.append(_simple(subject, f"resolved to 1e-{power}", False, resolved))
    settings.append(_simple(subject, "resolved to 1e-5", True, {}))
    reference = {"sensor.quadrature": "resolved", **EXACT}
    exact = cache(lambda: subject.contrasts(subject.plan_with(reference), Clock()))
    return Knob("quadrature", (*FITS, *TRACED), tuple(settings), exact)


def cutoff(subject: Subject) -> Knob:
    """Returns the knob of the optical depth at which a ray ends."""
    followed = [depth for variant in subject.plan.variants for depth in _depths(variant)]
    if not followed:
        raise MeaninglessError("the air is even: no ray is followed, and none is cut off")
    deepest = max(followed)
    depths = [depth for depth in (1.0, 2.0, 4.0, 8.0, 32.0) if depth < deepest]
    if not depths:
        raise MeaninglessError(f"no ray is deeper than {deepest:.2g}")
    settings = [
        _simple(subject, f"depth {d:g}", False, {"numerics.cutoff_depth": d}) for d in depths
    ]
    own = _simple(subject, f"depth {subject.plan.variants[0].settled.cutoff:.3g}", True, {})
    return Knob("cutoff", TRACED, (*settings, own), partial(_exact, subject))


def _depths(variant: PlannedVariant) -> list[float]:
    """Returns the depth of the longest ray through mean air, for each path through a cube.

    It is that of the thinnest frequency among all that the path serves.
    """
    depths = []
    for path in everything([variant.image.pixels]):
        if isinstance(path, TraceSpec | EmissionSpec):
            served = [spec for spec in everything([path]) if isinstance(spec, ExpansionSpec)]
            thinnest = min(fit.air.absorption(fit.frequency_hz.array).min() for fit in served)
            depths.append(variant.longest_m * float(thinnest))
    return depths


def samples(subject: Subject) -> Knob:
    """Returns the knob of rays to a pixel."""
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
    return Knob("samples", (*KINDS, *TRACED), tuple(settings), exact)


def _fits(subject: Subject, samples_per_pixel: int) -> bool:
    plan = subject.plan_with({"camera.samples_per_pixel": samples_per_pixel})
    most, largest = peak(pixels(plan))
    return 2 * most < subject.device.memory_bytes and largest < subject.device.largest_buffer


def voxel(subject: Subject) -> Knob:
    """Returns the knob of the voxels' size, at the same period and with the same large eddies.

    Images are of a finer cube averaged to coarser ones; times are of cubes made that coarse.
    """
    source = _fluctuating(subject)
    finest = min(2 * source.grid, FINEST_GRID)
    if finest <= source.grid:
        raise MeaninglessError(f"the scene's grid is as fine as {finest} voxels already")
    grids = [n for n in (16, 32, 64, 128) if n <= source.grid]
    finer = _finer_cubes(subject, source, finest)

    @cache
    def images() -> dict[int, Contrasts]:
        sizes = [*grids, finest]
        changes = (in_coarse_air(finer, n) for n in sizes)
        return dict(zip(sizes, subject.series(subject.plan, Clock(), changes), strict=True))

    def run(grid: int, clock: Clock) -> Contrasts:
        subject.contrasts(subject.plan_with(_cut_into(source, grid)), clock)
        return images()[grid]

    settings = [
        Setting(f"{n} cubed, {source.period_m / n:.3g} m", n == source.grid, partial(run, n))
        for n in grids
    ]
    stages = ("humidity-field", "temperature-field", *TRACED)
    return Knob("voxel", stages, tuple(settings), lambda: images()[finest])


def _cut_into(source: Turbulence, grid: int) -> dict[str, Any]:
    """Returns the settings of a cube of the same period with other voxels."""
    return {
        "atmosphere.fluctuations.grid": grid,
        "atmosphere.fluctuations.voxel_m": source.period_m / grid,
    }


def _finer_cubes(subject: Subject, source: Turbulence, grid: int) -> dict[AnyField, AnyField]:
    """Returns for each random cube of the scene the same with `grid` voxels an edge."""
    fine = subject.plan_with(_cut_into(source, grid))
    finer: dict[AnyField, AnyField] = {}
    pairs = zip(*map(_random_cubes, (subject.plan, fine)), strict=True)
    finer |= {own: other for own, other in pairs if own is not None and other is not None}
    sizes = {cube.lattice.shape[0] for cube in finer.values()}
    if sizes - {grid} or not all(_same_period(cube, source) for cube in finer.values()):
        raise MeaninglessError("a variant sets grid or voxel_m itself")
    return finer


def _random_cubes(plan: Plan) -> list[FieldSpec | None]:
    """Returns each variant's random cube, without the eddies larger than it, or None."""
    cubes = [variant.cube for variant in plan.variants]
    cubes = [cube.cube if isinstance(cube, LargeScalesSpec) else cube for cube in cubes]
    return [cube if isinstance(cube, FieldSpec) else None for cube in cubes]


def _same_period(cube: AnyField, source: Turbulence) -> bool:
    return math.isclose(cube.lattice.period_m, source.period_m)


def march(subject: Subject) -> Knob:
    """Returns the knob of steps of equal length, in place of the voxels' own segments."""
    source = _fluctuating(subject)
    _plain_air(subject)
    settings = [
        _rewritten(subject, f"steps of {part:g} voxels", False, by_steps(part * source.voxel_m))
        for part in (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
    ]
    own = _simple(subject, "exact segments", True, {})
    return Knob("march", TRACED, (*settings, own), partial(_exact, subject))


def stride(subject: Subject) -> Knob:
    """Returns the knob of rays that are traced, both ways; the others are interpolated."""
    _fluctuating(subject)
    _plain_air(subject)
    paths = (spec for spec in everything(pixels(subject.plan)) if isinstance(spec, TraceSpec))
    own = next(paths).stride
    settings = [
        _simple(
            subject,
            "every ray" if s == 1 else f"one ray in {s}",
            s == own,
            {"numerics.ray_stride": s},
        )
        for s in sorted({1, 2, 4, 8, 16, own})
    ]
    return Knob("stride", TRACED, tuple(settings), partial(_exact, subject))


def fft(subject: Subject) -> Knob:
    """Returns the knob of the library that transforms the field."""
    _fluctuating(subject)
    usual = subject.device.usual_library
    libraries = ("scipy", "reikna") if subject.device.in_place else ("reikna",)
    settings = [_rewritten(subject, name, name == usual, by_library(name)) for name in libraries]
    return Knob("fft", ("humidity-field",), tuple(settings), partial(_exact, subject))


def sky_levels(subject: Subject) -> Knob:
    """Returns the knob of the sky's layers, by their thickness below 1 km."""

    def layered(finest_m: float) -> Change:
        return under_sky(lambda sky: replace(sky, column=replace(sky.column, finest_m=finest_m)))

    settings = [
        _rewritten(subject, f"layers of {metres:g} m", metres == FINEST_M, layered(metres))
        for metres in (500.0, 200.0, 100.0, 50.0, FINEST_M, FINEST_M / 2)
    ]
    return _sky_knob(subject, "sky-levels", settings, layered(FINEST_M / 16))


def sky_directions(subject: Subject) -> Knob:
    """Returns the knob of the directions of which a rough surface sees the mean."""

    def sampled(points: int) -> Change:
        return under_sky(lambda sky: replace(sky, points=points))

    settings = [
        _rewritten(subject, f"{points} of a hemisphere", points == POINTS, sampled(points))
        for points in (4, 8, 16, 32, POINTS, 2 * POINTS)
    ]
    return _sky_knob(subject, "sky-directions", settings, sampled(8 * POINTS))


def sky_look_up(subject: Subject) -> Knob:
    """Returns the knob of the look-ups of the sky by elevation and tilt."""
    settings = [
        _rewritten(subject, f"to {tolerance:.0e}", tolerance == TOLERANCE, by_look_up(tolerance))
        for tolerance in (1e-2, 1e-3, 1e-4, 1e-5, TOLERANCE)
    ]
    return _sky_knob(subject, "sky-look-up", settings, by_look_up(TOLERANCE / 100))


def scattering_layers(subject: Subject) -> Knob:
    """Returns the knob of the layers in which light is scattered, by depth of the thinnest."""

    def layered(thinnest: float) -> Change:
        return in_weather(lambda weather: replace(weather, thinnest=thinnest))

    settings = [
        _rewritten(subject, f"layers of {depth:g} depth", depth == THINNEST, layered(depth))
        for depth in (0.3, 0.1, 0.03, THINNEST, THINNEST / 2)
    ]
    return _weather_knob(subject, "scattering-layers", settings, layered(THINNEST / 10))


def scattering_directions(subject: Subject) -> Knob:
    """Returns the knob of the directions of scattered light, and of the phase function's terms.

    For n directions of a hemisphere there are 2 n Legendre terms. That of the most that the phase
    functions have terms for counts as exact.
    """

    def directed(count: int) -> Change:
        return in_weather(lambda weather: replace(weather, directions=count))

    settings = [
        _rewritten(subject, f"{count} of a hemisphere", count == DIRECTIONS, directed(count))
        for count in (2, 4, 8, 16, DIRECTIONS)
    ]
    return _weather_knob(subject, "scattering-directions", settings, directed(DIRECTIONS))


def size_nodes(subject: Subject) -> Knob:
    """Returns the knob of the sizes of drops and flakes that are summed over.

    Sums are kept on disk, so that only the first run of a weather takes time for them.
    """
    if not any(one.falling for one in subject.plan.variants):
        raise MeaninglessError("nothing falls through the air")

    def contrasts(count: int, clock: Clock) -> Contrasts:
        with clock.stage("plan"), particles.sizes_of(count):
            plan = subject.plan_with({})
        return subject.contrasts(plan, clock)

    settings = [
        Setting(f"{count} sizes", count == particles.SIZES, partial(contrasts, count))
        for count in (12, 25, 50, 100, particles.SIZES, 2 * particles.SIZES)
    ]
    exact = cache(lambda: contrasts(8 * particles.SIZES, Clock()))
    return Knob("size-nodes", (*FITS, "scattering"), tuple(settings), exact)


def _weather_knob(subject: Subject, name: str, settings: list[Setting], finest: Change) -> Knob:
    """Returns a knob of scattered light, exact as with the `finest` setting."""
    specs = everything(pixels(subject.plan))
    if not any(isinstance(spec, WeatherSpec) for spec in specs):
        raise MeaninglessError("no light is scattered into rays")
    exact = cache(lambda: subject.contrasts(subject.plan, Clock(), finest))
    return Knob(name, ("scattering",), tuple(settings), exact)


def bounces(subject: Subject) -> Knob:
    """Returns the knob of mirrored rays that are followed to the next surface, or are not."""
    _mirroring(subject)
    own = int(any(variant.image.sources.bounces for variant in subject.plan.variants))
    settings = [_simple(subject, f"{n} bounces", n == own, {"numerics.bounces": n}) for n in (0, 1)]
    followed = {"numerics.bounces": 1, **EXACT}
    exact = cache(lambda: subject.contrasts(subject.plan_with(followed), Clock()))
    return Knob("bounces", (*KINDS, *TRACED), tuple(settings), exact)


def mirror_look_up(subject: Subject) -> Knob:
    """Returns the knob of the look-ups of what materials reflect by the angle."""
    _mirroring(subject)
    settings = [
        _rewritten(subject, f"to {tolerance:.0e}", tolerance == TOLERANCE, by_look_up(tolerance))
        for tolerance in (1e-2, 1e-3, 1e-4, 1e-5, TOLERANCE)
    ]
    finest = by_look_up(TOLERANCE / 100)
    exact = cache(lambda: subject.contrasts(subject.plan, Clock(), finest))
    return Knob("mirror-look-up", ("sky", "shading"), tuple(settings), exact)


def _mirroring(subject: Subject) -> None:
    """Raises MeaninglessError unless a passive sensor sees something made of a material."""
    sources = [variant.image.sources for variant in subject.plan.variants]
    if not any(one.air_emits and one.reflecting.mirrored for one in sources):
        raise MeaninglessError("nothing that a passive sensor sees is made of a material")


def _sky_knob(subject: Subject, name: str, settings: list[Setting], finest: Change) -> Knob:
    """Returns a knob of the sky, whose image without error is that of the `finest` one."""
    if not any(variant.image.sources.sky_views() for variant in subject.plan.variants):
        raise MeaninglessError("no [sky] is seen")
    exact = cache(lambda: subject.contrasts(subject.plan, Clock(), finest))
    return Knob(name, ("sky",), tuple(settings), exact)


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
    "sky-levels": sky_levels,
    "sky-directions": sky_directions,
    "sky-look-up": sky_look_up,
    "scattering-layers": scattering_layers,
    "scattering-directions": scattering_directions,
    "size-nodes": size_nodes,
    "bounces": bounces,
    "mirror-look-up": mirror_look_up,
}


def _fluctuating(subject: Subject) -> Turbulence:
    """Returns the statistics of the scene's random air."""
    for variant in subject.plan.variants:
        if variant.cube is not None and variant.cube.random is not None:
            return variant.cube.random
    raise MeaninglessError("the scene has no random air")


def _plain_air(subject: Subject) -> None:
    """Raises MeaninglessError but for air of one temperature, crossed once, at one time."""
    specs = everything(pixels(subject.plan))
    if any(isinstance(spec, EmissionSpec) for spec in specs):
        raise MeaninglessError("the air's temperature fluctuates")
    timed = any(isinstance(s, TraceSpec) and s.motion.times_s is not None for s in specs)
    if timed or any(v.needs.transmitter_m is not None for v in subject.plan.variants):
        raise MeaninglessError("the scene's rays go through the air more than once")
