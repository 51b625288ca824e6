"""What refraction by the same turbulence would add, which is left out: an estimate, so that a user sees when it matters.

Scintillation after Rytov, and the wander of the angle of arrival, of a plane wave in Kolmogorov turbulence (Tatarskii 1971);
radio refractivity N = 77.6 p/T + 3.73e5 e/T^2 in ppm, hPa and K (Smith and Weintraub 1953).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thzcl.air.mean import Air
from thzcl.air.radiometry import LIGHT_SPEED

GAS_CONSTANT_OF_VAPOUR = 461.525  # J kg-1 K-1
DECIBEL = 20 / math.log(10)  # of an amplitude's logarithm
USUAL_APERTURE_M = 0.3


class Refraction(NamedTuple):
    """At the end of a path.

    Standard deviations of the signal in dB and of the angle of arrival in microradians.
    """

    structure_constant_n: float  # C_n^2, m^(-2/3)
    scintillation_db: float
    tilt_urad: float
    path_m: float
    aperture_m: float


def structure_constant_n(
    air: Air, structure_constant_q: float, structure_constant_t: float
) -> float:
    """C_n^2 in m^(-2/3) of air with C_q^2 (g^2 m^-6 m^-2/3) and C_T^2 (K^2 m^-2/3).

    Each for itself.
    """
    kelvin = air.temperature_k
    vapour_hpa_per_gram = GAS_CONSTANT_OF_VAPOUR * kelvin * 1e-5
    by_humidity = 3.73e5 * vapour_hpa_per_gram / kelvin**2 * 1e-6
    by_temperature = (
        77.6 * air.pressure_hpa / kelvin**2 + 2 * 3.73e5 * air.vapour_pressure_hpa / kelvin**3
    ) * 1e-6
    return by_humidity**2 * structure_constant_q + by_temperature**2 * structure_constant_t


def estimate(
    structure_constant: float, frequency_hz: float, path_m: float, aperture_m: float | None
) -> Refraction:
    """Weak scintillation and tilt of a plane wave.

    0.307 C_n^2 k^(7/6) L^(11/6) and 2.91 C_n^2 D^(-1/3) L, as variances.
    """
    aperture = aperture_m or USUAL_APERTURE_M
    wave_number = 2 * math.pi * frequency_hz / LIGHT_SPEED
    log_amplitude = math.sqrt(
        0.307 * structure_constant * wave_number ** (7 / 6) * path_m ** (11 / 6)
    )
    tilt = math.sqrt(2.91 * structure_constant * aperture ** (-1 / 3) * path_m)
    return Refraction(structure_constant, DECIBEL * log_amplitude, 1e6 * tilt, path_m, aperture)
