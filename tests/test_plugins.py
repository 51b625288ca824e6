"""The door for other people's sensors: it opens on the first try, and what is wrong is named."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from conftest import ROOT
from scenes import scene, write


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The example package, built and installed by pip, as environment for a process."""
    folder = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(folder),
    ]
    subprocess.run(
        [*command, str(ROOT / "tests" / "example_sensor")], check=True, capture_output=True
    )
    return {"PYTHONPATH": f"{ROOT}:{folder}"}


def test_an_installed_sensor_is_found_listed_explained_and_used(
    thzcl_command, thzcl_json, tmp_path, installed
):
    import h5netcdf

    file = write(
        tmp_path,
        scene(
            sensor={"kind": "dicke", "frequency_ghz": 650.0, "reference_k": 280.0, "noise_k": 0.5}
        ),
    )
    found = thzcl_json("run", file, "--no-figure", env=installed)
    assert found["variants"][0]["targets"]["box"]["pixels"] > 0
    with h5netcdf.File(tmp_path / "scene.nc") as result:
        kelvin, noise = result["image"][0], result["noise"][0]
        contrast = result["brightness_temperature_contrast"][0, 0].astype(float)
        assert kelvin - noise == pytest.approx((290 + contrast - 280) / 2, abs=1e-4)
        assert 0.3 < noise.std() < 0.7
        assert result["noise"].attrs["units"] == "K"
    assert "example-dicke" in thzcl_command("sensors", env=installed).stdout
    page = thzcl_command("sensors", "dicke", env=installed).stdout
    assert "compares the scene with a reference load" in page and "reference_k" in page
    assert "noise" not in {item["stage"] for item in found["left_out"]}


def test_its_parameters_are_checked_like_any(thzcl_command, tmp_path, installed):
    file = write(
        tmp_path,
        scene(sensor={"kind": "dicke", "frequency_ghz": 650.0, "reference_k": -1.0, "nose_k": 1.0}),
    )
    done = thzcl_command("check", file, env=installed)
    assert done.returncode == 2
    assert "[sensor] reference_k: must be above 0 K, not -1" in done.stderr
    assert "did you mean noise_k?" in done.stderr


def test_a_module_may_hold_several_sensors_and_ask_for_bands(thzcl_json, tmp_path, installed):
    file = write(tmp_path, scene(sensor={"kind": "two-bands"}))
    box = thzcl_json("run", file, "--no-figure", env=installed)["variants"][0]["targets"]["box"]
    assert 0 < box["transmission"] < 1


def plugin(folder, body, name="odd", module="odd_module", distribution="odd-sensors"):
    """A plugin as pip would leave it: a module and its metadata."""
    (folder / f"{module}.py").write_text(body, encoding="utf-8")
    info = folder / f"{distribution.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(
        f"[thzcl.sensors]\n{name} = {module}\n", encoding="utf-8"
    )
    return {"PYTHONPATH": f"{ROOT}:{folder}"}


GOOD = """
import numpy as np
from thzcl.sensor import Image, Needs, Parameters, Sensor, hookimpl
class Odd(Sensor):
    name = "odd"
    contract = 1
    class Params(Parameters): pass
    def needs(self, view): return Needs(frequency_hz=[650e9])
    def observe(self, sight, rng): return Image(sight.brightness_temperature[0], "K", "kelvin")
@hookimpl
def register_sensors(): return [Odd]
"""

