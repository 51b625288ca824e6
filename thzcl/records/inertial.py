"""The inertial range of a spectrum and of a structure function, and their structure constants.

The density of a scalar whose structure function is C^2 r^(2/3) is, one-sided in cycles per metre,
2 * 0.1244 (2 pi)^(-2/3) C^2 xi^(-5/3), and two-sided in radians per metre 0.1244 C^2 k^(-5/3)
(Tatarskii 1971). White noise of the sensor adds a floor to the spectrum and twice its variance to
the structure function. Periodograms are fitted by maximum likelihood (Whittle 1953), that is by
their mean: the mean of their logarithm would lie 44 % low.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.turbulence.spectrum_table import KOLMOGOROV_ALONG as ONE_SIDED_CYCLES

Array = NDArray[np.float64]

BINS_PER_DECADE = 12
FEWEST_IN_BIN = 8  # periodogram values
# Neighbours of a Hann-windowed periodogram share information: 1 + 2 (4/9 + 1/36).
HANN_CORRELATION = 35 / 18
# The relative departure of a bin from the line, beside its scatter: measured turbulence is
# intermittent.
TOLERATED = 0.15
# Of bins in the inertial range: expected are 1 on average, and three sigma at most.
MEAN_DEVIANCE, LARGEST_DEVIANCE = 1.5, 9.0
# The departure of the free slope from -5/3 within the range, or two standard deviations if they
# are more.
WIDEST_SLOPE = 0.06
NARROWEST = 5.0  # ratio of the range's limits
OUTER_SCALES = 40  # tried
ABOVE_BEND = 3.0  # inverse outer scales, at which von Karman's density is 8 % below the line
# Of D(r) = C^2 r^(2/3) (1 - 0.393 (2 pi r / L0)^(4/3)), the series of von Karman's structure
# function: from Gamma(2/3) and Gamma(4/3).
BEND = 0.393
MOST_BENT = 0.5  # 2 pi r / L0: there the series is short by 0.2 %
STRAIGHT = 0.03  # relative departure of a structure function from its line


@dataclass(frozen=True)
class Binned:
    """A periodogram averaged in bins of the logarithm of spatial frequency; all arrays are (bin,).

    `density` is one-sided, in squared units of the signal times m; `power` is the mean of
    xi^(-5/3) in the bin, `frequency` (in cycles/m) that at which xi^(-5/3) has this mean, and
    `count` the number of periodogram values.
    """

    frequency: Array
    power: Array
    density: Array
    count: Array

    def part(self, low: float, high: float) -> Binned:
        """Returns the bins between two spatial frequencies."""
        inside = (self.frequency >= low) & (self.frequency <= high)
        return Binned(
            self.frequency[inside], self.power[inside], self.density[inside], self.count[inside]
        )


@dataclass(frozen=True)
class Inertial:
    """The inertial range of a spectrum, and what was fitted in it.

    `limits` are in cycles/m; `structure_constant` is C^2; `noise` is the floor, one-sided, in
    squared units of the signal times m; `bend` is 1/L0 in cycles/m of the von Karman spectrum that
    bends below the range, or 0 if it does not bend; `slope` is fitted freely, and its uncertainty
    is one standard deviation.
    """

    limits: tuple[float, float]
    structure_constant: float
    noise: float
    bend: float
    slope: float
    slope_uncertainty: float

    def line(self, frequency: Array) -> Array:
        """Returns the density of the -5/3 line, without the noise."""
        return np.asarray(ONE_SIDED_CYCLES * self.structure_constant * frequency ** (-5 / 3))

    def variance_of_noise(self, highest: float) -> float:
        """Returns the variance of the sensor's noise: the floor's, up to the highest frequency.

        What the signal itself folds down from beyond that frequency is subtracted.
        """
        folded = 1.5 * ONE_SIDED_CYCLES * self.structure_constant * math.pow(highest, -2 / 3)
        return float(max(0.0, self.noise * highest - folded))


def binned(frequency: Array, density: Array) -> Binned:
    """Averages periodogram values (n,) in bins of at least eight values, twelve to a decade."""
    order = np.argsort(frequency)
    frequency, density = frequency[order], density[order]
    decade = np.floor(np.log10(frequency / frequency[0]) * BINS_PER_DECADE)
    ends = [*(np.flatnonzero(np.diff(decade)) + 1).tolist(), len(frequency)]
    starts = [0]
    for end in ends[:-1]:
        if end - starts[-1] >= FEWEST_IN_BIN and len(frequency) - end >= FEWEST_IN_BIN:
            starts.append(end)
    count = np.diff([*starts, len(frequency)]).astype(np.float64)
    power = np.add.reduceat(frequency ** (-5 / 3), starts) / count
    return Binned(power ** (-3 / 5), power, np.add.reduceat(density, starts) / count, count)


def find(spectrum: Binned, place: str) -> Inertial:
    """Returns the widest range in which a density is a -5/3 line over a floor, within its scatter.

    If the density bends below the line, as below an outer scale, the range begins above the bend:
    so few values lie there that the search is blind to it, and yet the fit would lose up to a
    seventh. Raises RecordError if there is no such range; `place` begins the message.
    """
    widest, best = math.log(NARROWEST), None
    logs = np.log(spectrum.frequency)
    for first in range(len(logs) - 3):
        for last in range(len(logs) - 1, first + 2, -1):
            if logs[last] - logs[first] <= widest:
                break
            part = Binned(*(values[first : last + 1] for values in vars(spectrum).values()))
            if _straight(part):
                widest, best = float(logs[last] - logs[first]), part
    if best is None:
        raise RecordError(
            f"{place}: expected an inertial range, a spectral slope of -5/3 over at least a factor "
            f"of {NARROWEST:g} of spatial frequency; found none"
        )
    low, high = float(best.frequency[0]), float(best.frequency[-1])
    bend = _bend(best)
    start = spectrum.frequency[
        spectrum.frequency >= max(low, min(ABOVE_BEND * bend, high / NARROWEST))
    ][0]
    return within(spectrum, (float(start), high), bend)


def within(spectrum: Binned, limits: tuple[float, float], bend: float = 0.0) -> Inertial:
    """Returns the fit to a spectrum in given limits, with a bend at a given spatial frequency."""
    part = spectrum.part(*limits)
    amplitude, floor = _line(_bent(part, bend))
    slope, uncertainty = _slope(part, amplitude, floor)
    return Inertial(limits, amplitude / ONE_SIDED_CYCLES, floor, bend, slope, uncertainty)


def _bend(part: Binned) -> float:
    """Returns 1/L0 of the most likely von Karman spectrum (xi^2 + 1/L0^2)^(-5/6) over a floor.

    Returns 0 if that is no better than a spectrum without a bend.
    """
    tried = np.geomspace(part.frequency[0] / 4, part.frequency[-1] / NARROWEST, OUTER_SCALES)
    likelihood = [_likelihood(_bent(part, float(bend))) for bend in tried]
    best = int(np.argmax(likelihood))
    # One more parameter has to gain 2 in the logarithm, of values that are not independent.
    return (
        float(tried[best]) if likelihood[best] > _likelihood(part) + 2 * HANN_CORRELATION else 0.0
    )


def _bent(part: Binned, bend: float) -> Binned:
    """Returns bins with the von Karman spectrum's power of frequency in place of xi^(-5/3)."""
    return replace(part, power=(part.frequency**2 + bend**2) ** (-5 / 6))


