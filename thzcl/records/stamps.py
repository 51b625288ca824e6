"""Time stamps as loggers, spreadsheets and colleagues write them, turned into seconds.

Dates in ISO, US and German order, with time zones, with days of the year; seconds, milliseconds
and days since some day; date and time in one column or in several.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DAY_S = 86400.0
SLOWEST_HZ, FASTEST_HZ = 0.5, 100.0  # rates of a fast hygrometer
# What a number without a unit counts: (name, seconds), the likeliest first.
COUNTED = (
    ("s", 1.0), ("ms", 1e-3), ("days", DAY_S), ("us", 1e-6), ("ns", 1e-9), ("hours", 3600.0),
    ("minutes", 60.0),
)  # fmt: skip
# The first of January 1970 in days of: spreadsheets, MATLAB, Julian days.
EPOCHS_D = ((20_000, 80_000, 25569.0), (700_000, 800_000, 719529.0), (2.4e6, 2.5e6, 2440587.5))
EXAMPLE = "expected seconds, or one like 2012-06-07 12:45:00.05"
_PARTED = (
    r"^\s*(\d{1,4})[/.\-](\d{1,2})[/.\-](\d{1,4})"
    r"(?:[\sT,]+(\d{1,2}):(\d{1,2})(?::(\d{1,2}(?:[.,]\d*)?))?)?\s*([AaPp][Mm])?\s*$"
)
_CLOCK = r"^\s*(\d{1,2}):(\d{1,2})(?::(\d{1,2}(?:[.,]\d*)?))?\s*([AaPp][Mm])?\s*$"
_ORDINAL = r"^\s*(\d{4})-?(\d{3})[\sT]+(\d{1,2}):(\d{1,2})(?::(\d{1,2}(?:\.\d*)?))?\s*$"
_ZONE = r"\s*(?:Z|UTC|GMT|[+-]\d{2}:?\d{2})\s*$"


class StampError(ValueError):
    """A cell is no time stamp; `at` is its place among the cells."""

    def __init__(self, at: int, cell: str) -> None:
        super().__init__(f'"{cell[:40]}" is not a time stamp; {EXAMPLE}')
        self.at = at


@dataclass
class Clock:
    """Reads stamps chunk by chunk and remembers what they turned out to be.

    `dated` is whether seconds count from 1970; `numbers` whether the cells are numbers, whose unit
    is found once all are known. Where day and month may be exchanged, `other` holds the seconds of
    the other reading.
    """

    dated: bool = False
    numbers: bool = False
    told: str = ""
    months_first: bool | None = None
    chunks: list[Array] = field(default_factory=list)
    other: list[Array] = field(default_factory=list)

    def read(self, parts: Mapping[str, Any]) -> None:
        """Adds a chunk of cells by part of time (pandas series of text). Raises StampError."""
        if set(parts) == {"time"}:
            self._one(parts["time"])
        elif {"date", "clock"} <= set(parts):
            cells = parts["date"].astype(str).str.strip() + " " + parts["clock"].astype(str)
            self._dates(_undotted(cells))
        else:
            self.chunks.append(self._split_up(parts))

    def _one(self, cells: Any) -> None:
        """Adds a chunk of one column: numbers, dates, or times of day."""
        import pandas as pd

        first = str(cells.iloc[0]).strip()
        compact = re.fullmatch(r"(19|20)\d{10}(\d\d(\.\d+)?)?", first)
        if (self.numbers or not self.chunks) and not compact:
            numbers = pd.to_numeric(cells, errors="coerce").to_numpy(np.float64)
            if np.isfinite(numbers[0]) or self.numbers:
                _check(numbers, cells)
                self.numbers = True
                self.chunks.append(numbers)
                return
        if compact:
            cells = cells.astype(str).str.replace(
                r"^(\d{4})(\d\d)(\d\d)(\d\d)(\d\d)", r"\1-\2-\3T\4:\5:", regex=True
            ).str.replace(r":$", ":00", regex=True)  # fmt: skip
        self._dates(cells)

    def _dates(self, cells: Any) -> None:
        """Adds a chunk of dates with times, or of times of day."""
        import pandas as pd

        if self.months_first is None:
            found = pd.to_datetime(cells, format="ISO8601", utc=True, errors="coerce")
            if not found.isna().any():
                self.dated, self.told = True, self.told or "ISO date"
                self.chunks.append(_epoch(found))
                return
        plain = cells.astype(str).str.strip().str.replace(_ZONE, "", regex=True)
        for pattern, read in ((_PARTED, self._parted), (_CLOCK, self._clock), (_ORDINAL, _ordinal)):
            groups = plain.str.extract(pattern)
            groups.attrs["dotted"] = "." in str(plain.iloc[0])[:5]
            if groups[0].notna().mean() > 0.5:
                seconds = read(groups)
                _check(seconds, cells)
                if pattern != _CLOCK:
                    self.dated, self.told = True, self.told or "day of the year"
                self.chunks.append(seconds)
                return
        self.chunks.append(self._by_pandas(plain, cells))

    def _by_pandas(self, plain: Any, cells: Any) -> Array:
        """Returns stamps of other forms, with the names of months, as pandas reads them."""
        import warnings

        import pandas as pd

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = pd.to_datetime(plain, errors="coerce", utc=True, format="mixed")
        seconds = _epoch(found)
        _check(seconds, cells)
        self.dated, self.told = True, "date"
        return seconds

    def _parted(self, groups: Any) -> Array:
        """Returns seconds of dates in numbers: year first, or day and month in either order."""
        import pandas as pd

        a, b, c, hour, minute = (
            pd.to_numeric(groups[n], errors="coerce").to_numpy(np.float64) for n in range(5)
        )
        second = _seconds_of(groups[5])
        clock = _of_day(hour, minute, second, groups[6])
        if np.nanmax(a) > 31:
            self.told = "date, year first"
            return _civil(a, b, c) + clock
        day_first, month_first = _civil(c, b, a) + clock, _civil(c, a, b) + clock
        dotted = bool(groups.attrs.get("dotted"))
        self._settle(a, b, dotted)
        self.other.append(day_first if self.months_first else month_first)
        return month_first if self.months_first else day_first

    def _settle(self, a: Array, b: Array, dotted: bool) -> None:
        """Finds whether months stand before days, from numbers that cannot be months."""
        if np.nanmax(a) > 12 or dotted:
            self.months_first, self.told = False, "date, day first"
        elif np.nanmax(b) > 12:
            self.months_first, self.told = True, "date, month first"
        elif self.months_first is None:
            self.months_first, self.told = True, "date, month first?"

    def _clock(self, groups: Any) -> Array:
        """Returns seconds of times of day."""
        import pandas as pd

        hour, minute = (pd.to_numeric(groups[n]).to_numpy(np.float64) for n in range(2))
        self.told = "time of day"
        return _of_day(hour, minute, _seconds_of(groups[2]), groups[3])

    def _split_up(self, parts: Mapping[str, Any]) -> Array:
        """Returns seconds of a time in several columns of numbers."""
        import pandas as pd

        found = {}
        for part, cells in parts.items():
            if part == "date":
                own = Clock(months_first=self.months_first)
                own.read({"time": cells})
                found[part], self.months_first = own.chunks[0], own.months_first
                continue
            found[part] = pd.to_numeric(cells, errors="coerce").to_numpy(np.float64)
            _check(found[part], cells)
        self.told, zero = (
            "in columns " + ", ".join(parts),
            np.zeros(len(next(iter(found.values())))),
        )
        seconds = found.get("date", zero)
        self.dated = "date" in found or "year" in found
        if "year" in found:
            year = np.where(found["year"] < 100, 2000 + found["year"], found["year"])
            seconds = _civil(year, found.get("month", zero + 1), found.get("day", zero + 1))
        if "doy" in found:
            seconds = seconds + (found["doy"] - 1) * DAY_S
        hhmm = found.get("hhmm", zero)
        seconds = seconds + 3600 * np.floor(hhmm / 100) + 60 * (hhmm % 100)
        seconds = seconds + 3600 * found.get("hour", zero) + 60 * found.get("minute", zero)
        return np.asarray(
            seconds + found.get("second", zero) + 1e-3 * found.get("millisecond", zero)
        )

    def seconds(self, unit: str, factor: float, rate_hz: float | None) -> tuple[Array, list[str]]:
        """Returns all stamps in seconds, and notes on how they were understood.

        `unit` and `factor` are those of the column, if it names one.
        """
        time, notes = np.concatenate(self.chunks), []
        if self.numbers:
            time, told = self._counted(time, unit, factor, rate_hz)
            notes += told
        elif self.told == "date, month first?":
            other = np.concatenate(self.other)
            if np.all(np.isfinite(other)) and np.ptp(other) < np.ptp(time):
                time, self.told = other, "date, day first"
            else:
                self.told = "date, month first"
                notes.append("dates such as 03/07 are taken with the month first")
        elif self.told == "time of day":
            time = time + DAY_S * np.cumsum(np.diff(time, prepend=time[0]) < -DAY_S / 2)
        return time, notes

    def _counted(
        self, time: Array, unit: str, factor: float, rate_hz: float | None
    ) -> tuple[Array, list[str]]:
        """Returns numbers as seconds, in the unit that gives a fast hygrometer's rate."""
        steps = np.diff(time)
        step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
        name, scale = unit or "s", factor
        if not unit and step > 0 and rate_hz is None:
            fitting = [(n, s) for n, s in COUNTED if SLOWEST_HZ <= 1 / (step * s) <= FASTEST_HZ]
            whole = step == 1.0 and len(time) > 2 * len(np.unique(time[:1000]))
            name, scale = ("s", 1.0) if whole or not fitting else fitting[0]
        self.told = f"number of {name}"
        notes = [] if name == "s" or unit else [f"time is taken in {name}, from its steps"]
        offset, typical = 0.0, float(np.median(time))
        if scale == DAY_S:
            offset = next((o for low, high, o in EPOCHS_D if low < typical < high), 0.0)
            self.dated = bool(offset)
        elif 4e8 < typical * scale < 4e9:
            self.dated = True
        return (time - offset) * scale, notes


