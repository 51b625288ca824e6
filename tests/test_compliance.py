"""Result files as the IOOS compliance checker sees them, by CF-1.11."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from scenes import ACTIVE, BROAD, DRIFTING, run, scene, write

import thzcl

SINGLE = {"kind": "radiometer", "frequency_ghz": 346.0, "receiver_temperature_k": 3000.0,
          "if_center_ghz": 5.0, "if_bandwidth_ghz": 4.0, "integration_time_s": 0.1}  # fmt: skip
TWO = [{"name": "a"}, {"name": "b", "set": {"camera.position_m": [2.0, -2.0, 4.0]}}]
MADE = {
    "passive": scene(sensor__frequency_ghz=[350.0, 650.0], output={"save_field": True}),
    "active": scene(sensor=ACTIVE),
    "broadband": scene(sensor=BROAD),
    "radiometer": scene(sensor=SINGLE),
    "compared": scene(atmosphere__compare=["r24", "p676-13"]),
    "variants": scene(variants=TWO, output={"difference": ["a", "b"]}),
    "bands": scene(
        sensor=BROAD, variants=[{"name": "a"}, {"name": "b", "set": {"sensor.center_ghz": 400.0}}]
    ),
    "realizations": scene(sensor=ACTIVE, numerics={"realizations": 3}),
    "scan": scene(
        atmosphere=DRIFTING,
        sensor={"kind": "raster-scan", "dwell_s": 1e-4, "detector": scene()["sensor"]},
    ),
}
# Frames are seconds from the first one: a simulation has no date, which CF's time would ask for.
NO_DATE = "Coordinate variable 'time' should have standard_name='time', found: 'None'"
# UDUNITS knows no decibels.
DECIBELS = re.compile(r'units for \w+, "(dB|\(dB\)\^2)" are not recognized by UDUNITS')


@pytest.fixture(scope="module")
def files(tmp_path_factory, device):
    folder = tmp_path_factory.mktemp("compliance")
    found = {name: run(folder, data).save(folder / f"{name}.nc") for name, data in MADE.items()}
    moving = scene(atmosphere=DRIFTING, sequence={"rate_hz": 5.0, "frames": 2})
    moving["output"] = {"save_field": True}
    thzcl.sequence(write(folder, moving), folder / "sequence.nc", device=device)
    return found | {"sequence": folder / "sequence.nc"}


@pytest.mark.slow
def test_the_compliance_checker_has_no_remark(files, tmp_path):
    pytest.importorskip("compliance_checker")
    checker = Path(sys.executable).with_name("compliance-checker")
    told = tmp_path / "told.json"
    command = [checker, "--test=cf:1.11", "-f", "json_new", "-o", told, *files.values()]
    subprocess.run(command, check=False, capture_output=True)
    reports = json.loads(told.read_text(encoding="utf-8"))
    assert len(reports) == len(files)
    for path, report in reports.items():
        assert report["cf:1.11"]["possible_points"] > 100
        remarks = {text for one in report["cf:1.11"]["all_priorities"] for text in one["msgs"]}
        of_time = {NO_DATE} if "sequence" in path else set()
        assert {text for text in remarks if not DECIBELS.fullmatch(text)} == of_time, path


def attrs(path, name):
    with h5netcdf.File(path) as file:
        return dict(file[name].attrs)


def test_quantities_have_their_standard_names(files):
    for name, standard in (
        ("brightness_temperature", "brightness_temperature"),
        ("absolute_humidity", "mass_concentration_of_water_vapor_in_air"),
        ("frequency", "radiation_frequency"),
    ):
        assert attrs(files["passive"], name)["standard_name"] == standard
    contrast = attrs(files["passive"], "brightness_temperature_contrast")
    assert contrast["units_metadata"] == "temperature: difference"
    assert "standard_name" not in contrast


def test_the_history_says_when_and_by_what_a_file_was_made(files):
    for path in files.values():
        with h5netcdf.File(path) as file:
            date, _, by = file.attrs["history"].partition(": ")
        assert np.datetime64(date.removesuffix("Z")) > np.datetime64("2026-01-01")
        assert by == f"made by thzcl {thzcl.__version__}"


@pytest.mark.parametrize(
    ("name", "expected"), [("broadband", [600.0, 700.0]), ("radiometer", [339.0, 353.0])]
)
def test_bands_have_bounds(files, name, expected):
    with h5netcdf.File(files[name]) as file:
        bounds = file.variables[file["frequency"].attrs["bounds"]]
        assert bounds[...] == pytest.approx(np.array([expected]))
        assert bounds[0, 0] < file["frequency"][0] < bounds[0, 1]
    assert "bounds" not in attrs(files["passive"], "frequency")


def test_bands_that_differ_between_variants_have_bounds_each(files):
    with h5netcdf.File(files["bands"]) as file:
        assert file["frequency_bounds"].dimensions == ("variant", "frequency", "bounds")
        assert file["frequency_bounds"][:, 0] == pytest.approx(
            np.array([[600.0, 700.0], [350.0, 450.0]])
        )


def test_flags_have_meanings_and_their_means_have_a_unit(files):
    flags = attrs(files["active"], "below_floor")
    assert flags["flag_values"].tolist() == [0, 1] and flags["flag_meanings"] == "above below"
    assert "units" not in flags
    fraction = attrs(files["realizations"], "below_floor")
    assert fraction["units"] == "1" and "flag_values" not in fraction


def test_what_is_cheap_is_compressed_and_a_still_cube_is_stored_once(files):
    with h5netcdf.File(files["sequence"]) as file:
        for name in ("target", "image", "optical_depth"):
            assert file[name].compression == "gzip"
        assert file["absolute_humidity"].dimensions == ("z_voxel", "y_voxel", "x_voxel")
        for letter in "xyz":
            axis = file[f"{letter}_voxel"]
            assert axis.dimensions == (f"{letter}_voxel",)
            assert np.diff(axis[...]) == pytest.approx(np.full(31, 0.7))


@pytest.mark.parametrize("name", MADE)
def test_a_file_that_is_read_and_saved_again_says_the_same(files, name, tmp_path):
    path = thzcl.Result.load(files[name]).save(tmp_path / "again.nc")
    with h5netcdf.File(files[name]) as one, h5netcdf.File(path) as other:
        assert other.attrs["history"] == one.attrs["history"]
        assert set(other.variables) == set(one.variables)
        for variable in one.variables:
            told, again = (dict(file[variable].attrs) for file in (one, other))
            assert str(again) == str(told), variable
