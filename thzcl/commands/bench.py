"""`thzcl bench`: the throughput of every stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thzcl.commands.options import (
    AllowOutside,
    DeviceChoice,
    HowTable,
    Settings,
    TableFormat,
    Variants,
    changes,
)

if TYPE_CHECKING:
    from thzcl.commands.tables import Table

PREFIXES = (("G", 1e9), ("M", 1e6), ("k", 1e3))


def bench(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="as for run")] = "slide",
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    repeat: Annotated[int, typer.Option(metavar="N", min=1, help="runs to take the median of")] = 7,
    how: HowTable = TableFormat.table,
) -> None:
    """Measure the throughput of every stage on this device, and how much of the possible it is."""
    from thzcl.commands.tables import as_csv, from_records, show, show_json
    from thzcl.commands.terminal import note, progress
    from thzcl.studies import bench as benchmark

    with progress() as tell:
        found = benchmark.bench(
            scenario,
            settings=changes(settings),
            variants=variant or (),
            device=device,
            allow_outside=allow_outside,
            repeat=repeat,
            progress=tell,
        )
    rows = benchmark.flat(found)
    if how is TableFormat.json:
        show_json(found)
    elif how is TableFormat.csv:
        print(as_csv(from_records(rows)), end="")
    else:
        show(*tables(found, rows))
        machine = found["machine"]
        note(f"device: {found['device']}; {machine['cores']} cores of {machine['processor']}")


def tables(found: dict[str, Any], rows: Sequence[dict[str, Any]]) -> list[Table]:
    """Returns the throughput of stages, and what the device can do at most, as tables."""
    from thzcl.commands.tables import Column, Table

    stages = len(found["stages"])
    time, rate = Column("time", "ms", ".3g"), Column("throughput", right=True)
    share = Column("of what the device can do", right=True)
    shown = [(row["name"], 1e3 * row["seconds"], _throughput(row), _share(row)) for row in rows]
    return [
        Table(
            f"{found['scenario']}, medians of {found['repeat']}",
            (Column("stage"), time, rate, share),
            tuple(shown[:stages]),
        ),
        Table(
            "what the device can do at most",
            (Column("measured by"), time, rate),
            tuple(row[:3] for row in shown[stages:]),
        ),
    ]


def _throughput(row: dict[str, Any]) -> str:
    """Returns a rate with three digits, an SI prefix and its unit; "" if there is none."""
    if not row["unit"]:
        return ""
    value, unit = row["rate"], row["unit"].replace("_", " ")
    prefix, size = next((one for one in PREFIXES if value >= one[1]), ("", 1.0))
    return f"{value / size:.3g} {prefix}{' ' * bool(prefix)}{unit}"


def _share(row: dict[str, Any]) -> str:
    return f"{100 * row['share']:.3g} % of {row['bound']}" if row["bound"] else ""
