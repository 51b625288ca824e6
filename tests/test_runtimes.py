"""Other runtimes than the wheel's PoCL, where they are installed: Debian's PoCL, Intel's, Oclgrind.

    apt-get install pocl-opencl-icd oclgrind
    pip install intel-opencl-rt intel-cmplr-lib-rt
    python -m pytest -n 0 -rsP tests/test_runtimes.py

On the first two the tests of kernels, traces, fields and devices are run again; -rP prints how many
passed on which. Oclgrind interprets kernels and looks at every access to memory; scenes are small
there.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from conftest import ROOT
from scenes import run, scene, write

from thzcl.device import pocl

pytestmark = pytest.mark.slow

VENDORS = Path("/etc/OpenCL/vendors"), Path(sys.prefix, "etc", "OpenCL", "vendors")
# What to install, and the platform and the library that are then there.
RUNTIMES = {
    "pocl-opencl-icd": ("Portable Computing Language", "libpocl"),
    "intel-opencl-rt": ("Intel(R) OpenCL", "libintelocl.so"),
}
SUITES = (
    "test_trace",
    "test_field",
    "test_device",
    "test_devices",
    "test_kernel_arguments",
    "test_kernel_functions",
    "test_kernel_paths",
    "test_kernel_surfaces",
)


def installed(library):
    """The installed library whose name begins so, as vendors' files name it; None without one.

    The file of Intel's wheel names a folder of another machine; the library lies in lib.
    """
    for file in sorted(file for folder in VENDORS for file in folder.glob("*.icd")):
        named = Path(file.read_text(encoding="utf-8").strip())
        if named.name.startswith(library):
            own = Path(sys.prefix, "lib", named.name)
            return str(own if own.is_file() else named)
    return None


def python(*words, **environment):
    """Runs Python in a process of its own; gives back the finished process."""
    return subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def devices(**environment):
    """Returns the devices that `thzcl devices` lists."""
    done = python("-m", "thzcl", "devices", "--format", "json", **environment)
    return json.loads(done.stdout)["devices"]


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_kernels_traces_fields_and_devices(runtime):
    platform, library = RUNTIMES[runtime]
    named = installed(library)
    if named is None:
        pytest.skip(f"{runtime} is not installed")
    alone = {"OCL_ICD_VENDORS": named}  # no other runtime is seen then, the wheel's neither
    (device,) = devices(**alone)
    assert device["platform"] == platform
    assert Path(device["library"]).name.startswith(library)
    files = [f"tests/{name}.py" for name in SUITES]
    done = python("-m", "pytest", "-v", "-n", "0", *files, **alone)  # -v undoes -q: it counts
    assert done.returncode == 0, done.stdout[-5000:]
    print(runtime, device["driver"], done.stdout.splitlines()[-1].strip("= "))


def test_side_by_side_each_makes_the_image_and_is_named_in_it(tmp_path):
    """With the wheel's PoCL in one process. The newest PoCL is the default."""
    named = [found for _, library in RUNTIMES.values() if (found := installed(library))]
    if not named:
        pytest.skip("no other runtime is installed")
    for number, found in enumerate(named):
        (tmp_path / f"{number}.icd").write_text(found, encoding="utf-8")
    beside = {"OCL_ICD_VENDORS": str(tmp_path)}  # the wheel's loader adds its own PoCL
    file = write(tmp_path, scene(**SMALL))
    images = {}
    for choice in (None, *(device["number"] for device in devices(**beside))):
        device = [] if choice is None else ["--device", choice]
        command = ["run", file, "-o", tmp_path, "--no-figure", "--quiet", *device]
        done = python("-m", "thzcl", *command, **beside)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
        with h5netcdf.File(tmp_path / "scene.nc") as stored:
            images[choice] = stored.attrs["device"], np.asarray(stored.variables["image"])
    listed = devices(**beside)
    assert len(listed) == len(named) + 1
    for device in listed:
        name, image = images[device["number"]]
        assert f"{device['driver']}, {device['library']})" in name
        assert image == pytest.approx(images[None][1], abs=1e-4)  # of 290 K in float32
    pocls = [one for one in listed if one["platform"] == pocl.PLATFORM]
    newest = max(pocls, key=lambda one: pocl.version(one["driver"]))
    assert newest["library"] in images[None][0]


SMALL = {"camera__pixels": [8, 6], "atmosphere__fluctuations__grid": 16}
ACTIVE = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 120.0}
BOARD = {
    "kind": "billboard",
    "center_m": [25.0, 7.0, 1.0],
    "size_m": [6.0, 4.0],
    "facing_deg": 190.0,
    "image": "board.npy",
    "quantity": "temperature",
}
SCENES = {
    "a box on the ground": {},
    "a billboard": {"targets": {"board": BOARD}},
    "there and back": {
        "sensor": ACTIVE | {"arrangement": "bistatic", "transmitter_m": [6.0, 9.0, 7.0]}
    },
    "two temperatures": {"atmosphere__fluctuations__temperature_sigma_k": 1.0},
    "one ray in four": {"numerics__ray_stride": 2, "camera__pixels": [16, 12]},
    "rays cut off": {"sensor__frequency_ghz": 1400.0},
    "a scan of a band in the wind": {
        "sensor": {
            "kind": "raster-scan",
            "dwell_s": 0.1,
            "detector": {"kind": "passive-broadband", "center_ghz": 660.0, "bandwidth_ghz": 20.0},
        },
        "atmosphere__fluctuations__wind_m_s": [3.0, 1.0, 0.0],
    },
}


@pytest.mark.skipif(shutil.which("oclgrind") is None, reason="oclgrind is not installed")
@pytest.mark.parametrize("name", SCENES)
def test_oclgrind_finds_no_fault(name, tmp_path):
    """Nothing is read or written out of bounds or in a race, and the image is the usual device's.

    Oclgrind 21.10 does not know all that its own optimiser writes (LLVM's noalias scopes), which is
    turned off therefore. Programs that were built with it may lie in the usual cache.
    """
    np.save(tmp_path / "board.npy", np.linspace(280.0, 320.0, 48).reshape(6, 8))
    data = scene(**SMALL | SCENES[name])
    file = write(tmp_path, data)
    command = ["oclgrind", "--data-races", sys.executable, "-m", "thzcl", "run", str(file)]
    own = {
        "PYTHONPATH": str(ROOT),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable",
    }
    done = subprocess.run(
        [*command, "-o", str(tmp_path), "--device", "Oclgrind", "--no-figure", "--quiet"],
        cwd=tmp_path,
        env=os.environ | own,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    with h5netcdf.File(tmp_path / "scene.nc") as stored:
        assert "oclgrind" in stored.attrs["device"].lower()
        image = np.asarray(stored.variables["image"])[0]
    usual = np.asarray(run(tmp_path, data).variants[0].image.values)
    assert np.ptp(usual) > 0
    assert image == pytest.approx(usual, abs=1e-6 * np.abs(usual).max())
