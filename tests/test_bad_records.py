"""What is no usable record: one message naming file, line and column, and what was expected.

Exit code 2; no figure.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from hygrometer import RECORD, synthetic, write_csv

from thzcl.errors import RecordError
from thzcl.records.study import study

LINES = RECORD.read_text().splitlines(keepends=True)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A sound record: names and columns."""
    path, _, _ = synthetic(
        tmp_path_factory.mktemp("plain") / "a.csv", 1, samples=3000, gaps=0, spikes=0
    )
    names = path.read_text().split("\n", 1)[0].split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def text(change):
    """The shipped record's first lines.

    Changed one by one by a function of the line and its number from 1.
    """
    return "".join(
        change(line, number) for number, line in enumerate(LINES[:3000], start=1)
    ).encode()


def cell(line, at, value):
    cells = line.rstrip("\n").split(",")
    cells[at] = value
    return ",".join(cells) + "\n"


FILES = {
    "empty": (
        b"",
        r"bad\.dat:1: empty; expected Campbell TOA5, CSV with a header, or a LI-COR GHG archive",
    ),
    "binary": (bytes(range(256)) * 40, r"bad\.dat:1: binary, not text; expected"),
    "broken archive": (b"PK\3\4" + bytes(100), r"bad\.dat: a broken archive"),
    "header alone": (
        "".join(LINES[:4]).encode(),
        r"bad\.dat:5: empty below its header; expected rows with TIMESTAMP, h2o",
    ),
    "header cut": (
        "".join(LINES[:2]).encode(),
        r"bad\.dat:3: column 10: 10 names of columns and 0 units; expected as many",
    ),
    "truncated row": (
        text(lambda line, n: line if n < 2900 else line[:40] + "\n"),
        (
            r"bad\.dat:2900: column \d+: \d columns, expected the header's 10, here and in 100 "
            r"other rows; rows cut short\?"
        ),
    ),
    "comma decimals": (
        text(lambda line, n: line.replace(".", ",") if n > 4 else line),
        (
            r"bad\.dat:5: column 10: 1\d columns, expected the header's 10, here and in \d+ other "
            r"rows; a comma for a decimal point\?"
        ),
    ),
    "words": (
        text(lambda line, n: cell(line, 6, "wet") if n == 77 else line),
        r'bad\.dat:77: column h2o: "wet" is not a number; expected one with a decimal point',
    ),
    "no stamp": (
        text(lambda line, n: cell(line, 0, '"noon"') if n == 88 else line),
        r'bad\.dat:88: column TIMESTAMP: "noon" is not a time stamp; expected seconds, or one like',
    ),
    "NaN-filled": (
        text(lambda line, n: cell(line, 6, '"NAN"') if n > 4 else line),
        r"bad\.dat:5: column h2o: 100 % of its values are missing; expected 20% at most",
    ),
    "unknown unit": (
        text(lambda line, n: line.replace('"g/m^3"', '"furlong"') if n == 3 else line),
        r'bad\.dat:2: column h2o: unknown unit "furlong"; expected one of g/m3',
    ),
    "wrong unit": (
        text(lambda line, n: line.replace('"g/m^3"', '"kg/m^3"') if n == 3 else line),
        (
            r"bad\.dat:5: column h2o: 2996 of 2996 values cannot be of air in kg/m\^3, such as "
            r"8.78811 here: is its unit right\? In g/m3 or"
        ),
    ),
    "no humidity": (
        text(lambda line, n: line.replace('"h2o"', '"ch4"') if n == 2 else line),
        (
            r"bad\.dat:2: expected a column of water vapour \(h2o\) in g/m3 or mmol/m3, as a mole "
            r"fraction, a mixing ratio or relative humidity; there are TIMESTAMP"
        ),
    ),
    "too short": (
        "".join(LINES[:504]).encode(),
        r"bad\.dat:504: column TIMESTAMP: ends after 500 samples; the spectrum needs at least 1024",
    ),
    "decreasing time": (
        "".join(LINES[:4] + LINES[2999:3:-1]).encode(),
        (
            r"bad\.dat:6: column TIMESTAMP: time goes backwards here and in \d+ other rows; "
            r"expected ascending"
        ),
    ),
    "minutes for a rate": (
        text(
            lambda line, n: (
                re.sub(r"12:(\d\d):(\d\d)\.?\d*", r"12:\1:\2", line)
                if n < 5
                else cell(
                    line, 0, f'"2012-06-{1 + n // 1000:02d} {n // 60 % 24:02d}:{n % 60:02d}:00"'
                )
            )
        ),
        r"samples a second; expected 0.5 to 100: .*Means over minutes hold no turbulence",
    ),
    "Campbell binary": (
        b'"TOB1","6843","CR3000"' + bytes(range(256)),
        r"bad\.dat:1: Campbell binary \(TOB\), not text; convert it to TOA5 with LoggerNet",
    ),
    "NetCDF": (
        b"\x89HDF" + bytes(200),
        r"bad\.dat:1: HDF5 or NetCDF, not text; write it as CSV",
    ),
    "broken gzip": (b"\x1f\x8b\x08" + bytes(60), r"bad\.dat: a broken gzip file .*copy it again"),
}


