"""`thzcl new`: a scene to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thzcl.errors import UsageError


def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="the TOML file to write")],
) -> None:
    """Write a commented scene to start from."""
    from thzcl.files import write_whole
    from thzcl.scenario.source import SHIPPED

    if file.exists():
        raise UsageError(f"{file}: exists already; choose another name")
    text = (SHIPPED / "quick.toml").read_text(encoding="utf-8")
    write_whole(file, lambda part: part.write_text(text, encoding="utf-8"))
    print(f"wrote {file}; edit it, then: thzcl run {file}")
