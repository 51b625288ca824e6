"""Two hygrometers apart: covariance and structure function against their separation.

Beside them stands what Taylor's hypothesis makes of the first sensor alone, along the wind.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import inertial, spectrum, structure
from thzcl.records.analysis import Analysis
from thzcl.records.batches import BLOCKS, MOST_FILLED, detrended, filled
from thzcl.records.joining import SHORTEST
from thzcl.records.record import Record

Array = NDArray[np.float64]

MOST_LAG = 1.5  # separations, over which the wind's delay between two sensors is looked for
ALONG, ACROSS = math.cos(math.radians(30)), math.sin(math.radians(30))  # of the separation
MUCH_LOST = 0.2  # of a structure function: what both records lack of small eddies
SURE = 4.0  # standard deviations of a correlation of chance, above which a delay is told


@dataclass(frozen=True)
class Other:
    """Another hygrometer: its name, its separation in m, and its humidity.

    `humidity` (n,) in g/m3 is at `start` + i / `rate_hz`, in the seconds of the first sensor's
    clock, NaN in gaps.
    """

    name: str
    separation_m: float
    humidity: Array
    start: float
    rate_hz: float


def of_record(first: Record, second: Record, separation_m: float) -> Other:
    """Returns another sensor's record of its own file. Raises RecordError if clocks do not meet."""
    name = second.files[0]
    if first.dated != second.dated:
        bare = name if first.dated else first.files[0]
        raise RecordError(
            f"{bare}: its stamps have no dates, those of the other sensor have: the clocks cannot "
            "be aligned; expected dates in both, or in none"
        )
    ends = [r.start + r.samples / r.rate_hz for r in (first, second)]
    shared = min(ends) - max(first.start, second.start)
    fewest = SHORTEST / min(first.rate_hz, second.rate_hz)
    if shared < fewest:
        away = second.start - first.start
        raise RecordError(
            f"{name}: begins {away:+.6g} s from {first.files[0]} and shares {max(shared, 0.0):.4g} "
            f"s with it; expected {fewest:.4g} s and more: are both clocks of one time zone?"
        )
    return Other(name, separation_m, second.humidity, second.start, second.rate_hz)


def of_column(record: Record, separation_m: float) -> Other:
    """Returns the other sensor of a record's own file, its role h2o_2."""
    assert record.second is not None  # noqa: S101 (as the caller has it)
    names = [c["column"] for c in record.columns if c["role"] == "h2o_2"]
    return Other(names[0], separation_m, record.second, record.start, record.rate_hz)


def as_json(analysis: Analysis, others: Sequence[Other]) -> dict[str, Any]:
    """Returns the pairs by separation, Taylor's curve, and notes."""
    pairs: list[dict[str, Any]] = []
    notes: list[str] = []
    for other in sorted(others, key=lambda one: one.separation_m):
        pair = _pair(analysis, other)
        pairs.append(pair)
        notes += _doubts(analysis, pair)
    return {"pairs": pairs, "taylor": taylor(analysis), "notes": notes}


def taylor(analysis: Analysis) -> dict[str, list[float]]:
    """Returns structure function and covariance of the first sensor alone, along the wind.

    Noise is taken off: D(r) - 2 n and sigma^2 - n - (D(r) - 2 n) / 2, in (g/m3)^2.
    """
    separation, by_lag = analysis.by_separation
    noise = _noise_of_first(analysis)
    own = by_lag - 2 * noise
    variance = _variance(analysis) - noise
    return {
        "separation_m": separation.tolist(),
        "structure_function_g2_m6": own.tolist(),
        "covariance_g2_m6": (variance - own / 2).tolist(),
    }


def _variance(analysis: Analysis) -> float:
    """Returns the first sensor's variance about the means of its batches, in (g/m3)^2."""
    own = [float(np.nanvar(analysis.record.humidity[b.part])) for b in analysis.batches]
    return float(np.mean(own))


def _nyquist(analysis: Analysis, rate_hz: float) -> float:
    """Returns half a rate in cycles/m."""
    return rate_hz / 2 / analysis.sweeping_speed_m_s


def _noise_of_first(analysis: Analysis) -> float:
    """Returns the variance of the first sensor's noise in (g/m3)^2, 0 where it is not known.

    It is at most half the structure function after one step, and negative where the record lacks
    what the line has beyond Nyquist's frequency (structure.noise_variance).
    """
    found, nyquist = analysis.inertial, _nyquist(analysis, analysis.record.rate_hz)
    if found.structure_constant is None:
        return 0.0
    noise, _ = structure.noise_variance(analysis.spectrum, found, nyquist)
    return min(noise, float(analysis.by_separation[1][0]) / 2)


