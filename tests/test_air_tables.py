"""Air by a table of one's own, ranges of constituents, and what a scene says of them."""

from __future__ import annotations

import h5netcdf
import numpy as np
import pytest
from scenes import BROAD, DRIFTING, MOIST, facing, run, scene, write

from thzcl import pipeline
from thzcl.air.composition import located, optical_properties, part
from thzcl.air.constituents.mpm93 import attenuation
from thzcl.constituent import RESERVED_NAMES
from thzcl.errors import FileError, ScenarioError
from thzcl.scenario.atmosphere import Atmosphere

SCAN = {"kind": "raster-scan", "timing": "raster", "dwell_s": 1e-2}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": [340.0, 650.0]}


# --- the table -----------------------------------------------------------------------------------


def save(path, ghz, kelvin, vapour, pressure=1013.25, **changes):
    """A table of MPM93's absorption; changes replace axes and attributes in the file."""
    axes = {"frequency_ghz": ghz, "temperature_k": kelvin, "vapour_pressure_hpa": vapour}
    axes = {name: np.asarray(axis, float) for name, axis in axes.items()}
    f, t, e = (
        axis.reshape(shape)
        for axis, shape in zip(axes.values(), ((-1, 1, 1), (1, -1, 1), (1, 1, -1)), strict=True)
    )
    values = attenuation("mpm93", f, t, pressure, e).total_per_m * changes.pop("factor", 1.0)
    values[changes.pop("gap", ())] = np.nan if "nan" in changes else values[()]
    changes.pop("nan", None)
    attributes = {"units": "1/m", "pressure_hpa": pressure} | changes.pop("attributes", {})
    stored = axes | changes.pop("axes", {})
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {name: len(axis) for name, axis in axes.items()}
        for name, axis in stored.items():
            coordinate = file.create_variable(name, (name,), data=axis)
            if name in changes:
                coordinate.attrs["units"] = changes[name]
        variable = file.create_variable("absorption", tuple(axes), data=values)
        for name, value in attributes.items():
            if value is not None:
                variable.attrs[name] = value
    return path


def tabulated(path):
    return located(part("table", {"file": str(path)}), lambda _: path)


def test_a_table_filled_from_mpm93_gives_its_image(tmp_path):
    """Nodes at the scene's frequencies and temperature, 65 of them in vapour pressure."""
    save(tmp_path / "air.nc", [340.0, 650.0], [290.0], np.linspace(0.0, 40.0, 65))
    air = DRIFTING | {"model": "table", "model_file": "air.nc"}
    found = run(tmp_path, scene(sensor=SPECTRAL, atmosphere=air)).variants[0].sight
    exact = run(tmp_path, scene(sensor=SPECTRAL, atmosphere=DRIFTING)).variants[0].sight
    largest = np.abs(exact.contrast).max(axis=(1, 2), keepdims=True)
    assert np.max(np.abs(found.contrast - exact.contrast) / largest) < 1e-6
    assert found.optical_depth == pytest.approx(exact.optical_depth, rel=1e-6)


def test_between_its_nodes_a_table_is_cubic_straight_and_quadratic(tmp_path):
    """A monotone cubic in frequency never leaves its nodes; temperature and vapour are met."""
    ghz, kelvin, vapour = np.arange(300.0, 500.0, 10.0), [270.0, 290.0], [0.0, 10.0, 30.0]
    table = tabulated(save(tmp_path / "t.nc", ghz, kelvin, vapour))
    rng = np.random.default_rng(5)

    def of(f, t, e):
        return np.asarray(optical_properties(table, f * 1e9, t, 1013.25, e).absorption)

    nodes = of(ghz[:, None], 290.0, np.array(vapour))
    mpm93 = attenuation("mpm93", ghz[:, None], 290.0, 1013.25, np.array(vapour)).total_per_m
    assert nodes == pytest.approx(mpm93, rel=1e-12)
    between = of(rng.uniform(380.0, 390.0, 100), 290.0, 10.0)  # down a line's flank
    low, high = sorted(of(np.array([380.0, 390.0]), 290.0, 10.0))
    assert low <= between.min() and between.max() <= high
    cold, warm = (of(380.0, t, 10.0) for t in kelvin)
    assert of(380.0, 275.0, 10.0) == pytest.approx(0.75 * cold + 0.25 * warm, rel=1e-12)
    e = rng.uniform(0.0, 30.0, 50)
    parabola = np.polyfit(vapour, of(380.0, 290.0, np.array(vapour)), 2)
    assert of(380.0, 290.0, e) == pytest.approx(np.polyval(parabola, e), rel=1e-9)


