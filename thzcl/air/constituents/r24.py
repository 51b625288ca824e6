"""Absorption of moist air by Rosenkranz's model of 2024, in float64: formulas and constituent.

P. W. Rosenkranz, "Line-by-line microwave radiative transfer (non-scattering)", version of 2024,
doi:10.21982/M81013. Its tables of lines and of the self continuum lie beside this file. Sums are in
1/km.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

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

WARNED_ABOVE_GHZ = 780.0  # where the lines that it lacks are 2 % of absorption
REFUSED_ABOVE_GHZ = 800.0  # the end that its author states for water
LAST_LINE_GHZ = 1097.36487  # where the formulas still are what they are meant to be
WARNED_BELOW_HPA = 3.0  # where widths come from collisions no longer alone
DB_KM = 4.342944819  # dB/km in 1/km

CUT_OFF_GHZ = 750.0  # from a line of water to where its wing ends
CORE = 10.0  # widths from a line within which its shape depends on the molecules' speed
OXYGEN_SPEED_RATIO = 0.076  # of the 118.75 GHz line: what its width varies by with speed
MOLECULE_G = 2.9915075e-23  # of water
FOREIGN_CONTINUUM = 5.547e-10  # 1/km hPa-2 GHz-2 at 296 K
SELF_CONTINUUM = 6.532e12  # 1/km hPa-2 GHz-2 in the unit of its table
SELF_STEP_GHZ = 299.792458  # between rows of that table: 10/cm
DEBYE_STRENGTH = 1.584e-17  # Hz cm2 GHz-2, of oxygen's non-resonant spectrum
DEBYE_WIDTH = 0.56  # GHz/bar
OVERLAPPING = slice(1, 38)  # rows of the oxygen table: the lines of the 60 GHz band


def attenuation(
    frequency_ghz: Any, temperature_k: Any, pressure_hpa: Any, vapour_pressure_hpa: Any
) -> Attenuation:
    """Returns the specific attenuation of moist air; the arguments broadcast.

    `pressure_hpa` is the total pressure, vapour included. The formulas run on to the last line;
    above 800 GHz they lack lines that the constituent would be wrong without. Raises ValueError for
    a frequency outside 0 to 1097 GHz, or a vapour pressure outside 0 to the total pressure.
    """
    f, t, total, e = moist_air(frequency_ghz, temperature_k, pressure_hpa, vapour_pressure_hpa)
    if not np.all((f > 0) & (f <= LAST_LINE_GHZ)):
        raise ValueError(f"R24 knows frequencies above 0 and up to {LAST_LINE_GHZ:g} GHz")
    grams = 18.01528 * e / (0.0831451 * t)  # per m3
    # The vapour pressures are rounded as in the author's programs.
    dry = oxygen(f, t, total, 4.615228e-3 * grams * t) + nitrogen(f, t, total - e)
    vapour_hpa = 4.6152e-3 * grams * t
    vapour = water_lines(f, t, total - vapour_hpa, vapour_hpa, grams)
    vapour += water_continuum(f, t, total - vapour_hpa, vapour_hpa)
    return Attenuation(DB_KM * dry, DB_KM * vapour)


# --- water vapour --------------------------------------------------------------------------------


class _Collisions(NamedTuple):
    """What collisions do to lines of water, in GHz, and how the molecules' speed changes it.

    The arrays are (line, *state).
    """

    width: Array
    width_by_speed: Array
    shift: Array
    shift_by_speed: Array


def water_lines(f: Array, t: Array, p: Array, e: Array, grams: Array) -> Array:
    """Returns the absorption of `grams` of water per m3 in lines, 1/km; `p` is that of dry air."""
    shape = np.broadcast_shapes(f.shape, t.shape, p.shape)
    total = np.zeros(shape)
    table = line_table(__file__, "r24_water_lines.csv")
    for block in line_blocks(table, shape):
        by = _collisions(block, t, p, e)
        strength, square, center = _water_strength(block, t), by.width**2, block[0] + by.shift
        for away in (f - center, f + center):
            inside = np.abs(away) < CUT_OFF_GHZ
            if inside.any():
                wing = strength * by.width / (np.square(away, out=away) + square)
                wing -= strength * by.width / (CUT_OFF_GHZ**2 + square)
                total += np.sum(wing if inside.all() else wing * inside, axis=0)
    (lines,) = line_blocks(table[table[:, 13] > 0], (1,) * len(shape))
    by = _collisions(lines, t, p, e)
    spread = by.width_by_speed - 1j * by.shift_by_speed
    core = _core(f - lines[0] - by.shift, by.width, spread, 0.0)
    if core is not None:
        total += np.sum(_water_strength(lines, t) * core, axis=0)
    return np.asarray(1e-10 * grams / (MOLECULE_G * np.pi) * f**2 * total)


def _water_strength(lines: Array, t: Array) -> Array:
    """Returns the strengths of lines over the squares of their frequencies, (line, *state)."""
    f0, strength, b = lines[:3]
    h = 296.0 / t
    return np.asarray(strength / f0**2 * h**2.5 * np.exp(b * (1 - h)))


def _collisions(lines: Array, t: Array, p: Array, e: Array) -> _Collisions:
    """Returns what collisions with air, of pressure `p`, and with water do to lines."""
    (
        *_, air, of_air, own, of_own, d_air, d_of_air, d_own, d_of_own, a_air, a_own,
        air2, of_air2, own2, of_own2, d2_air, d2_own,
    ) = lines  # fmt: skip
    h = 296.0 / t
    log = np.log(h)
    return _Collisions(
        width=1e-3 * (air * p * h**of_air + own * e * h**of_own),
        width_by_speed=1e-3 * (air2 * p * h**of_air2 + own2 * e * h**of_own2),
        shift=1e-3
        * (
            d_air * p * (1 - a_air * log) * h**d_of_air
            + d_own * e * (1 - a_own * log) * h**d_of_own
        ),
        shift_by_speed=1e-3 * (d2_air * p + d2_own * e),
    )


def water_continuum(f: Array, t: Array, p: Array, e: Array) -> Array:
    """Returns the continuum of water with air, of pressure `p`, and with itself, 1/km.

    That with itself is a Catmull-Rom cubic between the rows of its table.
    """
    h = 296.0 / t
    steps = f / SELF_STEP_GHZ
    row = np.floor(steps)
    u = steps - row
    weights = (
        -u * (1 - u) ** 2 / 2,
        1 - 2.5 * u**2 + 1.5 * u**3,
        u / 2 + 2 * u**2 - 1.5 * u**3,
        -(u**2) * (1 - u) / 2,
    )
    _, strength, exponent = line_table(__file__, "r24_water_self_continuum.csv").T
    own = np.zeros(())
    for offset, weight in enumerate(weights, start=-1):
        node = np.abs(row + offset).astype(np.int64)  # row 1 stands for that before row 0, too
        own = own + weight * SELF_CONTINUUM * strength[node] * h ** (exponent[node] + 3)
    return np.asarray((FOREIGN_CONTINUUM * h**3 * p + own * e) * e * f**2)


# --- dry air -------------------------------------------------------------------------------------


def nitrogen(f: Array, t: Array, p: Array) -> Array:
    """Returns the absorption of nitrogen induced by pressure, 1/km; `p` is that of dry air."""
    return np.asarray(
        9.95e-14 * p**2 * f**2 * (300.0 / t) ** 3.22 * (1 + 1 / (1 + (f / 450.0) ** 2)) / 2
    )


def oxygen(f: Array, t: Array, pressure: Array, e: Array) -> Array:
    """Returns the absorption of oxygen's lines, which mix, and its non-resonant spectrum, 1/km."""
    h, p = 300.0 / t, pressure - e
    bar = 1e-3 * (p * h**0.754 + 1.2 * e * h)
    shape = np.broadcast_shapes(f.shape, bar.shape)
    adjusted = _mixing_adjustment(h)
    total = np.zeros(shape)
    for lines in line_blocks(_oxygen_table(), shape):
        strength, center, width, first, second = _mixed(lines, h, bar, adjusted)
        total += np.sum(_pair(f**2, 2 * strength, center, width, first, second), axis=0)
    (line,) = line_blocks(_oxygen_table()[:1], (1,) * len(shape))
    strength, center, width, first, _ = _mixed(line, h, bar, adjusted)
    core = _core(f - center, width, OXYGEN_SPEED_RATIO * width, first)
    if core is not None:
        total += (strength * core)[0]
    debye = DEBYE_WIDTH * bar
    total += DEBYE_STRENGTH * debye / (f**2 + debye**2)
    return np.asarray(1.6097e11 * p * (f * h) ** 2 * total)


