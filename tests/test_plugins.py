"""The door for other people's sensors: it opens on the first try, and what is wrong is named."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import ROOT
from packages import install, plugin
from scenes import scene, write

from thzcl.plugins.template import write_package
from thzcl.scenario.sensors import HOOK
from thzcl.sensor import CONTRACT, Image, Sensor


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The example package, built and installed by pip, as environment for a process."""
    return install(ROOT / "tests" / "example_sensor", tmp_path_factory.mktemp("site"))


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
    "interrupts on import": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "another version": (
        GOOD.replace("contract = 1", "contract = 99"),
        "written for version 99 of the sensor contract, this thzcl has",
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


PASSES = {
    "a fact of float32": "return Image(kelvin, 'K', 'x', facts={'a': (np.float32(1), 'K')})",
    "a list": "return Image(kelvin.tolist(), 'K', 'x')",
    "truth values": "return Image(kelvin > 0, '1', 'x')",
}
FAILS = {
    "raises": ("raise ZeroDivisionError('of course')", "ZeroDivisionError: of course"),
    "exits": ("import sys; sys.exit(0)", "SystemExit: 0"),
    "interrupts": ("raise KeyboardInterrupt", "KeyboardInterrupt"),
    "wrong shape": (
        "return Image(np.zeros((2, 2)), 'K', 'x')",
        "returned image of shape (2, 2); the image has (12, 16)",
    ),
    "not a number": (
        "return Image(np.full(sight.target.shape, np.nan), 'K', 'x')",
        "values that are not finite",
    ),
    "beyond float32": ("return Image(kelvin * 1e298, 'K', 'x')", "not finite as float32"),
    "wrong type": ("return 3", "returned int instead of an Image"),
    "text": ("return Image(np.full(sight.target.shape, 'a'), 'K', 'x')", "not numbers"),
    "writes into its inputs": ("sight.optical_depth[...] = np.nan", "read-only"),
    "writes into what it computed": (
        "sight.brightness_temperature_contrast[...] = np.nan",
        "read-only",
    ),
    "a layer named as a variable": (
        "return Image(kelvin, 'K', 'x', layers={'radiance': Layer(kelvin, 'K', 'x')})",
        "'radiance', as the result file's own",
    ),
    "a layer in a group": (
        "return Image(kelvin, 'K', 'x', layers={'a/b': Layer(kelvin, 'K', 'x')})",
        "'a/b', which cannot name a netCDF variable",
    ),
    "a fact that is none": (
        "return Image(kelvin, 'K', 'x', facts={'a': (float('nan'), 'K')})",
        "a fact 'a' whose value is not a finite number",
    ),
}
OBSERVE = 'return Image(sight.brightness_temperature[0], "K", "kelvin")'


def observing(body):
    """A sensor whose observe() has another body."""
    first = "kelvin = sight.brightness_temperature[0]"
    return GOOD.replace(OBSERVE, f"{first}; {body}").replace("Image, Needs", "Image, Layer, Needs")


@pytest.mark.parametrize("case", PASSES)
def test_common_slips_do_no_harm(thzcl_json, tmp_path, case):
    import h5netcdf

    environment = plugin(tmp_path, observing(PASSES[case]))
    file = write(tmp_path, scene(sensor={"kind": "odd"}))
    found = thzcl_json("run", file, env=environment)  # with its figure
    with h5netcdf.File(tmp_path / "scene.nc") as stored:
        mean = float(stored["image"][...].mean())
    assert mean == 1 if case == "truth values" else 280 < mean < 300
    facts = {"a": {"value": 1.0, "unit": "K"}} if "fact" in case else {}
    assert found["variants"][0]["facts"] == facts


@pytest.mark.parametrize("case", FAILS)
def test_a_sensor_that_fails_keeps_the_radiances(thzcl_command, tmp_path, case):
    import h5netcdf

    body, expected = FAILS[case]
    environment = plugin(tmp_path, observing(body))
    done = thzcl_command("run", write(tmp_path, scene(sensor={"kind": "odd"})), env=environment)
    assert done.returncode == 4
    assert expected in done.stderr and "odd-sensors" in done.stderr and "scene.nc" in done.stderr
    assert "Traceback" not in done.stderr
    with h5netcdf.File(tmp_path / "scene.nc") as kept:
        assert "radiance" in kept.variables and "image" not in kept.variables
        assert np.isfinite(kept["optical_depth"][...]).all()


NEEDS = {
    "raises ValueError": ("raise ValueError('gain: too high')", 2, "[sensor] gain: too high"),
    "raises anything": ("raise KeyError('x')", 4, "KeyError"),
    "exits": ("import sys; sys.exit(0)", 4, "SystemExit: 0"),
    "words": ("return Needs(frequency_hz=['a'])", 4, "not made of numbers"),
    "weights of zero": (
        "return Needs(frequency_hz=[650e9], weights=[[0.0]])",
        4,
        "weights whose sum over a band is not above 0",
    ),
    "writes into its inputs": ("view.lines_hz[...] = 0", 2, "read-only"),
    "wrong type": ("return None", 4, "returned NoneType instead of Needs"),
    "no frequency": ("return Needs(frequency_hz=[])", 4, "not a list of ascending numbers"),
    "too high": ("return Needs(frequency_hz=[2e12])", 2, "holds up to 1780 GHz"),
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
    assert code == 2 or "odd-sensors" in done.stderr
    assert not (tmp_path / "scene.nc").exists()


EARLY = {
    "constructor": ("def __init__(self, *_): raise OSError('no licence')", "OSError: no licence"),
    "troubles": (
        "class Params(Parameters):\n        def troubles(self): return int('x')",
        "troubles() raised ValueError",
    ),
    "no troubles": (
        "class Params(Parameters):\n        def troubles(self): return ['x']",
        "AttributeError",
    ),
}


@pytest.mark.parametrize("case", EARLY)
def test_what_fails_before_needs_is_named_too(thzcl_command, tmp_path, case):
    body, expected = EARLY[case]
    environment = plugin(tmp_path, GOOD.replace("    def needs", f"    {body}\n    def needs"))
    done = thzcl_command("check", write(tmp_path, scene(sensor={"kind": "odd"})), env=environment)
    assert done.returncode == 4
    assert expected in done.stderr and "odd-sensors" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_wrapped_sensor_that_fails_is_named(thzcl_command, tmp_path):
    environment = plugin(tmp_path, observing("raise ZeroDivisionError('of course')"))
    sensor = {
        "kind": "raster-scan",
        "timing": "raster",
        "dwell_s": 1e-3,
        "detector": {"kind": "odd"},
    }
    done = thzcl_command("run", write(tmp_path, scene(sensor=sensor)), env=environment)
    assert done.returncode == 4
    assert 'sensor "raster-scan" of thzcl, around sensor "odd" of odd-sensors' in done.stderr


def test_an_interrupt_by_the_user_interrupts_whatever_a_plugin_does(thzcl_command, tmp_path):
    body = """
        import os, signal
        try: os.kill(os.getpid(), signal.SIGINT)
        except BaseException: pass
        """
    environment = plugin(tmp_path, GOOD.replace(OBSERVE, body + OBSERVE))
    done = thzcl_command("run", write(tmp_path, scene(sensor={"kind": "odd"})), env=environment)
    assert done.returncode == 130, done.stderr


def test_a_new_sensor_installs_and_runs_as_it_is(thzcl_command, tmp_path):
    assert thzcl_command("new-sensor", "my-camera").returncode == 0
    environment = install(tmp_path / "my-camera", tmp_path / "site")
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


@pytest.mark.parametrize("name", ["image", "sensor", "none", "needs", "my-sensor"])
def test_a_new_sensors_name_hides_nothing_that_it_needs(tmp_path, monkeypatch, name):
    folder = write_package(HOOK, name, tmp_path)
    (file,) = folder.glob("thzcl_*.py")
    monkeypatch.syspath_prepend(folder)
    (made,) = import_module(file.stem).register_sensors()
    assert issubclass(made, Sensor) and made.name == name and made.contract == CONTRACT
    sight = SimpleNamespace(brightness_temperature=np.full((1, 2, 3), 300.0))
    params = made.Params(frequency_ghz=650.0, gain=2.0)
    image = made(params).observe(sight, np.random.default_rng(0))
    assert isinstance(image, Image) and (image.values == 600).all()


def test_only_the_chosen_sensor_is_imported():
    code = (
        "import sys; from thzcl import pipeline; pipeline.prepare('quick');"
        "print([m for m in sys.modules if m.startswith('thzcl.sensors.')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "['thzcl.sensors.passive_spectral']"
