"""`thzcl convergence`: error against run time for every knob."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thzcl.commands.options import (
    AllowOutside,
    DeviceChoice,
    Folder,
    HowTable,
    Settings,
    Source,
    TableFormat,
    Variants,
    changes,
)

if TYPE_CHECKING:
    from thzcl.commands.tables import Table

Knobs = Annotated[
    str,
    typer.Option(metavar="A,B,...", help="only these knobs; all that make a difference if absent"),
]
Repeat = Annotated[
    int,
    typer.Option(min=1, metavar="N", help="timed runs of each setting, of which the median counts"),
]


def convergence(
    scenario: Source,
    output: Folder = Path(),
    knobs: Knobs = "",
    repeat: Repeat = 5,
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    how: HowTable = TableFormat.table,
) -> None:
    """Error against run time for every knob: DIR/<scenario>-convergence.png, .csv and .json.

    Interrupted, it goes on later.
    """
    from thzcl.commands.tables import show, show_json
    from thzcl.commands.terminal import progress, wrote
    from thzcl.device.choose import open_device
    from thzcl.files import make_folder
    from thzcl.studies.convergence.study import study
    from thzcl.studies.convergence.subject import Subject

    subject = Subject(
        scenario, changes(settings), variant or (), open_device(device), allow_outside
    )
    wanted = [name.strip() for name in knobs.split(",") if name.strip()]
    make_folder(output)
    with progress() as tell:
        found = study(subject, output, wanted, repeat, tell)
    if how is TableFormat.json:
        show_json(found)
    elif how is TableFormat.csv:
        print(Path(found["files"][1]).read_text(encoding="utf-8"), end="")
    else:
        show(*tables(found))
        wrote(found["files"])


def tables(found: dict[str, Any]) -> list[Table]:
    """Returns a study of error against run time as tables."""
    from thzcl.commands.tables import Column, Table

    columns = (
        Column("knob"),
        Column("setting"),
        Column("time", "ms", ".3g"),
        Column("rms error / contrast", form=".2g"),
        Column("largest / contrast", form=".2g"),
        Column(""),
    )
    points = tuple(
        (
            point["knob"],
            point["setting"] + (" (default)" if point["default"] else ""),
            1e3 * point["seconds"],
            point["error_rms"],
            point["error_max"],
            "front" if point["on_front"] else "",
        )
        for point in found["points"]
    )
    ratio = (Column("knob"), Column("default's time over the front's", form=".2f"))
    left_out = tuple((item["knob"], item["reason"]) for item in found["left_out"])
    return [
        Table(f"{found['scenario']}: error against run time", columns, points, keys=2),
        Table("", ratio, tuple(found["default_over_front"].items())),
        Table("", (Column("left out"), Column("why")), left_out),
    ]
