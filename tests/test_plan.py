"""Plans: what is shared, what is left out, and whether the figures hold."""

from __future__ import annotations

import json

import h5py
import numpy as np
import oracle
import pytest
from scenes import run, scene, write

from thzcl import pipeline
from thzcl.air.refraction import estimate
from thzcl.paths.specs import TraceSpec
from thzcl.plan import report as overview


def plan(folder, data):
    return pipeline.prepare(write(folder, data))


def variants(**changes):
    return [{"name": name, "set": {key: value}} for name, (key, value) in changes.items()]


def traces(found):
    """Returns the paths of a plan that are traced."""
    return [spec for spec in found.specs() if isinstance(spec, TraceSpec)]


def test_six_panels_cost_one_field_and_one_trace():
    assert len(traces(pipeline.prepare("figure6"))) == 1
    reasons = {stage.name: stage.reason for stage in overview.stages(pipeline.prepare("figure6"))}
    assert reasons["humidity-field"] == "1 cube for 6 images"
    assert reasons["trace"].startswith("1 trace of")


def test_climates_share_the_field_and_the_trace(tmp_path):
    """Relative fluctuations know no climate, and path moments know neither frequency nor air."""
    data = scene(
        variants=variants(
            a=("atmosphere.temperature_k", 260.0), b=("atmosphere.relative_humidity_percent", 30.0)
        )
    )
    assert len(traces(plan(tmp_path, data))) == 1
    together = run(tmp_path, data)
    for number, (key, value) in enumerate(
        (("atmosphere.temperature_k", 260.0), ("atmosphere.relative_humidity_percent", 30.0))
    ):
        alone = run(tmp_path, scene(), settings={key: value}).variants[0].radiances
        assert together.variants[number].radiances.optical_depth == pytest.approx(
            alone.optical_depth, rel=1e-6
        )


@pytest.mark.parametrize(
    ("key", "value", "count"),
    [
        ("targets.box.temperature_k", 250.0, 1),
        ("sensor.frequency_ghz", 350.0, 1),
        ("targets.box.center_m", [20.0, 7.0, 1.0], 2),
        ("atmosphere.fluctuations.seed", 4, 2),
        ("atmosphere.fluctuations.grid_orientation", "aligned", 2),
        ("numerics.precision", "float64", 2),
    ],
)
def test_what_a_change_reaches(tmp_path, key, value, count):
    found = plan(
        tmp_path, scene(variants=variants(a=("targets.box.reflectivity", 0.2), b=(key, value)))
    )
    assert len(traces(found)) == count


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera__look_at_m": [30.0, 8.0, 30.0]},
        {
            "atmosphere__fluctuations__temperature_sigma_k": 1.0,
            "sensor__frequency_ghz": [300.0 + 20 * n for n in range(10)],
        },
        {"sensor__frequency_ghz": 556.936, "ground": None, "targets": {}},
        {"camera__samples_per_pixel": 4},
    ],
)
def test_voxels_are_counted_within_ten_per_cent(tmp_path, changes):
    data = scene(camera__pixels=[48, 36], **changes)
    assert overview.voxel_segments(plan(tmp_path, data)) == pytest.approx(
        run(tmp_path, data).voxel_segments, rel=0.1
    )


def test_what_a_scene_does_not_have_is_not_compiled_in(tmp_path):
    options = " ".join(run(tmp_path, scene(ground=None, targets={})).build_options)
    assert "GROUND" not in options
    assert "BOXES" not in options
    assert "CUTOFF" not in options
    assert "emission" not in options
    full = " ".join(
        run(tmp_path, scene(atmosphere__fluctuations__temperature_sigma_k=1.0)).build_options
    )
    assert "GROUND" in full and "BOXES" in full and "emission" in full


def test_uniform_air_needs_no_field_and_no_trace(tmp_path):
    result = run(tmp_path, scene(atmosphere__fluctuations=None))
    assert not any("field" in options or "march" in options for options in result.build_options)
    assert result.voxel_segments == 0
    assert not {"humidity-field", "trace"} & set(result.seconds)


def test_the_bound_of_the_plan_holds_in_the_run(tmp_path):
    for sigma in (20.0, 60.0):
        data = scene(atmosphere__fluctuations__sigma_percent=sigma)
        bound = overview.expansion_error(plan(tmp_path, data))
        assert 0 < run(tmp_path, data).error_budget["absorption-fit"]["max"] <= bound <= 1e-7


