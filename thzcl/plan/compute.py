"""The device's part of the story: field, rays.

Depth and radiance of the variants that share them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import HIGHEST_DEGREE, Surrogate, fit, trimmed
from thzcl.clock import Clock
from thzcl.device.opencl import Buffer, Device, Recipe
from thzcl.paths import trace
from thzcl.paths.trace import Ends, Guard, Medium, Paths, Shaded
from thzcl.plan.numerics import sources
from thzcl.plan.plan import Group, Plan, VariantPlan
from thzcl.surfaces.geometry import Raster, cube_frame, world_frame
from thzcl.turbulence.cube import Field
from thzcl.turbulence.spectra import Turbulence
from thzcl.turbulence import cube as fields

Array = NDArray[np.float64]
Tracer = Callable[[Device, Group, Ends, Medium, int, Guard | None], Paths]


@dataclass(frozen=True)
class Lines:
    """The rays of a group: from the camera, and from a transmitter of its own to what they meet."""

    camera: Ends
    outgoing: Ends | None


@dataclass(frozen=True)
class Capture:
    """What the rays of one variant bring at one time: (band, row, column) or (row.

    Column) of the raster, on the host.
    """

    variant: VariantPlan
    surrogate: Surrogate
    optical_depth: NDArray[Any]
    contrast: NDArray[Any]  # radiance above the air's, or the part returned
    path_length: NDArray[Any]
    outgoing_length: NDArray[Any]
    cosine: NDArray[Any] | None
    surface: NDArray[Any]
    between: NDArray[np.bool_] | None  # the rays that were interpolated, if any
    segments: int


def recipes(plan: Plan) -> list[Recipe]:
    """The programs that a plan is sure to need on a CPU, those that take longest to build first."""
    found: dict[Recipe, None] = {}
    for group in plan.groups:
        first, precision = group.first, group.first.precision
        made = first.field is not None and isinstance(first.field.source, Turbulence)
        moments = group.moments if first.field is not None else 0
        if made:
            found[fields.recipe(full=not first.isothermal)] = None
        if first.isothermal:
            if moments:
                moving = first.times_s is not None
                found[
                    trace.trace_recipe(moments, precision, group.cut, outgoing=False, moving=moving)
                ] = None
            for variant in group.variants:
                bands, textured = (
                    0 if variant.weights is None else len(variant.weights),
                    len(variant.geometry.billboards) > 0,
                )
                found[trace.shading_recipe(moments, precision, textured=textured, bands=bands)] = (
                    None
                )
        found[trace.surfaces_recipe(first.geometry, precision, cosine=first.needs.slant)] = None
    return list(found)


def make_field(
    device: Device, variant: VariantPlan, clock: Clock, library: str | None = None
) -> Field | None:
    """The cube that a variant's rays cross, made or read; None in uniform air.

    `library` as in Device.inverse_transform.
    """
    if variant.field is None:
        return None
    source, ceiling = variant.field.source, variant.field.ceiling
    with clock.stage("humidity-field"):
        if isinstance(source, Turbulence):
            cube = fields.generate(device, source, variant.precision, ceiling, library)
        else:
            mean_g_m3, mean_k = variant.field.mean or (1.0, 0.0)
            cube = fields.load(device, source, mean_g_m3, mean_k, variant.precision, ceiling)
        device.finish()
    return cube


def find_lines(device: Device, variant: VariantPlan, clock: Clock) -> Lines:
    """Where a variant's rays end; timed as what they are tested against."""
    shape, transmitter = variant.geometry, variant.needs.transmitter_m
    last = (
        "billboards"
        if len(shape.billboards)
        else "boxes"
        if len(shape.boxes)
        else "ground"
        if shape.ground
        else "trace"
    )
    with clock.stage(last):
        ends = trace.find_ends(device, shape, variant.precision, cosine=variant.needs.slant)
        device.finish()
    if transmitter is None:
        return Lines(ends, None)
    with clock.stage("outgoing-path"):
        outgoing = trace.outgoing_ends(device, ends, transmitter, variant.precision)
        device.finish()
    return Lines(ends, outgoing)


