"""The linker `ld` that PoCL calls for each new kernel, or the ziglang wheel's in its place."""

from __future__ import annotations

import os
import shutil
import stat
import sys
from importlib.util import find_spec
from pathlib import Path

from thzcl.device.cache import folder_of_programs

REMEDY = "`apt-get install gcc` (Debian and Ubuntu) or `pip install 'thzcl[linker]'` provides it"

# What PoCL asks for beyond the object file itself, libraries included, is found when the kernel
# is loaded, or is not needed.
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


def prepare() -> str | None:
    """Makes sure that some `ld` is on the PATH, the ziglang wheel's if need be.

    Returns None, or a sentence that says what is missing. Raises DeviceError if there is no place
    for that of the wheel.
    """
    if shutil.which("ld"):
        return None
    if find_spec("ziglang") is None:
        return f"no linker `ld` was found; {REMEDY}"
    folder = folder_of_programs("linker")
    shim = folder / "ld"
    shim.write_text(_SHIM.format(python=sys.executable), encoding="utf-8")
    shim.chmod(shim.stat().st_mode | stat.S_IXUSR)
    os.environ["PATH"] = f"{folder}{os.pathsep}{os.environ.get('PATH', '')}"
    return None


def identity() -> str:
    """Returns a text that changes when another linker comes first on the PATH."""
    path = Path(shutil.which("ld") or "ld")
    return f"{path} {path.stat().st_mtime_ns}"
