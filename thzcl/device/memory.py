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
    """Returns the least of the machine's memory, the control groups' limits and the process's own.

    Those of the process (`ulimit -v`, `ulimit -d`) and of its groups count less what it uses
    already. All in bytes.
    """
    groups = (limit - _used("VmRSS") for limit in _cgroups(PROC / "cgroup", CGROUPS))
    return max(min([_physical(), *groups, *_of_process()]), 0)


def _physical() -> int:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _of_process() -> Iterator[int]:
    """Yields what is left of the address space and of the data segment, if they are limited."""
    for kind, used in ((resource.RLIMIT_AS, "VmSize"), (resource.RLIMIT_DATA, "VmData")):
        soft, _ = resource.getrlimit(kind)
        if soft != resource.RLIM_INFINITY:
            yield soft - _used(used)


def _used(name: str) -> int:
    """Returns how much memory this process uses of a kind that Linux names, bytes."""
    with suppress(OSError, ValueError, IndexError):
        for line in (PROC / "status").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith(f"{name}:"):
                return 1024 * int(line.split()[1])
    return 0


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
