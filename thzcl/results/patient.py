"""A new file for HDF5, which cannot bear an error while it writes."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any


class Patient(io.RawIOBase):
    """A new file for HDF5, which delays errors until it is closed.

    The HDF5 library ends the process if an error, such as that of a full disk, is raised while it
    writes. Here the first error, an interrupt included, is stored until close() raises it. After an
    error nothing more is written, and zeros are read back.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b")
        self._error: BaseException | None = None

    def write(self, data: Any) -> int:
        """Writes all bytes, and returns their number."""
        self._try(lambda: self._file.write(data))
        return memoryview(data).nbytes

    def readinto(self, buffer: Any) -> int:
        """Reads from the file into a buffer, and returns the number of bytes.

        What the file does not hold is 0, since HDF5 would follow whatever the buffer held before.
        """
        count = self._try(lambda: self._file.readinto(buffer)) or 0
        rest = memoryview(buffer).cast("B")[count:]
        rest[:] = bytes(len(rest))
        return count

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Moves to a position in the file, and returns it."""
        return self._try(lambda: self._file.seek(offset, whence)) or 0

    def truncate(self, size: int | None = None) -> int:
        """Changes the file's size, and returns it."""
        return self._try(lambda: self._file.truncate(size)) or 0

    def flush(self) -> None:
        """Passes buffered bytes on to the operating system."""
        if not self.closed:
            self._try(self._file.flush)

    def close(self) -> None:
        """Closes the file, and raises the first error that has occurred, if any."""
        if self.closed:
            return
        self.flush()
        super().close()
        try:
            self._file.close()
        except OSError as error:  # the disk is still full, or the system reports it only now
            self._error = self._error or error
        if self._error is not None:
            raise self._error

    def _try(self, work: Callable[[], int | None]) -> int | None:
        """Returns what `work` returns, or None once an error has occurred."""
        if self._error is None:
            try:
                return work()
            except BaseException as error:  # noqa: BLE001 (raised by close())
                self._error = error
        return None
