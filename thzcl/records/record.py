"""From rows to a record: files are joined and rows set in even steps of time.

Gaps, repeated stamps and spikes are found and counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thzcl.air.humidity import GAS_CONSTANT_OF_VAPOUR
from thzcl.errors import RecordError
from thzcl.records.columns import BY_SIZE, ROLES
from thzcl.records.reading import Rows, read

Array = NDArray[np.float64]

SHORTEST = 1024  # samples: three decades of frequency, of which the inertial range takes one
JOIN_S = 10.0  # files are contiguous if no longer a time lies between them
MOST_MISSING = 0.2  # of the samples
MOST_DISORDER = 0.01  # of the stamps may go backwards
SLOWEST_M_S = 0.1  # mean wind: below, there is no wind run
WETTEST_G_M3 = 100.0  # mean humidity: saturation at 52 degrees
# A spike departs from the running median of so many samples by so many typical steps. The typical
# step is the median of the steps between neighbours, over 0.6745 sqrt 2: the sigma of white noise.
# Measured gusts of vapour stay below both.
SPIKES = ((3, 12.0), (5, 20.0))
MEASURED = ("h2o", "Ts", "Ux", "Uy", "Uz", "speed")  # columns that are searched for spikes
SONIC_HUMIDITY = 0.32  # sonic temperature is T (1 + 0.32 e/p): Kaimal and Gaynor (1991)


@dataclass(frozen=True)
class Record:
    """A hygrometer's record in even steps of time, NaN where nothing or a spike was measured.

    `humidity` (n,) is in g/m3; `wind` (component, n) in m/s, with one component where only a speed
    was measured; `temperature` (n,) in K, corrected for humidity, or None; `pressure_hpa` is its
    mean, or None. The counts are of what was found in the files.
    """

    files: tuple[str, ...]
    station: str
    start: float  # seconds from 1970, or of the file's own clock
    dated: bool
    rate_hz: float
    humidity: Array
    wind: Array
    temperature: Array | None
    pressure_hpa: float | None
    gaps: int  # samples without humidity, in all
    repeats: int
    out_of_order: int
    spikes: dict[str, int]  # by column
    notes: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Returns the number of samples, missing ones included."""
        return len(self.humidity)

    @property
    def wind_speed_m_s(self) -> float:
        """Returns the magnitude of the mean wind vector, or the mean of a speed."""
        return float(np.linalg.norm(np.nanmean(self.wind, axis=1)))


@dataclass(frozen=True)
class _Joined:
    """Rows of all files, one after the other, in order of time."""

    parts: Sequence[Rows]
    time_s: Array
    row: NDArray[np.int64]  # of the files together, before ordering
    repeats: int
    out_of_order: int

    def place(self, at: int) -> str:
        """Returns file, line and column of a time stamp, for messages."""
        row = int(self.row[at])
        for part in self.parts:
            if row < len(part.time_s):
                break
            row -= len(part.time_s)
        return (
            f"{part.layout.path}:{part.layout.first_line + row}: column {part.columns['time'].name}"
        )


