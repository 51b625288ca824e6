"""Mean humidity and temperature by height: check values, what is left out, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import ACTIVE, PLAIN, run, scene, write

from thzcl import pipeline
from thzcl.air import layers, radiometry
from thzcl.errors import FileError, ScenarioError
from thzcl.plan import report
from thzcl.turbulence.orientation import ROTATIONS

HEIGHTS = np.geomspace(0.01, 20, 30)


def surface_layer(scale_k, scale_g_m3, obukhov_m):
    """Departures from 2 m after Businger and Dyer (Businger 1971; Dyer 1974), kappa = 0.4."""

    def stability(height):
        zeta = height / obukhov_m
        if zeta < 0:
            return 2 * math.log((1 + math.sqrt(1 - 16 * zeta)) / 2)
        return -5 * zeta

    psi = np.array([stability(z) - stability(2.0) for z in HEIGHTS])
    shape = (np.log(HEIGHTS / 2) - psi) / 0.4
    return scale_k * shape, scale_g_m3 * shape


def save(path, kelvin, grams, heights=HEIGHTS):
    lines = ["height_m,temperature_k,absolute_humidity_g_m3"]
    rows = np.transpose([heights, kelvin, grams]).tolist()
    lines += [",".join(map(repr, row)) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def slide(kelvin, grams, **more):
    """The slides' camera and box in air without fluctuations."""
    return {
        "camera": {
            "position_m": [0.0, 0.0, 15.0],
            "look_at_m": [50.0, 40.0, 0.3],
            "focal_length_mm": 150.0,
            "focal_plane_mm": [4.0, 2.0],
            "pixels": [16, 8],
        },
        "atmosphere": {"temperature_k": kelvin, "absolute_humidity_g_m3": grams} | more,
        "ground": {"temperature_k": 285.0, "reflectivity": 0.2},
        "targets": {
            "box": {
                "kind": "box",
                "center_m": [50.0, 40.0, 0.3],
                "size_m": [2.0, 1.5, 0.6],
                "temperature_k": 288.0,
                "reflectivity": 0.2,
            }
        },
        "background": {"environment": "none"},
        "sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0},
    }


@pytest.mark.parametrize(
    ("air", "depth_percent", "emission_k"),
    [
        ((-0.5, -0.1, -20.0, 293.15, 7.6), -1.200, -0.483),
        ((0.0, -0.05, math.inf, 293.15, 7.6), -1.985, 0.0),
        ((0.1, 0.01, 20.0, 275.0, 5.6), 0.514, 0.445),
        ((-0.7, -0.2, -15.0, 303.15, 20.0), None, -1.072),
    ],
)
def test_surface_layers_change_depth_and_emission(tmp_path, air, depth_percent, emission_k):
    *scales, kelvin, grams = air
    warmer, moister = surface_layer(*scales)
    save(tmp_path / "air.csv", kelvin + warmer, grams + moister)
    even = run(tmp_path, slide(kelvin, grams)).variants[0].radiances
    result = run(tmp_path, slide(kelvin, grams, profile={"file": "air.csv"}))
    layered = result.variants[0].radiances
    box = even.target == 2
    if depth_percent is not None:
        ratio = layered.optical_depth[0][box].mean() / even.optical_depth[0][box].mean()
        assert 100 * (ratio - 1) == pytest.approx(depth_percent, rel=0.05)
    sent = even.contrast[0] * np.exp(even.optical_depth[0])
    own = layered.contrast[0] - sent * np.exp(-layered.optical_depth[0])
    per_k = radiometry.planck_slope(np.array([650e9]), kelvin)[0]
    assert own[box].mean() / per_k == pytest.approx(emission_k, rel=0.05, abs=0.005)
    assert result.error_budget["total"]["relative"] < 1e-6


def test_a_profile_of_the_mean_air_is_left_out(tmp_path):
    save(tmp_path / "air.csv", np.full(30, 288.0), np.full(30, 9.5))
    flow = {"sigma_percent": 20.0, "voxel_m": 0.7, "grid": 32, "seed": 3}
    due = run(tmp_path, slide(288.0, 9.5, fluctuations=flow))
    seen = run(tmp_path, slide(288.0, 9.5, fluctuations=flow, profile={"file": "air.csv"}))
    assert np.array_equal(*(r.variants[0].radiances.contrast for r in (due, seen)))
    left = {stage["stage"] for stage in seen.left_out}
    assert {"temperature-field", "path-emission"} <= left


