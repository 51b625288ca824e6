"""What the tests share."""

from __future__ import annotations

import importlib
import itertools
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# As the thzcl command has it: threads of a library beside those of pytest's workers only wait.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
_NUMBERS = itertools.count()
ROOT = Path(__file__).parents[1]
COMMANDS = {"thzcl_command", "thzcl_json"}  # fixtures that start a process
sys.path.insert(0, str(Path(__file__).parent))
_approx = pytest.approx


def _relative(expected, rel=None, abs=None, nan_ok=False):  # noqa: A002 (pytest's own name)
    """pytest.approx without its usual absolute tolerance: 1e-12 would pass any radiance."""
    if abs is None:
        rel, abs = 1e-6 if rel is None else rel, 0.0  # noqa: A001
    return _approx(expected, rel=rel, abs=abs, nan_ok=nan_ok)


pytest.approx = _relative


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Marks as slow what is long, and what runs commands in processes of their own."""
    for item in items:
        kinds = map(item.get_closest_marker, ("long", "browser"))
        if any(kinds) or COMMANDS & {*item.fixturenames}:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def device():
    """PoCL's CPU, or whatever else is the default."""
    from thzcl.device.choose import open_device

    return open_device()


@pytest.fixture(scope="session")
def dust(tmp_path_factory):
    """Third party's dust, installed by pip for this process; gives an environment for others."""
    from packages import install

    folder = tmp_path_factory.mktemp("dust")
    environment = install(ROOT / "tests" / "grey_dust", folder)
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    yield environment
    sys.path.remove(str(folder))


@pytest.fixture
def odd(tmp_path, monkeypatch):
    """Installs a constituent named "odd" in some text for this process. Returns its new name."""
    from packages import plugin

    monkeypatch.syspath_prepend(tmp_path)

    def installed(body, name=None):
        number = next(_NUMBERS)
        name = name or f"odd-{number}"
        body = body.replace('name = "odd"', f'name = "{name}"')
        owner, group = f"odd-airs-{number}", "thzcl.constituents"
        plugin(tmp_path, body, name, f"odd_air_{number}", owner, group)
        importlib.invalidate_caches()
        return name

    return installed


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
