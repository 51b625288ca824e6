"""Traced depths, lengths and surfaces against the oracle, ray by ray.

On the field that the run itself saved.
"""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from scenes import lens, run, scene

from thzcl.paths import shade, trace
from thzcl.surfaces.ends import Facing
from thzcl.surfaces.radiance import Table
from thzcl.turbulence.orientation import ROTATIONS

# Of the image's largest depth: what float32 leaves along some hundred voxels, and float64.
RMS = {"float32": 5e-7, "float64": 1e-11}
WORST = {"float32": 1e-5, "float64": 1e-11}


def expected(data, result):
    """Depth, length, target and air radiance contrast of every pixel of a scene, by the oracle."""
    camera, atmosphere = data["camera"], data["atmosphere"]
    seen = lens(data)
    boxes = [
        oracle.Box(b["center_m"], b["size_m"], b.get("yaw_deg", 0))
        for b in data.get("targets", {}).values()
    ]
    width, height = camera["pixels"]
    depth, length, target = (
        np.zeros((height, width)),
        np.zeros((height, width)),
        np.zeros((height, width), int),
    )
    cube = result.cubes[0]
    rotation = ROTATIONS[atmosphere["fluctuations"].get("grid_orientation", "oblique")]
    origin = np.array(camera["position_m"], float)
    grams, hz = cube.absolute_humidity_g_m3.astype(float), data["sensor"]["frequency_ghz"] * 1e9
    absorption = oracle.absorption_per_m(hz, atmosphere["temperature_k"], 1013.25, grams)
    for row, column in np.ndindex(height, width):
        direction = seen.ray(row, column)
        far, what = data["background"]["max_range_m"], 0
        if "ground" in data and direction[2] < 0 and -origin[2] / direction[2] < far:
            far, what = -origin[2] / direction[2], 1
        for number, box in enumerate(boxes):
            hit = box.meet(origin, direction)
            if hit and hit[0] < far:
                far, what = hit[0], number + 2
        k, metres = oracle.path(absorption, origin, direction, far, cube.voxel_m, rotation)
        depth[row, column], length[row, column], target[row, column] = (
            k @ metres,
            metres.sum(),
            what,
        )
    return depth, length, target


def compare(data, result, precision):
    depth, length, target = expected(data, result)
    sight = result.variants[0].radiances
    assert np.array_equal(sight.target, target)
    assert sight.path_length == pytest.approx(length, rel=1e-6 if precision == "float32" else 1e-12)
    error = (sight.optical_depth[0] - depth) / depth.max()
    assert np.sqrt(np.mean(error**2)) < RMS[precision]
    assert np.abs(error).max() < WORST[precision]


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("orientation", ["oblique", "aligned"])
def test_random_poses(tmp_path, precision, orientation):
    rng = np.random.default_rng(11)
    for _ in range(20):
        data = scene(
            camera__position_m=[*rng.uniform(-40, 40, 2), rng.uniform(1, 30)],
            camera__look_at_m=[*rng.uniform(-40, 40, 2), rng.uniform(-5, 40)],
            camera__focal_length_mm=rng.uniform(6, 60),
            atmosphere__fluctuations__grid_orientation=orientation,
            targets__box__center_m=[*rng.uniform(-30, 30, 2), 3.0],
            targets__other={
                "kind": "box",
                "center_m": [*rng.uniform(-30, 30, 2), 8.0],
                "size_m": [9.0, 5.0, 6.0],
                "temperature_k": 280.0,
            },
            numerics={"precision": precision},
            output={"save_field": True},
        )
        compare(data, run(tmp_path, data), precision)


AWKWARD = {
    "along x, on voxel corners": ([2.8, 1.4, 2.1], [9.8, 1.4, 2.1], (0, 0, 1)),
    "along -x, on voxel corners": ([2.8, 1.4, 2.1], [-9.8, 1.4, 2.1], (0, 0, 1)),
    "along y, inside a voxel": ([2.9, 1.5, 2.2], [2.9, 9.5, 2.2], (0, 0, 1)),
    "along -y, in a face": ([2.9, 1.4, 2.2], [2.9, -9.5, 2.2], (0, 0, 1)),
    "level diagonal through edges": ([2.8, 1.4, 2.45], [9.8, 8.4, 2.45], (0, 0, 1)),
    "space diagonal through corners": ([0.7, 0.7, 0.7], [7.7, 7.7, 7.7], (0, 0, 1)),
    "straight up": ([3.0, 2.0, 1.0], [3.0, 2.0, 9.0], (0, 1, 0)),
    "straight down": ([3.0, 2.0, 30.0], [3.0, 2.0, 0.0], (0, 1, 0)),
    "from inside the box": ([25.0, 7.0, 1.0], [30.0, 9.0, 1.2], (0, 0, 1)),
}


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("orientation", ["oblique", "aligned"])
@pytest.mark.parametrize("view", AWKWARD)
def test_awkward_rays(tmp_path, view, orientation, precision):
    position, look_at, up = AWKWARD[view]
    data = scene(
        camera__position_m=position,
        camera__look_at_m=look_at,
        camera__up=list(up),
        camera__pixels=[9, 7],  # odd: the central ray runs exactly along the line of sight
        atmosphere__fluctuations__voxel_m=0.5 if "diagonal" in view or "face" in view else 0.7,
        atmosphere__fluctuations__grid_orientation=orientation,
        numerics={"precision": precision},
        output={"save_field": True},
    )
    compare(data, run(tmp_path, data), precision)


