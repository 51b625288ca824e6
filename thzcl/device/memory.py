"""How much memory this process may use: the machine's, a container's, or what a shell allows."""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc/self")
CGROUPS = Path("/sys/fs/cgroup")


def available_memory() -> int:
    """Returns the least of the machine's memory, the control groups' limits and the address space.

    The address space (`ulimit -v`) counts less what is mapped already. All in bytes.
    """
    return min([_physical(), *_cgroups(PROC / "cgroup", CGROUPS), *_address_space()])


def _physical() -> int:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _address_space() -> Iterator[int]:
    """Yields what is left of the address space, if it is limited."""
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft == resource.RLIM_INFINITY:
        return
    mapped = 0
    with suppress(OSError):
        pages = (PROC / "statm").read_text(encoding="ascii").split()[0]
        mapped = int(pages) * resource.getpagesize()
    yield max(soft - mapped, 0)


def _cgroups(membership: Path, root: Path) -> Iterator[int]:
    """Yields the limit of every control group that this process is in, of version 2 and of 1."""
    try:
        lines = membership.read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if not controllers:
            yield from _limits(root, group, "memory.max")
        elif "memory" in controllers.split(","):
            yield from _limits(root / "memory", group, "memory.limit_in_bytes")


def _limits(root: Path, group: str, name: str) -> Iterator[int]:
    """Yields the limits of a group and of all above it; version 2 says "max" for none."""
    folder = root / group.lstrip("/")
    # Within a container the path may be the host's: then the root stands for the container's own.
    for place in (folder, *folder.parents):
        if not place.is_relative_to(root):
            return
        with suppress(OSError, ValueError):
            yield int((place / name).read_text(encoding="ascii"))