def _pair(
    square: Array, twice: Array, center: Array, width: Array, first: Array, second: Array
) -> Array:
    """Returns the profiles of lines and of their images at negative frequencies, as one fraction.

    With a centre c, width w and mixing y and g they are [w g + (f - c) y] / [(f - c)^2 + w^2] and
    [w g - (f + c) y] / [(f + c)^2 + w^2]. `square` is f^2, `twice` double the strength.
    """
    center_2, width_2 = center**2, width**2
    absorbing, mixing = twice * (width * second), twice * (center * first)
    below = square - (center_2 - width_2)
    np.square(below, out=below)
    below += 4 * (center_2 * width_2)
    profile = square * (absorbing + mixing)
    profile += (absorbing - mixing) * (center_2 + width_2)
    profile /= below
    return np.asarray(profile)


def _mixed(
    lines: Array, h: Array, bar: Array, adjusted: tuple[Array, Array]
) -> tuple[Array, Array, Array, Array, Array]:
    """Returns strengths, centres and widths of lines, and how they mix in first and second order.

    The arrays are (line, *state). `adjusted` is taken from the mixing of lines that overlap.
    """
    f0, _, _, width, *_, shift, shift_by_h, overlaps = lines
    strength, first, second = _unmixed(lines, h)
    first = bar * (first - overlaps * adjusted[0] / f0)
    second = 1 + bar**2 * overlaps * (second - adjusted[1] * strength)
    center = f0 + bar**2 * (shift + shift_by_h * (h - 1))
    return strength, center, width * bar, first, second


