"""The inertial range: found in a spectrum and in a structure function, and the structure constants that they give.

One-sided in cycles per metre, the density of a scalar whose structure function is C^2 r^(2/3) is
2 * 0.1244 (2 pi)^(-2/3) C^2 xi^(-5/3); two-sided in radians per metre, 0.1244 C^2 k^(-5/3). Tatarskii (1971). White noise of
the sensor adds a floor to the one and twice its variance to the other. Periodograms are fitted by maximum likelihood, that
is by their mean, as Whittle (1953) has it: the mean of their logarithm would lie 44 % low.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thzcl.records.columns import RecordError
from thzcl.turbulence.spectrum_table import KOLMOGOROV_ALONG as ONE_SIDED_CYCLES

Array = NDArray[np.float64]

BINS_PER_DECADE = 12
FEWEST_IN_BIN = 8  # periodogram values
HANN_CORRELATION = (
    35 / 18
)  # neighbours of a Hann-windowed periodogram share information: 1 + 2 (4/9 + 1/36)
TOLERATED = 0.15  # relative departure of a bin from the line, beside its scatter: measured turbulence is intermittent
MEAN_DEVIANCE, LARGEST_DEVIANCE = (
    1.5,
    9.0,
)  # of bins in the inertial range; 1 on average, and three sigma
WIDEST_SLOPE = 0.06  # departure of the free slope from -5/3 within the range; two standard deviations, where they are more
NARROWEST = 5.0  # ratio of the range's limits
OUTER_SCALES = 40  # tried
ABOVE_BEND = 3.0  # inverse outer scales, at which von Karman's density is 8 % below the line
BEND = 0.393  # of D(r) = C^2 r^(2/3) (1 - 0.393 (2 pi r / L0)^(4/3)): Gamma(2/3) and (4/3) in the series of von Karman's
MOST_BENT = 0.5  # 2 pi r / L0: there the series is short by 0.2 %
STRAIGHT = 0.03  # relative departure of a structure function from its line


@dataclass(frozen=True)
class Binned:
    """A periodogram averaged in bins of the logarithm of spatial frequency; all arrays are (bin,).

    `density` one-sided, in squared units of the signal times m; `power` the mean of xi^(-5/3) in
    the bin, `frequency` (in cycles/m) that at which xi^(-5/3) has this mean; `count` how many
    values of periodograms.
    """

    frequency: Array
    power: Array
    density: Array
    count: Array

    def part(self, low: float, high: float) -> Binned:
        """The bins between two spatial frequencies."""
        inside = (self.frequency >= low) & (self.frequency <= high)
        return Binned(
            self.frequency[inside], self.power[inside], self.density[inside], self.count[inside]
        )


@dataclass(frozen=True)
class Inertial:
    """The inertial range of a spectrum: its limits in cycles/m, C^2, the noise's density.

    And the free slope.
    """

    limits: tuple[float, float]
    structure_constant: float
    noise: float  # one-sided, in squared units of the signal times m
    bend: float  # cycles/m, 1/L0 of the von Karman spectrum that bends below the range; 0 where it does not bend
    slope: float
    slope_uncertainty: float  # one standard deviation

    def line(self, frequency: Array) -> Array:
        """The -5/3 line, without the noise."""
        return np.asarray(ONE_SIDED_CYCLES * self.structure_constant * frequency ** (-5 / 3))

    def variance_of_noise(self, highest: float) -> float:
        """Of the sensor, from the floor up to the highest frequency.

        Less what the signal itself folds down from beyond it.
        """
        folded = 1.5 * ONE_SIDED_CYCLES * self.structure_constant * math.pow(highest, -2 / 3)
        return float(max(0.0, self.noise * highest - folded))


def binned(frequency: Array, density: Array) -> Binned:
    """Averages periodogram values (n,) in bins, twelve to a decade and of eight values at least."""
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
    """The widest range in which a density is a -5/3 line over a floor of noise, within its scatter, and what it gives.

    Where the density bends below the line as an outer scale would have it, the range begins above the bend: so few values
    lie there that the search is blind to it, and yet the fit would lose up to a seventh. Raises RecordError where there is
    no such range; `place` begins its message.
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
            f"{place}: expected an inertial range, a spectral slope of -5/3 over at least a factor of {NARROWEST:g} of spatial "
            "frequency; found none"
        )
    low, high = float(best.frequency[0]), float(best.frequency[-1])
    bend = _bend(best)
    start = spectrum.frequency[
        spectrum.frequency >= max(low, min(ABOVE_BEND * bend, high / NARROWEST))
    ][0]
    return within(spectrum, (float(start), high), bend)


def within(spectrum: Binned, limits: tuple[float, float], bend: float = 0.0) -> Inertial:
    """What a spectrum that bends at a spatial frequency gives in given limits."""
    part = spectrum.part(*limits)
    amplitude, floor = _line(_bent(part, bend))
    slope, uncertainty = _slope(part, amplitude, floor)
    return Inertial(limits, amplitude / ONE_SIDED_CYCLES, floor, bend, slope, uncertainty)


def _bend(part: Binned) -> float:
    """1/L0 of the von Karman spectrum (xi^2 + 1/L0^2)^(-5/6) over a floor, of greatest likelihood.

    0 if no better than none.
    """
    tried = np.geomspace(part.frequency[0] / 4, part.frequency[-1] / NARROWEST, OUTER_SCALES)
    likelihood = [_likelihood(_bent(part, float(bend))) for bend in tried]
    best = int(np.argmax(likelihood))
    # One more parameter has to gain 2 in the logarithm, of values that are not independent.
    return (
        float(tried[best]) if likelihood[best] > _likelihood(part) + 2 * HANN_CORRELATION else 0.0
    )


def _bent(part: Binned, bend: float) -> Binned:
    """With the von Karman spectrum's power of frequency in the place of xi^(-5/3)."""
    return replace(part, power=(part.frequency**2 + bend**2) ** (-5 / 6))


def _likelihood(part: Binned) -> float:
    """Logarithm of the likelihood of a periodogram about its best line and floor (Whittle 1953)."""
    amplitude, floor = _line(part)
    mean = amplitude * part.power + floor
    return -float(np.sum(part.count * (np.log(mean) + part.density / mean)))


def _straight(part: Binned) -> bool:
    """Whether some bins follow a -5/3 line over a floor that lies below the line."""
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
    """Amplitude of the xi^(-5/3) and floor, not negative, of greatest likelihood.

    By Fisher's scoring.
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
    """The free slope over a given floor, of greatest likelihood, and its standard deviation."""
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
    """C^2, and the limits in m of the widest range in which D(r) = C^2 r^(2/3) (1 - bend) + noise.

    Of separations (n,) in m, none below the inverse of the spectrum's `found` range's end, and the
    structure function (n,) there. Twice the variance of the noise, up to the `highest` spatial
    frequency, and the outer scale are the spectrum's: in a structure function one passes for the
    other.
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
