"""Mean humidity and temperature by height in a CSV file, as a surface layer or a mast gives them.

Between rows above the ground both are straight in the logarithm of height, as in the neutral
surface layer (Monin and Obukhov 1954); where a row stands at 0 m or below, in height itself.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air import humidity
from thzcl.air.units import KELVIN
from thzcl.errors import FileError
from thzcl.graph import Values, frozen

Array = NDArray[np.float64]

LOWEST_M = 1.0  # the first row may lie so high, and serves below it
MOST_ROWS = 4096
STEPS = 1024  # of an octave of height in the kernels' look-up, as layers.cl has it
OCTAVES = 14  # below the highest row, where the lowest is at 0
SAME = 1e-9  # of humidity and of kelvins: departures up to here are those of rounding
COLDEST_K, WARMEST_K = 100.0, 400.0  # as of [atmosphere]
_HEIGHTS = {"height_m": 1.0, "height_km": 1e3}
_TEMPERATURES = {"temperature_k": 0.0, "temperature_degc": KELVIN}
_HUMIDITIES = ("absolute_humidity_g_m3", "relative_humidity_percent", "vapour_pressure_hpa")


@frozen
class Layers:
    """Rows of a profile, upwards: height in m, temperature in K, absolute humidity in g/m3."""

    height_m: Values
    temperature_k: Values
    absolute_humidity_g_m3: Values

    @property
    def span_m(self) -> tuple[float, float]:
        """Returns the heights of the lowest and the highest row; below 1 m it serves to the ground.

        The lower one is minus infinity where the lowest row serves below it.
        """
        low, high = float(self.height_m.array[0]), float(self.height_m.array[-1])
        return (-np.inf if low <= LOWEST_M else low), high

    def at(self, height_m: float) -> tuple[float, float]:
        """Returns temperature in K and absolute humidity in g/m3 at a height in m."""
        rows = self.temperature_k.array, self.absolute_humidity_g_m3.array
        kelvin, grams = (self._between(np.array([height_m]), row).item() for row in rows)
        return kelvin, grams

    def departures(self, temperature_k: float, absolute_humidity_g_m3: float) -> Departures | None:
        """Returns the rows as departures from mean air, or None if they are that air."""
        delta = self.absolute_humidity_g_m3.array / absolute_humidity_g_m3 - 1
        offset = self.temperature_k.array - temperature_k
        if np.abs(delta).max() <= SAME and np.abs(offset).max() <= SAME:
            return None
        return Departures(self.height_m, Values.of(delta), Values.of(offset))

    def _between(self, height_m: Array, row: Array) -> Array:
        return between(self.height_m.array, height_m, row)


@frozen
class Departures:
    """Departures of a profile's rows from mean air: humidity over its mean less 1, and kelvins."""

    height_m: Values
    delta: Values
    offset_k: Values

    @property
    def spans(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Returns the ranges of both, which include 0."""
        delta, offset = self.delta.array, self.offset_k.array
        moist = min(float(delta.min()), 0.0), max(float(delta.max()), 0.0)
        return moist, (min(float(offset.min()), 0.0), max(float(offset.max()), 0.0))

    def at(self, height_m: Array) -> tuple[Array, Array]:
        """Returns both departures at heights (...) in m."""
        z = self.height_m.array
        delta, offset = (
            between(z, height_m, row) for row in (self.delta.array, self.offset_k.array)
        )
        return delta, offset

    def look_up(self) -> LookUp:
        """Returns the kernels' look-up, which is straight between 1024 heights an octave.

        Where rows lie at or below 0, heights count from a little below the lowest of them.
        """
        low, high = float(self.height_m.array[0]), float(self.height_m.array[-1])
        base = min(low, 0.0)
        least = low if low > 0 else (high - base) * 2.0**-OCTAVES
        first, last = (math.floor(math.log2(height)) for height in (least, high - base))
        octave = np.arange(first, last + 1)[:, None]
        steps = (2.0**octave * (1 + np.arange(STEPS) / STEPS)).ravel()
        heights = np.append(steps, 2.0 ** (last + 1))
        start = int(np.searchsorted(heights, least, side="right")) - 1
        heights = heights[start:]
        return LookUp(base, float(heights[0]), high - base, np.array(self.at(heights + base)))


class LookUp(NamedTuple):
    """Departures (2, height) of humidity and temperature at heights above `base_m`.

    The heights have 1024 steps in each octave, from `lowest_m` on; what lies above `highest_m` is
    as it is there.
    """

    base_m: float
    lowest_m: float
    highest_m: float
    departures: Array


def between(rows_m: Array, height_m: Array, values: Array) -> Array:
    """Returns a profile's values (row,) at heights (...), those of its ends beyond them."""
    low = np.clip(np.searchsorted(rows_m, height_m, side="right") - 1, 0, len(rows_m) - 2)
    below, above = rows_m[low], rows_m[low + 1]
    level = np.clip(height_m, below, above)
    positive = below > 0
    one = np.where(positive, below, 1.0)
    logarithmic = np.log(np.where(positive, level, 1.0) / one) / np.log(
        np.where(positive, above, math.e) / one
    )
    part = np.where(positive, logarithmic, (level - below) / (above - below))
    return np.asarray(values[low] + part * (values[low + 1] - values[low]))


def read(path: Path) -> Layers:
    """Returns the profile in a CSV file, whose first line names the columns.

    They are height_m or height_km, temperature_k or temperature_degc, and one of
    absolute_humidity_g_m3, relative_humidity_percent and vapour_pressure_hpa; others are not used.
    Raises FileError, with the line, for what is no profile.
    """
    text = files.read_text(path, files.PROFILE)
    lines = [
        (number, next(csv.reader([line]), []))
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    ]
    if len(lines) < 3:
        raise FileError(f"{path}: has no names of columns with two rows or more; give them")
    if len(lines) > MOST_ROWS + 1:
        raise FileError(f"{path}: {len(lines) - 1} rows; give at most {MOST_ROWS}")
    at, names = lines[0][0], [name.strip() for name in lines[0][1]]
    chosen = [
        _column(f"{path}:{at}", what, names, choices)
        for what, choices in (
            ("height", tuple(_HEIGHTS)),
            ("temperature", tuple(_TEMPERATURES)),
            ("humidity", _HUMIDITIES),
        )
    ]
    rows = np.array([_row(path, number, cells, names, chosen) for number, cells in lines[1:]])
    height, kelvin = rows[:, 0] * _HEIGHTS[chosen[0]], rows[:, 1] + _TEMPERATURES[chosen[1]]
    _refuse(path, lines, np.concatenate([[False], np.diff(height) <= 0]), "heights must ascend")
    cold = ~((kelvin >= COLDEST_K) & (kelvin <= WARMEST_K))
    _refuse(path, lines, cold, f"{chosen[1]}: must be {COLDEST_K:g} to {WARMEST_K:g} K")
    _refuse(path, lines, ~(rows[:, 2] >= 0), f"{chosen[2]}: must not be negative")
    grams = rows[:, 2]
    if chosen[2] == "relative_humidity_percent":
        vapour = humidity.vapour_pressure_from_relative(grams, kelvin)
        grams = humidity.absolute_humidity(vapour, kelvin)
    elif chosen[2] == "vapour_pressure_hpa":
        grams = humidity.absolute_humidity(grams, kelvin)
    return Layers(*map(Values.of, (height, kelvin, grams)))


def _column(place: str, what: str, names: list[str], choices: tuple[str, ...]) -> str:
    """Returns the one column of a kind. Raises FileError."""
    found = [name for name in names if name in choices]
    if len(found) != 1:
        many = "no column" if not found else f"{len(found)} columns"
        raise FileError(f"{place}: {many} of {what}; give one of {', '.join(choices)}")
    return found[0]


def _row(
    path: Path, line: int, cells: list[str], names: list[str], chosen: list[str]
) -> list[float]:
    """Returns the finite numbers of a row in the chosen columns. Raises FileError."""
    if len(cells) != len(names):
        text = f"{len(cells)} columns, the first line names {len(names)}"
        raise FileError(f"{path}:{line}: {text}; give every line as many")
    numbers = []
    for name in chosen:
        cell = cells[names.index(name)].strip()
        try:
            number = float(cell)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            text = f'{name}: "{cell[:40]}" is no finite number; mend or remove the line'
            raise FileError(f"{path}:{line}: {text}")
        numbers.append(number)
    return numbers


def _refuse(
    path: Path, lines: list[tuple[int, list[str]]], wrong: NDArray[np.bool_], words: str
) -> None:
    """Raises FileError for the first row that is wrong."""
    if wrong.any():
        raise FileError(f"{path}:{lines[1 + int(np.argmax(wrong))][0]}: {words}; mend the line")
