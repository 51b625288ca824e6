"""`thzcl new-sensor`: a package with a sensor of one's own to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def new_sensor(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="name of the sensor, as [sensor] kind")
    ],
) -> None:
    """Write a package with a sensor of your own to start from: it installs and runs as it is."""
    from thzcl.plugins.template import write_package
    from thzcl.scenario.sensors import HOOK

    folder = write_package(HOOK, name, Path())
    print(f"wrote {folder}; next: pip install ./{folder} && thzcl run {folder}/scene.toml")
