"""Tables: one renderer for the terminal, one for CSV, one for JSON, and all of them fit."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import pty
import re
import subprocess
import sys
from functools import partial

import hygrometer
import pytest
from conftest import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scene, write

from thzcl.air.composition import HOOK as CONSTITUENTS
from thzcl.commands import app, tables, terminal
from thzcl.commands.tables import (
    LONGEST_WORD,
    Column,
    Table,
    as_csv,
    as_records,
    from_records,
    show,
    show_json,
)
from thzcl.scenario.sensors import HOOK as SENSORS
from thzcl.studies.stress import trial

MIXED = Table(
    "[sensor] kinds",
    (Column("name"), Column("NEP", "W", ".2g"), Column("note")),
    (("[bold]one[/bold]", 3e-11, "a; b"), ("two", None, "x" * 40)),
)
WORDS = st.text("abcdefgh_[]/:", min_size=1, max_size=LONGEST_WORD)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**12), 10**12)


@pytest.fixture
def printed(monkeypatch, capsys):
    """What is shown where there are so many columns."""

    def call(columns, *tables):
        monkeypatch.setenv("COLUMNS", str(columns))
        show(*tables)
        return capsys.readouterr().out

    return call


def test_a_table_is_the_same_in_every_form(printed):
    rows = list(csv.reader(io.StringIO(as_csv(MIXED))))
    assert rows[0] == ["name", "NEP", "note"]
    assert rows[1:] == [["[bold]one[/bold]", "3e-11", "a; b"], ["two", "", "x" * 40]]
    records = json.loads(json.dumps(as_records(MIXED)))
    assert records[0] == {"name": "[bold]one[/bold]", "NEP": 3e-11, "note": "a; b"}
    assert records[1]["NEP"] is None
    shown = printed(100, MIXED)
    for word in ("[sensor] kinds", "NEP / W", "[bold]one[/bold]", "3e-11", "a; b", "x" * 40):
        assert word in shown


def test_records_become_a_table_and_records_again():
    records = [{"a": 1.5, "b": "x"}, {"a": None, "b": "y"}]
    assert as_records(from_records(records)) == records


def test_numbers_stand_to_the_right_and_text_to_the_left(printed):
    table = Table("", (Column("n"), Column("text")), ((1, "40 m"), (1000, "8 m")))
    lines = printed(60, table).splitlines()
    assert [line.rstrip() for line in lines[-3:-1]] == ["    1  40 m", " 1000  8 m"]


def test_an_empty_table_is_not_shown(printed):
    assert printed(80, Table("nothing", (Column("a"),), ())) == ""


@settings(deadline=None)
@given(
    names=st.lists(st.lists(WORDS, min_size=1, max_size=4).map(" ".join), min_size=3, max_size=7),
    width=st.integers(60, 120),
    data=st.data(),
)
def test_no_table_is_wider_than_it_may_be_and_no_short_word_or_number_is_broken(names, width, data):
    cells = [
        data.draw(st.lists(WORDS, min_size=1, max_size=6).map(" ".join)),
        *(data.draw(NUMBERS) for _ in names[1:]),
    ]
    columns = (Column(names[0]), *(Column(name, form=".6g") for name in names[1:]))
    table = Table("", columns, (tuple(cells),))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", str(width))
        out = io.StringIO()
        patch.setattr(sys, "stdout", out)
        show(table)
    assert max(map(len, out.getvalue().splitlines())) <= width
    shown = out.getvalue().split()
    for word in (*cells[0].split(), *(f"{number:.6g}" for number in cells[1:])):
        assert word in shown


def test_a_table_too_wide_is_cut_and_its_keys_are_repeated(printed):
    columns = tuple(Column(name * 20) for name in "abcdef")
    row = tuple(name.upper() * 20 for name in "abcdef")
    shown = printed(80, Table("", columns, (row,), keys=2))
    assert shown.count("A" * 20) == shown.count("B" * 20) == shown.count("b" * 20) == 4
    assert [shown.count(name * 20) for name in "CDEF"] == [1, 1, 1, 1]


def test_a_heading_is_folded_before_a_cell_is(printed):
    table = Table("", (Column("a b c d e f"), Column("note")), (("x y z", "1 2 3 4 5 6 7 8"),))
    shown = printed(26, table)
    assert "x y z" in shown
    assert "1 2 3 4 5 6 7 8" in shown
    assert "a b c d e f" not in shown


TINY = ("--set", "camera.pixels=[8,8]", "--set", "atmosphere.fluctuations.grid=16")
COMPARED = ("--set", 'atmosphere.compare=["r24"]')
HAZE = ("--rain-mm-h", "5", "--fog-g-m3", "0.1", "--snow-mm-h", "1")
COMMANDS = {
    "run-several-frequencies": (
        "run", "quick", "--no-figure", *TINY, *COMPARED, "--set", "sensor.frequency_ghz=[340,650]",
    ),
    "run-active": ("run", "figure9", "--no-figure", *TINY, *COMPARED),
    "check": ("check", "figure6"),
    "plan": ("plan", "figure7"),
    "plan-sky-and-meshes": ("plan", "vehicle"),
    "absorption": ("absorption", "--frequency-ghz", "340"),
    "absorption-of-all": (
        "absorption", "--frequency-ghz", "340,650", "--relative-humidity-percent", "50",
        "--model", "mpm93", "--model", "r24", *HAZE,
    ),
    "absorption-validation": ("absorption", "--validation"),
    "fluctuations": (
        "fluctuations", "record.csv", "--height-m", "3", "--batch-minutes", "3",
        "--second", "other.csv", "--separation-m", "1",
    ),
    "study": ("study", "quick", *TINY, "-o", "study", "--seeds", "2"),
    "range": ("range", "range.toml", "--target", "box", "--ranges", "20,40", "--air", "10",
              "--seed", "1", "--frequency-ghz", "340,650"),
    "convergence": ("convergence", "quick", *TINY, "--knobs", "stride,march", "--repeat", "1"),
    "stress": ("stress",),
    "bench": ("bench", "quick", *TINY, "--repeat", "1"),
    "sensors": ("sensors",),
    **{name: ("sensors", name) for name in SENSORS.built_ins},
    "constituents": ("constituents",),
    **{name: ("constituents", name) for name in CONSTITUENTS.built_ins},
    "materials": ("materials",),
    **{name: ("materials", name) for name in ("water", "steel", "glass")},
    "scenarios": ("scenarios",),
    "devices": ("devices",),
    "doctor": ("doctor",),
}  # fmt: skip
WITHOUT_TABLES = {"report", "new", "new-sensor", "new-constituent", "schema"}


@pytest.fixture
def shown_by(tmp_path, monkeypatch, capsys):
    """Runs a command once, and gives back a function of what it shows at a width.

    Paths, which `wrote` tells and which are never folded, are left out.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(trial, "examine", lambda cases, *_: [Outcome(one) for one in cases])
    hygrometer.synthetic(tmp_path / "record.csv", 1, samples=12000)
    hygrometer.synthetic(tmp_path / "other.csv", 2, samples=12000)
    noisy = {"kind": "radiometer", "frequency_ghz": 340.0, "if_center_ghz": 6.0,
             "if_bandwidth_ghz": 4.0, "receiver_temperature_k": 3000.0,
             "integration_time_s": 1e-3}  # fmt: skip
    data = scene(camera__pixels=[8, 8], atmosphere__fluctuations__grid=16, sensor=noisy)
    write(tmp_path, data).rename(tmp_path / "range.toml")

    def call(arguments):
        told = []
        with monkeypatch.context() as patch:
            for module, name in ((tables, "show"), (terminal, "note"), (terminal, "page")):
                patch.setattr(module, name, partial(_kept, told, getattr(module, name)))
            assert app.call(arguments) == 0
        assert told or arguments[0] == "check"

        def at(columns):
            monkeypatch.setenv("COLUMNS", str(columns))
            capsys.readouterr()
            for printer, of in told:
                printer(*of)
            return capsys.readouterr().out

        return at

    return call


