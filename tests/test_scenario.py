"""Scenarios: what is read, what is refused, and in which words."""

from __future__ import annotations

import json

import pytest
import tomli
from scenes import PLAIN, scene, write

from thzcl import pipeline, scenario
from thzcl.plugins import loader as plugins
from thzcl.scenario import ScenarioError, toml


def problems(file, settings=None):
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(file, settings)
    return caught.value.problems


def test_every_problem_at_once_with_its_place(tmp_path):
    file = tmp_path / "bad.toml"
    file.write_text(
        """\
[camera]
position_m = [0, 0, 5]
look_at_m = [0, 0, 5]
focal_length_mm = -1
focal_plane_mm = [10, 10]
pixels = [0, 64]

[atmosphere]
temprature_k = 275
relative_humidity_percent = 50
absolute_humidity_g_m3 = 5

[atmosphere.fluctuations]
sigma_percent = "high"
voxel_m = 0.5
grid = 100

[targets.box]
kind = "box"
center_m = [30, 0]
size_m = [1, 0, 1]
temperature_k = -5
reflectivity = 1.5

[sensor]
kind = "passive-spectral"
frequency_ghz = 2000
""",
        encoding="utf-8",
    )
    lines = problems(file)
    numbers = [int(line.split("bad.toml:")[1].split(":")[0]) for line in lines]
    assert numbers == sorted(numbers)
    found = "\n".join(lines)
    for expected in (
        "bad.toml:4: [camera] focal_length_mm: must be above 0 mm, not -1",
        "bad.toml:6: [camera] pixels.0: must be at least 1, not 0",
        "bad.toml:9: [atmosphere] temprature_k: unknown key (did you mean temperature_k?)",
        "bad.toml:8: [atmosphere] temperature_k: missing: mean air temperature",
        "bad.toml:11: [atmosphere] absolute_humidity_g_m3: give only one of relative_humidity_percent or",
        'bad.toml:14: [atmosphere.fluctuations] sigma_percent: must be a number, not "high"',
        "bad.toml:20: [targets.box] center_m.2: missing",
        "bad.toml:21: [targets.box] size_m.1: must be above 0 m, not 0",
        "bad.toml:22: [targets.box] temperature_k: must be at least 0 K, not -5",
        "bad.toml:23: [targets.box] reflectivity: must be at most 1, not 1.5",
        "bad.toml:27: [sensor] frequency_ghz: must be at most 1780 GHz, not 2000",
    ):
        assert expected in found, found


SINGLE = {
    "grid": (
        {"atmosphere__fluctuations__grid": 100},
        "[atmosphere.fluctuations] grid: must be a power of two",
    ),
    "looks at itself": (
        {"camera__look_at_m": [1.0, -2.0, 4.0]},
        "[camera] look_at_m: the camera looks at itself",
    ),
    "under ground": (
        {"camera__position_m": [0, 0, -1.0]},
        "[camera] position_m: the camera is at z = -1 m",
    ),
    "no humidity": (
        {"atmosphere__relative_humidity_percent": None},
        "[atmosphere] needs one of relative_humidity_percent",
    ),
    "not a number": (
        {"atmosphere__temperature_k": float("nan")},
        "[atmosphere] temperature_k: must be a finite number",
    ),
    "pressure": (
        {"atmosphere__pressure_hpa": 10.0},
        "makes a vapour pressure of 13.4 hPa, more than the total of 10 hPa",
    ),
    "outer scale": (
        {"atmosphere__fluctuations__spectrum": "von-karman"},
        'spectrum = "von-karman" needs outer_scale_m',
    ),
    "spectrum": (
        {"atmosphere__fluctuations__spectrum": "kolmogorof"},
        "must be 'kolmogorov', 'von-karman', 'table' or 'file'",
    ),
    "no sensor of that name": (
        {"sensor__kind": "passive-spectrl"},
        'no sensor "passive-spectrl" is installed (did you mean',
    ),
    "ground temperature": (
        {"ground__temperature_k": None},
        "[ground] temperature_k: missing; a passive sensor sees",
    ),
    "no frequency": ({"sensor__frequency_ghz": None}, "[sensor] frequency_ghz: missing: frequency"),
    "no camera": ({"camera": None}, "camera: missing"),
    "name taken": (
        {"targets__ground": PLAIN["targets"]["box"]},
        '[targets] ground: "ground" names another part',
    ),
    "no such file": (
        {"atmosphere__fluctuations": {"spectrum": "file", "file": "no.nc"}},
        "no.nc: cannot be read",
    ),
    "bars twice": (
        {"targets__box__bars": [{"face": "-x", "count": 2, "temperature_k": 1.0}] * 2},
        '[targets.box] bars: face "-x" has two sets of bars',
    ),
    "camera is text": ({"camera": "here"}, 'camera: must be a table, not "here"'),
}


