"""The same physics again, slowly, to measure errors against: float64 NumPy, MPM93 without a surrogate, no cut-off.

Nothing here is shared with the kernels but the cube and where rays end. MPM93 is interpolated between 33 Chebyshev nodes over
the range that the cube reaches: to 1e-13 of the mean absorption even at line centres, and a thousand times faster.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.expansion import Surrogate, chebyshev_series, possible
from thzcl.air.mean import Air

Array = NDArray[np.float64]
Span = tuple[float, float]
NEGLIGIBLE = 1e-15  # of the mean absorption: terms of a Chebyshev series that are left out


class Path:
    """Rays through a cube, (ray, segment): lengths in m, and what is met there; segments of length 0 pad.

    `delta` lies within `span`; `offset` is the temperature's departure from the mean in K, None in isothermal air.
    """

    def __init__(self, length: Array, delta: Array, offset: Array | None, span: Span) -> None:
        self.length, self.delta, self.offset, self.span = length, delta, offset, span
        self._moments: list[Array] = []

    def cut(self, path_m: Array) -> Path:
        """The same as far as `path_m` (ray,)."""
        before = np.cumsum(self.length, axis=1) - self.length
        return Path(
            np.clip(path_m[:, None] - before, 0.0, self.length), self.delta, self.offset, self.span
        )

    def moments(self, count: int) -> Array:
        """Integrals of T_k(delta) along the rays, (k, ray), m.

        All that isothermal air's depth at any frequency needs.
        """
        if count > len(self._moments):
            # Most airs need fewer than sixteen; the next to ask finds them here.
            terms = basis(self.delta, self.span, max(count, 16))
            self._moments = [np.einsum("rs,rs->r", term, self.length) for term in terms]
        return np.array(self._moments[:count])


def walk(
    origin: Array, direction: Array, path_m: Array, voxel_m: float, grid: int
) -> tuple[Array, NDArray[np.int64]]:
    """Straight lines through a periodic cube: `origin` and unit `direction` (ray, 3) in its axes, in voxels; `path_m` (ray,).

    Returns lengths in m and voxel numbers in the flattened cube, (ray, segment); segments of length 0 pad.

    All crossings with the planes of each axis, sorted. A segment lies in the voxel that holds its middle.
    """
    end = path_m[:, None] / voxel_m
    crossings = [np.zeros_like(end), end]
    for o, d in zip(origin.T, direction.T, strict=True):
        most = int(np.floor(np.max(np.abs(d) * end[:, 0]))) + 1
        first = np.where(d > 0, np.floor(o) + 1, np.ceil(o) - 1)
        planes = first[:, None] + np.sign(d)[:, None] * np.arange(most)
        with np.errstate(divide="ignore", invalid="ignore"):
            there = (planes - o[:, None]) / d[:, None]
        crossings.append(np.where((there < end) & (d[:, None] != 0), there, end))
    s = np.sort(np.concatenate(crossings, axis=1), axis=1)
    middle = (s[:, 1:] + s[:, :-1]) / 2
    voxel = np.zeros(middle.shape, dtype=np.int64)
    for axis in (2, 1, 0):
        place = np.floor(origin[:, axis, None] + middle * direction[:, axis, None]).astype(np.int64)
        voxel = voxel * grid + place % grid
    return np.diff(s, axis=1) * voxel_m, voxel


@dataclass(frozen=True)
class Absorber:
    """Absorption over a range of humidity and temperature: a Chebyshev series (frequency.

    Humidity, temperature), 1/m.
    """

    series: Array
    humidity_span: Span
    temperature_span: Span


def exact(air: Air, frequency_hz: Array, humidity_span: Span, temperature_span: Span) -> Absorber:
    """MPM93 over the ranges given."""
    span = possible(air, humidity_span)
    series = chebyshev_series(
        lambda d, t: air.absorption(frequency_hz[:, None, None], d, t), span, temperature_span
    )
    kept = np.abs(series) > NEGLIGIBLE * np.abs(series).max()
    most = [
        1 + int(np.flatnonzero(kept.any(axis=axes))[-1]) if kept.any() else 1
        for axes in ((0, 2), (0, 1))
    ]
    return Absorber(series[:, : most[0], : most[1]], span, temperature_span)


def of_surrogate(surrogate: Surrogate) -> Absorber:
    """The polynomial that a run used."""
    spans = (surrogate.humidity_span, surrogate.temperature_span)
    rows = chebyshev_series(surrogate.absorption, *spans)
    return Absorber(
        rows[:, : surrogate.coefficients.shape[1], : surrogate.coefficients.shape[2]], *spans
    )


def basis(values: Array, span: Span, count: int) -> Iterator[Array]:
    """T_0 ... T_count-1 of values over a span, one after the other."""
    u = (2 * values - (span[0] + span[1])) / ((span[1] - span[0]) or 1.0)
    before, now = np.ones_like(u), u.copy()
    u *= 2
    for _ in range(count):
        yield before
        following = u * now
        following -= before
        before, now = now, following


def depth(absorber: Absorber, path: Path) -> Array:
    """Optical depth, (frequency, ray)."""
    if path.offset is None:
        rows = absorber.series[:, :, 0]
        return np.asarray(rows @ path.moments(rows.shape[1]))
    of_d, of_t = _bases(absorber, path)
    return np.array(
        [np.einsum("rs,rs->r", _mixed(rows, of_d, of_t), path.length) for rows in absorber.series]
    )


def emission(
    absorber: Absorber, frequency_hz: Array, air_k: float, path: Path, source: Array
) -> Array:
    """Contrast to the mean air's radiance, (frequency, ray), where temperature fluctuates.

    Front to back, each segment emitting as a black body of its own temperature: exact for constant
    absorption within one. `source` (frequency, ray) is what the surface sends.
    """
    assert path.offset is not None  # noqa: S101 (isothermal air needs no such sum)
    of_d, of_t = _bases(absorber, path)
    contrasts = []
    for frequency, rows, behind in zip(frequency_hz, absorber.series, source, strict=True):
        tau = _mixed(rows, of_d, of_t) * path.length
        through = np.exp(-(np.cumsum(tau, axis=1) - tau))
        emitted = radiometry.planck_difference(frequency, air_k + path.offset, air_k)
        contrasts.append(
            (through * -np.expm1(-tau) * emitted).sum(axis=1) + behind * np.exp(-tau.sum(axis=1))
        )
    return np.array(contrasts)


def _bases(absorber: Absorber, path: Path) -> tuple[Array, Array]:
    """T_k of humidity and of temperature along the rays, (k, ray, segment)."""
    of_d = np.array(list(basis(path.delta, absorber.humidity_span, absorber.series.shape[1])))
    assert path.offset is not None  # noqa: S101
    return of_d, np.array(
        list(basis(path.offset, absorber.temperature_span, absorber.series.shape[2]))
    )


def _mixed(rows: Array, of_d: Array, of_t: Array) -> Array:
    """Absorption along rays, (ray, segment), of one frequency's series (humidity, temperature)."""
    return np.asarray(np.einsum("krs,krs->rs", of_d, np.tensordot(rows, of_t, 1)))
