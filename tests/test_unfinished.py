"""Unfinished files, and the removal of those that killed processes left."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from thzcl import files

OLD_S = 2 * 86400.0


def name_of(process, machine=None):
    return f".thzcl-{machine or files.this_machine()}-{process}-x.nc"


@pytest.fixture
def dead():
    """The number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-S", "-c", ""]) as process:
        process.wait()
    return process.pid


def test_what_killed_processes_left_goes_and_a_neighbours_stays(tmp_path, dead):
    gone = [name_of(dead), name_of(7, "0a1b2c3d")]
    kept = [name_of(os.getpid()), name_of(os.getppid()), name_of(dead, "0a1b2c3e"), "x.nc"]
    for name in (*gone, *kept):
        (tmp_path / name).touch()
    folder = tmp_path / name_of(dead).replace("x.nc", "y")
    folder.mkdir()
    (folder / "built").touch()
    old = tmp_path.stat().st_mtime - OLD_S
    for name in (gone[1], kept[0], "x.nc"):
        os.utime(tmp_path / name, (old, old))
    files.sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_a_part_goes_whatever_happens(tmp_path):
    path = tmp_path / "a.nc"
    with files.part_beside(path) as part:
        assert (part.parent, part.suffix) == (tmp_path, ".nc")
        part.replace(path)
    with pytest.raises(KeyboardInterrupt), files.part_beside(path):
        raise KeyboardInterrupt
    assert [one.name for one in tmp_path.iterdir()] == ["a.nc"]
