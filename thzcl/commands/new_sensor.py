"""`thzcl new-sensor`: a package with a sensor of one's own to start from."""

from __future__ import annotations

from typing import Annotated

import typer


def new_sensor(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="name of the sensor, as [sensor] kind")
    ],
) -> None:
    """Write a package with a sensor of your own to start from: it installs and runs as it is."""
    from thzcl.commands.plugin_pages import write_new
    from thzcl.scenario.sensors import HOOK

    write_new(HOOK, name)
