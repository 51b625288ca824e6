"""An estimate of what refraction by the turbulence would add, which images leave out.

It gives the scintillation and the wander of the angle of arrival of a plane wave in Kolmogorov
turbulence, in Rytov's approximation (Tatarskii 1971, "The effects of the turbulent atmosphere on
wave propagation"). Radio refractivity is N = 77.6 p/T + 3.73e5 e/T^2 in ppm, with hPa and K (Smith
and Weintraub 1953, Proc. IRE 41, 1035).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from thzcl.air.humidity import GAS_CONSTANT_OF_VAPOUR
from thzcl.air.mean import Air
from thzcl.air.radiometry import LIGHT_SPEED

DECIBEL = 20 / math.log(10)  # dB for each unit of an amplitude's natural logarithm
USUAL_APERTURE_M = 0.3


class Refraction(NamedTuple):
    """What refraction does by the end of a path of `path_m`, before an aperture of `aperture_m`.

    `scintillation_db` is the standard deviation of the signal in dB, `tilt_urad` that of the angle
    of arrival in microradians.
    """

    structure_constant_n: float  # C_n^2, m^(-2/3)
    scintillation_db: float
    tilt_urad: float
    path_m: float
    aperture_m: float


def structure_constant_n(
    air: Air, structure_constant_q: float, structure_constant_t: float
) -> float:
    """Returns C_n^2 of the refractive index, m^(-2/3).

    `structure_constant_q` is C_q^2 of absolute humidity in g^2 m^-6 m^(-2/3), and
    `structure_constant_t` is C_T^2 of temperature in K^2 m^(-2/3). Their contributions are added as
    if humidity and temperature did not correlate.
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
    """Returns the weak scintillation and the tilt of a plane wave after a path of `path_m`.

    The variance of the amplitude's logarithm is 0.307 C_n^2 k^(7/6) L^(11/6), that of the angle of
    arrival 2.91 C_n^2 D^(-1/3) L in rad^2 (Tatarskii 1971). `structure_constant` is C_n^2 in
    m^(-2/3), and `aperture_m` is D, 0.3 m if it is None.
    """
    aperture = aperture_m or USUAL_APERTURE_M
    wave_number = 2 * math.pi * frequency_hz / LIGHT_SPEED
    log_amplitude = math.sqrt(
        0.307 * structure_constant * wave_number ** (7 / 6) * path_m ** (11 / 6)
    )
    tilt = math.sqrt(2.91 * structure_constant * aperture ** (-1 / 3) * path_m)
    return Refraction(structure_constant, DECIBEL * log_amplitude, 1e6 * tilt, path_m, aperture)
