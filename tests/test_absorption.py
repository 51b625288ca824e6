"""Absorption and humidity against the oracle, the paper's table and the stated check values."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import oracle
import pytest

from thzcl.air import humidity, spectrum, spectrum_figure
from thzcl.air.composition import part
from thzcl.air.constituents.mpm93 import attenuation
from thzcl.air.expansion import fit
from thzcl.air.mean import Air
from thzcl.air.spectrum import values
from thzcl.constituent import DB_KM_PER_INVERSE_METRE

MOIST = "relative_humidity_percent"
ROUNDING = 1e-12  # of float64 sums of some hundred terms
CLIMATES = [
    (263.15, 30, 7.98626),
    (293.15, 44, 68.66724),
    (316.15, 30, 144.63952),
    (308.15, 90, 376.25416),
]


@pytest.mark.parametrize(("kelvin", "percent", "expected"), CLIMATES)
def test_the_check_values_of_the_stated_convention(kelvin, percent, expected):
    vapour = humidity.vapour_pressure_from_relative(percent, kelvin)
    assert attenuation("mpm93", 650.0, kelvin, 1013.25, vapour).total_db_km == pytest.approx(
        expected, abs=5e-6
    )


@pytest.mark.parametrize("model", ["mpm93", "mpm93-corrected"])
def test_every_frequency_and_state_agrees_with_the_oracle(model):
    rng = np.random.default_rng(1)
    near_lines = [22.235, 60.3, 118.75, 183.31, 547.676, 552.02, 556.936, 752.033, 987.927]
    for ghz in [*rng.uniform(1, 1780, 40), *near_lines, 1780.0]:
        kelvin, pressure = rng.uniform(220, 330), 10 ** rng.uniform(-1, 3.04)
        vapour = rng.uniform(0, min(2 * oracle.saturation_hpa(kelvin), pressure))
        found = attenuation(model, ghz, kelvin, pressure, vapour)
        dry, wet = oracle.attenuation_db_km(
            ghz, kelvin, pressure, vapour, model == "mpm93-corrected"
        )
        assert found.dry_db_km == pytest.approx(dry, rel=ROUNDING)
        assert found.vapour_db_km == pytest.approx(wet, rel=ROUNDING)
        assert found.total_per_m == pytest.approx(
            (dry + wet) / DB_KM_PER_INVERSE_METRE, rel=ROUNDING
        )


def test_arrays_broadcast_and_equal_their_scalars():
    f, t, e = (
        np.array([100.0, 650.0])[:, None, None],
        np.array([270.0, 300.0])[None, :, None],
        np.array([0.0, 5.0, 30.0]),
    )
    grid = attenuation("mpm93", f, t, 1000.0, e).total_db_km
    assert grid.shape == (2, 2, 3)
    assert grid[1, 0, 2] == pytest.approx(
        float(attenuation("mpm93", 650.0, 270.0, 1000.0, 30.0).total_db_km), rel=ROUNDING
    )


def test_the_papers_table_at_600_ghz():
    """Humidities within one last digit; attenuations to 0.31 % from 10 % humidity on.

    The dry row to 2 % (PHYSICS 1).
    """
    with (Path(__file__).parent / "data" / "paper_600ghz_25c.csv").open(newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")][1:]
    assert len(rows) == 11
    for percent, millibar, grams, db_km, _ in (map(float, row) for row in rows):
        vapour = float(humidity.vapour_pressure_from_relative(percent, 298.15))
        assert vapour == pytest.approx(millibar, abs=0.1 if millibar >= 10 else 0.01)
        assert humidity.absolute_humidity(vapour, 298.15) == pytest.approx(
            grams, abs=0.1 if grams >= 10 else 0.01
        )
        found = float(attenuation("mpm93", 600.0, 298.15, 1013.25, vapour).total_db_km)
        assert found == pytest.approx(db_km, rel=0.02 if percent == 0 else 0.0031)


def test_what_correcting_two_lines_changes():
    """650 GHz falls by 1.2 to 1.5 %, 550 GHz by some 16 % (PHYSICS 1)."""
    vapour = humidity.vapour_pressure_from_relative(50, 288.15)

    def change(ghz):
        printed, corrected = (
            float(attenuation(m, ghz, 288.15, 1013.25, vapour).total_db_km)
            for m in ("mpm93", "mpm93-corrected")
        )
        return corrected / printed - 1

    assert -0.016 < change(650.0) < -0.012
    assert -0.18 < change(550.0) < -0.14


def test_negative_oxygen_wings_are_zero():
    """Between the lines the line-mixing sum is negative.

    What remains is the non-resonant spectrum and nitrogen.
    """
    dry = float(attenuation("mpm93", 600.0, 300.0, 1013.25, 0.0).dry_db_km)
    theta, g0, f, p = 1.0, 0.56e-3 * 1013.25, 600.0, 1013.25
    debye = 6.14e-5 * p * theta**2 * f * g0 / (f**2 + g0**2)
    nitrogen = 1.40e-12 * p**2 * theta**3.5 * f / (1 + 1.93e-5 * f**1.5)
    assert dry == pytest.approx(0.1820 * f * (debye + nitrogen), rel=ROUNDING)


def test_humidities_convert_both_ways():
    kelvin = np.array([230.0, 273.15, 320.0])
    vapour = humidity.vapour_pressure_from_relative(70, kelvin)
    assert humidity.relative_humidity(vapour, kelvin) == pytest.approx(70, rel=ROUNDING)
    grams = humidity.absolute_humidity(vapour, kelvin)
    assert humidity.vapour_pressure_from_absolute(grams, kelvin) == pytest.approx(
        vapour, rel=ROUNDING
    )
    assert humidity.saturation_vapour_pressure(kelvin) == pytest.approx(
        [oracle.saturation_hpa(t) for t in kelvin]
    )


@pytest.mark.parametrize(
    ("ghz", "kelvin", "vapour", "model"),
    [
        (1781.0, 280, 5, "mpm93"),
        (0.0, 280, 5, "mpm93"),
        (650, -1, 5, "mpm93"),
        (650, 280, 1100, "mpm93"),
        (650, 280, 5, "itu"),
    ],
)
def test_what_the_model_does_not_cover_is_refused(ghz, kelvin, vapour, model):
    with pytest.raises(ValueError, match=r"GHz|temperature|model"):
        attenuation(model, ghz, kelvin, 1013.25, vapour)


AIRS = [
    (288.0, 100, 1013.25, 650.0, (-1, 1.4)),
    (263.15, 30, 1013.25, 650.0, (-1, 1.4)),
    (323.15, 100, 1013.25, 556.936, (-1, 1.4)),
    (288.0, 5, 100.0, 556.936, (-1, 3)),
    (288.0, 50, 1013.25, 118.75, (-0.9, 1.4)),
]


@pytest.mark.parametrize(("kelvin", "percent", "pressure", "ghz", "span"), AIRS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7])
def test_the_surrogate_keeps_its_bound_against_the_oracle(
    kelvin, percent, pressure, ghz, span, tolerance
):
    grams = float(
        humidity.absolute_humidity(humidity.vapour_pressure_from_relative(percent, kelvin), kelvin)
    )
    air = Air((part("mpm93"),), kelvin, pressure, grams)
    surrogate = fit(air, np.array([ghz * 1e9]), span, tolerance=tolerance)
    assert surrogate.error <= tolerance
    delta = np.random.default_rng(2).uniform(*span, 200)
    exact = oracle.absorption_per_m(ghz * 1e9, kelvin, pressure, grams * (1 + delta))
    mean = oracle.absorption_per_m(ghz * 1e9, kelvin, pressure, grams)
    worst = np.max(np.abs(surrogate.absorption(delta)[0] - exact)) / mean
    assert worst <= surrogate.error
    assert worst <= surrogate.measured * 1.2


def test_a_looser_bound_needs_fewer_moments():
    air = Air((part("mpm93"),), 288.0, 1013.25, 12.8)
    degrees = [
        fit(air, np.array([650e9]), (-1, 1.4), tolerance=t).moments
        for t in (1e-2, 1e-4, 1e-7, 1e-12)
    ]
    assert degrees == sorted(degrees)
    assert degrees[0] < degrees[-1]


def test_the_surrogate_follows_temperature_too():
    air = Air((part("mpm93"),), 290.0, 1000.0, 10.0)
    surrogate = fit(air, np.array([556.9e9, 650e9]), (-0.9, 1.2), (-8, 8), tolerance=1e-6)
    rng = np.random.default_rng(3)
    delta, offset = rng.uniform(-0.9, 1.2, 100), rng.uniform(-8, 8, 100)
    for row, hz in zip(surrogate.absorption(delta, offset), (556.9e9, 650e9), strict=True):
        exact = oracle.absorption_per_m(hz, 290.0 + offset, 1000.0, 10.0 * (1 + delta))
        assert np.max(np.abs(row - exact)) <= surrogate.error * oracle.absorption_per_m(
            hz, 290.0, 1000.0, 10.0
        )
    assert surrogate.error <= 1e-6


def test_vapour_is_limited_to_the_total_pressure():
    """Air of nothing but vapour is the end of the range, and of the fit's."""
    air = Air((part("mpm93"),), 330.0, 200.0, 100.0)
    assert air.absorption(650e9, 50.0) == pytest.approx(
        float(air.absorption(650e9, air.most_vapour))
    )
    assert fit(air, np.array([650e9]), (-1, 50.0), tolerance=1e-6).humidity_span[
        1
    ] == pytest.approx(air.most_vapour)


