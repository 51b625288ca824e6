"""Absorption of moist air by MPM93, in float64: the formulas, and the two constituents.

The model is that of Liebe, Hufford and Cotton (1993), "Propagation modeling of moist air and
suspended water/ice particles at frequencies below 1000 GHz", AGARD CP-542. Line tables 1 and 2 of
that paper, as printed, lie beside this file.
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

MODELS = ("mpm93", "mpm93-corrected")
STATED_TO_GHZ = 1000.0  # the end of the range that its authors state
REFUSED_ABOVE_GHZ = 1780.0  # the centre of its continuum pseudo-line

# Water isotopologues whose printed strengths are about 10 and 81 times too strong: the physical
# ones are that of the 556.936 GHz line of H2-16O times the abundances of H2-18O and H2-17O.
_CORRECTED_STRENGTHS = {547.676440: 48.74 * 0.00199983, 552.020960: 48.74 * 0.000372}


def attenuation(
    model: str, frequency_ghz: Any, temperature_k: Any, pressure_hpa: Any, vapour_pressure_hpa: Any
) -> Attenuation:
    """Returns the specific attenuation of moist air; the arguments broadcast.

    `model` is "mpm93" (as printed) or "mpm93-corrected" (two isotopologue lines at their physical
    strength). `pressure_hpa` is the total pressure, vapour included. Raises ValueError
    for a frequency outside 0 to 1780 GHz, a vapour pressure outside 0 to the total pressure, or an
    unknown model.
    """
    if model not in MODELS:
        raise ValueError(f"unknown absorption model {model!r}; choose one of {', '.join(MODELS)}")
    f, t, total, e = moist_air(frequency_ghz, temperature_k, pressure_hpa, vapour_pressure_hpa)
    shape = np.broadcast_shapes(f.shape, t.shape, total.shape, e.shape)
    if not np.all((f > 0) & (f <= REFUSED_ABOVE_GHZ)):
        raise ValueError(f"MPM93 knows frequencies above 0 and up to {REFUSED_ABOVE_GHZ:g} GHz")
    theta = 300.0 / t
    dry_pressure = total - e
    scale = 0.1820 * f
    dry = _oxygen(f, theta, dry_pressure, e, shape) + _nitrogen(f, theta, dry_pressure)
    vapour = _water(f, theta, dry_pressure, e, shape, corrected=model == "mpm93-corrected")
    return Attenuation(scale * dry, scale * vapour)


def line_centers_ghz() -> Array:
    """Returns the centre frequencies of all lines of oxygen and water, ascending, GHz."""
    names = ("mpm93_oxygen_lines.csv", "mpm93_water_lines.csv")
    return np.sort(np.concatenate([line_table(__file__, name)[:, 0] for name in names]))


def line_width_ghz(pressure_hpa: float) -> float:
    """Returns about the half width of a line at half maximum, GHz.

    Collisions contribute some 3 MHz/hPa, the motion of the molecules about 1 MHz.
    """
    return 3e-3 * pressure_hpa + 1e-3


def _oxygen(f: Array, theta: Array, p: Array, e: Array, shape: tuple[int, ...]) -> Array:
    """Returns the imaginary refractivity N'' in ppm of oxygen lines and non-resonant spectrum."""
    lines = np.zeros(shape)
    for f0, a1, a2, a3, a4, a5, a6 in line_blocks(
        line_table(__file__, "mpm93_oxygen_lines.csv"), shape
    ):
        strength = 1e-6 * a1 / f0 * p * theta**3 * np.exp(a2 * (1 - theta))
        width = 1e-3 * a3 * (p * theta ** (0.8 - a4) + 1.1 * e * theta)
        width = np.sqrt(width**2 + (25 * 0.6e-4) ** 2)  # Zeeman splitting
        overlap = 1e-3 * (a5 + a6 * theta) * (p + e) * theta**0.8
        below, above = f0 - f, f0 + f
        resonances = (width - below * overlap) / (below**2 + width**2) + (
            width - above * overlap
        ) / (above**2 + width**2)
        lines += np.sum(strength * f * resonances, axis=0)
    width = 0.56e-3 * (p + e) * theta**0.8
    debye = 6.14e-5 * p * theta**2 * f * width / (f**2 + width**2)
    # Line mixing makes the far wings' sum negative: MPM93 sets it to zero.
    return np.asarray(np.maximum(lines, 0.0) + debye)


def _nitrogen(f: Array, theta: Array, p: Array) -> Array:
    """Returns the imaginary refractivity N'' in ppm of pressure-induced nitrogen absorption."""
    return np.asarray(1.40e-12 * p**2 * theta**3.5 * f / (1 + 1.93e-5 * f**1.5))


def _water(
    f: Array, theta: Array, p: Array, e: Array, shape: tuple[int, ...], *, corrected: bool
) -> Array:
    """Returns the imaginary refractivity N'' in ppm of water-vapour lines and pseudo-line."""
    total = np.zeros(shape)
    thin_air = p + e < 0.7
    for f0, b1, b2, b3, b4, b5, b6 in line_blocks(
        line_table(__file__, "mpm93_water_lines.csv"), shape
    ):
        strength = b1
        for line, physical in _CORRECTED_STRENGTHS.items() if corrected else ():
            strength = np.where(f0 == line, physical, strength)
        strength = strength / f0 * e * theta**3.5 * np.exp(b2 * (1 - theta))
        width = 1e-3 * b3 * (b4 * e * theta**b6 + p * theta**b5)
        doppler = 0.535 * width + np.sqrt(0.217 * width**2 + (1.46e-6 * f0) ** 2 / theta)
        width = np.where(thin_air, doppler, width)
        resonances = 1 / ((f0 - f) ** 2 + width**2) + 1 / ((f0 + f) ** 2 + width**2)
        total += np.sum(strength * f * width * resonances, axis=0)
    return total


class MPM93(Constituent):
    """Moist air by MPM93, its line tables as printed.

    44 lines of oxygen with overlap and its non-resonant spectrum, pressure-induced nitrogen, 34
    lines of water vapour and a pseudo-line at 1780 GHz that stands for the continuum.

    Validity: stated by its authors to 1000 GHz; beyond, up to the pseudo-line, it is an
    extrapolation, and above that it is refused. Any pressure and temperature of the troposphere.

    Validation: a table of attenuations at 600 GHz and 25 degC from 10 % humidity on is met to
    0.31 % (O'Brien and Tofsted; tests/test_absorption.py). In the windows it stands 6 to 21 %
    above ITU-R P.676.

    Mind: the printed strengths of two isotopologue lines, at 547.676 and 552.021 GHz, are about 10
    and 81 times too strong; "mpm93-corrected" has the physical ones.

    References: H. J. Liebe, G. A. Hufford, M. G. Cotton (1993), "Propagation modeling of moist air
    and suspended water/ice particles at frequencies below 1000 GHz", AGARD CP-542.
    """

    name = "mpm93"
    contract = 1
    gas = True
    valid = (
        Span(
            "frequency_ghz",
            0.0,
            REFUSED_ABOVE_GHZ,
            "there stands the pseudo-line of its continuum",
            warn=(0.0, STATED_TO_GHZ),
        ),
    )

    class Params(Parameters):
        """It has none."""

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns the absorption, in parts of dry air and of vapour."""
        state = temperature_k, pressure_hpa, vapour_hpa
        return attenuation(self.name, frequency_hz / 1e9, *state).optics()

    def lines(
        self, temperature_k: float, pressure_hpa: float, vapour_hpa: float
    ) -> tuple[Array, float]:
        """Returns the lines of oxygen and water, and about their half width."""
        del temperature_k, vapour_hpa
        return line_centers_ghz() * 1e9, line_width_ghz(pressure_hpa) * 1e9


class MPM93Corrected(MPM93):
    """Moist air by MPM93, with two lines of water vapour at their physical strength.

    The lines at 547.676 and 552.021 GHz, of H2-18O and H2-17O, take the strength of the 556.936 GHz
    line of H2-16O times the abundance of their isotopologue. That lowers 650 GHz by 1.2 to 1.5 %,
    and 550 GHz by some 16 %. All else is as in "mpm93", its validity and reference too.
    """

    name = "mpm93-corrected"


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituents of this file."""
    return [MPM93, MPM93Corrected]
