"""How a record's file is laid out: separator, names, units, and where its rows begin."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import TextIO

from thzcl.errors import RecordError
from thzcl.records.units import is_unit

LOOKED_AT = 200  # lines from which the layout is found
MISSING = frozenset(
    ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "+inf", "#n/a", "#num!",
     "#value!", "#div/0!", "err", "error", "over", "ovrf", "***", "*", "missing", "7999n", "-nan",
     "1.#qnan", "1.#inf", "-1.#ind"),
)  # fmt: skip
SEPARATORS = ("\t", ";", "|", ",", " ")
COMMENTS = ("#", "%", "//", '"#')


@dataclass(frozen=True)
class Layout:
    """How a file is laid out: its columns, its separator, and the lines of header and first row.

    `head` holds the lines of the header, which may come again; a separator of one space stands for
    any white space.
    """

    path: Path
    station: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    separator: str
    header_line: int
    first_line: int
    decimal: str = "."
    head: frozenset[str] = frozenset()

    def fields(self, line: str) -> int:
        """Returns the number of a line's cells."""
        if self.separator == " ":
            return len(line.split())
        if '"' in line:
            return len(cells_of(line, self.separator))
        return line.count(self.separator) + 1


def cells_of(line: str, separator: str) -> list[str]:
    """Returns the cells of a line."""
    if separator == " ":
        return line.split()
    return next(csv.reader([line.rstrip("\r\n")], delimiter=separator), [])


def find(path: Path, stream: TextIO) -> tuple[Layout, Iterator[str]]:
    """Returns the layout of a file, and the lines of its rows.

    Raises RecordError if there is no header.
    """
    lines = list(islice(stream, LOOKED_AT))
    first = lines[0] if lines else ""
    if first.lstrip('"').startswith("TOA5"):
        layout = _campbell(path, lines)
    elif re.match(r"\s*(Model|DATAH|\(Data)\b", first):
        layout = _licor(path, lines)
    else:
        layout = _plain(path, lines)
    return layout, chain(lines[layout.first_line - 1 :], stream)


def _campbell(path: Path, lines: Sequence[str]) -> Layout:
    """Returns the layout of a TOA5 file."""
    comma = "," if lines[0].count(",") >= lines[0].count(";") else ";"
    head = [cells_of(line, comma) for line in lines[:4]]
    station = " ".join(head[0][1:4:2])  # its name and its logger's serial number
    names, units, _ = (*head[1:4], [], [], [])[:3]
    if len(names) < 2:
        raise RecordError(f"{path}:2: column 1: expected the names of a TOA5 file's columns")
    first = next((line for line in lines[4:] if line.strip()), "")
    decimal = "," if comma == ";" and re.search(r";-?\d+,\d", first) else "."
    return _whole(
        Layout(
            path, station, tuple(names), tuple(units), comma, 2, 5, decimal, frozenset(lines[:4])
        )
    )


