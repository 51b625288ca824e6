"""PoCL links each new kernel with the system's `ld`, and takes the whole process down where that fails. Look before the leap.

Knows no OpenCL: it finds a linker, puts the ziglang wheel's in its place where there is none, and has a child go first.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

REMEDY = "`apt-get install gcc` (Debian and Ubuntu) or `pip install 'thzcl[linker]'` provides it"

PROVED = "a first kernel was built and run"

# What PoCL asks for beyond the object file itself, libraries included, is found at load time or not
# needed.
_SHIM = """#!/bin/sh
# Stands in for ld: links PoCL's kernels with the linker of the ziglang wheel.
for word; do
    shift
    case "$word" in
        -l* | -L*) ;;
        *) set -- "$@" "$word" ;;
    esac
done
exec "{python}" -m ziglang ld.lld "$@"
"""


def cache_folder() -> Path:
    """Where thzcl keeps what it can make again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "thzcl"


def can_cache() -> bool:
    """Whether anything can be kept at all."""
    folder = cache_folder()
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return os.access(folder, os.W_OK)


def prepare() -> str | None:
    """Makes sure that some `ld` is on the PATH, of the ziglang wheel if need be; what is missing.

    If anything is.
    """
    if shutil.which("ld"):
        return None
    if find_spec("ziglang") is None:
        return f"no linker `ld` was found; {REMEDY}"
    try:
        folder = cache_folder() / "linker"
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix="thzcl-linker-"))
    shim = folder / "ld"
    shim.write_text(_SHIM.format(python=sys.executable), encoding="utf-8")
    shim.chmod(shim.stat().st_mode | stat.S_IXUSR)
    os.environ["PATH"] = f"{folder}{os.pathsep}{os.environ.get('PATH', '')}"
    return None


class Helper:
    """A child process that builds programs. Where PoCL takes it down, this one has been warned; else the two share the work.

    It builds and runs a first kernel, on the device of that number or else the default one, and then what it is sent.
    """

    def __init__(self, device: int | None = None) -> None:
        root, own = str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")
        self._child = subprocess.Popen(  # noqa: S603 (no word of it is a user's)
            # -P: a user's folder may hold a signal.py.
            [
                sys.executable,
                "-P",
                "-m",
                "thzcl.device.opencl",
                *([] if device is None else [str(device)]),
            ],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (root, own)))},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def send(self, work: str) -> None:
        """All that there is to do, for thzcl.device to read."""
        if self._child.stdin:
            with suppress(BrokenPipeError), self._child.stdin as words:
                words.write(work)

    def trouble(self, driver: str) -> str | None:
        """Waits for the first kernel, and tells what is wrong, if anything is.

        `driver` names what that proves.
        """
        said = [""]
        for line in self._child.stdout or ():
            if line.strip() == PROVED:
                with suppress(OSError):  # then the next run looks again
                    marker = _marker(driver)
                    marker.parent.mkdir(parents=True, exist_ok=True)
                    marker.touch()
                return None
            said += [line.strip()[:200]] if line.strip() else []
        why = f"most often for want of a linker; {REMEDY}" + (
            f" (it said: {said[-1]})" if said[-1] else ""
        )
        return f"a first kernel could not be built and run with {driver}, {why}"

    def wait(self) -> None:
        """Until all is built."""
        if self._child.stdout:
            self._child.stdout.read()
        self._child.wait()

    def stop(self) -> None:
        """Whatever it is doing; again does no harm."""
        with suppress(BrokenPipeError), self._child:
            self._child.kill()


@contextmanager
def head_start(*, wanted: bool) -> Iterator[Helper | None]:
    """Where thzcl was never run.

    A helper that begins while this process still imports what it needs.
    """
    helper = Helper() if wanted and not cache_folder().exists() and prepare() is None else None
    try:
        yield helper
    finally:
        if helper:
            helper.stop()


def is_proved(driver: str) -> bool:
    """Whether a first kernel of `driver` has been built and run.

    With the linker that is there now.
    """
    return _marker(driver).exists()


def _marker(driver: str) -> Path:
    linker = Path(shutil.which("ld") or "ld")
    identity = f"{driver} {linker} {linker.stat().st_mtime_ns} {sys.prefix}"
    return cache_folder() / "probed" / hashlib.sha256(identity.encode()).hexdigest()[:16]
