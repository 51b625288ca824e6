"""NetCDF variables as the CF conventions say: units, packing, missing values, axes."""

from __future__ import annotations

import h5netcdf
import h5py
import numpy as np
import pytest
from test_air_tables import AXES
from test_air_tables import save as table
from test_cubes import AIR, EDGE, WARMTH, N, coordinates, refuses, save

from thzcl import files
from thzcl.air import grid
from thzcl.air.constituents.table import GRID
from thzcl.constituent import File
from thzcl.records import columns
from thzcl.turbulence import cube_file

FILL = 9.96921e36


# --- units, packing, missing values ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("units", "grams"),
    [
        ("g m-3", 1),
        ("g/m3", 1),
        ("g m**-3", 1),
        ("g m^-3", 1),
        ("g·m⁻³", 1),
        (np.bytes_(b"g m-3"), 1),
        ("kg m-3", 1000),
        ("kg/m^3", 1000),
        ("kg m⁻³", 1000),
        ("mg m-3", 1e-3),
        ("mg/m3", 1e-3),
        ("ug m-3", 1e-6),
        ("µg/m³", 1e-6),
    ],
)
def test_humidity_is_converted_by_its_units(tmp_path, units, grams):
    path = save(tmp_path / "a.nc", AIR / grams, units=units)
    assert cube_file.read(path)[0] == pytest.approx(AIR, rel=1e-12)
    assert cube_file.inspect(path).notes == ()


@pytest.mark.parametrize(
    "units", ["kg kg-1", "g/kg", "Mg m-3", "hPa", "1", "%", "kg", "g m-2", "0.001 kg m-3", 3]
)
def test_other_units_are_refused(tmp_path, units):
    """A mixing ratio, megagrams, a pressure: none is silently taken for g/m3."""
    refuses(
        save(tmp_path / "a.nc", AIR / 1000, units=units),
        f'absolute_humidity: units "{units}" are not known; convert it to g m-3, kg m-3',
    )


def test_units_that_are_not_given_are_told(tmp_path):
    path = save(tmp_path / "a.nc", units=None)
    assert np.array_equal(cube_file.read(path)[0], AIR)
    assert cube_file.inspect(path).notes == (
        f'{path}: absolute_humidity has no units and was taken to be in g/m3; give it "units"',
    )


@pytest.mark.parametrize(
    ("units", "offset"),
    [
        *((units, 273.15) for units in ("degC", "deg_C", "degree_Celsius", "°C", "celsius")),
        *(("K", 0), ("kelvin", 0), (None, 0)),
    ],
)
def test_temperature_is_converted_by_its_units(tmp_path, units, offset):
    path = save(tmp_path / "a.nc", temperature=WARMTH - offset)
    with h5py.File(path, "a") as file:
        del file["air_temperature"].attrs["units"]
        if units:
            file["air_temperature"].attrs["units"] = units
    assert cube_file.read(path)[1] == pytest.approx(WARMTH, rel=1e-12)
    assert len(cube_file.inspect(path).notes) == (units is None)


def test_temperature_in_other_units_is_refused(tmp_path):
    path = save(tmp_path / "a.nc", temperature=WARMTH)
    with h5py.File(path, "a") as file:
        file["air_temperature"].attrs["units"] = "degF"
    refuses(path, 'air_temperature: units "degF" are not known; convert it to K or degC')


def test_packed_values_are_unpacked(tmp_path):
    packed = np.rint((AIR - 10) / 1e-4).astype("i4")
    path = save(tmp_path / "a.nc", packed, scale_factor=np.float32(1e-4), add_offset=[10.0])
    assert cube_file.read(path)[0] == pytest.approx(AIR, abs=1e-4)
    path = save(tmp_path / "a.nc", packed, scale_factor=1e-7, add_offset=0.01, units="kg m-3")
    assert cube_file.read(path)[0] == pytest.approx(AIR, abs=1e-4)


