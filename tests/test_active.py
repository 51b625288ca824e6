"""The active imager against the numbers that it stands for."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import ACTIVE, MIRROR, facing, lens, run, scene

CLIMATES = {
    (-10, 30): 0.64,
    (20, 44): 5.5,
    (43, 30): 11.6,
    (35, 90): 30.1,
}  # two-way loss over 40 m at 650 GHz, dB


@pytest.mark.parametrize("distance", [40.0, 80.0])
@pytest.mark.parametrize("climate", CLIMATES)
def test_two_way_losses_of_the_four_climates(tmp_path, climate, distance):
    """To 1 %; a mirror, 1 mW, and a range that reaches everything."""
    sensor = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 100.0}
    air = {"temperature_k": 273.15 + climate[0], "relative_humidity_percent": float(climate[1])}
    image = run(tmp_path, facing(distance, sensor=sensor, atmosphere=air)).variants[0].image
    loss = 100.0 - image.values[1, 1]
    assert loss == pytest.approx(CLIMATES[climate] * distance / 40, rel=0.01)


def test_what_dynamic_range_leaves_at_80_m_in_the_wettest_air(tmp_path):
    """80 dB keep a mirror 20 dB over the floor, a reflectivity of 0.2 12.8 dB; 50 dB lose both."""
    air = {"temperature_k": 308.15, "relative_humidity_percent": 90.0}
    for reflectivity, over in ((1.0, 20.0), (0.2, 12.8)):
        wall = MIRROR | {"center_m": [81.0, 0.0, 1.2], "reflectivity": reflectivity}
        for decibels, expected in ((80.0, over), (50.0, 0.0)):
            sensor = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": decibels}
            image = (
                run(tmp_path, facing(80.0, sensor=sensor, atmosphere=air, targets={"wall": wall}))
                .variants[0]
                .image
            )
            assert image.values[1, 1] == pytest.approx(expected, abs=0.25)
            assert image.layers["below_floor"].values[1, 1] == (decibels == 50.0)


def test_monostatic_is_twice_the_one_way_depth_pixel_by_pixel(tmp_path):
    """The logarithm of P is the passive run's depth through the same turbulent air, to 1e-6."""
    passive = run(tmp_path, scene()).variants[0].radiances
    active = run(
        tmp_path,
        scene(sensor={"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 200.0}),
    ).variants[0]
    power = active.image.layers["received_power"].values
    for flag, reflectivity in ((1, 0.1), (2, 0.2)):
        here = passive.target == flag
        log = np.log(power[here] / (1e-3 * reflectivity))
        assert log == pytest.approx(-2 * passive.optical_depth[0][here], rel=1e-6)
    assert np.all(power[passive.target == 0] == 0)


def test_active_sensors_ask_for_no_temperatures(tmp_path):
    data = scene(
        sensor={"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 80.0},
        ground={"reflectivity": 0.1},
    )
    del data["targets"]["box"]["temperature_k"]
    result = run(tmp_path, data)
    assert "radiance" not in result.to_xarray()
    assert {"received_power", "below_floor"} <= set(result.to_xarray())


def test_a_bistatic_source_beside_the_camera_is_nearly_monostatic(tmp_path):
    sensor = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 200.0}
    mono = run(tmp_path, scene(sensor=sensor)).variants[0]
    beside = sensor | {"arrangement": "bistatic", "transmitter_m": [1.0, -2.0, 4.000001]}
    found = run(tmp_path, scene(sensor=beside)).variants[0]
    same = (mono.sight.target == found.sight.target) & (mono.sight.target > 0)
    assert (
        same.sum() > 0.95 * (mono.sight.target > 0).sum()
    )  # at grazing edges a micrometre decides
    assert found.sight.optical_depth[0][same] == pytest.approx(
        mono.sight.optical_depth[0][same], rel=1e-4
    )


def test_what_is_not_lit_sends_nothing_back(tmp_path):
    """The transmitter stands behind the box: its near side and its shadow on the ground are dark.

    The rest is lit. What is dark is still known for what it is, and how far away.
    """
    data = scene(
        camera__pixels=[60, 45],
        sensor=ACTIVE
        | {
            "dynamic_range_db": 200.0,
            "arrangement": "bistatic",
            "transmitter_m": [40.0, 12.0, 6.0],
        },
    )
    found = run(tmp_path, data).variants[0]
    seen = run(tmp_path, scene(camera__pixels=[60, 45])).variants[0].radiances
    camera = lens(data)
    box = oracle.Box((25.0, 7.0, 1.0), (3.0, 4.0, 2.0), 30.0)
    origin, transmitter = np.array([1.0, -2.0, 4.0]), np.array([40.0, 12.0, 6.0])
    lit = np.zeros((45, 60), dtype=bool)
    for row, column in np.ndindex(45, 60):
        if seen.target[row, column] == 0:
            continue
        point = origin + float(seen.path_length[row, column]) * camera.ray(row, column)
        way = point - transmitter
        distance = math.sqrt(way @ way)
        hit = box.meet(transmitter, way / distance)
        lit[row, column] = hit is None or hit[0] > distance * (1 - 1e-6)
    assert (lit == (found.image.layers["received_power"].values > 0)).mean() > 0.999
    assert np.array_equal(found.sight.target, seen.target)
    assert found.sight.path_length == pytest.approx(seen.path_length, rel=1e-6)
    assert lit.any() and (~lit & (seen.target == 1)).any() and (~lit & (seen.target == 2)).any()
    out = np.linalg.norm([25.0 - 40.0, 7.0 - 12.0, 1.0 - 6.0])
    assert abs(np.median(found.sight.outgoing_length[lit & (seen.target == 2)]) - out) < 5


def test_bistatic_depth_is_that_of_both_ways_through_shared_air(tmp_path):
    """The depth out and back is that of two cameras, one at each end, and theirs vary together.

    Each of five seeds takes three runs: bistatic, from the receiver, and from the transmitter. The
    two ways are at most 6 m apart in air whose eddies are larger.
    """
    base = {
        "camera__position_m": [0.0, 0.0, 1.2],
        "camera__look_at_m": [25.0, 0.0, 1.2],
        "camera__pixels": [1, 1],
        "camera__focal_length_mm": 1000.0,
        "ground": None,
        "targets": {"wall": MIRROR | {"center_m": [26.0, 0.0, 1.2]}},
        "numerics": {"precision": "float64", "error_budget": False},
        "atmosphere__fluctuations__voxel_m": 1.0,
    }
    transmitter = [0.0, 6.0, 1.2]
    bistatic = ACTIVE | {"arrangement": "bistatic", "transmitter_m": transmitter}
    both, back, out = (
        np.array(
            [
                run(tmp_path, scene(**(base | way), atmosphere__fluctuations__seed=seed))
                .variants[0]
                .sight.optical_depth.item()
                for seed in range(5)
            ]
        )
        for way in ({"sensor": bistatic}, {}, {"camera__position_m": transmitter})
    )
    assert both == pytest.approx(back + out, rel=1e-9)
    assert np.corrcoef(back, out)[0, 1] > 0.5


def test_lambertian_surfaces_spread_what_they_reflect(tmp_path):
    """P0 R cos A / (pi r^2), for a wall seen squarely and at 60 degrees."""
    sensor = ACTIVE | {"dynamic_range_db": 200.0, "spreading": "lambert", "aperture_m": 0.3}
    air = {"model": "none", "temperature_k": 290.0, "relative_humidity_percent": 0.0}
    for yaw, cosine in ((0.0, 1.0), (60.0, 0.5)):
        wall = MIRROR | {
            "size_m": [1e-3, 40.0, 40.0],
            "center_m": [40.0, 0.0, 1.2],
            "yaw_deg": yaw,
            "reflectivity": 0.5,
        }
        found = run(
            tmp_path, facing(40.0, sensor=sensor, atmosphere=air, targets={"wall": wall})
        ).variants[0]
        power = found.image.layers["received_power"].values[1, 1]
        area = math.pi / 4 * 0.3**2
        assert power == pytest.approx(1e-3 * 0.5 * cosine * area / (math.pi * 40.0**2), rel=1e-3)


def test_speckle_has_the_contrast_of_its_looks(tmp_path):
    sensor = ACTIVE | {"dynamic_range_db": 100.0, "speckle_looks": 4.0}
    found = run(tmp_path, facing(40.0, sensor=sensor, camera__pixels=[200, 200])).variants[0]
    power = found.image.layers["received_power"].values
    assert power.std() / power.mean() == pytest.approx(1 / math.sqrt(4), rel=0.02)
    assert power.mean() == pytest.approx(1e-3 * np.exp(-found.sight.optical_depth.mean()), rel=0.01)
