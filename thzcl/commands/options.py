"""The arguments and options that several commands share."""

from __future__ import annotations

from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from thzcl.errors import UsageError


class TextFormat(StrEnum):
    """The forms of what is more than a table."""

    text = "text"
    json = "json"


class TableFormat(StrEnum):
    """The forms of a table."""

    table = "table"
    json = "json"
    csv = "csv"


class RecordFormat(StrEnum):
    """The forms of what a hygrometer's record tells."""

    table = "table"
    json = "json"


def _sources(incomplete: str) -> list[str]:
    """Returns the shipped scenes, scene files, results and folders whose names begin so."""
    from thzcl.scenario.source import shipped

    folder = Path(incomplete if incomplete.endswith("/") else Path(incomplete).parent)
    found = list(shipped())
    with suppress(OSError):
        for path in sorted(folder.iterdir()):
            if path.suffix in (".toml", ".nc"):
                found.append(str(path))
            elif path.is_dir():
                found.append(f"{path}/")
    return [name for name in found if name.startswith(incomplete)]


Source = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="a TOML file, a result (.nc), or the name of a shipped scene",
        autocompletion=_sources,
    ),
]
Folder = Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="folder for the files")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="TABLE.KEY=VALUE", help="change a key; may be repeated"),
]
Variants = Annotated[
    list[str] | None,
    typer.Option("--variant", metavar="NAME", help="only this variant; may be repeated"),
]
DeviceChoice = Annotated[
    str | None, typer.Option("--device", metavar="D", help="device: a number, or part of its name")
]
AllowOutside = Annotated[
    bool,
    typer.Option(
        "--allow-outside", help="let pictures and tables lie outside the scenario's folder"
    ),
]
HowText = Annotated[TextFormat, typer.Option("--format", help="how to print")]
HowTable = Annotated[TableFormat, typer.Option("--format", help="how to print")]
HowRecord = Annotated[RecordFormat, typer.Option("--format", help="how to print")]


def changes(settings: list[str] | None) -> dict[str, Any]:
    """Returns `--set` options as dotted keys and TOML values; what is not TOML is text.

    Raises UsageError for an option without a key or a value, for a list or table that is none, and
    for what is not UTF-8.
    """
    import tomli

    from thzcl.files import readable

    found: dict[str, Any] = {}
    for item in settings or []:
        name, equals, text = item.partition("=")
        if not equals or not name.strip():
            raise UsageError(
                f"--set {item}: write table.key=value, as in --set targets.box.temperature_k=290"
            )
        if readable(item) != item:
            raise UsageError(f"--set {item}: is not UTF-8; write it in letters that are")
        try:
            found[name.strip()] = tomli.loads(f"value = {text}")["value"]
        except (ValueError, RecursionError):  # no TOML, too many digits, or too deep
            if text.startswith(("[", "{")):
                raise UsageError(
                    f"--set {item}: {text} is no TOML list or table; a shell takes double quotes "
                    f"away, so that the whole must stand in single ones: --set '{name}=[\"a\"]'"
                ) from None
            found[name.strip()] = text
    return found
