"""Studies of many scenes: the grid, what is shared, what survives a crash, and what is refused."""

from __future__ import annotations

import csv
import errno
import json
import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import ROOT
from scenes import scene, write

import thzcl
from thzcl import pipeline
from thzcl.errors import ScenarioError, UsageError
from thzcl.graph import everything
from thzcl.paths.specs import TraceSpec
from thzcl.plan.plan import join
from thzcl.scenario import document as documents
from thzcl.studies.many import grid, placing
from thzcl.studies.many.members import spawned
from thzcl.studies.many.store import Store
from thzcl.studies.many.study import described

RANGE = "targets.box.range_m"
HUMID = "atmosphere.relative_humidity_percent"
SMALL = {"camera__pixels": [16, 12], "numerics": {"error_budget": False}}


def rows(folder):
    with (folder / "index.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def numbers(folder):
    """The rows without the seconds, which are never the same."""
    return [{k: v for k, v in row.items() if k != "seconds"} for row in rows(folder)]


def small(tmp_path, **changes):
    return write(tmp_path, scene(**(SMALL | changes)))


def members(source, **asked):
    return described(
        source, asked.get("over", {}), asked.get("seeds"), 3, None, (), None, "over",
        allow_outside=False,
    )  # fmt: skip


def test_values_are_lists_ranges_and_pairs():
    over = grid.from_options(
        ["x=1,2.5,on", "r=10:30:10", "f = 0.1:0.3:0.1", 'a , b=1:[1,2],2:"c,d"', "v=[1,2],[3,4]"]
    )
    axes = grid.axes(over, "--over")
    assert [axis.keys for axis in axes] == [("x",), ("r",), ("f",), ("a", "b"), ("v",)]
    points = [axis.points for axis in axes]
    assert points[0] == ((1,), (2.5,), ("on",))
    assert points[1] == ((10,), (20,), (30,)) and all(type(p[0]) is int for p in points[1])
    assert [p[0] for p in points[2]] == pytest.approx([0.1, 0.2, 0.3])
    assert points[3] == ((1, [1, 2]), (2, "c,d"))
    assert points[4] == (([1, 2],), ([3, 4],))
    assert grid.size(axes) == 3 * 3 * 3 * 2 * 2
    first, second, *_ = grid.points(axes)
    assert first == {"x": 1, "r": 10, "f": pytest.approx(0.1), "a": 1, "b": [1, 2], "v": [1, 2]}
    assert second == first | {"v": [3, 4]}
    table = grid.axes({"a,b": [[1, 2], [3, 4]], "v": [[1, 2], [3, 4]], "r": "1:2:1"}, "over")
    assert [axis.points for axis in table] == [
        ((1, 2), (3, 4)), (([1, 2],), ([3, 4],)), ((1,), (2,)),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["camera.pixels="], "no values"),
        (["camera.pixels"], "write key=values"),
        (["a,b=1:2,3"], "1 of 2 values in 3"),
        (["a=1,,2"], "an empty value"),
        (["a=3:1:1"], "start <= stop"),
        (["a=1,2", "a,b=1:2"], "varied twice"),
        (["a=1,2", "a=3"], "is there already"),
    ],
)
def test_axes_that_make_no_sense_are_refused(options, words):
    with pytest.raises(UsageError, match=words):
        grid.axes(grid.from_options(options), "--over")


def test_a_target_moves_along_its_line_and_the_camera_follows():
    camera = {"position_m": [1.0, -2.0, 4.0], "focal_length_mm": 30.0}
    target = {"center_m": [25.0, 7.0, 1.0]}
    moved = placing.at_range(camera, target, "box", 60.0, True)
    there = np.array(moved["targets.box.center_m"])
    assert np.linalg.norm(there - camera["position_m"]) == pytest.approx(60.0)
    assert there[2] == 1.0
    away, before = there[:2] - [1.0, -2.0], np.array([24.0, 9.0])
    assert np.cross(np.r_[away, 0], np.r_[before, 0])[2] == pytest.approx(0.0, abs=1e-9)
    assert moved["camera.look_at_m"] == moved["targets.box.center_m"]
    own = math.dist(camera["position_m"], target["center_m"])
    assert moved["camera.focal_length_mm"] == pytest.approx(30 * 60 / own)
    for range_m, above in ((2.0, [25.0, 7.0, 1.0]), (60.0, [1.0, -2.0, 1.0])):
        with pytest.raises(ValueError, match=r"longer range|move its center_m"):
            placing.at_range(camera, {"center_m": above}, "box", range_m, False)


