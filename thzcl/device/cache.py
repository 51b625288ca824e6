"""The folders in which built kernels, and what was tried, are kept: thzcl's own, and PoCL's.

thzcl does without its own where that cannot be written. PoCL cannot: it shows no device, or ends
the process, so that kernels are then built in another place, for as long as this process lives.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from thzcl.errors import DeviceError
from thzcl.files import make_passing_folder, part_beside

ROOM_BYTES = 32_000_000  # that built kernels, and what PoCL makes on the way, may take
_TRIED_BYTES = 1_000_000  # written to see whether they can be


class KernelCache(NamedTuple):
    """PoCL's cache, with what to tell of it; `problem` says why there is none, if so."""

    note: str = ""
    problem: str = ""


def user_caches() -> Path:
    """Returns the folder of a user's caches; it need not exist."""
    own = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if own.is_absolute():
        return own
    try:
        return Path.home() / ".cache"
    except RuntimeError:  # a user whom the machine does not know
        return Path("/.cache")


def cache_folder() -> Path:
    """Returns the folder of thzcl's cache; it need not exist."""
    return user_caches() / "thzcl"


def kernel_folder() -> Path:
    """Returns the folder in which PoCL keeps what it builds; it need not exist."""
    own = os.environ.get("POCL_CACHE_DIR")
    return Path(own) if own else user_caches() / "pocl" / "kcache"


def fault(folder: Path) -> str | None:
    """Returns why kernels cannot be built in a folder, in words, or None if they can.

    The folder is made if there is none.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(_TRIED_BYTES))
        found = os.statvfs(folder)
    except OSError as error:
        return f"cannot be written: {error.strerror or error}"
    if found.f_flag & os.ST_NOEXEC:
        return "may hold no programs (it is mounted noexec)"
    free = found.f_bavail * found.f_frsize
    if free < ROOM_BYTES:
        return f"has room for {free / 1e6:.3g} MB, and kernels may take {ROOM_BYTES / 1e6:.0f} MB"
    return None


@cache
def settle() -> KernelCache:
    """Tells PoCL to build kernels in another place, if it cannot where it would.

    It must be called before the platforms are listed, and does nothing the second time.
    """
    usual = kernel_folder()
    reason = fault(usual)
    if reason is None:
        if not any(map(os.environ.get, ("POCL_CACHE_DIR", "XDG_CACHE_HOME", "HOME"))):
            os.environ["POCL_CACHE_DIR"] = str(usual)  # it would have a folder for all users
        return KernelCache()
    told, mend = (
        f"PoCL's kernel cache {usual} {reason}",
        "export POCL_CACHE_DIR=<a folder of yours>",
    )
    for place in _other_places():
        if fault(place) is None:
            with suppress(OSError):
                os.environ["POCL_CACHE_DIR"] = str(_passing(place))
                by = f"kernels are built in {place} and not kept"
                return KernelCache(note=f"{told}; {by}; mend that, or {mend}")
    return KernelCache(problem=f"{told}, nor does another place serve; make room there, or {mend}")


def _other_places() -> Iterator[Path]:
    """Yields where temporary files may lie."""
    with suppress(OSError):  # no folder can be written
        yield Path(tempfile.gettempdir())
    yield Path("/dev/shm")  # noqa: S108 (a folder of this process's own is made in it)


def _passing(place: Path) -> Path:
    """Returns a new folder in a place, which goes when this process ends. Raises OSError."""
    folder, owner = make_passing_folder(place), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a forked child has a copy of what is to be done at the end
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


def folder_of_programs(name: str) -> Path:
    """Returns a folder for programs that others run, in the cache or for this process alone.

    Raises DeviceError if there is no place for it.
    """
    if fault(cache_folder() / name) is None:
        return cache_folder() / name
    for place in _other_places():
        if fault(place) is None:
            with suppress(OSError):
                return _passing(place)
    raise DeviceError(f"{cache_folder()} cannot hold a linker; make room, or set XDG_CACHE_HOME")


def entry(kind: str, identity: Iterable[str]) -> Path:
    """Returns the path of an entry, by everything that it depends on."""
    digest = hashlib.sha256("\0".join(identity).encode()).hexdigest()
    return cache_folder() / kind / digest


def load(path: Path) -> bytes | None:
    """Returns the content of an entry, or None if it is missing or spoilt."""
    try:
        whole = path.read_bytes()
    except OSError:
        return None
    digest, content = whole[:32], whole[32:]
    return content if hashlib.sha256(content).digest() == digest else None


def keep(path: Path, content: bytes) -> None:
    """Writes an entry, whole, with its digest, if the cache can be written."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with part_beside(path) as part:
            part.write_bytes(hashlib.sha256(content).digest() + content)
            part.replace(path)
