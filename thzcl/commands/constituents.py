"""`thzcl constituents`: what air can be made of, or the manual page of one constituent."""

from __future__ import annotations

from typing import Annotated

import typer


def constituents(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="a constituent, for its manual page")
    ] = None,
) -> None:
    """List what air can be made of, or show one's manual page and parameters."""
    from thzcl.air.composition import HOOK, constituent_class
    from thzcl.commands.plugin_pages import show_all, show_one

    if name is None:
        show_all(HOOK)
        return
    gas = f'[atmosphere] model = "{name}", and '
    where = gas if constituent_class(name).gas else ""
    show_one(HOOK, name, f"{where}[atmosphere.{name}]")