def _likelihood(part: Binned) -> float:
    """Returns the log-likelihood of a periodogram about its best line and floor (Whittle 1953)."""
    amplitude, floor = _line(part)
    mean = amplitude * part.power + floor
    return -float(np.sum(part.count * (np.log(mean) + part.density / mean)))


def _straight(part: Binned) -> bool:
    """Returns whether bins follow a -5/3 line over a floor that lies below the line."""
    amplitude, floor = _line(part)
    if not amplitude * part.power[-1] > floor:
        return False
    ratio = part.density / (amplitude * part.power + floor)
    weight = 1 / (HANN_CORRELATION / part.count + TOLERATED**2)
    deviance = 2 * weight * (ratio - 1 - np.log(ratio))
    if deviance.mean() > MEAN_DEVIANCE or deviance.max() > LARGEST_DEVIANCE:
        return False
    slope, uncertainty = _slope(part, amplitude, floor)
    return abs(slope + 5 / 3) < max(WIDEST_SLOPE, 2 * uncertainty)


def _line(part: Binned) -> tuple[float, float]:
    """Returns the most likely amplitude of xi^(-5/3) and the floor, neither of them negative.

    They are found by Fisher's scoring.
    """
    amplitude, floor = float(np.sum(part.count * part.density / part.power) / part.count.sum()), 0.0
    for _ in range(12):
        mean = amplitude * part.power + floor
        weight = part.count / mean**2
        aa, ab, bb = (float(np.sum(weight * x)) for x in (part.power**2, part.power, 1.0))
        pa, pb = (
            float(np.sum(weight * part.density * part.power)),
            float(np.sum(weight * part.density)),
        )
        determinant = aa * bb - ab * ab
        amplitude, floor = (pa * bb - pb * ab) / determinant, (pb * aa - pa * ab) / determinant
        if floor <= 0 or amplitude <= 0:
            return float(np.sum(part.count * part.density / part.power) / part.count.sum()), 0.0
    return amplitude, floor


