"""Opens files from outside with one set of checks, and writes files whole or not at all.

A process that is killed (KILL, a power cut) leaves unfinished files. Their names tell which machine
and which process made them, so that the next process removes what nobody is going to finish.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import re
import shutil
import socket
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryFile, mkdtemp
from typing import TYPE_CHECKING, Any

from thzcl.errors import FileError, advice

if TYPE_CHECKING:
    import h5py
    import numpy as np
    from numpy.typing import NDArray

_DAY_S = 86400.0
_PART = re.compile(r"\.thzcl-([0-9a-f]{8})-(\d+)-")  # machine and process that made it
_IN_FOLDER = "paths start from the scenario's folder"
_NOT_REGULAR = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (lambda mode: stat.S_ISCHR(mode) or stat.S_ISBLK(mode), "a device"),
)


def readable(name: str) -> str:
    """Returns a file's name as valid UTF-8, in whatever way the locale decoded its bytes."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


@dataclass(frozen=True)
class Kind:
    """A kind of file from outside: its largest size in bytes, and the advice of messages."""

    most_bytes: int
    give: str  # advice for a file of another kind
    if_missing: str = _IN_FOLDER  # advice for a file that does not exist


SCENE = Kind(4_000_000, "give a TOML file", "check the name")
RESULT = Kind(64_000_000_000, "give a result written by `thzcl run`", "check the name")
PICTURE = Kind(64_000_000, "give a PNG or TIFF of 8 or 16 bit, or a .npy array")
CUBE = Kind(8_000_000_000, "give a NetCDF-4 file with absolute_humidity(z, y, x)")
TABLE = Kind(64_000_000, "give comma-separated numbers")
PROFILE = Kind(4_000_000, "give comma-separated columns with their names in the first line")
MESH = Kind(512_000_000, "give a mesh: OBJ, STL, PLY, GLB, or NPZ with vertices and faces")
RECORD = Kind(256_000_000, "give a file that thzcl has written", "check the name")
GRID = Kind(512_000_000, "give a NetCDF-4 file with a variable over named axes")


def open_regular(path: Path, kind: Kind) -> io.BufferedReader:
    """Returns a regular file of bounded size, opened for reading.

    Raises FileError for a file that is missing, too large or not readable, and for a folder, a
    pipe, a socket, a device and a link to itself. It waits for none of them.
    """
    try:
        _check(path, kind, path.stat())  # before it is opened: a pipe waits for its writer
        return path.open("rb")
    except OSError as error:
        raise _unreadable(path, kind, error) from None
    except FileError:
        raise
    except ValueError as error:  # a NUL, or letters that the file system does not know
        raise FileError(f"{str(path)!r}: no file can have this name ({error}); mend it") from None


def read_bytes(path: Path, kind: Kind) -> bytes:
    """Returns the bytes of a regular file. Raises FileError as open_regular does."""
    with open_regular(path, kind) as file:
        try:
            data = file.read(kind.most_bytes + 1) or b""
        except OSError as error:
            raise _unreadable(path, kind, error) from None
    _check_size(path, kind, len(data))
    return data


def digest(path: Path, kind: Kind) -> str:
    """Returns a file's SHA-256 in hexadecimal. Raises FileError as open_regular does."""
    with open_regular(path, kind) as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise _unreadable(path, kind, error) from None


def read_text(path: Path, kind: Kind) -> str:
    r"""Returns the text of a UTF-8 file, with lines that end in \n and without a byte-order mark.

    Raises FileError as open_regular does, and for a file that is not UTF-8.
    """
    data = read_bytes(path, kind)
    try:
        return io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8") from None


def read_json(path: Path, kind: Kind) -> Any:
    """Returns what a JSON file holds. Raises FileError as read_text and parse_json do."""
    return parse_json(read_text(path, kind), str(path), kind)


def parse_json(text: str | bytes, place: str, kind: Kind) -> Any:
    """Returns what a JSON text holds. Raises FileError, which names `place`, for any other text.

    NaN and infinities are no JSON.
    """
    try:
        return json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{place}: is no JSON that can be read ({error}); {kind.give}") from None


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")


