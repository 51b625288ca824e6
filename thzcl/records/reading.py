"""Reads records: Campbell's TOA5, plain CSV with a header, and LI-COR's GHG archives."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records.columns import Column, find

Array = NDArray[np.float64]

LINES_AT_ONCE = 16_384
LICOR_HEADER_LINES = 100  # at most, before DATAH
MISSING = frozenset(("", "nan", "na", "n/a", "null", "none", "-"))
NO_VALUE = -9998.0  # loggers write -9999 for what they could not measure


@dataclass(frozen=True)
class Layout:
    """How a file is laid out: its columns, its delimiter, and the lines of header and first row."""

    path: Path
    station: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    delimiter: str
    header_line: int
    first_line: int


@dataclass(frozen=True)
class Rows:
    """The rows of a file: seconds (n,), and by role values (n,) in g/m3, m/s, K and hPa.

    Values are NaN where they are missing.
    """

    layout: Layout
    columns: dict[str, Column]
    time_s: Array
    values: dict[str, Array]
    dated: bool  # whether seconds count from 1970, and not from a start of the file's own


def read(path: Path, chosen: str = "") -> Rows:
    """Returns the rows of a file; `chosen` names columns, as in columns.find.

    Raises RecordError, which names file, line and column, if the file holds no record.
    """
    try:
        with _opened(path) as stream:
            layout, first = _layout(path, stream)
            columns = find(layout.names, layout.units, chosen, f"{path}:{layout.header_line}")
            return _rows(layout, columns, chain([first] if first.strip() else [], stream))
    except csv.Error as error:
        raise RecordError(
            f"{path}: not a table of text ({error}); expected rows of numbers with a header"
        ) from None


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    """Opens the text of a file, or of the data part of an archive.

    Raises RecordError if the file holds no text.
    """
    expected = "expected Campbell TOA5, CSV with a header, or a LI-COR GHG archive"
    with path.open("rb") as file:
        start = file.read(4096)
        if not start.strip():
            raise RecordError(f"{path}:1: empty; {expected}")
        if start.startswith(b"PK"):
            with _archived(path, expected) as stream:
                yield stream
            return
        if b"\0" in start or sum(byte < 9 for byte in start) > len(start) // 50:
            raise RecordError(f"{path}:1: binary, not text; {expected}")
        file.seek(0)
        yield io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace", newline="")


@contextmanager
def _archived(path: Path, expected: str) -> Iterator[TextIO]:
    """Opens the data part of an archive. Raises RecordError if there is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            parts = [
                name for name in archive.namelist() if name.endswith(".data") and "/" not in name
            ]
            if not parts:
                raise RecordError(f"{path}: an archive without a .data part; {expected}")
            # Beside the fast data there may be those of a weather station, NAME-biomet.data.
            with archive.open(min(parts, key=len)) as part:
                yield io.TextIOWrapper(part, encoding="utf-8-sig", errors="replace", newline="")
    except (zipfile.BadZipFile, EOFError) as error:
        raise RecordError(
            f"{path}: a broken archive ({error}); fetch it again from the logger"
        ) from None


def _layout(path: Path, stream: TextIO) -> tuple[Layout, str]:
    """Returns the layout of a file, and the line of data that had to be read, or no text."""
    line, number = stream.readline(), 1
    if line.lstrip('"').startswith("TOA5"):
        return _campbell(path, line, stream), ""
    if re.match(r"\s*(Model|DATAH|\(Data)\b", line):
        return _licor(path, line, stream), ""
    while line.startswith("#"):
        line, number = stream.readline(), number + 1
    names = next(csv.reader([line]), [])
    _check_commas(path, number, names)
    if not any(re.search("[A-Za-z]{1,}", name) for name in names) or _is_data(names):
        raise RecordError(
            f"{path}:{number}: column 1: expected a header with the names of the columns; "
            "found data"
        )
    following = stream.readline()
    cells = next(csv.reader([following]), [])
    units, first = (
        (tuple(cells), "") if cells and _are_units(cells) else (("",) * len(names), following)
    )
    start = number + 1 + (not first)
    return _whole(
        Layout(path, "", tuple(name.strip() for name in names), units, ",", number, start)
    ), first


