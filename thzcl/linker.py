"""PoCL links each new kernel with the system's `ld`, and takes the whole process down where that fails. Look before the leap.

Knows no OpenCL: it finds a linker, puts the ziglang wheel's in its place where there is none, and runs a probe in a child.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

REMEDY = "`apt-get install gcc` (Debian and Ubuntu) or `pip install 'thzcl[linker]'` provides it"

# What PoCL asks for beyond the object file itself, libraries included, is found at load time or not needed.
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


def prepare() -> str | None:
    """Makes sure that some `ld` is on the PATH, of the ziglang wheel if need be; what is missing, if anything is."""
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


def check(driver: str) -> str | None:
    """Runs a first kernel of `driver` in a child process, once for each linker and driver; what is wrong, if anything is."""
    missing = prepare()
    if missing:
        return missing
    linker = Path(shutil.which("ld") or "ld")
    identity = f"{driver} {linker} {linker.stat().st_mtime_ns} {sys.prefix}"
    marker = cache_folder() / "probed" / hashlib.sha256(identity.encode()).hexdigest()[:16]
    if marker.exists():
        return None
    child = subprocess.run(
        [sys.executable, "-m", "thzcl.device"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        check=False,
    )
    if child.returncode != 0:
        lines = [line for line in (child.stdout + child.stderr).splitlines() if line.strip()]
        said = f" (it said: {lines[0].strip()[:200]})" if lines else ""
        return f"a first kernel could not be built and run with {driver}, most often for want of a linker; {REMEDY}{said}"
    try:
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.touch()
    except OSError:
        pass  # then the next run looks again
    return None
