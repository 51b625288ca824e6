"""Files: written whole or not at all; small tables read."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LARGEST_TABLE = 64_000_000  # bytes


def make_folder(folder: Path) -> None:
    """Makes sure that files can be written to a folder, before work is spent on them.

    Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with NamedTemporaryFile(dir=folder, prefix=".thzcl."):
        pass


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Has `write` fill a temporary file beside `path`, which takes its place only when whole.

    Raises OSError.
    """
    with NamedTemporaryFile(
        dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix, delete=False
    ) as file:
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


class Patient(io.RawIOBase):
    """A new file for HDF5, which takes the process down where a disk is full: errors are kept, and raised once it is done.

    An interrupt is one too. After the first nothing more is written, and what is read back is not to be believed.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b")
        self._error: BaseException | None = None

    def write(self, data: Any) -> int:
        """Writes all of it."""
        self._try(lambda: self._file.write(data))
        return memoryview(data).nbytes

    def readinto(self, buffer: Any) -> int:
        """Reads what was written."""
        return self._try(lambda: self._file.readinto(buffer)) or 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Moves on."""
        return self._try(lambda: self._file.seek(offset, whence)) or 0

    def truncate(self, size: int | None = None) -> int:
        """Cuts off, or makes longer."""
        return self._try(lambda: self._file.truncate(size)) or 0

    def flush(self) -> None:
        """Hands over to the system."""
        if not self.closed:
            self._try(self._file.flush)

    def close(self) -> None:
        """Raises the first error that came."""
        if self.closed:
            return
        self.flush()
        super().close()
        try:
            self._file.close()
        except OSError as error:  # as full as before, or what is only told at the end
            self._error = self._error or error
        if self._error is not None:
            raise self._error

    def _try(self, work: Callable[[], int | None]) -> int | None:
        if self._error is None:
            try:
                return work()
            except BaseException as error:  # noqa: BLE001 (raised by close())
                self._error = error
        return None


def inside(folder: Path, name: str, *, allow_outside: bool) -> Path:
    """The file of that name, seen from a folder; not outside of it unless allowed.

    Raises ValueError.
    """
    path = folder / name
    if not allow_outside and not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(
            f"{name}: leads out of the scenario's folder; move it there, or pass --allow-outside"
        )
    return path


def read_table(path: Path) -> NDArray[np.float64]:
    """The rows of numbers of a CSV file, (row, column); lines of "#" and a line of names at the top are passed over.

    Raises ValueError naming the line that is not like the others.
    """
    import numpy as np

    try:
        if path.stat().st_size > LARGEST_TABLE:
            raise ValueError(
                f"{path}: larger than {LARGEST_TABLE / 1e6:g} MB; give a shorter table"
            )
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ValueError(
            f"{path}: cannot be read: {error.strerror}; paths start from the scenario's folder"
        ) from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: not a text file; give comma-separated numbers") from None
    rows: list[list[float]] = []
    named = False
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            row = [float(cell) for cell in line.split(",")]
        except ValueError:
            if rows or named:
                raise ValueError(
                    f"{path}:{number}: not comma-separated numbers: {line.strip()[:60]}"
                ) from None
            named = True
            continue
        if rows and len(row) != len(rows[0]):
            raise ValueError(
                f"{path}:{number}: {len(row)} columns, the lines before have {len(rows[0])}"
            )
        rows.append(row)
    if not rows:
        raise ValueError(f"{path}: holds no numbers; give comma-separated columns")
    return np.array(rows)
