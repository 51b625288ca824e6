"""How one starts: a scene to copy, its schema for editors, completion, the version."""

from __future__ import annotations

import json

import jsonschema
import pytest
import tomli
from conftest import ROOT

from thzcl.pipeline import prepare
from thzcl.results.versions import VERSION
from thzcl.scenario.manual import scenario_schema
from thzcl.scenario.source import shipped


def test_the_version(thzcl_command):
    assert thzcl_command("--version").stdout == f"thzcl {VERSION}\n"


@pytest.mark.parametrize("name", list(shipped()))
def test_every_shipped_scene_can_be_started_from(tmp_path, thzcl_command, name):
    """With the pictures that it names, and a schema that holds it; nothing is overwritten."""
    file = tmp_path / "mine.toml"
    assert thzcl_command("new", str(file), "--from", name).returncode == 0
    text = file.read_text(encoding="utf-8")
    assert text.startswith("#:schema ./thzcl.schema.json\n")
    assert text.endswith(thzcl_command("scenarios", name).stdout)
    assert prepare(file).variants
    schema = json.loads((tmp_path / "thzcl.schema.json").read_text(encoding="utf-8"))
    assert schema["$id"] == "urn:thzcl:scenario"
    jsonschema.validate(tomli.loads(text), schema)
    again = thzcl_command("new", str(file), "--from", name)
    assert (again.returncode, "exists already" in again.stderr) == (2, True)
    assert file.read_text(encoding="utf-8") == text


def test_a_schema_of_somebody_elses_is_left_alone(tmp_path, thzcl_command):
    other = tmp_path / "thzcl.schema.json"
    other.write_text("{}", encoding="utf-8")
    done = thzcl_command("new", str(tmp_path / "a.toml"))
    assert (done.returncode, "is not thzcl's" in done.stderr) == (2, True)
    assert [path.name for path in tmp_path.iterdir()] == [other.name]


def test_a_mistyped_scene_gets_a_suggestion(tmp_path, thzcl_command):
    for command in (("scenarios", "figur6"), ("new", str(tmp_path / "a.toml"), "--from", "figur6")):
        done = thzcl_command(*command)
        assert (done.returncode, "figure6" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("changes", "path"),
    [
        ({"sensor": {"kind": "activ"}}, ["sensor", "kind"]),
        (
            {"sensor": {"kind": "passive-spectral", "frequency_ghz": "x"}},
            ["sensor", "frequency_ghz"],
        ),
        ({"targets": {"box": {"kind": "bx"}}}, ["targets", "box", "kind"]),
        ({"targets": {"box": {}}}, ["targets", "box"]),
    ],
)
def test_the_schema_names_the_key_that_is_wrong(changes, path):
    """As an editor shows it: not that a table is none of several kinds."""
    data = tomli.loads((ROOT / "scenarios" / "quick.toml").read_text(encoding="utf-8")) | changes
    found = list(jsonschema.Draft202012Validator(scenario_schema()).iter_errors(data))
    assert [list(error.absolute_path) for error in found] == [path]


@pytest.mark.parametrize(
    ("shell", "asked"),
    [
        ("bash", {"COMP_WORDS": "thzcl {}", "COMP_CWORD": "{n}"}),
        ("zsh", {"_TYPER_COMPLETE_ARGS": "thzcl {}"}),
        ("fish", {"_TYPER_COMPLETE_ARGS": "thzcl {}", "_TYPER_COMPLETE_FISH_ACTION": "get-args"}),
    ],
)
@pytest.mark.parametrize(
    ("words", "offered"),
    [("fluc", "fluctuations"), ("run figure", "figure6"), ("plan sc", "scene.toml")],
)
def test_shells_complete(tmp_path, monkeypatch, thzcl_command, shell, asked, words, offered):
    """Commands, shipped scenes, and one's own."""
    (tmp_path / "scene.toml").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("_THZCL_COMPLETE", f"complete_{shell}")
    for name, text in asked.items():
        monkeypatch.setenv(name, text.format(words, n=len(words.split())))
    done = thzcl_command()
    assert (done.returncode, done.stderr) == (0, "")
    assert offered in done.stdout
