"""Batches of a record, an hour each, and their blocks: what all statistics are made of."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import spectrum, structure
from thzcl.records.joining import SHORTEST
from thzcl.records.record import SLOWEST_M_S, Record
from thzcl.records.spectrum import Binned

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

BATCH_MINUTES = 60.0  # the paper's: an hour
MOST_FILLED = 0.1  # of a batch's samples; a batch with more gaps is left out
SMOOTHED_OVER = 5  # points of a spectrum, as in the paper
BLOCKS = 12  # of a batch, for uncertainties and thirds


@dataclass(frozen=True)
class Batch:
    """An hour of a record, or all of a shorter one, without trend.

    `humidity` (n,) in g/m3 and `temperature` (n,) in K are NaN in gaps, which are filled for the
    spectra. `frequency` is spatial, in cycles/m; densities are one-sided, in (g/m3)^2 m, K^2 m and
    K g/m3 m (`cross`, complex; its phase is humidity's lead). `part` are its samples in the record.
    """

    part: slice
    wind_speed_m_s: float
    sweeping_speed_m_s: float
    humidity: Array
    temperature: Array | None
    frequency: Array
    density: Array
    temperature_density: Array | None
    cross: Complex | None
    filled: int
    rate_hz: float
    sweeps: Array  # of each block, in m/s

    @property
    def smoothed(self) -> tuple[Array, Array]:
        """Returns spatial frequency and density, averaged over five neighbouring points."""
        mean = np.ones(SMOOTHED_OVER) / SMOOTHED_OVER
        return self.frequency[SMOOTHED_OVER // 2 : -(SMOOTHED_OVER // 2)], np.convolve(
            self.density, mean, "valid"
        )

    def blocks(self) -> Iterator[tuple[slice, float]]:
        """Yields the samples of each block, within the batch, and its sweeping speed in m/s."""
        edges = np.linspace(0, len(self.humidity), BLOCKS + 1).astype(int)
        for start, stop, sweep in zip(edges, edges[1:], self.sweeps, strict=False):
            yield slice(int(start), int(stop)), float(sweep)


@dataclass(frozen=True)
class Spectra:
    """Spectra of humidity, temperature and both, in the same bins; None where there is none."""

    humidity: Binned
    temperature: Binned | None
    cross: Complex | None


def sweeping_speed(wind: Array) -> float:
    """Returns <|u|^(2/3)>^(3/2) in m/s of wind (component, n).

    It is the speed at which gusty wind carries a frozen field past the sensor, as far as inertial
    ranges go: S(f) = A C^2 <|u|^(2/3)> f^(-5/3) (Wyngaard and Clifford 1977, J. Atmos. Sci. 34,
    922: the field is frozen, and the wind varies slowly against the inertial range).
    """
    size = np.sqrt((wind**2).sum(axis=0))
    return float(np.nanmean(size ** (2 / 3)) ** 1.5)


def cut(record: Record, minutes: float | None) -> list[slice]:
    """Returns the samples of each batch; a shorter remainder is joined to the last.

    Batches begin by the clock where stamps have dates: those of an hour at full hours. Raises
    RecordError if a batch holds too few samples for a spectrum.
    """
    length = (minutes or BATCH_MINUTES) * 60 * record.rate_hz
    if length < SHORTEST:
        raise RecordError(
            f"--batch-minutes {minutes:g}: {int(length)} samples at {record.rate_hz:g} Hz; "
            f"the spectrum needs at least {SHORTEST}"
        )
    first = 0.0
    if record.dated:
        seconds = length / record.rate_hz
        first = (-record.start % seconds) * record.rate_hz
    edges = np.arange(first, record.samples, length)
    inner = [round(edge) for edge in edges if 0 < round(edge) < record.samples]
    if inner and inner[0] < length / 2:
        inner = inner[1:]
    while inner and record.samples - inner[-1] < length * (1 if not record.dated else 0.5):
        inner.pop()
    ends = [0, *inner, record.samples]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def batches_of(record: Record, minutes: float | None) -> tuple[tuple[Batch, ...], int]:
    """Returns the batches of a record, and how many were left out for gaps or want of wind."""
    found, left_out = [], 0
    for part in cut(record, minutes):
        wind = record.wind[:, part]
        speed = 0.0
        if np.isfinite(wind).all(axis=0).any():
            speed = float(np.linalg.norm(np.nanmean(wind, axis=1)))
        signals = [record.humidity[part]]
        if record.temperature is not None:
            signals.append(record.temperature[part])
        gaps = max(float(np.isnan(signal).mean()) for signal in signals)
        if speed >= SLOWEST_M_S and gaps <= MOST_FILLED:
            found.append(_batch(signals, wind, speed, part, record.rate_hz))
        else:
            left_out += 1
    return tuple(found), left_out


def _batch(signals: list[Array], wind: Array, speed: float, part: slice, rate_hz: float) -> Batch:
    """Returns the batch of humidity and, if it is among the signals, temperature."""
    plain = [detrended(signal) for signal in signals]
    values = [spectrum.transforms(filled(signal)) for signal in plain]
    sweep = sweeping_speed(wind)
    edges = np.linspace(0, len(plain[0]), BLOCKS + 1).astype(int)
    parts = [wind[:, a:b] for a, b in itertools.pairwise(edges)]
    sweeps = [sweeping_speed(w) if np.isfinite(w).all(axis=0).any() else sweep for w in parts]
    both = len(plain) > 1
    frequency_hz = spectrum.frequencies(values[0].shape[1], len(plain[0]), rate_hz)
    return Batch(
        part=part,
        wind_speed_m_s=speed,
        sweeping_speed_m_s=sweep,
        humidity=plain[0],
        temperature=plain[1] if both else None,
        frequency=frequency_hz / sweep,
        density=spectrum.density(values[0], rate_hz) * sweep,
        temperature_density=spectrum.density(values[1], rate_hz) * sweep if both else None,
        cross=spectrum.cross_density(values[1], values[0], rate_hz) * sweep if both else None,
        filled=int(np.isnan(plain[0]).sum()),
        rate_hz=rate_hz,
        sweeps=np.array(sweeps),
    )


def detrended(signal: Array) -> Array:
    """Returns a signal less the line of least squares through the samples that are there."""
    time = np.linspace(-1, 1, len(signal))
    there = np.isfinite(signal)
    time, level = time - time[there].mean(), signal[there].mean()
    slope = np.sum(time[there] * (signal[there] - level)) / np.sum(time[there] ** 2)
    return np.asarray(signal - level - slope * time)


def filled(signal: Array) -> Array:
    """Returns a signal with straight lines across its gaps.

    Only spectra and autocorrelations take it, since they need all samples.
    """
    there = np.isfinite(signal)
    if there.all():
        return signal
    if not there.any():
        return np.zeros_like(signal)
    at = np.arange(len(signal))
    return np.interp(at, at[there], signal[there])


def pooled(batches: Sequence[Batch]) -> Spectra:
    """Returns the spectra of all batches together, averaged in bins of spatial frequency."""
    frequency = np.concatenate([b.frequency for b in batches])
    order = np.argsort(frequency, kind="stable")
    humidity = spectrum.binned(frequency, np.concatenate([b.density for b in batches]))
    if batches[0].temperature_density is None:
        return Spectra(humidity, None, None)
    own = [b.temperature_density for b in batches if b.temperature_density is not None]
    cross = np.concatenate([b.cross for b in batches if b.cross is not None])[order]
    starts = spectrum.edges_of(frequency[order])
    return Spectra(
        humidity,
        spectrum.binned(frequency, np.concatenate(own)),
        np.asarray(np.add.reduceat(cross, starts) / humidity.count),
    )


def block_spectra(batch: Batch) -> Iterator[Spectra]:
    """Yields the spectra of each block of a batch."""
    for part, sweep in batch.blocks():
        signals = [batch.humidity[part]]
        if batch.temperature is not None:
            signals.append(batch.temperature[part])
        if min(np.isfinite(s).mean() for s in signals) < 1 - 2 * MOST_FILLED:
            continue
        whole = [filled(signal) for signal in signals]
        values = [spectrum.transforms(w - np.mean(w)) for w in whole]
        hz = spectrum.frequencies(values[0].shape[1], len(whole[0]), batch.rate_hz)
        small = [
            spectrum.binned(hz / sweep, spectrum.density(v, batch.rate_hz) * sweep) for v in values
        ]
        cross: Complex | None = None
        if len(values) > 1:
            both = spectrum.cross_density(values[1], values[0], batch.rate_hz) * sweep
            starts = spectrum.edges_of(hz / sweep)
            cross = np.asarray(np.add.reduceat(both, starts) / small[0].count)
        yield Spectra(small[0], small[1] if len(small) > 1 else None, cross)


def structure_functions(batches: Sequence[Batch]) -> tuple[Array, Array]:
    """Returns separations in m, and the structure function of humidity over all batches.

    Batches of other wind have their lags at other separations: D / r^(2/3) varies least between
    them.
    """
    lags = structure.lags_of(min(len(b.humidity) for b in batches))
    speeds = np.array([b.sweeping_speed_m_s for b in batches])
    rows = np.stack([structure.differences(b.humidity, lags) for b in batches])
    separation = speeds.mean() * lags / batches[0].rate_hz
    scaled = rows / (speeds[:, None] * lags / batches[0].rate_hz) ** (2 / 3)
    return separation, np.nanmean(scaled, axis=0) * separation ** (2 / 3)


def unevenness(batches: Sequence[Batch]) -> float:
    """Returns by how much more densities scatter where turbulence comes and goes, at least 1.

    It is <e^2> / <e>^2 of the blocks' mean squared steps e: a record of which one quarter is lively
    holds a quarter of the independent values.
    """
    found = []
    for batch in batches:
        steps = [structure.differences(batch.humidity[p], [1])[0] for p, _ in batch.blocks()]
        energy = np.array(steps)[np.isfinite(steps)]
        if len(energy) and energy.mean() > 0:
            found.append(float(np.mean(energy**2) / energy.mean() ** 2))
    return float(np.mean(found)) if found else 1.0
