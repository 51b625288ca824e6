"""Which device is meant, what is known of it, and what devices of other kinds are asked to do."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import run, scene

from thzcl.device import choose, library, pocl
from thzcl.device.choose import open_device
from thzcl.device.info import DeviceInfo
from thzcl.device.opencl import Device
from thzcl.errors import DeviceError

# --- which is meant


def test_choosing_a_device(device):
    name = device.info.name
    assert open_device("0").info.number == 0
    assert open_device(name[:8]).info.name == name
    wrong = {
        "99": "no device 99",
        "9" * 5000: "no device 9",
        "toaster": "no device fits",
        "²": "no device fits",
    }
    for choice, expected in wrong.items():
        with pytest.raises(DeviceError, match=expected):
            open_device(choice)


def info(number, platform, name, kind="CPU", driver=""):
    return DeviceInfo(number, platform, name, kind, driver, 0, "")


BESIDE = [
    info(0, pocl.PLATFORM, "pthread-Intel(R) Xeon(R)", driver="OpenCL 3.0 PoCL 3.0-rc2 Linux"),
    info(1, "Intel(R) OpenCL", "Intel(R) Xeon(R)"),
    info(2, "Intel(R) OpenCL Graphics", "Intel(R) Arc(TM)", "GPU"),
    info(3, "AMD Parallel", "gfx90a:sramecc+:xnack-", "GPU"),
]
NEWER = info(4, pocl.PLATFORM, "cpu-Intel(R) Xeon(R)", driver="OpenCL 3.0 PoCL 10.1 Linux")
CHOICES = {
    None: 0,
    "portable": 0,
    "Intel(R) OpenCL": 1,
    "intel(r) opencl:xeon": 1,
    "graphics": 2,
    "Intel:GPU": 2,
    "arc": 2,
    "AMD": 3,
    "gfx90a:sramecc+": 3,
    "pthread": 0,
}


@pytest.mark.parametrize("choice", CHOICES)
def test_platforms_are_meant_before_devices(choice):
    """Else "Intel" would be PoCL's device too, which is named after the processor."""
    assert choose.chosen(BESIDE, choice).number == CHOICES[choice]


def test_several_that_fit_are_listed():
    for choice in ("Intel", "GPU", "Intel:Intel"):
        with pytest.raises(DeviceError, match=r"several devices fit .*; choose among .*1 \(Intel"):
            choose.chosen(BESIDE, choice)


@pytest.mark.parametrize("choice", [None, "portable", "xeon:xeon", "Portable:Xeon"])
def test_the_newer_of_two_pocls_is_meant(choice):
    both = [*BESIDE[:1], NEWER]
    if choice == "xeon:xeon":
        with pytest.raises(DeviceError, match="no device fits"):
            choose.chosen(both, choice)
    else:
        assert choose.chosen(both, choice).number == 4
        assert choose.chosen(both[::-1], choice).number == 4
    assert choose.chosen(both, "0").number == 0


# --- what is known of it


def test_the_doctor_names_library_and_default_device(thzcl_command, device):
    done = thzcl_command("doctor")
    assert done.returncode == 0
    told = "".join(done.stdout.split())  # whatever the width of lines
    assert "".join(device.info.description.split()) in told
    assert "".join(device.info.library.split()) in told
    assert f"{device.info.number},if--devicenamesnoother" in told
    assert "aGPUisneverchosenbydefault" in told


def test_the_library_that_serves_a_platform_is_named(device):
    """By the path of the file itself; a platform that is none has no library."""
    path = Path(device.info.library)
    assert path.is_file()
    assert str(path) in Path("/proc/self/maps").read_text(encoding="utf-8")
    if device.pocl:
        assert path.name.startswith("libpocl")
    assert device.info.description.endswith(f", {path.name})")
    assert library.path_of(0) == library.path_of(id(object())) == ""


def test_without_maps_no_library_is_named(device, monkeypatch):
    monkeypatch.setattr(library, "MAPS", Path("/nowhere"))
    assert library.path_of(device.context.devices[0].platform.int_ptr) == ""


PROCESSORS = {
    "AVX-512": ("GenuineIntel", "avx2 avx512f avx512bw avx512cd avx512dq avx512vl", "", 512),
    "AVX2": ("GenuineIntel", "avx2 fma avx512f", "", 256),
    "neither": ("GenuineIntel", "sse4_2", "", 0),
    "of another maker": ("AuthenticAMD", "avx2", "", 0),
    "guarded": ("GenuineIntel", "avx2", "Mitigation: Microcode", 0),
    "not told": ("GenuineIntel", "avx2", None, 0),
}


@pytest.mark.parametrize("kind", PROCESSORS)
def test_processors_gather_where_that_was_found_to_be_faster(kind, tmp_path, monkeypatch):
    maker, flags, guard, bits = PROCESSORS[kind]
    cpu, leak = tmp_path / "cpuinfo", tmp_path / "gather_data_sampling"
    cpu.write_text(f"vendor_id\t: {maker}\nflags\t\t: fpu {flags}\n", encoding="utf-8")
    if guard is not None:
        leak.write_text(f"{guard or 'Not affected'}\n", encoding="ascii")
    monkeypatch.setattr(pocl, "CPU_INFO", cpu)
    monkeypatch.setattr(pocl, "SLOW_GATHERS", leak)
    monkeypatch.delenv("POCL_LLVM_CPU_NAME", raising=False)
    pocl.processor.cache_clear()
    try:
        assert pocl.gather_bits() == bits
        monkeypatch.setenv("POCL_LLVM_CPU_NAME", "znver3")
        assert pocl.gather_bits() == 0
    finally:
        pocl.processor.cache_clear()


