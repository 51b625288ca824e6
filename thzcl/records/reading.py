"""Reads records: Campbell's TOA5, LI-COR's GHG archives, and tables of text with a header.

pandas parses the rows, chunk by chunk; what it cannot parse is looked at cell by cell.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import layout as layouts
from thzcl.records import opening
from thzcl.records.columns import Column, Columns, find, perhaps
from thzcl.records.layout import MISSING, Layout
from thzcl.records.stamps import Clock, StampError

Array = NDArray[np.float64]

LINES_AT_ONCE = 65_536
NO_VALUE = -9998.0  # loggers write -9999 for what they could not measure
MOST_BROKEN = 0.01  # of a file's lines may have too few or too many cells
NEVER = 10**9


@dataclass(frozen=True)
class Rows:
    """The rows of a file: seconds (n,), lines (n,) and, by role, values (n,) in thzcl's units.

    Humidity is in the unit of its column's kind (columns.Column). Values are NaN where they are
    missing. `flags` are the columns of diagnostic values by name. `time_s` is None where the file
    has no time.
    """

    layout: Layout
    columns: dict[str, Column]
    time_s: Array | None
    lines: NDArray[np.int32]
    values: dict[str, Array]
    flags: dict[str, Array]
    dated: bool  # whether seconds count from 1970, and not from a start of the file's own
    time_told: str
    others: tuple[str, ...]
    notes: tuple[str, ...]

    def place(self, row: int, role: str = "time") -> str:
        """Returns file, line and column of a row, for messages."""
        column = self.columns.get(role)
        names = [c.name for r, c in self.columns.items() if r.partition(":")[0] == role]
        name = column.name if column else " and ".join(names)
        where = f"{self.layout.path}:{int(self.lines[row])}"
        return f"{where}: column {name or 'without a name'}" if names or column else where


@dataclass
class _Read:
    """What has been read of a file so far."""

    layout: Layout
    columns: Columns
    clock: Clock = field(default_factory=Clock)
    values: dict[str, list[Array]] = field(default_factory=dict)
    lines: list[NDArray[np.int32]] = field(default_factory=list)
    broken: list[int] = field(default_factory=list)
    longest: int = 0  # cells of a broken line
    heads: int = 0
    cut: int = 0  # the line that ends the file too early
    notes: list[str] = field(default_factory=list)
    out: set[str] = field(default_factory=set)  # optional columns that hold text

    @property
    def rows(self) -> int:
        """Returns the number of rows so far."""
        return sum(map(len, self.lines))


def read(
    path: Path, chosen: str = "", rate_hz: float | None = None, companion: bool = False
) -> Rows:
    """Returns the rows of a file; `chosen` names columns, as in columns.find.

    A `companion`, the file of another hygrometer beside the first, needs no wind, nor all of the
    chosen columns. Raises RecordError, which names file, line and column, if the file holds no
    record.
    """
    try:
        with opening.opened(path) as stream:
            layout, lines = layouts.find(path, stream)
            place = f"{path}:{layout.header_line}"
            columns = find(layout.names, layout.units, chosen, place, companion)
            _complete(columns, layout, place, rate_hz, companion)
            return _rows(layout, columns, lines, rate_hz)
    except csv.Error as error:
        raise RecordError(
            f"{path}: not a table of text ({error}); expected rows of numbers with a header"
        ) from None


def _complete(
    columns: Columns, layout: Layout, place: str, rate_hz: float | None, companion: bool
) -> None:
    """Raises RecordError with all problems of the header, missing time and wind among them."""
    found = columns.by_role
    names = ", ".join(filter(None, layout.names))[:300]
    told = f"there are {names}; name it with --columns"
    if not any(role.partition(":")[0] == "time" for role in found) and rate_hz is None:
        columns.problems.append(
            f"{place}: expected a column of time stamps; {told} time=NAME, "
            "or give the samples a second with --rate-hz"
        )
    if not ({"Ux", "Uy"} <= found.keys() or "speed" in found or companion):
        columns.problems.append(
            f"{place}: expected columns of wind, Ux, Uy and Uz, or a wind speed, in m/s; "
            f"there are {names}; {perhaps(layout.names, 'ux')}"
            "name it with --columns Ux=NAME,Uy=NAME or speed=NAME"
        )
    if columns.problems:
        raise RecordError("\n".join(columns.problems))


def _rows(layout: Layout, columns: Columns, lines: Iterator[str], rate_hz: float | None) -> Rows:
    """Returns the rows of a file, read in chunks. Raises RecordError if there are none."""
    read, number = _Read(layout, columns), layout.first_line
    while chunk := list(islice(lines, LINES_AT_ONCE)):
        kept, at = _sound(read, chunk, number)
        if kept:
            _add(read, kept, at)
        number += len(chunk)
    _judge_broken(read, number)
    if not read.rows:
        names = ", ".join(column.name for column in columns.by_role.values())
        raise RecordError(
            f"{layout.path}:{layout.first_line}: empty below its header; expected rows with {names}"
        )
    return _whole(read, rate_hz)


def _whole(read: _Read, rate_hz: float | None) -> Rows:
    """Returns the rows of a file that is read to its end."""
    columns, told = read.columns, list(read.columns.notes)
    by_role = {r: c for r, c in columns.by_role.items() if r not in read.out}
    time = by_role.get("time")
    time_s: Array | None = None
    if read.clock.chunks:
        unit, factor = (time.unit, time.factor) if time else ("", 1.0)
        time_s, notes = read.clock.seconds(unit, factor, rate_hz)
        told += notes
    values = {role: np.concatenate(parts) for role, parts in read.values.items()}
    read.values.clear()
    if time_s is not None and "nanoseconds" in values:
        time_s = time_s + values.pop("nanoseconds")
    marks = [role for role in values if role.startswith("flag:")]
    flags = {role[5:]: values.pop(role) for role in marks if role not in read.out}
    return Rows(
        read.layout, by_role, time_s, np.concatenate(read.lines),
        {role: x for role, x in values.items() if role not in read.out}, flags,
        read.clock.dated or "nanoseconds" in by_role, read.clock.told, columns.others,
        (*told, *read.notes),
    )  # fmt: skip


def _sound(read: _Read, chunk: list[str], number: int) -> tuple[list[str], NDArray[np.int32]]:
    """Returns the lines of a chunk that are rows, and their numbers; what is none is counted."""
    layout, wanted = read.layout, len(read.layout.names)
    counts = [layout.fields(line) for line in chunk]
    at = np.arange(number, number + len(chunk), dtype=np.int32)
    if set(counts) == {wanted} and layout.head.isdisjoint(chunk):
        return chunk, at
    kept = np.zeros(len(chunk), dtype=np.bool_)
    for n, (line, count) in enumerate(zip(chunk, counts, strict=True)):
        if not line.strip() or line.startswith(layouts.COMMENTS):
            continue
        if line in layout.head or line.rstrip("\r\n") + "\n" in layout.head:
            read.heads += 1
        elif count == wanted:
            kept[n] = True
        else:
            read.broken.append(number + n)
            read.longest = max(read.longest, count)
    return [line for line, good in zip(chunk, kept, strict=True) if good], at[kept]


def _judge_broken(read: _Read, end: int) -> None:
    """Notes what was left out of a file. Raises RecordError if that is more than a few lines."""
    layout, broken = read.layout, read.broken
    if read.heads:
        read.notes.append(f"the header stands {read.heads} times more among the rows of the file")
    if not broken:
        return
    wanted = len(layout.names)
    if len(broken) > max(MOST_BROKEN * (read.rows + len(broken)), 1):
        reason = (
            "rows cut short?"
            if read.longest < wanted
            else "a comma for a decimal point? expected numbers with points, or other separators"
        )
        raise RecordError(
            f"{layout.path}:{broken[0]}: column {min(read.longest, wanted)}: {read.longest} "
            f"columns, expected the header's {wanted}, here and in {len(broken) - 1} other rows; "
            f"{reason}"
        )
    if broken[-1] >= end - 1 and len(broken) == 1:
        read.notes.append(f"the last line ({broken[0]}) is cut short and left out")
    else:
        read.notes.append(
            f"{len(broken)} lines have another number of columns than the header's {wanted} and "
            f"are left out, the first of them line {broken[0]}"
        )


def _add(read: _Read, kept: list[str], at: NDArray[np.int32]) -> None:
    """Adds the cells of some lines, all of which have as many as the header."""
    cells = _parsed(read, kept)
    parts = {
        role.partition(":")[2] or "time": cells[column.at]
        for role, column in read.columns.by_role.items()
        if role.partition(":")[0] == "time"
    }
    if parts:
        try:
            read.clock.read(parts)
        except StampError as error:
            columns = read.columns.by_role
            name = " and ".join(
                c.name or "without a name" for r, c in columns.items() if r[:4] == "time"
            )
            place = f"{read.layout.path}:{int(at[error.at])}"
            raise RecordError(f"{place}: column {name}: {error}") from None
    for role, column in _numeric(read.columns):
        numbers = _numbers(read, role, column, cells[column.at], at)
        scaled = numbers if column.factor == 1 and not column.offset else (
            column.factor * numbers + column.offset
        )  # fmt: skip
        read.values.setdefault(role, []).append(scaled)
    read.lines.append(at)


def _numeric(columns: Columns) -> Iterator[tuple[str, Column]]:
    """Yields the columns that hold numbers by role; those of flags as "flag:NAME"."""
    for role, column in columns.by_role.items():
        if role.partition(":")[0] != "time":
            yield role, column
    for column in columns.flags:
        yield f"flag:{column.name}", column


def _parsed(read: _Read, kept: list[str]) -> Any:
    """Returns the used cells of some lines as a pandas table, by the column's place.

    Columns of numbers hold float64, or text if one cell is no number.
    """
    import pandas as pd

    layout = read.layout
    texts = {c.at for r, c in read.columns.by_role.items() if r.partition(":")[0] == "time"}
    numbers = {column.at for _, column in _numeric(read.columns)} - texts
    how: dict[str, Any] = {
        "header": None,
        "usecols": sorted(texts | numbers),
        "sep": r"\s+" if layout.separator == " " else layout.separator,
        "decimal": layout.decimal,
        "na_values": sorted(MISSING | {word.upper() for word in MISSING}),
        "skipinitialspace": True,
        "skip_blank_lines": False,
    }
    text = "".join(kept)
    as_text: dict[int, Any] = dict.fromkeys(texts, str)
    try:
        return pd.read_csv(
            io.StringIO(text), dtype=as_text | dict.fromkeys(numbers, np.float64), **how
        )
    except ValueError:
        return pd.read_csv(io.StringIO(text), dtype=as_text | dict.fromkeys(numbers, str), **how)


def _numbers(read: _Read, role: str, column: Column, cells: Any, at: NDArray[np.int32]) -> Array:
    """Returns cells as numbers, NaN where they say that they hold none.

    Raises RecordError for any other text in a column that is needed; others are left out.
    """
    import pandas as pd

    if cells.dtype == np.float64:
        return _present(cells.to_numpy())
    text = cells.astype(str).str.strip()
    if read.layout.decimal == ",":
        text = text.str.replace(",", ".", regex=False)
    found = pd.to_numeric(text, errors="coerce").to_numpy(np.float64).copy()
    unread = np.flatnonzero(np.isnan(found) & cells.notna().to_numpy()).tolist()
    wrong = [n for n in unread if text.iloc[n].lower() not in MISSING]
    if wrong and role in ("h2o", "Ux", "Uy", "speed"):
        told = f'"{text.iloc[wrong[0]][:40]}" is not a number; expected one with a decimal point'
        raise RecordError(f"{read.layout.path}:{at[wrong[0]]}: column {column.name}: {told}")
    if wrong and role not in read.out:
        read.out.add(role)
        read.notes.append(
            f'column {column.name} is left out: "{text.iloc[wrong[0]][:40]}" in line '
            f"{at[wrong[0]]} is not a number"
        )
    return _present(found)


def _present(values: Array) -> Array:
    """Returns numbers, NaN where a logger says that there is none."""
    return np.where(np.isfinite(values) & (values > NO_VALUE), values, np.nan)
