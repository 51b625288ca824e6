"""P.676-13 and Rosenkranz 2024: check values, ITU-Rpy and the oracle; and each in every image."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import oracle
import pytest
from conftest import ROOT
from mutants import CASES
from scenes import ACTIVE, BROAD, MIRROR, MOIST, facing, run, scene, write

from thzcl import pipeline
from thzcl.air import spectrum
from thzcl.air.composition import lines, optical_properties, part
from thzcl.air.constituents import p676, r24
from thzcl.air.humidity import absolute_humidity, vapour_pressure_from_relative
from thzcl.constituent import DB_KM_PER_INVERSE_METRE
from thzcl.errors import RangeError, ScenarioError
from thzcl.plan import report
from thzcl.studies.stress.trial import DOUBLE, SINGLE, Case, examine

PRINT = 1e-5  # relative: the check values have six digits
ROUNDING = 1e-12  # of float64 sums of some hundred terms
CORE = 1e-10  # where a profile by speed is a difference of nearly equal numbers
MODELS = {"p676-13": p676.attenuation, "r24": r24.attenuation}
MOST_GHZ = {"p676-13": 1000.0, "r24": 1097.0}
HOT = (308.15, 90)
MILD = (293.15, 44)
HIGH = (230.0, 0.05, 300.0)

# GHz; temperature in K and relative humidity in %, or also vapour pressure and total pressure in
# hPa; dB/km of dry air and of vapour by P.676-13, and by R24.
CHECKS = [
    (100.0, MILD, (0.0308805, 0.400461), (0.0357696, 0.394748)),
    (118.75, MILD, (1.28344, 0.580963), (1.27007, 0.567865)),
    (183.31, (316.15, 30), (0.0082268, 57.0971), (0.0137341, 56.0473)),
    (220.0, MILD, (0.014127, 2.33641), (0.0226481, 2.25997)),
    (340.0, MILD, (0.0306949, 8.80324), (0.0468815, 8.39391)),
    (650.0, (263.15, 30), (0.136121, 7.29061), (0.192259, 6.37072)),
    (650.0, MILD, (0.0909575, 62.3707), (0.133195, 56.2871)),
    (650.0, HOT, (0.0702091, 327.667), (0.10454, 295.077)),
    (1000.0, MILD, (0.174291, 663.884), (0.274799, 653.777)),
    (183.4, HIGH, (0.00266979, 0.7322), (0.00349064, 0.741841)),
]

# The first half of the SHA-256 of each table's rows, comments left out, as its source has them.
TABLES = {
    "p676_13_oxygen_lines.csv": "6477c25c0b0c78b005f904c10f5beffe",
    "p676_13_water_lines.csv": "9a0884d8fcb3aec158335a5e260b50c9",
    "r24_oxygen_lines.csv": "5c826bdd5ca42dfedd86f62a768895b5",
    "r24_water_lines.csv": "efa4113acaca64d97c7f6d5e5158f8de",
    "r24_water_self_continuum.csv": "a3623ff9fff578e8806ec5217bd2f7fe",
}


# --- the formulas --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("check", CHECKS, ids=lambda check: f"{check[0]:g}-{check[1][0]:g}")
def test_the_check_values_of_four_climates(model, check):
    ghz, (kelvin, moist, *pressure), *expected = check
    vapour = moist if pressure else vapour_pressure_from_relative(moist, kelvin)
    found = MODELS[model](ghz, kelvin, *(pressure or [1013.25]), vapour)
    dry, wet = expected[list(MODELS).index(model)]
    assert found.dry_db_km == pytest.approx(dry, rel=PRINT)
    assert found.vapour_db_km == pytest.approx(wet, rel=PRINT)


def test_the_parts_of_r24_at_650_ghz():
    """Oxygen, nitrogen, lines and continuum at 20 degC and 44 %, in dB/km."""
    f, t, p = np.array(650.0), np.array(293.15), np.array(1013.25)
    e = vapour_pressure_from_relative(44, 293.15)
    grams = absolute_humidity(e, 293.15)
    parts = (
        (r24.oxygen(f, t, p, e), 0.00222209),
        (r24.nitrogen(f, t, p - e), 0.130973),
        (r24.water_lines(f, t, p - e, e, grams), 41.7755),
        (r24.water_continuum(f, t, p - e, e), 14.5116),
    )
    for found, expected in parts:
        # The programs' rounding of constants of humidity is left out here.
        assert found * r24.DB_KM == pytest.approx(expected, rel=4e-5)


@pytest.mark.slow
def test_p676_agrees_with_itu_rpy():
    """Its P.676-12 has the tables and equations of P.676-13; imported in a process of its own."""
    code = (
        "import sys, numpy as np, itur.models.itu676 as itu; itu.change_version(12);"
        "rows = np.loadtxt(sys.stdin);"
        "[print(float(itu.gamma0_exact(*row).value), float(itu.gammaw_exact(*row).value))"
        " for row in rows]"
    )
    rng = np.random.default_rng(1)
    count = 300
    ghz, kelvin = rng.uniform(1, 1000, count), rng.uniform(220, 320, count)
    ghz[:60] = rng.uniform(50, 70, 60)
    total = np.where(
        rng.random(count) < 0.5, rng.uniform(100, 1050, count), 10 ** rng.uniform(0, 3)
    )
    vapour = np.minimum(rng.uniform(0, 50, count) * kelvin / 216.7, 0.9 * total)
    rows = np.transpose([ghz, total - vapour, 216.7 * vapour / kelvin, kelvin])
    text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
    command = [sys.executable, "-W", "ignore", "-c", code]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
    dry, wet = np.array([line.split() for line in done.stdout.splitlines()], dtype=float).T
    found = p676.attenuation(ghz, kelvin, total, vapour)
    assert len(dry) == count
    assert found.dry_db_km == pytest.approx(dry, rel=1e-9, abs=0)
    assert found.vapour_db_km == pytest.approx(wet, rel=1e-9, abs=0)


@pytest.mark.parametrize("model", MODELS)
def test_every_frequency_and_state_agrees_with_the_oracle(model):
    """Cores, wings and cut-offs of lines, dry air, and pressures of 0.1 to 1100 hPa."""
    rng = np.random.default_rng(2)
    cores = np.repeat([22.235, 60.3, 118.75, 183.31, 556.936], 20)
    near = cores + rng.uniform(-30, 30, 100)
    cut = 750 - np.array([22.235, 183.31, 321.2, 380.2, 448.0]) + rng.uniform(-0.3, 0.3, 5)
    everywhere = rng.uniform(1, MOST_GHZ[model], 200)
    for number, ghz in enumerate(np.maximum([*everywhere, *near, *cut], 1.0)):
        kelvin, pressure = rng.uniform(200, 330), 10 ** rng.uniform(-1, 3.04)
        vapour = 0.0 if number % 10 == 0 else rng.uniform(0, min(60.0, pressure))
        found = MODELS[model](ghz, kelvin, pressure, vapour)
        dry, wet = oracle.GASES[model](ghz, kelvin, pressure, vapour)
        accuracy = CORE if model == "r24" else ROUNDING
        assert found.dry_db_km == pytest.approx(dry, rel=accuracy, abs=0)
        assert found.vapour_db_km == pytest.approx(wet, rel=accuracy, abs=0)


@pytest.mark.parametrize("model", MODELS)
def test_arrays_broadcast_and_equal_their_scalars(model):
    """Also many lines at a time, and few."""
    f = np.array([22.0, 118.9, 170.0, 183.0, 650.0])[:, None, None]
    t, e = np.linspace(250, 310, 60)[:, None], np.linspace(0, 30, 61)
    grid = MODELS[model](f, t, 900.0, e)
    assert grid.dry_db_km.shape == grid.vapour_db_km.shape == (5, 60, 61)
    for i, j, k in ((0, 3, 5), (1, 0, 0), (2, 59, 60), (3, 30, 1), (4, 7, 60)):
        one = MODELS[model](f[i, 0, 0], t[j, 0], 900.0, e[k])
        assert grid.dry_db_km[i, j, k] == pytest.approx(one.dry_db_km, rel=ROUNDING)
        assert grid.vapour_db_km[i, j, k] == pytest.approx(one.vapour_db_km, rel=ROUNDING, abs=0)


@pytest.mark.parametrize("model", MODELS)
def test_air_is_never_negative_and_dry_air_has_no_vapour(model):
    """The sum over oxygen lines is, between the lines, and is not clipped."""
    rng = np.random.default_rng(3)
    f, t = rng.uniform(1, MOST_GHZ[model], 20_000), rng.uniform(220, 320, 20_000)
    f[:5000] = rng.uniform(40, 130, 5000)
    found = MODELS[model](f, t, 10 ** rng.uniform(0, 3.04, 20_000), 0.0)
    assert found.dry_db_km.min() > 0
    assert not found.vapour_db_km.any()


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_as_published(name):
    text = (oracle.TABLES / name).read_text(encoding="utf-8")
    rows = "".join(row + "\n" for row in text.splitlines() if not row.startswith("#"))
    assert hashlib.sha256(rows.encode()).hexdigest()[:32] == TABLES[name]


BAD = [
    ("p676-13", (0.999, 280, 1000, 5), "from 1 to 1000 GHz"),
    ("p676-13", (1000.1, 280, 1000, 5), "from 1 to 1000 GHz"),
    ("r24", (0.0, 280, 1000, 5), "above 0"),
    ("r24", (1098.0, 280, 1000, 5), "up to 1097"),
    *((model, (np.nan, 280, 1000, 5), "GHz") for model in MODELS),
    *((model, (650, -1, 1000, 5), "temperature") for model in MODELS),
    *((model, (650, np.nan, 1000, 5), "temperature") for model in MODELS),
    *((model, (650, 280, 1000, 1001), "vapour") for model in MODELS),
    *((model, (650, 280, 1000, -1e-3), "vapour") for model in MODELS),
]


@pytest.mark.parametrize(("model", "state", "expected"), BAD)
def test_what_the_formulas_do_not_cover_is_refused(model, state, expected):
    with pytest.raises(ValueError, match=expected):
        MODELS[model](*state)


@pytest.mark.slow
def test_faddeevas_function_is_imported_near_a_lines_core_alone():
    code = (
        "import sys; from thzcl.air.constituents.r24 import attenuation;"
        "attenuation([300.0, 650.0], 290.0, 1013.25, 10.0);"
        "before = 'scipy.special' in sys.modules;"
        "attenuation({}, 290.0, 1013.25, 10.0); print(before, 'scipy.special' in sys.modules)"
    )
    for ghz in (22.0, 118.0, 183.0):
        command = [sys.executable, "-c", code.format(ghz)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
        assert done.stdout.split() == ["False", "True"]


# --- the constituents ----------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_optics_are_the_formulas_in_parts(model):
    hz = np.array([100e9, 650e9])
    found = optical_properties(part(model), hz, 290.0, 1000.0, 8.0)
    of_air = MODELS[model](hz / 1e9, 290.0, 1000.0, 8.0)
    assert found.absorption == pytest.approx(of_air.total_db_km / DB_KM_PER_INVERSE_METRE)
    assert found.parts["dry"] == pytest.approx(of_air.dry_db_km / DB_KM_PER_INVERSE_METRE)
    assert found.parts["vapour"] == pytest.approx(of_air.vapour_db_km / DB_KM_PER_INVERSE_METRE)


@pytest.mark.parametrize("model", MODELS)
def test_lines_stand_where_absorption_peaks(model):
    """Those of oxygen in dry air at low pressure, and those of water in moist air."""
    centers, width = lines(part(model), 290.0, 20.0, 1.0)
    for ghz in (118.7503, 183.31, 556.936):
        nearest = centers[np.abs(centers - ghz * 1e9).argmin()]
        around = nearest + width * np.linspace(-20, 20, 401)
        peak = optical_properties(part(model), around, 290.0, 20.0, 1.0).absorption
        assert abs(around[np.argmax(peak)] - nearest) < width
        wide = around[peak > peak.max() / 2]
        assert 0.2 * width < np.ptp(wide) / 2 < 3 * width


BEYOND = {
    "r24 above its end": (
        {"atmosphere__model": "r24", "sensor__frequency_ghz": 850.0},
        '[sensor] frequency_ghz: 850 GHz: "r24" holds up to 800 GHz',
        '"p676-13"',
    ),
    "r24 in a band": (
        {"atmosphere__model": "r24", "sensor": BROAD | {"center_ghz": 780.0}},
        '"r24" holds up to 800 GHz',
        '"p676-13"',
    ),
    "p676 above its end": (
        {"atmosphere__model": "p676-13", "sensor__frequency_ghz": 1000.5},
        '"p676-13" holds from 1 up to 1000 GHz',
        '"mpm93"',
    ),
    "p676 below its end": (
        {"atmosphere__model": "p676-13", "sensor__frequency_ghz": 0.5},
        '[sensor] frequency_ghz: 0.5 GHz: "p676-13" holds from 1 up to 1000 GHz',
        '"r24"',
    ),
}


@pytest.mark.parametrize("case", BEYOND)
def test_a_frequency_beyond_is_refused_with_models_that_would_do(tmp_path, case):
    changes, expected, instead = BEYOND[case]
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(**changes)))
    said, remedy = str(caught.value).split("; model = ")
    assert expected in said and instead in remedy and "would do" in remedy
    assert f'"{changes["atmosphere__model"]}"' not in remedy


def test_the_ends_themselves_are_inside(tmp_path):
    """However they come out of a unit's conversion."""
    for model, ghz in (("p676-13", 1.0), ("p676-13", 1000.0), ("r24", 800.0)):
        for off in (1.0, 1 + 1e-12, 1 - 1e-12):
            found = optical_properties(part(model), ghz * off * 1e9, 290.0, 1000.0, 8.0)
            assert found.absorption > 0
        data = scene(atmosphere__model=model, sensor__frequency_ghz=ghz)
        assert pipeline.prepare(write(tmp_path, data)).variants
    with pytest.raises(RangeError):
        optical_properties(part("r24"), 800.001e9, 290.0, 1000.0, 8.0)


