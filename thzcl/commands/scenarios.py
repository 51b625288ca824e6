"""`thzcl scenarios`: the scenes that come with thzcl."""

from __future__ import annotations


def scenarios() -> None:
    """List the shipped scenes."""
    from thzcl.commands.tables import Column, Table, show
    from thzcl.scenario.source import shipped

    show(Table("", (Column("scene"), Column("")), tuple(shipped().items())))