@pytest.mark.parametrize("case", SINGLE)
def test_each_mistake_has_its_message(tmp_path, case):
    changes, expected = SINGLE[case]
    found = problems(write(tmp_path, scene(**changes)))
    assert len(found) == 1, found
    assert expected in found[0], found


def test_variants_change_what_they_set_and_are_checked(tmp_path):
    data = scene(
        variants=[
            {"name": "cold", "set": {"targets.box.temperature_k": 250.0}},
            {"name": "as it is"},
        ]
    )
    plan = pipeline.prepare(write(tmp_path, data))
    assert [v.name for v in plan.variants] == ["cold", "as it is"]
    assert [v.scene.targets["box"].temperature_k for v in plan.variants] == [250.0, 300.0]
    assert [
        v.name for v in pipeline.prepare(write(tmp_path, data), variants=["as it is"]).variants
    ] == ["as it is"]
    with pytest.raises(ScenarioError, match=r"no such variant \(did you mean cold"):
        pipeline.prepare(write(tmp_path, data), variants=["colt"])
    bad = scene(
        variants=[
            {"name": "hot", "set": {"targets.box.temprature_k": 1.0}},
            {"name": "hot", "set": {"ground.temperature_k": -3.0}},
        ]
    )
    file = write(tmp_path, bad)
    lines = file.read_text().splitlines()
    found = "\n".join(problems(file))
    assert f"scene.toml:{lines.index('[[variants]]') + 3}: " in found
    assert "unknown key (did you mean temperature_k?)" in found
    assert "at least 0 K, not -3" in found
    assert '"hot" is taken' in found


def test_settings_change_keys_and_are_named_in_messages(tmp_path):
    file = write(tmp_path, PLAIN)
    plan = pipeline.prepare(
        file, {"targets.box.temperature_k": 310.0, "sensor.frequency_ghz": [350.0, 650.0]}
    )
    assert plan.variants[0].scene.targets["box"].temperature_k == 310.0
    assert plan.frequency_hz.tolist() == [350e9, 650e9]
    assert problems(file, {"camera.pixels": 3})[0].startswith(
        "--set: [camera] pixels: must be a list"
    )


def test_what_is_not_a_scenario_is_refused_in_words(tmp_path):
    (tmp_path / "latin.toml").write_bytes("# caf\xe9".encode("latin-1"))
    (tmp_path / "broken.toml").write_text(
        "[camera]\nposition_m = [1,\nlook_at_m = 3\n", encoding="utf-8"
    )
    (tmp_path / "huge.toml").write_bytes(b"#" * 5_000_000)
    (tmp_path / "other.nc").write_bytes(b"not a result")
    for name, expected in (
        ("latin.toml", "not UTF-8 text (byte 5)"),
        ("broken.toml", "broken.toml:3: not valid TOML in column"),
        ("huge.toml", "larger than 4 MB"),
        ("other.nc", "cannot be read"),
        ("", "cannot be read"),
        ("figur6", "no such file or shipped scene (did you mean figure6?)"),
    ):
        with pytest.raises(ScenarioError) as caught:
            pipeline.prepare(str(tmp_path / name) if name != "figur6" else name)
        assert expected in str(caught.value)


def test_toml_is_written_as_it_is_read():
    for data in (
        PLAIN,
        scene(variants=[{"name": 'q"uote', "set": {"a.b": [1, 2.5, "x"], "c": True}}]),
    ):
        assert tomli.loads(toml.dumps(data)) == data


def test_a_seed_is_drawn_and_recorded(tmp_path):
    data = scene(atmosphere__fluctuations__seed=None)
    one, other = (pipeline.prepare(write(tmp_path, data)).scenario for _ in range(2))
    assert one.seed != other.seed
    assert tomli.loads(one.text)["atmosphere"]["fluctuations"]["seed"] == one.seed


def test_the_schema_knows_what_the_reader_knows():
    found = plugins.scenario_schema()
    json.dumps(found)
    assert found["$defs"]["Camera"]["additionalProperties"] is False
    assert found["$defs"]["passive-spectral"]["required"] == ["kind", "frequency_ghz"]
    assert found["$defs"]["Atmosphere"]["properties"]["temperature_k"]["unit"] == "K"


@pytest.mark.parametrize("name", scenario.shipped())
def test_every_shipped_scene_is_sound_and_says_what_it_is(name):
    plan = pipeline.prepare(name)
    assert plan.variants
    assert len(scenario.shipped()[name]) > 20