def test_ranges_of_numbers_include_their_stop():
    assert values("100:1000:1").size == 901
    assert values("0.1:0.5:0.1") == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert values("1,2,5").tolist() == [1, 2, 5]
    for wrong in ("", "a", "1:2", "2:1:1", "1:2:0", "1:2:-1", "nan", "0:1e9:1e-3"):
        with pytest.raises(ValueError, match=r"is not a number|not finite|more than 1,000,000"):
            values(wrong)


def test_the_picture_runs_along_what_has_more_values(tmp_path, monkeypatch):
    """The paper's figure 5, moist and dry on a log scale.

    The slides' attenuation against temperature.
    """
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure.axes[0]))
    for ghz, kelvin in (
        (values("100:1000:10"), np.array([288.15])),
        (np.array([350.0, 650.0]), values("253:313:10")),
    ):
        spectrum_figure.draw(
            spectrum.records(spectrum.states(ghz, kelvin, 1013.25, MOIST, 50.0), part("mpm93")),
            tmp_path,
        )
    frequency, temperature = drawn
    assert (
        frequency.get_xlabel() == "frequency / GHz"
        and temperature.get_xlabel() == "temperature / K"
    )
    assert frequency.get_yscale() == temperature.get_yscale() == "log"
    moist, dry = (line.get_ydata() for line in frequency.lines)
    assert np.min(np.divide(moist, dry)) > 1
    assert [text.get_text() for text in temperature.get_legend().get_texts()] == [
        "350 GHz, 50 % RH",
        "650 GHz, 50 % RH",
        "dry part",
    ]
    assert all(np.all(np.diff(line.get_ydata()) > 0) for line in temperature.lines[::2])
