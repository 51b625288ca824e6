"""What the commands have in common on their command lines."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from enum import StrEnum
from typing import Annotated, Any

import typer


class UsageError(Exception):
    """The command line makes no sense; the text says why and what would."""


class Format(StrEnum):
    """How to print."""

    text = "text"
    json = "json"


class TableFormat(StrEnum):
    """How to print a table."""

    table = "table"
    json = "json"
    csv = "csv"


class RecordFormat(StrEnum):
    """How to print what a record tells."""

    table = "table"
    json = "json"


Source = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO", help="a TOML file, a result (.nc), or the name of a shipped scene"
    ),
]
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
HowToPrint = Annotated[Format, typer.Option("--format", help="how to print")]
HowToTell = Annotated[RecordFormat, typer.Option("--format", help="how to print")]
HowToTabulate = Annotated[TableFormat, typer.Option("--format", help="how to print")]


def changes(given: list[str] | None) -> dict[str, Any]:
    """`--set` options as dotted keys and TOML values; what is not TOML is text."""
    import tomli

    found: dict[str, Any] = {}
    for item in given or []:
        name, equals, text = item.partition("=")
        if not equals or not name.strip():
            raise UsageError(
                f"--set {item}: write table.key=value, as in --set targets.box.temperature_k=290"
            )
        try:
            found[name.strip()] = tomli.loads(f"value = {text}")["value"]
        except tomli.TOMLDecodeError:
            found[name.strip()] = text
    return found


def complain(lines: Iterable[str], code: int) -> int:
    """Prints what is wrong, and returns the exit code."""
    for line in lines:
        print(line, file=sys.stderr)
    return code
