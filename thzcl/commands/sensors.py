"""`thzcl sensors`: the sensors, or the manual page of one."""

from __future__ import annotations

from typing import Annotated

import typer


def sensors(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="a sensor, for its manual page")
    ] = None,
) -> None:
    """List the sensors, or show one's manual page and parameters."""
    from thzcl.commands.plugin_pages import show_all, show_one
    from thzcl.scenario.sensors import HOOK

    if name is None:
        show_all(HOOK)
    else:
        show_one(HOOK, name, f'[sensor] kind = "{name}"')