def _noise_of(analysis: Analysis, other: Other) -> float:
    """Returns the variance of another sensor's noise in (g/m3)^2, by its own spectrum."""
    if np.isnan(other.humidity).mean() > MOST_FILLED:
        return 0.0
    speed, nyquist = analysis.sweeping_speed_m_s, _nyquist(analysis, other.rate_hz)
    signal = filled(detrended(other.humidity))
    values = spectrum.transforms(signal)
    hz = spectrum.frequencies(values.shape[1], len(signal), other.rate_hz)
    own = spectrum.binned(hz / speed, spectrum.density(values, other.rate_hz) * speed)
    found = inertial.find(own, nyquist)
    if found is None or found.structure_constant is None:
        return 0.0
    noise, _ = structure.noise_variance(own, found, nyquist)
    return min(noise, float(structure.differences(other.humidity, [1])[0]) / 2)


def aligned(analysis: Analysis, other: Other) -> Array:
    """Returns another sensor's humidity (n,) at the first one's samples, NaN where it has none.

    Each sample goes to the first sensor's nearest one by its stamp; of several the nearest counts.
    """
    record = analysis.record
    time = (other.start - record.start) + np.arange(len(other.humidity)) / other.rate_hz
    at = time * record.rate_hz
    nearest = np.rint(at).astype(np.int64)
    inside = (nearest >= 0) & (nearest < record.samples) & np.isfinite(other.humidity)
    order = np.argsort(-np.abs(at - nearest)[inside], kind="stable")  # the nearest is written last
    even = np.full(record.samples, np.nan)
    even[nearest[inside][order]] = other.humidity[inside][order]
    return even


def _pair(analysis: Analysis, other: Other) -> dict[str, Any]:
    """Returns what two sensors tell together; covariances are about the means of batches."""
    second = aligned(analysis, other)
    steps, products, samples = [], [], 0
    squares = np.zeros(2)
    for batch in analysis.batches:
        both = np.stack([analysis.record.humidity[batch.part], second[batch.part]])
        there = np.isfinite(both).all(axis=0)
        if there.sum() < BLOCKS:
            continue
        both = both - both[:, there].mean(axis=1, keepdims=True)
        samples += int(there.sum())
        squares += (both[:, there] ** 2).sum(axis=1)
        products.append(both[0] * both[1])
        steps.append((both[0] - both[1]) ** 2)
    if samples < SHORTEST:
        raise RecordError(
            f"{other.name}: {samples} of its samples stand beside those of "
            f"{analysis.record.files[0]}; expected {SHORTEST}"
        )
    noises = np.array([_noise_of_first(analysis), _noise_of(analysis, other)])
    covariance, own_error = _mean(products)
    difference, error = _mean(steps)
    difference -= float(noises.sum())
    power = np.prod(squares / samples - noises)
    along, lag = _delay(analysis, second, other.separation_m)
    along_wind = _at(taylor(analysis), other.separation_m)
    constant, bent = None, _bent(analysis, other.separation_m)
    if bent is not None and difference > 0:
        constant = difference / bent
    uncertainty = {"covariance_g2_m6": own_error, "structure_function_g2_m6": error}
    if constant is not None and bent is not None:
        uncertainty["structure_constant_q"] = error / bent
    return {
        "second": other.name,
        "separation_m": other.separation_m,
        "samples": samples,
        "direction": _direction(along, other.separation_m),
        "lag_s": lag,
        "along_wind_m": along,
        "covariance_g2_m6": covariance,
        "correlation": covariance / math.sqrt(power) if power > 0 else None,
        "structure_function_g2_m6": difference,
        "noise_g2_m6": float(noises.sum()),
        "structure_constant_q": constant,
        "taylor_covariance_g2_m6": along_wind[0],
        "taylor_structure_function_g2_m6": along_wind[1],
        "uncertainty": {k: v for k, v in uncertainty.items() if math.isfinite(v)},
    }


