"""Cubes of one's own air: read right, or refused with a remedy."""

from __future__ import annotations

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path

import h5netcdf
import h5py
import numpy as np
import oracle
import pytest
from scenes import ACTIVE, run, scene, write

from thzcl import pipeline
from thzcl.air.humidity import absolute_humidity
from thzcl.errors import FileError, ScenarioError
from thzcl.scenario.atmosphere import Atmosphere, Fluctuations
from thzcl.turbulence import cube_file
from thzcl.turbulence.cube_file import Asked
from thzcl.turbulence.lattice import Lattice

N, EDGE = 16, 0.5
AIR = 10 + np.random.default_rng(0).random((N, N, N))
WARMTH = 290 + np.random.default_rng(1).random((N, N, N))


def layers():
    """Returns humidity that falls with height alone, g/m3, (z, y, x)."""
    height = (np.arange(N) + 0.5) * EDGE
    return np.broadcast_to((12 * np.exp(-height / 4))[:, None, None], (N, N, N)).copy()


def save(
    path, values=AIR, dims=tuple("zyx"), units="g m-3", voxel_m=EDGE, temperature=None, **attributes
):
    """Writes a cube as an LES would; dimensions have no coordinates."""
    with h5netcdf.File(path, "w") as file:
        file.dimensions = dict(zip(dims, values.shape, strict=True))
        for name, data in (("absolute_humidity", values), ("air_temperature", temperature)):
            if data is not None:
                file.create_variable(name, dims, data.dtype, data=data)
    with h5py.File(path, "a") as file:
        told = {"units": units, "voxel_m": voxel_m} | attributes
        file["absolute_humidity"].attrs.update({k: v for k, v in told.items() if v is not None})
        if temperature is not None:
            file["air_temperature"].attrs["units"] = "K"
    return path


def coordinates(path, **axes):
    """Gives dimensions of a saved cube coordinates: (values, attributes) by name."""
    with h5py.File(path, "a") as file:
        for name, (values, attributes) in axes.items():
            file[name].attrs["NAME"] = name
            file[name][...] = values
            file[name].attrs.update(attributes)
    return path


def refuses(path, *texts, voxel_m=None):
    with pytest.raises(FileError) as caught:
        cube_file.inspect(path, Asked(voxel_m))
    assert str(caught.value).startswith(f"{path}: ")
    for text in texts:
        assert text in str(caught.value)


# --- what a plan learns ---------------------------------------------------------------------------


def test_a_cube_is_inspected(tmp_path):
    path = save(tmp_path / "a.nc", temperature=WARMTH)
    found = cube_file.inspect(path)
    assert (found.path, found.lattice, found.notes) == (path, Lattice.cubic(N, EDGE), ())
    assert found.mean_g_m3 == pytest.approx(AIR.mean(), rel=1e-12)
    assert found.humidity_span_g_m3 == (AIR.min(), AIR.max())
    assert found.temperature_span_k == (WARMTH.min(), WARMTH.max())
    assert found.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert pickle.loads(pickle.dumps(found)) == found
    assert hash(found) == hash(replace(found))
    humidity, temperature = cube_file.read(path)
    assert np.array_equal(humidity, AIR)
    assert np.array_equal(temperature, WARMTH)


def test_cubes_are_equal_by_their_bytes(tmp_path):
    """Another value in a voxel that changes neither mean nor spans makes another cube."""
    swapped = AIR.copy()
    swapped[0, 0, 1:3] = AIR[0, 0, 2:0:-1]
    path = tmp_path / "a.nc"
    one = cube_file.inspect(save(path))
    other = cube_file.inspect(save(path, swapped))
    assert one != other
    assert replace(one, digest="", mean_g_m3=0) == replace(other, digest="", mean_g_m3=0)
    assert cube_file.inspect(save(path)) == one


# --- the edge of a voxel --------------------------------------------------------------------------


@pytest.mark.parametrize("voxel_m", [-1.0, np.inf, 0.0, np.nan, 1e-300, 1e6])
def test_an_edge_beyond_the_keys_limits_is_refused(tmp_path, voxel_m):
    refuses(save(tmp_path / "a.nc", voxel_m=voxel_m), "voxel_m")
    refuses(save(tmp_path / "a.nc", voxel_m=voxel_m), "voxel_m", voxel_m=EDGE)