def load(paths: Sequence[Path], columns: str = "") -> Record:
    """Returns the record in one file, or in several contiguous files of one station.

    `columns` is as in columns.find. Raises RecordError if the files hold no record; the message
    says file, line, column and what was expected.
    """
    joined = _join([read(path, columns) for path in paths])
    rate_hz, index = _clock(joined)
    first = joined.parts[0]
    values = {role: _even(joined, role, index) for role in first.values}
    units = {role: first.columns[role].assumed for role in values}
    for role, unit in units.items():
        if unit == BY_SIZE:
            units[role] = _unit_by_size(role, values[role])
            factor, offset = ROLES[role].units[units[role].lower()]
            values[role] = factor * values[role] + offset
    _check(first, values, rate_hz)
    gaps = int(np.isnan(values["h2o"]).sum())
    spikes = {
        first.columns[role].name: _remove_spikes(values[role])
        for role in MEASURED
        if role in values
    }
    components = (
        [role for role in ("Ux", "Uy", "Uz") if role in values] if "Ux" in values else ["speed"]
    )
    wind = np.stack([values[role] for role in components])
    pressure_hpa = float(np.nanmean(values["pressure"])) if "pressure" in values else None
    temperature = None
    if "Ts" in values:
        temperature = true_temperature(values["Ts"], values["h2o"], pressure_hpa or 1013.25)
    record = Record(
        files=tuple(str(part.layout.path) for part in joined.parts),
        station=first.layout.station,
        start=float(joined.time_s[0]),
        dated=first.dated,
        rate_hz=rate_hz,
        humidity=values["h2o"],
        wind=wind,
        temperature=temperature,
        pressure_hpa=pressure_hpa,
        gaps=gaps,
        repeats=len(joined.time_s) - len(index) + joined.repeats,
        out_of_order=joined.out_of_order,
        spikes=spikes,
        notes=tuple(_notes(first, units)),
    )
    if not record.wind_speed_m_s >= SLOWEST_M_S:
        names = ", ".join(first.columns[role].name for role in components)
        raise RecordError(
            f"{first.layout.path}:{first.layout.first_line}: column {names}: mean wind of "
            f"{record.wind_speed_m_s:.3g} m/s; expected at least {SLOWEST_M_S:g} m/s, "
            "for time to become distance"
        )
    return record


def _notes(rows: Rows, units: Mapping[str, str]) -> Iterator[str]:
    """Yields what was taken for granted; `units` are those assumed, by role, or empty."""
    for role, unit in units.items():
        column = rows.columns[role]
        if column.assumed == BY_SIZE:
            say = f"if it is another, name it with --columns {role}={column.name}:UNIT"
            yield f"column {column.name} names no unit: taken as {unit} by its size; {say}"
        elif unit:
            yield f"column {column.name} names no unit: taken as {unit}"
    if "Ux" not in rows.values:
        yield (
            "wind is a speed without direction: its mean exceeds the mean vector, "
            "and so does the wind run"
        )
    if "Ts" in rows.values and "pressure" not in rows.values:
        yield "no pressure: 1013.25 hPa taken to correct sonic temperature for humidity"


def true_temperature(sonic_k: Array, humidity_g_m3: Array, pressure_hpa: float) -> Array:
    """Returns air temperature in K for a sonic temperature, humidity in g/m3 and pressure.

    Kaimal and Gaynor (1991): Ts = T (1 + 0.32 e/p), with e = rho R T; the quadratic equation is
    solved for T without cancellation.
    """
    a = SONIC_HUMIDITY * humidity_g_m3 * GAS_CONSTANT_OF_VAPOUR / 1e5 / pressure_hpa
    return np.asarray(2 * sonic_k / (1 + np.sqrt(1 + 4 * a * sonic_k)))


def _join(parts: Sequence[Rows]) -> _Joined:
    """Returns the rows of all files in order of time, each stamp once.

    Raises RecordError if the files do not belong together.
    """
    parts = sorted(parts, key=lambda part: float(part.time_s[0]))
    for part in parts:
        _check_stamps(part)
    for before, after in pairwise(parts):
        place = f"{after.layout.path}:{after.layout.first_line}"
        if before.layout.station != after.layout.station or _assumed(before) != _assumed(after):
            text = f"of another station, or with other columns, than {before.layout.path}"
            raise RecordError(
                f"{place}: column {after.columns['time'].name}: {text}; analyse them apart"
            )
        between = float(after.time_s[0] - before.time_s.max())
        if between > JOIN_S:
            text = f"begins {between:.6g} s after {before.layout.path} ends; expected at most"
            raise RecordError(
                f"{place}: column {after.columns['time'].name}: {text} {JOIN_S:g} s between files; "
                "analyse them apart"
            )
    time_s = np.concatenate([part.time_s for part in parts])
    out_of_order = sum(int((np.diff(part.time_s) < 0).sum()) for part in parts)
    row = np.argsort(time_s, kind="stable")
    time_s = time_s[row]
    fresh = np.concatenate([[True], np.diff(time_s) > 0])
    if fresh.sum() < (1 - MOST_MISSING) * len(fresh) and len(parts) == 1:
        at = int(row[np.argmin(fresh)])
        raise RecordError(
            f"{_stamp(parts[0], at)}: {(~fresh).sum()} time stamps repeat those before; "
            "expected stamps as fine as the samples"
        )
    return _Joined(parts, time_s[fresh], row[fresh], int((~fresh).sum()), out_of_order)