def _slope(part: Binned, amplitude: float, floor: float) -> tuple[float, float]:
    """Returns the most likely free slope over a given floor, and its standard deviation."""
    log = np.log(part.frequency)
    log -= np.average(log, weights=part.count)
    level, slope = math.log(amplitude) + float(np.mean(np.log(part.power))), -5 / 3
    design = np.stack([np.ones_like(log), log], axis=1)
    for _ in range(20):
        line = np.exp(level + slope * log)
        weight = part.count * (line / (line + floor)) ** 2
        normal = design.T @ (weight[:, None] * design)
        step = np.linalg.solve(normal, design.T @ (weight * (part.density - line - floor) / line))
        level, slope = (
            level + float(np.clip(step[0], -1, 1)),
            slope + float(np.clip(step[1], -1, 1)),
        )
    ratio = part.density / (np.exp(level + slope * log) + floor)
    scatter = (
        2
        * np.sum(part.count / HANN_CORRELATION * (ratio - 1 - np.log(ratio)))
        / max(len(log) - 2, 1)
    )
    return slope, math.sqrt(
        float(np.linalg.inv(normal)[1, 1]) * HANN_CORRELATION * max(1.0, float(scatter))
    )


def structure_fit(
    separation: Array, structure: Array, found: Inertial, highest: float
) -> tuple[float, tuple[float, float]]:
    """Returns C^2 and the widest range, in m, in which D(r) = C^2 r^(2/3) (1 - bend) + noise.

    `structure` (n,) is the structure function at `separation` (n,) in m; separations shorter than
    the spectrum's `found` range resolves are left out. The outer scale and the noise (twice its
    variance, up to the `highest` spatial frequency) are the spectrum's, since in a structure
    function one passes for the other.
    """
    turn = 2 * np.pi * separation * found.bend
    usable = separation >= 1 / found.limits[1]
    usable &= (turn <= MOST_BENT) | (
        np.cumsum(usable) <= 4
    )  # four at least, however short the outer scale
    r, bend = separation[usable], BEND * np.minimum(turn[usable], MOST_BENT) ** (4 / 3)
    ratio = (structure[usable] - 2 * found.variance_of_noise(highest)) / (r ** (2 / 3) * (1 - bend))
    best, widest = (float(ratio[:4].mean()), (float(r[0]), float(r[3]))), 0.0
    for first in range(len(r) - 3):
        for last in range(first + 3, len(r)):
            width = math.log(r[last] / r[first])
            part = ratio[first : last + 1]
            constant = float(part.mean())
            if width > widest and np.max(np.abs(part / constant - 1)) < STRAIGHT:
                widest, best = width, (constant, (float(r[first]), float(r[last])))
    return best