def captures(
    device: Device,
    group: Group,
    cube: Field | None,
    lines: Lines,
    clock: Clock,
    tracer: Tracer | None = None,
) -> Iterator[list[Capture]]:
    """What the cameras of a group's variants capture, at one time after the other.

    `tracer` stands in for the group's own.
    """
    with clock.stage("surrogate"):
        surrogates = _surrogates(group, cube)
    times = group.first.times_s
    for sample in [None] if times is None else times:
        media = [
            None if cube is None else medium_of(device, group.first, cube, way, sample)
            for way in _ways(lines)
        ]
        if group.first.isothermal:
            yield list(isothermal(device, group, surrogates, media, lines, clock, tracer or _trace))
        else:
            yield [
                _emission(
                    device, group, surrogates[0], [m for m in media if m is not None], lines, clock
                )
            ]


def _ways(lines: Lines) -> list[Ends]:
    return [lines.camera] if lines.outgoing is None else [lines.camera, lines.outgoing]


def isothermal(
    device: Device,
    group: Group,
    surrogates: list[Surrogate],
    media: list[Medium | None],
    lines: Lines,
    clock: Clock,
    tracer: Tracer,
) -> Iterator[Capture]:
    """One trace for every variant, and a shading each."""
    guard = _guard(group, surrogates)
    moments = max(surrogate.moments for surrogate in surrogates)
    ways = []
    for stage, ends, medium in zip(("trace", "outgoing-path"), _ways(lines), media, strict=False):
        if medium is None or not moments:  # air that might as well be uniform
            ways.append(trace.straight(ends))
            continue
        with clock.stage(stage):
            ways.append(tracer(device, group, ends, medium, moments, guard))
            device.finish()
    paths = ways[0] if len(ways) == 1 else trace.there_and_back(device, *ways)
    for number, (variant, surrogate) in enumerate(zip(group.variants, surrogates, strict=True)):
        with clock.stage("shading"):
            trips = 2 if variant.needs.reflection and len(ways) == 1 else 1
            shaded = _shade(device, variant, paths, surrogate.coefficients[:, :, 0] * trips)
            capture = _capture(
                variant,
                surrogate,
                shaded,
                ways,
                paths.surface,
                0 if number else paths.segments,
                lines,
            )
        yield capture


def _trace(
    device: Device, group: Group, ends: Ends, medium: Medium, moments: int, guard: Guard | None
) -> Paths:
    if group.stride == 1:
        return trace.trace(device, ends, medium, moments, guard, group.first.precision)
    from thzcl.paths import thinning

    things = np.array([surface.target for surface in group.first.surfaces])
    return thinning.trace_thinned(device, ends, medium, moments, guard, group.stride, things)


def _shade(
    device: Device, variant: VariantPlan, paths: Paths, coefficients: Array
) -> tuple[Array, Array]:
    """Optical depth and contrast on the host, (band, ray with padding)."""
    table = sources(variant.scene, variant.needs, variant.surfaces, variant.frequency_hz)
    if variant.weights is None or variant.transmission_weights is None:
        shaded = trace.shade(device, paths, coefficients, table, variant.precision)
    else:
        bands = variant.weights, variant.transmission_weights
        shaded = trace.shade_bands(device, paths, coefficients, table, *bands, variant.precision)
    return shaded.depth.host(), shaded.contrast.host()


def _mean_depth(depth: NDArray[Any], weights: Array) -> Array:
    """Depth of the mean transmission, (band, ray), of depths (frequency, ray).

    Neither thin nor deep air loses its digits.
    """
    found = []
    for row in weights:
        least = depth[row > 0].min(axis=0).astype(np.float64)
        beyond = np.minimum(least - depth, 0.0)
        lost = row @ -np.expm1(beyond)
        # Of the two sums that which is the smaller part of 1 has the digits.
        found.append(
            least
            - np.where(lost < 0.5, np.log1p(-np.minimum(lost, 0.5)), np.log(row @ np.exp(beyond)))
        )
    return np.array(found)


