"""Rain, fog and snow: permittivities, laws of sizes, sums over them, and what is refused."""

from __future__ import annotations

import csv
import io
import json

import h5netcdf
import numpy as np
import pytest
from scenes import MOIST, scene, write

from thzcl import pipeline
from thzcl.air import humidity, particles, permittivity, spectrum
from thzcl.air.composition import located, moments, optical_properties, part
from thzcl.air.constituents import fog, rain, snow
from thzcl.air.mean import Air
from thzcl.constituent import DB_KM_PER_INVERSE_METRE as DB_KM
from thzcl.device import cache
from thzcl.errors import FileError, PluginFailure, RangeError, ScenarioError

HZ = np.array([94e9, 220e9, 340e9, 650e9])
COOL = (283.15, 1013.25, 12.0)  # temperature, pressure, vapour pressure


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Nothing that was kept before is read."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def extinction(name, table, state=COOL, hz=HZ):
    """What a constituent extinguishes, in dB/km."""
    found = optical_properties(part(name, table), hz, *state)
    return (np.asarray(found.absorption) + found.scattering) * DB_KM


# --- what drops are made of ----------------------------------------------------------------------


def test_water_and_ice_mirror_what_their_permittivities_say():
    """Reflectivity at normal incidence, 293.15 K and 263.15 K."""
    index = np.sqrt(permittivity.water(HZ, 293.15))
    found = np.abs((index - 1) / (index + 1)) ** 2
    assert found == pytest.approx([0.4152, 0.2865, 0.2338, 0.1777], abs=5e-5)
    index = np.sqrt(permittivity.ice(HZ, 263.15))
    assert np.abs((index - 1) / (index + 1)) ** 2 == pytest.approx(4 * [0.0792], abs=5e-5)


def test_they_lose_and_never_gain():
    kelvin = np.linspace(233.15, 373.15, 141)[:, None]
    hz = np.geomspace(1e9, 1e12, 61)
    for of in (permittivity.water, permittivity.water_liebe):
        assert (of(hz, kelvin).imag > 0).all() and (of(hz, kelvin).real > 1).all()
    assert (permittivity.ice(hz, np.minimum(kelvin, 273.15)).imag > 0).all()


def test_maxwell_garnett_begins_with_air_and_ends_with_ice():
    ice = permittivity.ice(650e9, 268.15)
    assert permittivity.maxwell_garnett(ice, 0.0) == 1
    assert permittivity.maxwell_garnett(ice, 1.0) == pytest.approx(complex(ice))
    assert permittivity.snow(650e9, 268.15, 0.1).real == pytest.approx(1 + 1.45 * 0.1, abs=0.01)


def test_the_wet_bulb_solves_its_equation():
    kelvin, percent = np.array([253.15, 283.15, 308.15])[:, None], np.array([0.0, 44.0, 100.0])
    vapour = humidity.vapour_pressure_from_relative(percent, kelvin)
    wet = humidity.wet_bulb_temperature(kelvin, 1013.25, vapour)
    assert wet[:, 2] == pytest.approx(kelvin[:, 0], abs=1e-9)
    left = humidity.saturation_vapour_pressure(wet)
    left = left - 6.62e-4 * 1013.25 * (kelvin - wet) * (1 + 9.44e-4 * (wet - 273.15))
    assert left == pytest.approx(vapour, abs=1e-9)
    # Psychrometric tables: 13.1 degC at 20 degC and 44 %.
    moist = humidity.vapour_pressure_from_relative(44, 293.15)
    assert humidity.wet_bulb_temperature(293.15, 1013.25, moist) == pytest.approx(286.2, abs=0.15)
    assert humidity.wet_bulb_temperature(283.15, 1013.25, 20.0) == 283.15


# --- the laws as they are printed ----------------------------------------------------------------

# k_e in 1/m, albedo, asymmetry, back-scatter in 1/m/sr, chi_2, chi_3 of 10 mm/h at 283.15 K by the
# raw law of Marshall and Palmer and Liebe's permittivity, computed with other code.
MARSHALL_PALMER = {
    94.0: (1.88286e-3, 0.48176, 0.29288, 4.7042e-5, 0.15865, 0.06321),
    220.0: (2.15558e-3, 0.49824, 0.59253, 2.3174e-5, 0.41036, 0.27476),
    650.0: (1.96598e-3, 0.52204, 0.80239, 1.0974e-5, 0.71173, 0.62477),
}