def _unmixed(lines: Array, h: Array) -> tuple[Array, Array, Array]:
    """Returns strengths over squared frequencies, and mixing of both orders before it is adjusted.

    The arrays are (line, *state), of `h`, 300 K over temperature, alone.
    """
    f0, strength, energy, _, y0, y1, g0, g1, *_ = lines
    k = h - 1
    return strength * np.exp(-energy * k) * h / f0**2, 0.99 * (y0 + y1 * k), g0 + g1 * k


def _mixing_adjustment(h: Array) -> tuple[Array, Array]:
    """Returns what keeps the sums over mixing lines of the 60 GHz band as they must be, (*state).

    The first is subtracted, over a line's frequency, from its mixing of first order; the second,
    times its strength, from that of second order.
    """
    number, bias, moment, square = (np.zeros(h.shape) for _ in range(4))
    for lines in line_blocks(_oxygen_table()[: OVERLAPPING.stop], h.shape):
        f0, width, overlaps = lines[0], lines[3], lines[-1]
        strength, first, second = _unmixed(lines, h)
        bias += np.sum(strength * (width + first * f0), axis=0)
        number += np.sum(overlaps * strength, axis=0)
        moment += np.sum(overlaps * strength * second, axis=0)
        square += np.sum(overlaps * strength**2, axis=0)
    bias += DEBYE_WIDTH * DEBYE_STRENGTH / 2
    return bias / number, moment / square


@cache
def _oxygen_table() -> Array:
    """Returns the oxygen lines with a last column that is 1 for those that overlap, else 0."""
    table = line_table(__file__, "r24_oxygen_lines.csv")
    overlaps = np.zeros((len(table), 1))
    overlaps[OVERLAPPING] = 1.0
    return np.hstack([table, overlaps])


# --- both ----------------------------------------------------------------------------------------


def _core(away: Array, width: Array, spread: Array, mixing: Array | float) -> Array | None:
    """Returns a line's profile less Lorentz's, where molecules of each speed have another width.

    It is 0 from ten widths on. `away` is the frequency less the line's, and `spread` what its width
    and shift vary by, all in GHz. The profile is quadratic in speed (Rosenkranz and Cimini 2019).
    """
    near = np.abs(away) < CORE * width
    if not near.any():
        return None
    from scipy.special import wofz  # takes 0.4 s

    away, width, spread, mixing = (
        np.broadcast_to(x, near.shape)[near] for x in (away, width, spread, mixing)
    )
    lorentz = width + 1j * away
    x = np.sqrt((lorentz - 1.5 * spread) / spread)
    profile = 2 * (1 - np.sqrt(np.pi) * x * wofz(1j * x)) / spread
    change = np.zeros(near.shape)
    change[near] = ((1 + 1j * mixing) * (profile - 1 / lorentz)).real
    return change


