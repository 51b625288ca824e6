"""The statistics of a record: spectra, structure functions, scales and correlation.

Time becomes distance along the wind by Taylor's hypothesis of frozen air.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import cross, inertial, structure, surface
from thzcl.records.batches import (
    MOST_FILLED,
    Batch,
    Spectra,
    batches_of,
    block_spectra,
    filled,
    pooled,
    structure_functions,
    unevenness,
)
from thzcl.records.inertial import Fit, Inertial
from thzcl.records.record import SLOWEST_M_S, Record
from thzcl.records.spectrum import CORRELATION, Binned, binned
from thzcl.records.spikes import SPIKES
from thzcl.records.structure import Fitted
from thzcl.turbulence.spectra import KOLMOGOROV

Array = NDArray[np.float64]

GUSTY = 0.5  # turbulence intensity above which Taylor's hypothesis is doubtful
VON_KARMAN_VARIANCE = (  # of C^2 L0^(2/3): 2 pi KOLMOGOROV B(3/2, 1/3)
    2 * math.pi * KOLMOGOROV * math.gamma(1.5) * math.gamma(1 / 3) / math.gamma(11 / 6)
)
# Thirds differ by more than chance: probability of the blocks' scatter, and ratio, at least; or
# the ratio alone.
BY_CHANCE, UNLIKE, CLEARLY_UNLIKE = 0.01, 2.0, 4.0
STEADY_PARTS = 6  # of a batch: five minutes of half an hour (Foken and Wichura 1996)


@dataclass(frozen=True)
class Analysis:
    """The statistics of a record; units are g/m3, K, m and cycles/m.

    `uncertainty` holds one standard deviation by JSON key; what there is not is None.
    """

    record: Record
    batches: tuple[Batch, ...]
    spectra: Spectra
    inertial: Inertial
    by_separation: tuple[Array, Array]  # separations and structure function of humidity
    fitted: Fitted
    temperature: Fit | None
    together: cross.Together | None
    correlation: float | None
    integral_scale_m: float
    outer_scale_m: float | None
    left_out: int  # batches
    thirds: tuple[float | None, ...]
    steady: bool
    surface: surface.Surface | None
    height_m: float | None
    uncertainty: dict[str, float] = field(default_factory=dict)
    of_batches: tuple[dict[str, Any], ...] = ()

    @property
    def spectrum(self) -> Binned:
        """Returns humidity's spectrum in bins."""
        return self.spectra.humidity

    @property
    def structure_constant_t(self) -> float | None:
        """Returns C_T^2 in K^2 m^-2/3, or None."""
        if self.temperature is None or self.inertial.structure_constant is None:
            return None
        return float(self.temperature.level / inertial.ONE_SIDED_CYCLES)

    @property
    def sweeping_speed_m_s(self) -> float:
        """Returns the mean speed at which gusty wind carries the air past, as batches have it."""
        return float(np.mean([b.sweeping_speed_m_s for b in self.batches]))

    def as_json(self) -> dict[str, Any]:
        """Returns what `thzcl fluctuations --format json` prints."""
        return {
            **_of_record(self.record),
            "batches": len(self.batches),
            "batches_left_out": self.left_out,
            "filled_in_spectra": sum(batch.filled for batch in self.batches),
            "sweeping_speed_m_s": self.sweeping_speed_m_s,
            **self._moments(),
            **self._constants(),
            **self._temperature(),
            "integral_scale_m": self.integral_scale_m,
            "outer_scale_m": self.outer_scale_m,
            **self._surface(),
            "stationarity_percent": _unsteadiness(self.record, self.batches),
            "coherence": cross.coherence(self.spectra),
            "uncertainty": self.uncertainty,
            "batch_statistics": list(self.of_batches),
            "notes": [*self.record.notes, *self._doubts()],
        }

    def _moments(self) -> dict[str, Any]:
        """Returns mean and sigma: over all, and within batches, before detrending."""
        humidity = self.record.humidity
        mean, sigma = float(np.nanmean(humidity)), float(np.nanstd(humidity))
        within = [float(np.nanvar(humidity[batch.part])) for batch in self.batches]
        return {
            "mean_g_m3": mean,
            "sigma_g_m3": sigma,
            "sigma_percent": 100 * sigma / mean,
            "sigma_within_g_m3": math.sqrt(float(np.mean(within))),
        }

    def _constants(self) -> dict[str, Any]:
        """Returns slope, range and structure constants of humidity."""
        found, constant = self.inertial, self.inertial.structure_constant
        by_function = self.fitted.constant
        both = constant is not None and by_function is not None
        return {
            "slope": found.slope,
            "slope_uncertainty": found.slope_uncertainty,
            "inertial_range_cycles_per_m": list(found.limits) if constant is not None else None,
            "structure_constant_q": constant,
            "structure_constant_q_thirds": list(self.thirds),
            "structure_constant_q_from_structure_function": by_function,
            "structure_function_range_m": list(self.fitted.limits or ()) or None,
            "agreement_percent": 100 * (by_function / constant - 1) if both else None,  # type: ignore[operator]
            "noise_g2_per_m5": found.noise,
        }

    def _temperature(self) -> dict[str, Any]:
        """Returns what is of temperature, and of temperature and humidity together."""
        kelvin, both = self.record.temperature, self.together
        return {
            "mean_temperature_k": None if kelvin is None else float(np.nanmean(kelvin)),
            "sigma_temperature_k": None if kelvin is None else float(np.nanstd(kelvin)),
            "pressure_hpa": self.record.pressure_hpa,
            "structure_constant_t": self.structure_constant_t,
            "correlation_tq": self.correlation,
            "correlation_tq_inertial": both.correlation if both else None,
            "c_tq": both.constant if both else None,
        }

    def _surface(self) -> dict[str, Any]:
        """Returns height, friction velocity, Obukhov length and stability."""
        length = None if self.surface is None else self.surface.obukhov_length_m
        over = length is not None and self.height_m is not None
        return {
            "height_m": self.height_m,
            "friction_velocity_m_s": self.surface and self.surface.friction_velocity_m_s,
            "obukhov_length_m": length,
            "z_over_l": self.height_m / length if over else None,  # type: ignore[operator]
        }

    def _doubts(self) -> Iterator[str]:
        """Yields what speaks against trusting the figures."""
        record, found = self.record, self.inertial
        intensity = float(np.sqrt(np.nanvar(record.wind, axis=1).sum())) / record.wind_speed_m_s
        if intensity > GUSTY:
            yield (
                f"the wind's fluctuations are {100 * intensity:.0f} % of its mean: Taylor's "
                "hypothesis is doubtful; constants are taken with the sweeping speed of "
                f"{self.sweeping_speed_m_s:.3g} m/s, and not with {record.wind_speed_m_s:.3g}"
            )
        if found.reason:
            yield f"no inertial range was found, and so no structure constant: {found.reason}"
            yield from _other_columns(record)
        elif found.steepens:
            yield (
                f"the spectrum steepens above {found.steepens:.2g} cycles/m, as of a slow sensor, "
                "a tube, or air without smaller eddies: the inertial range ends there"
            )
        elif found.roll_m:
            delay = found.roll_m / (2 * math.pi * self.sweeping_speed_m_s)
            yield (
                f"the response is slow, as of a tube or a sensor of {delay:.2g} s: "
                "it is in the fit, and the inertial range ends where it costs 20 %"
            )
        if not found.reason and self.fitted.reason:
            yield f"no structure constant of the structure function: {self.fitted.reason}"
        yield from self._unlike()

    def _unlike(self) -> Iterator[str]:
        """Yields notes on what does not agree: two estimates, thirds, scale and height."""
        constant, by_function = self.inertial.structure_constant, self.fitted.constant
        if constant and by_function and abs(by_function / constant - 1) > 0.2:
            yield (
                f"the structure function's C_q^2 is {100 * (by_function / constant - 1):+.0f} % "
                "off the spectrum's: trust neither to less"
            )
        if not self.steady:
            thirds = ", ".join("none" if t is None else f"{t:.3g}" for t in self.thirds)
            yield (
                f"the record is not stationary: C_q^2 of its thirds is {thirds}; "
                "the constant is their mean over time"
            )
        if self.height_m and self.outer_scale_m:
            ratio = self.outer_scale_m / self.height_m
            if not 0.4 <= ratio <= 3:
                yield (
                    f"the outer scale is {ratio:.2g} heights, where 0.4 to 3 are usual: "
                    "large eddies are in it that do not touch the ground"
                )