@pytest.mark.parametrize("ghz", MARSHALL_PALMER)
def test_raw_rain_has_its_check_values(ghz):
    drops = rain.raw_sizes("marshall-palmer", 10.0)
    found = particles.spheres(ghz * 1e9, 283.15, permittivity.water_liebe, drops)
    k, albedo, asymmetry, back, second, third = MARSHALL_PALMER[ghz]
    assert found.extinction == pytest.approx(k, rel=1e-3)
    assert found.scattering / found.extinction == pytest.approx(albedo, rel=5e-4)
    assert found.legendre[1] == pytest.approx(asymmetry, rel=5e-4)
    assert found.backscatter == pytest.approx(back, rel=5e-3)
    assert found.legendre[2:4] == pytest.approx([second, third], abs=1e-4)
    # Water of another author changes rain hardly at all.
    other = particles.spheres(ghz * 1e9, 283.15, permittivity.water, drops)
    assert other.extinction == pytest.approx(k, rel=1e-3)


FOG = {  # dB/km of 1 g/m3 with a = 6 and r_m = 10 um at 283.15 K
    permittivity.water_liebe: (4.260, 11.357, 17.096, 31.855),
    permittivity.water: (4.197, 11.612, 17.113, 29.629),
}


@pytest.mark.parametrize("water", FOG)
def test_fog_has_its_check_values(water):
    droplets = fog.droplet_sizes("radiation", 10.0, 1.0)
    found = particles.spheres(HZ, 283.15, water, droplets)
    assert found.extinction * DB_KM == pytest.approx(FOG[water], rel=1e-3)


def test_snow_has_its_check_values():
    table = {"rate_mm_h": 1.0, "density_g_cm3": 0.1}
    saturated = (268.15, 1013.25, float(humidity.saturation_vapour_pressure(268.15)))
    expected = [0.598, 3.243, 6.568, 13.001]
    assert extinction("snow", table, saturated) == pytest.approx(expected, rel=1e-3)
    snowy = part("snow", table)
    found = moments(snowy, optical_properties(snowy, HZ, *saturated))[1]
    assert found == pytest.approx([0.857, 0.954, 0.972, 0.982], abs=6e-4)


# --- what a scene's keys mean --------------------------------------------------------------------


@pytest.mark.parametrize("law", rain.LAWS)
@pytest.mark.parametrize("rate", [0.01, 1.0, 10.0, 50.0, 300.0])
def test_rain_comes_to_its_rate(law, rate):
    assert rain.rain_rate(rain.scaled_sizes(law, rate)) == pytest.approx(rate, rel=1e-12)


def test_raw_rain_comes_to_another_rate():
    for rate, expected in ((10.0, 11.64), (50.0, 54.67)):
        found = rain.rain_rate(rain.raw_sizes("marshall-palmer", rate))
        assert found == pytest.approx(expected, abs=5e-3)


def test_hardly_any_rain_is_scaled_as_a_little():
    one, ten = (extinction("rain", {"rate_mm_h": rate}) for rate in (0.01, 0.0099))
    assert ten == pytest.approx(one, rel=0.02) and np.all(ten < one)
    assert np.all(extinction("rain", {"rate_mm_h": 1e-9}) < 1e-6)


def test_contrast_factors_at_650_ghz_over_64_m():
    """10 and 50 mm/h, advection fog and snow."""
    heavy_fog = {"liquid_water_g_m3": 0.37, "droplets": "advection"}
    for name, table, state, factor in (
        ("rain", {"rate_mm_h": 10.0}, COOL, 0.898),
        ("rain", {"rate_mm_h": 50.0}, COOL, 0.736),
        ("fog", heavy_fog, (275.0, 1013.25, 7.0), 0.851),
        ("snow", {"rate_mm_h": 1.0}, (268.15, 1013.25, 4.0), 0.83),
    ):
        db = extinction(name, table, state)[3]
        assert np.exp(-db / DB_KM * 64) == pytest.approx(factor, abs=0.005), name


def test_the_spread_over_laws_of_drop_sizes():
    """From a thunderstorm's few large drops to drizzle; two laws are one once they are scaled."""
    found = {
        law: extinction("rain", {"rate_mm_h": 10.0, "drop_sizes": law})[3] for law in rain.LAWS
    }
    assert found["thunderstorm"] == pytest.approx(4.33, abs=0.01)
    assert found["drizzle"] == pytest.approx(13.32, abs=0.02)
    assert found["widespread"] == pytest.approx(found["marshall-palmer"], rel=1e-12)


