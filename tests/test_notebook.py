"""thzcl in a notebook: scenes as text and tables, results that show themselves."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
import tomli
from conftest import ROOT

import thzcl
from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.scenario import source

QUICK = (ROOT / "scenarios" / "quick.toml").read_text(encoding="utf-8")
FEW = {"camera.pixels": [8, 6], "atmosphere.fluctuations.seed": 3}


@pytest.mark.parametrize("module", [pipeline, source])
def test_examples_in_docstrings(tmp_path, monkeypatch, module):
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(module)
    assert (failed, tried > 0) == (0, True)


def test_a_scene_as_tables_or_text_is_that_of_the_file():
    """With numbers and arrays of NumPy among the tables."""
    tables = tomli.loads(QUICK)
    tables["camera"]["pixels"] = np.array([8, 6])
    tables["atmosphere"]["fluctuations"]["seed"] = np.int64(3)
    due = thzcl.run("quick", settings=FEW, figure=False)
    text = thzcl.Scene.from_toml(QUICK, name="mine")
    for found in (thzcl.run(tables, figure=False), thzcl.run(text, settings=FEW, figure=False)):
        assert np.array_equal(found.variants[0].image.values, due.variants[0].image.values)
    assert found.scenario == "mine"


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"camera": {"pixels": object()}}, "scene: object is no value of TOML"),
        ({1: {}}, "scene: a key is no text"),
        ({"camera": {"pixels": [1, 2]}}, r"scene: \[camera\] look_at_m: missing"),
    ],
)
def test_tables_that_are_no_scene_are_refused(tables, message):
    """Without a line number, as there are no lines."""
    with pytest.raises(ScenarioError, match=message):
        thzcl.run(tables)


def test_paths_in_a_scene_of_no_file_start_from_a_folder():
    text = (ROOT / "scenarios" / "figure8.toml").read_text(encoding="utf-8")
    few = {"camera.pixels": [8, 6]}
    there = thzcl.Scene.from_toml(text, folder=ROOT / "scenarios")
    assert pipeline.prepare(there, few).variants
    with pytest.raises(ScenarioError, match="phantom"):
        pipeline.prepare(thzcl.Scene.from_toml(text), few)


def test_what_thzcl_offers():
    assert {"Result", "Scene", "open_device", "run"} <= set(dir(thzcl))
