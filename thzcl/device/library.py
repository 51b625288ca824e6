"""Which shared library on disk serves an OpenCL platform."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

MAPS = Path("/proc/self/maps")


class _Mapping(NamedTuple):
    """A stretch of this process's memory, and the file that it shows, if any."""

    first: int
    end: int
    readable: bool
    path: str


def path_of(platform: int) -> str:
    """Returns the path of the library that serves a platform, or "" where it cannot be told.

    `platform` is the address of the platform's object. That begins with the address of a table of
    the library's own functions, as OpenCL's extension cl_khr_icd has it.
    """
    maps = _maps()
    table = _word_at(platform, maps)
    function = _word_at(table, maps)
    path = next((one.path for one in maps if one.first <= function < one.end), "")
    return path if path.startswith("/") else ""


def _maps() -> list[_Mapping]:
    """Returns the mappings of this process; none where the system does not tell them."""
    found = []
    with suppress(OSError):
        for line in MAPS.read_text(encoding="utf-8", errors="replace").splitlines():
            span, access, _, _, _, *path = line.split(maxsplit=5)
            first, end = (int(address, 16) for address in span.split("-"))
            found.append(_Mapping(first, end, access.startswith("r"), "".join(path)))
    return found


def _word_at(address: int, maps: list[_Mapping]) -> int:
    """Returns the 64 bits at an address, or 0 where nothing can be read."""
    for one in maps:
        if one.readable and one.first <= address and address + 8 <= one.end:
            return ctypes.c_uint64.from_address(address).value
    return 0