@contextmanager
def open_netcdf(path: Path, kind: Kind) -> Iterator[h5py.File]:
    """Opens a NetCDF-4 file for reading; the context should do nothing but read it.

    Raises FileError for a file that cannot be opened. Errors of the HDF5 library, and other errors
    while the context reads the file, become a FileError too.
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
    """Raises FileError for anything but a regular file of bounded size."""
    if not stat.S_ISREG(found.st_mode):
        what = next((name for test, name in _NOT_REGULAR if test(found.st_mode)), "no file")
        raise FileError(f"{path}: cannot be read: {what}, not a regular file; {kind.give}")
    _check_size(path, kind, found.st_size)


def _check_size(path: Path, kind: Kind, size: int) -> None:
    """Raises FileError for a size, in bytes, above the largest of its kind."""
    if size > kind.most_bytes:
        raise FileError(
            f"{path}: {size / 1e6:.6g} MB, larger than {kind.most_bytes / 1e6:g} MB; give less"
        )


def _unreadable(path: Path, kind: Kind, error: OSError) -> FileError:
    """Returns the error for a file that the operating system cannot read, with a remedy."""
    remedy = kind.if_missing if error.errno == errno.ENOENT else advice(error)
    return FileError(f"{path}: cannot be read: {error.strerror or error}; {remedy}")


def read_table(path: Path) -> NDArray[np.float64]:
    """Returns the numbers of a CSV file, (row, column), all of them finite.

    Empty lines, lines that start with "#" and one line of names at the top are skipped. Raises
    FileError as open_regular does, and for the first line that is unlike the others.
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


def read_columns(path: Path) -> dict[str, NDArray[np.float64]]:
    """Returns the columns of a CSV file of numbers by the names in its first line, (row,) each.

    Raises FileError as read_table does, and for names that are missing or stand there twice.
    """
    lines = read_text(path, TABLE).splitlines()
    first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    names = [name.strip() for name in first.split(",")]
    if not first or _numbers(first) is not None or len({*names}) < len(names):
        raise FileError(f"{path}: its first line must name the columns, each once; add it")
    rows = read_table(path)
    if rows.shape[1] != len(names):
        text = f"{rows.shape[1]} columns, the first line names {len(names)}"
        raise FileError(f"{path}: {text}; give every line as many")
    return dict(zip(names, rows.T, strict=True))


def _numbers(line: str) -> list[float] | None:
    """Returns the numbers of a line, or None if it contains anything else."""
    try:
        return [float(number) for number in line.split(",")]
    except ValueError:
        return None


def inside(folder: Path, name: str, *, allow_outside: bool) -> Path:
    """Returns the path of a file, `name` being relative to a folder.

    Raises FileError if the path leads out of the folder, unless `allow_outside` is true.
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
    """Makes a folder if there is none, and checks that files can be written to it.

    Raises OSError if that fails.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with _named(folder), TemporaryFile(dir=folder):
        pass


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Calls `write` with a temporary file beside `path`, which replaces `path` when it is whole.

    If `write` raises an error or is interrupted, `path` stays as it was. Raises OSError if the file
    cannot be written.
    """
    with _named(path), part_beside(path) as part:
        write(part)
        mask = os.umask(0)
        os.umask(mask)
        part.chmod(0o666 & ~mask)
        part.replace(path)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Makes errors of the operating system name the user's path, not that of a temporary file."""
    try:
        yield
    except OSError as error:
        if error.errno is not None:  # otherwise it has no fields but its text
            error.filename, error.filename2 = str(path), None
        raise


@contextmanager
def part_beside(path: Path) -> Iterator[Path]:
    """Makes an empty unfinished file in a path's folder, and removes it if it is still there.

    Raises OSError if there can be none.
    """
    sweep(path.parent)
    part = path.parent / f"{_prefix()}{token_hex(8)}{path.suffix}"  # no other process takes it
    try:  # before it is made: an interrupt may come at once
        part.touch(0o600, exist_ok=False)
        yield part
    finally:
        part.unlink(missing_ok=True)


def make_passing_folder(place: Path) -> Path:
    """Returns a new folder, which this process should remove at its end. Raises OSError."""
    sweep(place)
    return Path(mkdtemp(prefix=_prefix(), dir=place))


@cache
def sweep(folder: Path) -> None:
    """Removes what killed processes left in a folder; a process looks there once.

    That is what processes of this machine made that live no longer, and what has not been touched
    for a day. What cannot be removed stays.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            found = _PART.match(path.name)
            if found and _left(path, found[1], int(found[2])):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    with suppress(OSError):
                        path.unlink()


def _left(path: Path, machine: str, process: int) -> bool:
    """Returns whether nobody is going to finish a file or folder."""
    if machine == this_machine():
        with suppress(PermissionError):  # it lives, and is another user's
            return not _lives(process)
    with suppress(OSError):
        return time.time() - path.stat().st_mtime > _DAY_S
    return False


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    return True


def _prefix() -> str:
    return f".thzcl-{this_machine()}-{os.getpid()}-"


@cache
def this_machine() -> str:
    """Returns a short text for this machine; containers count processes for themselves."""
    counted = ""
    with suppress(OSError):
        counted = str(Path("/proc/self/ns/pid").readlink())
    return hashlib.sha256(f"{socket.gethostname()} {counted}".encode()).hexdigest()[:8]