@pytest.mark.parametrize(
    ("units", "factor"), [("1/km", 1e3), ("km-1", 1e3), ("dB/km", 1e4 / np.log(10.0)), ("m^-1", 1)]
)
def test_units_of_a_table_are_obeyed(tmp_path, units, factor):
    axes = [300.0, 400.0], [280.0, 290.0], [5.0, 9.0, 12.0]
    plain = tabulated(save(tmp_path / "plain.nc", *axes))
    other = save(
        tmp_path / "other.nc",
        *axes,
        factor=factor,
        attributes={"units": units},
        frequency_ghz="Hz",
        axes={
            "frequency_ghz": np.array([300e9, 400e9]),
            "temperature_k": np.array([280.0, 290.0]),
            "vapour_pressure_hpa": np.array([500.0, 900.0, 1200.0]),
        },
        vapour_pressure_hpa="Pa",
    )
    state = 310e9, 283.0, 1013.25, np.array([5.0, 7.0, 12.0])
    found, due = (optical_properties(one, *state) for one in (tabulated(other), plain))
    assert found.absorption == pytest.approx(due.absorption, rel=1e-12)


AXES = [300.0, 400.0], [280.0, 290.0], [0.0, 9.0, 12.0]
BAD_TABLES = {
    "gap": ({"gap": (0, 1, 2), "nan": True}, "1 of 12 values (the first at [0, 1, 2]) are missing"),
    "negative": ({"factor": -1.0}, "12 of 12 values (the first at [0, 0, 0]) are negative"),
    "descending": (
        {
            "axes": {"frequency_ghz": np.array([400.0, 300.0])}
            | {"temperature_k": np.array(AXES[1]), "vapour_pressure_hpa": np.array(AXES[2])}
        },
        "frequency_ghz: does not ascend",
    ),
    "other units": ({"attributes": {"units": "m2/kg"}}, 'units "m2/kg" are not known'),
    "no units": ({"attributes": {"units": None}}, 'has no units; give it units = "1/m"'),
    "units of an axis": ({"temperature_k": "degF"}, 'temperature_k: units "degF" are not known'),
    "no pressure": ({"attributes": {"pressure_hpa": None}}, "has no attribute pressure_hpa"),
    "pressure in words": ({"attributes": {"pressure_hpa": "high"}}, "pressure_hpa is not a number"),
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_a_table_that_cannot_be_used_is_refused(tmp_path, case):
    changes, expected = BAD_TABLES[case]
    save(tmp_path / "air.nc", *AXES, **changes)
    air = MOIST | {"model": "table", "model_file": "air.nc"}
    with pytest.raises(ScenarioError, match=r"air\.nc") as caught:
        pipeline.prepare(write(tmp_path, scene(atmosphere=air)))
    assert expected in str(caught.value)


def test_a_table_of_other_dimensions_and_no_table_at_all(tmp_path):
    air = MOIST | {"model": "table", "model_file": "air.nc"}
    file = write(tmp_path, scene(atmosphere=air))
    for make, expected in (
        (lambda path: path.with_name("b"), "No such file"),
        (lambda path: path.write_text("ghz,k\n"), "cannot be read"),
        (lambda path: _variable(path, "extinction", ("frequency_ghz",)), "has no variable absorp"),
        (lambda path: _variable(path, "absorption", ("frequency_ghz",)), "its dimensions are (fre"),
    ):
        make(tmp_path / "air.nc")
        with pytest.raises(ScenarioError) as caught:
            pipeline.prepare(file)
        assert expected in str(caught.value) and "air.nc" in str(caught.value)


def _variable(path, name, dimensions):
    path.unlink(missing_ok=True)
    with h5netcdf.File(path, "w") as file:
        file.dimensions = dict.fromkeys(dimensions, 3)
        file.create_variable(dimensions[0], dimensions[:1], data=np.arange(1.0, 4.0))
        file.create_variable(name, dimensions, data=np.ones(3)).attrs["units"] = "1/m"


def test_a_table_outside_the_folder_or_changed_meanwhile(tmp_path):
    inner = tmp_path / "scene"
    inner.mkdir()
    save(tmp_path / "air.nc", *AXES)
    air = MOIST | {"model": "table", "model_file": "../air.nc"}
    with pytest.raises(ScenarioError, match="outside"):
        pipeline.prepare(write(inner, scene(atmosphere=air)))
    planned = tabulated(tmp_path / "air.nc")
    save(tmp_path / "air.nc", *AXES, factor=2.0)
    from thzcl.air import grid

    grid.read.cache_clear()
    with pytest.raises(FileError, match="has changed since"):
        optical_properties(planned, 310e9, 283.0, 1013.25, 5.0)


# --- ranges --------------------------------------------------------------------------------------


RANGES = {
    "frequency": (
        {"sensor__frequency_ghz": 2000.0},
        '[sensor] frequency_ghz: 2000 GHz: "mpm93" holds up to 1780 GHz',
    ),
    "one of several frequencies": (
        {"sensor__frequency_ghz": [600.0, 1800.0]},
        "[sensor] frequency_ghz: 1800 GHz",
    ),
    "of a detector": (
        {"sensor": SCAN | {"detector": SPECTRAL | {"frequency_ghz": 2000.0}}},
        "[sensor] detector.frequency_ghz: 2000 GHz",
    ),
    "band": ({"sensor": BROAD | {"center_ghz": 1770.0}}, '"mpm93" holds up to 1780 GHz'),
    "corrected": (
        {"atmosphere__model": "mpm93-corrected", "sensor__frequency_ghz": 2000.0},
        '"mpm93-corrected" holds up to 1780 GHz',
    ),
}


@pytest.mark.parametrize("case", RANGES)
def test_a_frequency_beyond_the_model_is_refused_with_one_that_would_do(tmp_path, case):
    changes, expected = RANGES[case]
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(**changes)))
    assert expected in str(caught.value) and 'model = "none" would do' in str(caught.value)


