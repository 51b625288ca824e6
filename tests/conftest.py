"""What the tests share."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COMMANDS = {"thzcl_command", "thzcl_json"}  # fixtures that start a process
sys.path.insert(0, str(Path(__file__).parent))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Marks as slow what is long, and what runs commands in processes of their own."""
    for item in items:
        if item.get_closest_marker("long") or COMMANDS & {*item.fixturenames}:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def device():
    """PoCL's CPU, or whatever else is the default."""
    from thzcl.device.choose import open_device

    return open_device()


@pytest.fixture
def thzcl_command(tmp_path):
    """Runs the command line in a process of its own, in an empty folder.

    Gives back the finished process.
    """

    def call(*arguments, cwd=tmp_path, env=None, **options):
        environment = (
            {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "COLUMNS")}
            | {"PYTHONPATH": str(ROOT)}
            | (env or {})
        )
        command = [sys.executable, "-m", "thzcl", *map(str, arguments)]
        return subprocess.run(
            command,
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
            **options,
        )

    return call


@pytest.fixture
def thzcl_json(thzcl_command):
    """Runs a command that must succeed with --format json, and gives back what it printed."""

    def call(*arguments, **options):
        done = thzcl_command(*arguments, "--format", "json", **options)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return call
