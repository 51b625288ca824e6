"""The statistics of a record: spectra, structure functions, scales and correlation.

Time becomes distance along the wind by Taylor's hypothesis of frozen air.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import inertial
from thzcl.records.inertial import Binned, Inertial
from thzcl.records.record import SLOWEST_M_S, SPIKES, Record
from thzcl.turbulence.spectra import KOLMOGOROV

Array = NDArray[np.float64]

BATCH_S = 3600.0  # the paper's: an hour
MOST_FILLED = 0.1  # of a batch's samples; a batch with more gaps is left out
SMOOTHED_OVER = 5  # points of a periodogram, as in the paper
LAGS = 60
GUSTY = 0.5  # turbulence intensity above which Taylor's hypothesis is doubtful
VON_KARMAN_VARIANCE = (  # of C^2 L0^(2/3): 2 pi KOLMOGOROV B(3/2, 1/3)
    2 * math.pi * KOLMOGOROV * math.gamma(1.5) * math.gamma(1 / 3) / math.gamma(11 / 6)
)


@dataclass(frozen=True)
class Batch:
    """An hour of a record, or all of a shorter one, without trend.

    `humidity` (n,) in g/m3 and `temperature` (n,) in K are NaN in gaps, which are filled for the
    spectra. `frequency` is spatial, in cycles/m; densities are one-sided, in (g/m3)^2 m and K^2 m.
    """

    wind_speed_m_s: float
    humidity: Array
    temperature: Array | None
    frequency: Array
    density: Array
    temperature_density: Array | None
    filled: int

    @property
    def smoothed(self) -> tuple[Array, Array]:
        """Returns spatial frequency and density, averaged over five neighbouring points."""
        mean = np.ones(SMOOTHED_OVER) / SMOOTHED_OVER
        return self.frequency[SMOOTHED_OVER // 2 : -(SMOOTHED_OVER // 2)], np.convolve(
            self.density, mean, "valid"
        )


@dataclass(frozen=True)
class Analysis:
    """The statistics of a record; units are g/m3, K, m and cycles/m."""

    record: Record
    batches: tuple[Batch, ...]
    spectrum: Binned
    inertial: Inertial
    structure: tuple[Array, Array]  # separations and structure function of humidity
    structure_constant: float
    structure_range_m: tuple[float, float]
    temperature: Inertial | None
    correlation: float | None
    integral_scale_m: float
    outer_scale_m: float
    left_out: int  # batches

    def as_json(self) -> dict[str, Any]:
        """Returns what `thzcl fluctuations --format json` prints."""
        record, constant = self.record, self.inertial.structure_constant
        mean, sigma = float(np.nanmean(record.humidity)), float(np.nanstd(record.humidity))
        return {
            "records": list(record.files),
            "samples": record.samples,
            "rate_hz": record.rate_hz,
            "duration_s": record.samples / record.rate_hz,
            "gaps": record.gaps,
            "spikes": sum(record.spikes.values()),
            "spikes_by_column": record.spikes,
            "spike_thresholds": [
                {"median_of": window, "typical_steps": threshold} for window, threshold in SPIKES
            ],
            "repeats": record.repeats,
            "out_of_order": record.out_of_order,
            "filled_in_spectra": sum(batch.filled for batch in self.batches),
            "batches": len(self.batches),
            "batches_left_out": self.left_out,
            "wind_speed_m_s": record.wind_speed_m_s,
            "wind_run_m": record.wind_speed_m_s * record.samples / record.rate_hz,
            "mean_g_m3": mean,
            "sigma_g_m3": sigma,
            "sigma_percent": 100 * sigma / mean,
            "slope": self.inertial.slope,
            "slope_uncertainty": self.inertial.slope_uncertainty,
            "inertial_range_cycles_per_m": list(self.inertial.limits),
            "structure_constant_q": constant,
            "structure_constant_q_from_structure_function": self.structure_constant,
            "structure_function_range_m": list(self.structure_range_m),
            "agreement_percent": 100 * (self.structure_constant / constant - 1),
            "noise_g2_per_m5": self.inertial.noise,
            "mean_temperature_k": None
            if record.temperature is None
            else float(np.nanmean(record.temperature)),
            "sigma_temperature_k": None
            if record.temperature is None
            else float(np.nanstd(record.temperature)),
            "pressure_hpa": record.pressure_hpa,
            "structure_constant_t": None
            if self.temperature is None
            else self.temperature.structure_constant,
            "correlation_tq": self.correlation,
            "integral_scale_m": self.integral_scale_m,
            "outer_scale_m": self.outer_scale_m,
            "notes": [*record.notes, *self._doubts()],
        }

    def _doubts(self) -> Iterator[str]:
        """Yields what speaks against trusting the figures."""
        intensity = (
            float(np.sqrt(np.nanvar(self.record.wind, axis=1).sum())) / self.record.wind_speed_m_s
        )
        if intensity > GUSTY:
            yield (
                f"the wind's fluctuations are {100 * intensity:.0f} % of its mean: "
                "Taylor's hypothesis is doubtful"
            )
        difference = self.structure_constant / self.inertial.structure_constant - 1
        if abs(difference) > 0.2:
            yield (
                f"the structure function's C_q^2 is {100 * difference:+.0f} % off the spectrum's: "
                "trust neither to less"
            )


def analyse(record: Record) -> Analysis:
    """Returns the statistics of a record.

    Sigma is taken before the trend is removed, structure constants and correlation after it.
    Raises RecordError if gaps leave no batch, or if no inertial range is found.
    """
    place = f"{record.files[0]}: humidity"
    batches, left_out = _batches(record)
    if not batches:
        raise RecordError(
            f"{place}: of {left_out} batches none has fewer than {MOST_FILLED:.0%} of gaps "
            f"and a wind of {SLOWEST_M_S:g} m/s; expected one"
        )
    spectrum = inertial.binned(
        *(np.concatenate([getattr(b, name) for b in batches]) for name in ("frequency", "density"))
    )
    found = inertial.find(spectrum, place)
    separation, structure = _structure(batches, record.rate_hz)
    highest = record.rate_hz / 2 / float(np.mean([batch.wind_speed_m_s for batch in batches]))
    constant, limits = inertial.structure_fit(separation, structure, found, highest)
    variance = float(np.mean([np.nanvar(batch.humidity) for batch in batches]))
    return Analysis(
        record=record,
        batches=batches,
        spectrum=spectrum,
        inertial=found,
        structure=(separation, structure),
        structure_constant=constant,
        structure_range_m=limits,
        temperature=_temperature(batches, found),
        correlation=_correlation(batches),
        integral_scale_m=float(
            np.mean([_integral_scale(batch, record.rate_hz) for batch in batches])
        ),
        outer_scale_m=float((variance / (VON_KARMAN_VARIANCE * found.structure_constant)) ** 1.5),
        left_out=left_out,
    )


def _batches(record: Record) -> tuple[tuple[Batch, ...], int]:
    """Returns batches of one length, and how many were left out for their gaps or want of wind."""
    number = max(1, int(record.samples / record.rate_hz // BATCH_S))
    length = record.samples // number
    found = []
    for start in range(0, number * length, length):
        part = slice(start, start + length)
        wind = (
            np.linalg.norm(np.nanmean(record.wind[:, part], axis=1))
            if np.isfinite(record.wind[:, part]).any()
            else 0.0
        )
        signals = [
            record.humidity[part],
            *([] if record.temperature is None else [record.temperature[part]]),
        ]
        if wind >= SLOWEST_M_S and all(
            np.isnan(signal).mean() <= MOST_FILLED for signal in signals
        ):
            found.append(_batch(signals, float(wind), record.rate_hz))
    return tuple(found), number - len(found)


def _batch(signals: list[Array], wind: float, rate_hz: float) -> Batch:
    """Returns the batch of humidity and, if it is among the signals, temperature."""
    plain = [_detrended(signal) for signal in signals]
    spectra = [_periodogram(filled(signal), rate_hz) for signal in plain]
    frequency_hz, density = spectra[0]
    return Batch(
        wind_speed_m_s=wind,
        humidity=plain[0],
        temperature=plain[1] if len(plain) > 1 else None,
        frequency=frequency_hz / wind,
        density=density * wind,
        temperature_density=spectra[1][1] * wind if len(plain) > 1 else None,
        filled=int(np.isnan(plain[0]).sum()),
    )


def _detrended(signal: Array) -> Array:
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
    at = np.arange(len(signal))
    return np.interp(at, at[there], signal[there])


def _periodogram(signal: Array, rate_hz: float) -> tuple[Array, Array]:
    """Returns frequencies in Hz and one-sided density per Hz of a signal under a Hann window.

    Frequency zero and Nyquist's are left out.
    """
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(len(signal)) / len(signal))
    spectrum = np.fft.rfft(window * (signal - signal.mean()))[1 : (len(signal) + 1) // 2]
    frequency_hz = np.arange(1, len(spectrum) + 1) * rate_hz / len(signal)
    return frequency_hz, 2 * np.abs(spectrum) ** 2 / (rate_hz * np.sum(window**2))


def _structure(batches: tuple[Batch, ...], rate_hz: float) -> tuple[Array, Array]:
    """Returns separations in m, and the mean squared differences of samples so far apart.

    The mean is over all batches' pairs of samples of which neither is missing.
    """
    lags = np.unique(np.geomspace(1, len(batches[0].humidity) // 4, LAGS).astype(int))
    rows = np.empty((len(batches), len(lags)))
    for batch, row in zip(batches, rows, strict=True):
        for at, lag in enumerate(lags):
            row[at] = np.nanmean((batch.humidity[lag:] - batch.humidity[:-lag]) ** 2)
    # Batches of other wind have their lags at other separations: D / r^(2/3) varies least between
    # them.
    winds = np.array([batch.wind_speed_m_s for batch in batches])
    separation = winds.mean() * lags / rate_hz
    scaled = rows / (winds[:, None] * lags / rate_hz) ** (2 / 3)
    return separation, scaled.mean(axis=0) * separation ** (2 / 3)


def _temperature(batches: tuple[Batch, ...], humidity: Inertial) -> Inertial | None:
    """Returns the fit to temperature's spectrum, with humidity's range and outer scale."""
    densities = [
        batch.temperature_density for batch in batches if batch.temperature_density is not None
    ]
    if not densities:
        return None
    spectrum = inertial.binned(
        np.concatenate([batch.frequency for batch in batches]), np.concatenate(densities)
    )
    return inertial.within(spectrum, humidity.limits, humidity.bend)


def _correlation(batches: tuple[Batch, ...]) -> float | None:
    """Returns the correlation of temperature and humidity over all samples that have both."""
    q = np.concatenate([batch.humidity for batch in batches])
    if batches[0].temperature is None:
        return None
    t = np.concatenate([batch.temperature for batch in batches if batch.temperature is not None])
    both = np.isfinite(q) & np.isfinite(t)
    return float(np.corrcoef(q[both], t[both])[0, 1])


def _integral_scale(batch: Batch, rate_hz: float) -> float:
    """Returns the integral of the autocorrelation up to its first zero, in m."""
    signal = filled(batch.humidity)
    size = 2 ** math.ceil(math.log2(2 * len(signal)))
    covariance = np.fft.irfft(np.abs(np.fft.rfft(signal, size)) ** 2)[: len(signal)]
    zero = int(np.argmax(covariance < 0)) or len(signal)
    return float(np.sum(covariance[:zero]) / covariance[0] - 0.5) * batch.wind_speed_m_s / rate_hz