def test_a_voxel_spans_from_its_index_up(tmp_path):
    """Aligned: voxel [iz, iy, ix] spans [i h, (i + 1) h) from the world's origin, periodically.

    Whichever way a ray runs.
    """
    n, h = 16, 0.5
    rng = np.random.default_rng(5)
    cube = rng.uniform(5.0, 15.0, (n, n, n))
    write_cube(tmp_path / "cube.nc", cube, h)
    # In the face y = 1.0 between voxels 1 and 2, and in the edge y = 1.0, z = 2.5 between 4 and 5.
    for z, iz in ((2.3, 4), (2.5, 5)):
        for ahead in (1, -1):
            data = scene(
                camera__position_m=[0.25, 1.0, z],
                camera__look_at_m=[0.25 + ahead, 1.0, z],
                camera__pixels=[1, 1],
                atmosphere__fluctuations={
                    "spectrum": "file",
                    "file": "cube.nc",
                    "grid_orientation": "aligned",
                },
                targets={},
                ground=None,
                background__max_range_m=3.0,
                numerics={"precision": "float64"},
            )
            depth = run(tmp_path, data).variants[0].radiances.optical_depth.item()
            xs = [int(np.floor((0.25 + ahead * s) / h)) % n for s in np.arange(0.0005, 3.0, 0.001)]
            k = oracle.absorption_per_m(650e9, 290.0, 1013.25, cube[iz, 2, xs])
            assert depth == pytest.approx(k.mean() * 3.0, rel=1e-9)


def write_cube(path, humidity, voxel_m, **more):
    import h5netcdf

    with h5netcdf.File(path, "w") as file:
        file.dimensions = dict(zip("zyx", humidity.shape, strict=True))
        file.create_variable("absolute_humidity", ("z", "y", "x"), data=humidity).attrs[
            "voxel_m"
        ] = voxel_m
        for name, values in more.items():
            file.create_variable(name, ("z", "y", "x"), data=values)


def test_segments_are_voxels_crossed_over_positive_length(tmp_path):
    data = scene(camera__pixels=[20, 15])
    result = run(tmp_path, data)
    sight, total = result.variants[0].radiances, 0
    camera = lens(data)
    for row, column in np.ndindex(15, 20):
        o = ROTATIONS["oblique"] @ np.array(data["camera"]["position_m"]) / 0.7
        length = float(sight.path_length[row, column]) / 0.7
        _, lengths = oracle.segments(o, ROTATIONS["oblique"] @ camera.ray(row, column), length, 32)
        total += int((lengths > 1e-6).sum())
    assert result.voxel_segments == pytest.approx(
        total, abs=3
    )  # a path length rounds across a face now and then


def test_stripes_are_counted_from_the_left(tmp_path):
    """Every face, seen from outside: the first, third, ...

    Stripe from the left has the bars' temperature.
    """
    views = {
        "-x": [-6, 0, 1.5],
        "+x": [6, 0, 1.5],
        "-y": [0, -6, 1.5],
        "+y": [0, 6, 1.5],
        "+z": [0, -0.5, 9],
        "-z": [0, 0.5, -6],
    }
    for face, position in views.items():
        data = scene(
            camera__position_m=position,
            camera__look_at_m=[0, 0, 0],
            camera__pixels=[41, 31],
            targets__box={
                "kind": "box",
                "center_m": [0, 0, 0],
                "size_m": [2.0, 2.5, 1.5],
                "yaw_deg": 0,
                "temperature_k": 300.0,
                "bars": {"face": face, "count": 5, "temperature_k": 250.0},
            },
            ground=None,
            atmosphere__fluctuations=None,
            atmosphere__model="none",
        )  # fmt: skip
        seen = run(tmp_path, data).variants[0].radiances.brightness_temperature[0]
        camera = lens(data)
        box = oracle.Box((0, 0, 0), (2.0, 2.5, 1.5))
        axis, sign = "xyz".index(face[1]), 1 if face[0] == "+" else -1
        checked = 0
        for row, column in np.ndindex(31, 41):
            hit = box.meet(np.array(position, float), camera.ray(row, column))
            kelvin = 290.0
            if hit:
                on_face = hit[1] == axis and hit[2] == sign
                striped = on_face and oracle.stripe(box, hit, 5) % 2 == 0
                kelvin = 250.0 if striped else 300.0
                checked += on_face
            assert seen[row, column] == pytest.approx(kelvin, abs=1e-3), (face, row, column)
        assert checked > 50


