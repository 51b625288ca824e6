"""Scanning through moving air: frozen flow, exactly."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from scenes import lens, run, scene

from thzcl.turbulence.orientation import ROTATIONS

ACTIVE = {
    "kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 80.0,
    "arrangement": "bistatic", "transmitter_m": [0.0, 5.0, 4.0],
}  # fmt: skip
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": 650.0}


def scan(**parameters):
    timed = {} if "timing" in parameters else {"dwell_s": 0.01}
    return {"kind": "raster-scan", "detector": SPECTRAL} | timed | parameters


def depth(folder, sensor, wind, **changes):
    data = scene(sensor=sensor, atmosphere__fluctuations__wind_m_s=wind, **changes)
    return run(folder, data).variants[0].sight.optical_depth[0]


def test_zero_wind_is_the_snapshot_bit_for_bit(tmp_path):
    snapshot = depth(tmp_path, SPECTRAL, [0.0, 0.0, 0.0])
    for sensor in (scan(), scan(timing="focal-plane", integration_time_s=1.0, samples=3)):
        assert np.array_equal(depth(tmp_path, sensor, [0.0, 0.0, 0.0]), snapshot)
    # And with the motion compiled in, at a wind that is next to nothing.
    still = run(
        tmp_path, scene(sensor=scan(), atmosphere__fluctuations__wind_m_s=[1e-300, 0.0, 0.0])
    )
    assert any("MOTION" in options for options in still.build_options)
    assert np.array_equal(still.variants[0].sight.optical_depth[0], snapshot)


@pytest.mark.parametrize("order", ["rows", "columns"])
@pytest.mark.parametrize("back_and_forth", [False, True])
@pytest.mark.parametrize("orientation", ["oblique", "aligned"])
def test_each_pixel_sees_the_air_of_its_own_time(tmp_path, order, back_and_forth, orientation):
    """A ray taken at time t starts at -U t in the saved cube: against the oracle.

    Pixel by pixel.
    """
    wind = np.array([3.0, -2.0, 0.5])
    data = scene(
        camera__pixels=[6, 5],
        sensor=scan(order=order, back_and_forth=back_and_forth, dwell_s=0.37),
        atmosphere__fluctuations__wind_m_s=wind.tolist(),
        atmosphere__fluctuations__grid_orientation=orientation,
        numerics={"precision": "float64"},
        output={"save_field": True},
    )
    result = run(tmp_path, data)
    sight, cube = result.variants[0].radiances, result.cubes[0]
    camera = lens(data)
    for row, column in np.ndindex(5, 6):
        line, place, along = (row, column, 6) if order == "rows" else (column, row, 5)
        number = line * along + (along - 1 - place if back_and_forth and line % 2 else place)
        start = np.array(data["camera"]["position_m"]) - wind * number * 0.37
        far = float(sight.path_length[row, column])
        grams, metres = oracle.path(
            cube.absolute_humidity_g_m3,
            start,
            camera.ray(row, column),
            far,
            cube.voxel_m,
            ROTATIONS[orientation],
        )
        exact = oracle.absorption_per_m(650e9, 290.0, 1013.25, grams) @ metres
        assert sight.optical_depth[0, row, column] == pytest.approx(exact, rel=1e-10)


def test_reversed_order_and_reversed_wind_is_the_forward_image(tmp_path):
    """The whole scan moves the air by a whole number of periods along a cube's axis (PHYSICS 6)."""
    pixels, period = 16 * 12, 32 * 0.7
    wind = 3 * period / ((pixels - 1) * 0.01)
    changes = {"atmosphere__fluctuations__grid_orientation": "aligned"}
    forward = depth(tmp_path, scan(), [wind, 0.0, 0.0], **changes)
    backward = depth(tmp_path, scan(reverse=True), [-wind, 0.0, 0.0], **changes)
    assert backward == pytest.approx(forward, rel=1e-5)
    other = depth(tmp_path, scan(), [-wind, 0.0, 0.0], **changes)
    assert np.abs(other - forward).max() > 1e-3


def test_a_focal_plane_averages_instants(tmp_path):
    """The mean radiance of snapshots at the middles of equal parts of the integration time."""
    wind = [4.0, 1.0, 0.0]
    sensor = scan(timing="focal-plane", integration_time_s=2.0, samples=4)
    mean = (
        run(tmp_path, scene(sensor=sensor, atmosphere__fluctuations__wind_m_s=wind))
        .variants[0]
        .radiances
    )
    parts = []
    for instant in (0.25, 0.75, 1.25, 1.75):
        # The same air from a camera, ground and box that move against the wind: only the air can
        # tell.
        moved = {
            name: [place - u * instant for place, u in zip(at, wind, strict=True)]
            for name, at in (
                ("camera__position_m", [1.0, -2.0, 4.0]),
                ("camera__look_at_m", [30.0, 8.0, 1.0]),
            )
        }
        data = scene(**moved)
        data["targets"]["box"]["center_m"] = [
            c - u * instant for c, u in zip([25.0, 7.0, 1.0], wind, strict=True)
        ]
        parts.append(run(tmp_path, data).variants[0].radiances.contrast)
    assert mean.contrast == pytest.approx(np.mean(parts, axis=0), rel=1e-4)


def test_it_wraps_any_sensor(tmp_path):
    wind = [3.0, 0.0, 0.0]
    for detector in (
        {"kind": "passive-broadband", "center_ghz": 650.0, "bandwidth_ghz": 50.0},
        ACTIVE,
    ):
        still, moving = (
            run(
                tmp_path,
                scene(
                    sensor=scan(detector=detector, dwell_s=0.1),
                    atmosphere__fluctuations__wind_m_s=u,
                ),
            ).variants[0]
            for u in ([0.0, 0.0, 0.0], wind)
        )
        assert still.image.quantity == moving.image.quantity
        assert not np.array_equal(still.sight.optical_depth, moving.sight.optical_depth)
        assert (
            moving.sight.optical_depth[0, 0, 0] == still.sight.optical_depth[0, 0, 0]
        )  # taken at time 0
