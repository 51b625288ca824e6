"""`thzcl stress`: stiff and extreme cases, each against its reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from thzcl.commands.options import DeviceChoice, HowTable, TableFormat
from thzcl.errors import DONE, FAILED

if TYPE_CHECKING:
    from thzcl.commands.tables import Table


def stress(device: DeviceChoice = None, how: HowTable = TableFormat.table) -> int:
    """Run the stiff and extreme cases, each against its reference."""
    from thzcl.commands.tables import as_csv, as_records, from_records, show, show_json
    from thzcl.commands.terminal import complain, progress
    from thzcl.studies.stress.cases import cases
    from thzcl.studies.stress.trial import examine

    with progress() as tell:
        found = [outcome.record() for outcome in examine(cases(), device, tell)]
    if how is TableFormat.json:
        show_json({"cases": as_records(from_records(found))})
    elif how is TableFormat.csv:
        print(as_csv(from_records(found)), end="")
    else:
        show(table(found))
    failed = [case["name"] for case in found if not case["passed"]]
    if not failed:
        return DONE
    complain([f"{len(failed)} of {len(found)} cases failed: {', '.join(failed)}"])
    return FAILED


def table(cases: list[dict[str, Any]]) -> Table:
    """Returns the outcomes of the cases as a table."""
    from thzcl.commands.tables import Column, Table

    columns = (
        Column("case: what, arithmetic"),
        Column("measured", form=".6g"),
        Column("reference", form=".6g"),
        Column("relative error", form=".1e"),
        Column("bound", form=".0e"),
        Column(""),
    )
    rows = tuple(
        (
            *(case[key] for key in ("name", "measured", "reference", "error", "bound")),
            "passed" if case["passed"] else "FAILED",
        )
        for case in cases
    )
    return Table("", columns, rows)