@pytest.mark.usefixtures("dust")
def test_without_a_gas_frequencies_have_no_such_end(tmp_path):
    """10 THz, at the end of the paper's band, through dust alone."""
    air = MOIST | {"model": "none", "dust": {"per_km": 0.5}}
    sensor = {"kind": "passive-spectral", "frequency_ghz": 10000.0}
    seen = run(tmp_path, facing(40.0, atmosphere=air, sensor=sensor)).variants[0].sight
    assert seen.optical_depth[0] == pytest.approx(0.5e-3 * seen.path_length, rel=1e-6)


BEYOND = {
    "temperature": ({"temperature_k": 300.0}, "[atmosphere] temperature_k: 300 K"),
    "pressure": ({"pressure_hpa": 1015.0}, "[atmosphere] pressure_hpa: 1015 hPa"),
    "humidity": (
        {"relative_humidity_percent": 90.0},
        "[atmosphere] relative_humidity_percent: 17.2",
    ),
    "frequency": ({}, "[sensor] frequency_ghz: 650 GHz"),
    "fluctuations": (
        {"fluctuations": DRIFTING["fluctuations"]},
        "[atmosphere.fluctuations]: ",
    ),
}


@pytest.mark.parametrize("case", BEYOND)
def test_a_table_that_does_not_hold_the_scene_is_refused(tmp_path, case):
    """Its pressure stands for 0.1 % around it; fluctuating air must lie within its nodes too."""
    changes, expected = BEYOND[case]
    ghz = [600.0, 640.0] if case == "frequency" else [600.0, 700.0]
    save(tmp_path / "air.nc", ghz, [285.0, 295.0], [5.0, 10.0, 15.0])
    air = MOIST | {"pressure_hpa": 1014.0, "model": "table", "model_file": "air.nc"} | changes
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(atmosphere=air)))
    assert expected in str(caught.value) and '"mpm93"' in str(caught.value)
    assert "would do" in str(caught.value)


# --- what a scene says ---------------------------------------------------------------------------

SAID = {
    "unknown model": ({"model": "mpm39"}, "model: no constituent", "did you mean mpm93?"),
    "dust as model": ({"model": "dust"}, 'model: "dust" is no gas', "[atmosphere.dust]"),
    "unknown table": ({"dusk": {}}, "dusk: unknown key, and no constituent", "did you mean dust?"),
    "unknown key": ({"presure_hpa": 900.0}, "presure_hpa: unknown key", "did you mean pressure_"),
    "no table": ({"dust": 3.0}, "dust: must be a table, not 3", ""),
    "its key": ({"dust": {"per_mile": 1.0}}, "per_mile: unknown key", "did you mean per_km?"),
    "its value": ({"dust": {"per_km": -1.0}}, "per_km: must be at least 0 1/km, not -1", ""),
    "another gas": (
        {"table": {"file": "a.nc"}},
        "table: is the table of a gas that is not in use",
        'model = "table"',
    ),
    "a file for none": ({"model_file": "a.nc"}, "model_file: is read by a model that is", "mpm93"),
    "no file": ({"model": "table"}, "model_file: missing: NetCDF file of absorption", ""),
    "two files": (
        {"model": "table", "model_file": "a.nc", "table": {"file": "b.nc"}},
        "give only one of model_file and table.file",
        "",
    ),
    "not text": ({"model": 3}, 'model: must be text in "quotes", not 3', ""),
}


@pytest.mark.usefixtures("dust")
@pytest.mark.parametrize("case", SAID)
def test_what_is_wrong_with_the_air_is_said(tmp_path, case):
    changes, *expected = SAID[case]
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(atmosphere=MOIST | changes)))
    assert all(text in str(caught.value) for text in expected), str(caught.value)
    assert len(caught.value.problems) == 1


@pytest.mark.usefixtures("dust")
def test_all_that_is_wrong_is_said_at_once(tmp_path):
    air = MOIST | {"temperature_k": -1.0, "model": "mpm39", "dust": {"per_km": "a"}, "fluff": 1}
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(atmosphere=air)))
    assert len(caught.value.problems) == 4


def test_a_table_may_be_named_in_its_own_table(tmp_path):
    save(tmp_path / "air.nc", [600.0, 700.0], [285.0, 295.0], [5.0, 10.0, 15.0])
    for keys in ({"model_file": "air.nc"}, {"table": {"file": "air.nc"}}):
        air = MOIST | {"model": "table"} | keys
        assert pipeline.prepare(write(tmp_path, scene(atmosphere=air))).variants[0].cube is None


def test_names_of_keys_are_kept():
    assert set(Atmosphere.model_fields) <= RESERVED_NAMES
