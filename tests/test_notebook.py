"""thzcl in a notebook: scenes as text and tables, results that show themselves."""

from __future__ import annotations

import copy
import doctest
import gc
import weakref
from pathlib import Path

import numpy as np
import pytest
import tomli
from conftest import ROOT

import thzcl
from thzcl import pipeline
from thzcl.errors import FileError, ScenarioError
from thzcl.paths.trace import Paths
from thzcl.results import result as results
from thzcl.scenario import source

QUICK = (ROOT / "scenarios" / "quick.toml").read_text(encoding="utf-8")
FEW = {"camera.pixels": [8, 6], "atmosphere.fluctuations.seed": 3}


@pytest.mark.parametrize("module", [pipeline, source, results])
def test_examples_in_docstrings(tmp_path, monkeypatch, module):
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(module)
    assert (failed, tried > 0) == (0, True)


def test_a_scene_as_tables_or_text_is_that_of_the_file():
    """With numbers and arrays of NumPy among the tables."""
    tables = tomli.loads(QUICK)
    tables["camera"]["pixels"] = np.array([8, 6])
    tables["atmosphere"]["fluctuations"]["seed"] = np.int64(3)
    due = thzcl.run("quick", settings=FEW, figure=False)
    text = thzcl.Scene.from_toml(QUICK, name="mine")
    for found in (thzcl.run(tables, figure=False), thzcl.run(text, settings=FEW, figure=False)):
        assert np.array_equal(found.variants[0].image.values, due.variants[0].image.values)
    assert found.scenario == "mine"


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"camera": {"pixels": object()}}, "scene: object is no value of TOML"),
        ({1: {}}, "scene: a key is no text"),
        ({"camera": {"pixels": [1, 2]}}, r"scene: \[camera\] look_at_m: missing"),
    ],
)
def test_tables_that_are_no_scene_are_refused(tables, message):
    """Without a line number, as there are no lines."""
    with pytest.raises(ScenarioError, match=message):
        thzcl.run(tables)


def test_numbers_and_arrays_of_numpy_paths_and_single_names_are_taken_everywhere(tmp_path):
    """By studies, answers about range and sequences too, of a scene as tables as well."""
    tables = tomli.loads(QUICK)
    few = FEW | {"camera.pixels": np.array([8, 6]), "numerics.error_budget": np.bool_(False)}
    over = {"sensor.frequency_ghz": np.array([340.0, 650.0]), "numerics.noise_seed": range(2)}
    for _ in range(2):  # the second finds the study of the first
        asked = {"settings": few, "over": over, "seed": np.int64(1), "seeds": np.int64(1)}
        found = thzcl.study(tables, tmp_path / "study", **asked)
    assert found.members == found.states["done"] == 4
    pairs = {"camera.focal_length_mm,sensor.frequency_ghz": np.array([[60.0, 340], [70, 650]])}
    places = {"camera.position_m": [np.array([0, 0, 5.0]), np.array([0, 0, 4.0])]}
    found = thzcl.study("quick", tmp_path / "two", settings=few, over=pairs | places, seed=1)
    assert found.states["done"] == 4
    wind = {"atmosphere.fluctuations.wind_m_s": np.array([0, 2, 0])}
    frames = {"sequence": {"rate_hz": np.float32(5), "frames": np.int32(2)}}
    taken = thzcl.sequence(tables, tmp_path / "s.nc", settings=few | wind | frames, figure=False)
    assert taken.frames == 2
    at = {"ranges": np.array([20.0, 30.0]), "frequency_ghz": np.float64(340), "seed": np.int64(1)}
    answer = thzcl.detection_range(
        thzcl.Scene.from_dict(tables), "box", **at, air=np.int64(10), settings=few, folder=tmp_path
    )
    assert answer.question.frequency_ghz == (340.0,)
    with pytest.raises(ScenarioError, match=r"absent\.png"):
        pipeline.prepare("figure8", {"targets.subject.image": Path("absent.png")})


def test_one_variant_may_be_named_alone():
    few = {"camera.pixels": [8, 6], "atmosphere.fluctuations.grid": 16}
    found = pipeline.prepare("figure6", few, "(a) 263 K")
    assert [one.name for one in found.variants] == ["(a) 263 K"]