# --- devices of other kinds, imitated by PoCL's


BISTATIC = scene(
    camera__position_m=[0.0, 0.0, 5.0],
    camera__look_at_m=[30.0, 0.0, 0.0],
    camera__focal_length_mm=100.0,
    camera__focal_plane_mm=[40.0, 30.0],
    camera__pixels=[64, 48],
    atmosphere__fluctuations=None,
    background__max_range_m=1000.0,
    ground={"reflectivity": 0.2},
    targets={
        "a": {
            "kind": "box",
            "center_m": [28.0, 1.0, 0.6],
            "size_m": [1.0, 2.0, 1.2],
            "yaw_deg": 25.0,
            "reflectivity": 0.5,
        }
    },
    sensor={
        "kind": "active",
        "frequency_ghz": 650.0,
        "dynamic_range_db": 120.0,
        "arrangement": "bistatic",
        "transmitter_m": [6.0, 9.0, 7.0],
    },
)


class WithoutFloat64(Device):
    """A device that is told to have no float64, and whose kernels may not name it."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.float64 = False

    def _compiled(self, source, arguments):
        return super()._compiled(f"#define double there_is_no_double\n{source}", arguments)


@pytest.fixture
def single(device, tmp_path, monkeypatch):
    """What PoCL offers, without float64, and without programs of an earlier run."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return WithoutFloat64(device.context.devices[0], device.info)


def test_without_float64_nothing_shadows_itself(tmp_path, device, single):
    """One in twenty lit pixels did, where a float32 is too coarse to leave out its own surface."""
    lit = [
        run(tmp_path, BISTATIC, device=opened).variants[0].image.layers["received_power"].values > 0
        for opened in (device, single)
    ]
    assert lit[0].sum() == 3050
    assert np.array_equal(*lit)


def test_without_float64_the_image_is_the_same(tmp_path, device, single):
    data = scene(atmosphere__fluctuations__temperature_sigma_k=1.0)
    one, other = (run(tmp_path, data, device=opened) for opened in (device, single))
    image, same = (np.asarray(found.variants[0].image.values) for found in (one, other))
    assert np.ptp(image) > 5
    assert same == pytest.approx(image, abs=1e-4)


def test_float64_is_refused_where_there_is_none(tmp_path, single):
    with pytest.raises(DeviceError, match="cannot compute in float64; set numerics"):
        run(tmp_path, scene(numerics__precision="float64"), device=single)


@pytest.fixture
def gpu(device):
    """What PoCL offers, told to be a GPU: one ray to a work-item, groups of 64, memory apart."""
    return Device(device.context.devices[0], replace(device.info, kind="GPU"))


def test_groups_and_padding_are_those_of_the_kind(device, gpu):
    assert gpu.grouped((9, 16, 16)) == ((64, 16, 16), (64, 1, 1))
    assert gpu.grouped((192,)) == ((192,), (64,))
    assert gpu.padded(65, "float32") == 128
    assert device.grouped((9, 16, 16)) == ((9, 16, 16), (1, 16, 1))
    assert device.padded(1, "float64") == 16 * device.lanes("float64")
    assert device.padded(1, "float32") % (16 * device.lanes("float32", gathers=True)) == 0


@pytest.mark.parametrize("kelvin", [None, 1.0])
def test_a_gpu_makes_the_same_image(tmp_path, device, gpu, kelvin):
    """To the rounding of its brightness temperatures, with as many voxels crossed."""
    data = scene(atmosphere__fluctuations__temperature_sigma_k=kelvin)
    one, other = (run(tmp_path, data, device=opened) for opened in (device, gpu))
    image, same = (np.asarray(found.variants[0].image.values) for found in (one, other))
    assert np.ptp(image) > 5
    assert same == pytest.approx(image, abs=1e-5)
    assert other.voxel_segments == one.voxel_segments


FORK = """
import multiprocessing, sys
import thzcl

def again(device, answers):
    try:
        thzcl.run("quick", settings={"camera.pixels": [4, 4]}, figure=False, device=device)
        answers.put("ran")
    except thzcl.errors.DeviceError as error:
        answers.put(str(error))

opened = thzcl.open_device()
thzcl.run("quick", settings={"camera.pixels": [4, 4]}, figure=False, device=opened)
fork = multiprocessing.get_context("fork")
for device in (None, opened):
    answers = fork.Queue()
    child = fork.Process(target=again, args=(device, answers))
    child.start()
    print(answers.get(timeout=60))
    child.join(60)
    print(child.exitcode)
"""


def test_a_fork_after_a_run_fails_in_words():
    """With a device of its own or an inherited one; and it ends without releasing anything."""
    done = subprocess.run(
        [sys.executable, "-c", FORK], capture_output=True, text=True, timeout=180, check=True
    )
    lines = done.stdout.splitlines()
    assert lines[1::2] == ["0", "0"]
    assert all('get_context("spawn")' in line for line in lines[::2])
    assert len(lines) == 4


def test_a_fork_before_the_first_run_works():
    text = FORK.replace("opened = thzcl.open_device()\n", "opened = None\n")
    first = text.index("thzcl.run(", text.index("opened = None"))
    text = text[:first] + text[text.index("fork = ") :]
    done = subprocess.run(
        [sys.executable, "-c", text], capture_output=True, text=True, timeout=180, check=True
    )
    assert done.stdout.splitlines() == ["ran", "0", "ran", "0"]