def _mean(rows: Sequence[Array]) -> tuple[float, float]:
    """Returns the mean of what is finite, and its standard deviation by the scatter of blocks."""
    whole = np.concatenate(rows)
    blocks = [np.nanmean(b) for row in rows for b in np.array_split(row, BLOCKS) if _any(b)]
    scatter = float(np.std(blocks, ddof=1)) / math.sqrt(len(blocks))
    return float(np.nanmean(whole)), scatter


def _any(values: Array) -> bool:
    """Returns whether any value is finite."""
    return bool(np.isfinite(values).any())


def _at(curve: dict[str, list[float]], separation_m: float) -> tuple[float | None, float | None]:
    """Returns Taylor's covariance and structure function at a separation, None beyond the curve."""
    r = curve["separation_m"]
    if not r[0] <= separation_m <= r[-1]:
        return None, None
    covariance, difference = (
        float(np.interp(math.log(separation_m), np.log(r), curve[key]))
        for key in ("covariance_g2_m6", "structure_function_g2_m6")
    )
    return covariance, difference


def _bent(analysis: Analysis, separation_m: float) -> float | None:
    """Returns D(r) of air with C^2 = 1 and the spectrum's bend, or None beyond its series."""
    turn = 2 * math.pi * separation_m * analysis.inertial.bend
    if analysis.inertial.structure_constant is None or turn > structure.MOST_BENT:
        return None
    return float(separation_m ** (2 / 3) * (1 - structure.BEND * turn ** (4 / 3)))


def _delay(
    analysis: Analysis, second: Array, separation_m: float
) -> tuple[float | None, float | None]:
    """Returns how far along the wind the second sensor stands, in m, and its delay in s.

    It is the lag of the largest covariance, times the wind: positive if the air comes to the first
    sensor first. None where no lag has a covariance beyond chance.
    """
    from scipy import fft

    speed, rate = analysis.record.wind_speed_m_s, analysis.record.rate_hz
    both = np.stack([analysis.record.humidity, second])
    there = np.isfinite(both)
    centred = np.stack([x - x[t].mean() for x, t in zip(both, there, strict=True)])
    size = fft.next_fast_len(2 * both.shape[1])
    signals = fft.rfft(np.where(there, centred, 0.0), size, axis=1)
    marks = fft.rfft(there.astype(np.float64), size, axis=1)
    total = fft.irfft(np.conj(signals[0]) * signals[1], size)
    count = fft.irfft(np.conj(marks[0]) * marks[1], size)
    most = min(math.ceil(MOST_LAG * separation_m / speed * rate) + 1, both.shape[1] // 4)
    lags = np.arange(-most, most + 1)
    spread = float(np.prod([x[t].std() for x, t in zip(centred, there, strict=True)]))
    share = total[lags] / np.maximum(count[lags], 1.0) / spread
    best = int(np.argmax(share))
    run = both.shape[1] / rate * speed
    chance = math.sqrt(min(2 * analysis.integral_scale_m / run, 1.0))
    if share[best] < SURE * chance:
        return None, None
    lag = float(lags[best] / rate)
    return lag * speed, lag


def _direction(along_m: float | None, separation_m: float) -> str:
    """Returns along, across or oblique to the wind, within 30 degrees; unknown without a delay."""
    if along_m is None:
        return "unknown"
    share = abs(along_m) / separation_m
    return "along" if share > ALONG else "across" if share < ACROSS else "oblique"


def _doubts(analysis: Analysis, pair: dict[str, Any]) -> Iterator[str]:
    """Yields what speaks against trusting a pair."""
    where = f"{Path(pair['second']).name}, {pair['separation_m']:g} m away"
    along, lag = pair["along_wind_m"], pair["lag_s"]
    step = analysis.record.wind_speed_m_s / analysis.record.rate_hz
    if along is None:
        yield f"{where}: no delay between the sensors is sure, nor whether it is along the wind"
    elif abs(along) > 1.2 * pair["separation_m"] + step:
        yield (
            f"{where}: most alike after {lag:.3g} s, in which the wind goes {abs(along):.3g} m, "
            "more than the separation: do the clocks agree?"
        )
    lost = -pair["noise_g2_m6"] / max(pair["structure_function_g2_m6"], 1e-300)
    if lost > MUCH_LOST:
        yield (
            f"{where}: {100 * lost:.0f} % of the structure function is what both records lack "
            "beyond Nyquist's frequency, put back as if the inertial range went on"
        )
    if pair["structure_function_g2_m6"] <= 0:
        yield f"{where}: noise outweighs the difference between the sensors"