def test_samples_average_radiance_over_each_pixel(tmp_path):
    """A pixel of n samples is the mean over a finer raster of the same camera."""
    data = scene(camera__pixels=[8, 6], camera__samples_per_pixel=6)
    coarse = run(tmp_path, data).variants[0].radiances
    fine = run(tmp_path, scene(camera__pixels=[24, 12])).variants[0].radiances
    blocks = fine.contrast[0].reshape(6, 2, 8, 3).mean(axis=(1, 3))
    assert coarse.contrast[0] == pytest.approx(blocks, rel=1e-6)
    assert coarse.target.shape == (6, 8)


def test_row_zero_is_the_top_and_column_zero_the_left(tmp_path):
    """Looking along +x with z up, y increases to the left.

    A box up and to the left is in the first quadrant of the array.
    """
    box = {
        "kind": "box",
        "center_m": [20.0, 4.0, 8.0],
        "size_m": [1.0, 1.0, 1.0],
        "temperature_k": 300.0,
    }
    data = scene(
        camera__position_m=[0.0, 0.0, 5.0], camera__look_at_m=[20.0, 0.0, 5.0], targets={"box": box}
    )
    target = run(tmp_path, data).variants[0].radiances.target
    rows, columns = np.nonzero(target == 2)
    assert rows.max() < 6 and columns.max() < 8


def test_the_cut_off_ends_rays_and_changes_nothing_else(tmp_path):
    """A ray past the cut-off keeps its depth so far, and length and target of what stands there.

    The others are as without it.
    """
    deep = scene(
        atmosphere__relative_humidity_percent=100.0,
        sensor__frequency_ghz=556.936,
        ground=None,
        targets={},
    )
    far = scene(
        numerics={"cutoff_depth": 1e9}, sensor__frequency_ghz=556.936, ground=None, targets={}
    )
    far["atmosphere"] = deep["atmosphere"]
    cut = run(tmp_path, deep)
    whole = run(tmp_path, far).variants[0].radiances
    sight = cut.variants[0].radiances
    assert any("CUTOFF" in options for options in cut.build_options)
    assert np.array_equal(sight.target, whole.target)
    assert np.array_equal(sight.path_length, whole.path_length)
    assert np.all(sight.optical_depth < whole.optical_depth)
    assert np.all(sight.optical_depth >= 16)
    assert np.all(
        sight.optical_depth < 16 + 17 * 0.7 * np.sqrt(3) * 2.5 * whole.optical_depth.max() / 90
    )
    assert (
        np.abs(sight.contrast - whole.contrast).max() == 0
    )  # isothermal, background at air temperature
    shallow = run(tmp_path, scene()).variants[0].radiances
    guarded = (
        run(tmp_path, scene(numerics={"cutoff_depth": shallow.optical_depth.max() * 0.6}))
        .variants[0]
        .radiances
    )
    kept = guarded.optical_depth[0] == shallow.optical_depth[0]
    assert 0 < kept.sum() < kept.size
    assert np.array_equal(guarded.contrast[0][kept], shallow.contrast[0][kept])
    assert np.all(guarded.contrast[0][~kept] == 0)
    assert np.any(shallow.contrast[0][~kept] != 0)
    assert np.array_equal(guarded.target, shallow.target)
    assert np.array_equal(guarded.path_length, shallow.path_length)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_bands_far_apart_do_not_disturb_each_other(device, precision):
    """One lets everything pass, the other nothing: what is no part of a band.

    However deep or thin, is worth nothing in it.
    """
    rays = 128
    length = device.put(np.linspace(1, 2000, rays), precision)
    surface, single = device.put(np.zeros(rays, np.int32)), device.empty((1,), precision)
    none, facing = (
        device.empty((0, rays), precision),
        Facing(*5 * [single], device.empty((1,), np.int32), single),
    )
    paths = trace.Paths(length, surface, facing, none, np.zeros(rays, bool))
    coefficients, each, ones = np.array([[1e-4], [1.0]]), np.eye(2), Table(np.ones((1, 2)), None)
    shaded = shade.shade_bands(device, paths, coefficients, ones, each, each, precision)
    depth = coefficients * length.host()
    assert np.allclose(shaded.depth.host(), depth, rtol=1e-6, atol=0)
    assert np.allclose(shaded.contrast.host(), np.exp(-depth), rtol=1e-5, atol=1e-30)