def test_a_profile_gives_the_mean_air_that_is_left_out(tmp_path):
    """That of the camera's height, straight in ln z."""
    save(
        tmp_path / "air.csv", np.array([290.0, 280.0]), np.array([8.0, 6.0]), np.array([1.0, 100.0])
    )
    data = slide(0, 0, profile={"file": "air.csv"})
    for name in ("temperature_k", "absolute_humidity_g_m3"):
        del data["atmosphere"][name]
    data["camera"]["position_m"] = [0.0, 0.0, 10.0]
    air = pipeline.prepare(write(tmp_path, data)).variants[0].air
    assert (air.temperature_k, air.absolute_humidity_g_m3) == pytest.approx((285.0, 7.0))
    data["atmosphere"]["relative_humidity_percent"] = 50.0
    air = pipeline.prepare(write(tmp_path, data)).variants[0].air
    assert air.temperature_k == pytest.approx(285.0)
    assert air.relative_humidity_percent == pytest.approx(50.0)


def test_rows_at_the_ground_are_straight_in_height():
    found = layers.between(
        np.array([0.0, 2.0, 20.0]), np.array([-1.0, 0.5, 2.0, 6.0, 30.0]), np.array([1.0, 3.0, 5.0])
    )
    due = [1.0, 1.5, 3.0, 3 + 2 * math.log(3) / math.log(10), 5.0]
    assert found == pytest.approx(due, rel=1e-12)


@pytest.mark.parametrize("warm", [{}, {"temperature_sigma_k": 0.5}], ids=["one", "fluctuating"])
def test_rays_see_cube_and_profile_segment_by_segment(tmp_path, warm):
    """By the oracle's equation (2): (1 + d)(1 + D) - 1 at the middle of each segment."""
    kelvin, grams, (scale_t, scale_q) = 290.0, 10.0, surface_layer(-0.5, -0.1, -20.0)
    save(tmp_path / "air.csv", kelvin + scale_t, grams + scale_q)
    flow = {"sigma_percent": 20.0, "voxel_m": 0.7, "grid": 32, "seed": 3} | warm
    data = slide(kelvin, grams, fluctuations=flow, profile={"file": "air.csv"})
    result = run(tmp_path, data | {"output": {"save_field": True}})
    sight, cube = result.variants[0].radiances, result.cubes[0]
    camera = oracle.Camera((0, 0, 15), (50, 40, 0.3), 150, (4, 2), (16, 8))
    slope, planck = radiometry.planck_slope(np.array([650e9]), kelvin)[0], oracle.planck
    for row, column in ((0, 0), (4, 8), (7, 13)):
        far, ray = float(sight.path_length[row, column]), camera.ray(row, column)
        where = (0.0, 0.0, 15.0), ray, far, 0.7, ROTATIONS["oblique"]
        held, metres = oracle.path(cube.absolute_humidity_g_m3.astype(float), *where)
        own = np.full(len(held), kelvin)
        if warm:
            own = oracle.path(cube.air_temperature_k, *where)[0]
        height = 15 + (np.cumsum(metres) - metres / 2) * ray[2]
        moister, warmer = (
            np.interp(np.log(height), np.log(HEIGHTS), v) for v in (scale_q, scale_t)
        )
        air = held * (1 + moister / grams), own + warmer
        per_m = oracle.absorption_per_m(650e9, air[1], 1013.25, air[0])
        depth = float(np.sum(per_m * metres))
        assert sight.optical_depth[0, row, column] == pytest.approx(depth, rel=2e-5)
        surface = 285.0 if sight.target[row, column] == 1 else 288.0
        source = [planck(650e9, one) for one in air[1]]
        due = oracle.transfer(per_m, metres, source, 0.8 * planck(650e9, surface))
        seen = sight.contrast[0, row, column] + planck(650e9, kelvin)
        assert (seen - due) / slope == pytest.approx(0, abs=2e-4)


def test_an_active_sensor_sees_the_profile_both_ways(tmp_path):
    warmer, moister = surface_layer(-0.5, -0.1, -20.0)
    save(tmp_path / "air.csv", 293.15 + warmer, 7.6 + moister)
    bistatic = ACTIVE | {"arrangement": "bistatic", "transmitter_m": [4.0, 6.0, 3.0]}
    for sensor in (ACTIVE, bistatic):
        data = slide(293.15, 7.6, profile={"file": "air.csv"}) | {"sensor": sensor}
        budget = run(tmp_path, data).error_budget
        assert budget["arithmetic"]["relative"] < 1e-5