@pytest.mark.parametrize("voxel_m", ["half a metre", [0.5, 0.5], h5py.Empty("f4")])
def test_an_edge_that_is_no_number_is_refused(tmp_path, voxel_m):
    refuses(save(tmp_path / "a.nc", voxel_m=voxel_m), "its attribute voxel_m is")


def test_limits_are_those_of_the_keys():
    def limits(model, key):
        schema = model.model_json_schema()["properties"][key]
        number = schema.get("anyOf", [schema])[0]
        return number["minimum"], number["maximum"]

    assert limits(Fluctuations, "voxel_m") == cube_file.VOXEL_M
    assert limits(Fluctuations, "grid") == (16, round(cube_file.MOST_VOXELS ** (1 / 3)))
    kelvins = cube_file.TEMPERATURE.least, cube_file.TEMPERATURE.most
    assert limits(Atmosphere, "temperature_k") == kelvins
    pressure = Atmosphere.model_json_schema()["properties"]["pressure_hpa"]["maximum"]
    most = float(absolute_humidity(pressure, kelvins[0]))
    assert most == pytest.approx(cube_file.HUMIDITY.most, rel=1e-3)


def test_scene_attribute_and_coordinates_agree_on_the_edge(tmp_path):
    steps = {"z": (np.arange(N) * 0.25, {"units": "m"})}
    path = save(tmp_path / "a.nc", voxel_m=None)
    refuses(path, "does not say how large its voxels are; give voxel_m in [atmosphere.fl")
    assert cube_file.inspect(path, Asked(2.0)).lattice.voxel_m[0] == 2.0
    assert cube_file.inspect(coordinates(path, **steps)).lattice.voxel_m[0] == 0.25
    refuses(path, "steps of 0.25 m, but the edge of its voxels is 2 m", voxel_m=2.0)
    path = save(tmp_path / "a.nc")
    assert cube_file.inspect(path, Asked(EDGE)).lattice.voxel_m[0] == EDGE
    refuses(path, "its voxels are 0.5 m, but voxel_m says 0.6 m; remove voxel_m", voxel_m=0.6)


# --- cubes that are none --------------------------------------------------------------------------

NONE = {
    "nothing": lambda file: file.__setitem__("q", AIR),
    "string": lambda file: file.create_dataset("absolute_humidity", data="a"),
    "empty": lambda file: file.create_dataset("absolute_humidity", data=h5py.Empty("f4")),
    "compound": lambda file: file.create_dataset(
        "absolute_humidity", data=np.zeros((N, N, N), [("a", "f4"), ("b", "i4")])
    ),
    "truths": lambda file: file.create_dataset("absolute_humidity", data=AIR > 0),
    "complex": lambda file: file.create_dataset("absolute_humidity", data=AIR + 0j),
    "group": lambda file: file.create_group("absolute_humidity"),
    "number": lambda file: file.create_dataset("absolute_humidity", data=1.0),
    "plane": lambda file: file.create_dataset("absolute_humidity", data=AIR[0]),
    "enormous": lambda file: file.create_dataset(
        "absolute_humidity", (10**6,) * 3, "f4", chunks=(16, 16, 16)
    ),
    "loop": lambda file: link(file, h5py.SoftLink("/absolute_humidity")),
    "nowhere": lambda file: link(file, h5py.SoftLink("/no")),
    "elsewhere": lambda file: link(file, h5py.ExternalLink("nothere.nc", "x")),
    "raw values elsewhere": lambda file: raw(file),  # noqa: PLW0108 (they stand below)
    "virtual": lambda file: virtual(file),  # noqa: PLW0108
}


def raw(file):
    place = Path(file.filename).with_name("raw")
    place.write_bytes(AIR.tobytes())
    return file.create_dataset(
        "absolute_humidity", AIR.shape, "f8", external=[(place, 0, h5py.h5f.UNLIMITED)]
    )


def link(file, to):
    file["absolute_humidity"] = to
    file["x"] = AIR  # what a link to another file's x must not be mistaken for


def virtual(file):
    layout = h5py.VirtualLayout(AIR.shape, "f8")
    layout[...] = h5py.VirtualSource("nothere.nc", "x", AIR.shape)
    return file.create_virtual_dataset("absolute_humidity", layout)


@pytest.mark.parametrize("case", NONE)
def test_what_is_no_cube_is_refused(tmp_path, case):
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as file:
        made = NONE[case](file)
        if isinstance(made, h5py.Dataset):
            made.attrs.update({"units": "g m-3", "voxel_m": EDGE})
    refuses(path, "absolute_humidity")


