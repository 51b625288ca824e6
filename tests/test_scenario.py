"""Scenarios: what is read, what is refused, and in which words."""

from __future__ import annotations

import json

import h5py
import jsonschema
import pytest
import tomli
from scenes import ACTIVE, BROAD, DRIFTING, PLAIN, scene, write

from thzcl import pipeline
from thzcl.__main__ import main
from thzcl.errors import ScenarioError
from thzcl.plan import report
from thzcl.scenario import document, manual
from thzcl.scenario.atmosphere import Atmosphere, Fluctuations
from thzcl.scenario.source import SHIPPED, find, shipped
from thzcl.turbulence.spectra import turbulence


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
frequency_ghz = 2e5
""",
        encoding="utf-8",
    )
    lines = problems(file)
    numbers = [int(line.split("bad.toml:")[1].split(":")[0]) for line in lines]
    assert numbers == sorted(numbers)
    found = "\n".join(lines)
    for expected in (
        "bad.toml:4: [camera] focal_length_mm: must be at least 1e-06 mm, not -1",
        "bad.toml:6: [camera] pixels.0: must be at least 1, not 0",
        "bad.toml:9: [atmosphere] temprature_k: unknown key (did you mean temperature_k?)",
        "bad.toml:8: [atmosphere] temperature_k: missing: mean air temperature",
        "bad.toml:11: [atmosphere] absolute_humidity_g_m3: give only one of relative_humidity_",
        'bad.toml:14: [atmosphere.fluctuations] sigma_percent: must be a number, not "high"',
        "bad.toml:20: [targets.box] center_m.2: missing",
        "bad.toml:21: [targets.box] size_m.1: must be above 0 m, not 0",
        "bad.toml:22: [targets.box] temperature_k: must be at least 0 K, not -5",
        "bad.toml:23: [targets.box] reflectivity: must be at most 1, not 1.5",
        "bad.toml:27: [sensor] frequency_ghz: must be at most 100000 GHz, not 200000",
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
    "looks nowhere": (
        {"camera__position_m": [1e-300, 0, 1.2], "camera__look_at_m": [0, 0, 1.2]},
        "[camera] look_at_m: the camera looks at itself",
    ),
    "tiny up": ({"camera__up": [0, 0, 1e-300]}, "[camera] up: must not be zero"),
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
    "degrees Celsius": (
        {"atmosphere__temperature_k": -5},
        "must be at least 100 K, not -5; -5 degrees Celsius are 268.15 K",
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
    "no kind of target": (
        {"targets__box__kind": None},
        "[targets.box] missing: kind, which says what it is",
    ),
    "no such kind of target": (
        {"targets__box__kind": "sphere"},
        "[targets] box: kind must be 'box' or 'billboard' or 'mesh', not \"sphere\"",
    ),
    "neither of two kinds": (
        {"sensor__frequency_ghz": {"a": 1}},
        "[sensor] frequency_ghz: must be a number or a list in [brackets], not a table",
    ),
    "a choice or a number": (
        {"background__environment": []},
        "[background] environment: must be 'air', 'none' or 'sky' or a number, not []",
    ),
    "beyond the limit of one kind": (
        {"background__environment": -1.0},
        "must be 'air', 'none' or 'sky' or at least 0 K, not -1",
    ),
    "a place in another galaxy": (
        {"camera__position_m": [0.0, 1e300, 5.0]},
        "[camera] position_m.1: must be at most 1e+09 m, not 1e+300",
    ),
    "an aperture that no telescope has": (
        {"sensor__optics": {"aperture_m": 1e300}},
        "[sensor.optics] aperture_m: must be at most 1000 m, not 1e+300",
    ),
    "a strength given twice": (
        {"atmosphere__fluctuations__structure_constant_q": 0.1},
        "give only one of sigma_percent or structure_constant_q",
    ),
    "hardly any fluctuation of temperature": (
        {"atmosphere__fluctuations__temperature_sigma_k": 1e-300},
        "temperature_sigma_k: must be 0 or at least 1e-09, not 1e-300",
    ),
    "variants are no list": ({"variants": 3}, "variants: must be a list of tables [[variants]]"),
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
    (wrong,) = (number for number, line in enumerate(lines, start=1) if "temprature_k" in line)
    assert f"scene.toml:{wrong}: [variants.0.set] targets.box.temprature_k: unknown key" in found
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


def test_two_mistakes_in_one_table_are_both_told(tmp_path):
    """A check of values taken together waits until each of them is there and sound."""
    changes = {"atmosphere__relative_humidity_percent": None, "ground__temperature_k": "x"}
    found = problems(write(tmp_path, scene(**changes)))
    assert len(found) == 2
    assert "[atmosphere] needs one of relative_humidity_percent" in found[0]
    assert '[ground] temperature_k: must be a number, not "x"' in found[1]
    changes |= {"camera__look_at_m": [1.0, -2.0, 4.0], "atmosphere__fluctuations__grid": 100}
    found = problems(write(tmp_path, scene(**changes)))
    assert len(found) == 4
    assert "[camera] look_at_m: the camera looks at itself" in found[0]
    assert "[atmosphere.fluctuations] grid: must be a power of two" in found[2]


def test_a_folder_does_not_hide_a_shipped_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick").mkdir()
    assert find("quick") == SHIPPED / "quick.toml"
    (tmp_path / "slow").mkdir()
    with pytest.raises(ScenarioError, match="a folder, not a regular file"):
        document.read("slow")
    (tmp_path / "figure6").write_text("x = 1", encoding="utf-8")
    assert str(find("figure6")) == "figure6"


def test_what_is_not_a_scenario_is_refused_in_words(tmp_path):
    (tmp_path / "latin.toml").write_bytes("# caf\xe9".encode("latin-1"))
    (tmp_path / "broken.toml").write_text(
        "[camera]\nposition_m = [1,\nlook_at_m = 3\n", encoding="utf-8"
    )
    (tmp_path / "huge.toml").write_bytes(b"#" * 5_000_000)
    (tmp_path / "other.nc").write_bytes(b"not a result")
    h5py.File(tmp_path / "none.nc", "w").close()
    for name, expected in (
        ("latin.toml", "not UTF-8 text (byte 5)"),
        ("broken.toml", "broken.toml:3: not valid TOML in column"),
        ("huge.toml", "larger than 4 MB"),
        ("other.nc", "cannot be read"),
        ("none.nc", "holds no scenario"),
        ("", "cannot be read"),
        ("figur6", "no such file or shipped scene (did you mean figure6?)"),
    ):
        with pytest.raises(ScenarioError) as caught:
            pipeline.prepare(str(tmp_path / name) if name != "figur6" else name)
        assert expected in str(caught.value)


def test_a_seed_is_drawn_and_recorded(tmp_path):
    data = scene(atmosphere__fluctuations__seed=None)
    one, other = (pipeline.prepare(write(tmp_path, data)).scenario for _ in range(2))
    assert one.seed != other.seed
    assert tomli.loads(one.text)["atmosphere"]["fluctuations"]["seed"] == one.seed


@pytest.mark.parametrize(
    "own",
    [
        {"atmosphere.fluctuations": {"sigma_percent": 20, "voxel_m": 0.4}},
        {"atmosphere.fluctuations.sigma_percent": 20, "atmosphere.fluctuations.voxel_m": 0.4},
        {
            "atmosphere.fluctuations.outer_scale_m": 5,
            "atmosphere.fluctuations": {"spectrum": "von-karman", "sigma_percent": 9, "voxel_m": 1},
        },
        {"atmosphere": scene(atmosphere__fluctuations__seed=None)["atmosphere"]},
    ],
)
def test_a_variant_that_brings_fluctuations_gets_a_seed_too(tmp_path, own):
    """The stored text makes the same air again, and both variants share it."""
    data = scene(atmosphere__fluctuations=None, variants=[{"name": n, "set": own} for n in "ab"])
    plan = pipeline.prepare(write(tmp_path, data))
    seeds = {variant.cube.turbulence.seed for variant in plan.variants}
    assert len(seeds) == 1 and seeds != {0}
    assert pipeline.prepare(write(tmp_path, tomli.loads(plan.scenario.text), "again")) == plan


def test_fluctuations_that_lack_a_seed_are_never_taken_for_still_air():
    air = Atmosphere(
        temperature_k=290,
        relative_humidity_percent=50,
        fluctuations={"sigma_percent": 20, "voxel_m": 0.4},
    )
    with pytest.raises(ValueError, match="a seed"):
        turbulence(air)


FLOW = "atmosphere.fluctuations"


@pytest.mark.parametrize(
    ("key", "value"), [("temperature_sigma_k", 50.0), ("structure_constant_t", 1e4)]
)
def test_air_that_would_be_colder_than_nothing_is_refused(tmp_path, key, value):
    (line,) = problems(write(tmp_path, PLAIN), {f"{FLOW}.{key}": value})
    assert "[atmosphere.fluctuations]: the air's temperature would fall to -" in line
    assert "K; lower temperature_sigma_k or structure_constant_t" in line


SCAN = {"kind": "raster-scan", "detector": PLAIN["sensor"], "timing": "focal-plane"}
IDLE = {
    "correlation": (
        {FLOW + ".correlation_tq": 0.5},
        "is used with temperature_sigma_k or structure_constant_t only; remove it, or give that",
    ),
    "grid": (
        {FLOW: {"spectrum": "file", "file": "a.nc", "grid": 64}},
        'grid: is used by spectrum = "kolmogorov" or "von-karman" or "table" only',
    ),
    "aperture": (
        {"sensor": ACTIVE | {"aperture_m": 0.1}},
        'is used by spreading or illumination = "lambert" or "beam" only',
    ),
    "steps": ({"sensor": BROAD | {"step_ghz": 5.0}}, 'step_ghz: is used by quadrature = "paper"'),
    "area": ({"sensor": BROAD | {"aperture_m": 0.1}}, 'is used by throughput = "geometric" only'),
    "rate": (
        {"sensor": BROAD | {"frame_rate_hz": 9.0}},
        "is used with noise_equivalent_power_w_rthz or netd_k or photon_noise only",
    ),
    "dwell": (
        {"sensor": SCAN | {"integration_time_s": 1.0, "dwell_s": 1.0}},
        'dwell_s: is used by timing = "raster" only',
    ),
    "in a detector": (
        {"sensor": SCAN | {"integration_time_s": 1.0, "detector": BROAD | {"aperture_m": 0.1}}},
        '[sensor.detector] aperture_m: is used by throughput = "geometric" only',
    ),
}


@pytest.mark.parametrize("name", IDLE)
def test_a_key_that_no_variant_uses_is_told(tmp_path, name):
    keys, words = IDLE[name]
    scenario = document.parse(document.read(write(tmp_path, PLAIN), keys))
    (line,) = scenario.idle
    assert words in line


def test_a_key_that_one_variant_uses_stands_for_all(tmp_path, capsys):
    own = {"sensor.spreading": "lambert"}
    variants = [{"name": "even", "set": own}, {"name": "mirror", "set": {}}]
    data = scene(sensor=ACTIVE | {"aperture_m": 0.1}, variants=variants)
    assert not pipeline.prepare(write(tmp_path, data)).scenario.idle
    assert not pipeline.prepare(write(tmp_path, data), variants=["mirror"]).scenario.idle
    data["variants"][0]["set"] = {}
    plan = pipeline.prepare(write(tmp_path, data))
    (line,) = plan.scenario.idle
    assert "aperture_m: is used by spreading" in line
    assert line in report.warnings(plan, report.planned_errors(plan))
    main(["check", str(tmp_path / "scene.toml")])
    assert f"note: {line}\n" in capsys.readouterr().out


def test_wind_that_moves_nothing_is_told(tmp_path):
    """Scenes that are written of records give the wind, whatever sensor comes to them."""
    notes = []
    scan = SCAN | {"integration_time_s": 1.0}
    for air, sensor in ((DRIFTING, ACTIVE), (DRIFTING, scan), (PLAIN["atmosphere"], ACTIVE)):
        plan = pipeline.prepare(write(tmp_path, scene(atmosphere=air, sensor=sensor)))
        found = report.warnings(plan, report.planned_errors(plan))
        notes.append([note for note in found if "wind_m_s moves nothing" in note])
    assert [len(found) for found in notes] == [1, 0, 0]


def test_a_difference_of_variants_that_are_not_there_is_refused(tmp_path):
    variants = [{"name": "warm", "set": {}}, {"name": "cold", "set": {}}]
    data = scene(output={"difference": ["warm", "colt"]}, variants=variants)
    (line,) = problems(write(tmp_path, data))
    assert '[output] difference: no variant "colt" (did you mean cold?)' in line
    data["output"]["difference"] = ["warm", "cold"]
    assert pipeline.prepare(write(tmp_path, data), variants=["cold"])


def test_the_schema_knows_what_the_reader_knows():
    found = manual.scenario_schema()
    json.dumps(found)
    assert found["$defs"]["Camera"]["additionalProperties"] is False
    assert found["$defs"]["passive-spectral"]["required"] == ["kind", "frequency_ghz"]
    assert found["$defs"]["Atmosphere"]["properties"]["temperature_k"]["unit"] == "K"


@pytest.mark.parametrize("name", shipped())
def test_the_schema_accepts_every_shipped_scene(name):
    schema = jsonschema.Draft202012Validator(manual.scenario_schema())
    data = tomli.loads((SHIPPED / f"{name}.toml").read_text(encoding="utf-8"))
    assert [error.message for error in schema.iter_errors(data)] == []


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor": {"kind": "raster-scan", "dwell_s": 1.0}},  # no detector
        {"sensor": {"kind": "raster-scan", "dwell_s": 1.0, "detector": {"kind": "active"}}},
        {"sensor__kind": "nothing"},
        {"atmosphere__absolute_humidity_g_m3": 3.0},  # and a relative one
        {"atmosphere__relative_humidity_percent": None},
        {"atmosphere__fluctuations__structure_constant_q": 3.0},  # and a sigma
        {"camera__pixels": [1, 2, 3]},
        {"targets__box__colour": "red"},
    ],
)
def test_the_schema_refuses_what_the_reader_refuses(tmp_path, changes):
    schema = jsonschema.Draft202012Validator(manual.scenario_schema())
    assert schema.is_valid(scene())
    data = scene(**changes)
    assert not schema.is_valid(data)
    assert problems(write(tmp_path, data))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"sigma_percent": 1.0, "voxel_m": 1.0}, "oblique"),
        ({"sigma_percent": 1.0, "voxel_m": 1.0, "grid_orientation": "aligned"}, "aligned"),
        ({"spectrum": "file", "file": "cube.nc"}, "aligned"),
        ({"spectrum": "file", "file": "cube.nc", "grid_orientation": "oblique"}, "oblique"),
    ],
)
def test_a_cube_of_ones_own_stands_upright(given, expected):
    assert Fluctuations.model_validate(given).orientation == expected


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_scene_is_sound_and_says_what_it_is(name):
    plan = pipeline.prepare(name)
    assert plan.variants
    assert len(shipped()[name]) > 20
