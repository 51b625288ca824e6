"""Profiles of the air by height: the six model atmospheres of AFGL, and those in files."""

from __future__ import annotations

import csv
import io
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air import humidity
from thzcl.errors import FileError
from thzcl.graph import Values, frozen

Array = NDArray[np.float64]

NAMES = (
    "us-standard",
    "tropical",
    "midlatitude-summer",
    "midlatitude-winter",
    "subarctic-summer",
    "subarctic-winter",
)
LOWEST_M = 1.0  # the first row may lie so high, and serves below it
WIDEST_M = 10e3  # the most between two rows: lines in between would mean nothing
DRIEST_HPA = 1e-12  # vapour pressures below count as this, whose logarithm is finite
COLDEST_K, WARMEST_K = 100.0, 400.0  # as of [atmosphere]
_HEIGHTS = {"height_m": 1.0, "height_km": 1e3}
_MEASURES = (
    "relative_humidity_percent",
    "absolute_humidity_g_m3",
    "vapour_pressure_hpa",
    "h2o_ppmv",  # parts of a million by volume, that is, of the total pressure
)


class State(NamedTuple):
    """Air at some heights: total pressure in hPa, temperature in K, vapour pressure in hPa."""

    pressure_hpa: Array
    temperature_k: Array
    vapour_hpa: Array


@frozen
class Profile:
    """Rows of a profile, upwards; temperature and logarithms of pressures are straight between."""

    name: str
    height_m: Values
    pressure_hpa: Values
    temperature_k: Values
    vapour_hpa: Values

    @property
    def top_m(self) -> float:
        """Returns the height of the last row, m."""
        return float(self.height_m.array[-1])

    def at(self, height_m: Array | float) -> State:
        """Returns the air at some heights, that of the first row below it."""
        z = self.height_m.array
        vapour = np.maximum(self.vapour_hpa.array, DRIEST_HPA)
        log_p, log_e = (
            np.interp(height_m, z, np.log(row)) for row in (self.pressure_hpa.array, vapour)
        )
        kelvin = np.interp(height_m, z, self.temperature_k.array)
        return State(np.exp(log_p), np.asarray(kelvin), np.exp(log_e))


