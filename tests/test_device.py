"""Devices: what is said where there is none, no linker, or an unknown processor.

And that caches are only caches.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from thzcl.device import linker
from thzcl.device import opencl as devices

pocl_only = pytest.mark.skipif(shutil.which("ld") is None, reason="needs a linker to take away")


def test_no_device_is_exit_3_and_the_doctor_says_why(thzcl_command, tmp_path):
    blind = {"OCL_ICD_VENDORS": str(tmp_path / "nowhere")}
    done = thzcl_command("run", "quick", env=blind)
    assert done.returncode == 3
    assert done.stderr == "OpenCL sees no device; run `thzcl doctor`\n"
    doctor = thzcl_command("doctor", env=blind)
    assert doctor.returncode == 3
    assert "unset OCL_ICD_VENDORS" in doctor.stdout


@pocl_only
def test_without_a_linker_nothing_crashes(thzcl_command, tmp_path):
    """PoCL aborts the whole process where `ld` is missing: exit 3, one line, no core."""
    bare = {
        "PATH": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
    }
    done = thzcl_command("run", "quick", env=bare)
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert "apt-get install gcc" in done.stderr
    assert "thzcl[linker]" in done.stderr


def test_a_cache_that_cannot_be_written_is_done_without(thzcl_command, tmp_path):
    """PoCL needs one, but no one else."""
    (tmp_path / "pocl").mkdir()
    (tmp_path / "file").touch()
    bare = {"XDG_CACHE_HOME": str(tmp_path / "file"), "POCL_CACHE_DIR": str(tmp_path / "pocl")}
    done = thzcl_command("run", "quick", "--no-figure", "--quiet", env=bare)
    assert (done.returncode, done.stderr) == (0, "")


@pocl_only
def test_with_a_linker_that_fails_nothing_crashes(thzcl_command, tmp_path):
    """As where `ld` is there but libgcc is not."""
    broken = tmp_path / "ld"
    broken.write_text("#!/bin/sh\necho cannot find -lgcc >&2\nexit 1\n", encoding="utf-8")
    broken.chmod(0o755)
    bare = {
        "PATH": f"{tmp_path}:/bin",
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "POCL_CACHE_DIR": str(tmp_path / "pocl"),
    }
    done = thzcl_command("run", "quick", env=bare)
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert "apt-get install gcc" in done.stderr
    doctor = thzcl_command("doctor", env=bare)
    assert doctor.returncode == 3
    assert "first kernel" in doctor.stdout


def test_the_shim_passes_on_what_zig_understands(tmp_path, monkeypatch):
    """With ziglang in place of ld: libraries and their folders are dropped.

    The rest is handed on.
    """
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(linker, "find_spec", lambda name: name)
    monkeypatch.setattr(sys, "executable", "/bin/echo")
    assert linker.prepare() is None
    shim = shutil.which("ld")
    assert shim and Path(shim).is_relative_to(tmp_path)
    words = [
        shim,
        "-shared",
        "-o",
        "out.so",
        "-L/usr/lib",
        "in put.o",
        "-lgcc",
        "--as-needed",
        "-lc",
    ]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert said.split("-m ziglang ld.lld ")[1] == "-shared -o out.so in put.o --as-needed\n"


def test_choosing_a_device(device):
    name = device.info.name
    assert devices.open_device("0").info.number == 0
    assert devices.open_device(name[:8]).info.name == name
    for choice, expected in (("99", "no device 99"), ("toaster", "no device fits")):
        with pytest.raises(devices.DeviceError, match=expected):
            devices.open_device(choice)


def test_kernels_build_on_this_processor_whatever_pocl_calls_it(device):
    program = device.build(("turbulence/field",), "float32", ("TWO_FIELDS=1",))
    values = device.put(np.arange(1024, dtype=np.float32))
    program.run("humidity", 1024 // device.lanes("float32"), values, np.float32(2), np.float32(0))
    assert np.array_equal(values.host(), 2 * np.arange(1024))


def test_a_spoilt_cache_is_built_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = devices.open_device()
    first.build(("surfaces/camera", "surfaces/surfaces"), "float32", ("GROUND",))
    (cached,) = (tmp_path / "thzcl" / "programs").iterdir()
    cached.write_bytes(cached.read_bytes()[:-1] + b"?")
    again = devices.open_device()
    again.build(("surfaces/camera", "surfaces/surfaces"), "float32", ("GROUND",))
    assert not cached.read_bytes().endswith(b"?")


@pocl_only
def test_a_first_run_is_helped(tmp_path, monkeypatch):
    """With empty caches a child builds what it is told to, after a first kernel.

    What it leaves is as good as one's own.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    wanted = [
        devices.Recipe(("turbulence/field",), "float32", ("TWO_FIELDS=0",)),
        devices.Recipe(("surfaces/camera", "surfaces/surfaces"), "float32"),
    ]
    devices.open_device(None, wanted)
    programs = list((tmp_path / "thzcl" / "programs").iterdir())
    assert len(programs) == len(wanted)
    assert len(list((tmp_path / "thzcl" / "probed").iterdir())) == 1
    monkeypatch.setattr(
        devices.Device, "_compiled", lambda *_: pytest.fail("nothing is left to build")
    )
    again = devices.open_device(None, wanted)
    for recipe in wanted:
        again.build(*recipe)


@pocl_only
def test_a_helper_that_dies_is_done_without(tmp_path, monkeypatch):
    """Once a linker is proved: then what it was to build is built here."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    devices.open_device()
    monkeypatch.setattr(sys, "executable", shutil.which("false"))
    wanted = [
        devices.Recipe(("paths/thinning",), "float32", (f"MOMENTS={moments}",))
        for moments in range(1, 5)
    ]
    opened = devices.open_device(None, wanted)
    assert len(list((tmp_path / "thzcl" / "programs").iterdir())) == len(wanted) - 1
    for recipe in wanted:
        opened.build(*recipe)
    assert len(list((tmp_path / "thzcl" / "programs").iterdir())) == len(wanted)


def test_buffers_outlive_the_kernels_that_use_them(device):
    """A buffer that goes out of scope while a kernel waits for it must not be freed."""
    program = device.build(("turbulence/field",), "float32", ("TWO_FIELDS=1",))
    total = device.put(np.zeros(1 << 20, dtype=np.float32))
    for _ in range(50):
        one = device.put(np.ones(1 << 20, dtype=np.float32))
        program.run(
            "combine",
            (1 << 20) // device.lanes("float32"),
            total,
            one,
            np.float32(1),
            np.float32(1),
        )
        del one
    assert np.array_equal(total.host(), np.full(1 << 20, 50, dtype=np.float32))