def test_warnings_where_a_user_should_think_twice(tmp_path):
    def said(**changes):
        found = plan(tmp_path, scene(**changes))
        return " ".join(overview.warnings(found, overview.planned_errors(found)))

    assert "periods of the 22.4 m cube" in said()
    assert said(atmosphere__fluctuations__grid=256) == ""
    assert "stated to 1000 GHz" in said(sensor__frequency_ghz=1200.0)
    assert "of saturation" in said(atmosphere__relative_humidity_percent=120.0)


def test_variants_stand_in_one_file_or_are_refused(tmp_path):
    from thzcl.errors import ScenarioError

    with pytest.raises(ScenarioError, match="must have the same pixels"):
        plan(
            tmp_path,
            scene(variants=variants(a=("camera.pixels", [8, 8]), b=("camera.pixels", [9, 9]))),
        )


def test_refraction_that_is_left_out_is_estimated(tmp_path):
    """PHYSICS section 6: 0.03 dB go with 7 microradians at 650 GHz and 100 m.

    Both grow with the root of C_n^2.
    """
    found = estimate(1.13e-13, 650e9, 100.0, 0.3)
    assert found.tilt_urad == pytest.approx(7.0, rel=0.02)
    assert found.scintillation_db == pytest.approx(0.03, rel=0.1)
    assert estimate(4.52e-13, 650e9, 100.0, 0.3).scintillation_db == pytest.approx(
        2 * found.scintillation_db
    )
    told = overview.as_json(pipeline.prepare(write(tmp_path, scene())))["refraction_left_out"]
    assert told["path_m"] == pytest.approx(25.0, rel=0.03)  # the box, not the background
    assert told["scintillation_db"] > 0
    even = overview.as_json(pipeline.prepare(write(tmp_path, scene(atmosphere__fluctuations=None))))
    assert even["refraction_left_out"] is None


@pytest.mark.parametrize(
    ("name", "constant"), [("quick", 1.428), ("figure6", 0.26), ("slide", 1.6)]
)
def test_what_fluctuates_is_told_whichever_was_given(name, constant):
    """C_q^2 of shipped scenes, of which sigma is given; and back."""
    told = overview.as_json(pipeline.prepare(name))["air"]
    assert told["structure_constant_q"] == pytest.approx(constant, rel=0.02)
    assert told["sigma_percent"] == 20.0
    changes = {
        "atmosphere.fluctuations.sigma_percent": None,
        "atmosphere.fluctuations.structure_constant_q": told["structure_constant_q"],
    }
    assert overview.as_json(pipeline.prepare(name, changes))["air"] == pytest.approx(told)


def test_a_cube_stands_for_an_outer_scale(tmp_path):
    """That of von Karman's air of the same variance, by its integral over wave numbers."""
    told = overview.as_json(pipeline.prepare(write(tmp_path, scene())))["air"]
    k0, k = 2 * np.pi / told["outer_scale_m"], np.logspace(-6, 4, 200_001)
    density = 0.0330054 * told["structure_constant_q"] * (k**2 + k0**2) ** (-11 / 6)
    variance = np.trapezoid(4 * np.pi * k**2 * density, k)
    grams = 0.70 * oracle.saturation_hpa(290.0) * 100 / 461.525 / 290.0 * 1e3
    assert np.sqrt(variance) == pytest.approx(0.2 * grams, rel=2e-3)
    karman = {"spectrum": "von-karman", "outer_scale_m": 7.0}
    own = scene()
    own["atmosphere"]["fluctuations"] |= karman
    assert overview.as_json(pipeline.prepare(write(tmp_path, own)))["air"]["outer_scale_m"] == 7.0


def test_a_result_tells_how_its_air_fluctuates(tmp_path, thzcl_command):
    found = run(tmp_path, scene())
    told = overview.as_json(pipeline.prepare(write(tmp_path, scene())))["air"]
    assert found.summary()["air"] == told
    path = found.save(tmp_path / "one.nc")
    with h5py.File(path) as file:
        assert json.loads(file.attrs["air"]) == [{"variant": "scene", **told}]
    assert "C_q^2" in thzcl_command("plan", "quick").stdout
    even = run(tmp_path, scene(atmosphere__fluctuations=None)).summary()["air"]
    assert even == {"structure_constant_q": 0.0, "sigma_percent": 0.0, "outer_scale_m": None}
