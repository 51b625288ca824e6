"""Sums over a frequency band: frequencies and weights that resolve its lines, or the paper's steps.

The summand is response times black-body radiance times exp(-K(nu) s), for paths of several lengths
s. The lines are narrow, a few GHz at one atmosphere and a few MHz at 1 hPa. The band is covered by
Gauss-Legendre rules, each on a part that is halved until halving changes next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.errors import FileError

Array = NDArray[np.float64]

HIGHEST_GHZ = 100_000.0  # where the thermal infrared begins; no frequency in Hz is as low
TOLERANCE = 1e-5  # of the radiance that the shortest path lets through
_POINTS = 7  # of the rule on each part of the band
_DEEPEST = 24  # halvings, which make parts of 6 kHz out of 100 GHz
_GAUSSIAN_WIDTHS = 1.5  # full widths at half maximum to either edge: all but 4e-4 of a Gaussian


class Sight(Protocol):
    """What a sum over a band must know of the scene; thzcl.sensor.View is one."""

    @property
    def air_temperature_k(self) -> float:
        """Returns the temperature of the mean air, K."""

    @property
    def path_m(self) -> tuple[float, float]:
        """Returns about the lengths of the shortest and the longest path, m."""

    @property
    def absorption(self) -> Callable[[Array], Array]:
        """Returns the function that gives the mean air's absorption in 1/m at frequencies in Hz."""

    @property
    def lines_hz(self) -> Array:
        """Returns the centre frequencies of the air's lines, Hz."""

    @property
    def line_width_hz(self) -> float:
        """Returns about the width of the air's lines, Hz."""


@dataclass(frozen=True)
class Band:
    """A band from `low_hz` to `high_hz`, and the function that gives its response at (n,) Hz.

    `peak` is the largest response.
    """

    low_hz: float
    high_hz: float
    response: Callable[[Array], Array]
    peak: float = 1.0


@dataclass(frozen=True)
class Quadrature:
    """A rule that sums over a band: ascending frequencies in Hz, and weights in Hz, both (node,).

    The weights include the band's response. `error` is the sum's error, relative to the radiance
    that passes the shortest path; it is NaN where it was not estimated.
    """

    frequency_hz: Array
    weights: Array
    error: float


def named(shape: str, center_hz: float, width_hz: float) -> Band:
    """Returns a "flat" band, or a "gaussian" one whose width is that at half maximum.

    Raises ValueError for a band that is not within 0 to HIGHEST_GHZ.
    """
    half = width_hz / 2 if shape == "flat" else _GAUSSIAN_WIDTHS * width_hz
    if not 0 < center_hz - half < center_hz + half <= HIGHEST_GHZ * 1e9:
        raise ValueError(
            f"center_ghz and bandwidth_ghz make a band of {(center_hz - half) / 1e9:g} to "
            f"{(center_hz + half) / 1e9:g} GHz; it must lie above 0 and up to {HIGHEST_GHZ:g} GHz"
        )
    if shape == "flat":
        return Band(center_hz - half, center_hz + half, np.ones_like)
    return Band(
        center_hz - half,
        center_hz + half,
        lambda f: np.asarray(np.exp(-4 * np.log(2) * ((f - center_hz) / width_hz) ** 2)),
    )


def tabulated(table: Array, name: str) -> Band:
    """Returns the band of a table (row, 2) of frequencies in GHz and responses.

    The response is linear between the rows. `name` is what messages call the table. Raises
    FileError if the table is no band.
    """
    if table.shape[1] != 2 or len(table) < 2:
        raise FileError(
            f"{name}: needs two columns, frequency in GHz and response, and two rows or more"
        )
    ghz, response = table.T
    if not (np.diff(ghz) > 0).all():
        raise FileError(f"{name}: its frequencies do not ascend; sort them, and give each once")
    if ghz[0] <= 0 or ghz[-1] > HIGHEST_GHZ:
        raise FileError(f"{name}: its frequencies must lie above 0 and up to {HIGHEST_GHZ:g} GHz")
    if not (np.isfinite(response).all() and response.min() >= 0 and response.max() > 0):
        raise FileError(f"{name}: its response must be at least 0, and above 0 somewhere")
    return Band(
        float(ghz[0]) * 1e9,
        float(ghz[-1]) * 1e9,
        lambda f: np.asarray(np.interp(f, ghz * 1e9, response)),
        float(response.max()),
    )