def _assumed(part: Rows) -> dict[str, str]:
    """Returns the units that are assumed, by role, for the columns that hold values."""
    return {role: part.columns[role].assumed for role in part.values}


def _stamp(part: Rows, at: int) -> str:
    """Returns file, line and column of a row's time stamp, for messages."""
    return f"{part.layout.path}:{part.layout.first_line + at}: column {part.columns['time'].name}"


def _check_stamps(part: Rows) -> None:
    """Raises RecordError if stamps of a file are missing, or often go backwards."""
    missing = np.flatnonzero(np.isnan(part.time_s))
    if missing.size:
        raise RecordError(
            f"{_stamp(part, int(missing[0]))}: no time stamp; expected one in every row"
        )
    backwards = np.flatnonzero(np.diff(part.time_s) < 0)
    if backwards.size > max(MOST_DISORDER * len(part.time_s), 1):
        raise RecordError(
            f"{_stamp(part, int(backwards[0]) + 1)}: time goes backwards here and in "
            f"{backwards.size - 1} other rows; expected ascending time stamps"
        )


def _clock(joined: _Joined) -> tuple[float, NDArray[np.int64]]:
    """Returns samples a second, and the number of the time step of each row.

    Raises RecordError if there are too few samples, or not one rate throughout.
    """
    steps = np.diff(joined.time_s)
    first = joined.parts[0]
    if len(steps) < SHORTEST - 1:
        end = first.layout.first_line + len(first.time_s) - 1
        text = f"ends after {len(steps) + 1} samples; the spectrum needs at least {SHORTEST}"
        raise RecordError(f"{first.layout.path}:{end}: column {first.columns['time'].name}: {text}")
    typical = float(np.median(steps))
    edges = np.linspace(0, len(steps), 11).astype(int)
    for start, stop in pairwise(edges):
        own = float(np.median(steps[start:stop]))
        if not 0.8 < own / typical < 1.25:
            wrong = start + int(
                np.argmax(
                    ~((steps[start:stop] > 0.8 * typical) & (steps[start:stop] < 1.25 * typical))
                )
            )
            raise RecordError(
                f"{joined.place(wrong + 1)}: steps of {own:.6g} s from here on, "
                f"{typical:.6g} s elsewhere; expected one rate throughout"
            )
    counts = np.rint(steps / typical)
    step = float(steps.sum() / max(counts.sum(), 1))  # stamps may be rounded
    uneven = np.abs(steps / step - counts) > 0.4
    if not 0.8 < step / typical < 1.25 or uneven.mean() > MOST_DISORDER:
        text = f"steps of time are no multiples of {typical:.6g} s; expected one rate throughout"
        raise RecordError(f"{joined.place(int(np.argmax(uneven)) + 1)}: {text}")
    place = np.rint((joined.time_s - joined.time_s[0]) / step).astype(np.int64)
    if place[-1] + 1 > len(place) / (1 - MOST_MISSING):
        at = int(np.argmax(steps))
        raise RecordError(
            f"{joined.place(at + 1)}: {place[-1] + 1 - len(place)} of {place[-1] + 1} samples are "
            f"missing, {steps[at]:.6g} s of them before here; "
            f"expected {100 * (1 - MOST_MISSING):g} % of them"
        )
    return round(1 / step, 6), place[np.diff(place, prepend=-1) > 0]


