"""The float64 twin: the physics in NumPy without a run's shortcuts, by which errors are measured.

A twin takes from a run the cube and the ends of rays, and shares nothing else with the kernels. All
crossings of a ray with voxel faces are listed and sorted, there is no cut-off, and every segment
emits for itself. For what the air emits, Planck's law is written otherwise than in
`thzcl.air.radiometry`, so that a mistake in one of the two shows as an error; what surfaces send is
the run's own. The error budget computes some rays of an image with the twin, and `thzcl stress`
compares its cases with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, chebyshev_series, possible
from thzcl.air.mean import Air
from thzcl.air.radiometry import BOLTZMANN, LIGHT_SPEED, PLANCK

Array = NDArray[np.float64]
Span = tuple[float, float]
NEGLIGIBLE = 1e-15  # of the largest term: smaller terms of a Chebyshev series are left out
EVEN = 1e-9  # of the largest coefficient: series whose LAST ones are larger are not used
LAST = 4
TERMS_AT_ONCE = 16  # moments that are computed together, more than most airs need


class Path:
    """Rays through a cube, as arrays (ray, segment): lengths in m, and the air of each segment.

    `delta` is humidity over its mean less 1 and lies within `span`; `offset` is the temperature's
    departure from the mean in K, or None in isothermal air. Segments of length 0 pad the arrays.
    """

    def __init__(self, length: Array, delta: Array, offset: Array | None, span: Span) -> None:
        self.length, self.delta, self.offset, self.span = length, delta, offset, span
        self._moments: list[Array] = []

    def cut(self, path_m: Array) -> Path:
        """Returns the rays cut off after `path_m` (ray,), in metres."""
        before = np.cumsum(self.length, axis=1) - self.length
        length = np.clip(path_m[:, None] - before, 0.0, self.length)
        return Path(length, self.delta, self.offset, self.span)

    def moments(self, count: int) -> Array:
        """Returns the integrals of T_k(delta) along the rays for k < `count`, (k, ray), in m.

        The depth of isothermal air at any frequency is a sum over them.
        """
        if count > len(self._moments):
            terms = chebyshev(self.delta, self.span, max(count, TERMS_AT_ONCE))
            self._moments = [np.einsum("rs,rs->r", term, self.length) for term in terms]
        return np.array(self._moments[:count])


def walk(
    origin: Array, step: Array, path_m: Array, shape: tuple[int, int, int]
) -> tuple[Array, NDArray[np.int64]]:
    """Returns the segments of straight lines through a periodic box of voxels.

    `origin` is in voxels, and `step` in voxels per metre, both (ray, 3) along the box's axes, which
    are `shape` (x, y, z) voxels long; `path_m` (ray,) is in metres. The segments are lengths in m
    and voxel numbers in the flattened box, both (ray, segment); segments of length 0 pad the
    arrays. A segment lies in the voxel that holds its middle.
    """
    end = path_m[:, None]
    crossings = [np.zeros_like(end), end]
    for o, d in zip(origin.T, step.T, strict=True):
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
        place = np.floor(origin[:, axis, None] + middle * step[:, axis, None]).astype(np.int64)
        voxel = voxel * shape[axis] + place % shape[axis]
    return np.diff(s, axis=1), voxel


@dataclass(frozen=True)
class Absorber:
    """Absorption in 1/m as a Chebyshev series (frequency, humidity, temperature) over two spans.

    With 33 nodes each way it agrees with MPM93 to 1e-12 of the largest absorption (1e-11 at 1 hPa),
    even at the centres of lines, and is a thousand times faster than the model itself. At
    frequencies whose numbers `direct` holds, no series agrees, and the model itself is asked, as a
    function of delta and offset.
    """

    series: Array
    humidity_span: Span
    temperature_span: Span
    direct: Mapping[int, Callable[[Array, Array], Array]]

    def along(self, path: Path) -> Iterator[Array]:
        """Yields the absorption along rays, (ray, segment), for one frequency after the other."""
        offset = np.zeros_like(path.delta) if path.offset is None else path.offset
        of_d, of_t = (
            np.array(list(chebyshev(values, span, terms)))
            for values, span, terms in (
                (path.delta, self.humidity_span, self.series.shape[1]),
                (offset, self.temperature_span, self.series.shape[2]),
            )
        )
        for number, rows in enumerate(self.series):
            if number in self.direct:
                yield self.direct[number](path.delta, offset)
            else:
                yield np.asarray(np.einsum("krs,krs->rs", of_d, np.tensordot(rows, of_t, 1)))

    def depth(self, path: Path) -> Array:
        """Returns the optical depth of rays, (frequency, ray)."""
        if path.offset is not None:
            return np.array([_summed(per_m, path) for per_m in self.along(path)])
        rows = self.series[:, :, 0]
        found = rows @ path.moments(rows.shape[1])
        for number, law in self.direct.items():
            found[number] = _summed(law(path.delta, np.zeros(1)), path)
        return np.asarray(found)


def _summed(per_m: Array, path: Path) -> Array:
    """Returns the integral along rays, (ray,), of what their segments have per metre."""
    return np.asarray(np.einsum("rs,rs->r", per_m, path.length))


def exact(air: Air, frequency_hz: Array, humidity_span: Span, temperature_span: Span) -> Absorber:
    """Returns the absorption of the air's own model over the spans that are possible for the air.

    It is computed once for all images in the same air.
    """
    spans = possible(air, humidity_span), temperature_span
    return _exact(air, tuple(np.asarray(frequency_hz, dtype=np.float64).tolist()), spans)


@lru_cache(maxsize=8)
def _exact(air: Air, frequencies: tuple[float, ...], spans: tuple[Span, Span]) -> Absorber:
    """Returns what `exact` describes, from arguments that can be hashed."""
    hz = np.array(frequencies)[:, None, None]
    series = chebyshev_series(lambda d, t: air.absorption(hz, d, t), *spans)
    size = np.abs(series).max(axis=0)
    worth = size > NEGLIGIBLE * size.max()
    humidity, temperature = (
        1 + int(np.flatnonzero(worth.any(axis=axis))[-1]) if worth.any() else 1 for axis in (1, 0)
    )
    laws = {n: partial(air.absorption, np.array(frequencies[n])) for n in _uneven(series)}
    return Absorber(series[:, :humidity, :temperature], *spans, laws)


def _uneven(series: Array) -> list[int]:
    """Returns the numbers of the frequencies at which a series (frequency, k, j) does not end.

    Coefficients of what is smooth fall to rounding; those of steps and kinks do not.
    """
    largest = np.abs(series).max(axis=(1, 2))
    wrong = np.zeros(len(series), dtype=bool)
    for axis in (1, 2):
        ends = np.abs(np.moveaxis(series, axis, 1)[:, 1:][:, -LAST:])
        wrong |= ends.max(axis=(1, 2), initial=0.0) > EVEN * largest
    return np.flatnonzero(wrong).tolist()


def of_surrogate(surrogate: Expansion) -> Absorber:
    """Returns the absorption of the expansion that a run used."""
    spans = (surrogate.humidity_span, surrogate.temperature_span)
    _, humidity, temperature = surrogate.coefficients.shape
    series = chebyshev_series(surrogate.absorption, *spans)
    return Absorber(series[:, :humidity, :temperature], *spans, {})


def chebyshev(values: Array, span: Span, count: int) -> Iterator[Array]:
    """Yields the Chebyshev polynomials T_0 to T_(count-1) of values in a span, in their shape."""
    u = (2 * values - (span[0] + span[1])) / ((span[1] - span[0]) or 1.0)
    before, now = np.ones_like(u), u.copy()
    u *= 2
    for _ in range(count):
        yield before
        following = u * now
        following -= before
        before, now = now, following


def emission(
    absorber: Absorber,
    frequency_hz: Array,
    air_k: float,
    path: Path,
    source: Array,
    veil: Array,
) -> Array:
    """Returns contrast to the mean air's radiance where temperature fluctuates, (frequency, ray).

    `source` (frequency, ray) is the contrast at the ends of the rays, and `veil` (frequency,) the
    part of absorption, 1/m, that emits nothing.
    """
    assert path.offset is not None  # noqa: S101 (isothermal air needs no such sum)
    kelvin = air_k + path.offset
    along = zip(frequency_hz, absorber.along(path), source, veil, strict=True)
    return np.array(
        [
            transfer(
                per_m * path.length,
                _own(per_m, dark) * planck_difference(hz, kelvin, air_k),
                behind,
            )
            for hz, per_m, behind, dark in along
        ]
    )


def _own(per_m: Array, veil: float) -> Array:
    """Returns the part of absorption that emits."""
    own = np.maximum(per_m - veil, 0.0)
    return np.divide(own, per_m, out=np.zeros_like(own), where=per_m > 0)


def transfer(tau: Array, emitted: Array, behind: Array) -> Array:
    """Returns the contrast that rays (...) bring through segments (..., segment), nearest first.

    `tau` is the depth of each segment, `emitted` the contrast of a black body of its temperature,
    and `behind` (...) the contrast at the ends of the rays. It is exact if absorption is constant
    within each segment: O'Brien and Tofsted, equation (2), with the mean air's radiance subtracted
    from every term.
    """
    through = np.exp(tau - np.cumsum(tau, axis=-1))
    of_air = (through * -np.expm1(-tau) * emitted).sum(axis=-1)
    return np.asarray(of_air + behind * np.exp(-tau.sum(axis=-1)))


def planck(frequency_hz: Array, temperature_k: float) -> Array:
    """Returns the spectral radiance of a black body above 0 K, W m-2 sr-1 Hz-1.

    With a = h nu / (2 k T) there are n = exp(-a) / (2 sinh(a)) photons in each mode.
    """
    half = PLANCK * frequency_hz / (2 * BOLTZMANN * temperature_k)
    return np.asarray(_per_photon(frequency_hz) * np.exp(-half) / (2 * np.sinh(half)))


def planck_difference(
    frequency_hz: Array | float, temperature_k: Array | float, reference_k: float
) -> Array:
    """Returns B(T) - B(T_r) in W m-2 sr-1 Hz-1; frequency and temperature broadcast.

    With a = h nu / (2 k T), and b for the reference, the photons in each mode differ by
    (coth a - coth b) / 2 = tanh(b - a) (1 / (tanh a tanh b) - 1) / 2. This holds from 0 K, where a
    is infinite, to any temperature. It keeps its digits however close the two temperatures are, if
    the reference is not cold (h nu below about 5 k T_r).
    """
    kelvin = np.asarray(temperature_k, dtype=np.float64)
    half_k = PLANCK * np.asarray(frequency_hz, dtype=np.float64) / (2 * BOLTZMANN)
    with np.errstate(divide="ignore"):
        a, apart = half_k / kelvin, half_k * ((kelvin - reference_k) / (kelvin * reference_k))
    inverse = 1 / (np.tanh(a) * np.tanh(half_k / reference_k))
    return np.asarray(_per_photon(frequency_hz) / 2 * np.tanh(apart) * (inverse - 1))


def _per_photon(frequency_hz: Array | float) -> Array:
    """Returns the radiance of one photon in each mode, 2 h nu^3 / c^2, W m-2 sr-1 Hz-1."""
    return np.asarray(2 * PLANCK * np.asarray(frequency_hz) ** 3 / LIGHT_SPEED**2)
