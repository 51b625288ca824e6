"""Depth and radiance carried along the path.

Where air temperature fluctuates and path moments no longer suffice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.expansion import Surrogate
from thzcl.device.opencl import Buffer, Device
from thzcl.paths.trace import Ends, Medium, Paths, Shaded, changed_ends, march_options, placed
from thzcl.plan.plan import EMISSION_AT_ONCE

Array = NDArray[np.float64]
THIN = 1 / 8  # depth of a voxel up to which a series does for the exponential
PLANCK_NODES = 16  # of Planck's law over the temperatures that occur


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
        """Those frequencies from `first` that one pass carries."""
        part = slice(first, first + EMISSION_AT_ONCE)
        return replace(
            self,
            coefficients=self.coefficients[part],
            planck=self.planck[part],
            sources=self.sources[:, part],
        )


def emitting(
    surrogate: Surrogate,
    span: tuple[float, float],
    sources: Array,
    precision: str,
    *,
    path: bool = True,
) -> Emitting:
    """Tables for an emission trace over a span of temperatures; without `path`.

    What the air itself emits is left out.
    """
    planck = (
        _planck_powers(surrogate, span, precision)
        if path
        else np.zeros((len(surrogate.frequency_hz), 1))
    )
    present = np.abs(surrogate.coefficients).max(axis=0)
    counts = tuple(int(1 + np.flatnonzero(row)[-1]) if row.any() else 1 for row in present)
    return Emitting(
        surrogate.coefficients,
        counts,
        float(surrogate.sizes.sum(axis=(1, 2)).max()),
        planck,
        sources,
    )


def trace_emission(
    device: Device,
    ends: Ends,
    medium: Medium,
    tables: Emitting,
    cutoff: float | None,
    precision: str,
) -> tuple[Paths, Shaded]:
    """Optical depth and contrast where temperature fluctuates, the path's own emission included."""
    path_length, surface = changed_ends(device, ends, cutoff)
    parts, crossed = [], 0
    for first in range(0, len(tables.coefficients), EMISSION_AT_ONCE):
        some = tables.some(first)
        shaded, segments = _emission_pass(
            device, ends, medium, some, cutoff, (path_length, surface), precision
        )
        parts.append(shaded)
        crossed += int(segments.host().sum(dtype=np.int64))
    paths = Paths(path_length, surface, ends.blend, None, crossed)
    if len(parts) == 1:
        return paths, parts[0]
    depth, contrast = (
        device.put(np.concatenate([getattr(p, n).host() for p in parts]))
        for n in ("depth", "contrast")
    )
    return paths, Shaded(depth, contrast)


def _emission_pass(
    device: Device,
    ends: Ends,
    medium: Medium,
    tables: Emitting,
    cutoff: float | None,
    own_ends: tuple[Buffer, Buffer],
    precision: str,
) -> tuple[Shaded, Buffer]:
    (count, powers_d, powers_t), powers_b = tables.coefficients.shape, tables.planck.shape[1]
    numbers = {
        "FREQUENCIES": count,
        "HUMIDITY_POWERS": powers_d,
        "TEMPERATURE_POWERS": powers_t,
        "PLANCK_POWERS": powers_b,
    }
    options = list(
        march_options(cutoff, outgoing=ends.outgoing, moving=medium.time is not None, **numbers)
    )
    options += [f"COUNTS={','.join(map(str, tables.counts))}"]
    options += ["THIN"] if tables.densest * medium.voxel_m * math.sqrt(3) <= THIN else []
    options += ["BILLBOARDS"] if len(ends.blend) > 1 else []
    program = device.build(
        ("surfaces/camera", "paths/march", "surfaces/source", "paths/attenuate", "paths/emission"),
        precision,
        options,
    )
    depth, contrast = (device.empty((count, ends.rays), precision) for _ in range(2))
    segments = device.empty((ends.rays // device.lanes(precision),), np.int32)
    program.run(
        "emission",
        len(segments),
        medium.delta,
        medium.offset,
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
    return Shaded(depth, contrast), segments


def _planck_powers(surrogate: Surrogate, span: tuple[float, float], precision: str) -> Array:
    """B(T_mean + t) - B(T_mean) in powers of t over a span, (frequency, power).

    To a tenth of a rounding.
    """
    low, high = min(span[0], 0.0), max(span[1], 0.0)
    largest = max(-low, high)
    t = (low + high) / 2 + (high - low) / 2 * np.cos(
        (np.arange(PLANCK_NODES) + 0.5) * np.pi / PLANCK_NODES
    )
    mean_k = surrogate.air.temperature_k
    t = (mean_k + t) - mean_k  # what is left of a tiny departure once it is added
    # The slope is fitted, and multiplied by t: the difference is exactly 0 at t = 0.
    slopes = radiometry.planck_difference(surrogate.frequency_hz[:, None], mean_k + t, mean_k) / t
    for degree in range(1, PLANCK_NODES - 2):
        fits = np.polynomial.polynomial.polyfit(t / largest, slopes.T, degree).T
        wrong = np.abs(np.polynomial.polynomial.polyval(t / largest, fits.T) - slopes).max(axis=1)
        if (wrong <= np.finfo(precision).eps / 10 * np.abs(slopes).max(axis=1)).all():
            break
    return np.hstack([np.zeros((len(fits), 1)), fits / largest ** np.arange(fits.shape[1])])