def test_rain_beside_the_recommendation():
    """ITU-R P.838-3, in dB/km at 10 and 25 mm/h, is 13 to 17 % less than here."""
    for ghz, *printed in ((225.0, 7.095, 12.696), (313.0, 6.911, 12.298), (355.2, 6.810, 12.100)):
        for rate, db_km in zip((10.0, 25.0), printed, strict=True):
            (found,) = extinction("rain", {"rate_mm_h": rate}, hz=np.array([ghz * 1e9]))
            assert 1.13 < found / db_km < 1.17


@pytest.mark.parametrize(
    ("droplets", "mode", "visibility", "water"),
    [
        ("advection", None, 140, 0.372),
        ("advection", 8.0, 219, 0.191),
        ("radiation", None, 250, 0.063),
        ("radiation", 2.0, 500, 0.0156),
    ],
)
def test_fogs_of_shettle_and_fenn(droplets, mode, visibility, water):
    table = {"droplets": droplets, "visibility_m": float(visibility)}
    params = fog.Fog.Params(**table, mode_radius_um=mode)
    assert params.water_g_m3 == pytest.approx(water, rel=0.01)
    assert extinction("fog", table | ({"mode_radius_um": mode} if mode else {})) == pytest.approx(
        extinction("fog", table | {"mode_radius_um": params.mode_um})
    )
    sizes = fog.droplet_sizes(droplets, params.mode_um, params.water_g_m3)
    assert sizes.water_g_m3 == pytest.approx(params.water_g_m3, rel=1e-12)


def test_who_has_which_temperature():
    state = (293.15, 1013.25, 10.3)
    own = {
        name: optical_properties(part(name, table), HZ, *state).temperature_k
        for name, table in (
            ("rain", {"rate_mm_h": 1.0}),
            ("fog", {"visibility_m": 100.0}),
            ("snow", {"rate_mm_h": 1.0}),
        )
    }
    wet = float(humidity.wet_bulb_temperature(*state))
    assert own["rain"] == pytest.approx(wet) and own["fog"] == pytest.approx(293.15)
    assert own["snow"] == pytest.approx(273.15)
    warm = part("rain", {"rate_mm_h": 1.0, "temperature_k": 293.15})
    assert optical_properties(warm, HZ, *state).temperature_k == pytest.approx(293.15)


def test_each_has_its_layers_top():
    for kind, table, top in (
        (rain.Rain, {"rate_mm_h": 1.0}, 2000.0),
        (fog.Fog, {"visibility_m": 100.0}, 200.0),
        (snow.Snow, {"rate_mm_h": 1.0, "layer_top_m": 500.0}, 500.0),
    ):
        assert kind(kind.Params(**table)).layer_top_m == top


# --- a disdrometer's file ------------------------------------------------------------------------


def disdrometer(path, diameter=None, density=None, units="m-3 mm-1", unit="mm"):
    diameter = np.linspace(0.1, 8, 80) if diameter is None else np.asarray(diameter)
    density = 8000 * np.exp(-2.53 * diameter) if density is None else np.asarray(density)
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"diameter_mm": len(diameter)}
        file.create_variable("diameter_mm", ("diameter_mm",), data=diameter).attrs["units"] = unit
        made = file.create_variable("number_density", ("diameter_mm",), data=density)
        made.attrs["units"] = units
    return path


def measured(folder, **of):
    disdrometer(folder / "sizes.nc", **of)
    one = part("rain", {"rate_mm_h": 10.0, "drop_sizes": "file", "file": "sizes.nc"})
    return located(one, lambda name: folder / name)


def test_sizes_of_a_disdrometer_are_scaled_to_the_rate(tmp_path):
    """An exponential law in a file is that law, to its coarse steps and its ends."""
    found = optical_properties(measured(tmp_path), HZ, *COOL)
    law = extinction("rain", {"rate_mm_h": 10.0})
    assert (found.absorption + found.scattering) * DB_KM == pytest.approx(law, rel=0.02)
    metres = {"diameter": np.linspace(1e-4, 8e-3, 80), "unit": "m"}
    law = 8e6 * np.exp(-2.53 * np.linspace(0.1, 8, 80))  # per m4
    same = optical_properties(measured(tmp_path, **metres, density=law, units="m-4"), HZ, *COOL)
    assert same.scattering == pytest.approx(found.scattering, rel=1e-6)


