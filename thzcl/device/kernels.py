"""Families of kernels: the files that they stand in, and the options that they are built with."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

FOLDER = Path(__file__).parents[1] / "kernels"
if not FOLDER.is_dir():  # straight from a checkout
    FOLDER = Path(__file__).parents[2] / "kernels"


@dataclass(frozen=True)
class Kernels:
    """A family of kernels. A subclass names its files, and has a field for each of its options.

    An option is named after its field in capitals. A number gives it a value, and a tuple several;
    True sets it without one, and False and None leave it out.
    """

    files: ClassVar[tuple[str, ...]] = ()
    gathers: ClassVar[bool] = False  # whether reads at each ray's own place are most of its work

    def options(self) -> list[str]:
        """Returns the options that are set, as NAME or NAME=value."""
        found = []
        for field in fields(self):
            name, value = field.name.upper(), getattr(self, field.name)
            if value is True:
                found.append(name)
            elif isinstance(value, tuple):
                found.append(f"{name}={','.join(map(str, value))}")
            elif value is not None and value is not False:
                found.append(f"{name}={value}")
        return found


def text_of(name: str) -> str:
    """Returns the text of a kernel file, under a line that names it in compilers' messages."""
    text = (FOLDER / f"{name}.cl").read_text(encoding="utf-8")
    return f'#line 1 "{name}.cl"\n{text}\n'