def test_temperature_is_held_to_the_same(tmp_path):
    path = save(tmp_path / "a.nc")
    with h5py.File(path, "a") as file:
        file["air_temperature"] = h5py.ExternalLink("nothere.nc", "absolute_humidity")
    refuses(path, "air_temperature is a link to another file; copy the values in")
    path = save(tmp_path / "a.nc")
    with h5py.File(path, "a") as file:
        file["air_temperature"] = WARMTH[:8]
    refuses(path, "air_temperature has shape (8, 16, 16), the humidity (16, 16, 16)")


@pytest.mark.parametrize("name", ["scale_factor", "add_offset", "_FillValue", "valid_min"])
def test_attributes_that_are_no_numbers_are_refused(tmp_path, name):
    refuses(save(tmp_path / "a.nc", **{name: "many"}), f"its attribute {name} is not a number")


# --- the scene's mean beside the cube's -----------------------------------------------------------


def test_a_mean_that_is_not_the_cubes_is_told(tmp_path):
    cube = cube_file.inspect(save(tmp_path / "a.nc", layers()))
    assert cube.mean_g_m3 == pytest.approx(5.185, abs=5e-4)
    for mean in (cube.mean_g_m3, 0.995 * cube.mean_g_m3, 1.005 * cube.mean_g_m3):
        assert cube_file.mean_note(cube, mean) is None
    for mean in (0.5, 0.98 * cube.mean_g_m3, 1.02 * cube.mean_g_m3):
        assert cube_file.mean_note(cube, mean) == (
            f"{cube.path}: the air is the cube's, 5.185 g/m3 in the mean, and not the scene's "
            f"{mean:.4g} g/m3; give absolute_humidity_g_m3 = 5.185"
        )


@pytest.mark.parametrize("mean", [0.0, 1e-300, 1e-4])
def test_a_dry_scene_is_no_measure_of_a_moist_cube(tmp_path, mean):
    cube = cube_file.inspect(save(tmp_path / "a.nc", layers()))
    with pytest.raises(FileError, match=r"cube's own mean: absolute_humidity_g_m3 = 5\.185"):
        cube_file.refuse_zero_mean(cube, mean)
    cube_file.refuse_zero_mean(cube, 0.5)


def test_a_dry_cube_takes_any_mean_but_0(tmp_path):
    dry = cube_file.inspect(save(tmp_path / "a.nc", np.zeros((N, N, N))))
    cube_file.refuse_zero_mean(dry, 0.001)
    with pytest.raises(FileError, match=r"give any mean above 0, say .* = 0\.001"):
        cube_file.refuse_zero_mean(dry, 0.0)


# --- images ---------------------------------------------------------------------------------------


def profile(mean=7.0, **more):
    """Returns a scene of one level ray, 8 m long, at 2.25 m in air from cube.nc."""
    return scene(
        camera={
            "position_m": [0.0, 0.0, 2.25],
            "look_at_m": [1000.0, 0.0, 2.25],
            "focal_length_mm": 100.0,
            "focal_plane_mm": [0.1, 0.1],
            "pixels": [1, 1],
        },
        atmosphere={
            "temperature_k": 290.0,
            "absolute_humidity_g_m3": mean,
            "fluctuations": {"spectrum": "file", "file": "cube.nc"} | more,
        },
        ground=None,
        targets=None,
        background__max_range_m=8.0,
    )


@pytest.mark.parametrize(
    ("order", "dims", "units", "factor"),
    [
        ((0, 1, 2), "zyx", "g m-3", 1.0),
        ((0, 1, 2), "zyx", "kg m-3", 1000.0),
        ((2, 1, 0), "xyz", "g m-3", 1.0),
    ],
)
def test_rays_cross_the_cube_as_it_stands_in_the_world(tmp_path, order, dims, units, factor):
    """A level ray stays in one layer; a cube of one's own stands upright if nothing is said."""
    save(tmp_path / "cube.nc", layers().transpose(order) / factor, tuple(dims), units)
    seen = run(tmp_path, profile()).variants[0].radiances.optical_depth.item()
    layer = oracle.absorption_per_m(650e9, 290.0, 1013.25, 12 * np.exp(-2.25 / 4))
    assert seen == pytest.approx(float(layer) * 8.0, rel=1e-4)
    assert seen == pytest.approx(0.1165, rel=1e-3)