def _undotted(cells: Any) -> Any:
    """Returns cells of date and clock joined, without what a date of midnight has of its own."""
    return cells.str.replace(r"^(\S+)[T ]0?0:00(?::00(?:\.0+)?)? ", r"\1 ", regex=True)


def _check(seconds: Array, cells: Any) -> None:
    """Raises StampError at the first cell that is none."""
    wrong = np.flatnonzero(~np.isfinite(seconds))
    if wrong.size:
        raise StampError(int(wrong[0]), str(cells.iloc[int(wrong[0])]))


def _epoch(found: Any) -> Array:
    """Returns pandas' times as seconds from 1970, NaN for none."""
    stamps = found.dt.tz_localize(None).to_numpy().astype("datetime64[us]")
    return np.where(np.isnat(stamps), np.nan, stamps.astype(np.int64) / 1e6)


def _seconds_of(cells: Any) -> Array:
    """Returns the seconds of a minute; a comma may stand for the point, and none for zero."""
    import pandas as pd

    text = cells.fillna("0").str.replace(",", ".", regex=False)
    return np.asarray(pd.to_numeric(text, errors="coerce").to_numpy(np.float64))


def _of_day(hour: Array, minute: Array, second: Array, half: Any) -> Array:
    """Returns seconds since midnight; `half` says AM or PM, or nothing."""
    late = half.fillna("").str.lower().to_numpy()
    hour = np.nan_to_num(hour)
    hour = np.where(late == "", hour, hour % 12 + 12 * (late == "pm"))
    return np.asarray(3600 * hour + 60 * np.nan_to_num(minute) + second)


def _civil(year: Array, month: Array, day: Array) -> Array:
    """Returns seconds from 1970 of dates; NaN where there is no such date."""
    year = np.where(year < 100, 2000 + year, year)
    good = (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31) & np.isfinite(year)
    whole = [np.where(good, x, 1).astype(np.int64) for x in (year, month)]
    months = (whole[0] - 1970) * 12 + whole[1] - 1
    start = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    return np.where(good, (start + np.where(good, day, 1) - 1) * DAY_S, np.nan)


def _ordinal(groups: Any) -> Array:
    """Returns seconds of stamps with a day of the year, 2024-067T09:00:00."""
    import pandas as pd

    year, day, hour, minute = (
        pd.to_numeric(groups[n], errors="coerce").to_numpy(np.float64) for n in range(4)
    )
    start = _civil(year, np.ones_like(year), np.ones_like(year))
    return np.asarray(
        start + (day - 1) * DAY_S + 3600 * hour + 60 * minute + _seconds_of(groups[4])
    )
