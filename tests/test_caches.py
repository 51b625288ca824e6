"""Caches that cannot be used: kernels are then built elsewhere, or it is said why they cannot."""

from __future__ import annotations

import os
import resource
from types import SimpleNamespace

import pytest
from scenes import scene, write

from thzcl.device import cache

QUICK = {"camera__pixels": [4, 4], "atmosphere__fluctuations": None}


def a_file(folder):
    folder.touch()
    return folder


PLACES = {
    "a file": (a_file, "cannot be written"),
    "below a file": (lambda folder: a_file(folder) / "x", "cannot be written"),
    "what nobody can make": (lambda _: cache.Path("/proc/x"), "cannot be written"),
    "one to be made": (lambda folder: folder / "a" / "b", None),
}


@pytest.mark.parametrize("case", PLACES)
def test_a_place_is_tried(tmp_path, case):
    make, expected = PLACES[case]
    found = cache.fault(make(tmp_path / "place"))
    assert found is None if expected is None else expected in found
    assert not [*tmp_path.rglob("tmp*")]


MOUNTS = {
    "no room": ({"f_bavail": 100}, "has room for 0.41 MB, and kernels may take 32 MB"),
    "no programs": ({"f_flag": os.ST_NOEXEC}, "noexec"),
}


@pytest.mark.parametrize("case", MOUNTS)
def test_a_mount_is_looked_at(tmp_path, monkeypatch, case):
    changed, expected = MOUNTS[case]
    usual = {"f_bavail": 10**9, "f_frsize": 4096, "f_flag": 0}
    monkeypatch.setattr(cache.os, "statvfs", lambda _: SimpleNamespace(**usual | changed))
    assert expected in cache.fault(tmp_path)


def test_home_may_be_unknown(monkeypatch):
    def unknown():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.Path, "home", unknown)
    assert cache.cache_folder() == cache.Path("/.cache/thzcl")


def test_kernels_are_built_elsewhere_and_leave_nothing(tmp_path, thzcl_command):
    file, passing = tmp_path / "file", tmp_path / "passing"
    file.touch()
    passing.mkdir()
    caches = {"POCL_CACHE_DIR": str(file), "TMPDIR": str(passing)}
    scenario = write(tmp_path, scene(**QUICK))
    done = thzcl_command("run", scenario, "--no-figure", env=caches)
    assert done.returncode == 0, done.stderr
    told = f"note: PoCL's kernel cache {file} cannot be written: File exists"
    assert f"{told}; kernels are built in {passing}" in " ".join(done.stdout.split())
    assert not [*passing.iterdir()]


def test_where_no_place_serves_it_is_said(tmp_path, thzcl_command):
    """Files of more than 100 kB cannot be written anywhere: PoCL would end the process."""
    done = thzcl_command(
        "run",
        write(tmp_path, scene(**QUICK)),
        "--no-figure",
        # Python itself would keep modules that the limit has cut off.
        env={"POCL_CACHE_DIR": str(tmp_path / "kernels"), "PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)),
    )
    assert done.returncode == 3
    assert "cannot be written: File too large" in done.stderr
    assert "export POCL_CACHE_DIR=" in done.stderr