def test_members_of_a_seed_share_its_air_and_their_trace(tmp_path):
    source = small(tmp_path)
    whole = members(source, over={"sensor.frequency_ghz": "340,650,850"}, seeds=2)
    assert whole.count == 6 and [len(group) for group in whole.groups()] == [3, 3]
    plans = join([whole.plan(whole.member(n)) for n in range(3)])
    specs = everything(spec for plan in plans for spec in plan.batch())
    assert sum(isinstance(spec, TraceSpec) for spec in specs) == 1
    other = whole.plan(whole.member(3)).variants[0]
    assert other.cube.turbulence.seed != plans[0].variants[0].cube.turbulence.seed
    assert other.image.noise.seed == whole.member(3).seed


def test_a_members_seed_depends_on_its_number_alone(tmp_path):
    source = small(tmp_path)
    few, many = (members(source, over={HUMID: "20,40"}, seeds=n) for n in (2, 5))
    assert [few.member(n) for n in range(4)] == [many.member(n) for n in range(4)]
    assert few.name(few.member(3)) == many.name(many.member(3))
    assert few.name(few.member(3)) != few.name(few.member(2))
    seeds = [spawned(7, n) for n in range(1000)]
    assert len({*seeds}) == 1000 and all(0 <= seed < 2**63 for seed in seeds)


def test_the_table_holds_what_single_runs_tell(tmp_path, device):
    source = small(
        tmp_path,
        variants=[{"name": "a"}, {"name": "b", "set": {"camera.position_m": [2.0, 2.0, 4.0]}}],
        atmosphere__compare=["r24"],
        sensor__frequency_ghz=[340.0, 650.0],
    )
    out = tmp_path / "out"
    found = thzcl.study(
        source, out, over={RANGE: [20.0, 30.0], HUMID: [30.0]}, seeds=2, seed=9, device=device
    )
    assert found.members == 4 and found.states == {"done": 4}
    table = rows(out)
    assert list(table[0])[:6] == ["member", RANGE, HUMID, "seed", "state", "seconds"]
    named = {(r["variant"], r["frequency_ghz"], r["model"], r["target"]) for r in table}
    assert {"ground", "box"} <= {target for *_, target in named}
    assert {(v, f, m) for v, f, m, _ in named} == {
        (v, f, m) for v in "ab" for f in ("340.0", "650.0") for m in ("mpm93", "r24")
    }
    picked = [r for r in table if r["member"] == "3" and r["variant"] == "b"]
    seed = int(picked[0]["seed"])
    camera = np.array([2.0, 2.0, 4.0])
    level = np.array([25.0, 7.0, 1.0]) - camera
    level[2] = 0
    centre = camera + level / np.linalg.norm(level) * math.sqrt(30.0**2 - 3.0**2)
    centre[2] = 1.0
    alone = thzcl.run(
        source, variants=["b"], device=device,
        settings={
            HUMID: 30.0, "atmosphere.fluctuations.seed": seed, "numerics.noise_seed": seed,
            "targets.box.center_m": centre.tolist(), "camera.look_at_m": centre.tolist(),
        },
    )  # fmt: skip
    told = alone.summary()["variants"][0]
    for model in ("mpm93", "r24"):
        mine = [r for r in picked if r["model"] == model and r["target"] == "box"]
        mean = np.mean([float(r["mean_contrast_k"]) for r in mine])
        values = told["models"][model]["targets"]["box"]
        assert mean == pytest.approx(values["mean_contrast_k"], rel=1e-6)
        assert {int(r["pixels"]) for r in mine} == {values["pixels"]}