@pytest.mark.parametrize(
    ("fill", "attributes"),
    [
        (FILL, {"_FillValue": FILL}),
        (FILL, {"_FillValue": np.array([FILL])}),
        (12.5, {"missing_value": 12.5}),
        (12.5, {"missing_value": [1.0, 12.5]}),
        (np.nan, {}),
        (9.969209968386869e36, {}),  # what the library leaves where nothing was written
        (12.5, {"valid_range": [0.0, 12.0]}),
        (12.5, {"valid_max": 12.0}),
        (5.0, {"valid_min": 6.0}),
    ],
)
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_missing_values_are_counted_and_refused(tmp_path, fill, attributes, kind):
    holes = AIR.copy()
    holes[2, 3, 4:7] = fill
    refuses(
        save(tmp_path / "a.nc", holes.astype(kind), **attributes),
        "absolute_humidity: 3 of 4096 values (the first at [2, 3, 4]) are missing",
        "fill the gaps",
    )


def test_the_fill_value_is_that_of_the_packed_values(tmp_path):
    packed = np.rint(AIR / 0.001).astype("i2")
    packed[1, 2, 3] = -32767
    more = {"scale_factor": 0.001, "_FillValue": np.int16(-32767)}
    refuses(save(tmp_path / "a.nc", packed, **more), "1 of 4096 values (the first at [1, 2, 3])")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (-1.0, "are negative, the lowest -1; mend them"),
        (np.inf, "are not finite; mend them"),
        (1e5, "are above 4334 g/m3; are the units right?"),
    ],
)
def test_humidity_beyond_its_limits_is_refused(tmp_path, value, expected):
    wrong = AIR.copy()
    wrong[0, 1] = value
    told = "absolute_humidity: 16 of 4096 values (the first at [0, 1, 0]) "
    refuses(save(tmp_path / "a.nc", wrong), told + expected)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (20.0, "are below 100 K; are the units right?"),
        (2000.0, "are above 400 K; are the units right?"),
        (-5.0, "are negative, the lowest -5"),
    ],
)
def test_temperature_beyond_its_limits_is_refused(tmp_path, value, expected):
    path = save(tmp_path / "a.nc", temperature=np.full((N, N, N), value))
    refuses(path, f"air_temperature: 4096 of 4096 values (the first at [0, 0, 0]) {expected}")


# --- axes -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dims", "order"),
    [
        ("z y x", (0, 1, 2)),
        ("x y z", (2, 1, 0)),
        ("y z x", (1, 0, 2)),
        ("z_voxel y_voxel x_voxel", (0, 1, 2)),
        ("x_voxel y_voxel z_voxel", (2, 1, 0)),
        ("xt yt zt", (2, 1, 0)),
        ("Y X zu_3d", (1, 2, 0)),
        ("dim_0 dim_1 dim_2", (0, 1, 2)),
    ],
)
def test_axes_are_told_by_the_names_of_dimensions(tmp_path, dims, order):
    path = save(
        tmp_path / "a.nc", AIR.transpose(order), dims.split(), temperature=WARMTH.transpose(order)
    )
    humidity, temperature = cube_file.read(path)
    assert np.array_equal(humidity, AIR)
    assert np.array_equal(temperature, WARMTH)
    assert len(cube_file.inspect(path).notes) == 2 * dims.startswith("dim")


def test_variables_have_axes_of_their_own(tmp_path):
    path = save(tmp_path / "a.nc")
    with h5netcdf.File(path, "a") as file:
        warmth = file.create_variable("air_temperature", tuple("xyz"), data=WARMTH.transpose())
        warmth.attrs["units"] = "K"
    assert np.array_equal(cube_file.read(path)[1], WARMTH)


def test_dimensions_without_names_are_told(tmp_path):
    path = tmp_path / "a.nc"
    with h5py.File(path, "w") as file:
        file["absolute_humidity"] = AIR
        file["absolute_humidity"].attrs.update({"units": "g m-3", "voxel_m": EDGE})
    assert np.array_equal(cube_file.read(path)[0], AIR)
    (told,) = cube_file.inspect(path).notes
    assert told == (
        f"{path}: absolute_humidity names no dimensions and was taken to be (z, y, x); "
        "name them z, y, x"
    )


