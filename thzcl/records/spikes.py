"""Spikes: one or two samples that stand out from the steps of their own minute."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SCALE_S = 60.0  # over which the typical step is taken
FEWEST = 256  # samples, however slow the record
# A spike of one or two samples departs by so many typical steps from the median of its nine
# neighbours: measured gusts of vapour stay below both.
SPIKES = ((1, 12.0), (2, 20.0))
# Of a spike's height: more in the samples beside it, and it is a peak of air.
SHOULDER = 0.25
NORMAL = 1.6449 * np.sqrt(2)  # the nine-tenths quantile of the steps of white noise of sigma 1


def remove(values: Array, rate_hz: float) -> int:
    """Sets spikes in values (n,) to NaN, in place, and returns how many there were.

    Typical is the larger of the median and the nine-tenths quantile of a minute's steps, each over
    that of white noise, and of the two minutes beside it: so neither an instrument slower than its
    logger, half of whose steps are none, nor air that wakes up has spikes.
    """
    present = np.flatnonzero(np.isfinite(values))
    if len(present) < 16:
        return 0
    found = values[present]
    typical = _typical(found, max(FEWEST, int(SCALE_S * rate_hz)))
    height = np.abs(found - _running_median(found, 9))
    spiky = np.zeros(len(found), dtype=np.bool_)
    padded = np.pad(height, 2, mode="edge")
    before, after = padded[1:-3], padded[3:-1]
    low = SHOULDER * height
    spiky |= (height > SPIKES[0][1] * typical) & (before < low) & (after < low)
    two = np.flatnonzero(
        (height > SPIKES[1][1] * typical)
        & (after > SPIKES[1][1] * typical)
        & (before < low)
        & (padded[4:] < low)
    )
    spiky[two] = True
    spiky[np.minimum(two + 1, len(spiky) - 1)] = True
    values[present[spiky]] = np.nan
    return int(spiky.sum())


def _typical(found: Array, length: int) -> Array:
    """Returns the typical step (n,) around each sample."""
    steps = np.abs(np.diff(found))
    edges = np.unique(np.append(np.arange(0, len(steps), length), len(steps)))
    if len(edges) > 2 and edges[-1] - edges[-2] < length // 2:
        edges = np.delete(edges, -2)
    scales = np.array([_scale(part) for part in np.split(steps, edges[1:-1])])
    padded = np.pad(scales, 1, mode="edge")
    wide = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    return np.repeat(wide, np.diff([*edges[:-1], len(found)]))


def _scale(steps: Array) -> float:
    """Returns the typical step of a minute; where most steps are none, their root mean square."""
    typical = max(np.median(steps) / 0.6745 / np.sqrt(2), np.quantile(steps, 0.9) / NORMAL)
    return float(typical or np.sqrt(np.mean(steps**2) / 2) or np.inf)


def _running_median(values: Array, window: int) -> Array:
    """Returns the median of each sample's `window` neighbours, itself included."""
    from scipy import ndimage

    return np.asarray(ndimage.median_filter(values, window, mode="reflect"))