def test_the_plan_tells_of_the_profile(tmp_path):
    warmer, moister = surface_layer(-0.5, -0.1, -20.0)
    save(tmp_path / "air.csv", 293.15 + warmer, 7.6 + moister)
    plan = pipeline.prepare(write(tmp_path, slide(293.15, 7.6, profile={"file": "air.csv"})))
    stages = {stage.name: stage for stage in report.stages(plan, figure=False)}
    assert stages["temperature-field"].needed
    assert stages["temperature-field"].reason == "mean temperature changes by height"
    assert not stages["humidity-field"].needed
    assert stages["path-emission"].needed


@pytest.mark.parametrize(
    ("heights", "text"),
    [
        (np.geomspace(0.01, 10, 30), "reach from 0.01 to 10 m, and rays of the scene"),
        (np.geomspace(2.0, 40, 30), "reach from 2 to 40 m, and rays of the scene"),
    ],
)
def test_a_profile_that_does_not_reach_all_rays_is_refused(tmp_path, heights, text):
    save(tmp_path / "air.csv", np.full(30, 288.0), np.linspace(9, 8, 30), heights)
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, slide(288.0, 9.0, profile={"file": "air.csv"})))
    assert text in str(caught.value)
    assert "give rows for all of them" in str(caught.value)


FLOW = PLAIN["atmosphere"]["fluctuations"]


@pytest.mark.parametrize(
    ("flow", "text"),
    [
        (FLOW | {"large_scales": True}, "does not go with fluctuations.large_scales"),
        ({"spectrum": "file", "file": "cube.nc"}, "a cube from a file holds its own mean air"),
    ],
)
def test_profiles_that_do_not_go_with_a_cube_are_refused(tmp_path, flow, text):
    save(tmp_path / "air.csv", np.full(30, 288.0), np.linspace(9, 8, 30))
    data = scene(
        atmosphere=slide(288.0, 9.0, fluctuations=flow, profile={"file": "air.csv"})["atmosphere"]
    )
    with pytest.raises(ScenarioError, match=text):
        pipeline.prepare(write(tmp_path, data))


BAD = {
    "nothing": ("", "no names of columns with two rows"),
    "names": ("height_m,temperature_k\n0,280\n9,280\n", "a.csv:1: no column of humidity"),
    "twice": (
        "height_m,height_km,temperature_k,vapour_pressure_hpa\n0,0,280,5\n9,9,280,5\n",
        "a.csv:1: 2 columns of height; give one of height_m, height_km",
    ),
    "short": (
        "height_m,temperature_k,vapour_pressure_hpa\n0,280\n9,280,5\n",
        "a.csv:2: 2 columns, the first line names 3",
    ),
    "word": (
        "height_m,temperature_k,vapour_pressure_hpa\n# a note\n0,cold,5\n9,280,5\n",
        'a.csv:3: temperature_k: "cold" is no finite number',
    ),
    "order": (
        "height_m,temperature_k,vapour_pressure_hpa\n9,280,5\n0,280,5\n",
        "a.csv:3: heights must ascend; mend the line",
    ),
    "units": (
        "height_m,temperature_degc,vapour_pressure_hpa\n0,280,5\n9,280,5\n",
        "a.csv:2: temperature_degc: must be 100 to 400 K",
    ),
    "negative": (
        "height_m,temperature_k,vapour_pressure_hpa\n0,280,5\n9,280,-5\n",
        "a.csv:3: vapour_pressure_hpa: must not be negative",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_profile_is_refused(tmp_path, case):
    text, due = BAD[case]
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(FileError) as caught:
        layers.read(tmp_path / "a.csv")
    assert due in str(caught.value)


def test_measures_of_humidity_and_units_agree(tmp_path):
    rows = "0,15,{}\n0.02,14,{}\n"
    found = []
    for name, values in (
        ("absolute_humidity_g_m3", (8.0, 7.0)),
        ("vapour_pressure_hpa", (8.0 * 461.525 * 288.15 / 1e5, 7.0 * 461.525 * 287.15 / 1e5)),
    ):
        text = f"height_km,temperature_degc,{name}\n" + rows.format(*values)
        (tmp_path / "a.csv").write_text(text, encoding="utf-8")
        found.append(layers.read(tmp_path / "a.csv"))
    assert found[0].height_m.array.tolist() == [0.0, 20.0]
    assert found[0].temperature_k.array == pytest.approx([288.15, 287.15])
    one, other = (made.absolute_humidity_g_m3.array for made in found)
    assert one == pytest.approx(other, rel=1e-12)