def _of_record(record: Record) -> dict[str, Any]:
    """Returns what was read, and what was found wrong with it."""
    return {
        "records": list(record.files),
        "columns": list(record.columns),
        "samples": record.samples,
        "rate_hz": record.rate_hz,
        "duration_s": record.samples / record.rate_hz,
        "gaps": record.gaps,
        "masked_by_column": record.masked,
        "spikes": sum(record.spikes.values()),
        "spikes_by_column": record.spikes,
        "spike_thresholds": [
            {"samples": samples, "typical_steps": threshold} for samples, threshold in SPIKES
        ],
        "repeats": record.repeats,
        "out_of_order": record.out_of_order,
        "wind_speed_m_s": record.wind_speed_m_s,
        "wind_run_m": record.wind_speed_m_s * record.samples / record.rate_hz,
    }


def _other_columns(record: Record) -> Iterator[str]:
    """Yields a note on other columns of humidity that might do."""
    if record.others:
        names = " or ".join(record.others)
        yield (
            f"another column may have an inertial range: {names}; "
            f"try --columns h2o={record.others[0]}"
        )


def analyse(
    record: Record, batch_minutes: float | None = None, height_m: float | None = None
) -> Analysis:
    """Returns the statistics of a record in batches of an hour, or of as many minutes.

    Sigma is taken before the trend is removed, structure constants and correlation after it. With
    the sensor's `height_m`, no spatial frequency below 1/height is taken for inertial. Raises
    RecordError if gaps leave no batch.
    """
    batches, left_out = batches_of(record, batch_minutes)
    if not batches:
        raise RecordError(
            f"{record.files[0]}: humidity: of {left_out} batches none has fewer than "
            f"{MOST_FILLED:.0%} of gaps and a wind of {SLOWEST_M_S:g} m/s; expected one"
        )
    scatter, lowest = unevenness(batches), 1 / height_m if height_m else 0.0
    spectra, nyquist = pooled(batches), _nyquist(batches)
    found = _found(spectra.humidity, nyquist, scatter, lowest)
    separation, by_lag = structure_functions(batches)
    fitted = structure.fit(separation, by_lag, found, spectra.humidity, nyquist)
    temperature = None
    if spectra.temperature is not None and found.structure_constant is not None:
        temperature = inertial.like(spectra.temperature, found, scatter)
    both = None
    if temperature is not None and found.structure_constant is not None:
        levels = found.structure_constant, temperature.level / inertial.ONE_SIDED_CYCLES
        both = cross.together(spectra, found, temperature, levels)
    of_blocks = [list(block_spectra(batch)) for batch in batches]
    thirds, steady = _thirds(of_blocks, found)
    scales = [_integral_scale(batch) for batch in batches]
    analysis = Analysis(
        record=record,
        batches=batches,
        spectra=spectra,
        inertial=found,
        by_separation=(separation, by_lag),
        fitted=fitted,
        temperature=temperature,
        together=both,
        correlation=cross.correlation(batches),
        integral_scale_m=float(np.mean(scales)),
        outer_scale_m=_outer_scale(batches, found),
        left_out=left_out,
        thirds=thirds,
        steady=steady,
        surface=_fluxes(record, batches),
        height_m=height_m,
        of_batches=tuple(_of_batches(record, batches, of_blocks, found, lowest)),
    )
    analysis.uncertainty.update(_uncertainties(analysis, of_blocks, scatter))
    return analysis


