"""Radiances against closed forms and equation (2), computed by the oracle from the saved field.

Never from the run's depth.
"""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from scenes import lens, run, scene
from test_trace import expected

from thzcl.air import radiometry
from thzcl.turbulence.orientation import ROTATIONS

OF_CONTRAST = 5e-6  # of the unattenuated contrast: float32 depth and shading
HZ = 650e9


def surface_radiance(kelvin, reflectivity, surroundings):
    return (1 - reflectivity) * oracle.planck(HZ, kelvin) + reflectivity * surroundings


@pytest.mark.parametrize("contrast_k", [1e-3, 1.0, 100.0])
@pytest.mark.parametrize("fluctuating", [False, True])
@pytest.mark.parametrize("environment", ["air", "none", 100.0])
def test_contrast_is_attenuated_and_nothing_else(tmp_path, contrast_k, fluctuating, environment):
    """(L_surface - B_air) exp(-tau), tau in float64 with exact MPM93 on the saved field."""
    changes = {} if fluctuating else {"atmosphere__fluctuations__sigma_percent": 0.0}
    data = scene(
        targets__box__temperature_k=290.0 + contrast_k,
        ground__temperature_k=290.0 - contrast_k,
        background__environment=environment,
        output={"save_field": True},
        **changes,
    )
    result = run(tmp_path, data)
    sight = result.variants[0].radiances
    if fluctuating:
        depth, _, target = expected(data, result)
    else:
        assert not result.cubes
        grams = 0.7 * oracle.saturation_hpa(290.0) * 1e5 / (461.525 * 290.0)
        _, length, target = expected(data, result_with_uniform_cube(result, grams))
        depth = oracle.absorption_per_m(HZ, 290.0, 1013.25, grams) * length
    surroundings = {"air": oracle.planck(HZ, 290.0), "none": 0.0}.get(
        environment, oracle.planck(HZ, 100.0)
    )
    air = oracle.planck(HZ, 290.0)
    for flag, kelvin, reflectivity in ((1, 290.0 - contrast_k, 0.1), (2, 290.0 + contrast_k, 0.2)):
        own = (1 - reflectivity) * radiometry.planck_difference(HZ, kelvin, 290.0)
        unattenuated = own + reflectivity * (surroundings - air)
        here = target == flag
        assert here.sum() > 5
        error = sight.contrast[0][here] - unattenuated * np.exp(-depth[here])
        assert np.abs(error).max() < OF_CONTRAST * abs(unattenuated)


def result_with_uniform_cube(result, grams):
    """So that the oracle's geometry can be asked about a run without a field."""
    import dataclasses

    from thzcl.results.contents import Cube
    from thzcl.turbulence.lattice import Lattice

    return dataclasses.replace(
        result, cubes=(Cube(np.full((16, 16, 16), grams), None, Lattice.cubic(16, 0.7)),)
    )


def test_everything_at_one_temperature_is_a_black_body(tmp_path):
    """Contrast exactly 0, whatever the humidity does."""
    data = scene(
        targets__box__temperature_k=290.0,
        ground__temperature_k=290.0,
        background__temperature_k=290.0,
    )
    sight = run(tmp_path, data).variants[0].radiances
    assert np.all(sight.contrast == 0)
    assert sight.brightness_temperature == pytest.approx(290.0, abs=0)


def test_air_that_absorbs_nothing_shows_the_surfaces(tmp_path):
    data = scene(atmosphere__model="none", targets__box__reflectivity=0.0, ground__reflectivity=0.0)
    result = run(tmp_path, data)
    sight = result.variants[0].radiances
    assert np.all(sight.optical_depth == 0)
    for flag, kelvin in ((0, 290.0), (1, 285.0), (2, 300.0)):
        assert sight.brightness_temperature[0][sight.target == flag] == pytest.approx(
            kelvin, abs=1e-4
        )
    assert {"surrogate", "humidity-field", "trace"} <= {item["stage"] for item in result.left_out}


def test_deep_air_is_all_one_sees(tmp_path):
    data = scene(
        sensor__frequency_ghz=556.936,
        atmosphere__relative_humidity_percent=100.0,
        atmosphere__temperature_k=300.0,
    )
    sight = run(tmp_path, data).variants[0].radiances
    assert sight.optical_depth.min() > 15
    assert np.abs(sight.brightness_temperature_contrast).max() < 1e-4