class Rosenkranz2024(Constituent):
    """Moist air by P. W. Rosenkranz's line-by-line microwave model of 2024.

    20 lines of water vapour that end 750 GHz from their centres, with the continuum of water in air
    and that of water in itself; 49 lines of oxygen, of which 37 mix, with its non-resonant
    spectrum; and nitrogen induced by pressure. Within ten half widths of the lines at 22.2, 118.75
    and 183.3 GHz profiles depend on the molecules' speed; there absorption steps by 2e-4 to 5e-4.

    Fitted to: the lines to spectra taken in laboratories, as its author chose them; water's
    continuum in itself to MT_CKD 4.1 (Mlawer and others; AER) at 296 K, in six rows of 10/cm.

    Validity: to 800 GHz, as its author states for water; above, it is refused. Its list has one of
    64 lines between 1000 and 1743 GHz, so that it is low by 1 % from 640 GHz, 2 % from 787 and
    3.4 % at 800: from 780 GHz on it warns. It warns below 3 hPa too, where it lacks Doppler
    broadening and Zeeman splitting.

    Validation: the check values of four climates to 1e-5, and plain sums over its lines, with an
    integral over speeds, to 1e-9 (tests/test_gas_models.py). pyrtlib 1.2, which approximates that
    integral, agrees to 1.2e-6 in 4000 states of 220 to 320 K and 100 to 1050 hPa.

    How it compares at 1013.25 hPa: at 94, 220, 410, 650 and 680 GHz it stands off "p676-13" by 0,
    -3, -5, -10 and -12 % at 20 degC and 44 %, by +10, +6, -2, -10 and -12 % at 35 degC and 90 %;
    and off MWL24, of 83 lines and another continuum, by -10, -7, -2, 0 and -1 % at 20 degC and
    44 %. The continua disagree, and nobody can say which is right.

    Mind: where the author left the exponents of a shift or a width by speed blank, they are 0, as
    in public ports of 2024. His programs of 2021 took the width's exponent: a difference below 2e-4
    in windows, and of 1 % beside 557 GHz at 225 K.

    References: P. W. Rosenkranz (2024), "Line-by-line microwave radiative transfer
    (non-scattering)", doi:10.21982/M81013. P. W. Rosenkranz, D. Cimini (2019), "Speed dependence of
    22- and 118-GHz line shapes for tropospheric remote sensing", IEEE Trans. Geosci. Remote Sens.
    57, 9702. M. A. Koshelev and others (2021), "Water vapor line profile at 183-GHz", J. Quant.
    Spectrosc. Radiat. Transf. 262, 107472.
    """

    name = "r24"
    contract = 1
    gas = True
    valid = (
        Span(
            "frequency_ghz",
            0.0,
            REFUSED_ABOVE_GHZ,
            "above, too many lines are not in its list",
            warn=(0.0, WARNED_ABOVE_GHZ),
            beyond="lines above 1000 GHz that are not in its list make it low by 2 to 3.4 %",
        ),
        Span(
            "pressure_hpa",
            0.0,
            np.inf,
            warn=(WARNED_BELOW_HPA, np.inf),
            beyond="it lacks Doppler broadening and Zeeman splitting",
        ),
    )

    class Params(Parameters):
        """It has none."""

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns the absorption, in parts of dry air and of vapour."""
        return attenuation(frequency_hz / 1e9, temperature_k, pressure_hpa, vapour_hpa).optics()

    def lines(
        self, temperature_k: float, pressure_hpa: float, vapour_hpa: float
    ) -> tuple[Array, float]:
        """Returns the lines of oxygen and water, and about their half width: 3 MHz/hPa."""
        del temperature_k, vapour_hpa
        names = ("r24_oxygen_lines.csv", "r24_water_lines.csv")
        centers = np.sort(np.concatenate([line_table(__file__, name)[:, 0] for name in names]))
        return centers * 1e9, 3e6 * pressure_hpa


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [Rosenkranz2024]
