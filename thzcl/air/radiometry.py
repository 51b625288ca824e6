"""Planck's law, its inverse and differences, from 0 K to 1e18 K and down to microkelvins.

Spectral radiance is in W m-2 sr-1 Hz-1, frequency in Hz, temperature in kelvin; all arguments
broadcast. Radiance is 2 h nu^3 / c^2 times the photon occupation n = 1 / (exp(x) - 1) of a mode,
with x = h nu / (k T) (Planck 1901). Differences are formed by expm1 and log1p, never by
subtraction, and never in float32.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

PLANCK = 6.62607015e-34  # J s
BOLTZMANN = 1.380649e-23  # J/K
LIGHT_SPEED = 299792458.0  # m/s

Array = NDArray[np.float64]


def radiance_unit(frequency_hz: Any) -> Array:
    """Returns the spectral radiance of one photon in each mode, 2 h nu^3 / c^2."""
    return np.asarray(2 * PLANCK * np.asarray(frequency_hz, dtype=np.float64) ** 3 / LIGHT_SPEED**2)


def photon_temperature(frequency_hz: Any) -> Array:
    """Returns the temperature h nu / k, in kelvin."""
    return np.asarray(PLANCK * np.asarray(frequency_hz, dtype=np.float64) / BOLTZMANN)


def planck(frequency_hz: Any, temperature_k: Any) -> Array:
    """Returns the spectral radiance of a black body, which is exactly 0 at 0 K."""
    return np.asarray(radiance_unit(frequency_hz) * _occupation(frequency_hz, temperature_k))


def planck_slope(frequency_hz: Any, temperature_k: Any) -> Array:
    """Returns the derivative of Planck's law with temperature, W m-2 sr-1 Hz-1 K-1."""
    n = _occupation(frequency_hz, temperature_k)
    kelvin = np.asarray(temperature_k, dtype=np.float64)
    return np.asarray(
        radiance_unit(frequency_hz) * n * (n + 1) * photon_temperature(frequency_hz) / kelvin**2
    )


def planck_difference(frequency_hz: Any, temperature_k: Any, reference_k: Any) -> Array:
    """Returns planck(T) - planck(T_reference), accurate however close the temperatures are."""
    t, r = (np.asarray(one, dtype=np.float64) + 0.0 for one in (temperature_k, reference_k))
    hot, cold = np.maximum(t, r), np.minimum(t, r)
    # n_hot - n_cold = n_hot (1 + n_cold) (1 - exp(x_hot - x_cold)): no term grows without bound.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        exponent = photon_temperature(frequency_hz) * (cold - hot) / (cold * hot)
    exponent = np.where(hot == cold, 0.0, exponent)
    n_hot, n_cold = _occupation(frequency_hz, hot), _occupation(frequency_hz, cold)
    return np.asarray(
        np.sign(t - r) * radiance_unit(frequency_hz) * n_hot * (1 + n_cold) * -np.expm1(exponent)
    )


def brightness_temperature(frequency_hz: Any, radiance: Any) -> Array:
    """Returns the temperature of the black body of a given radiance; it is 0 K for none."""
    n = np.asarray(radiance, dtype=np.float64) / radiance_unit(frequency_hz)
    with np.errstate(divide="ignore"):
        return np.asarray(photon_temperature(frequency_hz) / np.log1p(1 / n))


def brightness_temperature_contrast(
    frequency_hz: Any, radiance_contrast: Any, reference_k: Any
) -> Array:
    """Returns the brightness temperature of planck(T_r) + radiance_contrast, less T_r, in kelvin.

    T_r is `reference_k`. With l = log(1 + 1/n) it is T - T_r = (h nu / k) (l_r - l) / (l_r l), and
    l_r - l = log1p(dn / (n_r (n_r + 1 + dn))) for a contrast of dn photons in each mode.
    """
    n_r = _occupation(frequency_hz, reference_k)
    dn = np.asarray(radiance_contrast, dtype=np.float64) / radiance_unit(frequency_hz)
    l_r = np.log1p(1 / n_r)
    with np.errstate(divide="ignore", invalid="ignore"):
        less = np.log1p(dn / (n_r * (n_r + 1 + dn)))
        logarithm = np.asarray(l_r - less)
        hot = logarithm < l_r / 2  # beyond twice the reference the difference loses its digits
        if hot.any():
            logarithm = np.where(hot, np.log1p(1 / (n_r + dn)), logarithm)
        contrast = np.asarray(less / logarithm * (photon_temperature(frequency_hz) / l_r))
    dark = n_r + dn <= 0  # no radiance at all is 0 K, that is, minus the reference
    return (
        np.where(dark, -np.asarray(reference_k, dtype=np.float64), contrast)
        if dark.any()
        else contrast
    )


def _occupation(frequency_hz: Any, temperature_k: Any) -> Array:
    """Returns the photons in each mode, 1 / (exp(h nu / (k T)) - 1)."""
    kelvin = np.asarray(temperature_k, dtype=np.float64) + 0.0  # +0 of -0
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(1 / np.expm1(photon_temperature(frequency_hz) / kelvin))
