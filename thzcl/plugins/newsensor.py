"""A package with a sensor of one's own, to start from."""

from __future__ import annotations

import re
from pathlib import Path

from thzcl.plugins.loader import PluginError
from thzcl.plugins import loader as plugins
from thzcl.sensor import CONTRACT

_PYPROJECT = """\
[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "thzcl-{name}"
version = "0.1.0"
description = "The sensor {name} for thzcl"
requires-python = ">=3.11"
dependencies = ["thzcl"]

# The entry point's name is what scenes say: [sensor] kind = "{name}".
[project.entry-points."thzcl.sensors"]
{name} = "{module}"

[tool.setuptools]
py-modules = ["{module}"]
"""

_SENSOR = """\
from thzcl.sensor import FrequencyGHz, Image, Needs, Parameters, Sensor, hookimpl, parameter


class {title}(Sensor):
    \"\"\"One line that says what it is.

    And the manual page: what it records, its equations with their source, what it leaves out. `thzcl sensors {name}` shows
    it, with the table of parameters below.
    \"\"\"

    name = "{name}"
    contract = {contract}  # of thzcl.sensor, as this was written

    class Params(Parameters):
        frequency_ghz: FrequencyGHz = parameter(help="centre frequency", unit="GHz")
        gain: float = parameter(1.0, gt=0, help="counts per kelvin")
        noise_counts: float = parameter(0.0, ge=0, help="standard deviation of the noise, in counts")

    def needs(self, view):
        # What must be computed; see thzcl.sensor.Needs for all there is: bands, echoes, times,
        # optics.
        return Needs(frequency_hz=[self.params.frequency_ghz * 1e9], noise=self.params.noise_counts > 0)

    def observe(self, sight, rng):
        # A pure function of what reaches the pixels (thzcl.sensor.Radiances) and of the random
        # numbers.
        counts = self.params.gain * sight.brightness_temperature[0]
        counts = counts + self.params.noise_counts * rng.standard_normal(counts.shape)
        return Image(counts, unit="1", quantity="counts")


@hookimpl
def register_sensors():
    return [{title}]
"""

_TEST = """\
import pathlib

import numpy as np
import thzcl


def test_counts_are_gain_times_kelvin():
    scene = pathlib.Path(__file__).with_name("scene.toml")
    one, two = (thzcl.run(scene, settings={{"sensor.gain": gain}}).variants[0].image.values for gain in (1.0, 2.0))
    assert np.allclose(two, 2 * one)
    assert 250 < one.mean() < 320
"""

_SCENE = """\
# A warm box through humid air, as the sensor {name} sees it.

[camera]
position_m = [0, 0, 5]
look_at_m = [30, 0, 0.5]
focal_length_mm = 100
focal_plane_mm = [10, 10]
pixels = [64, 64]

[atmosphere]
temperature_k = 290
relative_humidity_percent = 60

[ground]
temperature_k = 286

[targets.box]
kind = "box"
center_m = [30, 0, 0.5]
size_m = [1, 1.5, 1]
temperature_k = 300

[sensor]
kind = "{name}"
frequency_ghz = 650
"""


def write(name: str, where: Path) -> Path:
    """Writes the package into a new folder of that name, and returns it.

    Raises PluginError or OSError.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise PluginError(
            f'"{name}" cannot name a sensor; use small letters, digits and single hyphens, as in my-sensor'
        )
    taken = [origin for origin in plugins.origins() if origin.name == name]
    if taken:
        raise PluginError(f'"{name}" is a sensor of {taken[0].distribution}; choose another name')
    folder = where / name
    if folder.exists():
        raise PluginError(f"{folder}: exists already; choose another name")
    module = "thzcl_" + name.replace("-", "_")
    words = {
        "name": name,
        "module": module,
        "title": name.title().replace("-", ""),
        "contract": CONTRACT,
    }
    folder.mkdir()
    for file, text in (
        ("pyproject.toml", _PYPROJECT),
        (f"{module}.py", _SENSOR),
        (f"test_{module}.py", _TEST),
        ("scene.toml", _SCENE),
    ):
        (folder / file).write_text(text.format(**words), encoding="utf-8")
    return folder