def test_a_cube_that_was_told_to_be_oblique_is(tmp_path):
    save(tmp_path / "cube.nc", layers())
    tilted = run(tmp_path, profile(grid_orientation="oblique")).variants[0].radiances
    assert tilted.optical_depth.item() == pytest.approx(0.0874, rel=1e-2)


def test_powers_that_overflow_are_refused(tmp_path):
    """What the refusal advises works."""
    save(tmp_path / "cube.nc", layers())
    due = run(tmp_path, profile()).variants[0].radiances.optical_depth.item()
    for mean in (0.05, 0.01, 0.0015):
        data = profile(mean=mean) | {"numerics": {"moments": 16}}
        with pytest.raises(ScenarioError, match="of degree 16 overflow float32") as caught:
            run(tmp_path, data)
        most = int(str(caught.value).split("give at most ")[1].split(",")[0])
        for mended in ({"moments": most}, {"moments": 16, "precision": "float64"}):
            sight = run(tmp_path, data | {"numerics": mended}).variants[0].radiances
            assert sight.optical_depth.item() == pytest.approx(due, rel=1e-5)
    assert run(tmp_path, profile(mean=0.1) | {"numerics": {"moments": 16}})


@pytest.mark.parametrize("apart_k", [0.0, 1e-13, 2e-6])
def test_a_cube_of_the_scenes_own_temperature_is_air_of_one_temperature(tmp_path, apart_k):
    """Nor do departures matter that are as small as rounding."""
    walled = scene(atmosphere=profile()["atmosphere"])
    save(tmp_path / "cube.nc", layers())
    due = run(tmp_path, walled)
    warmth = np.full(layers().shape, 290.0)
    warmth[0, 0, 0] += apart_k
    save(tmp_path / "cube.nc", layers(), temperature=warmth)
    seen = run(tmp_path, walled)
    one, other = (made.variants[0].radiances for made in (seen, due))
    assert "temperature-field" not in {stage["stage"] for stage in seen.left_out}
    assert one.optical_depth == pytest.approx(other.optical_depth, rel=1e-5)
    scale = float(np.abs(other.contrast).max())
    assert one.contrast == pytest.approx(other.contrast, abs=1e-5 * scale)
    assert seen.error_budget["total"]["relative"] < 1e-5


def test_a_result_tells_whose_mean_counts(tmp_path):
    save(tmp_path / "cube.nc", layers())
    told = [note for note in run(tmp_path, profile(mean=0.5)).warnings if "g/m3" in note]
    assert len(told) == 1
    assert "5.185 g/m3 in the mean, and not the scene's 0.5 g/m3" in told[0]
    assert not [n for n in run(tmp_path, profile(mean=5.185)).warnings if "g/m3" in n]


def test_a_dry_scene_beside_a_moist_cube_is_a_message(tmp_path):
    save(tmp_path / "cube.nc", layers())
    with pytest.raises(ScenarioError, match="give the cube's own mean: absolute_humidity_g_m3 ="):
        pipeline.prepare(write(tmp_path, profile(mean=0.0)))


# --- boxes ----------------------------------------------------------------------------------------

KELVIN = 291.0


def box(path, shape, voxel_m, corner_m, *, warm=False, seed=3, **attributes):
    """Writes humidity of any shape (x, y, z), with coordinates in the world; returns the arrays."""
    rng = np.random.default_rng(seed)
    grams = rng.uniform(2, 14, shape[::-1])
    kelvin = 288 + 6 * rng.random(shape[::-1]) if warm else None
    save(path, grams, temperature=kelvin, voxel_m=None, **attributes)
    axes = {
        name: (corner + (np.arange(n) + 0.5) * edge, {"units": "m"})
        for name, n, edge, corner in zip("xyz", shape, voxel_m, corner_m, strict=True)
    }
    coordinates(path, **axes)
    return grams, kelvin


def boxed(position, look_at, range_m=30.0, **flow):
    """Returns a scene of a few rays through cube.nc, with a background of 300 K."""
    return scene(
        camera={
            "position_m": position,
            "look_at_m": look_at,
            "focal_length_mm": 20.0,
            "focal_plane_mm": [10.0, 8.0],
            "pixels": [5, 4],
        },
        atmosphere={
            "temperature_k": KELVIN,
            "absolute_humidity_g_m3": 8.0,
            "fluctuations": {"spectrum": "file", "file": "cube.nc"} | flow,
        },
        ground=None,
        targets=None,
        background={"temperature_k": 300.0, "max_range_m": range_m},
    )