def test_images_are_kept_on_demand(tmp_path, device):
    source = small(tmp_path, study={"over": {HUMID: [20.0, 60.0]}, "keep": "images"})
    out = tmp_path / "out"
    thzcl.study(source, out, device=device)
    kept = sorted((out / "members").glob("*.nc"))
    assert len(kept) == 2
    again = thzcl.run(kept[1], device=device).variants[0].sight.optical_depth
    own = thzcl.run(source, settings={HUMID: 60.0}, device=device).variants[0].sight.optical_depth
    assert again == pytest.approx(own, rel=1e-6)


def test_the_focal_length_follows_if_asked(tmp_path, device):
    source = small(tmp_path)
    counts = {}
    for keep in (False, True):
        out = tmp_path / str(keep)
        asked = {"study.keep_pixels": keep}
        thzcl.study(source, out, over={RANGE: [20.0, 40.0]}, settings=asked, device=device, seed=1)
        counts[keep] = [int(r["pixels"]) for r in rows(out) if r["target"] == "box"]
    assert counts[False][1] < 0.4 * counts[False][0]
    assert counts[True][1] > 0.8 * counts[True][0]


def test_a_bad_scene_marks_its_member_and_the_rest_goes_on(tmp_path, device):
    source, out = small(tmp_path), tmp_path / "out"
    found = thzcl.study(
        source, out, over={HUMID: [-4.0, 50.0], RANGE: [2.0, 25.0]}, seeds=1, device=device
    )
    assert found.states == {"failed": 3, "done": 1}
    messages = [one["message"] for one in found.records()]
    assert "relative_humidity_percent: must be at least 0 %" in messages[1]
    assert "2 m is no more than the 3 m between the heights" in messages[0] + messages[2]
    assert messages[3] == ""
    assert [r["state"] for r in rows(out) if r["target"] in ("", "box")] == [
        "failed", "failed", "failed", "done",
    ]  # fmt: skip


def test_a_hidden_target_is_told_of(tmp_path, device):
    wall = scene()["targets"]["box"] | {
        "center_m": [20.0, 6.0, 2.5], "size_m": [1.0, 40.0, 5.0], "yaw_deg": 18.0,
    }  # fmt: skip
    source = small(tmp_path, targets__wall=wall)
    found = thzcl.study(source, tmp_path / "out", over={RANGE: [10.0, 40.0]}, device=device)
    states = [(one["state"], one["message"]) for one in found.records()]
    assert states[0] == ("done", "")
    assert states[1][0] == "failed" and "box is not in the picture" in states[1][1]


def test_what_is_done_is_not_done_again(tmp_path, device, monkeypatch):
    source, out = small(tmp_path), tmp_path / "out"
    asked = {"over": {HUMID: [20.0, 40.0, 60.0]}, "seeds": 2, "device": device}
    whole = thzcl.study(source, tmp_path / "whole", seed=4, **asked)
    assert whole.states == {"done": 6}

    written = Store.write

    def full(self, name, found):
        if found["member"] == 4:
            raise OSError(errno.ENOSPC, "No space left on device", str(self.members / name))
        written(self, name, found)

    monkeypatch.setattr(Store, "write", full)
    with pytest.raises(OSError, match="No space left"):
        thzcl.study(source, out, seed=4, **asked)
    assert [r["member"] for r in rows(out) if r["target"] == "box"] == ["0", "1", "2", "3"]
    monkeypatch.undo()
    before = {path.name: path.stat().st_mtime_ns for path in (out / "members").iterdir()}
    thzcl.study(source, out, **asked)  # the seed is the folder's
    after = {path.name: path.stat().st_mtime_ns for path in (out / "members").iterdir()}
    assert before.items() <= after.items() and len(after) == 6
    assert numbers(out) == numbers(tmp_path / "whole")
    more = thzcl.study(source, out, **(asked | {"seeds": 3}))
    assert more.states == {"done": 9}


