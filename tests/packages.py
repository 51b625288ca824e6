"""Third parties' packages, as pip leaves them where Python looks for modules."""

from __future__ import annotations

import shutil
import subprocess
import sys

from conftest import ROOT
from scenes import scene, write

from thzcl import pipeline

# A third party's constituent, as small as one can be.
ODD = """
import numpy as np
from thzcl.constituent import (
    Constituent, Grid, OpticalProperties, Parameters, Span, file_parameter, hookimpl, parameter
)
class Odd(Constituent):
    name = "odd"
    contract = 1
    class Params(Parameters): pass
    def optics(self, frequency_hz, temperature_k, pressure_hpa, vapour_hpa):
        return OpticalProperties(absorption=1e-3)
@hookimpl
def register_constituents(): return [Odd]
"""


def install(package, folder):
    """Installs a package by pip into a folder. Returns the environment for a process.

    It is built in a copy, since builds leave files behind, and tests run beside each other.
    """
    copy = folder.parent / f"{folder.name}-build"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target"]
    subprocess.run([*command, str(folder), str(copy)], check=True, capture_output=True)
    return {"PYTHONPATH": f"{ROOT}:{folder}"}


def plugin(
    folder,
    body,
    name="odd",
    module="odd_module",
    distribution="odd-sensors",
    group="thzcl.sensors",
):
    """Writes a module and its metadata. Returns the environment for a process."""
    (folder / f"{module}.py").write_text(body, encoding="utf-8")
    info = folder / f"{distribution.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    text = f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n"
    (info / "METADATA").write_text(text, encoding="utf-8")
    points = f"[{group}]\n{name} = {module}\n"
    (info / "entry_points.txt").write_text(points, encoding="utf-8")
    return {"PYTHONPATH": f"{ROOT}:{folder}"}


def prepare(folder, name, **changes):
    """Plans a scene whose air holds a constituent of that name."""
    data = scene(**({f"atmosphere__{name}": {}} | changes))
    return pipeline.prepare(write(folder, data))
