"""Air of one mean state, and its absorption where humidity and temperature depart from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import humidity
from thzcl.air.mpm93 import attenuation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Air:
    """The mean air: its absorption model, temperature, total pressure and absolute humidity."""

    model: str
    temperature_k: float
    pressure_hpa: float
    absolute_humidity_g_m3: float

    @property
    def vapour_pressure_hpa(self) -> float:
        """Returns the vapour pressure of the mean air, hPa."""
        return float(
            humidity.vapour_pressure_from_absolute(self.absolute_humidity_g_m3, self.temperature_k)
        )

    @property
    def relative_humidity_percent(self) -> float:
        """Returns the relative humidity of the mean air over water, per cent."""
        return float(humidity.relative_humidity(self.vapour_pressure_hpa, self.temperature_k))

    @property
    def most_vapour(self) -> float:
        """Returns the largest delta that the total pressure admits: that of vapour alone."""
        if self.absolute_humidity_g_m3 == 0:
            return 0.0
        return self.pressure_hpa / self.vapour_pressure_hpa - 1

    def absorption(self, frequency_hz: Any, delta: Any = 0.0, offset_k: Any = 0.0) -> Array:
        """Returns the absorption coefficient of power in 1/m; the arguments broadcast.

        `delta` is the humidity fluctuation rho / rho_mean - 1, at least -1. `offset_k` is the
        temperature's departure from the mean in kelvin, at constant total pressure. Vapour pressure
        is limited to the total pressure.
        """
        kelvin = self.temperature_k + np.asarray(offset_k, dtype=np.float64)
        vapour = humidity.vapour_pressure_from_absolute(
            self.absolute_humidity_g_m3 * (1 + np.asarray(delta)), kelvin
        )
        vapour = np.clip(vapour, 0.0, self.pressure_hpa)
        return attenuation(
            self.model, np.asarray(frequency_hz) / 1e9, kelvin, self.pressure_hpa, vapour
        ).total_per_m
