"""Humidity of any kind as a density in g/m3, with air temperature and pressure.

Molar mass of water 18.01528 g/mol, gas constant 8.314462618 J/(mol K) (CODATA 2018), ratio of the
gas constants of dry air and vapour 0.62198 (28.9652 g/mol of dry air, Picard et al. 2008).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import humidity as vapour
from thzcl.air.units import GRAMS_PER_MILLIMOLE

Array = NDArray[np.float64]

GAS = 8.314462618  # J/(mol K)
MOLAR_MASS = 1e3 * GRAMS_PER_MILLIMOLE  # g/mol
EPSILON = MOLAR_MASS / 28.9652
SONIC_HUMIDITY = 0.32  # sonic temperature is T (1 + 0.32 e/p): Kaimal and Gaynor (1991)
SOUND = 402.7  # m2 s-2 K-1: the square of the speed of sound is 402.7 K Ts, of dry air
ITERATIONS = 4  # of sonic temperature with relative humidity: the error falls by 50 in each
NEEDS_PRESSURE = ("mole", "mole-dry", "specific", "ratio")


def vapour_share(values: Array, kind: str) -> Array:
    """Returns e/p, the mole fraction of vapour, of humidity of a kind (see columns.Column).

    A dry mole ratio r is r / (1 + r), a mixing ratio w is w / (w + 0.622), specific humidity s is
    s / (0.622 + 0.378 s) (WMO-No. 8, 2018, annex 4.A).
    """
    if kind == "mole":
        return values
    if kind == "mole-dry":
        return np.asarray(values / (1 + values))
    if kind == "ratio":
        return np.asarray(values / (values + EPSILON))
    return np.asarray(values / (EPSILON + (1 - EPSILON) * values))


def density(share: Array, temperature_k: Any, pressure_hpa: Any) -> Array:
    """Returns vapour density in g/m3 of a mole fraction (ideal gas): x p M / (R T)."""
    return np.asarray(share * pressure_hpa * 100 * MOLAR_MASS / (GAS * temperature_k))


def true_temperature(sonic_k: Array, humidity_g_m3: Array, pressure_hpa: Any) -> Array:
    """Returns air temperature in K for a sonic temperature, humidity in g/m3 and pressure.

    Kaimal and Gaynor (1991): Ts = T (1 + 0.32 e/p), with e = rho R T; the quadratic equation is
    solved for T without cancellation.
    """
    a = SONIC_HUMIDITY * humidity_g_m3 * vapour.GAS_CONSTANT_OF_VAPOUR / 1e5 / pressure_hpa
    return np.asarray(2 * sonic_k / (1 + np.sqrt(1 + 4 * a * sonic_k)))


def dry_by_share(sonic_k: Array, share: Array) -> Array:
    """Returns air temperature in K for a sonic temperature and a mole fraction of vapour."""
    return np.asarray(sonic_k / (1 + SONIC_HUMIDITY * share))


def from_relative(percent: Array, temperature_k: Array) -> Array:
    """Returns vapour density in g/m3 of a relative humidity in per cent, over water."""
    pressure = vapour.vapour_pressure_from_relative(percent, temperature_k)
    return vapour.absolute_humidity(pressure, temperature_k)


def dry_by_relative(sonic_k: Array, percent: Array, pressure_hpa: Any) -> Array:
    """Returns air temperature in K for a sonic temperature and relative humidity in per cent."""
    kelvin = sonic_k
    for _ in range(ITERATIONS):
        share = vapour.vapour_pressure_from_relative(percent, kelvin) / pressure_hpa
        kelvin = dry_by_share(sonic_k, share)
    return kelvin


def relative(humidity_g_m3: Any, temperature_k: Any) -> Array:
    """Returns relative humidity over water in per cent of a vapour density in g/m3."""
    pressure = vapour.vapour_pressure_from_absolute(humidity_g_m3, temperature_k)
    return vapour.relative_humidity(pressure, temperature_k)