def test_shards_together_are_the_whole(tmp_path, device):
    source = small(tmp_path)
    asked = {"over": {HUMID: [20.0, 40.0, 60.0]}, "seeds": 2, "seed": 4, "device": device}
    thzcl.study(source, tmp_path / "whole", **asked)
    for part in (3, 1, 2):
        thzcl.study(source, tmp_path / "parts", shard=(part, 3), **asked)
    assert numbers(tmp_path / "parts") == numbers(tmp_path / "whole")


def test_a_folder_of_another_study_is_left_alone(tmp_path, device):
    source, out = small(tmp_path), tmp_path / "out"
    thzcl.study(source, out, over={HUMID: [20.0]}, device=device)
    before = (out / "index.csv").read_bytes()
    for asked in ({"over": {HUMID: [30.0]}}, {"over": {HUMID: [20.0]}, "seeds": 2}):
        with pytest.raises(UsageError, match="holds another study"):
            thzcl.study(source, out, device=device, **asked)
    assert (out / "index.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({}, "nothing is varied"),
        ({"over": {"atmosphere.humid": [3.0]}}, "humid: unknown key"),
        ({"over": {"sensor.colour": [3.0]}}, "colour"),
        ({"over": {"targets.bx.range_m": [3.0]}}, "did you mean box"),
        ({"over": {HUMID: []}}, "no values"),
        ({"seeds": 1_000_001}, "1000001 members; say --yes"),
        ({"seeds": 2, "shard": (0, 2)}, "from 1 to n"),
        ({"seeds": 2, "keep": "all"}, "must be"),
    ],
)
def test_what_is_no_study_is_refused_before_anything_is_written(tmp_path, asked, words):
    out = tmp_path / "out"
    with pytest.raises((UsageError, ScenarioError), match=words):
        thzcl.study(small(tmp_path), out, **asked)
    assert not list(out.rglob("*"))


def test_realizations_are_refused_and_the_table_is_no_part_of_an_image(tmp_path):
    source = small(tmp_path, study={"over": {HUMID: [20.0]}, "seeds": 2})
    for settings, words in (
        ({"numerics.realizations": 3}, "seeds, each of which is one"),
        ({"sequence": {"rate_hz": 1.0, "frames": 2}}, "sequence. is refused in a study"),
    ):
        with pytest.raises(ScenarioError, match=words):
            thzcl.study(source, tmp_path / "a", settings=settings)
    assert not list((tmp_path / "a").rglob("*"))
    over = {"numerics.realizations": [1, 3]}
    found = thzcl.study(source, tmp_path / "b", over=over, seeds=1)
    assert found.states == {"done": 1, "failed": 1}
    assert "seeds, each of which is one" in list(found.records())[1]["message"]
    plain, with_table = (pipeline.prepare(s) for s in (small(tmp_path), source))
    assert plain == with_table
    bad = small(tmp_path, study={"ower": {}})
    with pytest.raises(ScenarioError, match=r"ower: unknown key .*over"):
        documents.parse(documents.read(bad))


