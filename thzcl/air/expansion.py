"""The expansion of absorption in powers of humidity and temperature, which stands in for MPM93.

In isothermal air the optical depth at frequency nu is sum_k c_k(nu) M_k over path moments
M_k = integral of delta^k ds, with delta = rho / rho_mean - 1. If temperature fluctuates too, each
coefficient is itself a polynomial in the temperature's departure from its mean. A Chebyshev series
covers exactly the range of delta and temperature that a scene's air reaches. It is cut at the
lowest degree whose error is within the tolerance, and written out in powers of delta. The mean air
lies at delta = 0, so that float32 needs to resolve only departures from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air.mean import NOWHERE, Air, Span
from thzcl.graph import LeftOut, Spec, Values, Work, frozen

Array = NDArray[np.float64]

HIGHEST_DEGREE = 16
STILL_FALLS = 2.0  # no degree is raised to lower the error by less than this factor
_NODES = 33  # of the uncut series: enough for every line at pressures of 1 hPa and above
_SAFETY = 1.2  # the error between checked points may be a little larger than at them


@dataclass(frozen=True)
class Expansion:
    """The polynomial K(nu, delta, t) = sum over k, j of coefficients[nu, k, j] delta^k t^j, in 1/m.

    t is the temperature's departure from the mean in kelvin. `measured` is the largest
    |polynomial - model| over the spans and all frequencies, relative to the mean air's absorption,
    at points that are not nodes of the fit; `error` bounds that difference everywhere.
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
        """Returns the number of path moments, the length not counted, that the depth needs."""
        return int(self.coefficients.shape[1]) - 1

    @property
    def sizes(self) -> Array:
        """Returns the largest absolute value of each term within the spans, 1/m.

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

    `tolerance` is relative to the mean air's absorption. `humidity_span` bounds delta, and
    `temperature_span` bounds the temperature's departure from the mean in kelvin. `moments` fixes
    the degree in delta. If degree 16 does not suffice, the expansion of degree 16 is returned with
    its larger error, which the caller reports.
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
    """Returns the expansion that `fit` describes, from arguments that can be hashed."""
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
    """Returns an expansion without its smallest terms, its error still within `tolerance`.

    `tolerance` is relative to the mean air's absorption. The sum of the dropped terms is at most
    the tolerance less the expansion's error. In each power of delta, the highest powers of t are
    dropped first.
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
    remaining = np.where(np.arange(terms.shape[1]) < counts[:, None], expansion.coefficients, 0.0)
    cut = replace(expansion, coefficients=remaining, error=expansion.error + left_out)
    return replace(cut, measured=_measured(cut, scale))


def _measured(expansion: Expansion, scale: Array) -> float:
    """Returns the largest error at points between the nodes and at the ends of the spans.

    The error is divided by `scale` (frequency, 1, 1) in 1/m.
    """
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
    """Returns a span of delta limited to what is possible: from dry air to vapour alone."""
    if air.absolute_humidity_g_m3 == 0 or not air.varies:
        return NOWHERE
    high = min(humidity_span[1], air.most_vapour)
    return min(max(humidity_span[0], -1.0), high), high