def _licor(path: Path, lines: Sequence[str]) -> Layout:
    """Returns the layout of a LI-COR data file."""
    station = ""
    for number, line in enumerate(lines, start=1):
        if line.startswith("DATAH"):
            names = tuple(name.strip() for name in line.rstrip("\r\n").split("\t"))
            none = ("",) * len(names)
            return Layout(
                path, station, names, none, "\t", number, number + 1, head=frozenset(lines[:number])
            )
        if line.startswith(("SN", "Instrument")):
            station += line.partition("\t")[2].strip()
    raise RecordError(
        f"{path}:{len(lines)}: column 1: expected a line of column names beginning with DATAH"
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


def _plain(path: Path, lines: Sequence[str]) -> Layout:
    """Returns the layout of a table of text: names, perhaps units and instruments, then rows."""
    table = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.startswith(COMMENTS)
    ]
    separator, width = _separator([line for _, line in table])
    head: list[tuple[int, list[str]]] = []
    for number, line in table:
        cells = [cell.strip() for cell in cells_of(line, separator)]
        if len(cells) == width and is_data(cells):
            first = number
            break
        blank = separator == " " and len(cells) > 1 and not is_data(cells)
        if len(cells) == width or (not head and blank):
            head.append((number, [cell.rstrip(",") for cell in cells] if blank else cells))
    else:
        first = (table[-1][0] if table else len(lines)) + 1
        _check_head(path, head, table)
    head = head or _commented(lines[: first - 1], separator, width)
    if not head:
        raise RecordError(
            f"{path}:{first}: column 1: expected a header with the names of the columns; "
            "found data; write their names above them, as in time_s,h2o_g_m3,Ux_m_s,Uy_m_s"
        )
    # A logger's line about itself, with few cells filled, stands above the names (TOACI1).
    head = head[next((n for n, (_, cells) in enumerate(head) if _is_full(cells)), 0) :]
    line_of, names = head[0]
    rows = [cells for _, cells in head[1:] if sum(map(_unit_like, cells)) > len(cells) / 3]
    units = rows[0] if rows else [""] * len(names)
    return Layout(
        path, "", tuple(names), tuple(units), separator, line_of, first,
        _decimal([line for number, line in table if number >= first], separator),
        frozenset(lines[number - 1] for number, _ in head),
    )  # fmt: skip


def _is_full(cells: Sequence[str]) -> bool:
    """Returns whether more than half of a row's cells hold text."""
    return 2 * sum(map(bool, cells)) > len(cells)


def _unit_like(cell: str) -> bool:
    """Returns whether a cell of the header is a unit, or stands for a stamp's form."""
    return bool(cell) and (is_unit(cell) or "yyyy" in cell.lower() or cell.upper() == "TS")


def _check_head(
    path: Path, head: Sequence[tuple[int, list[str]]], table: Sequence[tuple[int, str]]
) -> None:
    """Raises RecordError if a file without rows has no header either, or one column."""
    if not head or len(head[0][1]) < 2:
        line = table[0][0] if table else 1
        raise RecordError(
            f"{path}:{line}: column 1: expected names of columns with commas, semicolons or tabs "
            "between them, and rows of numbers; found neither"
        )


def _commented(lines: Sequence[str], separator: str, width: int) -> list[tuple[int, list[str]]]:
    """Returns the names from a comment above the rows that has as many cells as they."""
    for number in range(len(lines), 0, -1):
        text = lines[number - 1].lstrip('#%/" ').rstrip("\r\n")
        cells = [cell.strip() for cell in cells_of(text, separator)]
        if len(cells) == width and not is_data(cells):
            return [(number, cells)]
    return []


def _separator(lines: Sequence[str]) -> tuple[str, int]:
    """Returns the separator by which most lines have as many cells, and how many."""
    best, most = (",", 1), 0
    for separator in SEPARATORS:
        counts = Counter(len(cells_of(line, separator)) for line in lines[-100:])
        width, number = counts.most_common(1)[0] if counts else (1, 0)
        if width > 1 and number > 1.2 * most:
            best, most = (separator, width), number
    return best


def _decimal(lines: Sequence[str], separator: str) -> str:
    """Returns the decimal mark of the rows: a comma where cells hold commas and no points."""
    if separator == ",":
        return "."
    cells = [cell for line in lines[:50] for cell in cells_of(line, separator)]
    commas = sum(bool(re.fullmatch(r"\s*[-+]?\d+,\d+(e[-+]?\d+)?\s*", cell)) for cell in cells)
    points = sum(bool(re.fullmatch(r"\s*[-+]?\d+\.\d+(e[-+]?\d+)?\s*", cell)) for cell in cells)
    return "," if commas > points else "."


def is_data(cells: Sequence[str]) -> bool:
    """Returns whether half of a row's cells or more are numbers, stamps or stand for none."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    values = sum(
        bool(re.match(r"[-+.]?\d", cell)) or (cell.lower() in MISSING and cell != "-")
        for cell in filled
    )
    return bool(filled) and 2 * values >= len(filled)