def _nyquist(batches: Sequence[Batch]) -> float:
    """Returns half the sampling rate in cycles/m."""
    return batches[0].rate_hz / 2 / float(np.mean([b.sweeping_speed_m_s for b in batches]))


def _found(spectrum: Binned, nyquist: float, scatter: float, lowest: float) -> Inertial:
    """Returns the inertial range of a spectrum, without C^2 where there is none."""
    found = inertial.find(spectrum, nyquist, scatter, lowest)
    return found if found is not None else inertial.none(spectrum, nyquist, scatter)


def _outer_scale(batches: Sequence[Batch], found: Inertial) -> float | None:
    """Returns the outer scale in m that gives von Karman air of this C^2 its variance."""
    if found.structure_constant is None:
        return None
    variance = float(np.mean([np.nanvar(batch.humidity) for batch in batches]))
    return float((variance / (VON_KARMAN_VARIANCE * found.structure_constant)) ** 1.5)


def _integral_scale(batch: Batch) -> float:
    """Returns the integral of the autocorrelation up to its first zero, in m along the wind."""
    from scipy import fft

    signal = filled(batch.humidity)
    size = fft.next_fast_len(2 * len(signal))
    covariance = fft.irfft(np.abs(fft.rfft(signal, size)) ** 2, size)[: len(signal)]
    zero = int(np.argmax(covariance < 0)) or len(signal)
    steps = float(np.sum(covariance[:zero]) / covariance[0] - 0.5)
    return steps * batch.wind_speed_m_s / batch.rate_hz