def test_splitting_every_voxel_changes_nothing(tmp_path):
    """The same air in voxels half as large: a subdivision of every segment."""
    from test_trace import write_cube

    cube = np.random.default_rng(1).uniform(4, 16, (16, 16, 16))
    write_cube(tmp_path / "coarse.nc", cube, 1.0)
    write_cube(tmp_path / "fine.nc", cube.repeat(2, 0).repeat(2, 1).repeat(2, 2), 0.5)
    depths = [
        run(
            tmp_path,
            scene(
                atmosphere__fluctuations={"spectrum": "file", "file": f"{name}.nc"},
                numerics={"precision": "float64"},
            ),
        )
        .variants[0]
        .radiances.optical_depth
        for name in ("coarse", "fine")
    ]
    assert depths[0] == pytest.approx(depths[1], rel=1e-11)


def test_several_frequencies_are_each_as_alone(tmp_path):
    together = (
        run(tmp_path, scene(sensor__frequency_ghz=[350.0, 650.0, 850.0])).variants[0].radiances
    )
    for number, ghz in enumerate((350.0, 650.0, 850.0)):
        alone = run(tmp_path, scene(sensor__frequency_ghz=ghz)).variants[0].radiances
        assert together.optical_depth[number] == pytest.approx(alone.optical_depth[0], rel=1e-6)
        assert together.contrast[number] == pytest.approx(alone.contrast[0], rel=2e-6)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("ghz", [650.0, [350.0, 556.936, 650.0]])
def test_fluctuating_temperature_emits_along_the_path(tmp_path, precision, ghz):
    """Equation (2), segment by segment.

    With exact MPM93 and Planck at each voxel's own humidity and temperature.
    """
    data = scene(
        camera__pixels=[6, 5],
        atmosphere__fluctuations__temperature_sigma_k=2.0,
        atmosphere__fluctuations__correlation_tq=-0.5,
        sensor__frequency_ghz=ghz,
        numerics={"precision": precision},
        output={"save_field": True},
    )
    result = run(tmp_path, data)
    sight, cube = result.variants[0].radiances, result.cubes[0]
    camera = lens(data)
    origin, rotation = np.array(data["camera"]["position_m"]), ROTATIONS["oblique"]
    for number, hz in enumerate(sight.frequency_hz):
        for row, column in np.ndindex(5, 6):
            far = float(sight.path_length[row, column])
            ray = origin, camera.ray(row, column), far, cube.voxel_m, rotation
            grams, metres = oracle.path(cube.absolute_humidity_g_m3.astype(float), *ray)
            kelvin, _ = oracle.path(cube.air_temperature_k, *ray)
            k = oracle.absorption_per_m(hz, kelvin, 1013.25, grams)
            t, r = {0: (290.0, 0.0), 1: (285.0, 0.1), 2: (300.0, 0.2)}[
                int(sight.target[row, column])
            ]
            air = oracle.planck(hz, 290.0)
            surface = (1 - r) * oracle.planck(hz, t) + r * air
            source = np.array([oracle.planck(hz, value) for value in kelvin])
            exact = oracle.transfer(k, metres, source, surface)
            # Of the largest difference in play; float64's limit is that of the absorption and
            # Planck polynomials.
            scale = np.abs(source - air).max() + abs(surface - air)
            assert sight.contrast[number, row, column] == pytest.approx(
                exact - air, abs=scale * (3e-6 if precision == "float32" else 1e-9)
            )
            assert sight.optical_depth[number, row, column] == pytest.approx(
                k @ metres, rel=2e-6 if precision == "float32" else 1e-9
            )


def test_figure_6_as_the_paper_describes_it():
    """Upper edges are dark but in (f), base edges vanish in (c) and are bright from (d) on.

    Bars vanish in (c).
    """
    from thzcl import pipeline

    result = pipeline.run("figure6")
    target = result.variants[0].radiances.target
    box = target == 2
    columns = np.nonzero(box.any(axis=0))[0][5:-5]
    top = {c: np.nonzero(box[:, c])[0][0] for c in columns}
    base = {c: np.nonzero(box[:, c])[0][-1] for c in columns}
    bright = {}
    for variant in result.variants:
        kelvin = variant.image.values
        upper = np.mean([kelvin[top[c] + 2, c] - kelvin[top[c] - 2, c] for c in columns])
        # The base of the +x half, which has no bars.
        lower = np.mean(
            [
                kelvin[base[c] - 2, c] - kelvin[base[c] + 2, c]
                for c in columns[len(columns) * 2 // 3 :]
            ]
        )
        row = kelvin[base[columns[20]] - 12, columns[0] : columns[0] + 100]
        bright[variant.name[1]] = upper, lower, np.abs(np.diff(row)).max()
    for panel in "abcde":
        assert bright[panel][0] < -0.2
    assert abs(bright["f"][0]) < 0.2
    assert abs(bright["c"][1]) < 0.15
    for panel in "def":
        assert bright[panel][1] > bright["c"][1] + 0.2
    for panel in "abdef":
        assert bright[panel][2] > 3 * bright["c"][2]
    assert bright["c"][2] < 0.1
