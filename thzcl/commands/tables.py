"""Tables as data, and what draws them: for a terminal, as CSV, as records for JSON."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from thzcl.commands.terminal import PIPE_WIDTH, width_to_keep

if TYPE_CHECKING:
    from rich.table import Table as Drawn

Cell = str | float | int | None
LONGEST_WORD = 30  # letters; a longer word is folded where a table must be narrow
NARROWEST = 8  # letters that a column keeps, however narrow the terminal


@dataclass(frozen=True)
class Column:
    """A column: its name, the unit of its values, and how its numbers are written."""

    name: str
    unit: str = ""
    form: str = ""  # as for format(), on a terminal
    right: bool = False  # also aligns text to the right, as numbers always are

    @property
    def heading(self) -> str:
        """The name, with its unit."""
        return f"{self.name} / {self.unit}" if self.unit else self.name


@dataclass(frozen=True)
class Table:
    """Rows of values under columns; None is a value that there is not."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    keys: int = 1  # leading columns that name a row, repeated where a table must be cut


def from_records(records: Sequence[Mapping[str, Cell]], form: str = "", keys: int = 1) -> Table:
    """Returns records of the same keys as a table; `form` is how its numbers are written."""
    names = list(records[0]) if records else []
    columns = tuple(Column(name, form=form) for name in names)
    return Table("", columns, tuple(tuple(r[name] for name in names) for r in records), keys)


def as_csv(table: Table) -> str:
    """Returns a table as CSV, with the names of its columns on top."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.name for column in table.columns])
    writer.writerows(table.rows)
    return text.getvalue()


def as_records(table: Table) -> list[dict[str, Cell]]:
    """Returns each row as a dictionary by the names of the columns, for JSON."""
    names = [column.name for column in table.columns]
    return [dict(zip(names, row, strict=True)) for row in table.rows]


def show_json(found: Any) -> None:
    """Prints something as JSON, which has no NaN and no infinity: they are null."""
    print(json.dumps(_finite(found), indent=2, allow_nan=False))


def _finite(value: Any) -> Any:
    """Returns a value with None for each number in it that is not finite."""
    if isinstance(value, Mapping):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def show(*tables: Table) -> None:
    """Prints tables, none of them wider than the terminal or COLUMNS.

    Tables without rows, and columns without a value, are left out. Text is folded. A table that is
    still too wide is cut into several, each of which begins with the columns that name its rows.
    """
    from rich.console import Console
    from rich.text import Text

    width = width_to_keep() or PIPE_WIDTH
    console = Console(width=width)
    with console.capture() as captured:  # rich would end the process if nobody reads
        for table in map(_without_empty_columns, tables):
            if table.title and table.rows:
                console.print(Text(table.title, style="bold"))
            for block in _blocks(table, width) if table.rows else ():
                console.print(_drawn(block, width))
    print(captured.get(), end="")


def _without_empty_columns(table: Table) -> Table:
    """Returns a table of those columns that have a value in any row."""
    full = [
        n for n in range(len(table.columns)) if any(row[n] not in (None, "") for row in table.rows)
    ]
    keys = sum(n < table.keys for n in full)
    return replace(_only(table, full), title=table.title, keys=keys)


def _blocks(table: Table, width: int) -> list[Table]:
    """Returns a table, or if it cannot be as narrow as that, its columns in several tables."""
    least = [_least(column, cells) for column, cells in _columns(table)]
    own = list(range(table.keys))
    groups: list[list[int]] = []
    for number in range(table.keys, len(table.columns)):
        longer = [*(groups[-1] if groups else own), number]
        if groups and _total([least[n] for n in longer]) <= width:
            groups[-1] = longer
        else:
            groups.append([*own, number])
    return [_only(table, group) for group in groups] or [table]


def _only(table: Table, numbers: Sequence[int]) -> Table:
    """Returns a table of some of a table's columns."""
    rows = tuple(tuple(row[n] for n in numbers) for row in table.rows)
    return Table("", tuple(table.columns[n] for n in numbers), rows, table.keys)


def _columns(table: Table) -> list[tuple[Column, list[str]]]:
    """Returns each column with its cells as they are written on a terminal."""
    return [
        (column, [_written(row[number], column.form) for row in table.rows])
        for number, column in enumerate(table.columns)
    ]


def _written(value: Cell, form: str) -> str:
    if value is None or isinstance(value, str):
        return value or ""
    return format(value, form)


def _is_numeric(table: Table, number: int) -> bool:
    cells = [row[number] for row in table.rows if row[number] is not None]
    return bool(cells) and not any(isinstance(cell, str) for cell in cells)


def _least(column: Column, cells: Sequence[str]) -> int:
    """Returns how narrow a column can be without breaking its words."""
    words = [*_pieces(column.heading), *(word for cell in cells for word in cell.split())]
    return min(max(map(_letters, words), default=1), LONGEST_WORD)


def _pieces(heading: str) -> list[str]:
    """Returns the parts of a heading between which a line may be broken."""
    return re.findall(r"[^ _]+_*|_+", heading)


def _letters(text: str) -> int:
    """Returns how many columns a text takes on a terminal."""
    from rich.cells import cell_len

    return cell_len(text)


def _total(widths: Sequence[int]) -> int:
    """Returns the width of a table whose columns have these widths."""
    return sum(widths) + 2 * len(widths)


def _drawn(table: Table, width: int) -> Drawn:
    """Returns a table as rich draws it, no wider than that."""
    from rich import box
    from rich.table import Table as Drawn
    from rich.text import Text

    drawn = Drawn(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    columns = _columns(table)
    widths = _widths(columns, width)
    for number, (column, _) in enumerate(columns):
        right = column.right or _is_numeric(table, number)
        heading = _folded(column.heading, widths[number])
        drawn.add_column(
            Text(heading),
            justify="right" if right else "left",
            width=widths[number],
            overflow="fold",
        )
    for row in zip(*(cells for _, cells in columns), strict=True):
        drawn.add_row(*map(Text, row))
    return drawn


def _widths(columns: Sequence[tuple[Column, list[str]]], width: int) -> list[int]:
    """Returns the columns' widths: the widest are narrowed until the table is no wider than that.

    First headings are folded, then cells between words, then words.
    """
    widths = [max(map(_letters, [column.heading, *cells])) for column, cells in columns]
    least = [_least(column, cells) for column, cells in columns]
    whole = [max(map(_letters, cells)) for _, cells in columns]
    for floor in (list(map(max, least, whole)), least, [NARROWEST] * len(columns)):
        while _total(widths) > width:
            widest = max(range(len(widths)), key=lambda n: (widths[n] > floor[n], widths[n]))
            if widths[widest] <= floor[widest]:
                break
            widths[widest] -= 1
    return widths


def _folded(heading: str, width: int) -> str:
    """Returns a heading in lines of at most that many letters, broken at spaces and after "_"."""
    if _letters(heading) <= width:
        return heading
    lines = [""]
    for piece in _pieces(heading):
        gap = "" if not lines[-1] or lines[-1].endswith("_") else " "
        if lines[-1] and _letters(lines[-1] + gap + piece) > width:
            lines.append(piece)
        else:
            lines[-1] += gap + piece
    return "\n".join(lines)