def _kept(told, printer, *of):
    told.append((printer, of))


class Outcome:
    """Of a stress case that was not run."""

    def __init__(self, case):
        self.name = case.name

    def record(self):
        """What the command shows of it."""
        numbers = {
            "measured": 1.23456e-300,
            "reference": 1.23456e-300,
            "error": 1e-7,
            "bound": 1e-6,
        }
        return {"name": self.name, **numbers, "passed": True}


@pytest.mark.parametrize("name", COMMANDS)
def test_what_a_command_shows_fits_every_width_and_loses_no_letter(shown_by, name):
    """Where a table is cut, its keys' letters come more often."""
    shown = shown_by(COMMANDS[name])
    wide = shown(2000)
    for columns in (80, 100, 200):
        lines = shown(columns).splitlines()
        assert max(map(len, lines), default=0) <= columns
        found = "".join(lines)
        for letter in set(wide) - set(" \n─"):
            assert found.count(letter) >= wide.count(letter), letter


def test_every_command_that_shows_a_table_is_among_them():
    assert {arguments[0] for arguments in COMMANDS.values()} | WITHOUT_TABLES == {*app.COMMANDS}


def test_several_frequencies_have_a_row_each_and_two_ways_say_so(shown_by):
    passive = shown_by(COMMANDS["run-several-frequencies"])(2000)
    for ghz in ("340", "650"):
        assert len(re.findall(rf"^ quick +{ghz}  box ", passive, re.MULTILINE)) == 3  # and 2 models
    assert "path of light" not in passive
    active = shown_by(COMMANDS["run-active"])(2000)
    assert "contrast to air" not in active  # there is none
    rows = [line for line in active.splitlines() if " subject " in line]
    assert len(rows) == 8 * 3
    assert all(line.rstrip().endswith("  out and back") for line in rows)


