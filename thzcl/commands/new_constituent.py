"""`thzcl new-constituent`: a package with a constituent of one's own to start from."""

from __future__ import annotations

from typing import Annotated

import typer


def new_constituent(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="name of the constituent, as [atmosphere.NAME]")
    ],
) -> None:
    """Write a package with something in the air to start from: it installs and runs as it is."""
    from thzcl.air.composition import HOOK
    from thzcl.commands.plugin_pages import write_new

    write_new(HOOK, name)