def resolve(band: Band, sight: Sight, tolerance: float = TOLERANCE) -> Quadrature:
    """Returns as few frequencies as resolve the band's lines, for every length of path."""
    edges = _first_edges(band, sight)
    low, high = edges[:-1], edges[1:]
    whole = _parts(band, sight, low, high)
    scale = _reference(whole.sum(axis=0))
    accepted: list[tuple[Array, Array]] = []
    error = 0.0
    for depth in range(_DEEPEST + 1):
        middle = (low + high) / 2
        left, right = _parts(band, sight, low, middle), _parts(band, sight, middle, high)
        change = np.abs(whole - left - right).max(axis=1)
        # Errors add up, so that a part may have its share of the tolerance by width, or a floor.
        share = tolerance * scale * np.maximum((high - low) / (band.high_hz - band.low_hz), 1e-3)
        done = (change <= share) | (depth == _DEEPEST)
        accepted.append((low[done], high[done]))
        error += float(change[done].sum())
        left, right, low, middle, high = (
            array[~done] for array in (left, right, low, middle, high)
        )
        if not len(low):
            break
        whole, low, high = (
            np.concatenate([left, right]),
            np.concatenate([low, middle]),
            np.concatenate([middle, high]),
        )
    frequency_hz, weights = _rule(*(np.concatenate(ends) for ends in zip(*accepted, strict=True)))
    order = np.argsort(frequency_hz.ravel())
    flat = frequency_hz.ravel()[order]
    return Quadrature(flat, weights.ravel()[order] * band.response(flat), error / scale)


def _reference(radiance: Array) -> float:
    """Returns the radiance that errors are divided by: what passes the shortest path.

    `radiance` (length of path,) starts with that before any air; a trillionth of this is the least
    that is returned.
    """
    return float(max(radiance[1], 1e-12 * radiance[0]))


def _first_edges(band: Band, sight: Sight) -> Array:
    """Returns the edges of the band's first parts, ascending, Hz.

    The parts grow finer towards lines that are too narrow for a coarse rule to notice.
    """
    width = band.high_hz - band.low_hz
    edges = [np.array([band.low_hz, band.high_hz])]
    if sight.line_width_hz < width / 100:
        steps = sight.line_width_hz * 4.0 ** np.arange(
            np.ceil(np.log(width / sight.line_width_hz) / np.log(4))
        )
        inside = sight.lines_hz[(sight.lines_hz > band.low_hz) & (sight.lines_hz < band.high_hz)]
        edges += [line + np.array([*-steps, 0.0, *steps]) for line in inside]
    cuts = np.unique(np.concatenate(edges))
    return cuts[(cuts >= band.low_hz) & (cuts <= band.high_hz)]


def paper(band: Band, step_hz: float, reading: str) -> Quadrature:
    """Returns a rule of equal steps, as O'Brien and Tofsted sum over a band.

    `reading` is "edges" for the mean over the band's edges and the steps between them, "trapezoid"
    for the trapezoid rule over the same frequencies, or "bins" for the middles of the steps.
    """
    width = band.high_hz - band.low_hz
    steps = max(1, round(width / step_hz))
    if reading == "bins":
        frequency_hz = band.low_hz + (np.arange(steps) + 0.5) * width / steps
        weights = np.full(steps, width / steps)
    else:
        frequency_hz = np.linspace(band.low_hz, band.high_hz, steps + 1)
        weights = np.full(steps + 1, width / (steps + 1))
        if reading == "trapezoid":
            weights = np.full(steps + 1, width / steps)
            weights[[0, -1]] /= 2
    return Quadrature(frequency_hz, weights * band.response(frequency_hz), np.nan)


def error(used: Quadrature, resolved: Quadrature, sight: Sight) -> float:
    """Returns the largest error of the `used` rule over the lengths of path.

    It is relative to the radiance that passes the shortest path; `resolved` stands for the truth.
    """

    def radiance(quadrature: Quadrature) -> Array:
        return quadrature.weights @ _integrand(sight, quadrature.frequency_hz)

    exact = radiance(resolved)
    # Mean radiances are compared, each over the sum of its own rule's weights.
    approximate = radiance(used) * resolved.weights.sum() / used.weights.sum()
    return float(np.max(np.abs(approximate - exact)) / _reference(exact))


def _parts(band: Band, sight: Sight, low: Array, high: Array) -> Array:
    """Returns integrals over parts of the band, (part, length of path); length 0 comes first."""
    frequency_hz, weights = _rule(low, high)
    values = _integrand(sight, frequency_hz.ravel()) * band.response(frequency_hz.ravel())[:, None]
    return np.asarray(np.einsum("pn,pns->ps", weights, values.reshape(*frequency_hz.shape, -1)))


def _rule(low: Array, high: Array) -> tuple[Array, Array]:
    """Returns Gauss-Legendre frequencies and weights in Hz on each part, both (part, point)."""
    x, w = _nodes()
    middle, half = (low + high)[:, None] / 2, (high - low)[:, None] / 2
    return middle + half * x, half * w


@cache
def _nodes() -> tuple[Array, Array]:
    """Returns nodes and weights of Gauss and Legendre's rule from -1 to 1."""
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    return x, w


def _integrand(sight: Sight, frequency_hz: Array) -> Array:
    """Returns the air's black-body radiance behind paths of several lengths, (frequency, length).

    The first length is 0; the others run from the shortest path to twice the longest.
    """
    lengths = np.array([0.0, *np.geomspace(sight.path_m[0], sight.path_m[1] * 2, 6)])
    radiance = radiometry.planck(frequency_hz, sight.air_temperature_k)
    return np.asarray(
        radiance[:, None] * np.exp(-np.outer(sight.absorption(frequency_hz), lengths))
    )
