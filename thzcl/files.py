"""Files from outside, opened through one door, and files that are written whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

from thzcl.errors import FileError, advice

if TYPE_CHECKING:
    import h5py
    import numpy as np
    from numpy.typing import NDArray

_IN_FOLDER = "paths start from the scenario's folder"
_NOT_REGULAR = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (lambda mode: stat.S_ISCHR(mode) or stat.S_ISBLK(mode), "a device"),
)


@dataclass(frozen=True)
class Kind:
    """A kind of file from outside: the most bytes that it may have, and what messages advise."""

    most_bytes: int
    give: str  # in place of a file that is no such thing
    if_missing: str = _IN_FOLDER


SCENE = Kind(4_000_000, "give a TOML file", "check the name")
RESULT = Kind(64_000_000_000, "give a result written by `thzcl run`", "check the name")
PICTURE = Kind(64_000_000, "give a PNG or TIFF of 8 or 16 bit, or a .npy array")
CUBE = Kind(8_000_000_000, "give a NetCDF-4 file with absolute_humidity(z, y, x)")
TABLE = Kind(64_000_000, "give comma-separated numbers")


def open_regular(path: Path, kind: Kind) -> io.BufferedReader:
    """Opens a regular file of bounded size for reading.

    Raises FileError for a file that is missing, too large or not to be read, and for a folder,
    a pipe, a socket, a device and a link to itself, without waiting for any of them.
    """
    try:
        _check(path, kind, path.stat())  # before it is opened: a pipe would wait for its writer
        return path.open("rb")
    except OSError as error:
        raise _unreadable(path, kind, error) from None
    except FileError:
        raise
    except ValueError as error:  # a NUL, or letters that the file system has not
        raise FileError(f"{str(path)!r}: no file can have this name ({error}); mend it") from None


def read_bytes(path: Path, kind: Kind) -> bytes:
    """Returns what a regular file of bounded size holds. Raises FileError."""
    with open_regular(path, kind) as file:
        try:
            data = file.read(kind.most_bytes + 1) or b""
        except OSError as error:
            raise _unreadable(path, kind, error) from None
    _check_size(path, kind, len(data))
    return data


def digest(path: Path, kind: Kind) -> str:
    """Returns the SHA-256 of a file's bytes, in hexadecimal. Raises FileError."""
    with open_regular(path, kind) as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise _unreadable(path, kind, error) from None


def read_text(path: Path, kind: Kind) -> str:
    r"""Returns the text of a UTF-8 file, with lines that end in \n and without a byte-order mark.

    Raises FileError.
    """
    data = read_bytes(path, kind)
    try:
        return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None


@contextmanager
def open_netcdf(path: Path, kind: Kind) -> Iterator[h5py.File]:
    """Opens a NetCDF-4 file for reading; only reading should be done within the context.

    Raises FileError, also for whatever the HDF5 library raises while the file is read.
    """
    import h5py

    with open_regular(path, kind) as file:
        try:
            if file.read(3) == b"CDF":
                raise FileError(
                    f"{path}: classic NetCDF, not NetCDF-4; convert it with nccopy -k nc4 IN OUT"
                )
            file.seek(0)
            with h5py.File(file, "r") as opened:
                yield opened
        except FileError:
            raise
        except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
            reason = str(error).strip("'\"")
            raise FileError(f"{path}: cannot be read: {reason}; {kind.give}") from None


def _check(path: Path, kind: Kind, found: os.stat_result) -> None:
    """Raises FileError for what is not a regular file of bounded size."""
    if not stat.S_ISREG(found.st_mode):
        what = next((name for test, name in _NOT_REGULAR if test(found.st_mode)), "no file")
        raise FileError(f"{path}: cannot be read: {what}, not a regular file; {kind.give}")
    _check_size(path, kind, found.st_size)


def _check_size(path: Path, kind: Kind, size: int) -> None:
    if size > kind.most_bytes:
        raise FileError(
            f"{path}: {size / 1e6:.6g} MB, larger than {kind.most_bytes / 1e6:g} MB; give less"
        )