@pytest.mark.parametrize(
    "dims", ["lev lat lon", "z lat lon", "z y time", "height y x", "z1 z2 x", "dim_0 y x"]
)
def test_dimensions_that_are_not_known_are_refused(tmp_path, dims):
    path = save(tmp_path / "a.nc", dims=dims.split())
    refuses(path, f"its dimensions are ({', '.join(dims.split())})", "name them z, y, x")


@pytest.mark.parametrize(
    ("heights", "attributes", "upright"),
    [
        (np.arange(N), {}, True),
        (np.arange(N) * EDGE, {"units": "m"}, True),
        (np.arange(N) * -EDGE, {"units": "m"}, False),
        (np.arange(N) * EDGE, {"units": "m", "positive": "down"}, False),
        (np.arange(N) * -EDGE, {"units": "m", "positive": "down"}, True),
    ],
)
def test_axes_ascend_as_their_coordinates_say(tmp_path, heights, attributes, upright):
    values = AIR if upright else AIR[::-1]
    path = coordinates(save(tmp_path / "a.nc", values), z=(heights, attributes))
    assert np.array_equal(cube_file.read(path)[0], AIR)


def test_steps_may_be_rounded_as_the_coordinate_is(tmp_path):
    """Half a million metres from an origin, float32 tells only 3 cm apart."""
    eastings = (500_000 + np.arange(N) * 0.3).astype("f4")
    assert np.ptp(np.diff(eastings)) > 0.02
    path = coordinates(save(tmp_path / "a.nc", voxel_m=0.3), x=(eastings, {"units": "m"}))
    assert cube_file.inspect(path).lattice.voxel_m[0] == 0.3


@pytest.mark.parametrize(
    ("heights", "attributes", "expected"),
    [
        (1.1 ** np.arange(N), {}, "its coordinate z has steps of 0.1 to 0.379"),
        (np.full(N, 3.0), {}, "its coordinate z has steps of 0 to 0"),
        (np.full(N, np.nan), {}, "its coordinate z has steps of nan to nan"),
        (np.arange(N), {"units": "hPa"}, 'its coordinate z is in "hPa"; give it in m'),
        (np.arange(N), {"units": "m"}, "steps of 1 m, but the edge of its voxels is 0.5 m"),
        (np.arange(N) * EDGE, {"units": "km"}, "steps of 500 m, but the edge"),
    ],
)
def test_coordinates_that_contradict_are_refused(tmp_path, heights, attributes, expected):
    path = coordinates(save(tmp_path / "a.nc"), z=(heights, attributes))
    refuses(path, expected)


@pytest.mark.parametrize(
    "spelling", ["degreeCelsius", "degree_Celsius", "\N{DEGREE SIGN}C", "degC"]
)
def test_a_unit_is_known_to_every_reader_that_is_known_to_one(tmp_path, spelling):
    """A cube, a table of absorption and a record's column read the same spellings."""
    warmth = np.full((N, N, N), 17.0)
    path = save(tmp_path / "a.nc", temperature=warmth)
    with h5py.File(path, "a") as file:
        file["air_temperature"].attrs["units"] = spelling
    assert cube_file.inspect(path).temperature_span_k == pytest.approx((290.15, 290.15))
    kelvin = {"temperature_k": np.array(AXES[1]) - 273.15}
    path = table(tmp_path / "t.nc", *AXES, axes=kelvin, temperature_k=spelling)
    held = grid.read(File("t.nc", path, files.digest(path, files.GRID)), GRID)
    assert held.arrays["temperature_k"] == pytest.approx(AXES[1])
    names, units = ("t", "h2o", "Ux", "Uy", "Ts"), ("s", "g/m3", "m/s", "m/s", spelling)
    assert columns.find(names, units, "", "here").by_role["Ts"][2:4] == (1.0, 273.15)