@pytest.mark.parametrize(
    ("source", "settings", "message"),
    [
        (None, {}, "NoneType is no scene; give a file"),
        (3, {}, "int is no scene; give a file"),
        ("quick", ["a=1"], "settings: must map keys to values"),
        ("quick", {3: 1}, "settings: the key 3 is no text"),
        ("quick", {"sensor.frequency_ghz": 1j}, "complex is no value of TOML"),
    ],
)
def test_what_is_no_scene_and_no_setting_is_refused_in_words(source, settings, message):
    with pytest.raises(ScenarioError, match=message):
        thzcl.run(source, settings=settings)


def test_paths_in_a_scene_of_no_file_start_from_a_folder():
    text = (ROOT / "scenarios" / "figure8.toml").read_text(encoding="utf-8")
    few = {"camera.pixels": [8, 6]}
    there = thzcl.Scene.from_toml(text, folder=ROOT / "scenarios")
    assert pipeline.prepare(there, few).variants
    with pytest.raises(ScenarioError, match="phantom"):
        pipeline.prepare(thzcl.Scene.from_toml(text), few)


def test_what_thzcl_offers():
    assert {"Result", "Scene", "open_device", "run"} <= set(dir(thzcl))


# --- other settings without a new trace -----------------------------------------------------------

SMALL = {"camera.pixels": [16, 12], "numerics.error_budget": False}
BAND = {"kind": "passive-broadband", "center_ghz": 600, "bandwidth_ghz": 40}
SAME_RAYS = {
    "frequency": {"sensor.frequency_ghz": 340},
    "several": {"sensor.frequency_ghz": np.array([340.0, 650.0])},
    "model": {"atmosphere.model": "r24"},
    "models": {"atmosphere.compare": ["r24"]},
    "band": {"sensor": BAND | {"noise_equivalent_power_w_rthz": 1e-12, "frame_rate_hz": 30}},
    "noise": {"numerics.noise_seed": np.int64(5)},
    "warmer": {"targets.box.temperature_k": 310.0},
    "drier": {"atmosphere.relative_humidity_percent": 30},
    "taken away": {"ground": None},
}


@pytest.mark.parametrize("name", SAME_RAYS)
def test_what_leaves_the_rays_is_not_traced_again(device, name):
    first = thzcl.run("quick", settings=SMALL, device=device, figure=False)
    changed = first.with_settings(SAME_RAYS[name], figure=False)
    due = thzcl.run("quick", settings=SMALL | SAME_RAYS[name], device=device, figure=False)
    assert changed.variants[0].image.values == pytest.approx(due.variants[0].image.values, abs=1e-4)
    assert due.voxel_segments > 0
    if name != "taken away":  # other surfaces, other rays
        assert changed.voxel_segments == 0 and "trace" not in changed.seconds
        assert changed.warnings == due.warnings
    assert thzcl.run(source.Scene(changed.scenario_toml), device=device, settings=SMALL).variants


COMPOSED = {
    "scan": ("raster", {}),
    "optics and speckle": ("active-noise", {"atmosphere.fluctuations.grid": 16}),
    "echo of rain": ("rain-active", {}),
    "mesh and mirrors": ("vehicle", {}),
    "temperature": ("quick", {"atmosphere.fluctuations.temperature_sigma_k": 0.5}),
    "float64 and samples": (
        "quick",
        {"numerics.precision": "float64", "camera.samples_per_pixel": 4},
    ),
}


@pytest.mark.parametrize("name", COMPOSED)
def test_other_noise_of_any_scene_is_that_of_a_new_run(device, name):
    scene, changes = COMPOSED[name]
    few = SMALL | {"camera.pixels": [6, 5]} | changes
    other = {"numerics.noise_seed": 7}
    first = thzcl.run(scene, settings=few, device=device, figure=False)
    changed = first.with_settings(other, figure=False)
    due = thzcl.run(scene, settings=few | other, device=device, figure=False)
    for ours, theirs in zip(changed.variants, due.variants, strict=True):
        assert np.array_equal(ours.image.values, theirs.image.values)
    assert changed.voxel_segments == 0


OTHER_RAYS = {
    "air": {"atmosphere.fluctuations.seed": 9},
    "camera": {"camera.focal_length_mm": 90},
    "closer": {"numerics.ray_stride": 1},
    "rain": {"atmosphere.rain.rate_mm_h": 5},  # rays that meet nothing end at its top
}


