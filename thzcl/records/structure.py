"""Structure functions of a record, and the structure constant that one gives.

D(r) = C^2 r^(2/3) (1 - bend) + 2 sigma_n^2 - 2 lost, with the noise's variance sigma_n^2 and what a
slow sensor does not see.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.records.inertial import BELOW_ROLL, ONE_SIDED_CYCLES, Fit, Inertial
from thzcl.records.spectrum import Binned

Array = NDArray[np.float64]

LAGS = 60
# D(r) = C^2 r^(2/3) (1 - 0.393 (2 pi r / L0)^(4/3)), the series of von Karman's structure
# function: from Gamma(2/3) and Gamma(4/3).
BEND = 0.393
MOST_BENT = 0.5  # 2 pi r / L0: there the series is short by 0.2 %
STRAIGHT = 0.03  # relative departure of a structure function from its line
# The integral of x^(1/3) / (1 + x^2): what a first-order sensor loses, in 2 A C^2 c^(2/3).
LOST = math.pi / (2 * math.sin(2 * math.pi / 3))
FEWEST = 4  # separations
FAR = 1e3  # Nyquist frequencies, up to which a line is integrated


@dataclass(frozen=True)
class Fitted:
    """C^2 of a structure function, or None and the reason, and its range of separations in m."""

    constant: float | None
    limits: tuple[float, float] | None
    reason: str = ""


def lags_of(samples: int) -> NDArray[np.int64]:
    """Returns lags in steps, denser towards the shortest: 1 to a quarter of a batch."""
    return np.unique(np.geomspace(1, max(samples // 4, 1), LAGS).astype(np.int64))


def differences(signal: Array, lags: Sequence[int] | NDArray[np.int64]) -> Array:
    """Returns the mean squared differences (lag,) of a signal, over pairs that are both there."""
    rows = [_mean_square(signal[lag:] - signal[:-lag]) for lag in lags]
    return np.array(rows)


def _mean_square(steps: Array) -> float:
    """Returns the mean square of what is finite, NaN if nothing is."""
    good = steps[np.isfinite(steps)]
    return float(good @ good / len(good)) if len(good) else math.nan


def noise_variance(spectrum: Binned, found: Inertial, nyquist: float) -> tuple[float, float]:
    """Returns the noise's variance, and the spatial frequency up to which it reaches.

    Within the fit it is the floor's; beyond, what was measured there less the line. What the line
    has beyond Nyquist's frequency, `nyquist`, and did not fold down is taken off: a floor may be
    nothing but that, and a filter before the sampling loses it. So the variance is negative where
    the record lacks more of the line than it has of noise.
    """
    fixed = found.fixed
    high = found.fitted[1]
    beyond = spectrum.frequency > high
    xi, measured = spectrum.frequency[beyond], spectrum.density[beyond]
    width = spectrum.count[beyond] / max(float(spectrum.count[beyond].sum()), 1.0)
    signal = fixed.density(xi) - fixed.floor
    excess = float(np.sum((measured - signal) * width)) * max(nyquist - high, 0.0)
    variance = fixed.floor * high + excess
    reach = min(variance / fixed.floor, nyquist) if fixed.floor > 0 < variance else nyquist
    return variance - (1 - fixed.fold) * _beyond(fixed, nyquist), reach


def _beyond(fit: Fit, nyquist: float) -> float:
    """Returns the variance that a fitted line has beyond a spatial frequency."""
    xi = nyquist * np.geomspace(1, FAR, 400)
    rest = 1.5 * float(fit.line(xi[-1:])[0] * xi[-1])
    return float(np.trapezoid(fit.line(xi) * xi, np.log(xi))) + (0.0 if fit.roll else rest)


def fit(
    separation: Array, structure: Array, found: Inertial, spectrum: Binned, nyquist: float
) -> Fitted:
    """Returns C^2 and the widest range, in m, in which D(r) is C^2 r^(2/3) of bent air plus noise.

    `structure` (n,) is the structure function at `separation` (n,) in m. The outer scale, the
    sensor's loss and the noise are the spectrum's, since in a structure function one passes for
    the other; but no more is taken off for noise than D itself is where noise is independent, after
    one step or, if the noise ends below Nyquist's frequency, after half its shortest wave.
    """
    if found.structure_constant is None:
        return Fitted(None, None, found.reason)
    noise, reach = noise_variance(spectrum, found, nyquist)
    apart = int(np.argmax(separation >= 0.99 / (2 * reach)))
    shortest = max(1 / found.limits[1], float(separation[apart]))
    noise = min(noise, float(structure[apart]) / 2)
    lost = LOST * ONE_SIDED_CYCLES * found.structure_constant * found.roll_m ** (2 / 3)
    if found.roll_m:
        shortest = max(shortest, found.roll_m / BELOW_ROLL / (2 * math.pi))
    turn = 2 * np.pi * separation * found.bend
    usable = separation >= 0.999 * shortest
    usable &= (turn <= MOST_BENT) | (np.cumsum(usable) <= FEWEST)
    r, bend = separation[usable], BEND * np.minimum(turn[usable], MOST_BENT) ** (4 / 3)
    if len(r) < FEWEST:
        return Fitted(None, None, "no separations lie within the inertial range")
    ratio = (structure[usable] - 2 * noise + 2 * lost) / (r ** (2 / 3) * (1 - bend))
    constant, limits = _straight(r, ratio)
    if not constant > 0:
        return Fitted(None, None, "noise outweighs the structure function in the inertial range")
    return Fitted(constant, limits)


def _straight(r: Array, ratio: Array) -> tuple[float, tuple[float, float]]:
    """Returns the mean of D/r^(2/3) over the widest range in which it is even, and the range."""
    best = float(ratio[:FEWEST].mean()), (float(r[0]), float(r[FEWEST - 1]))
    widest = 0.0
    for first in range(len(r) - FEWEST + 1):
        for last in range(first + FEWEST - 1, len(r)):
            width = math.log(r[last] / r[first])
            part = ratio[first : last + 1]
            constant = float(part.mean())
            if width > widest and constant > 0 and np.max(np.abs(part / constant - 1)) < STRAIGHT:
                widest, best = width, (constant, (float(r[first]), float(r[last])))
    return best
