"""Several absorption models beside each other, as spectra, and what is known of which is true."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import oracle
import pytest

from thzcl.__main__ import main
from thzcl.air import composition, spectrum, spectrum_figure, validation
from thzcl.air.validation import CLIMATES, MODELS, WINDOWS_GHZ

MOIST = ("--relative-humidity-percent", "50")


def told(capsys, *arguments):
    """Returns exit code, stdout and stderr of a command."""
    code = main(list(arguments))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def records(capsys, *arguments):
    """Returns the records of an absorption spectrum."""
    code, out, _ = told(capsys, "absorption", *arguments, "--format", "json")
    assert code == 0
    return json.loads(out)["records"]


def test_several_models_give_the_records_of_each_by_name(capsys):
    asked = ("--frequency-ghz", "340,650", "--temperature-k", "270,290", *MOIST)
    both = records(capsys, *asked, "--model", "mpm93", "--model", "r24")
    assert [row.pop("model") for row in both] == ["mpm93"] * 4 + ["r24"] * 4
    for name, rows in (("mpm93", both[:4]), ("r24", both[4:])):
        assert rows == records(capsys, *asked, "--model", name)
    assert both[:4] == records(capsys, *asked)
    two = ("--model", "mpm93", "--model", "r24")
    _, out, _ = told(capsys, "absorption", *asked, *two, "--format", "csv")
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [row["model"] for row in rows] == ["mpm93"] * 4 + ["r24"] * 4
    assert "r24" in told(capsys, "absorption", *asked, *two)[1]


def test_a_model_that_is_not_valid_at_a_frequency_is_left_out_there(capsys):
    """The first is refused instead."""
    asked = ("absorption", "--frequency-ghz", "650,790,850", *MOIST, "--format", "json")
    code, out, err = told(capsys, *asked, "--model", "mpm93", "--model", "r24")
    rows = json.loads(out)["records"]
    assert [row["frequency_ghz"] for row in rows if row["model"] == "r24"] == [650, 790]
    assert code == 0
    assert '"r24" is left out at 1 of 3 frequencies: 850 GHz: "r24" holds up to 800 GHz' in err
    assert '790 GHz: "r24" is stated to 780 GHz' in err
    code, out, err = told(capsys, *asked, "--model", "r24", "--model", "mpm93")
    assert (code, out) == (2, "")
    assert '850 GHz: "r24" holds up to 800 GHz' in err
    asked = ("absorption", "--frequency-ghz", "900", *MOIST, "--format", "json")
    code, out, err = told(capsys, *asked, "--model", "mpm93", "--model", "r24")
    assert [row["model"] for row in json.loads(out)["records"]] == ["mpm93"]
    assert '"r24" is left out: 900 GHz' in err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--frequency-ghz", "650", "--model", "r24", "--model", "r25"), "did you mean r24?"),
        (("--frequency-ghz", "650", "--model", "r24", "--model", "r24"), "each model once"),
        ((), "give --frequency-ghz F, or --validation"),
        (("--validation", "--frequency-ghz", "650"), "--validation has models"),
        (("--validation", "--model", "r24"), "--validation has models"),
        (("--validation", "--figure", "a.doc"), "are written as .png, .pdf or .svg"),
    ],
)
def test_wrong_words_are_explained(capsys, arguments, text):
    code, out, err = told(capsys, "absorption", *arguments)
    assert (code, out) == (2, "")
    assert text in " ".join(err.split())


def test_a_picture_of_several_models_has_their_ratio(tmp_path, monkeypatch):
    """It is that to the first of them, at the frequencies that both hold."""
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    gases = [composition.part(name) for name in ("mpm93", "r24")]
    ghz, moist = np.array([600.0, 700.0, 900.0]), ("vapour_pressure_hpa", 10.0)
    states = spectrum.states(ghz, np.array([290.0]), 1013.25, *moist)
    rows, _ = spectrum.by_model(states, gases)
    spectrum_figure.draw(rows, tmp_path / "a.png")
    above, below = drawn[0].axes
    assert [line.get_label() for line in above.get_lines()] == ["mpm93", "r24"]
    one, other = (np.array(line.get_xydata()) for line in above.get_lines())
    same, ratio = (np.array(line.get_xydata()) for line in below.get_lines())
    assert same[:, 1] == pytest.approx(np.ones(3))
    assert ratio[:, 1] == pytest.approx(other[:, 1] / one[:2, 1])
    assert above.get_title() == "290 K, 52.2 % RH, 1013.25 hPa"


def test_the_windows_are_those_of_the_oracle(capsys):
    """All models in four climates; r24 where it is valid, and its place is empty elsewhere."""
    code, out, _ = told(capsys, "absorption", "--validation", "--format", "json")
    assert code == 0
    rows = json.loads(out)["windows"]
    assert len(rows) == len(CLIMATES) * len(WINDOWS_GHZ)
    for row in rows:
        (climate,) = (one for one in CLIMATES if one.name == row["climate"])
        kelvin, percent = climate
        hz, hpa = row["frequency_ghz"] * 1e9, percent / 100 * oracle.saturation_hpa(kelvin)
        grams = 216.673 * hpa / kelvin
        due = oracle.absorption_per_m(hz, kelvin, 1013.25, grams) * 1e4 / np.log(10)
        assert row["mpm93"] == pytest.approx(float(due), rel=1e-5)
        assert (row["r24"] is None) == (row["frequency_ghz"] > 800)
        values = [row[model] for model in MODELS if row[model] is not None]
        assert row["spread_percent"] == pytest.approx(100 - 100 * min(values) / max(values))
    _, out, _ = told(capsys, "absorption", "--validation", "--format", "csv")
    table = list(csv.DictReader(io.StringIO(out)))
    assert [float(row["p676-13"]) for row in table] == [row["p676-13"] for row in rows]
    text = " ".join(told(capsys, "absorption", "--validation")[1].split())
    for part in ("attenuation, dB/km", "Yang", "O'Hara", "could not be had", "Slocum"):
        assert part in text


def test_the_measured_continuum_is_in_the_units_of_its_source():
    """By hand for 20 degC and 44 %, which are 10.264 hPa of vapour, at 650 GHz."""
    rows = {row["climate"]: row for row in validation.continua()}
    warmth = 296.0 / 293.15
    own = 3.83 * 1.0264**2 * 0.65**2 * warmth**8.8
    foreign = 0.185 * 1.0264 * (101.325 - 1.0264) * 0.65**2 * warmth**5.7
    found = rows["20 °C, 44 % RH"]
    assert found["measured_db_km"] == pytest.approx(own + foreign, rel=1e-3)
    assert found["r24_db_km"] == pytest.approx(14.5116, rel=3e-5)
    assert list(rows) == [climate.name for climate in CLIMATES[1:]]  # it is of 293 to 333 K
    assert all(row["r24_db_km"] > row["measured_db_km"] for row in rows.values())


def test_the_picture_shows_four_climates(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    assert main(["absorption", "--validation", "--figure", str(tmp_path / "a.png")]) == 0
    axes = drawn[0].axes
    assert [one.get_title() for one in axes if one.get_title()] == [c.name for c in CLIMATES]
    assert all(len(one.get_lines()) == len(MODELS) for one in axes)