@pytest.mark.parametrize(
    ("of", "expected"),
    [
        ({"diameter": [1.0, 2.0], "density": [3.0, -1.0]}, "negative, the lowest -1"),
        ({"diameter": [1.0, 2.0], "density": [0.0, 0.0]}, "holds no drops"),
        ({"diameter": [0.0, 2.0], "density": [1.0, 1.0]}, "diameter_mm holds 0 mm"),
        ({"diameter": [1.0, 200.0], "density": [1.0, 1.0]}, "are the units right?"),
        ({"diameter": [1.0], "density": [1.0]}, "give two or more"),
        ({"units": "1/m3"}, "not known; convert it to 1/m3/mm"),
    ],
)
def test_a_wrong_file_of_sizes_has_its_message(tmp_path, of, expected):
    with pytest.raises(FileError) as caught:
        optical_properties(measured(tmp_path, **of), HZ, *COOL)
    assert expected in str(caught.value) and "sizes.nc" in str(caught.value)


# --- many frequencies, and what is kept ----------------------------------------------------------


def test_between_nodes_lies_what_is_computed_there(monkeypatch):
    drops = rain.scaled_sizes("thunderstorm", 50.0)
    hz, kelvin = np.linspace(100e9, 1000e9, 91), np.linspace(240, 310, 50)
    asked = ((hz, np.array(280.0)), (np.array(650e9), kelvin))
    nodes = [particles.spheres(*state, permittivity.water, drops) for state in asked]
    monkeypatch.setattr(particles, "DIRECT", 1000)
    for state, found in zip(asked, nodes, strict=True):
        exact = particles.spheres(*state, permittivity.water, drops)
        assert found.extinction == pytest.approx(exact.extinction, rel=1e-6)
        assert found.scattering == pytest.approx(exact.scattering, rel=1e-6)
        assert found.backscatter == pytest.approx(exact.backscatter, rel=1e-3)
        assert found.legendre == pytest.approx(exact.legendre, abs=1e-6)
        assert found.legendre.shape == (particles.ORDERS, *found.extinction.shape)


def test_a_frequency_is_the_same_alone_and_beside_others():
    """To the bit, computed or kept."""
    drops = rain.scaled_sizes("marshall-palmer", 10.0)
    many = particles.spheres(HZ, 280.0, permittivity.water, drops)
    particles.scattered.cache_clear()
    for one, other in zip(
        particles.spheres(HZ[2:3], 280.0, permittivity.water, drops), many, strict=True
    ):
        assert np.array_equal(one[..., 0], other[..., 2])


def test_sums_are_kept_and_done_without(monkeypatch, tmp_path):
    """What was kept is read back bit for bit; a spoilt entry, or no folder at all, does no harm."""
    drops = rain.scaled_sizes("drizzle", 5.0)

    def found():
        particles.scattered.cache_clear()
        return particles.spheres(HZ, 280.0, permittivity.water, drops)

    first = found()
    (entry,) = (cache.cache_folder() / "mie").iterdir()
    monkeypatch.setattr(particles.mie, "scatter", None)  # the second is not computed again
    for one, other in zip(first, found(), strict=True):
        assert np.array_equal(one, other)
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    entry.write_bytes(entry.read_bytes()[:1000])
    assert np.array_equal(found().extinction, first.extinction)
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert np.array_equal(found().extinction, first.extinction)


# --- scenes --------------------------------------------------------------------------------------


NOTHING = {
    "rain": {"rate_mm_h": 0.0},
    "fog": {"liquid_water_g_m3": 0.0},
    "snow": {"rate_mm_h": 0.0},
}


def test_no_rain_is_no_table_at_all(tmp_path, device):
    """Bit for bit."""
    turbulent = scene()["atmosphere"]
    for air in (MOIST, turbulent):
        with_table, without = (
            pipeline.run(write(tmp_path, scene(atmosphere=air | more)), device=device).variants[0]
            for more in (NOTHING, {})
        )
        assert np.array_equal(with_table.sight.contrast, without.sight.contrast)