@cache
def shipped(name: str) -> Profile:
    """Returns one of the AFGL model atmospheres.

    They are those of Anderson, Clough, Kneizys, Chetwynd and Shettle (1986), "AFGL atmospheric
    constituent profiles", AFGL-TR-86-0110, tables 1a to 1f.
    """
    text = (Path(__file__).parent / "afgl_profiles.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = [row for row in csv.DictReader(lines) if row["profile"] == name]
    km, hpa, kelvin, ppmv = (
        np.array([float(row[key]) for row in rows])
        for key in ("height_km", "pressure_hpa", "temperature_k", "h2o_ppmv")
    )
    arrays = km * 1e3, hpa, kelvin, ppmv * 1e-6 * hpa
    return Profile(name, *map(Values.of, arrays))


def read(path: Path, above_m: float = 0.0) -> Profile:
    """Returns the profile in a CSV file, which must reach above a height.

    Its first line names the columns: height_m or height_km, pressure_hpa, temperature_k and one
    humidity; other columns are not used. Raises FileError, with the line, for what is no profile.
    """
    numbered = [
        (number, line)
        for number, line in enumerate(files.read_text(path, files.PROFILE).splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    ]
    if not numbered:
        raise FileError(f"{path}: is empty; {files.PROFILE.give}")
    cells = [next(csv.reader(io.StringIO(line)), []) for _, line in numbered]
    lines = [number for number, _ in numbered]
    height, measure = _columns(path, lines[0], [name.strip() for name in cells[0]])
    names = [name.strip() for name in cells[0]]
    wanted = [names.index(key) for key in (height, "pressure_hpa", "temperature_k", measure)]
    rows = [
        _row(path, line, row, names, wanted) for line, row in zip(lines[1:], cells[1:], strict=True)
    ]
    if len(rows) < 2:
        raise FileError(f"{path}: {len(rows)} rows; a profile has two or more")
    table = np.array(rows)
    metres, hpa, kelvin = table[:, 0] * _HEIGHTS[height], table[:, 1], table[:, 2]
    vapour = _vapour_hpa(measure, table[:, 3], kelvin, hpa)
    _refuse(path, lines[1:], metres, State(hpa, kelvin, vapour))
    if metres[-1] <= above_m:
        text = f"ends at {metres[-1]:g} m, below the scene's {above_m:g} m; give rows above"
        raise FileError(f"{path}:{lines[-1]}: {text}")
    return Profile(path.name, *map(Values.of, (metres, hpa, kelvin, vapour)))


def _vapour_hpa(measure: str, values: Array, kelvin: Array, hpa: Array) -> Array:
    """Returns the vapour pressure, hPa, from a measure of humidity."""
    if measure == "relative_humidity_percent":
        return humidity.vapour_pressure_from_relative(values, kelvin)
    if measure == "absolute_humidity_g_m3":
        return humidity.vapour_pressure_from_absolute(values, kelvin)
    return values * 1e-6 * hpa if measure == "h2o_ppmv" else values


def _columns(path: Path, line: int, names: list[str]) -> tuple[str, str]:
    """Returns the names of the columns of height and of humidity. Raises FileError."""
    found = []
    for what, choices in (("height", tuple(_HEIGHTS)), ("humidity", _MEASURES)):
        given = [name for name in choices if name in names]
        if len(given) != 1:
            many = "no column" if not given else f"{len(given)} columns"
            words = f"{many} of {what}; give one of {', '.join(choices)}"
            raise FileError(f"{path}:{line}: {words}")
        found += given
    for name in ("pressure_hpa", "temperature_k"):
        if name not in names:
            raise FileError(f"{path}:{line}: no column {name}; the first line names the columns")
    twice = next((name for name in names if name and names.count(name) > 1), None)
    if twice is not None:
        raise FileError(f"{path}:{line}: two columns {twice}; give one")
    return found[0], found[1]


def _row(
    path: Path, line: int, cells: list[str], names: list[str], wanted: list[int]
) -> list[float]:
    """Returns the numbers of a row in the wanted columns, all of them finite. Raises FileError."""
    if len(cells) != len(names):
        text = f"{len(cells)} columns, the first line names {len(names)}"
        raise FileError(f"{path}:{line}: {text}; give every line as many")
    numbers = []
    for column in wanted:
        try:
            number = float(cells[column])
        except ValueError:
            shown = cells[column].strip()[:40] or "a gap"
            text = f"{names[column]}: {shown}, not a number; mend or remove the line"
            raise FileError(f"{path}:{line}: {text}") from None
        if not np.isfinite(number):
            text = f"{names[column]}: not finite; mend or remove the line"
            raise FileError(f"{path}:{line}: {text}")
        numbers.append(number)
    return numbers


def _refuse(path: Path, lines: list[int], height_m: Array, air: State) -> None:
    """Raises FileError for the first row of a profile that cannot be."""
    apart, hpa, kelvin = np.diff(height_m), air.pressure_hpa, air.temperature_k
    later = np.concatenate([[False], apart <= 0])
    far = np.concatenate([[False], apart > WIDEST_M])
    denser = np.concatenate([[False], np.diff(hpa) >= 0])
    low, high = COLDEST_K, WARMEST_K
    troubles = (
        (later, "heights must ascend; sort the rows"),
        (far, f"a gap of more than {WIDEST_M / 1e3:g} km to the row before; give rows between"),
        (~(hpa > 0), "pressure must be above 0"),
        (denser, "pressure must fall with height; mend the line"),
        (~((kelvin >= low) & (kelvin <= high)), f"temperature_k outside {low:g} to {high:g} K"),
        (~(air.vapour_hpa >= 0), "humidity must not be negative"),
        (~(air.vapour_hpa <= hpa), "more vapour than total pressure; mend the humidity"),
    )
    for wrong, words in troubles:
        if wrong.any():
            raise FileError(f"{path}:{lines[int(np.argmax(wrong))]}: {words}")
    if height_m[0] > LOWEST_M:
        text = f"begins at {height_m[0]:g} m, above the scene's ground (z = 0)"
        raise FileError(f"{path}:{lines[0]}: {text}; give a row at 0 m")