def test_targets_are_detected_over_the_seeds(tmp_path, device):
    """As `thzcl range` tells it of a target that stands where the scene has it."""
    data = scene(**SMALL)
    data["targets"]["box"]["temperature_k"] = 287.0
    camera, box = data["camera"], data["targets"]["box"]
    camera["look_at_m"] = box["center_m"]
    source = write(tmp_path, data)
    asked = {"over": {HUMID: [30.0, 70.0]}, "seeds": 20, "seed": 4, "device": device}
    thzcl.study(source, tmp_path / "s", settings={"study.detect": ["box"]}, **asked)
    table = rows(tmp_path / "s")
    for humid in (30.0, 70.0):
        mine = [r for r in table if float(r[HUMID]) == humid and r["target"] == "box"]
        assert len(mine) == 20 and len({r["d_prime"] for r in mine}) == 1
        told = {name: float(mine[0][name]) for name in ("d_prime", "d_prime_low", "area")}
        away = math.dist(camera["position_m"], box["center_m"])
        answer = thzcl.detection_range(
            source, "box", ranges=[away], air=20, seed=4, settings={HUMID: humid}, device=device
        )
        (one,) = answer.curves[0].found
        assert told["d_prime"] == pytest.approx(one.d_prime.value, rel=1e-3)
        assert told["area"] == pytest.approx(one.area.value, rel=1e-3)
    assert all(r["d_prime"] == "" for r in table if r["target"] == "ground")
    with pytest.raises(UsageError, match="at least 10 seeds"):
        thzcl.study(source, tmp_path / "t", settings={"study.detect": ["box"]},
                    over={HUMID: [30.0]}, seeds=9)  # fmt: skip
    with pytest.raises(UsageError, match="bx: no such target"):
        thzcl.study(source, tmp_path / "t", settings={"study.detect": ["bx"]},
                    over={HUMID: [30.0]}, seeds=10)  # fmt: skip


@pytest.mark.slow
def test_a_killed_study_goes_on_where_it_was(tmp_path):
    source, out = small(tmp_path, camera__pixels=[64, 48]), tmp_path / "out"
    command = [
        sys.executable, "-m", "thzcl", "study", str(source), "-o", str(out), "--seed", "4",
        "--over", f"{HUMID}=20:90:10", "--seeds", "12",
    ]  # fmt: skip
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for kind, code in ((signal.SIGKILL, -9), (signal.SIGTERM, 130)):
        process = subprocess.Popen(
            command, env=environment, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE
        )
        had = len(list(out.glob("members/*.json")))
        while len(list(out.glob("members/*.json"))) < had + 5 and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(kind)
        process.communicate()
        assert process.returncode == code
        for path in out.glob("members/*.json"):
            assert json.loads(path.read_text(encoding="utf-8"))["state"] == "done"
    held = len(list(out.glob("members/*.json")))
    assert 10 <= held < 96
    assert len({r["member"] for r in rows(out)}) == held  # TERM left a table
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, check=True)
    assert b"96 done" in done.stdout
    thzcl.study(source, tmp_path / "here", over={HUMID: "20:90:10"}, seeds=12, seed=4)
    assert numbers(out) == numbers(tmp_path / "here")


def test_where_nothing_else_is_varied_each_variant_is_a_member(tmp_path, device):
    variants = [
        {"name": f"{kelvin} K", "set": {"targets.box.temperature_k": kelvin}}
        for kelvin in (260.0, 300.0, -3.0)
    ]
    source = small(tmp_path, variants=variants, output={"difference": ["260.0 K", "300.0 K"]})
    found = thzcl.study(source, tmp_path / "a", device=device)
    assert found.states == {"done": 2, "failed": 1}
    told = rows(tmp_path / "a")
    told = [one for one in told if one["target"] in ("box", "")]
    assert [(one["member"], one["variant"], one["state"]) for one in told] == [
        ("0", "260.0 K", "done"), ("1", "300.0 K", "done"), ("2", "", "failed")
    ]  # fmt: skip
    whole = thzcl.run(source, variants=["260.0 K", "300.0 K"], device=device)
    for one, variant in zip(told, whole.summary()["variants"], strict=False):
        assert float(one["mean_contrast_k"]) == variant["targets"]["box"]["mean_contrast_k"]
    two = thzcl.study(source, tmp_path / "b", variants=["260.0 K", "300.0 K"], device=device)
    assert two.states == {"done": 2}
    with pytest.raises(ScenarioError, match="no such variant"):
        thzcl.study(source, tmp_path / "c", variants=["260.0 K", "cold"], device=device)
    with pytest.raises(UsageError, match="nothing is varied"):
        thzcl.study(source, tmp_path / "d", variants="260.0 K", device=device)