def planck(kelvin):
    """Planck's law at 650 GHz for numbers or arrays."""
    x = oracle.H * 650e9 / (oracle.K * np.asarray(kelvin))
    return 2 * oracle.H * 650e9**3 / oracle.C**2 / np.expm1(x)


def expected(grams, kelvin, lattice, data, times=None, steps=200_000):
    """Returns depth and radiance of each ray by tiny equal steps, which know nothing of segments.

    `lattice` is shape, edges and corner along x, y, z, and which axes repeat.
    """
    shape, voxel_m, corner_m, periodic = lattice
    camera, air = data["camera"], data["atmosphere"]
    wind = np.array(air["fluctuations"].get("wind_m_s", (0.0, 0.0, 0.0)))
    names = "position_m", "look_at_m", "focal_length_mm", "focal_plane_mm", "pixels"
    rays = oracle.Camera(*(camera[name] for name in names))
    far = data["background"]["max_range_m"]
    own = np.full(grams.shape, KELVIN) if kelvin is None else kelvin
    held = oracle.absorption_per_m(650e9, own, 1013.25, grams)
    around = oracle.absorption_per_m(650e9, KELVIN, 1013.25, air["absolute_humidity_g_m3"])
    depths, radiances = [], []
    for row in range(camera["pixels"][1]):
        for column in range(camera["pixels"][0]):
            d = rays.ray(row, column)
            s = (np.arange(steps) + 0.5) * far / steps
            t = 0.0 if times is None else times[row][column]
            at = np.array(camera["position_m"]) - t * wind + s[:, None] * np.asarray(d)
            cell = np.floor((at - corner_m) / voxel_m).astype(int)
            inside = np.ones(steps, bool)
            for axis in range(3):
                if periodic[axis]:
                    cell[:, axis] %= shape[axis]
                else:
                    inside &= (cell[:, axis] >= 0) & (cell[:, axis] < shape[axis])
            x, y, z = np.where(inside[:, None], cell, 0).T
            warmth = np.full(steps, KELVIN)
            if kelvin is not None:
                warmth = np.where(inside, kelvin[z, y, x], KELVIN)
            tau = np.where(inside, held[z, y, x], around) * far / steps
            passed = np.exp(-np.concatenate([[0.0], np.cumsum(tau)]))
            depths.append(tau.sum())
            radiances.append(passed[-1] * planck(300.0) - (np.diff(passed) * planck(warmth)).sum())
    pixels = camera["pixels"][1], camera["pixels"][0]
    return np.reshape(depths, pixels), np.reshape(radiances, pixels)


BOXES = {
    "inside, all bounded": ((20, 9, 7), (1.0, 0.5, 0.25), (-3.0, -2.0, 0.0), (0, 0, 0), (0, 0, 1)),
    "from outside": ((12, 17, 5), (0.5, 1.0, 0.7), (6.0, -8.0, -1.0), (0, 0, 0), (0.0, 0.5, 0.3)),
    "misses": ((4, 4, 4), (0.5, 0.5, 0.5), (6.0, 30.0, -1.0), (0, 0, 0), (0.0, 0.5, 0.3)),
    "two periods": ((8, 16, 11), (0.5, 0.25, 0.5), (1.0, 7.0, 0.0), (1, 1, 0), (3.0, 2.0, 6.0)),
    "one voxel high": ((8, 4, 1), (0.5, 0.25, 50.0), (1.0, 7.0, -20.0), (1, 1, 1), (3.0, 2.0, 6.0)),
}


@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize("case", BOXES)
def test_a_box_stands_where_its_coordinates_say(tmp_path, case, warm):
    """Depth and radiance as by 200,000 steps a ray; around the box is the scene's own air."""
    shape, voxel_m, corner_m, periodic, start = BOXES[case]
    periodic = [bool(p) for p in periodic]
    grams, kelvin = box(tmp_path / "cube.nc", shape, voxel_m, corner_m, warm=warm)
    data = boxed(list(start), [10.0, 0.3, 2.1], periodic=periodic)
    made = run(tmp_path, data | {"numerics": {"precision": "float64"}})
    depth, radiance = expected(grams, kelvin, (shape, voxel_m, corner_m, periodic), data)
    seen = made.variants[0].radiances
    assert seen.optical_depth[0] == pytest.approx(depth, rel=2e-4)
    ours = seen.contrast[0] + seen.air_radiance[:, None, None][0]
    assert ours == pytest.approx(radiance, rel=2e-4)
    assert made.error_budget["total"]["relative"] < 1e-10