def _even(joined: _Joined, role: str, index: NDArray[np.int64]) -> Array:
    """Returns a column in even steps of time, NaN where there is no row."""
    values = np.concatenate([part.values[role] for part in joined.parts])[joined.row]
    even = np.full(int(index[-1]) + 1, np.nan)
    step = (joined.time_s[-1] - joined.time_s[0]) / index[-1]
    # Of two rows at one step of time the later in the file is written over by the earlier.
    even[np.rint((joined.time_s - joined.time_s[0]) / step).astype(np.int64)[::-1]] = values[::-1]
    return even


def _unit_by_size(role: str, values: Array) -> str:
    """Returns the unit that values of a column without one most likely have, by their size."""
    typical = float(np.nanmedian(values)) if np.isfinite(values).any() else 0.0
    if role == "Ts":
        return "degC" if typical < 150 else "K"
    return "Pa" if typical > 2000 else "kPa" if typical < 200 else "hPa"


def _check(rows: Rows, values: dict[str, Array], rate_hz: float) -> None:
    """Raises RecordError if a column has too many gaps, is constant, or cannot be of air."""
    for role, found in values.items():
        name = rows.columns[role].name
        place = f"{rows.layout.path}:{rows.layout.first_line}: column {name}"
        missing = float(np.isnan(found).mean())
        if missing > MOST_MISSING:
            raise RecordError(
                f"{place}: {100 * missing:.3g} % of its values are missing; "
                f"expected {MOST_MISSING:.0%} at most"
            )
        if role in ("h2o", "Ts") and np.nanmax(found) - np.nanmin(found) < 1e-9 * np.nanmax(
            np.abs(found), initial=1.0
        ):
            text = f"holds {np.nanmean(found):.6g} throughout; expected a signal that fluctuates"
            raise RecordError(f"{place}: {text}")
    first = f"{rows.layout.path}:{rows.layout.first_line}: column"
    mean = float(np.nanmean(values["h2o"]))
    if not 0 < mean < WETTEST_G_M3:
        raise RecordError(
            f"{first} {rows.columns['h2o'].name}: a mean of {mean:.4g} g/m3 at {rate_hz:g} Hz; "
            f"expected between 0 and {WETTEST_G_M3:g} g/m3: is its unit right?"
        )
    if "Ts" in values and not 150 < (kelvin := float(np.nanmean(values["Ts"]))) < 400:
        raise RecordError(
            f"{first} {rows.columns['Ts'].name}: a mean of {kelvin:.4g} K; "
            "expected that of air: is its unit right?"
        )


def _remove_spikes(values: Array) -> int:
    """Sets spikes to NaN, in place, and returns how many there were."""
    present = np.flatnonzero(np.isfinite(values))
    found = values[present]
    typical = float(np.median(np.abs(np.diff(found)))) / 0.6745 / np.sqrt(2)
    if typical == 0:  # steps of the converter outweigh the signal's own
        typical = float(np.std(np.diff(found))) / np.sqrt(2)
    spiky = np.zeros(len(found), dtype=np.bool_)
    for window, threshold in SPIKES:
        spiky |= np.abs(found - _running_median(found, window)) > threshold * typical
    values[present[spiky]] = np.nan
    return int(spiky.sum())


def _running_median(values: Array, window: int) -> Array:
    """Returns the median of each sample's `window` neighbours, itself included."""
    half = window // 2
    padded = np.pad(values, half, mode="reflect")
    shifted = [padded[start : start + len(values)] for start in range(window)]
    if window == 3:
        low, middle, high = shifted
        return np.asarray(
            np.maximum(np.minimum(low, middle), np.minimum(np.maximum(low, middle), high))
        )
    return np.asarray(np.partition(np.stack(shifted), half, axis=0)[half])