@pytest.mark.parametrize("name", OTHER_RAYS)
def test_what_changes_rays_or_air_is_traced_again(device, name):
    first = thzcl.run("quick", settings=SMALL | {"numerics.ray_stride": 4}, device=device)
    changed = first.with_settings(OTHER_RAYS[name])
    due = thzcl.run(
        "quick", settings=SMALL | {"numerics.ray_stride": 4} | OTHER_RAYS[name], device=device
    )
    assert changed.voxel_segments == due.voxel_segments > 0
    assert np.array_equal(changed.variants[0].image.values, due.variants[0].image.values)
    why = "the settings change the air, the rays, or what the air sends along them"
    assert changed.warnings == (*due.warnings, f"the air was traced anew: {why}")


def test_rays_that_may_have_ended_in_the_air_are_not_taken_for_clearer_air(device):
    """At 557 GHz nothing is seen through 30 m; what ended there is not what 340 GHz sees."""
    opaque = SMALL | {"sensor.frequency_ghz": 556.9, "numerics.cutoff_depth": 3.0}
    first = thzcl.run("quick", settings=opaque, device=device, figure=False)
    changed = first.with_settings({"sensor.frequency_ghz": 340}, figure=False)
    due = thzcl.run("quick", settings=opaque | {"sensor.frequency_ghz": 340}, device=device)
    assert np.array_equal(changed.variants[0].image.values, due.variants[0].image.values)
    assert changed.voxel_segments == due.voxel_segments
    assert "rays had ended in air that lets less through" in changed.warnings[-1]


def test_rays_that_ended_in_clearer_air_serve_for_air_that_lets_less_through(device):
    """And not the other way round."""
    opaque = SMALL | {"sensor.frequency_ghz": 556.9}
    first = thzcl.run("quick", settings=opaque, device=device, figure=False)
    assert any(v.guarded for v in first.kept.held.values.values() if isinstance(v, Paths))
    denser = {"atmosphere.relative_humidity_percent": 80}
    changed = first.with_settings(denser, figure=False)
    due = thzcl.run("quick", settings=opaque | denser, device=device, figure=False)
    assert due.voxel_segments > 0 == changed.voxel_segments
    assert changed.variants[0].image.values == pytest.approx(due.variants[0].image.values, abs=1e-4)
    drier = due.with_settings({"atmosphere.relative_humidity_percent": 30}, figure=False)
    assert drier.voxel_segments > 0


def test_more_moments_than_were_traced_are_traced_anew(device):
    few = SMALL | {"numerics.moments": 1, "numerics.ray_stride": 1}
    first = thzcl.run("quick", settings=few, device=device, figure=False)
    changed = first.with_settings({"numerics.moments": 3}, figure=False)
    due = thzcl.run("quick", settings=few | {"numerics.moments": 3}, device=device, figure=False)
    assert np.array_equal(changed.variants[0].image.values, due.variants[0].image.values)
    assert "3 moments of the humidity are needed, and 1 were traced" in changed.warnings[-1]
    fewer = changed.with_settings({"numerics.moments": 2}, figure=False)
    assert fewer.voxel_segments == 0


def test_what_results_hold_has_a_limit_and_the_oldest_gives_way(device, monkeypatch):
    """Of all results together; one that gave way traces anew and says so."""
    first = thzcl.run("quick", settings=SMALL, device=device, figure=False)
    assert first.kept.held.size > 0
    monkeypatch.setattr(pipeline, "HELD_SHARE", 0.0)
    none = thzcl.run("quick", settings=SMALL, device=device, figure=False)
    assert none.kept.held.size == first.kept.held.size == 0
    for result in (none, first):
        again = result.with_settings({"sensor.frequency_ghz": 340}, figure=False)
        assert again.voxel_segments > 0
        assert "what was traced before had no room any more" in again.warnings[-1]


def test_a_result_that_is_deleted_holds_nothing(device):
    result = thzcl.run("quick", settings=SMALL, device=device, figure=False)
    held = weakref.ref(result.kept.held)
    other = result.with_settings({"sensor.frequency_ghz": 340}, figure=False)
    del result
    gc.collect()
    assert held() is other.kept.held
    del other
    gc.collect()
    assert held() is None