WRONG = {
    "negative": ({"rain": {"rate_mm_h": -1.0}}, "must be at least 0 mm/h, not -1"),
    "absurd": ({"rain": {"rate_mm_h": 301.0}}, "must be at most 300 mm/h, not 301"),
    "absurd snow": ({"snow": {"rate_mm_h": 301.0}}, "must be at most 300 mm/h, not 301"),
    "no rate": ({"rain": {}}, "missing: rain rate"),
    "no sight": ({"fog": {"visibility_m": 0.0}}, "must be above 0 m, not 0"),
    "little sight": ({"fog": {"visibility_m": 0.1}}, "means 157 g/m3 of liquid water"),
    "both": (
        {"fog": {"visibility_m": 9.0, "liquid_water_g_m3": 0.1}},
        "give only one of liquid_water_g_m3 or visibility_m",
    ),
    "neither": ({"fog": {}}, "needs one of liquid_water_g_m3 or visibility_m"),
    "law": ({"rain": {"rate_mm_h": 1.0, "drop_sizes": "mist"}}, "must be 'marshall-palmer'"),
    "no file": ({"rain": {"rate_mm_h": 1.0, "drop_sizes": "file"}}, "go together"),
    "idle file": ({"rain": {"rate_mm_h": 1.0, "file": "a.nc"}}, "go together"),
    "density": ({"snow": {"rate_mm_h": 1.0, "density_g_cm3": 1.0}}, "at most 0.9 g/cm3"),
    "frozen": ({"rain": {"rate_mm_h": 1.0, "temperature_k": 200.0}}, "at least 233.15 K"),
}


@pytest.mark.parametrize("case", WRONG)
def test_each_wrong_key_has_one_message(tmp_path, case):
    tables, expected = WRONG[case]
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(atmosphere=MOIST | tables)))
    assert len(caught.value.problems) == 1 and expected in caught.value.problems[0]


def test_weather_where_there_is_none_is_told():
    cases = (
        ("rain", {"rate_mm_h": 1.0}, (257.0, 1013.25, 1.4), "below 258 K"),
        ("rain", {"rate_mm_h": 1.0, "temperature_k": 250.0}, COOL, "below 258 K"),
        ("fog", {"visibility_m": 100.0}, (283.15, 1013.25, 11.5), "at 94 % relative humidity"),
        ("snow", {"rate_mm_h": 1.0}, (275.0, 1013.25, 7.0), "above 274 K snow melts"),
    )
    for name, table, state, expected in cases:
        grams = float(humidity.absolute_humidity(state[2], state[0]))
        air = Air((part("none"), part(name, table)), state[0], state[1], grams)
        (note,) = air.notes(HZ, (0, 0), (0, 0))
        assert expected in note and note.startswith(f"{name}: ")
    for name, table, state in (
        ("rain", {"rate_mm_h": 1.0}, COOL),
        ("fog", {"visibility_m": 100.0}, (283.15, 1013.25, 12.2)),
        ("snow", {"rate_mm_h": 1.0}, (275.0, 1013.25, 5.5)),  # dry enough
    ):
        grams = float(humidity.absolute_humidity(state[2], state[0]))
        assert not Air((part(name, table),), *state[:2], grams).notes(HZ, (0, 0), (0, 0))


def test_frequencies_and_droplets_beyond_are_refused():
    with pytest.raises(RangeError, match="up to 1000 GHz"):
        extinction("rain", {"rate_mm_h": 1.0}, hz=np.array([1.1e12]))
    with pytest.raises(RangeError, match="where water is liquid"):
        extinction("fog", {"visibility_m": 100.0}, (230.0, 1013.25, 0.1))


# --- the contract --------------------------------------------------------------------------------


MOMENTS = {
    "none": ("1e-3, 1e-3", "without moments"),
    "few": ("1e-3, 1e-3, legendre=np.ones(3)", "3 moments; the least is 49"),
    "first": ("1e-3, 1e-3, legendre=np.zeros(49)", "the first of which is not 1"),
    "large": ("1e-3, 1e-3, legendre=np.r_[1.0, np.full(48, 2.0)]", "not between -1 and 1"),
    "NaN": ("1e-3, 1e-3, legendre=np.r_[1.0, np.full(48, np.nan)]", "not between -1 and 1"),
    "shape": ("1e-3, 1e-3, legendre=np.ones((49, 7))", "legendre of shape (49, 7)"),
}


@pytest.mark.parametrize("case", MOMENTS)
def test_moments_that_are_none_are_named(odd, case):
    from packages import ODD

    given, expected = MOMENTS[case]
    one = part(odd(ODD.replace("absorption=1e-3", given)))
    with pytest.raises(PluginFailure) as caught:
        moments(one, optical_properties(one, HZ, *COOL))
    assert expected in str(caught.value) and "odd-airs" in str(caught.value)