def _check_commas(path: Path, number: int, names: Sequence[str]) -> None:
    """Raises RecordError if a line of names is not split by commas."""
    if len(names) < 3:
        others = {";": "semicolons", "\t": "tabs", "|": "bars"}
        found = next((name for mark, name in others.items() if mark in "".join(names)), "no commas")
        raise RecordError(
            f"{path}:{number}: column 1: expected names of columns with commas between them; "
            f"found {found}"
        )


def _is_data(cells: Sequence[str]) -> bool:
    """Returns whether most cells are numbers."""
    return sum(_number(cell) is not None for cell in cells[1:]) > len(cells[1:]) / 2


def _are_units(cells: Sequence[str]) -> bool:
    """Returns whether no cell is a number or stands for a missing one."""
    return not any(
        re.match(r"\s*[-+.]?\d", cell) or cell.strip().lower() in ("nan", "na") for cell in cells
    )


def _campbell(path: Path, first: str, stream: TextIO) -> Layout:
    """Returns the layout of a TOA5 file, of which the first line is read."""
    station = " ".join(next(csv.reader([first]))[1:4:2])  # its name and its logger's serial number
    names, units, _ = (next(csv.reader([stream.readline()]), []) for _ in range(3))
    _check_commas(path, 2, names)
    return _whole(Layout(path, station, tuple(names), tuple(units), ",", 2, 5))


def _licor(path: Path, line: str, stream: TextIO) -> Layout:
    """Returns the layout of a LI-COR data file, of which the first line is read."""
    station = ""
    for number in range(1, LICOR_HEADER_LINES):
        if line.startswith("DATAH"):
            names = [name.strip() for name in line.rstrip("\r\n").split("\t")]
            return _whole(
                Layout(path, station, tuple(names), ("",) * len(names), "\t", number, number + 1)
            )
        if line.startswith(("SN", "Instrument")):
            station += line.partition("\t")[2].strip()
        line = stream.readline()
    raise RecordError(
        f"{path}:{LICOR_HEADER_LINES}: column 1: expected a line of column names beginning with "
        "DATAH"
    )


def _whole(layout: Layout) -> Layout:
    """Returns the layout itself. Raises RecordError if its names and units are not as many."""
    if not layout.names or len(layout.units) != len(layout.names):
        text = (
            f"{len(layout.names)} names of columns and {len(layout.units)} units; expected as many"
        )
        place = f"{layout.path}:{layout.header_line + 1}: column {len(layout.names)}"
        raise RecordError(f"{place}: {text}; is the file cut short?")
    return layout


def _rows(layout: Layout, columns: dict[str, Column], lines: Iterator[str]) -> Rows:
    """Returns the rows of a file, read in chunks. Raises RecordError if there are none."""
    parts: dict[str, list[Array]] = {role: [] for role in columns}
    dated, line = False, layout.first_line
    while chunk := list(islice(lines, LINES_AT_ONCE)):
        count = len(chunk)
        while chunk and not chunk[-1].strip():
            chunk.pop()
        for role, (cells, numbers) in _cells(layout, columns, chunk, line).items():
            if role == "time" and cells is not None and (dated or _number(cells[0]) is None):
                dated = True
                parts[role].append(_dates(layout, columns[role], cells, line))
            else:
                found = (
                    _numbers(layout, columns[role], cells or (), line)
                    if numbers is None
                    else _present(numbers)
                )
                parts[role].append(columns[role].factor * found + columns[role].offset)
        line += count
    if not parts["time"]:
        names = ", ".join(column.name for column in columns.values())
        raise RecordError(
            f"{layout.path}:{line}: empty below its header; expected rows with {names}"
        )
    values = {role: np.concatenate(found) for role, found in parts.items()}
    time_s = values.pop("time") + values.pop("nanoseconds", 0.0)
    return Rows(layout, columns, time_s, values, dated or "nanoseconds" in columns)