def _fluxes(record: Record, batches: Sequence[Batch]) -> surface.Surface | None:
    """Returns friction velocity and Obukhov length, where all components and Ts are there."""
    if len(record.wind) < 3 or record.sonic is None:
        return None
    return surface.fluxes(
        [record.wind[:, b.part] for b in batches], [record.sonic[b.part] for b in batches]
    )


def _unsteadiness(record: Record, batches: Sequence[Batch]) -> float:
    """Returns the non-stationarity of humidity's variance in per cent (Foken and Wichura 1996).

    It is the difference between the mean variance within sixths of a batch and the batch's, over
    the batch's, equation 1 there; below 30 % is taken for steady. The mean of batches is told.
    """
    found = []
    for batch in batches:
        whole = record.humidity[batch.part]
        parts = [np.nanvar(p) for p in np.array_split(whole, STEADY_PARTS) if np.isfinite(p).any()]
        found.append(abs(float(np.mean(parts)) / float(np.nanvar(whole)) - 1))
    return 100 * float(np.mean(found))


def _levels(blocks: Sequence[Spectra], found: Inertial) -> Array:
    """Returns C^2 of humidity of each block."""
    levels = np.array([inertial.level_of(block.humidity, found) for block in blocks])
    return np.asarray(levels[np.isfinite(levels)])


def _thirds(
    of_blocks: Sequence[Sequence[Spectra]], found: Inertial
) -> tuple[tuple[float | None, ...], bool]:
    """Returns C^2 of the record's thirds, and whether they differ by no more than chance."""
    from scipy import stats

    levels = _levels([block for blocks in of_blocks for block in blocks], found)
    if found.structure_constant is None or len(levels) < 6:
        return (None, None, None), True
    parts = np.array_split(levels, 3)
    means = [float(np.mean(part)) for part in parts]
    if min(means) <= 0:
        return tuple(mean if mean > 0 else None for mean in means), False
    ratio = max(means) / min(means)
    floor = 1e-3 * float(np.mean(levels))
    logs = [np.log(np.maximum(part, floor)) for part in parts]
    chance = float(stats.f_oneway(*logs).pvalue)
    steady = ratio < CLEARLY_UNLIKE and not (chance < BY_CHANCE and ratio > UNLIKE)
    return tuple(means), steady


def _spread(values: Sequence[Sequence[float] | Array]) -> float:
    """Returns the standard deviation of the mean of all values, each batch's about its own mean."""
    own = [np.asarray(v, dtype=np.float64) for v in values]
    own = [v[np.isfinite(v)] for v in own]
    own = [v for v in own if len(v) > 2]
    if not own:
        return math.nan
    total = sum(len(v) for v in own)
    return math.sqrt(sum(len(v) * float(np.var(v, ddof=1)) for v in own)) / total


def _uncertainties(
    analysis: Analysis, of_blocks: Sequence[Sequence[Spectra]], scatter: float
) -> dict[str, float]:
    """Returns one standard deviation by JSON key: by the scatter of blocks, twelve to a batch.

    A constant's grows by what floor, bend and roll-off cost, which are held in the blocks.
    """
    found, told = analysis.inertial, {"slope": analysis.inertial.slope_uncertainty}
    humidity = [analysis.record.humidity[b.part] for b in analysis.batches]
    runs = [len(h) / analysis.record.rate_hz * b.wind_speed_m_s
            for h, b in zip(humidity, analysis.batches, strict=True)]  # fmt: skip
    # Lenschow, Mann and Kristensen (1994): var(mean) = 2 I sigma^2 / run, sd(sigma) = sigma
    # sqrt(I / (2 run)) of a Gaussian signal with an exponential correlation.
    share = analysis.integral_scale_m / sum(runs)
    sigma = math.sqrt(float(np.mean([np.nanvar(h) for h in humidity])))
    told |= {"mean_g_m3": sigma * math.sqrt(2 * share), "sigma_g_m3": sigma * math.sqrt(share / 2)}
    if found.structure_constant is None:
        return told
    growth = _growth(analysis.spectrum, found, scatter)
    told["structure_constant_q"] = growth * _spread([_levels(b, found) for b in of_blocks])
    told |= _of_function(analysis)
    if analysis.temperature is not None:
        told |= _of_temperature(analysis, of_blocks, growth)
    return {key: value for key, value in told.items() if math.isfinite(value)}


def _growth(spectrum: Binned, found: Inertial, scatter: float) -> float:
    """Returns by how much a constant's uncertainty grows by what is fitted with it."""
    part = spectrum.part(*found.fitted)
    share = found.fixed.line(part.frequency) / found.fixed.density(part.frequency)
    alone = math.sqrt(CORRELATION * scatter / float(np.sum(part.count * share**2)))
    return max(1.0, found.level_uncertainty / alone)


