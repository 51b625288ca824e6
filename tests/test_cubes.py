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
from scenes import run, scene, write

from thzcl import pipeline
from thzcl.air.humidity import absolute_humidity
from thzcl.errors import FileError, ScenarioError
from thzcl.scenario.atmosphere import Atmosphere, Fluctuations
from thzcl.turbulence import cube_file

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
        cube_file.inspect(path, voxel_m)
    assert str(caught.value).startswith(f"{path}: ")
    for text in texts:
        assert text in str(caught.value)


# --- what a plan learns ---------------------------------------------------------------------------


def test_a_cube_is_inspected(tmp_path):
    path = save(tmp_path / "a.nc", temperature=WARMTH)
    found = cube_file.inspect(path, None)
    assert (found.path, found.grid, found.voxel_m, found.notes) == (path, N, EDGE, ())
    assert found.mean_g_m3 == pytest.approx(AIR.mean(), rel=1e-12)
    assert found.humidity_span_g_m3 == (AIR.min(), AIR.max())
    assert found.temperature_span_k == (WARMTH.min(), WARMTH.max())
    assert found.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert pickle.loads(pickle.dumps(found)) == found
    assert hash(found) == hash(replace(found))
    humidity, temperature, voxel_m = cube_file.read(path)
    assert np.array_equal(humidity, AIR)
    assert np.array_equal(temperature, WARMTH)
    assert voxel_m == EDGE


def test_cubes_are_equal_by_their_bytes(tmp_path):
    """Another value in a voxel that changes neither mean nor spans makes another cube."""
    swapped = AIR.copy()
    swapped[0, 0, 1:3] = AIR[0, 0, 2:0:-1]
    path = tmp_path / "a.nc"
    one = cube_file.inspect(save(path), None)
    other = cube_file.inspect(save(path, swapped), None)
    assert one != other
    assert replace(one, digest="", mean_g_m3=0) == replace(other, digest="", mean_g_m3=0)
    assert cube_file.inspect(save(path), None) == one


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
    assert limits(Fluctuations, "grid") == (cube_file.FEWEST, cube_file.MOST)
    kelvins = cube_file.TEMPERATURE.least, cube_file.TEMPERATURE.most
    assert limits(Atmosphere, "temperature_k") == kelvins
    pressure = Atmosphere.model_json_schema()["properties"]["pressure_hpa"]["maximum"]
    most = float(absolute_humidity(pressure, kelvins[0]))
    assert most == pytest.approx(cube_file.HUMIDITY.most, rel=1e-3)


def test_scene_attribute_and_coordinates_agree_on_the_edge(tmp_path):
    steps = {"z": (np.arange(N) * 0.25, {"units": "m"})}
    path = save(tmp_path / "a.nc", voxel_m=None)
    refuses(path, "does not say how large its voxels are; give voxel_m in [atmosphere.fl")
    assert cube_file.inspect(path, 2.0).voxel_m == 2.0
    assert cube_file.inspect(coordinates(path, **steps), None).voxel_m == 0.25
    assert cube_file.read(path)[2] == 0.25
    refuses(path, "steps of 0.25 m, but the edge of its voxels is 2 m", voxel_m=2.0)
    path = save(tmp_path / "a.nc")
    assert cube_file.inspect(path, EDGE).voxel_m == EDGE
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
    "brick": lambda file: file.create_dataset("absolute_humidity", data=AIR[:8]),
    "small": lambda file: file.create_dataset("absolute_humidity", data=AIR[:8, :8, :8]),
    "odd": lambda file: file.create_dataset("absolute_humidity", (20, 20, 20), "f4"),
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
    refuses(path, "air_temperature has shape (8, 16, 16), absolute_humidity (16, 16, 16)")


@pytest.mark.parametrize("name", ["scale_factor", "add_offset", "_FillValue", "valid_min"])
def test_attributes_that_are_no_numbers_are_refused(tmp_path, name):
    refuses(save(tmp_path / "a.nc", **{name: "many"}), f"its attribute {name} is not a number")


# --- the scene's mean beside the cube's -----------------------------------------------------------


def test_a_mean_that_is_not_the_cubes_is_told(tmp_path):
    cube = cube_file.inspect(save(tmp_path / "a.nc", layers()), None)
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
    cube = cube_file.inspect(save(tmp_path / "a.nc", layers()), None)
    with pytest.raises(FileError, match=r"cube's own mean: absolute_humidity_g_m3 = 5\.185"):
        cube_file.refuse_zero_mean(cube, mean)
    cube_file.refuse_zero_mean(cube, 0.5)


def test_a_dry_cube_takes_any_mean_but_0(tmp_path):
    dry = cube_file.inspect(save(tmp_path / "a.nc", np.zeros((N, N, N))), None)
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
