"""Whole processes, timed from outside."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from timing import alternate

import thzcl

# Set for this process, perhaps, but not in a user's shell.
ALTERED = ("PYTHONDONTWRITEBYTECODE", "OPENBLAS_NUM_THREADS")
# Runs a command of thzcl, and prints which modules of others it has imported, in order.
WATCH = """
import sys
from thzcl.__main__ import main
code = main()
ours = {*sys.stdlib_module_names, "thzcl", "__main__"}
modules = [name for name, module in sys.modules.items() if getattr(module, "__spec__", None)]
print(*(name for name in modules if name.partition(".")[0] not in ours))
sys.exit(code)
"""
IMPORT = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]"


def measure(repeat: int) -> dict[str, float]:
    """Returns median seconds of `thzcl run slide --no-figure` with caches warm, and empty.

    Beside them stand those of a process that only imports what a warm run imports.
    """
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        warm = here / "warm"
        arguments = ["run", "slide", "--no-figure", "--quiet", "-o", folder]
        command, bare = ["-m", "thzcl", *arguments], ["-c", IMPORT, *imported(arguments, here)]
        calls = {
            "imports": lambda: _run(bare, here, warm),
            "warm": lambda: _run(command, here, warm),
            "cold": lambda: _run_cold(command, here),
        }
        return alternate(calls, repeat)


def imported(arguments: list[str], here: Path) -> list[str]:
    """Returns the names of others' modules that a command of thzcl imports, caches being warm."""
    command = ["-c", WATCH, *arguments]
    _run(command, here, here / "warm")
    return _printed(command, here, here / "warm").splitlines()[-1].split()


def _run_cold(arguments: list[str], here: Path) -> None:
    with tempfile.TemporaryDirectory(dir=here) as empty:
        _run(arguments, here, Path(empty))


def _run(arguments: list[str], here: Path, caches: Path) -> None:
    _printed(arguments, here, caches)


def _printed(arguments: list[str], here: Path, caches: Path) -> str:
    """Runs Python with its caches in a folder; returns what it printed."""
    own = {
        "XDG_CACHE_HOME": str(caches),
        "POCL_CACHE_DIR": str(caches / "pocl"),
        "PYTHONPATH": str(Path(thzcl.__file__).parents[1]),  # the thzcl that this process runs
    }
    for folder in (caches, caches / "pocl"):
        folder.mkdir(exist_ok=True)
    # As installed: modules compiled once, not at every start.
    environment = {name: value for name, value in os.environ.items() if name not in ALTERED} | own
    command = [sys.executable, *arguments]
    where = {"cwd": here, "env": environment}
    return subprocess.run(command, **where, check=True, capture_output=True, text=True).stdout
