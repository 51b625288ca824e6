"""The device's part of the story: field, rays, depth and radiance of the variants that share them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import field as fields
from thzcl import trace
from thzcl.absorption import Surrogate, fit
from thzcl.absorption.surrogate import HIGHEST_DEGREE
from thzcl.clock import Clock
from thzcl.device import Device
from thzcl.field import Field
from thzcl.geometry import ROTATIONS, Geometry, cube_frame
from thzcl.plan import SURROGATE_TOLERANCE, Group, VariantPlan, emitted
from thzcl.sensor import Radiances
from thzcl.trace import Ends, Guard, Medium, Paths, Shaded
from thzcl.turbulence import Turbulence


@dataclass(frozen=True)
class Sight:
    """What one variant's camera sees, the polynomial that it was computed with, and the voxels crossed for it."""

    variant: VariantPlan
    radiances: Radiances
    surrogate: Surrogate
    segments: int


def make_field(device: Device, variant: VariantPlan, clock: Clock) -> Field | None:
    """The cube that a variant's rays cross, generated or read; None in uniform air."""
    if variant.field is None:
        return None
    source, ceiling = variant.field.source, variant.field.ceiling
    with clock.stage("humidity-field"):
        if isinstance(source, Turbulence):
            cube = fields.generate(device, source, variant.precision, ceiling)
        else:
            mean_g_m3, mean_k = variant.field.mean or (1.0, 0.0)
            cube = fields.load(device, source, mean_g_m3, mean_k, variant.precision, ceiling)
        device.finish()
    return cube


def find_ends(device: Device, group: Group, clock: Clock) -> Ends:
    """Where the rays of a group end; timed as what they are tested against."""
    shape = group.first.geometry
    with clock.stage("boxes" if len(shape.boxes) else "ground" if shape.ground else "trace"):
        ends = trace.find_ends(device, shape, group.first.precision)
        device.finish()
    return ends


def sights(device: Device, group: Group, cube: Field | None, ends: Ends, clock: Clock) -> Iterator[Sight]:
    """What the cameras of a group's variants see."""
    with clock.stage("surrogate"):
        surrogates = _surrogates(group, cube)
    if cube is None:
        paths = trace.straight(ends)
    elif group.first.isothermal:
        paths = _trace(device, group, surrogates, cube, ends, clock)
    else:
        yield _emission(device, group.first, surrogates[0], cube, ends, group.cut, clock)
        return
    for number, (variant, surrogate) in enumerate(zip(group.variants, surrogates, strict=True)):
        with clock.stage("shading"):
            sources = emitted(variant.scene, variant.surfaces, variant.frequency_hz)
            shaded = trace.shade(device, paths, surrogate, sources, variant.precision)
            radiances = _radiances(variant, shaded)
        yield Sight(variant, radiances, surrogate, 0 if number else paths.segments)


def _surrogates(group: Group, cube: Field | None) -> list[Surrogate]:
    """A polynomial for each variant's air, over what the cube really reaches.

    All are of the degree planned, or higher, where this cube reaches further than any of a million would.
    """
    if cube is None:
        return [variant.surrogate for variant in group.variants]
    moments = group.moments
    while True:
        fits = [_fit(variant, cube, moments) for variant in group.variants]
        poor = [
            variant
            for variant, fitted in zip(group.variants, fits, strict=True)
            if fitted.error > max(SURROGATE_TOLERANCE[variant.precision], variant.surrogate.error)
            and variant.scene.numerics.moments is None
        ]
        if not poor or moments >= HIGHEST_DEGREE:
            return fits
        moments += 1


def _fit(variant: VariantPlan, cube: Field, moments: int) -> Surrogate:
    tolerance = SURROGATE_TOLERANCE[variant.precision]
    return fit(
        variant.surrogate.air,
        variant.frequency_hz,
        cube.humidity_span,
        cube.temperature_span,
        tolerance=tolerance,
        moments=moments,
    )


def _trace(device: Device, group: Group, surrogates: list[Surrogate], cube: Field, ends: Ends, clock: Clock) -> Paths:
    """Path moments for every variant of an isothermal group."""
    guard = None
    if group.cut:
        thinnest = surrogates[group.variants.index(group.thinnest)]
        row = thinnest.coefficients[:, :, 0][np.argmin(thinnest.coefficients[:, 0, 0])]
        guard = Guard(tuple(row), group.cutoff)
    moments = max(surrogate.moments for surrogate in surrogates)
    with clock.stage("trace"):
        return trace.trace(device, ends, _medium(group.first, cube), moments, guard, group.first.precision)


def _emission(
    device: Device, variant: VariantPlan, surrogate: Surrogate, cube: Field, ends: Ends, cut: bool, clock: Clock
) -> Sight:
    with clock.stage("path-emission"):
        sources = emitted(variant.scene, variant.surfaces, variant.frequency_hz)
        cutoff = variant.cutoff if cut else None
        medium = _medium(variant, cube)
        shaded, segments = trace.trace_emission(device, ends, medium, surrogate, sources, cutoff, variant.precision)
        return Sight(variant, _radiances(variant, shaded), surrogate, segments)


def _medium(variant: VariantPlan, cube: Field) -> Medium:
    frame = cube_frame(variant.geometry.frame, ROTATIONS[variant.orientation], cube.voxel_m, cube.grid)
    return Medium(cube.delta, cube.offset, cube.temperature_span, frame, cube.grid)


def _radiances(variant: VariantPlan, shaded: Shaded) -> Radiances:
    """Averages over the samples of each pixel; the sample in its middle says what the pixel shows."""
    shape = variant.geometry
    flags = np.array([surface.target for surface in variant.surfaces], dtype=np.int32)
    rows, columns = shape.raster.block
    return Radiances(
        frequency_hz=variant.frequency_hz,
        contrast=_pixels(shape, shaded.contrast),
        optical_depth=_pixels(shape, shaded.optical_depth),
        path_length=_pixels(shape, shaded.path_length),
        target=flags[shaded.surface[rows // 2 :: rows, columns // 2 :: columns]],
        air_temperature_k=variant.scene.atmosphere.temperature_k,
    )


def _pixels(shape: Geometry, values: NDArray[Any]) -> NDArray[Any]:
    """The mean over each pixel's block of samples."""
    rows, columns = shape.raster.block
    if rows == columns == 1:
        return values
    height, width = shape.raster.pixels
    return np.asarray(values.reshape(*values.shape[:-2], height, rows, width, columns).mean(axis=(-3, -1)))