BROKEN = {
    "raises on import": ("raise RuntimeError('no licence')", "RuntimeError: no licence"),
    "exits on import": ("import sys; sys.exit('bye')", "SystemExit: bye"),
    "another version": (
        GOOD.replace("contract = 1", "contract = 2"),
        "written for version 2 of the sensor contract, this thzcl has",
    ),
    "no version": (GOOD.replace("contract = 1", ""), "written for version None"),
    "misspelt hook": (
        GOOD.replace("def register_sensors", "def register_sensor"),
        "unknown hook 'register_sensor'",
    ),
    "no such name": (GOOD.replace('name = "odd"', 'name = "even"'), 'offers no sensor named "odd"'),
    "no observe": (GOOD.replace("def observe", "def obsrve"), "does not define observe()"),
    "no Params": (
        GOOD.replace("class Params(Parameters)", "class Parms(Parameters)"),
        "its Params is not",
    ),
    "no Sensor": (
        GOOD.replace("class Odd(Sensor)", "class Odd"),
        "is not a subclass of thzcl.sensor.Sensor",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_plugin_is_named_and_breaks_no_other_scene(thzcl_command, tmp_path, case):
    body, expected = BROKEN[case]
    environment = plugin(tmp_path, body)
    file = write(tmp_path, scene(sensor={"kind": "odd"}))
    done = thzcl_command("check", file, env=environment)
    assert done.returncode == 2
    assert (
        expected in done.stderr and "odd-sensors" in done.stderr and "Traceback" not in done.stderr
    )
    assert thzcl_command("check", "quick", env=environment).returncode == 0
    assert "BROKEN" in thzcl_command("sensors", env=environment).stdout
    assert thzcl_command("schema", env=environment).returncode == 0
    doctor = thzcl_command("doctor", env=environment)
    assert doctor.returncode == 3 and "pip uninstall odd-sensors" in doctor.stdout


def test_a_name_claimed_twice_is_reported(thzcl_command, tmp_path):
    plugin(tmp_path, GOOD)
    environment = plugin(tmp_path, GOOD, module="odd_too", distribution="odd-too")
    file = write(tmp_path, scene(sensor={"kind": "odd"}))
    done = thzcl_command("check", file, env=environment)
    assert done.returncode == 2
    assert "claimed by odd-sensors and odd-too" in done.stderr
    built_in = tmp_path / "more"
    built_in.mkdir()
    stolen = plugin(
        built_in, GOOD.replace('"odd"', '"active"'), name="active", distribution="thief"
    )
    doctor = thzcl_command("doctor", env=stolen)
    assert "claimed by thzcl and thief" in doctor.stdout


FAILS = {
    "raises": ("raise ZeroDivisionError('of course')", "ZeroDivisionError: of course"),
    "wrong shape": (
        "return Image(np.zeros((2, 2)), 'K', 'x')",
        "returned image of shape (2, 2); the image has (12, 16)",
    ),
    "not a number": (
        "return Image(np.full(sight.target.shape, np.nan), 'K', 'x')",
        "values that are not finite",
    ),
    "wrong type": ("return 3", "returned int instead of an Image"),
    "text": ("return Image(np.full(sight.target.shape, 'a'), 'K', 'x')", "not numbers"),
}


@pytest.mark.parametrize("case", FAILS)
def test_a_sensor_that_fails_keeps_the_radiances(thzcl_command, tmp_path, case):
    import h5netcdf

    body, expected = FAILS[case]
    old = 'return Image(sight.brightness_temperature[0], "K", "kelvin")'
    environment = plugin(tmp_path, GOOD.replace(old, body))
    done = thzcl_command("run", write(tmp_path, scene(sensor={"kind": "odd"})), env=environment)
    assert done.returncode == 4
    assert expected in done.stderr and "odd-sensors" in done.stderr and "scene.nc" in done.stderr
    assert "Traceback" not in done.stderr
    with h5netcdf.File(tmp_path / "scene.nc") as kept:
        assert "radiance" in kept.variables and "image" not in kept.variables


NEEDS = {
    "raises ValueError": ("raise ValueError('gain: too high')", 2, "[sensor] gain: too high"),
    "raises anything": ("raise KeyError('x')", 4, "KeyError"),
    "wrong type": ("return None", 4, "returned NoneType instead of Needs"),
    "no frequency": ("return Needs(frequency_hz=[])", 4, "not a list of ascending numbers"),
    "too high": ("return Needs(frequency_hz=[2e12])", 2, "MPM93 ends at 1780 GHz"),
    "weights": (
        "return Needs(frequency_hz=[650e9], weights=[[1, 2]])",
        4,
        "weights of another length",
    ),
}


@pytest.mark.parametrize("case", NEEDS)
def test_needs_are_checked_before_anything_is_computed(thzcl_command, tmp_path, case):
    body, code, expected = NEEDS[case]
    environment = plugin(tmp_path, GOOD.replace("return Needs(frequency_hz=[650e9])", body))
    done = thzcl_command("run", write(tmp_path, scene(sensor={"kind": "odd"})), env=environment)
    assert done.returncode == code
    assert expected in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "scene.nc").exists()


def test_a_new_sensor_installs_and_runs_as_it_is(thzcl_command, tmp_path):
    assert thzcl_command("new-sensor", "my-camera").returncode == 0
    folder = tmp_path / "site"
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--target",
        str(folder),
        "./my-camera",
    ]
    subprocess.run(command, check=True, capture_output=True, cwd=tmp_path)
    environment = {"PYTHONPATH": f"{ROOT}:{folder}"}
    done = thzcl_command(
        "run", "my-camera/scene.toml", "--no-figure", "--format", "json", env=environment
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["variants"]
    tests = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "my-camera"]
    done = subprocess.run(
        tests,
        cwd=tmp_path,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    for name, expected in (
        ("my-camera", "exists already"),
        ("active", "is a sensor of thzcl"),
        ("My Camera", "small letters"),
    ):
        done = thzcl_command("new-sensor", name)
        assert done.returncode == 2 and expected in done.stderr


def test_only_the_chosen_sensor_is_imported():
    code = (
        "import sys; from thzcl import pipeline; pipeline.prepare('quick');"
        "print([m for m in sys.modules if m.startswith('thzcl.sensors.')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "['thzcl.sensors.passive_spectral']"
