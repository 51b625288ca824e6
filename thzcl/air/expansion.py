"""The expansion of absorption in powers of humidity and temperature, which stands in for MPM93.

In isothermal air the optical depth at frequency nu is sum_k c_k(nu) M_k over path moments
M_k = integral of delta^k ds, with delta = rho / rho_mean - 1. Where temperature fluctuates too,
each coefficient is itself a polynomial in its departure from the mean. A Chebyshev series over
exactly the range that a scene's own air reaches is cut where the error is within what was asked
for, and written out in powers of delta: the mean air is at delta = 0, so that what float32 must
resolve are departures from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.mean import Air
from thzcl.graph import LeftOut, Spec, Values, Work, frozen

Array = NDArray[np.float64]
Span = tuple[float, float]

NOWHERE: Span = (0.0, 0.0)
HIGHEST_DEGREE = 16
_NODES = 33  # of the series before it is cut: enough for every line at 1 hPa and more
_SAFETY = 1.2  # between checked points the error may be a little larger than at them


@dataclass(frozen=True)
class Expansion:
    """The polynomial K(nu, delta, t) = sum over k, j of coefficients[nu, k, j] delta^k t^j, in 1/m.

    t is the temperature's departure from the mean in kelvin. `measured` is the largest
    |polynomial - model| over the spans and all frequencies, relative to the mean air's absorption,
    at points that the fit has not seen; `error` bounds it everywhere.
    """

    air: Air
    frequency_hz: Array
    coefficients: Array  # (frequency, humidity power, temperature power), per metre
    humidity_span: Span
    temperature_span: Span
    error: float
    measured: float

    @property
    def moments(self) -> int:
        """Returns how many path moments beyond the length the optical depth needs."""
        return int(self.coefficients.shape[1]) - 1

    @property
    def sizes(self) -> Array:
        """Returns the most that each term can be within the spans, 1/m.

        The shape is (frequency, humidity power, temperature power).
        """
        spans = zip(
            (self.humidity_span, self.temperature_span), self.coefficients.shape[1:], strict=True
        )
        humidity, temperature = (max(map(abs, span)) ** np.arange(powers) for span, powers in spans)
        return np.asarray(np.abs(self.coefficients) * np.outer(humidity, temperature))

    def absorption(self, delta: Array | float, offset_k: Array | float = 0.0) -> Array:
        """Returns absorption in 1/m, shape (frequency, *broadcast shape of the arguments)."""
        d, t = np.broadcast_arrays(
            np.asarray(delta, dtype=np.float64), np.asarray(offset_k, dtype=np.float64)
        )
        powers_d = d[..., None] ** np.arange(self.coefficients.shape[1])
        powers_t = t[..., None] ** np.arange(self.coefficients.shape[2])
        return np.asarray(np.einsum("fkj,...k,...j->f...", self.coefficients, powers_d, powers_t))


def fit(
    air: Air,
    frequency_hz: Array,
    humidity_span: Span = NOWHERE,
    temperature_span: Span = NOWHERE,
    *,
    tolerance: float,
    moments: int | None = None,
) -> Expansion:
    """Returns the expansion of least degree whose error is within `tolerance`.

    `tolerance` is relative to the mean air's absorption, `humidity_span` bounds delta,
    `temperature_span` the departure from the mean in kelvin. `moments` fixes the degree in delta.
    Past degree 16 the expansion is returned with the error it has, which the caller reports.
    """
    spans = (possible(air, humidity_span), temperature_span)
    return _fitted(
        air, tuple(np.asarray(frequency_hz, dtype=np.float64).tolist()), spans, tolerance, moments
    )


@lru_cache(maxsize=32)  # variants often have their air in common
def _fitted(
    air: Air,
    frequencies: tuple[float, ...],
    spans: tuple[Span, Span],
    tolerance: float,
    moments: int | None,
) -> Expansion:
    frequency_hz = np.array(frequencies)
    scale = _scale(air, frequency_hz)
    series = chebyshev_series(
        lambda d, t: air.absorption(frequency_hz[:, None, None], d, t) / scale, *spans
    )
    values = np.einsum(
        "nk,mj,fkj->fnm",
        _chebyshev(series.shape[1]),
        _chebyshev(series.shape[2]),
        series,
        optimize=True,
    )
    degrees = _degrees(values, series, tolerance, moments)
    cut = series[:, : degrees[0] + 1, : degrees[1] + 1]
    powers_d, powers_t = (
        _to_powers(span, degree) for span, degree in zip(spans, degrees, strict=True)
    )
    coefficients = np.einsum("ka,jb,fkj->fab", powers_d, powers_t, cut) * scale
    expansion = Expansion(air, frequency_hz, coefficients, *spans, error=0.0, measured=0.0)
    measured = _measured(expansion, scale)
    return replace(
        expansion,
        measured=measured,
        error=_SAFETY * max(_error_of_cut(values, series, degrees), measured),
    )


def trimmed(expansion: Expansion, tolerance: float) -> Expansion:
    """Returns an expansion without its smallest terms.

    All that are left out are together within what its error leaves of `tolerance` (relative to the
    mean air's absorption). Of each power of delta it is the highest powers of t that go.
    """
    scale = _scale(expansion.air, expansion.frequency_hz)
    terms = (expansion.sizes / scale).max(axis=0)
    counts, left_out = np.full(len(terms), terms.shape[1]), 0.0
    while True:
        last = np.where(counts > 1, terms[np.arange(len(terms)), counts - 1], np.inf)
        row = int(last.argmin())
        if left_out + last[row] > tolerance - expansion.error:
            break
        left_out += last[row]
        counts[row] -= 1
    kept = np.where(np.arange(terms.shape[1]) < counts[:, None], expansion.coefficients, 0.0)
    cut = replace(expansion, coefficients=kept, error=expansion.error + left_out)
    return replace(cut, measured=_measured(cut, scale))


def _measured(expansion: Expansion, scale: Array) -> float:
    """Returns the largest error half way between the nodes, and at the ends of the spans."""
    delta, offset = (
        _between(span)[index]
        for span, index in zip(
            (expansion.humidity_span, expansion.temperature_span),
            (np.s_[:, None], np.s_[None, :]),
            strict=True,
        )
    )
    exact = expansion.air.absorption(expansion.frequency_hz[:, None, None], delta, offset)
    return float(np.max(np.abs(expansion.absorption(delta, offset) - exact) / scale))


def possible(air: Air, humidity_span: Span) -> Span:
    """Returns a span of delta limited to what air can be: between dry, and vapour alone."""
    if air.absolute_humidity_g_m3 == 0 or air.model == "none":
        return NOWHERE
    high = min(humidity_span[1], air.most_vapour)
    return min(max(humidity_span[0], -1.0), high), high


def chebyshev_series(
    absorption: Callable[[Array, Array], Array], humidity_span: Span, temperature_span: Span
) -> Array:
    """A function of delta and t, of shape (frequency, delta, t).

    As a series T_k T_j through 33 nodes each way.
    """
    nodes_d, nodes_t = _nodes(humidity_span), _nodes(temperature_span)
    values = absorption(nodes_d[:, None], nodes_t[None, :])
    return np.asarray(
        np.einsum(
            "kn,jm,fnm->fkj",
            _to_series(len(nodes_d)),
            _to_series(len(nodes_t)),
            values,
            optimize=True,
        )
    )


def _degrees(
    values: Array, series: Array, tolerance: float, moments: int | None
) -> tuple[int, int]:
    """The least degrees in delta and t at which the cut series is within tolerance.

    The dearer axis, delta, last.
    """
    most = (min(HIGHEST_DEGREE, series.shape[1] - 1), min(HIGHEST_DEGREE, series.shape[2] - 1))
    degree_d = min(moments, most[0]) if moments is not None and most[0] else most[0]
    goal = tolerance / _SAFETY
    degree_t = next(
        (j for j in range(most[1]) if _error_of_cut(values, series, (most[0], j)) <= goal / 2),
        most[1],
    )
    if moments is None:
        degree_d = next(
            (k for k in range(most[0]) if _error_of_cut(values, series, (k, degree_t)) <= goal),
            most[0],
        )
    return degree_d, degree_t


def _error_of_cut(values: Array, series: Array, degrees: tuple[int, int]) -> float:
    at_d, at_t = (
        _chebyshev(values.shape[1])[:, : degrees[0] + 1],
        _chebyshev(values.shape[2])[:, : degrees[1] + 1],
    )
    cut = series[:, : degrees[0] + 1, : degrees[1] + 1]
    return float(
        np.max(np.abs(np.einsum("nk,mj,fkj->fnm", at_d, at_t, cut, optimize=True) - values))
    )


def _scale(air: Air, frequency_hz: Array) -> Array:
    """The mean air's absorption, shape (frequency, 1, 1); 1 where there is none.

    So that nothing is divided by 0.
    """
    mean = air.absorption(frequency_hz)[:, None, None]
    return np.where(mean > 0, mean, 1.0)


def _between(span: Span) -> Array:
    """The extremes of T_33, each between two nodes, the ends among them.

    Or the one point of an empty span.
    """
    if span[0] >= span[1]:
        return np.array([span[0]])
    middle, half = (span[0] + span[1]) / 2, (span[1] - span[0]) / 2
    return np.asarray(middle + half * np.cos(np.arange(_NODES + 1) * np.pi / _NODES))


def _nodes(span: Span) -> Array:
    """Chebyshev nodes over a span, or the one point of an empty one."""
    if span[0] >= span[1]:
        return np.array([span[0]])
    middle, half = (span[0] + span[1]) / 2, (span[1] - span[0]) / 2
    return np.asarray(middle + half * np.cos((np.arange(_NODES) + 0.5) * np.pi / _NODES))


def _chebyshev(count: int) -> Array:
    """T_k at node n of as many Chebyshev nodes, shape (n, k)."""
    n = np.arange(count)
    return np.asarray(np.cos(np.outer(n + 0.5, n) * np.pi / count))


def _to_series(count: int) -> Array:
    """The matrix that turns values at the nodes into coefficients of T_k."""
    weights = np.full(count, 2.0 / count)
    weights[0] = 1.0 / count
    return np.asarray(weights[:, None] * _chebyshev(count).T)


def _to_powers(span: Span, degree: int) -> Array:
    """Row k: T_k((x - middle) / half) in powers of x, by T_k+1 = 2 u T_k - T_k-1."""
    middle, half = (span[0] + span[1]) / 2, (span[1] - span[0]) / 2 or 1.0
    rows = np.zeros((degree + 1, degree + 1))
    rows[0, 0] = 1.0
    for k in range(degree):
        times_u = (np.roll(rows[k], 1) - middle * rows[k]) / half
        rows[k + 1] = times_u if k == 0 else 2 * times_u - rows[k - 1]
    return rows


@frozen
class ExpansionSpec(Spec):
    """The expansion of one air at some frequencies, over what its cube reaches."""

    air: Air
    frequency_hz: Values  # (frequency,)
    field: Any  # the spec of a cube whose value has humidity_span and temperature_span, or None
    tolerance: float  # relative to the mean air's absorption
    moments: int | None  # a fixed degree in delta
    reads = ("field",)
    stage = "surrogate"

    def run(self, device: Any, field: Any) -> Expansion:
        """Returns the expansion, of this air's own least degree."""
        del device
        spans = (NOWHERE, NOWHERE)
        if field is not None:
            spans = (field.humidity_span, field.temperature_span)
        return self._fit(spans)

    def planned(self) -> Expansion:
        """Returns the expansion over the range that a cube leaves with probability 1e-6."""
        return self._fit((NOWHERE, NOWHERE) if self.field is None else self.field.spans())

    def _fit(self, spans: tuple[Span, Span]) -> Expansion:
        frequency_hz = self.frequency_hz.array
        return fit(self.air, frequency_hz, *spans, tolerance=self.tolerance, moments=self.moments)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns the model's name; its degree and error are told by the plan."""
        if self.air.model == "none":
            return {"surrogate": LeftOut('model = "none": air that absorbs nothing')}
        return {"surrogate": Work("", "MPM93 as polynomial")}


@frozen
class TrimmedSpec(Spec):
    """An expansion without terms that are too small to matter, where each costs time a voxel."""

    expansion: ExpansionSpec
    reads = ("expansion",)
    stage = "surrogate"

    def run(self, device: Any, expansion: Expansion) -> Expansion:
        """Returns the expansion with fewer terms, within its tolerance."""
        del device
        return trimmed(expansion, self.expansion.tolerance)

    def planned(self) -> Expansion:
        """Returns the expansion over the range that a cube leaves with probability 1e-6."""
        return self.expansion.planned()
