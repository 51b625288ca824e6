"""`thzcl sensors`: the sensors, or the manual page of one."""

from __future__ import annotations

from typing import Annotated

import typer


def sensors(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="a sensor, for its manual page")
    ] = None,
) -> None:
    """List the sensors, or show one's manual page and parameters."""
    from thzcl.commands.tables import Column, Table, show
    from thzcl.commands.terminal import page
    from thzcl.plugins.loader import origins
    from thzcl.scenario.manual import manual, summary
    from thzcl.scenario.sensors import HOOK

    if name is not None:
        text, rows = manual(name)
        page(text)
        print()
        columns = tuple(map(Column, ("key", "unit", "default", "limits", "meaning")))
        show(Table(f'[sensor] kind = "{name}"', columns, tuple(map(tuple, rows))))
        return
    rows = [[origin.name, origin.distribution, summary(origin)] for origin in origins(HOOK)]
    show(Table("", (Column("sensor"), Column("from"), Column("")), tuple(map(tuple, rows))))
