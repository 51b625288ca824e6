"""Power and cross-spectra of a record by five sine tapers, averaged in bins of frequency.

Sine tapers (Riedel and Sidorenko 1995, IEEE Trans. Signal Process. 43, 188): together they weigh a
record nearly evenly, so that turbulence at its ends counts as much as in its middle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TAPERS = 5
# Five tapers are not five records: means over many neighbouring frequencies scatter as those of a
# periodogram whose values are independent, times this: N sum w^2 = 1 + 1 / (2 TAPERS) for the
# tapers' joint weight w.
CORRELATION = 1 + 1 / (2 * TAPERS)
BINS_PER_DECADE = 16
FEWEST_IN_BIN = 4  # frequencies


@dataclass(frozen=True)
class Binned:
    """A spectrum averaged in bins of the logarithm of spatial frequency; all arrays are (bin,).

    `density` is one-sided, in squared units of the signal times m; `power` is the mean of
    xi^(-5/3) in the bin, `frequency` (in cycles/m) that at which xi^(-5/3) has this mean, and
    `count` the number of frequencies.
    """

    frequency: Array
    power: Array
    density: Array
    count: Array
    nyquist: float = np.inf  # cycles/m, beyond which the signal is folded

    def part(self, low: float, high: float) -> Binned:
        """Returns the bins between two spatial frequencies."""
        return self.where((self.frequency >= low) & (self.frequency <= high))

    def where(self, chosen: NDArray[np.bool_] | slice) -> Binned:
        """Returns some of the bins."""
        return Binned(
            self.frequency[chosen],
            self.power[chosen],
            self.density[chosen],
            self.count[chosen],
            self.nyquist,
        )


def transforms(signal: Array) -> Complex:
    """Returns the tapered transforms (taper, frequency) of a signal (n,) without gaps.

    Their frequencies are 1, 2, ... over the signal's length, below Nyquist's. A sine taper is two
    exponentials: all tapers come of one transform of twice the length. Up to 1 % of the samples at
    the end are left out, so that the length has small factors.
    """
    from scipy import fft

    n = len(signal)
    while fft.next_fast_len(n + 1) != n + 1:
        n -= 1
    padded = np.zeros(2 * (n + 1))
    padded[1 : n + 1] = signal[:n] - signal[:n].mean()
    whole = fft.rfft(padded)
    at = 2 * np.arange(1, (n + 1) // 2 - TAPERS // 2)
    rows = []
    for k in range(1, TAPERS + 1):
        below = whole[np.abs(at - k)]
        below[at < k] = np.conj(below[at < k])  # negative frequencies
        rows.append(np.sqrt(2 / (n + 1)) / 2 * (below - whole[at + k]))
    return np.stack(rows)


def frequencies(number: int, samples: int, rate_hz: float) -> Array:
    """Returns the frequencies in Hz of `number` transformed values of a signal of `samples`."""
    from scipy import fft

    while fft.next_fast_len(samples + 1) != samples + 1:
        samples -= 1
    return np.arange(1, number + 1) * rate_hz / (samples + 1)


def density(values: Complex, rate_hz: float) -> Array:
    """Returns the one-sided density per Hz of tapered transforms, the mean of all tapers."""
    return np.asarray(2 / rate_hz * np.mean(np.abs(values) ** 2, axis=0))


def cross_density(one: Complex, other: Complex, rate_hz: float) -> Complex:
    """Returns the one-sided cross-density per Hz, conj(one) other; its phase is other's lead."""
    return np.asarray(2 / rate_hz * np.mean(np.conj(one) * other, axis=0))


def edges_of(frequency: Array) -> NDArray[np.int64]:
    """Returns where bins of ascending frequencies begin: sixteen a decade, four values at least."""
    decade = np.floor(np.log10(frequency / frequency[0]) * BINS_PER_DECADE)
    starts = [0]
    for end in (np.flatnonzero(np.diff(decade)) + 1).tolist():
        if end - starts[-1] >= FEWEST_IN_BIN and len(frequency) - end >= FEWEST_IN_BIN:
            starts.append(end)
    return np.array(starts)


def binned(frequency: Array, values: Array) -> Binned:
    """Averages the densities (n,) at spatial frequencies (n,), in any order, in bins."""
    order = np.argsort(frequency, kind="stable")
    frequency, values = frequency[order], values[order]
    starts = edges_of(frequency)
    count = np.diff([*starts, len(frequency)]).astype(np.float64)
    power = np.add.reduceat(frequency ** (-5 / 3), starts) / count
    return Binned(power ** (-3 / 5), power, np.add.reduceat(values, starts) / count, count)


def scaled(bins: Binned, by: float) -> Binned:
    """Returns bins with densities multiplied by a factor."""
    return replace(bins, density=bins.density * by)
