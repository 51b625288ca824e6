"""Absorption of moist air by Recommendation ITU-R P.676-13, in float64: formulas and constituent.

"Attenuation by atmospheric gases and related effects", Geneva 2022, Annex 1. Its line tables 1 and
2 lie beside this file.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.constituent import (
    Attenuation,
    Constituent,
    OpticalProperties,
    Parameters,
    Span,
    hookimpl,
    line_blocks,
    line_table,
    moist_air,
)

Array = NDArray[np.float64]

LEAST_GHZ, MOST_GHZ = 1.0, 1000.0  # the range that the Recommendation states


def attenuation(
    frequency_ghz: Any, temperature_k: Any, pressure_hpa: Any, vapour_pressure_hpa: Any
) -> Attenuation:
    """Returns the specific attenuation of moist air (equation 1); the arguments broadcast.

    `pressure_hpa` is the total pressure, vapour included. Raises ValueError for a frequency outside
    1 to 1000 GHz, or a vapour pressure outside 0 to the total pressure.
    """
    f, t, total, e = moist_air(frequency_ghz, temperature_k, pressure_hpa, vapour_pressure_hpa)
    if not np.all((f >= LEAST_GHZ) & (f <= MOST_GHZ)):
        raise ValueError(f"P.676-13 knows frequencies from {LEAST_GHZ:g} to {MOST_GHZ:g} GHz")
    shape = np.broadcast_shapes(f.shape, t.shape, total.shape, e.shape)
    theta, p = 300.0 / t, total - e
    dry = _oxygen(f, theta, p, e, shape) + _dry_continuum(f, theta, p, e)
    return Attenuation(0.1820 * f * dry, 0.1820 * f * _water(f, theta, p, e, shape))


def _oxygen(f: Array, theta: Array, p: Array, e: Array, shape: tuple[int, ...]) -> Array:
    """Returns the imaginary refractivity N'' in ppm of oxygen lines.

    `p` is the pressure of dry air. The sum is negative between lines, where the continuum is
    larger (P.676-13, equations 2a, 3 and 5 to 7).
    """
    total = np.zeros(shape)
    for f0, a1, a2, a3, a4, a5, a6 in line_blocks(
        line_table(__file__, "p676_13_oxygen_lines.csv"), shape
    ):
        strength = 1e-7 * a1 * p * theta**3 * np.exp(a2 * (1 - theta))
        width = 1e-4 * a3 * (p * theta ** (0.8 - a4) + 1.1 * e * theta)
        width = np.sqrt(width**2 + 2.25e-6)  # Zeeman splitting
        overlap = 1e-4 * (a5 + a6 * theta) * (p + e) * theta**0.8
        below, above = f0 - f, f0 + f
        profile = (width - overlap * below) / (below**2 + width**2)
        profile += (width - overlap * above) / (above**2 + width**2)
        total += np.sum(strength / f0 * profile, axis=0)
    return f * total


def _dry_continuum(f: Array, theta: Array, p: Array, e: Array) -> Array:
    """Returns N'' in ppm of oxygen's Debye spectrum and of nitrogen (P.676-13, equations 8, 9)."""
    width = 5.6e-4 * (p + e) * theta**0.8
    debye = 6.14e-5 / (width * (1 + (f / width) ** 2))
    nitrogen = 1.4e-12 * p * theta**1.5 / (1 + 1.9e-5 * f**1.5)
    return np.asarray(f * p * theta**2 * (debye + nitrogen))


def _water(f: Array, theta: Array, p: Array, e: Array, shape: tuple[int, ...]) -> Array:
    """Returns N'' in ppm of water vapour, the pseudo-line at 1780 GHz included.

    `p` is the pressure of dry air (P.676-13, equations 2b, 3, 5 and 6).
    """
    total = np.zeros(shape)
    for f0, b1, b2, b3, b4, b5, b6 in line_blocks(
        line_table(__file__, "p676_13_water_lines.csv"), shape
    ):
        strength = 0.1 * b1 * e * theta**3.5 * np.exp(b2 * (1 - theta))
        width = 1e-4 * b3 * (p * theta**b4 + b5 * e * theta**b6)
        # Doppler broadening, at every pressure.
        width = 0.535 * width + np.sqrt(0.217 * width**2 + 2.1316e-12 * f0**2 / theta)
        profile = 1 / ((f0 - f) ** 2 + width**2)
        profile += 1 / ((f0 + f) ** 2 + width**2)
        total += np.sum(strength * width / f0 * profile, axis=0)
    return f * total


class P676(Constituent):
    """Moist air by Recommendation ITU-R P.676-13.

    44 lines of oxygen with overlap, its Debye spectrum, nitrogen induced by pressure, 34 lines of
    water vapour, and a pseudo-line at 1780 GHz that stands for the continuum of water vapour. The
    scheme is that of "mpm93", with other coefficients.

    Fitted to: what radio paths need to be predicted. The pseudo-line is what vapour was measured to
    absorb beyond its lines.

    Validity: 1 to 1000 GHz, as the Recommendation states; refused outside. Any pressure: lines of
    water have Doppler's width besides, and Zeeman splitting widens those of oxygen to 1.5 MHz.

    Validation: ITU-Rpy, whose tables are the same, agrees to 1e-9 (tests/test_gas_models.py), and
    itself with the 350 rows of the ITU's own sheet to 5e-7.

    How it compares at 650 GHz and 1013.25 hPa: 7.43, 62.5 and 328 dB/km at -10 degC and 30 %, 20
    degC and 44 %, 35 degC and 90 %, where "mpm93" has 7.99, 68.7 and 376, "r24" 6.56, 56.4 and 295.
    Spectra measured at 450 to 1000 GHz depart from it the more the higher frequency and humidity
    are (O'Hara and Grischkowsky 2018).

    References: Recommendation ITU-R P.676-13 (2022), "Attenuation by atmospheric gases and related
    effects", Annex 1, tables 1 and 2. J. F. O'Hara, D. R. Grischkowsky (2018), "Comment on the
    veracity of the ITU-R recommendation for atmospheric attenuation at terahertz frequencies", IEEE
    Trans. Terahertz Sci. Technol. 8, 372.
    """

    name = "p676-13"
    contract = 1
    gas = True
    valid = (Span("frequency_ghz", LEAST_GHZ, MOST_GHZ, "the range of ITU-R P.676-13"),)

    class Params(Parameters):
        """It has none."""

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns the absorption, in parts of dry air and of vapour."""
        ghz = np.clip(frequency_hz / 1e9, LEAST_GHZ, MOST_GHZ)  # an end may be missed by rounding
        return attenuation(ghz, temperature_k, pressure_hpa, vapour_hpa).optics()

    def lines(
        self, temperature_k: float, pressure_hpa: float, vapour_hpa: float
    ) -> tuple[Array, float]:
        """Returns the lines of oxygen and water, and about their half width: 3 MHz/hPa, and 1."""
        del temperature_k, vapour_hpa
        names = ("p676_13_oxygen_lines.csv", "p676_13_water_lines.csv")
        centers = np.sort(np.concatenate([line_table(__file__, name)[:, 0] for name in names]))
        return centers * 1e9, 3e6 * pressure_hpa + 1e6


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [P676]
