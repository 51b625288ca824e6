"""`thzcl report`: one self-contained page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    result: Annotated[
        Path,
        typer.Argument(metavar="RESULT.nc|DIR", help="a result, or the folder of a study or range"),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.html", help="beside what it is of by default"),
    ] = None,
) -> None:
    """Write a report of a result, a study or an answer about range: one HTML file."""
    from thzcl.commands.terminal import wrote

    wrote([str(write(result, output))])


def write(result: Path, output: Path | None = None) -> Path:
    """Writes a report, whole or not at all, and returns its path. Raises UsageError."""
    from thzcl.errors import UsageError
    from thzcl.files import write_whole
    from thzcl.results.report import report as page_of

    file = output or (result / "report.html" if result.is_dir() else result.with_suffix(".html"))
    if file.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"-o {file}: a report is HTML; let its name end in .html")
    text = page_of(result)
    write_whole(file, lambda part: part.write_text(text, encoding="utf-8"))
    return file
