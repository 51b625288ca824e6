"""Optical depth and radiance summed up along paths through air whose temperature fluctuates.

The emission of such air varies along the path, so that path moments do not suffice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.expansion import Expansion
from thzcl.device.opencl import Device
from thzcl.paths.trace import MarchKernels, Medium, changed_ends, march_options, placed
from thzcl.surfaces import source
from thzcl.surfaces.ends import RayEnds
from thzcl.surfaces.radiance import Table
from thzcl.surfaces.source import SourceKernels
from thzcl.turbulence.cube import Field

Array = NDArray[np.float64]
AT_ONCE = 8  # frequencies that one pass carries
THIN = 1 / 8  # depth of a voxel up to which a series replaces the exponential
PLANCK_NODES = 16  # temperatures at which Planck's law is fitted
EVEN_K = 1e-9  # departures up to here, which rounding spoils, take the slope at the mean


@dataclass(frozen=True)
class EmissionKernels(MarchKernels, SourceKernels):
    """The kernel that sums up depth and radiance, with the sizes of its polynomials."""

    files: ClassVar = (
        "surfaces/camera",
        "paths/march",
        "paths/layers",
        "surfaces/source",
        "paths/attenuate",
        "paths/emission",
    )

    frequencies: int
    humidity_powers: int
    temperature_powers: int
    planck_powers: int
    counts: tuple[int, ...]
    thin: bool
    one_temperature: bool
    layers: int | None
    veil: bool = False


@dataclass(frozen=True)
class Carried:
    """Optical depth and contrast that rays bring, both (frequency, ray), on the host.

    Contrast is radiance less that of the mean air, in W m-2 sr-1 Hz-1, or the part of a
    transmitter's power that comes back. `path_length` in m and `surface`, both (ray,), are those of
    the rays' ends; a ray that the cut-off ended is shorter, and its surface is 0.
    """

    depth: NDArray[Any]
    contrast: NDArray[Any]
    path_length: NDArray[Any]
    surface: NDArray[np.int32]


@dataclass(frozen=True)
class Emitting:
    """The tables of an emission trace, which describe the air and the surfaces.

    `coefficients` (frequency, humidity power, temperature power) in 1/m are those of absorption,
    `planck` (frequency, power) those of B(T) - B(T_mean) in powers of T - T_mean, and `sent` is
    what surfaces send. `veil` (frequency,) is the part of absorption, 1/m, that emits nothing here.
    """

    coefficients: Array
    counts: tuple[int, ...]  # temperature powers of each humidity power that are not 0
    densest: float  # bound on absorption in the cube at any frequency, 1/m
    planck: Array
    sent: Table
    veil: Array

    def some(self, first: int) -> Emitting:
        """Returns the tables for the frequencies of one pass, which start at number `first`."""
        part = slice(first, first + AT_ONCE)
        return replace(
            self,
            coefficients=self.coefficients[part],
            planck=self.planck[part],
            sent=self.sent.some(part),
            veil=self.veil[part],
        )


def emitting(
    expansion: Expansion,
    span: tuple[float, float],
    sent: Table,
    veil: Array,
    precision: str,
    *,
    air: bool,
) -> Emitting:
    """Returns the tables of an emission trace; `span` bounds the temperature's departure in K.

    `sent` is what surfaces send, `veil` (frequency,) the part of absorption that is not the air's,
    and `air` says whether what the air emits is seen.
    """
    frequency_hz = expansion.frequency_hz
    planck = np.zeros((len(frequency_hz), 1))
    if air:
        planck = _planck_powers(expansion, span, precision)
    present = np.abs(expansion.coefficients).max(axis=0)
    counts = tuple(int(1 + np.flatnonzero(row)[-1]) if row.any() else 1 for row in present)
    densest = float(expansion.sizes.sum(axis=(1, 2)).max())
    return Emitting(expansion.coefficients, counts, densest, planck, sent, veil)


def trace_emission(
    device: Device,
    ends: RayEnds,
    medium: Medium,
    tables: Emitting,
    cutoff: float | None,
    precision: str,
    crossed: float = 0.0,
) -> Carried:
    """Returns the optical depth and the contrast of rays, the emission along them included.

    A ray ends at the optical depth `cutoff`, or goes to its end if that is None. `crossed` is about
    how many voxels all rays together cross.
    """
    passes = [
        _emission_pass(device, ends, medium, tables.some(first), cutoff, precision, crossed)
        for first in range(0, len(tables.coefficients), AT_ONCE)
    ]
    depths, contrasts, lengths, surfaces = zip(*passes, strict=True)
    # Where opaque frequencies end a ray, others may let it go on to the surface, which is above 0.
    return Carried(
        np.concatenate(depths),
        np.concatenate(contrasts),
        np.maximum.reduce(lengths),
        np.maximum.reduce(surfaces),
    )


def _emission_pass(
    device: Device,
    ends: RayEnds,
    medium: Medium,
    tables: Emitting,
    cutoff: float | None,
    precision: str,
    crossed: float,
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[np.int32]]:
    """Returns what Carried holds, at the frequencies of some tables."""
    program = device.build(_kernels(ends, medium, tables, cutoff), precision)
    shape = len(tables.coefficients), ends.rays
    depth, contrast = (device.empty(shape, precision) for _ in range(2))
    segments = device.empty((ends.rays // program.lanes,), np.int32)
    path_length, surface = changed_ends(device, ends, cutoff)
    program.run(
        "emission",
        len(segments),
        crossed * len(tables.coefficients) / ends.rays,
        delta=medium.field.delta,
        offset=medium.field.delta if medium.field.offset is None else medium.field.offset,
        **_layered(device, ends, medium.field, precision),
        **placed(device, ends, medium, ends.followed),
        path_length=path_length,
        surface=surface,
        coefficients=device.put(tables.coefficients, precision),
        planck=device.put(tables.planck, precision),
        veil=device.put(tables.veil, precision),
        **source.arguments(device, ends.facing, tables.sent, precision),
        cutoff=cutoff or np.inf,
        segments=segments,
        depth_out=depth,
        contrast_out=contrast,
    )
    device.counters.segments += int(segments.host().sum(dtype=np.int64))
    return depth.host(), contrast.host(), path_length.host(), surface.host()


def _layered(device: Device, ends: RayEnds, field: Field, precision: str) -> dict[str, Any]:
    """Returns the kernel arguments that describe the mean air by height."""
    if field.layers is None:
        none = device.empty((1,), precision)
        heights = {"lowest": 0.0, "highest": 0.0, "level": 0.0}
        return {"layers": none, "rise": ends.reach, **heights}
    found = field.layers.look_up()
    directions, start = ends.ways()
    return {
        "layers": device.put(found.departures, precision),
        "lowest": found.lowest_m,
        "highest": found.highest_m,
        "level": float(start[2]) - found.base_m,
        "rise": device.put(directions[:, 2], device.wide),
    }


def _kernels(
    ends: RayEnds, medium: Medium, tables: Emitting, cutoff: float | None
) -> EmissionKernels:
    """Returns the kernel of an emission pass with its options."""
    field = medium.field
    look_up = None if field.layers is None else field.layers.look_up()
    frequencies, humidity_powers, temperature_powers = tables.coefficients.shape
    return EmissionKernels(
        **march_options(cutoff, ends, medium),
        frequencies=frequencies,
        humidity_powers=humidity_powers,
        temperature_powers=temperature_powers,
        planck_powers=tables.planck.shape[1],
        counts=tables.counts,
        veil=bool(tables.veil.any()),
        one_temperature=medium.field.offset is None,
        layers=None if look_up is None else look_up.departures.shape[1],
        thin=tables.densest * medium.field.lattice.diagonal_m <= THIN,
        **source.options(ends.facing, tables.sent),
    )


def _planck_powers(expansion: Expansion, span: tuple[float, float], precision: str) -> Array:
    """Returns the coefficients of B(T_mean + t) - B(T_mean) in powers of t, (frequency, power).

    Over a span of t in kelvin their error is at most a tenth of the rounding of the arithmetic, if
    a degree of at most 13 suffices for that.
    """
    low, high = min(span[0], 0.0), max(span[1], 0.0)
    largest = max(-low, high)
    mean_k = expansion.air.temperature_k
    if largest < EVEN_K:
        slope = radiometry.planck_slope(expansion.frequency_hz, mean_k)
        return np.stack([np.zeros_like(slope), slope], axis=1)
    t = (low + high) / 2 + (high - low) / 2 * np.cos(
        (np.arange(PLANCK_NODES) + 0.5) * np.pi / PLANCK_NODES
    )
    t = (mean_k + t) - mean_k  # the departure as it is after rounding
    # The slope is fitted, and multiplied by t: the difference is exactly 0 at t = 0.
    slopes = radiometry.planck_difference(expansion.frequency_hz[:, None], mean_k + t, mean_k) / t
    for degree in range(1, PLANCK_NODES - 2):
        fits = np.polynomial.polynomial.polyfit(t / largest, slopes.T, degree).T
        wrong = np.abs(np.polynomial.polynomial.polyval(t / largest, fits.T) - slopes).max(axis=1)
        if (wrong <= np.finfo(precision).eps / 10 * np.abs(slopes).max(axis=1)).all():
            break
    return np.hstack([np.zeros((len(fits), 1)), fits / largest ** np.arange(fits.shape[1])])