@pytest.mark.parametrize("warm", [False, True])
def test_wind_carries_a_box_along(tmp_path, warm):
    """Each pixel of a scan is taken when the box has gone on: it comes, and it leaves."""
    shape, voxel_m, corner_m = (6, 9, 5), (1.0, 0.5, 0.6), (3.0, -2.0, -1.0)
    grams, kelvin = box(tmp_path / "cube.nc", shape, voxel_m, corner_m, warm=warm)
    wind = [0.5, 4.0, -0.25]
    data = boxed([0.0, 0.5, 0.3], [10.0, 0.3, 1.1], periodic=[False] * 3, wind_m_s=wind)
    detector = {"kind": "passive-spectral", "frequency_ghz": 650.0}
    data["sensor"] = {"kind": "raster-scan", "dwell_s": 0.1, "detector": detector}
    times = 0.1 * np.arange(20).reshape(4, 5)
    depth, _ = expected(grams, kelvin, (shape, voxel_m, corner_m, [False] * 3), data, times)
    for precision, near in (("float64", 2e-4), ("float32", 3e-4)):
        seen = run(tmp_path, data | {"numerics": {"precision": precision}}).variants[0].radiances
        assert seen.optical_depth[0] == pytest.approx(depth, rel=near)
    assert depth.max() > 1.05 * depth.min()


WALL = {
    "kind": "box",
    "center_m": [21.0, 0.0, 2.0],
    "size_m": [2.0, 90.0, 90.0],
    "temperature_k": 300.0,
    "reflectivity": 0.5,
}


def test_light_of_a_transmitter_elsewhere_crosses_a_box_both_ways(tmp_path):
    """Out from the transmitter, back to the camera; each way is the sum of its tiny steps."""
    lattice = (9, 7, 5), (1.0, 2.0, 1.5), (3.0, -7.0, 0.0), [False] * 3
    grams, _ = box(tmp_path / "cube.nc", *lattice[:3])
    data = boxed([0.0, 0.0, 2.0], [20.0, 0.0, 2.0], periodic=[False] * 3)
    data |= {"targets": {"wall": WALL}, "numerics": {"precision": "float64"}}
    data["camera"]["pixels"] = [1, 1]
    place = [0.0, 3.0, 1.0]
    data["sensor"] = ACTIVE | {"arrangement": "bistatic", "transmitter_m": place}
    made = run(tmp_path, data)
    back = data | {"background": {"temperature_k": 300.0, "max_range_m": 20.0}}
    far = float(np.hypot(20.0, np.hypot(3.0, 1.0)))
    out = back | {"camera": back["camera"] | {"position_m": place}}
    out["background"] = {"temperature_k": 300.0, "max_range_m": far}
    due = sum(expected(grams, None, lattice, way)[0].item() for way in (back, out))
    assert made.variants[0].sight.optical_depth.item() == pytest.approx(due, rel=1e-4)
    assert made.error_budget["total"]["relative"] < 1e-10


@pytest.mark.parametrize("warm", [False, True])
def test_a_ray_that_the_cut_off_ends_within_a_box_ends_there(tmp_path, warm):
    """The air behind the box is not added to it."""
    box(tmp_path / "cube.nc", (90, 7, 5), (0.1, 20.0, 15.0), (3.0, -70.0, -20.0), warm=warm)
    data = boxed([0.0, 0.0, 2.0], [20.0, 0.0, 2.0], periodic=[False] * 3)
    data |= {"targets": {"wall": WALL}}
    whole = run(tmp_path, data).variants[0].radiances.optical_depth
    made = run(tmp_path, data | {"numerics": {"cutoff_depth": 0.1}})
    depth = made.variants[0].radiances.optical_depth
    assert depth.min() > 0.1
    assert depth.max() < 0.14 < whole.min()
    assert made.error_budget["cut-off"]["relative"] > 0.1
    assert made.error_budget["arithmetic"]["relative"] < 1e-5