def test_moments_may_be_the_same_everywhere(odd):
    from packages import ODD

    given = "1e-3, 1e-3, legendre=0.5 ** np.arange(49).reshape(49, 1)"
    one = part(odd(ODD.replace("absorption=1e-3", given)))
    assert moments(one, optical_properties(one, HZ, *COOL)).shape == (49, 4)


SAYS = {
    "notes": ("def notes(self, *_): return 'wet'.__len__()", "notes() returned 3"),
    "alternatives": ("def alternatives(self): return [1]", "not return a list of its Params"),
}


@pytest.mark.parametrize("case", SAYS)
def test_what_it_says_is_checked(odd, case):
    from packages import ODD

    body, expected = SAYS[case]
    one = part(odd(ODD.replace("    def optics", f"    {body}\n    def optics")))
    of = spectrum.states([650.0], [290.0], 1013.25, "vapour_pressure_hpa", 8.0)
    asked = spectrum.notes if case == "notes" else spectrum.records
    with pytest.raises(PluginFailure) as caught:
        asked(of, *([[one]] if case == "notes" else [part("none"), [one]]))
    assert expected in str(caught.value)


# --- the command ---------------------------------------------------------------------------------

PLACE = ("--frequency-ghz", "94,650", "--temperature-k", "283.15")
HUMID = ("--relative-humidity-percent", "96")
FALLING = ("--rain-mm-h", "10", "--fog-visibility-m", "200", "--snow-mm-h", "1")


def test_spectra_have_parts_of_what_falls(thzcl_command, thzcl_json, tmp_path):
    found = thzcl_json("absorption", *PLACE, *HUMID, *FALLING)["records"]
    dry = thzcl_json("absorption", *PLACE, *HUMID)["records"]
    for row, without in zip(found, dry, strict=True):
        falling = row["rain_db_km"] + row["fog_db_km"] + row["snow_db_km"]
        assert row["total_db_km"] == pytest.approx(without["total_db_km"] + falling, rel=1e-9)
        assert list(row)[: len(without)] == list(without)
        assert row["rain_least_db_km"] < row["rain_db_km"] < row["rain_most_db_km"]
        assert row["fog_least_db_km"] < row["fog_most_db_km"] / 3
    assert found[1]["rain_db_km"] == pytest.approx(7.33, abs=0.01)
    assert found[1]["rain_albedo"] == pytest.approx(0.52, abs=0.01)
    assert found[1]["rain_asymmetry"] == pytest.approx(0.80, abs=0.01)
    assert found[1]["rain_backscatter_per_m_sr"] == pytest.approx(9.6e-6, rel=0.05)
    lines = thzcl_command("absorption", *PLACE, *FALLING, "--format", "csv").stdout
    assert float(next(csv.DictReader(io.StringIO(lines)))["snow_albedo"]) > 0.9
    done = thzcl_command("absorption", *PLACE, *FALLING, "--figure", "a.png")
    assert done.returncode == 0 and (tmp_path / "a.png").stat().st_size > 0
    assert "fog: at 0 % relative humidity" in done.stderr and "rain_db_" in done.stdout
    none = thzcl_json("absorption", *PLACE, "--rain-mm-h", "0")["records"][0]
    assert none["rain_db_km"] == 0 and none["rain_albedo"] is None


def test_options_that_do_not_go_are_told_in_one_line(thzcl_command):
    for options, expected in (
        (("--rain-mm-h", "400"), "--rain-mm-h: must be at most 300 mm/h"),
        (("--fog-visibility-m", "0"), "--fog-visibility-m: must be above 0 m"),
        (("--fog-visibility-m", "9", "--fog-g-m3", "1"), "give only one of --fog-g-m3"),
        (("--drop-sizes", "drizzle"), "give --rain-mm-h too"),
        (("--rain-mm-h", "1", "--drop-sizes", "mist"), "--drop-sizes: must be"),
        (("--rain-mm-h", "1", "--drop-sizes", "file"), "give a law's name"),
    ):
        done = thzcl_command("absorption", *PLACE, *options)
        assert done.returncode == 2 and expected in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1


def test_manual_pages_say_how_far_to_trust(thzcl_command):
    for name in NOTHING:
        page = thzcl_command("constituents", name).stdout
        for section in ("Validity", "Validation", "References", f"[atmosphere.{name}]"):
            assert section in page
    schema = json.loads(thzcl_command("schema").stdout)
    assert "rate_mm_h" in json.dumps(schema)