def _unreadable(path: Path, kind: Kind, error: OSError) -> FileError:
    remedy = kind.if_missing if error.errno == errno.ENOENT else advice(error)
    return FileError(f"{path}: cannot be read: {error.strerror or error}; {remedy}")


def read_table(path: Path) -> NDArray[np.float64]:
    """Returns the numbers of a CSV file, (row, column), all finite.

    Empty lines and lines that start with "#" are passed over, and so is a line of names at the
    top. Raises FileError naming the line that is not like the others.
    """
    import numpy as np

    rows: list[list[float]] = []
    named = False
    for number, line in enumerate(read_text(path, TABLE).splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        row = _numbers(line)
        if row is None and not rows and not named:
            named = True
        elif row is None:
            raise FileError(
                f"{path}:{number}: not comma-separated numbers: {line.strip()[:60]}; mend the line"
            )
        elif not np.isfinite(row).all():
            raise FileError(
                f"{path}:{number}: not finite: {line.strip()[:60]}; mend or remove the line"
            )
        elif rows and len(row) != len(rows[0]):
            raise FileError(
                f"{path}:{number}: {len(row)} columns, the lines before have {len(rows[0])}; "
                "give every line as many"
            )
        else:
            rows.append(row)
    if not rows:
        raise FileError(f"{path}: holds no numbers; give comma-separated columns")
    return np.array(rows)


def _numbers(line: str) -> list[float] | None:
    """Returns the numbers of a line, or None if it holds anything else."""
    try:
        return [float(cell) for cell in line.split(",")]
    except ValueError:
        return None


def inside(folder: Path, name: str, *, allow_outside: bool) -> Path:
    """Returns the path of the file of that name, seen from a folder.

    Raises FileError if it leads out of the folder, unless that is allowed.
    """
    path = folder / name
    try:
        leads_out = not path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a link to itself, a NUL
        raise FileError(f"{path}: cannot be read: {error}; mend the link or the name") from None
    if leads_out and not allow_outside:
        raise FileError(
            f"{name}: leads out of the scenario's folder; move it there, or pass --allow-outside"
        )
    return path


def make_folder(folder: Path) -> None:
    """Makes sure that files can be written to a folder, before work is spent on them.

    Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _named(folder), NamedTemporaryFile(dir=folder, prefix=".thzcl."):
        pass


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Has `write` fill a temporary file beside `path`, which takes its place only when whole.

    Raises OSError.
    """
    with (
        _named(path),
        NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix, delete=False
        ) as file,
    ):
        part = Path(file.name)
    try:
        with _named(path):
            write(part)
            mask = os.umask(0)
            os.umask(mask)
            part.chmod(0o666 & ~mask)
            part.replace(path)
    except BaseException:  # an interrupt too leaves nothing half written
        part.unlink(missing_ok=True)
        raise


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Has errors of the operating system name the path that the user knows, not a temporary one."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:  # else its text is all that it has
            error.filename, error.filename2 = str(path), None
        raise


class Patient(io.RawIOBase):
    """A new file for HDF5, which ends the process where a disk is full unless errors wait.

    The first error, an interrupt included, is kept until close() raises it. After it nothing more
    is written, and what is read back is not to be believed.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b")
        self._error: BaseException | None = None

    def write(self, data: Any) -> int:
        """Writes all bytes, and returns how many there are."""
        self._try(lambda: self._file.write(data))
        return memoryview(data).nbytes

    def readinto(self, buffer: Any) -> int:
        """Reads what was written into a buffer, and returns the number of bytes."""
        return self._try(lambda: self._file.readinto(buffer)) or 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Moves to a place in the file, and returns it."""
        return self._try(lambda: self._file.seek(offset, whence)) or 0

    def truncate(self, size: int | None = None) -> int:
        """Makes the file shorter or longer, and returns its size."""
        return self._try(lambda: self._file.truncate(size)) or 0

    def flush(self) -> None:
        """Hands what was written over to the system."""
        if not self.closed:
            self._try(self._file.flush)

    def close(self) -> None:
        """Closes the file, and raises the first error that came."""
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