WARNED = {
    "r24 near its end": ({"model": "r24"}, 790.0, "790 GHz", "low by 2 to 3.4 %"),
    "r24 high up": (
        {"model": "r24", "pressure_hpa": 2.0, "relative_humidity_percent": 1.0},
        650.0,
        '2 hPa: "r24" is stated from 3 hPa',
        "Doppler",
    ),
}


@pytest.mark.parametrize("case", WARNED)
def test_r24_warns_where_it_is_about_to_end(tmp_path, case):
    changes, ghz, *expected = WARNED[case]
    plan = pipeline.prepare(
        write(tmp_path, scene(atmosphere=MOIST | changes, sensor__frequency_ghz=ghz))
    )
    (warning,) = (told for told in report.warnings(plan, [0.0]) if "[sky]" not in told)
    assert all(text in warning for text in expected), warning


@pytest.mark.parametrize(("model", "ghz"), [("r24", 779.0), ("p676-13", 999.0)])
def test_neither_warns_within(tmp_path, model, ghz):
    data = scene(atmosphere=MOIST | {"model": model}, sensor__frequency_ghz=ghz)
    assert not report.warnings(pipeline.prepare(write(tmp_path, data)), [0.0])


# --- images --------------------------------------------------------------------------------------

EVEN = {
    "one frequency": {},
    "in the core of a line": {"sensor__frequency_ghz": 183.0},
    "float64": {"numerics": {"precision": "float64"}},
    "dry air": {"atmosphere__relative_humidity_percent": 0.0},
    "hot and humid": {
        "atmosphere__temperature_k": 308.15,
        "atmosphere__relative_humidity_percent": 90.0,
    },
    "active": {"sensor": ACTIVE},
    "several frequencies": {"sensor__frequency_ghz": [100.0, 183.31, 650.0]},
}


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("case", EVEN)
def test_even_air_takes_what_the_oracle_says(tmp_path, model, case):
    data = facing(40.0, atmosphere=MOIST | {"model": model})
    changes = {"atmosphere": data["atmosphere"]} | EVEN[case]
    for key, value in changes.items():
        table, _, name = key.partition("__")
        data[table] = data.get(table, {}) | {name: value} if name else value
    air, sight = data["atmosphere"], run(tmp_path, data).variants[0].sight
    kelvin = air["temperature_k"]
    vapour = air["relative_humidity_percent"] / 100 * oracle.saturation_hpa(kelvin)
    length = sight.path_length + (sight.outgoing_length if case == "active" else 0.0)
    for row, ghz in zip(
        sight.optical_depth, np.atleast_1d(data["sensor"]["frequency_ghz"]), strict=True
    ):
        db_km = sum(oracle.GASES[model](ghz, kelvin, 1013.25, vapour))
        accuracy = 1e-12 if case == "float64" else 1e-6  # float64's lengths, float32's
        assert row == pytest.approx(db_km / DB_KM_PER_INVERSE_METRE * length, rel=accuracy)
        assert row.min() > 0


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_a_bands_sum_resolves_each_models_lines(tmp_path, model):
    """Around 183 GHz, where R24 steps at ten half widths: a fine sum by the oracle, to 1e-5."""
    sensor = BROAD | {"center_ghz": 183.31, "bandwidth_ghz": 80.0}
    wall = {"wall": MIRROR | {"reflectivity": 0.0}}
    one, other = (
        run(tmp_path, facing(40.0, atmosphere=MOIST | {"model": name}, sensor=sensor, targets=wall))
        for name in (model, "none")
    )
    passed = (one.variants[0].sight.contrast / other.variants[0].sight.contrast)[0, 1, 1]
    ghz = 143.31 + (np.arange(8000) + 0.5) / 100
    vapour = 0.7 * oracle.saturation_hpa(290.0)
    gas = np.vectorize(oracle.GASES[model], excluded=(1, 2, 3))
    per_m = sum(gas(ghz, 290.0, 1013.25, vapour)) / DB_KM_PER_INVERSE_METRE
    # The throughput of a single mode goes with the square of the wavelength.
    weights = [(oracle.planck(f * 1e9, 300) - oracle.planck(f * 1e9, 290)) / f**2 for f in ghz]
    assert passed == pytest.approx(np.average(np.exp(-40 * per_m), weights=weights), abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_a_tolerance_is_kept_and_the_budget_knows_the_model(tmp_path, model):
    """The budget's twin follows the model itself: with another one's it would be far off."""
    fluctuating = {"temperature_sigma_k": 2.0, **scene()["atmosphere"]["fluctuations"]}
    air = MOIST | {"model": model, "fluctuations": fluctuating}
    loose, tight = (
        run(tmp_path, scene(atmosphere=air, numerics=numerics))
        for numerics in ({"tolerance": 1e-3}, {"precision": "float64"})
    )
    assert loose.error_budget["total"]["relative"] <= 1e-3
    assert tight.error_budget["total"]["relative"] < 1e-6
    contrast = tight.variants[0].sight.contrast
    error = loose.variants[0].sight.contrast - contrast
    assert np.sqrt(np.mean(error**2)) <= 1e-3 * np.abs(contrast).max()


def test_a_step_of_r24_within_the_fluctuations_is_reported(tmp_path):
    """At 150.5 GHz ten half widths end inside the air's humidity: a step of some 1e-4."""
    air = scene()["atmosphere"] | {"model": "r24"}
    stepped, smooth = (
        run(tmp_path, scene(atmosphere=air, sensor__frequency_ghz=ghz)) for ghz in (150.5, 140.0)
    )
    assert 1e-5 < stepped.error_budget["absorption-fit"]["max"] < 2e-4
    assert smooth.error_budget["absorption-fit"]["max"] < 1e-6
    assert stepped.error_budget["total"]["relative"] < 1e-6


STRESS = (
    "183.31 GHz saturated, 3 K of fluctuation",
    "556.936 GHz saturated at 50 degC",
    "humidity 0",
    "pressure 1 hPa",
    "100 GHz band at 1 hPa, lines of a few MHz",
    "100 GHz band around a saturated line",
)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_stress_cases_pass_with_each_model(model):
    chosen = [CASES[name] for name in STRESS]
    outcomes = list(
        examine(
            Case(one.name, one.changes | {"atmosphere.model": model}, one.judges) for one in chosen
        )
    )
    assert {outcome.case for outcome in outcomes} == set(STRESS)
    assert all(outcome.error <= outcome.bound for outcome in outcomes)
    assert {outcome.precision for outcome in outcomes} == {SINGLE, DOUBLE}


# --- commands ------------------------------------------------------------------------------------


def test_spectra_and_manual_pages_by_command(thzcl_command, thzcl_json):
    dry, wet = CHECKS[6][3]
    arguments = ("--frequency-ghz", "650", "--temperature-k", "293.15")
    moist = ("--relative-humidity-percent", "44", "--model", "r24")
    (row,) = thzcl_json("absorption", *arguments, *moist)["records"]
    assert row["dry_db_km"] == pytest.approx(dry, rel=PRINT)
    assert row["vapour_db_km"] == pytest.approx(wet, rel=PRINT)
    done = thzcl_command("absorption", "--frequency-ghz", "799", "--model", "r24")
    assert "low by 2 to 3.4 %" in done.stderr and done.returncode == 0
    thin = ("--pressure-hpa", "1", "--model", "r24")
    assert "Doppler" in thzcl_command("absorption", "--frequency-ghz", "60", *thin).stderr
    done = thzcl_command("absorption", "--frequency-ghz", "801", "--model", "r24")
    assert done.returncode == 2 and '"p676-13"' in done.stderr
    for name, words in (("p676-13", "1 to 1000 GHz"), ("r24", "refused")):
        page = thzcl_command("constituents", name).stdout
        for section in ("Fitted to", "Validity", "Validation", "How it compares", "References"):
            assert section in page
        assert words in page


def test_notes_of_spectra_name_frequency_and_pressure():
    of = spectrum.states([650.0, 790.0], [290.0], 2.0, "vapour_pressure_hpa", 0.0)
    found = spectrum.notes(of, [part("r24")])
    assert [note.split(":")[0] for note in found] == ["790 GHz", "2 hPa"]
    assert not spectrum.notes(of, [part("p676-13")])
