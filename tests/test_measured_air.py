"""From a record to a scene: what is written runs, and its air is the measured one."""

from __future__ import annotations

import pytest
import tomli
from hygrometer import RECORD, synthetic
from PIL import Image

from thzcl import pipeline
from thzcl.records.study import study
from thzcl.turbulence import spectra as turbulence


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    found = study([RECORD], output=folder, scene=folder / "measured.toml")
    return found, folder / "measured.toml"


def test_the_scene_has_the_measured_air(written):
    found, path = written
    text = path.read_text(encoding="utf-8")
    air = tomli.loads(text)["atmosphere"]
    assert air["absolute_humidity_g_m3"] == pytest.approx(found["mean_g_m3"], rel=1e-3)
    assert air["temperature_k"] == pytest.approx(found["mean_temperature_k"], abs=0.01)
    assert air["pressure_hpa"] == pytest.approx(found["pressure_hpa"], abs=0.1)
    for key in ("structure_constant_q", "structure_constant_t", "outer_scale_m"):
        assert air["fluctuations"][key] == pytest.approx(found[key], rel=1e-3)
    inertial = found["correlation_tq_inertial"]  # and not that of all scales
    assert air["fluctuations"]["correlation_tq"] == pytest.approx(inertial, rel=1e-3)
    assert "of station 6843" in text and RECORD.name in text and "2012-06-07 12:45:00" in text


def test_three_pictures_are_drawn(written):
    """Like the paper's figures 2, 3 and 4; what they show has been looked at.

    Here only that they show something.
    """
    found, path = written
    names = [f"{RECORD.stem}-{name}.png" for name in ("time", "wind-run", "spectrum")]
    assert [file.split("/")[-1] for file in found["files"]] == [
        *names,
        "measured.toml",
        "measured-spectrum.csv",
    ]
    for name in names:
        with Image.open(path.parent / name) as picture:
            assert min(picture.size) > 400 and len(picture.convert("L").getcolors()) > 50


def test_the_scene_runs_as_it_is(written, thzcl_command):
    done = thzcl_command("run", written[1], "--no-figure")
    assert done.returncode == 0, done.stderr


def test_a_record_without_temperature_makes_a_scene_too(tmp_path):
    path, _, _ = synthetic(tmp_path / "a.csv", 0)
    study([path], scene=tmp_path / "scene.toml")
    plan = pipeline.prepare(tmp_path / "scene.toml")
    assert turbulence.turbulence(plan.variants[0].scene.atmosphere).structure_constants(12.0)[
        0
    ] == pytest.approx(0.2, rel=0.2)
    assert "# not in the record" in (tmp_path / "scene.toml").read_text(encoding="utf-8")


def test_nothing_is_written_over(written, thzcl_command):
    done = thzcl_command("fluctuations", RECORD, "--scene", written[1])
    assert done.returncode == 2 and "exists already; choose another name" in done.stderr