@pytest.mark.parametrize("kelvins", [None, 0.5])
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("orientation", ["oblique", "aligned"])
def test_ones_own_saved_cube_makes_the_same_image_bit_for_bit(
    tmp_path, kelvins, precision, orientation
):
    warm = {} if kelvins is None else {"temperature_sigma_k": kelvins, "correlation_tq": -0.4}
    flow = {"sigma_percent": 35.0, "voxel_m": 0.3, "grid": 64, "seed": 5}
    air = {"temperature_k": 290.0, "relative_humidity_percent": 60.0}
    data = scene(atmosphere=air | {"fluctuations": flow | warm | {"grid_orientation": orientation}})
    data |= {"output": {"save_field": True}, "numerics": {"precision": precision}}
    made = run(tmp_path, data)
    made.save(tmp_path / "own.nc")
    data["atmosphere"] = air | {"fluctuations": {"spectrum": "file", "file": "own.nc"}}
    again = run(tmp_path, data)
    one, other = (result.variants[0].radiances for result in (made, again))
    assert np.array_equal(one.optical_depth, other.optical_depth)
    assert np.array_equal(one.contrast, other.contrast)
    cubes = [result.cubes[0].absolute_humidity_g_m3 for result in (made, again)]
    assert np.array_equal(*cubes)
    assert not [note for note in again.warnings if "own.nc" in note]


def test_a_saved_box_is_read_as_it_was(tmp_path):
    """With its corner, its edges and the axes that repeat."""
    box(tmp_path / "cube.nc", (12, 16, 5), (0.5, 1.0, 0.7), (6.0, -8.0, -1.0), warm=True)
    data = boxed([0.0, 0.5, 0.3], [10.0, 0.3, 2.1], periodic=[False, True, False])
    made = run(tmp_path, data | {"output": {"save_field": True}})
    made.save(tmp_path / "own.nc")
    data["atmosphere"]["fluctuations"] = {"spectrum": "file", "file": "own.nc"}
    again = run(tmp_path, data)
    one, other = (result.variants[0].radiances for result in (made, again))
    assert other.optical_depth == pytest.approx(one.optical_depth, rel=1e-6)
    lattices = [cube_file.inspect(tmp_path / name).lattice for name in ("own.nc", "cube.nc")]
    assert lattices[0].shape == (16, 16, 8)
    assert lattices[0].filled == (12, None, 5)
    assert lattices[0].corner_m == pytest.approx((6.0, -8.0, -1.0))


@pytest.mark.parametrize(
    ("attributes", "asked", "due"),
    [
        ({}, None, (None, None, 5)),
        ({"periodic": np.array([0, 1, 1])}, None, (12, None, None)),
        ({"periodic": np.array([0, 1, 1])}, (True, False, False), (None, 16, 5)),
    ],
)
def test_scene_and_file_say_which_axes_repeat(tmp_path, attributes, asked, due):
    """With coordinates x and y do, unless it is said otherwise."""
    path = tmp_path / "cube.nc"
    box(path, (12, 16, 5), (0.5, 1.0, 0.7), (6.0, -8.0, -1.0), **attributes)
    found = cube_file.inspect(path, Asked(periodic=asked)).lattice
    assert found.filled == due
    if found.filled[0] is None:
        assert (found.shape[0], found.voxel_m[0]) == (16, pytest.approx(6.0 / 16))


def test_what_says_that_axes_repeat_must_be_three(tmp_path):
    refuses(save(tmp_path / "a.nc", periodic=np.array([1, 2, 0])), "its attribute periodic is")
    path = save(tmp_path / "a.nc")
    with h5py.File(path, "a") as file:
        file.attrs["grid_rotation"] = "[[0, 1, 0], [1, 0, 0], [0, 0, 1]]"
    refuses(path, "its grid_rotation is none of thzcl's own; turn the cube upright")


def test_cells_are_remapped_conservatively(tmp_path):
    """Uneven heights, and a period that is no power of two: the mean stays, sigma is told."""
    path, heights = tmp_path / "cube.nc", np.array([0.5, 1.5, 3.0, 5.0, 9.0])
    grams, _ = box(path, (12, 16, 5), (0.5, 1.0, 1.0), (0.0, 0.0, 0.0))
    coordinates(path, z=(heights, {"units": "m"}))
    found = cube_file.inspect(path)
    faces = np.array([0.0, 1.0, 2.25, 4.0, 7.0, 11.0])
    assert found.lattice.filled == (None, None, 11)
    assert found.lattice.voxel_m == pytest.approx((6 / 16, 1.0, 1.0))
    own = np.average(grams.mean(axis=(1, 2)), weights=np.diff(faces))
    assert found.mean_g_m3 == pytest.approx(own, rel=1e-12)
    values, _ = cube_file.read(path)
    assert values[0, 3, 0] == pytest.approx(grams[0, 3, 0], rel=1e-12)
    mixed = 0.25 * grams[1, 3, 0] + 0.75 * grams[2, 3, 0]
    assert values[2, 3, 0] == pytest.approx(mixed, rel=1e-12)
    (note,) = found.notes
    assert "remapped along z from 5 cells to 11 voxels of 1 m, x from 12 cells to 16 voxels" in note
    assert f"sigma was {grams.std():.4g} g/m3, and is {values.std():.4g}" in note