def _emission(
    device: Device,
    group: Group,
    surrogate: Surrogate,
    media: list[Medium],
    lines: Lines,
    clock: Clock,
) -> Capture:
    """Depth and radiance where temperature fluctuates, carried along the path."""
    from thzcl.paths import emission

    variant = group.first
    with clock.stage("surrogate"):
        surrogate = trimmed(surrogate, variant.accuracy.surrogate)
    table = sources(variant.scene, variant.needs, variant.surfaces, variant.frequency_hz)
    path = not variant.needs.reflection
    cutoff = variant.accuracy.cutoff if group.cut else None
    found: list[tuple[Paths, Shaded]] = []
    for stage, ends, medium in zip(
        ("path-emission", "outgoing-path"), _ways(lines), media, strict=False
    ):
        with clock.stage(stage):
            tables = emission.emitting(
                surrogate, medium.temperature_span, table, variant.precision, path=path
            )
            found.append(
                emission.trace_emission(device, ends, medium, tables, cutoff, variant.precision)
            )
            device.finish()
    with clock.stage("shading"):
        depths = [shaded.depth.host() for _, shaded in found]
        contrast, surface = found[0][1].contrast.host(), found[0][0].surface
        if variant.needs.reflection:
            out = depths[-1]
            contrast = contrast * np.exp(-out) * (found[-1][0].surface.host() > 0)
            depths = [depths[0], out]
        depth = sum(depths[1:], start=depths[0])
        if variant.weights is not None and variant.transmission_weights is not None:
            depth = _mean_depth(depth, variant.transmission_weights)
            contrast = variant.weights @ contrast
        segments = sum(paths.segments for paths, _ in found)
        return _capture(
            variant, surrogate, (depth, contrast), [p for p, _ in found], surface, segments, lines
        )


def _capture(
    variant: VariantPlan,
    surrogate: Surrogate,
    shaded: tuple[Array, Array],
    ways: list[Paths],
    surface: Buffer,
    segments: int,
    lines: Lines,
) -> Capture:
    raster = variant.geometry.raster
    depth, contrast = (_raster(raster, values) for values in shaded)
    back, out = (_raster(raster, paths.path_length.host()) for paths in (ways[0], ways[-1]))
    cosine = _raster(raster, lines.camera.cosine.host()) if variant.needs.slant else None
    between = None if ways[0].between is None else _raster(raster, ways[0].between)
    return Capture(
        variant,
        surrogate,
        depth,
        contrast,
        back,
        out,
        cosine,
        _raster(raster, surface.host()),
        between,
        segments,
    )


def _raster(raster: Raster, values: NDArray[Any]) -> NDArray[Any]:
    """Without the padding, in rows and columns."""
    return values[..., : raster.rays].reshape(*values.shape[:-1], raster.rows, raster.columns)


def _surrogates(group: Group, cube: Field | None) -> list[Surrogate]:
    """A polynomial for each variant's air, over what the cube really reaches.

    All are of the degree planned, or higher, where this cube reaches further than any of a million
    would.
    """
    if cube is None:
        return [variant.surrogate for variant in group.variants]
    moments = group.moments
    while True:
        fits = [_fit(variant, cube, moments) for variant in group.variants]
        poor = [
            variant
            for variant, fitted in zip(group.variants, fits, strict=True)
            if fitted.error > max(variant.accuracy.surrogate, variant.surrogate.error)
            and variant.scene.numerics.moments is None
        ]
        if not poor or moments >= HIGHEST_DEGREE:
            return fits
        moments += 1


def _fit(variant: VariantPlan, cube: Field, moments: int) -> Surrogate:
    return fit(
        variant.surrogate.air,
        variant.frequency_hz,
        cube.humidity_span,
        cube.temperature_span,
        tolerance=variant.accuracy.surrogate,
        moments=moments,
    )


def _guard(group: Group, surrogates: list[Surrogate]) -> Guard | None:
    """The depth to watch: that of the frequency and air that absorb least."""
    if not group.cut:
        return None
    thinnest = surrogates[group.variants.index(group.thinnest)].coefficients[:, :, 0]
    return Guard(tuple(thinnest[np.argmin(thinnest[:, 0])]), group.cutoff)


def medium_of(
    device: Device, variant: VariantPlan, cube: Field, ends: Ends, times_s: Array | None
) -> Medium:
    """The cube as the rays of one way cross it."""
    start = np.array(variant.needs.transmitter_m) if ends.outgoing else None
    world = world_frame(variant.geometry.frame, start)
    frame = cube_frame(world, variant.orientation, cube.voxel_m, cube.grid, variant.wind_m_s)
    time = None
    if times_s is not None:
        raster = variant.geometry.raster
        spread = np.pad(
            times_s.repeat(raster.block[0], 0).repeat(raster.block[1], 1),
            raster.margin,
            mode="edge",
        )
        time = device.put(np.pad(spread.ravel(), (0, ends.rays - raster.rays)), device.wide)
    return Medium(
        cube.delta, cube.offset, cube.temperature_span, frame, cube.grid, cube.voxel_m, time
    )
