"""TOML text: the line of every key, and what cannot stand in it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import tomli
from scenes import PLAIN, scene, write

from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.scenario import document, text
from thzcl.scenario.lines import line_numbers

# What a reader that does not know where values end would take for keys and tables; the number of
# each line that a key stands on is in its comment.
TRAPS = r'''a = """1
[no]
no = 1
""\"""" # 4
b = [ # 5
  [650], # 6
  { c = 1, d.e = [ "]", # 7
    1979-05-27 07:32:00.5 ] }, # 8
  # ] no = """ 9
] # 10
"f # = ['" = 'no = """' # 11
[ g . "\u00e9" ] # 12
h.i = -1.5e+3 # 13
[[j]] # 14
k = """x""""" # 15
[j.l] # 16
[[j]] # 17
[[j.m]] # 18
[[j.m]] # 19
n = QUOTES''x'
no = 1
''QUOTES
o = 2 # 23
'''.replace("QUOTES", "'''")
KEYS = {
    1: [("a",)],
    5: [("b",)],
    6: [("b", 0)],
    7: [("b", 1), ("b", 1, "c"), ("b", 1, "d"), ("b", 1, "d", "e")],
    8: [("b", 1, "d", "e", 1)],
    11: [("f # = ['",)],
    12: [("g",), ("g", "é")],
    13: [("g", "é", "h"), ("g", "é", "h", "i")],
    14: [("j",), ("j", 0)],
    15: [("j", 0, "k")],
    16: [("j", 0, "l")],
    17: [("j", 1)],
    18: [("j", 1, "m"), ("j", 1, "m", 0)],
    19: [("j", 1, "m", 1)],
    20: [("j", 1, "m", 1, "n")],
    23: [("j", 1, "m", 1, "o")],
}


def refused(file, settings=None):
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(file, settings)
    return caught.value.problems


def test_every_key_is_known_by_its_line():
    assert tomli.loads(TRAPS)  # it is TOML
    assert line_numbers(TRAPS) == {path: line for line, paths in KEYS.items() for path in paths}


ARRAY = """\
[sensor]
frequency_ghz = [
  340,
  [650],
]
frequncy_ghz = 650
"""
STRING = '''\
[[variants]]
name = """
[sensor]
frequncy_ghz = 3
"""
[sensor]
frequncy_ghz = 650
'''


@pytest.mark.parametrize(("body", "line"), [(ARRAY, 6), (STRING, 7)], ids=["array", "string"])
def test_a_mistake_after_an_array_or_a_string_is_told_at_its_line(tmp_path, body, line):
    (tmp_path / "trap.toml").write_text(body + 'kind = "passive-spectral"\n', encoding="utf-8")
    (told,) = (one for one in refused(tmp_path / "trap.toml") if "frequncy_ghz" in one)
    assert f"trap.toml:{line}: [sensor] frequncy_ghz: unknown key" in told


def test_toml_is_written_as_it_is_read():
    for data in (
        PLAIN,
        scene(variants=[{"name": 'q"uote\n', "set": {"a.b": [1, 2.5, "x"], "c": True}}]),
    ):
        assert tomli.loads(text.dumps(data)) == data


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("a = " + "[" * 2000 + "]" * 2000, "stand more than 16 deep in each other"),
        ("a = " + "[" * 17 + "]" * 17, "stand more than 16 deep in each other"),
        (".".join("a" * 2000) + " = 1", "stand more than 16 deep in each other"),
        ("a = " + "9" * 5000, "a whole number has more than 64 bits"),
        ("a = 9223372036854775808", "a whole number has more than 64 bits"),
    ],
    ids=["lists", "a few lists", "parts of a key", "digits", "one bit"],
)
def test_deep_or_long_toml_is_refused_in_words(tmp_path, body, expected):
    (tmp_path / "deep.toml").write_text(body, encoding="utf-8")
    assert expected in refused(tmp_path / "deep.toml")[0]


def test_none_removes_a_key(tmp_path):
    file = write(tmp_path, PLAIN)
    settings = {"atmosphere.fluctuations.seed": None, "atmosphere.no_table.key": None}
    data = document.read(file, settings).data
    assert data["atmosphere"]["fluctuations"].pop("seed") != 3  # another is drawn
    noise_seed = data["numerics"]["noise_seed"]  # which no longer follows the air's
    due = scene(atmosphere__fluctuations__seed=None, numerics={"noise_seed": noise_seed})
    assert data == due
    again = tmp_path / "again.toml"  # the stored text can be run again
    again.write_text(pipeline.prepare(file, settings).scenario.text, encoding="utf-8")
    assert pipeline.prepare(again).scenario.seed > 0
    assert "frequency_ghz: missing" in refused(file, {"sensor.frequency_ghz": None})[0]


def test_settings_may_be_numpys(tmp_path):
    settings = {
        "atmosphere.fluctuations.seed": np.int64(3),
        "camera.pixels": np.array([8, 4]),
        "camera.position_m": (np.float32(0.5), np.float64(0.25), 5),
        "sensor.frequency_ghz": np.linspace(300, 400, 3),
        "output": {"save_field": np.True_, "difference": None},
    }
    plan = pipeline.prepare(write(tmp_path, PLAIN), settings)
    (variant,) = plan.variants
    assert variant.scene.camera.pixels == (8, 4)
    assert variant.scene.camera.position_m == (0.5, 0.25, 5.0)
    assert variant.scene.output.save_field is True
    assert plan.frequency_hz.tolist() == [300e9, 350e9, 400e9]
    assert tomli.loads(plan.scenario.text)["sensor"]["frequency_ghz"] == [300.0, 350.0, 400.0]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (object(), "object is no value of TOML"),
        ([1, None], "NoneType is no value of TOML"),
        ({1: 2}, "a key is no text"),
        (2**63, "a whole number has more than 64 bits"),
        (10**5000, "a whole number has more than 64 bits"),
        (functools.reduce(lambda inner, _: [inner], range(5000), 0), "stand more than 16 deep"),
    ],
    ids=["object", "None", "key", "a bit", "digits", "lists"],
)
def test_a_setting_that_toml_cannot_hold_is_refused(tmp_path, value, expected):
    told = refused(write(tmp_path, PLAIN), {"camera.pixels": value})
    assert told[0].startswith("--set camera.pixels: ") and expected in told[0]


def test_a_setting_of_many_parts_is_refused(tmp_path):
    told = refused(write(tmp_path, PLAIN), {".".join("a" * 2000): 1})
    assert "a key of 2000 parts; no key has more than 16" in told[0]