def test_humidity_is_read_by_standard_names(tmp_path):
    """Specific humidity, mixing ratio, relative humidity: the same air to the last digits."""
    kelvin, hpa = WARMTH, 950.0 + np.arange(N)[:, None, None]
    vapour = AIR * 461.525 * kelvin / 1e5
    mixing = 0.62198 * vapour / (hpa - vapour)
    theta = 300 / kelvin
    saturated = 2.408e11 * theta**5 * np.exp(-22.644 * theta)
    for standard, values, units in (
        ("specific_humidity", mixing / (1 + mixing), "kg kg-1"),
        ("specific_humidity", 1e3 * mixing / (1 + mixing), "g/kg"),
        ("humidity_mixing_ratio", mixing, "1"),
        ("relative_humidity", 100 * vapour / saturated, "%"),
        ("mass_concentration_of_water_vapor_in_air", AIR / 1e3, "kg m-3"),
    ):
        path = save(tmp_path / "a.nc", values, units=units, temperature=kelvin)
        with h5py.File(path, "a") as file:
            file.move("absolute_humidity", "q")
            file["q"].attrs["standard_name"] = standard
            file.move("air_temperature", "ta")
            file["ta"].attrs["standard_name"] = "air_temperature"
            pressures = file.create_dataset("p", data=np.broadcast_to(hpa, (N, N, N)) * 100)
            pressures.attrs.update({"standard_name": "air_pressure", "units": "Pa"})
        humidity, temperature = cube_file.read(path)
        assert humidity == pytest.approx(AIR, rel=1e-9)
        assert np.array_equal(temperature, kelvin)


def test_a_pressure_that_is_not_in_the_file_is_the_scenes(tmp_path):
    path = save(tmp_path / "a.nc", np.full((N, N, N), 0.01), units="1", temperature=WARMTH)
    with h5py.File(path, "a") as file:
        file.move("absolute_humidity", "specific_humidity")
    low, high = (cube_file.read(path, Asked(pressure_hpa=p))[0] for p in (500.0, 1000.0))
    assert high == pytest.approx(2 * low, rel=1e-12)
    vapour = 0.01 * 1000.0 / (0.62198 + 0.37802 * 0.01)
    assert high == pytest.approx(vapour * 1e5 / (461.525 * WARMTH), rel=1e-9)
    with h5py.File(path, "a") as file:
        del file["air_temperature"]
    refuses(path, "specific_humidity needs air_temperature beside it")


def test_one_of_several_times_is_taken(tmp_path):
    path = tmp_path / "a.nc"
    times = np.stack([AIR + step for step in range(3)])
    save(path, times, ("time", "z", "y", "x"))
    refuses(path, "has 3 times; choose one of 0 to 2 with time_index")
    assert np.array_equal(cube_file.read(path, Asked(time_index=2))[0], AIR + 2)
    with pytest.raises(FileError, match="has 3 times, and no time_index = 3; lower it"):
        cube_file.inspect(path, Asked(time_index=3))
    save(path, times[:1], ("t", "z", "y", "x"))
    assert np.array_equal(cube_file.read(path)[0], AIR)
    save(path)
    with pytest.raises(FileError, match="has no times to choose from; remove time_index"):
        cube_file.inspect(path, Asked(time_index=0))


def test_the_part_of_rays_that_a_box_holds_is_told(tmp_path):
    box(tmp_path / "cube.nc", (20, 100, 100), (0.5, 1.0, 1.0), (6.0, -50.0, -50.0))
    data = boxed([0.0, 0.5, 0.3], [10.0, 0.5, 0.3], range_m=40.0, periodic=[False] * 3)
    (told,) = [note for note in run(tmp_path, data).warnings if "of the rays' length" in note]
    assert "holds 26 % of the rays' length" in told or "holds 25 % of the rays' length" in told
