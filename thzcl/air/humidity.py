"""Humidity in its three forms: relative (%), absolute (g/m3), vapour pressure (hPa).

Saturation is over water at every temperature, as in MPM93 (Liebe, Hufford and Cotton 1993, AGARD
CP-542), so that relative humidity below freezing is that of supercooled water. All functions take
scalars or arrays, which broadcast.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

GAS_CONSTANT_OF_VAPOUR = 461.525  # J kg-1 K-1
FREEZING_K = 273.15
HALVINGS = 48  # of an interval of 150 K, to 1e-12 K

Array = NDArray[np.float64]


def saturation_vapour_pressure(temperature_k: Any) -> Array:
    """Returns the saturation vapour pressure over water in hPa.

    It is 2.408e11 theta^5 exp(-22.644 theta) with theta = 300 K / T (Liebe, Hufford and Cotton
    1993, AGARD CP-542).
    """
    theta = 300.0 / np.asarray(temperature_k, dtype=np.float64)
    return np.asarray(2.408e11 * theta**5 * np.exp(-22.644 * theta))


def vapour_pressure_from_relative(relative_humidity_percent: Any, temperature_k: Any) -> Array:
    """Returns the vapour pressure in hPa of air at a relative humidity in per cent."""
    return np.asarray(
        np.asarray(relative_humidity_percent) / 100.0 * saturation_vapour_pressure(temperature_k)
    )


def vapour_pressure_from_absolute(absolute_humidity_g_m3: Any, temperature_k: Any) -> Array:
    """Returns the vapour pressure in hPa of air at an absolute humidity in g/m3 (ideal gas)."""
    kelvin = np.asarray(temperature_k, dtype=np.float64)
    return np.asarray(np.asarray(absolute_humidity_g_m3) * GAS_CONSTANT_OF_VAPOUR * kelvin / 1e5)


def absolute_humidity(vapour_pressure_hpa: Any, temperature_k: Any) -> Array:
    """Returns the absolute humidity in g/m3 of air at a vapour pressure in hPa (ideal gas)."""
    kelvin = np.asarray(temperature_k, dtype=np.float64)
    return np.asarray(np.asarray(vapour_pressure_hpa) * 1e5 / (GAS_CONSTANT_OF_VAPOUR * kelvin))


def relative_humidity(vapour_pressure_hpa: Any, temperature_k: Any) -> Array:
    """Returns the relative humidity over water in per cent; it is over 100 in supersaturation."""
    return np.asarray(
        100.0 * np.asarray(vapour_pressure_hpa) / saturation_vapour_pressure(temperature_k)
    )


def wet_bulb_temperature(temperature_k: Any, pressure_hpa: Any, vapour_pressure_hpa: Any) -> Array:
    """Returns the temperature in K to which what is wet cools in moving air, at most the air's.

    It solves e = e_s(T_w) - 6.62e-4 p (T - T_w) (1 + 9.44e-4 t_w), t_w being in degC, the equation
    of Assmann's psychrometer with e_s over water (WMO-No. 8, annex 4.B, which has 6.53e-4).
    """
    air_k, p, e = (
        np.asarray(given, dtype=np.float64)
        for given in (temperature_k, pressure_hpa, vapour_pressure_hpa)
    )
    high = np.broadcast_to(air_k, np.broadcast_shapes(air_k.shape, p.shape, e.shape))
    low = np.maximum(high - 150.0, high / 2)
    for _ in range(HALVINGS):
        wet_k = (low + high) / 2
        cooled = 6.62e-4 * p * (air_k - wet_k) * (1 + 9.44e-4 * (wet_k - FREEZING_K))
        dry = saturation_vapour_pressure(wet_k) - cooled < e
        low, high = np.where(dry, wet_k, low), np.where(dry, high, wet_k)
    return np.asarray(high)
