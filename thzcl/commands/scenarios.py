"""`thzcl scenarios`: the scenes that come with thzcl."""

from __future__ import annotations

from typing import Annotated

import typer


def scenarios(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="print this one")] = None,
) -> None:
    """List the shipped scenes, or print one to start from."""
    from thzcl.commands.tables import Column, Table, show
    from thzcl.scenario.source import shipped, shipped_text

    if name is None:
        show(Table("", (Column("scene"), Column("")), tuple(shipped().items())))
    else:
        print(shipped_text(name), end="")
