"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from tempfile import NamedTemporaryFile


def make_folder(folder: Path) -> None:
    """Makes sure that files can be written to a folder, before work is spent on them. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(dir=folder, prefix=".thzcl."):
        pass


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Has `write` fill a temporary file beside `path`, which takes its place only when whole. Raises OSError."""
    with NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix, delete=False) as file:
        part = Path(file.name)
    try:
        write(part)
        mask = os.umask(0)
        os.umask(mask)
        part.chmod(0o666 & ~mask)
        part.replace(path)
    except BaseException:  # an interrupt too leaves nothing half written
        part.unlink(missing_ok=True)
        raise