def test_commands_obey_the_width_that_they_are_given(thzcl_command):
    for columns in (80, 200):
        lines = thzcl_command("scenarios", env={"COLUMNS": str(columns)}).stdout.splitlines()
        assert max(map(len, lines)) == columns


def test_in_a_pipe_nothing_is_folded(thzcl_command, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    lines = thzcl_command("scenarios").stdout.splitlines()
    assert max(map(len, lines)) > 150


def test_notes_are_folded_at_words(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    terminal.note("note: " + "word " * 30 + "/a/path/" + "x" * 50)
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 40 for line in lines if "/a/path" not in line)
    assert lines[-1].strip() == "/a/path/" + "x" * 50
    assert " ".join(line.strip() for line in lines).count("word") == 30


def test_a_manual_page_is_folded_but_not_its_indented_lines(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "40")
    terminal.page("title\n=====\n\n" + "word " * 30 + "\n\n    " + "code " * 20)
    title, rule, _, *rest = capsys.readouterr().out.splitlines()
    assert (title, rule) == ("title", "=====")
    assert all(len(line) <= 40 for line in rest[:-1])
    assert rest[-1] == "    " + "code " * 20


def test_progress_shows_its_bar_on_a_terminal_as_it_is():
    """The bar's brackets are no markup."""
    code = (
        "import time\n"
        "from thzcl.commands.terminal import progress\n"
        "with progress() as tell:\n"
        "    tell('[#####...............] 5 of 20: trace'); time.sleep(0.5)"
    )
    ours, theirs = pty.openpty()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "80"}
    with subprocess.Popen([sys.executable, "-c", code], stderr=theirs, env=environment) as child:
        child.wait(60)
    os.close(theirs)
    shown = b""
    while chunk := _read(ours):
        shown += chunk
    os.close(ours)
    assert b"[#####...............] 5 of 20: trace" in shown


def _read(terminal_end):
    """What a terminal was sent; nothing once its other end is closed."""
    try:
        return os.read(terminal_end, 65536)
    except OSError:
        return b""


def test_json_has_no_nan(capsys):
    show_json({"a": [1.0, math.nan, {"b": (-math.inf, "x", None, True)}]})
    assert json.loads(capsys.readouterr().out) == {"a": [1.0, None, {"b": [None, "x", None, True]}]}
