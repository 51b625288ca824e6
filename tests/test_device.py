"""Devices: what is said without one, without a linker, or on a processor that PoCL does not know.

Caches are only caches, and memory is what the process may use of it.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from thzcl.device import choose, linker, memory, probe
from thzcl.device.choose import open_device
from thzcl.errors import DeviceError
from thzcl.surfaces.ends import SurfaceKernels
from thzcl.turbulence.cube import FieldKernels

GRID = 16
SURFACES = SurfaceKernels(ground=True, boxes=False, billboards=False), "float32"

pocl_only = pytest.mark.usefixtures("linked")


@pytest.fixture
def linked(device):
    """Skips what is about PoCL and its linker where that is not the device or has none."""
    if not device.pocl:
        pytest.skip(f"{device.info.platform} calls no linker")
    if shutil.which("ld") is None:
        pytest.skip("needs a linker to take away")


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
    """With ziglang in place of ld, libraries and their folders are dropped, the rest handed on."""
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


def test_kernels_build_on_this_processor_whatever_pocl_calls_it(device):
    program = device.build(FieldKernels(two_fields=True), "float32")
    values = device.put(np.arange(1024, dtype=np.float32))
    program.run("humidity", 1024 // program.lanes, field=values, scale=2, shift=0)
    assert np.array_equal(values.host(), 2 * np.arange(1024))


def test_a_spoilt_cache_is_built_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    open_device().build(*SURFACES)
    (cached,) = (tmp_path / "thzcl" / "programs").iterdir()
    cached.write_bytes(cached.read_bytes()[:-1] + b"?")
    open_device().build(*SURFACES)
    assert not cached.read_bytes().endswith(b"?")


def test_a_binary_without_the_programs_kernels_is_built_again(tmp_path, monkeypatch):
    """Some drivers accept any binary, and have no kernels then."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    recipes = [SURFACES, (FieldKernels(two_fields=False), "float32")]
    for recipe in recipes:
        open_device().build(*recipe)
    one, other = (tmp_path / "thzcl" / "programs").iterdir()
    right = one.read_bytes(), other.read_bytes()
    one.write_bytes(right[1])
    other.write_bytes(right[0])
    opened = open_device()
    opened.build(*SURFACES)
    values = opened.put(np.ones(1024, np.float32))
    program = opened.build(*recipes[1])
    program.run("humidity", 1024 // program.lanes, field=values, scale=0.5, shift=0)
    assert (values.host() == 0.5).all()
    assert one.read_bytes() != right[1] and other.read_bytes() != right[0]


def test_remarks_of_a_driver_on_its_builds_reach_nobody(tmp_path, monkeypatch):
    """Neither on a build from source nor on one from an earlier run's binary."""
    import pyopencl

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    built, builds = pyopencl.Program.build, []

    def talkative(self, *arguments, **options):
        builds.append(self)
        warnings.warn("a driver's remark", pyopencl.CompilerWarning, stacklevel=2)
        return built(self, *arguments, **options)

    opened = [open_device(), open_device()]
    monkeypatch.setattr(pyopencl.Program, "build", talkative)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for one in opened:
            one.build(*SURFACES)
    assert len(builds) == len(opened)


def test_what_a_compiler_refuses_is_a_device_error(device):
    with pytest.raises(DeviceError, match="cannot build kernels"):
        device.compile("__kernel void broken(", [])


@pocl_only
def test_a_child_goes_first_once_for_each_driver_and_linker(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    children, run = [], subprocess.run

    def counted(command, **options):
        children.append(command)
        return run(command, **options)

    monkeypatch.setattr(subprocess, "run", counted)
    open_device()
    open_device()
    assert len(children) == 1
    (mark,) = (tmp_path / "thzcl" / "probed").iterdir()
    mark.unlink()
    monkeypatch.setattr(probe, "PROVED", "what no child says")
    with pytest.raises(DeviceError, match="could not be built and run"):
        open_device()
    assert len(children) == 2
    assert not mark.exists()


def test_thzcl_opens_a_device():
    import thzcl

    assert thzcl.open_device("0").info == choose.devices()[0]


def rounding(cube):
    """The rounding of a transform: of each value once for every doubling of its size."""
    return np.finfo(cube.dtype).eps * np.log2(cube.size) * np.abs(cube).max()


@pytest.mark.parametrize("library", ["scipy", "reikna"])
@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
def test_a_full_spectrum_becomes_a_cube_in_place(device, library, dtype):
    if library == "reikna" and not device.float64 and dtype == np.complex128:
        pytest.skip("the device has no float64")
    rng = np.random.default_rng(5)
    shape = (GRID,) * 3
    cube = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(dtype)
    spectrum = device.put(np.fft.fftn(cube).astype(dtype))
    result = device.inverse_transform(spectrum, GRID, library)
    assert result is spectrum
    assert np.abs(result.host() - cube).max() < rounding(cube)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_half_spectrum_becomes_a_real_cube(device, dtype):
    cube = np.random.default_rng(6).standard_normal((GRID,) * 3).astype(dtype)
    half = np.fft.rfftn(cube).astype(np.result_type(dtype, np.complex64))
    result = device.inverse_transform(device.put(half), GRID, "scipy").host()
    assert result.dtype == dtype
    assert np.abs(result - cube).max() < rounding(cube)


def test_reikna_compiles_once_for_each_size(monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import reikna.fft

        compiled, shapes = reikna.fft.FFT.compile, []

        def counted(self, *arguments, **options):
            shapes.append(self)
            return compiled(self, *arguments, **options)

        monkeypatch.setattr(reikna.fft.FFT, "compile", counted)
        opened = open_device()
        for size in (8, 8, 10, 8):
            opened.inverse_transform(opened.put(np.ones((size,) * 3, np.complex64)), size, "reikna")
    assert len(shapes) == 2


def test_memory_is_the_least_of_all_limits_on_it(tmp_path, monkeypatch):
    """Of control groups of both versions, the limits of every group above count too."""
    groups, proc = tmp_path / "cgroup", tmp_path / "proc"
    (groups / "outer" / "inner").mkdir(parents=True)
    (groups / "memory" / "old").mkdir(parents=True)
    proc.mkdir()
    monkeypatch.setattr(memory, "CGROUPS", groups)
    monkeypatch.setattr(memory, "PROC", proc)
    unlimited = memory.available_memory()  # no membership is told: the machine's own
    (proc / "cgroup").write_text("0::/outer/inner\n5:cpu,memory:/old\n", encoding="ascii")
    limit = groups / "outer" / "inner" / "memory.max"
    above = groups / "outer" / "memory.max"
    older = groups / "memory" / "old" / "memory.limit_in_bytes"
    limit.write_text("max\n", encoding="ascii")
    assert memory.available_memory() == unlimited
    for file, size in ((limit, 3_000_000), (above, 2_000_000), (older, 1_000_000)):
        file.write_text(f"{size}\n", encoding="ascii")
        assert memory.available_memory() == size
    (proc / "cgroup").write_text("0::/of/the/host\n", encoding="ascii")  # seen from a container
    (groups / "memory.max").write_text("4000000\n", encoding="ascii")
    assert memory.available_memory() == 4_000_000


def test_a_limited_address_space_counts_less_what_is_mapped():
    limit = 2_000_000_000
    code = "from thzcl.device.memory import available_memory; print(available_memory())"

    def limited():
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=limited,
        cwd=Path(__file__).parents[1],
    )
    assert limit / 2 < int(done.stdout) < limit


def test_buffers_outlive_the_kernels_that_use_them(device):
    """A buffer that goes out of scope while a kernel waits for it must not be freed."""
    program = device.build(FieldKernels(two_fields=True), "float32")
    total = device.put(np.zeros(1 << 20, dtype=np.float32))
    for _ in range(50):
        one = device.put(np.ones(1 << 20, dtype=np.float32))
        items = (1 << 20) // program.lanes
        program.run("combine", items, field=total, other=one, along=1, across=1)
        del one
    assert np.array_equal(total.host(), np.full(1 << 20, 50, dtype=np.float32))
