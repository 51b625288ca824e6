"""Depth and radiance carried along the path, where air temperature fluctuates.

Path moments no longer suffice there, since what the air emits varies along the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.expansion import Expansion
from thzcl.device.opencl import Buffer, Device
from thzcl.paths.trace import Medium, changed_ends, march_options, placed
from thzcl.surfaces.ends import RayEnds
from thzcl.surfaces.radiance import Sources

Array = NDArray[np.float64]
AT_ONCE = 8  # frequencies that one pass carries
THIN = 1 / 8  # depth of a voxel up to which a series does for the exponential
PLANCK_NODES = 16  # of Planck's law over the temperatures that occur
KERNELS = (
    "surfaces/camera",
    "paths/march",
    "surfaces/source",
    "paths/attenuate",
    "paths/emission",
)


@dataclass(frozen=True)
class Carried:
    """Optical depth and contrast at the end of rays, both (frequency, ray), on the host.

    Contrast is radiance above the mean air's, W m-2 sr-1 Hz-1, or the part that comes back.
    `path_length` and `surface` (ray,) are those of the ends, but for rays that were cut off.
    """

    depth: NDArray[Any]
    contrast: NDArray[Any]
    path_length: NDArray[Any]
    surface: NDArray[np.int32]


@dataclass(frozen=True)
class Emitting:
    """What an emission trace needs to know of the air and the surfaces.

    `coefficients` (frequency, humidity power, temperature power) per metre, `planck` (frequency,
    power) of B(T) - B(T_mean) in powers of T - T_mean, `sources` (surface, frequency).
    """

    coefficients: Array
    counts: tuple[int, ...]  # temperature powers that there are with each humidity power
    densest: float  # the most that the air absorbs anywhere, at any frequency, 1/m
    planck: Array
    sources: Array

    def some(self, first: int) -> Emitting:
        """Returns the tables of those frequencies from `first` that one pass carries."""
        part = slice(first, first + AT_ONCE)
        return replace(
            self,
            coefficients=self.coefficients[part],
            planck=self.planck[part],
            sources=self.sources[:, part],
        )


def emitting(
    expansion: Expansion, span: tuple[float, float], sources: Sources, precision: str
) -> Emitting:
    """Returns tables for an emission trace over a span of temperatures."""
    frequency_hz = expansion.frequency_hz
    planck = np.zeros((len(frequency_hz), 1))
    if sources.air_emits:
        planck = _planck_powers(expansion, span, precision)
    present = np.abs(expansion.coefficients).max(axis=0)
    counts = tuple(int(1 + np.flatnonzero(row)[-1]) if row.any() else 1 for row in present)
    densest = float(expansion.sizes.sum(axis=(1, 2)).max())
    table = sources.table(frequency_hz)
    return Emitting(expansion.coefficients, counts, densest, planck, table)


def trace_emission(
    device: Device,
    ends: RayEnds,
    medium: Medium,
    tables: Emitting,
    cutoff: float | None,
    precision: str,
) -> Carried:
    """Returns optical depth and contrast, the path's own emission included."""
    changed = changed_ends(device, ends, cutoff)
    parts = [
        _emission_pass(device, ends, medium, tables.some(first), cutoff, changed, precision)
        for first in range(0, len(tables.coefficients), AT_ONCE)
    ]
    depth, contrast = (
        part[0].host() if len(part) == 1 else np.concatenate([one.host() for one in part])
        for part in zip(*parts, strict=True)
    )
    path_length, surface = (buffer.host() for buffer in changed)
    return Carried(depth, contrast, path_length, surface)


def _emission_pass(
    device: Device,
    ends: RayEnds,
    medium: Medium,
    tables: Emitting,
    cutoff: float | None,
    own_ends: tuple[Buffer, Buffer],
    precision: str,
) -> tuple[Buffer, Buffer]:
    """Returns depth and contrast at a few frequencies, both (frequency, ray)."""
    (count, powers_d, powers_t), powers_b = tables.coefficients.shape, tables.planck.shape[1]
    options = march_options(
        cutoff,
        ends,
        medium,
        FREQUENCIES=count,
        HUMIDITY_POWERS=powers_d,
        TEMPERATURE_POWERS=powers_t,
        PLANCK_POWERS=powers_b,
    )
    options += [f"COUNTS={','.join(map(str, tables.counts))}"]
    options += ["THIN"] if tables.densest * medium.field.voxel_m * math.sqrt(3) <= THIN else []
    options += ["BILLBOARDS"] if len(ends.blend) > 1 else []
    program = device.build(KERNELS, precision, options)
    depth, contrast = (device.empty((count, ends.rays), precision) for _ in range(2))
    segments = device.empty((ends.rays // device.lanes(precision),), np.int32)
    program.run(
        "emission",
        len(segments),
        medium.field.delta,
        medium.field.offset,
        *placed(device, ends, medium, ends.followed),
        *own_ends,
        device.put(tables.coefficients, precision),
        device.put(tables.planck, precision),
        device.put(tables.sources, precision),
        ends.blend,
        np.dtype(precision).type(cutoff or np.inf),
        segments,
        depth,
        contrast,
    )
    device.counters.segments += int(segments.host().sum(dtype=np.int64))
    return depth, contrast


def _planck_powers(expansion: Expansion, span: tuple[float, float], precision: str) -> Array:
    """Returns B(T_mean + t) - B(T_mean) in powers of t, (frequency, power).

    It holds over a span of t in kelvin, to a tenth of a rounding.
    """
    low, high = min(span[0], 0.0), max(span[1], 0.0)
    largest = max(-low, high)
    t = (low + high) / 2 + (high - low) / 2 * np.cos(
        (np.arange(PLANCK_NODES) + 0.5) * np.pi / PLANCK_NODES
    )
    mean_k = expansion.air.temperature_k
    t = (mean_k + t) - mean_k  # what is left of a tiny departure once it is added
    # The slope is fitted, and multiplied by t: the difference is exactly 0 at t = 0.
    slopes = radiometry.planck_difference(expansion.frequency_hz[:, None], mean_k + t, mean_k) / t
    for degree in range(1, PLANCK_NODES - 2):
        fits = np.polynomial.polynomial.polyfit(t / largest, slopes.T, degree).T
        wrong = np.abs(np.polynomial.polynomial.polyval(t / largest, fits.T) - slopes).max(axis=1)
        if (wrong <= np.finfo(precision).eps / 10 * np.abs(slopes).max(axis=1)).all():
            break
    return np.hstack([np.zeros((len(fits), 1)), fits / largest ** np.arange(fits.shape[1])])