def _cells(
    layout: Layout, columns: dict[str, Column], chunk: list[str], line: int
) -> dict[str, tuple[Sequence[str] | None, Array | None]]:
    """Returns by role the cells of some lines, or instead their numbers.

    Numbers are returned if all columns but that of time hold nothing else, which is fast.
    """
    if not chunk:
        return {}
    numeric = [role for role in columns if role != "time"]
    if {text.count(layout.delimiter) for text in chunk} == {len(layout.names) - 1}:
        used = [columns[role].at for role in numeric]
        with suppress(ValueError):  # text among the numbers; what it says is looked at below
            read = np.loadtxt(
                chunk,
                delimiter=layout.delimiter,
                usecols=used,
                comments=None,
                quotechar='"',
                ndmin=2,
            )
            if len(read) == len(chunk):
                at = columns["time"].at
                stamps = [
                    text.split(layout.delimiter, at + 1)[at].strip().strip('"') for text in chunk
                ]
                return {"time": (stamps, None)} | {
                    role: (None, read[:, n]) for n, role in enumerate(numeric)
                }
    by_column = _transposed(layout, list(csv.reader(chunk, delimiter=layout.delimiter)), line)
    return {role: (by_column[column.at], None) for role, column in columns.items()}


def _transposed(layout: Layout, chunk: list[list[str]], line: int) -> list[tuple[str, ...]]:
    """Returns the cells by column. Raises RecordError if a row is not as long as the header."""
    wanted = len(layout.names)
    if set(map(len, chunk)) != {wanted}:
        at, row = next((at, row) for at, row in enumerate(chunk) if len(row) != wanted)
        reason = (
            "a row cut short?"
            if len(row) < wanted
            else "a comma for a decimal point? expected numbers with points"
        )
        text = f"{len(row)} columns, expected the header's {wanted}; {reason}"
        raise RecordError(f"{layout.path}:{line + at}: column {min(len(row), wanted)}: {text}")
    return list(zip(*chunk, strict=True))


def _numbers(layout: Layout, column: Column, cells: Sequence[str], line: int) -> Array:
    """Returns cells as numbers, NaN where they say that they hold none.

    Raises RecordError for any other text.
    """
    try:
        found = np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        numbers = [np.nan if cell.strip().lower() in MISSING else _number(cell) for cell in cells]
        if None in numbers:
            at = numbers.index(None)
            text = f'"{cells[at][:40]}" is not a number; expected one with a decimal point'
            raise RecordError(f"{layout.path}:{line + at}: column {column.name}: {text}") from None
        found = np.array(numbers, dtype=np.float64)
    return _present(found)


def _present(values: Array) -> Array:
    """Returns numbers, NaN where a logger says that there is none."""
    return np.where(np.isfinite(values) & (values > NO_VALUE), values, np.nan)


def _number(cell: str) -> float | None:
    """Returns a cell as a number, or None."""
    try:
        return float(cell)
    except ValueError:
        return None


def _dates(layout: Layout, column: Column, cells: Sequence[str], line: int) -> Array:
    """Returns time stamps as seconds from 1970. Raises RecordError for a cell that is none."""
    try:
        stamps = np.array([cell.rstrip("Z") for cell in cells], dtype="datetime64[us]")
        wrong = np.flatnonzero(np.isnat(stamps))
        if not wrong.size:
            return np.asarray(stamps.astype(np.int64) / 1e6)
        at = int(wrong[0])
    except ValueError:
        at = next((at for at, cell in enumerate(cells) if not _is_date(cell)), 0)
    text = f'"{cells[at][:40]}" is not a time stamp; expected seconds, or one like'
    raise RecordError(
        f"{layout.path}:{line + at}: column {column.name}: {text} 2012-06-07 12:45:00.05"
    ) from None


def _is_date(cell: str) -> bool:
    """Returns whether a cell is a date with a time."""
    try:
        return not np.isnat(np.datetime64(cell.rstrip("Z"), "us"))
    except ValueError:
        return False