def chebyshev_series(
    absorption: Callable[[Array, Array], Array], humidity_span: Span, temperature_span: Span
) -> Array:
    """Returns the coefficients, (frequency, k, j), of a function's Chebyshev series T_k T_j.

    `absorption` takes delta and t and returns values of shape (frequency, delta, t). The series
    agrees with it at 33 Chebyshev nodes in each of the two spans.
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
    """Returns the least degrees in delta and in t for which the cut series is within tolerance.

    The degree in t is chosen first, with half of the tolerance, and then the degree in delta, each
    power of which costs more time. `values` (frequency, node, node) are those of the uncut series.
    """
    most = (min(HIGHEST_DEGREE, series.shape[1] - 1), min(HIGHEST_DEGREE, series.shape[2] - 1))
    degree_d = min(moments, most[0]) if moments is not None and most[0] else most[0]
    goal = tolerance / _SAFETY
    degree_t = _least_degree(
        lambda j: _error_of_cut(values, series, (most[0], j)), most[1], goal / 2
    )
    if moments is None:
        degree_d = _least_degree(
            lambda k: _error_of_cut(values, series, (k, degree_t)), most[0], goal
        )
    return degree_d, degree_t


def _least_degree(error: Callable[[int], float], most: int, goal: float) -> int:
    """Returns the least degree whose error is within a goal, or else does not fall much further."""
    errors = []
    for degree in range(most + 1):
        errors.append(error(degree))
        if errors[-1] <= goal:
            return degree
    least = min(errors)
    return next(degree for degree, one in enumerate(errors) if one <= STILL_FALLS * least)


def _error_of_cut(values: Array, series: Array, degrees: tuple[int, int]) -> float:
    """Returns the largest absolute error, at the nodes, of a series cut at some degrees."""
    at_d, at_t = (
        _chebyshev(values.shape[1])[:, : degrees[0] + 1],
        _chebyshev(values.shape[2])[:, : degrees[1] + 1],
    )
    cut = series[:, : degrees[0] + 1, : degrees[1] + 1]
    return float(
        np.max(np.abs(np.einsum("nk,mj,fkj->fnm", at_d, at_t, cut, optimize=True) - values))
    )


def _scale(air: Air, frequency_hz: Array) -> Array:
    """Returns the mean air's absorption in 1/m, (frequency, 1, 1), as a divisor.

    It is 1 where the mean air absorbs nothing, so that nothing is divided by 0.
    """
    mean = air.absorption(frequency_hz)[:, None, None]
    return np.where(mean > 0, mean, 1.0)


def _between(span: Span) -> Array:
    """Returns the extremes of T_33 over a span: its two ends, and a point between any two nodes.

    For a span of no width it returns the span's one point.
    """
    if span[0] >= span[1]:
        return np.array([span[0]])
    middle, half = (span[0] + span[1]) / 2, (span[1] - span[0]) / 2
    return np.asarray(middle + half * np.cos(np.arange(_NODES + 1) * np.pi / _NODES))


def _nodes(span: Span) -> Array:
    """Returns the 33 Chebyshev nodes of a span, or the one point of a span of no width."""
    if span[0] >= span[1]:
        return np.array([span[0]])
    middle, half = (span[0] + span[1]) / 2, (span[1] - span[0]) / 2
    return np.asarray(middle + half * np.cos((np.arange(_NODES) + 0.5) * np.pi / _NODES))


def _chebyshev(count: int) -> Array:
    """Returns T_k at node n, (n, k), for `count` Chebyshev nodes and as many polynomials."""
    n = np.arange(count)
    return np.asarray(np.cos(np.outer(n + 0.5, n) * np.pi / count))


def _to_series(count: int) -> Array:
    """Returns the matrix (k, n) that turns values at `count` nodes into coefficients of T_k."""
    weights = np.full(count, 2.0 / count)
    weights[0] = 1.0 / count
    return np.asarray(weights[:, None] * _chebyshev(count).T)


def _to_powers(span: Span, degree: int) -> Array:
    """Returns the matrix whose row k holds T_k(u) in powers of x, for k up to `degree`.

    u = (x - middle) / half lies in -1 to 1 over the span of x; T_(k+1) = 2 u T_k - T_(k-1).
    """
    middle, half = (span[0] + span[1]) / 2, (span[1] - span[0]) / 2 or 1.0
    rows = np.zeros((degree + 1, degree + 1))
    rows[0, 0] = 1.0
    for k in range(degree):
        times_u = (np.roll(rows[k], 1) - middle * rows[k]) / half
        rows[k + 1] = times_u if k == 0 else 2 * times_u - rows[k - 1]
    return rows


class Reached(Protocol):
    """A cube whose values lie within known spans; thzcl.turbulence.cube.Field is one."""

    @property
    def humidity_span(self) -> Span:
        """Returns the smallest and largest delta in the cube."""

    @property
    def temperature_span(self) -> Span:
        """Returns the smallest and largest departure from the mean temperature, K."""


class Reaching(Protocol):
    """The spec of a cube, which foresees its spans; see thzcl.turbulence.fields.AnyField."""

    def spans(self) -> tuple[Span, Span]:
        """Returns the spans of delta, and of the departure from the mean temperature in K."""


@frozen
class ExpansionSpec(Spec):
    """The expansion of one air at some frequencies, over the spans that its cube reaches."""

    air: Air
    frequency_hz: Values  # (frequency,)
    field: Reaching | None  # None for air that is the same everywhere
    tolerance: float  # relative to the mean air's absorption
    moments: int | None  # a fixed degree in delta
    reads = ("field",)
    stage = "surrogate"

    def run(self, device: object, field: Reached | None) -> Expansion:
        """Returns the expansion of the least degree that this air needs."""
        del device
        spans = (NOWHERE, NOWHERE)
        if field is not None:
            spans = (field.humidity_span, field.temperature_span)
        return self._fit(spans)

    def planned(self) -> Expansion:
        """Returns the expansion over spans that the cube exceeds with probability 1e-6."""
        return self._fit((NOWHERE, NOWHERE) if self.field is None else self.field.spans())

    def _fit(self, spans: tuple[Span, Span]) -> Expansion:
        """Returns the expansion over the spans of delta and of temperature."""
        frequency_hz = self.frequency_hz.array
        return fit(self.air, frequency_hz, *spans, tolerance=self.tolerance, moments=self.moments)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns the name of the absorption model, or why none is needed."""
        if not (self.air.varies or self.air.absorption(self.frequency_hz.array).any()):
            return {"surrogate": LeftOut("air that absorbs nothing")}
        return {"surrogate": Work("", f"{self.air.names} as polynomial")}


@frozen
class TrimmedSpec(Spec):
    """An expansion without its smallest terms, for kernels that evaluate it in every voxel."""

    expansion: ExpansionSpec
    reads = ("expansion",)
    stage = "surrogate"

    def run(self, device: object, expansion: Expansion) -> Expansion:
        """Returns the expansion with fewer terms, its error still within its tolerance."""
        del device
        return trimmed(expansion, self.expansion.tolerance)

    def planned(self) -> Expansion:
        """Returns the whole expansion over spans that the cube exceeds with probability 1e-6."""
        return self.expansion.planned()
