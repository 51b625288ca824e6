"""Permittivity of water, ice and other substances, by published formulas in float64.

Relative permittivity is eps' + i eps'' with eps'' >= 0, for waves that go as exp(-i w t). Frequency
is in Hz and temperature in K; the arguments broadcast.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ICE_G_CM3 = 0.917  # density of solid ice
FREEZING_K = 273.15
VACUUM_F_M = 8.8541878128e-12  # electric constant, CODATA 2018


def water(frequency_hz: Any, temperature_k: Any) -> Complex:
    """Returns the permittivity of liquid water, supercooled or not (Rosenkranz 2015).

    "A model for the complex dielectric constant of supercooled liquid water at microwave
    frequencies", IEEE Trans. Geosci. Remote Sens. 53, 1387, fitted to measurements of the static
    value, of relaxation and of the far infrared.
    """
    kelvin = np.asarray(temperature_k, dtype=np.float64)
    t, theta = kelvin - FREEZING_K, 300.0 / kelvin
    z = 1e-9j * np.asarray(frequency_hz, dtype=np.float64)
    static = -43.7527 * theta**0.05 + 299.504 * theta**1.47
    static += -399.364 * theta**2.11 + 221.327 * theta**2.31
    slow = 1164.023 * np.exp(-651.4728 / (t + 133.07))  # relaxation frequency, GHz
    relaxing = 80.69715 * np.exp(-t / 226.45) * z / (slow + z)
    strength = 4.008724 * np.exp(-t / 103.05)
    cubic = 10.46012 + 0.1454962 * t + 0.063267156 * t**2 + 0.00093786645 * t**3
    z1, z2 = (-0.75 + 1j) * cubic, -4500.0 + 2000.0j
    c = np.log(z2 / z1)
    band = np.log((z2 - z) / (z1 - z)) / c
    band = band + np.log((np.conj(z2) - z) / (np.conj(z1) - z)) / np.conj(c)
    return np.asarray(np.conj(static - relaxing + strength / 2 * band - strength))


def water_liebe(frequency_hz: Any, temperature_k: Any) -> Complex:
    """Returns the permittivity of liquid water by Liebe, Hufford and Manabe (1991).

    "A model for the complex permittivity of water at frequencies below 1 THz", Int. J. Infrared
    Millim. Waves 12, 659, with the constant 3.52 at high frequencies that MPM93 has. Rain's
    extinction by it is within 0.05 % of that by `water`, fog's within 7 %.
    """
    f = np.asarray(frequency_hz, dtype=np.float64) / 1e9
    less = 300.0 / np.asarray(temperature_k, dtype=np.float64) - 1
    e0 = 77.66 + 103.3 * less
    e1, e2 = 0.0671 * e0, 3.52
    first = 20.20 - 146.4 * less + 316.0 * less**2  # relaxation frequency, GHz
    second = 39.8 * first
    relaxing = (e0 - e1) / (f + 1j * first) + (e1 - e2) / (f + 1j * second)
    return np.asarray(e0 - f * relaxing)


def ice(frequency_hz: Any, temperature_k: Any) -> Complex:
    """Returns the permittivity of pure ice (Maetzler 2006).

    "Microwave dielectric properties of ice", in Thermal Microwave Radiation: Applications for
    Remote Sensing (IET Electromagnetic Waves Series 52), section 5.3; the loss is that of Hufford
    (1991) with Mishima's term.
    """
    f = np.asarray(frequency_hz, dtype=np.float64) / 1e9
    kelvin = np.asarray(temperature_k, dtype=np.float64)
    less, hot = 300.0 / kelvin - 1, np.exp(335.0 / kelvin)
    alpha = (0.00504 + 0.0062 * less) * np.exp(-22.1 * less)
    beta = 0.0207 / kelvin * hot / (hot - 1) ** 2 + 1.16e-11 * f**2
    beta = beta + np.exp(-9.963 + 0.0372 * (kelvin - 273.16))
    return np.asarray(3.1884 + 9.1e-4 * (kelvin - 273.0) + 1j * (alpha / f + beta * f))


def maxwell_garnett(inclusions: Any, share: Any) -> Complex:
    """Returns the permittivity of air that holds small spheres in a share of its volume.

    `inclusions` is the spheres' permittivity (Maxwell Garnett 1904, Phil. Trans. R. Soc. A 203,
    385).
    """
    eps = np.asarray(inclusions, dtype=np.complex128)
    pull = np.asarray(share) * (eps - 1) / (eps + 2)
    return np.asarray((1 + 2 * pull) / (1 - pull))


def snow(frequency_hz: Any, temperature_k: Any, density_g_cm3: float) -> Complex:
    """Returns the permittivity of dry snow: ice in air, by Maxwell Garnett."""
    return maxwell_garnett(ice(frequency_hz, temperature_k), density_g_cm3 / ICE_G_CM3)


def debye(
    frequency_hz: Any, eps_inf: float, delta_eps: Sequence[float], tau_ps: Sequence[float]
) -> Complex:
    """Returns eps_inf + sum of delta_eps / (1 - i w tau) over some relaxations (Debye 1929).

    `tau_ps` are the relaxation times in ps.
    """
    w = 2 * np.pi * np.asarray(frequency_hz, np.float64)
    terms = [d / (1 - 1j * w * t * 1e-12) for d, t in zip(delta_eps, tau_ps, strict=True)]
    return np.asarray(eps_inf + sum(terms), np.complex128)


def building(frequency_hz: Any, a: float, b: float, c: float, d: float) -> Complex:
    """Returns eps' = a f^b with a conductivity of c f^d S/m, f in GHz.

    Recommendation ITU-R P.2040-4 (2025), table 3: eps'' = 17.98 c f^d / f.
    """
    ghz = np.asarray(frequency_hz, np.float64) / 1e9
    return np.asarray(a * ghz**b + 17.98j * c * ghz ** (d - 1))


def conductor(frequency_hz: Any, conductivity_s_m: float) -> Complex:
    """Returns 1 + i sigma / (eps_0 w), of a metal far below its collision rate (Drude 1900).

    With it, Fresnel's equations reflect all but 4 sqrt(pi eps_0 f / sigma) at normal incidence
    (Hagen and Rubens 1903).
    """
    w = 2 * np.pi * np.asarray(frequency_hz, np.float64)
    return np.asarray(1 + 1j * conductivity_s_m / (VACUUM_F_M * w))