def test_chosen_variants_averages_and_copies(device):
    """Variants are chosen, averages and copies traced anew, and what is not kept stays nowhere."""
    few = SMALL | {"atmosphere.fluctuations.grid": 16}
    first = thzcl.run("figure6", settings=few, variants=["(a) 263 K"], device=device, figure=False)
    changed = first.with_settings({"sensor.frequency_ghz": 340}, figure=False)
    assert [one.name for one in changed.variants] == ["(a) 263 K"]
    mean = changed.with_settings({"numerics.realizations": 2}, figure=False)
    again = mean.with_settings({}, figure=False)
    assert again.voxel_segments > 0 and "means over realizations" in again.warnings[-1]
    assert mean.with_settings({"numerics.realizations": 1}, figure=False).voxel_segments == 0
    there = copy.deepcopy(first)
    assert there.kept is None and there.with_settings({}, figure=False).voxel_segments > 0
    bare = thzcl.run("quick", settings=SMALL, device=device, figure=False, keep=False)
    assert bare.kept.held is None and bare.with_settings({}, figure=False).voxel_segments > 0
    with pytest.raises(ScenarioError, match="frequency_ghz"):
        first.with_settings({"sensor.frequency_ghz": -1})


# --- results read back ----------------------------------------------------------------------------

STORED = {
    "variants": ("figure6", {}),
    "active": ("figure9", {}),
    "rain": ("rain-active", {}),
    "average": ("quick", {"numerics.realizations": 2, "output.save_field": True}),
    "models": ("slide", {"atmosphere.compare": ["p676-13", "r24"], "output.model_spread": True}),
    "band": ("concealed", {}),
    "frequencies": ("quick", {"sensor.frequency_ghz": [340, 650]}),
}


@pytest.mark.parametrize("name", STORED)
def test_a_result_comes_back_from_its_file(device, tmp_path, name):
    """Written again it is the same but for the rounding of sums, and its picture is the same."""
    scene, changes = STORED[name]
    first = thzcl.run(scene, settings=SMALL | changes, device=device)
    found = thzcl.Result.load(first.save(tmp_path / "a.nc"))
    one, other = first.to_xarray(), found.to_xarray()
    assert set(one.variables) == set(other.variables)
    for variable in one.variables:
        ours, theirs = one[variable], other[variable]
        assert ours.attrs.keys() == theirs.attrs.keys() and ours.dims == theirs.dims
        if ours.dtype.kind == "f":
            rounded = 4e-5 if variable == "brightness_temperature" else 0
            np.testing.assert_allclose(theirs, ours.values.astype(ours.dtype), 0, rounded)
        else:
            assert np.array_equal(ours, theirs)
    alike = one.attrs.keys() - {"summary"}
    assert {key: str(one.attrs[key]) for key in alike} == {k: str(other.attrs[k]) for k in alike}
    assert found.plot().get_suptitle() == first.plot().get_suptitle()
    assert [v["targets"].keys() for v in found.summary()["variants"]] == [
        v["targets"].keys() for v in first.summary()["variants"]
    ]
    assert found.with_settings({"numerics.noise_seed": 3}).variants


def test_files_that_hold_no_result_are_refused(tmp_path):
    import h5netcdf

    with h5netcdf.File(tmp_path / "a.nc", "w") as file:
        file.attrs["title"] = "else"
    with pytest.raises(FileError, match="holds no whole result"):
        thzcl.Result.load(tmp_path / "a.nc")
    thzcl.sequence(
        "quick",
        tmp_path / "s.nc",
        settings=SMALL
        | {
            "atmosphere.fluctuations.wind_m_s": [0, 2, 0],
            "sequence.rate_hz": 5,
            "sequence.frames": 2,
        },
        figure=False,
    )
    with pytest.raises(FileError, match="frames of a sequence; open it with xarray"):
        thzcl.Result.load(tmp_path / "s.nc")


def test_a_result_shows_itself(device):
    result = thzcl.run("quick", settings=SMALL, device=device)
    assert repr(result) == "<thzcl.Result of quick: 1 image of 16 x 12 pixels>"
    assert "data:image/png;base64," in result._repr_html_()
    assert result._repr_png_().startswith(b"\x89PNG") and "<table>" in result._repr_html_()