@pytest.mark.parametrize("case", FILES)
def test_each_bad_file_has_its_message(tmp_path, case):
    content, expected = FILES[case]
    (tmp_path / "bad.dat").write_bytes(content)
    with pytest.raises(RecordError, match=expected) as caught:
        study([tmp_path / "bad.dat"], output=tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_all_problems_of_a_header_are_told_at_once(tmp_path):
    (tmp_path / "bad.csv").write_text("h2o\n" + "9.1\n" * 2000)
    with pytest.raises(RecordError) as caught:
        study([tmp_path / "bad.csv"])
    time, wind = caught.value.problems
    assert "expected a column of time stamps; there are h2o" in time and "--rate-hz" in time
    assert "expected columns of wind" in wind and "--columns Ux=NAME,Uy=NAME or speed=NAME" in wind


ARRAYS = {
    "constant": (
        lambda _: {"h2o_g_m3": np.full(3000, 9.0)},
        r"column h2o_g_m3: holds 9 throughout; expected a signal",
    ),
    "zero wind": (
        lambda _: {"Ux_m_s": np.zeros(3000), "Uy_m_s": np.zeros(3000)},
        r"mean wind of 0 m/s; expected at least 0.1",
    ),
    "mixed rate": (
        lambda c: {"time_s": np.where(c["time_s"] < 75, c["time_s"], 75 + (c["time_s"] - 75) * 2)},
        (
            r"bad\.csv:150\d: column time_s: steps of 0.1 s from here on, 0.05 s elsewhere; "
            r"expected one rate"
        ),
    ),
    "half missing": (
        lambda c: {"time_s": np.where(c["time_s"] < 75, c["time_s"], c["time_s"] + 200)},
        r"bad\.csv:1502: column time_s: \d+ of \d+ samples are missing",
    ),
    "a slow logger": (
        lambda c: {"time_s": c["time_s"] * 1000},
        r"0.02 samples a second; expected 0.5 to 100: is its time in ms\?",
    ),
    "negative": (
        lambda c: {"h2o_g_m3": -c["h2o_g_m3"]},
        r"bad\.csv:2: column h2o_g_m3: 3000 of 3000 values cannot be of air in g/m3",
    ),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_each_unusable_signal_has_its_message(tmp_path, plain, case):
    change, expected = ARRAYS[case]
    path = write_csv(tmp_path / "bad.csv", plain | change(plain))
    with pytest.raises(RecordError, match=expected):
        study([path])


@pytest.mark.parametrize(
    "signal",
    [
        lambda _: 9 + 0.1 * np.random.default_rng(1).standard_normal(3000),
        lambda time: 9 + np.sin(time),
    ],
    ids=["white noise", "a sine"],
)
def test_a_sound_signal_without_an_inertial_range_has_a_slope_and_no_constant(
    tmp_path, plain, signal
):
    path = write_csv(tmp_path / "a.csv", plain | {"h2o_g_m3": signal(plain["time_s"])})
    found = study([path])
    assert found["structure_constant_q"] is found["outer_scale_m"] is None
    assert np.isfinite([found["slope"], found["slope_uncertainty"]]).all()
    assert any("no inertial range" in note for note in found["notes"])
    with pytest.raises(RecordError, match="no scene without a structure constant"):
        study([path], scene=tmp_path / "scene.toml")


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ("h2o=vapour", r"--columns h2o=vapour: no such column; there are time_s, h2o_g_m3"),
        (
            "moisture=h2o_g_m3",
            r"--columns moisture=h2o_g_m3: write ROLE=NAME or ROLE=NAME:UNIT, with a role of time",
        ),
        ("h2o=h2o_g_m3:cubits", r'column h2o_g_m3: unknown unit "cubits"; expected one of'),
    ],
)
def test_columns_named_wrongly(tmp_path, plain, columns, expected):
    path = write_csv(tmp_path / "a.csv", plain)
    with pytest.raises(RecordError, match=expected):
        study([path], columns)


def test_the_command_says_it_and_stops(tmp_path, thzcl_command):
    (tmp_path / "bad.dat").write_bytes(b"")
    for arguments, expected in (
        (("bad.dat",), "bad.dat:1: empty"),
        (("none.dat",), "none.dat: No such file"),
    ):
        done = thzcl_command("fluctuations", *arguments, "-o", "out", "--scene", "scene.toml")
        assert done.returncode == 2
        assert done.stderr.startswith(expected) and done.stderr.count("\n") == 1
        assert not done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["bad.dat"]
