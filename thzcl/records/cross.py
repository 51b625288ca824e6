"""Temperature and humidity together: cross-structure constant, coherence, phase, correlation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.records.batches import Batch, Spectra
from thzcl.records.inertial import Fit, Inertial
from thzcl.records.spectrum import TAPERS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Together:
    """How temperature and humidity go together in the inertial range.

    `constant` is C_Tq, signed, in K g/m3 m^-2/3: <dT dq> = C_Tq r^(2/3); `correlation` is that of
    the inertial range, noise taken off.
    """

    constant: float
    correlation: float


def together(
    spectra: Spectra, found: Inertial, temperature: Fit, levels: tuple[float, float]
) -> Together | None:
    """Returns how temperature and humidity go together, of pooled spectra or of a block's.

    r = sum Re S_tq / sqrt(sum (S_q - n_q) sum (S_t - n_t)) over the inertial range, and not the
    root of coherence, which five tapers bias by a fifth; C_Tq = r C_T C_q. `levels` are C_q^2 and
    C_T^2. The range's large eddies weigh most, since sensors some decimetres apart lose the
    coherence of the small ones. None where noise leaves nothing.
    """
    assert spectra.temperature is not None and spectra.cross is not None  # noqa: S101, PT018
    xi = spectra.humidity.frequency
    chosen = (xi >= found.limits[0]) & (xi <= found.limits[1])
    count, q = spectra.humidity.count[chosen], spectra.humidity.density[chosen]
    t, both = spectra.temperature.density[chosen], spectra.cross.real[chosen]
    own = [float(np.sum(count * (s - n))) for s, n in ((q, found.noise), (t, temperature.floor))]
    if min(*own, *levels) <= 0:
        return None
    correlation = float(np.clip(np.sum(count * both) / np.sqrt(own[0] * own[1]), -1, 1))
    return Together(correlation * float(np.sqrt(levels[0] * levels[1])), correlation)


def coherence(spectra: Spectra) -> dict[str, list[float]] | None:
    """Returns squared coherence, 0 to 1, and phase in degrees in bins of cycles/m.

    A phase above 0 says that humidity leads temperature. The bias of few tapers and frequencies,
    (1 - coherence) / (number of values), is taken off.
    """
    if spectra.temperature is None or spectra.cross is None:
        return None
    power = spectra.humidity.density * spectra.temperature.density
    raw = np.abs(spectra.cross) ** 2 / np.maximum(power, 1e-300)
    values = np.maximum(spectra.humidity.count, TAPERS)
    squared = np.clip(raw - (1 - raw) / values, 0, 1)
    return {
        "spatial_frequency_cycles_per_m": spectra.humidity.frequency.tolist(),
        "squared": squared.tolist(),
        "phase_deg": np.degrees(np.angle(spectra.cross)).tolist(),
    }


def correlation(batches: Sequence[Batch]) -> float | None:
    """Returns the correlation of temperature and humidity over all samples that have both."""
    if batches[0].temperature is None:
        return None
    q = np.concatenate([batch.humidity for batch in batches])
    t = np.concatenate([batch.temperature for batch in batches if batch.temperature is not None])
    both: Any = np.isfinite(q) & np.isfinite(t)
    return float(np.corrcoef(q[both], t[both])[0, 1])
