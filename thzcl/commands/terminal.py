"""What commands say beside their tables: notes, progress, and what is wrong."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress

PIPE_WIDTH = 240  # columns, where there is no terminal to keep to


def width_to_keep() -> int | None:
    """Returns COLUMNS, or the width of the terminal on stdout, or None if there is neither."""
    return shutil.get_terminal_size((0, 0)).columns or None


def note(text: str) -> None:
    """Prints a line, folded where there is a width to keep to; no word of it is broken."""
    width = width_to_keep()
    if width:
        text = textwrap.fill(
            text, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
        )
    print(text)


def page(text: str) -> None:
    """Prints a manual page; paragraphs are folded again where one of their lines is too long.

    A paragraph that has indented lines stays as it is.
    """
    width = width_to_keep()
    for number, paragraph in enumerate(text.split("\n\n")):
        lines = paragraph.splitlines()
        long = width is not None and any(len(line) > width for line in lines)
        if width and long and not any(line.startswith((" ", "\t")) for line in lines):
            paragraph = textwrap.fill(" ".join(lines), width, break_on_hyphens=False)  # noqa: PLW2901
        print(f"\n{paragraph}" if number else paragraph)


def wrote(files: Iterable[str]) -> None:
    """Prints which files were written; a path is not folded."""
    for file in files:
        print(f"wrote {file}")


def complain(lines: Iterable[str]) -> None:
    """Prints what is wrong on stderr, as far as that can be written to."""
    with suppress(OSError, ValueError):  # full, or closed
        for line in lines:
            print(line, file=sys.stderr)


@contextmanager
def progress(*, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Gives a function that shows the stage at work, on a terminal's stderr.

    Elsewhere, and if quiet, the function does nothing.
    """
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield _ignore
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("starting") as status:
        yield lambda stage: status.update(Text(stage))


def _ignore(stage: str) -> None:
    """Shows nothing."""