def _of_function(analysis: Analysis) -> dict[str, float]:
    """Returns the uncertainty of the structure function's constant, by blocks at its middle lag."""
    if analysis.fitted.constant is None or analysis.fitted.limits is None:
        return {}
    middle = math.sqrt(analysis.fitted.limits[0] * analysis.fitted.limits[1])
    rows = []
    for batch in analysis.batches:
        lag = max(round(middle * batch.rate_hz / batch.sweeping_speed_m_s), 1)
        row = []
        for part, sweep in batch.blocks():
            if part.stop - part.start > lag:
                step = structure.differences(batch.humidity[part], [lag])[0]
                row.append(step / (sweep * lag / batch.rate_hz) ** (2 / 3))
        rows.append(row)
    return {"structure_constant_q_from_structure_function": _spread(rows)}


def _of_temperature(
    analysis: Analysis, of_blocks: Sequence[Sequence[Spectra]], growth: float
) -> dict[str, float]:
    """Returns the uncertainties of what is of temperature, by blocks."""
    found, fit = analysis.inertial, analysis.temperature
    assert fit is not None  # noqa: S101 (as the caller has it)
    warm = inertial.as_inertial(found, fit)
    rows: dict[str, list[list[float]]] = {
        "structure_constant_t": [], "c_tq": [], "correlation_tq_inertial": []
    }  # fmt: skip
    for blocks in of_blocks:
        for row in rows.values():
            row.append([])
        for block in blocks:
            if block.temperature is None:
                continue
            levels = (inertial.level_of(block.humidity, found),
                      inertial.level_of(block.temperature, warm))  # fmt: skip
            both = cross.together(block, found, fit, levels)
            rows["structure_constant_t"][-1].append(levels[1])
            if both is not None:
                rows["c_tq"][-1].append(both.constant)
                rows["correlation_tq_inertial"][-1].append(both.correlation)
    told = {key: _spread(row) for key, row in rows.items()}
    return told | {k: growth * told[k] for k in ("structure_constant_t", "c_tq")}


def _of_batch(batch: Batch, found: Inertial, lowest: float) -> Inertial:
    """Returns what a batch has in the range found for all, or its own if there was none."""
    spectrum, scatter = binned(batch.frequency, batch.density), unevenness([batch])
    if found.structure_constant is None:
        return _found(spectrum, _nyquist([batch]), scatter, lowest)
    slope, uncertainty = inertial.slope_of(spectrum, found, scatter)
    constant = inertial.level_of(spectrum, found)
    sound = constant > 0 and not inertial.departs(slope, uncertainty)
    return replace(
        found,
        slope=slope,
        slope_uncertainty=uncertainty,
        structure_constant=constant if sound else None,
    )


def _of_batches(
    record: Record,
    batches: Sequence[Batch],
    of_blocks: Sequence[Sequence[Spectra]],
    found: Inertial,
    lowest: float,
) -> Iterator[dict[str, Any]]:
    """Yields the statistics of each batch: constants by the shape found for all, own slopes."""
    for batch, blocks in zip(batches, of_blocks, strict=True):
        humidity, start = (
            record.humidity[batch.part],
            record.start + batch.part.start / record.rate_hz,
        )
        own = _of_batch(batch, found, lowest) if len(batches) > 1 else found
        seconds = (batch.part.stop - batch.part.start) / record.rate_hz
        kelvin = record.temperature
        fluxes = _fluxes(record, [batch])
        yield {
            "start": f"{datetime.fromtimestamp(start, UTC):%Y-%m-%dT%H:%M:%S}"
            if record.dated
            else start,
            "duration_s": seconds,
            "mean_g_m3": float(np.nanmean(humidity)),
            "sigma_g_m3": float(np.nanstd(humidity)),
            "structure_constant_q": own.structure_constant,
            "structure_constant_q_uncertainty": None
            if own.structure_constant is None
            else _spread([_levels(blocks, own)]),
            "slope": own.slope,
            "slope_uncertainty": own.slope_uncertainty,
            "wind_speed_m_s": batch.wind_speed_m_s,
            "sweeping_speed_m_s": batch.sweeping_speed_m_s,
            "mean_temperature_k": None if kelvin is None else float(np.nanmean(kelvin[batch.part])),
            "friction_velocity_m_s": fluxes and fluxes.friction_velocity_m_s,
            "obukhov_length_m": fluxes and fluxes.obukhov_length_m,
            "gaps": int(np.isnan(humidity).sum()),
        }
