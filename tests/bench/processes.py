"""Whole processes, timed from outside."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from timing import alternate

import thzcl

ALTERED = (
    "PYTHONDONTWRITEBYTECODE",
    "OPENBLAS_NUM_THREADS",
)  # that this process may have, and a user's shell has not
IMPORTS = "import numpy, pyopencl, pluggy, pydantic, typer, rich, h5netcdf"


def measure(repeat: int) -> dict[str, float]:
    """Median seconds of `thzcl run slide --no-figure` with caches warm and empty.

    And of its bare imports.
    """
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        command = [
            sys.executable,
            "-m",
            "thzcl",
            "run",
            "slide",
            "--no-figure",
            "--quiet",
            "-o",
            folder,
        ]
        calls = {
            "imports": lambda: _run([sys.executable, "-c", IMPORTS], here, here / "warm"),
            "warm": lambda: _run(command, here, here / "warm"),
            "cold": lambda: _run_cold(command, here),
        }
        return alternate(calls, repeat)


def _run_cold(command: list[str], here: Path) -> None:
    with tempfile.TemporaryDirectory(dir=here) as empty:
        _run(command, here, Path(empty))


def _run(command: list[str], here: Path, caches: Path) -> None:
    """Runs a command with its caches in a folder."""
    own = {
        "XDG_CACHE_HOME": str(caches),
        "POCL_CACHE_DIR": str(caches / "pocl"),
        "PYTHONPATH": str(_root()),
    }
    for folder in (caches, caches / "pocl"):
        folder.mkdir(exist_ok=True)
    # As installed: modules compiled once, not at every start.
    environment = {name: value for name, value in os.environ.items() if name not in ALTERED} | own
    subprocess.run(command, cwd=here, env=environment, check=True, capture_output=True)


def _root() -> Path:
    """So that the process runs the thzcl that this one does."""
    return Path(thzcl.__file__).parents[1]
