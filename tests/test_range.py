"""At what range a target is detected: closed forms, intervals that hold, and what is refused."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import solids
from coverage_of_intervals import WORLDS, held
from scenes import scene, write
from scipy.stats import chi2, norm

import thzcl
from thzcl import pipeline
from thzcl.errors import ScenarioError, UsageError
from thzcl.studies.detection import intervals, ranges
from thzcl.studies.detection.observer import NPW, Training

PIXELS = 32
NOISY = {
    "kind": "radiometer", "frequency_ghz": 340.0, "if_center_ghz": 5.0, "if_bandwidth_ghz": 4.0,
    "receiver_temperature_k": 1500.0, "integration_time_s": 2e-3,
}  # fmt: skip


def target(height_m=1.2, kelvin=289.6, **changes):
    """A flat target that faces the camera, before a backdrop right behind it."""
    board = {"kind": "box", "center_m": [20.0, 0.0, height_m], "size_m": [0.001, 0.3, 0.3],
             "temperature_k": kelvin}  # fmt: skip
    base = {
        "camera__position_m": [0.0, 0.0, 1.2],
        "camera__look_at_m": [20.0, 0.0, 1.2],
        "camera__pixels": [PIXELS, PIXELS],
        "camera__focal_length_mm": 300.0,
        "camera__focal_plane_mm": [12.0, 12.0],
        "atmosphere": {"temperature_k": 290.0, "relative_humidity_percent": 60.0},
        "ground": None,
        "targets": {"plate": board},
        "background": {"max_range_m": 1000.0},
        "sensor": NOISY,
        "numerics": {"error_budget": False},
    }
    return scene(**(base | changes))


def asked(tmp_path, data, device, **options):
    options = {"ranges": [10.0, 20.0, 40.0], "air": 60, "seed": 5} | options
    name = next(iter(data["targets"]))
    return thzcl.detection_range(write(tmp_path, data), name, device=device, **options)


def closed_form(tmp_path, data, device, range_m):
    """The plate's d' behind even air in white noise: contrast, NEDT and pixels, and no more."""
    moved = {
        "targets.plate.center_m": [range_m, 0.0, 1.2], "camera.look_at_m": [range_m, 0.0, 1.2],
    }  # fmt: skip
    clear = {"atmosphere.model": "none", "sensor.kind": "passive-spectral"} | {
        f"sensor.{name}": None for name in NOISY if name not in ("kind", "frequency_ghz")
    }
    source = write(tmp_path, data)
    plan = pipeline.prepare(source)
    sums = plan.variants[0].image.spectrum
    hz = float(np.mean(sums.planes(sums.nodes_hz.array)))
    absorption = float(plan.variants[0].air.absorption(np.array([hz]))[0])
    steep = data["targets"]["plate"]["temperature_k"] - data["atmosphere"]["temperature_k"]
    contrast = steep * math.exp(-absorption * range_m)
    pixel_m = range_m * 12.0 / 300.0 / PIXELS
    across = np.abs(np.arange(64 * PIXELS) / 64 + 1 / 128 - PIXELS / 2) * pixel_m < 0.15
    share = across.reshape(PIXELS, 64).mean(axis=1)  # of each pixel's width on the plate
    seen = thzcl.run(source, settings=moved | clear, device=device).variants[0].sight
    assert seen.target.max() == 2
    nedt = (3000.0 / 2 + 290.0) / math.sqrt(4e9 * 2e-3)  # T_rec + T_A over sqrt(B t)
    return abs(contrast) / nedt * float((share**2).sum())


@pytest.mark.slow
def test_even_air_gives_the_closed_form(tmp_path, device):
    """All points together, at 99.9 %."""
    data = target(kelvin=289.9, camera__samples_per_pixel=64)
    spots = [8.0, 12.0, 20.0, 30.0, 45.0]
    found = asked(tmp_path, data, device, ranges=spots, air=100)
    (curve,) = found.curves
    truths = np.array([closed_form(tmp_path, data, device, r) for r in spots])
    away = []
    for one, truth in zip(curve.found, truths, strict=True):
        half = (one.d_prime.high - one.d_prime.low) / 2
        away.append((one.d_prime.value - truth) / (half / norm.isf(0.025)))
        pd = norm.cdf(truth - norm.isf(0.01))
        assert one.tail == intervals.EMPIRICAL
        assert one.probability.low - 0.05 <= pd <= one.probability.high + 0.05
    assert truths[0] > 4 and truths[-1] < 1
    assert np.sum(np.square(away)) < chi2.isf(0.001, len(spots))
    where = np.interp(-0.9, -norm.cdf(truths - norm.isf(0.01)), spots)
    asked_for = curve.reach
    assert asked_for.low <= asked_for.range_m <= asked_for.high
    assert asked_for.low * 0.9 <= where <= asked_for.high * 1.1


def test_more_humidity_or_noise_never_detects_better_there(tmp_path, device):
    wet = {"atmosphere.relative_humidity_percent": 100.0, "sensor.frequency_ghz": 650.0}
    loud = {"sensor.receiver_temperature_k": 6000.0}
    dry = {"atmosphere.relative_humidity_percent": 20.0, "sensor.frequency_ghz": 650.0}
    for better, worse in ((dry, wet), ({}, loud)):
        one, other = (
            asked(tmp_path, target(), device, settings=settings).curves[0].found
            for settings in (better, worse)
        )
        for a, b in zip(one, other, strict=True):
            assert b.d_prime.low <= a.d_prime.high
        assert other[-1].d_prime.value < one[-1].d_prime.value


def test_air_that_fluctuates_is_clutter_and_its_law_is_named(tmp_path, device):
    box = scene()["targets"]["box"] | {"temperature_k": 287.0}
    data = scene(
        camera__pixels=[24, 18], targets={"box": box}, atmosphere__compare=["r24"],
        sensor__frequency_ghz=340.0,
    )  # fmt: skip
    found = asked(tmp_path, data, device, ranges=[15.0, 40.0], air=20, frequency_ghz=[340.0, 650.0])
    told = found.as_json()
    assert [(c["frequency_ghz"], c["model"]) for c in told["curves"]] == [
        (340.0, "mpm93"), (340.0, "r24"), (650.0, "mpm93"), (650.0, "r24"),
    ]  # fmt: skip
    for curve, losses in zip(told["curves"], told["losses"], strict=True):
        assert curve["range_m"] == losses["range_m"] == [15.0, 40.0]
        lengths = {len(v) for v in (*curve.values(), *losses.values()) if isinstance(v, list)}
        assert lengths == {2}
        assert set(curve["observer"]) == {NPW} and set(curve["tail"]) == {"normal"}
        assert losses["noise"] == [None, None] and all(v > 0 for v in losses["clutter"])
        assert losses["absorption"][1] > losses["clutter"][1]
    assert set(told["ranges"][0]) == {
        "frequency_ghz", "model", "probability", "range_m", "low", "high", "note",
    }  # fmt: skip
    assert any("no noise: the air's clutter alone" in note for note in found.notes)
    assert any("10 test airs are fewer than the 1000 null samples" in n for n in found.notes)


def test_rain_is_part_of_what_air_absorbs(tmp_path, device):
    """Without it and the gas the target shows as in no air at all."""
    dry, rainy = (
        asked(tmp_path, target(**changes), device, ranges=[40.0], air=20).as_json()
        for changes in ({}, {"atmosphere__rain": {"rate_mm_h": 99.0, "temperature_k": 290.0}})
    )
    one, other = (told["losses"][0]["absorption"][0] for told in (dry, rainy))
    assert other == pytest.approx(one, rel=0.15)
    assert rainy["curves"][0]["d_prime"][0] < 0.8 * dry["curves"][0]["d_prime"][0]


def test_path_radiance_that_makes_contrast_is_told_of(tmp_path, device):
    """A plate at the temperature of what is far behind it shows by the air between."""
    wall = {"kind": "box", "center_m": [120.5, 0.0, 1.2], "size_m": [1.0, 99.0, 99.0],
            "temperature_k": 260.0}  # fmt: skip
    data = target(kelvin=260.0)
    data["targets"]["wall"] = wall
    data["sensor"] = NOISY | {"frequency_ghz": 410.0}
    found = asked(tmp_path, data, device, ranges=[10.0, 40.0, 119.0])
    near, _, far = (one.d_prime.value for one in found.curves[0].found)
    assert near > far
    data["background"]["temperature_k"] = 290.0
    data["targets"].pop("wall")
    data["targets"]["plate"]["temperature_k"] = 290.0
    data["background"] = {"temperature_k": 290.0, "max_range_m": 100.0}
    nothing = asked(tmp_path, data, device, ranges=[10.0, 20.0])
    assert nothing.curves[0].reach.note == "not reached"
    assert nothing.curves[0].found[0].d_prime.low < 0.3


def test_active_sensors_are_judged_by_the_cells_of_the_target(tmp_path, device):
    wall = {"kind": "box", "center_m": [60.5, 0.0, 1.2], "size_m": [1.0, 99.0, 99.0],
            "reflectivity": 0.1}  # fmt: skip
    data = target()
    data["targets"]["plate"] = data["targets"]["plate"] | {"reflectivity": 0.13}
    data["targets"]["wall"] = wall
    data["sensor"] = {"kind": "active", "frequency_ghz": 340.0, "dynamic_range_db": 100.0,
                      "speckle_looks": 4.0}  # fmt: skip
    data["atmosphere"] = {"temperature_k": 290.0, "relative_humidity_percent": 0.0, "model": "none"}
    found = asked(tmp_path, data, device, ranges=[14.0], air=100)
    (one,), (samples,) = found.curves[0].found, found.curves[0].samples
    assert samples.observer == "cells" and samples.sign == 1
    from thzcl import metrics

    truth = float(metrics.speckle_detection(1.3, 4 * samples.pixels, 0.01))
    assert one.probability.low <= truth <= one.probability.high


@pytest.mark.slow
@pytest.mark.parametrize("name", ["white noise, 0.33", "red clutter, 0.55", "speckle, 1.18"])
def test_intervals_hold_the_truth(name):
    """At least as often as 178 of 200 would have it; 40 trials leave a spread."""
    hits, _, _ = held(WORLDS[name], 40)
    assert all(count >= 33 for count in hits.values()), hits


@pytest.mark.long
@pytest.mark.parametrize("name", list(WORLDS))
def test_intervals_hold_the_truth_of_every_world(name):
    hits, _, _ = held(WORLDS[name], 200)
    assert all(178 <= count <= 199 for count in hits.values()), hits


def test_the_template_is_not_learnt_from_a_covariance_of_samples():
    """With fewer airs than pixels, what it claims is what it holds on other airs."""
    world, rng = WORLDS["red clutter, 0.55"], np.random.default_rng(3)
    training = Training()
    for _ in range(20):
        air = world.air(rng)
        there, gone = (world.image(np.random.default_rng(9), air, t) for t in (True, False))
        training.add(there, gone, world.image(rng, air, False))
    observer = training.observer("hotelling", random=True)
    assert observer.template.size > 20 * 20
    truth, _, _ = world.truths(observer)
    assert observer.d_prime() < 1.6 * truth


def test_ends_of_probability_are_one_sided():
    rng = np.random.default_rng(2)
    null = rng.normal(size=(50, 20))
    often = intervals.counts(50, 1)
    sure = intervals.detect(null, null + 50.0, 0.01, intervals.EMPIRICAL, often).probability
    assert sure.value == 1 and sure.high == 1
    assert sure.low == pytest.approx(0.025 ** (1 / 50))
    never = intervals.detect(null, null - 9.0, 0.01, intervals.EMPIRICAL, often).probability
    assert never.value == never.low == 0 and never.high == pytest.approx(1 - 0.025 ** (1 / 50))


def reach_of(seed, scale_m=30.0, probability=0.9):
    """A range at a probability; d' falls as 12 exp(-R / scale), and ranges share their airs."""
    rng, places = np.random.default_rng(seed), np.arange(20.0, 121.0, 20.0)
    often, shared, found = intervals.counts(50, seed), rng.normal(size=(50, 1)), []
    for place in places:
        null = 0.8 * shared + 0.6 * rng.normal(size=(50, 1))
        present = 12 * np.exp(-place / scale_m) + null + 0.2 * rng.normal(size=(50, 1))
        found.append(intervals.detect(null, present, 0.01, intervals.NORMAL, often))
    return intervals.reach(places, found, probability)


def test_the_interval_of_a_range_holds_the_truth():
    truth = 30 * np.log(12 / (norm.ppf(0.9) + norm.isf(0.01)))
    found = [reach_of(seed) for seed in range(40)]
    assert all(one.low < one.range_m < one.high for one in found)
    assert sum(one.low <= truth <= one.high for one in found) >= 33


def test_a_range_may_be_nearer_or_farther_than_asked():
    near, far = reach_of(1, scale_m=6.0), reach_of(1, scale_m=900.0)
    assert (near.range_m, near.low, near.note) == (None, None, "not reached")
    assert (far.range_m, far.high, far.note) == (None, None, "farther than asked")


def test_draws_are_as_many_as_a_rate_of_false_alarms_takes():
    assert intervals.draws_needed(50, 0.01, 0.0) == 20
    assert intervals.draws_needed(50, 0.01, 0.04) == 96
    assert intervals.draws_needed(50, 0.01, 0.06) is None  # the air alone limits them
    assert intervals.draws_needed(50, 1e-4, 0.0) is None  # too many to draw
    assert intervals.draws_needed(2000, 0.01, 0.5) == 1


def test_a_range_beyond_all_says_what_is_known(tmp_path, device):
    hot = target(kelvin=320.0)
    found = asked(tmp_path, hot, device, ranges=[10.0, 15.0], air=20, probability=0.95)
    assert found.curves[0].reach.note == "farther than asked"
    notes = " ".join(found.notes)
    assert "farther than 15 m, the longest of the ranges; give longer ones" in notes
    low = found.curves[0].found[-1].probability.low
    assert low < 0.95 and f"at 15 m the interval begins at {low:.3g}, so that 0.95 is not" in notes


def test_an_answer_goes_on_where_it_was(tmp_path, device, monkeypatch):
    data, computed = target(), []
    together = ranges.computed_together

    def counted(question, some, opened, *more):
        for found in together(question, some, opened, *more):
            computed.append(found[0])
            if len(computed) == 2:
                raise KeyboardInterrupt
            yield found

    monkeypatch.setattr(ranges, "computed_together", counted)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        asked(tmp_path, data, device, folder=out)
    found = asked(tmp_path, data, device, folder=out, seed=None)
    assert computed == [10.0, 20.0, 20.0, 40.0]
    monkeypatch.undo()
    assert found.as_json() == asked(tmp_path, data, device).as_json()
    other = asked(tmp_path, data, device, folder=out, seed=6)
    assert other.as_json()["curves"] != found.as_json()["curves"]


@pytest.mark.parametrize("stopped", [3, 15], ids=["learning", "testing"])
def test_an_answer_goes_on_amid_its_airs(tmp_path, device, monkeypatch, stopped):
    """The same to the bit; a damaged file of airs is no file."""
    box = scene()["targets"]["box"] | {"temperature_k": 287.0}
    data = scene(camera__pixels=[24, 18], targets={"box": box}, atmosphere__compare=["r24"])
    options = {"ranges": [15.0, 40.0], "air": 20, "device": device, "data": data}
    out, seen = tmp_path / "out", []
    due = asked(tmp_path, **options).as_json()
    monkeypatch.setattr(ranges, "SAVED_S", 0.0)

    def stop(text):
        seen.append(text)
        if text.endswith(f"air {stopped + 1} of 20"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        asked(tmp_path, **options, folder=out, progress=stop)
    (kept,) = out.rglob("airs-*.npz")
    whole, seen[:] = kept.read_bytes(), []
    again = asked(tmp_path, **options, folder=out, progress=seen.append)
    assert again.as_json() == due
    assert seen[0].endswith(f"air {stopped + 1} of 20") and not list(out.rglob("airs-*"))
    for path in out.rglob("*m-*.json"):
        path.unlink()
    kept.write_bytes(whole[:-100])
    assert asked(tmp_path, **options, folder=out).as_json() == due


def test_the_command_writes_table_curve_and_numbers(thzcl_json, tmp_path):
    source = write(tmp_path, target())
    told = thzcl_json("range", source, "--target", "plate", "--ranges", "10,30", "--air", "20",
                      "--seed", "4")  # fmt: skip
    assert told["files"] == [f"scene-range.{kind}" for kind in ("json", "csv", "png")]
    assert json.loads((tmp_path / "scene-range.json").read_text(encoding="utf-8")) == told
    lines = (tmp_path / "scene-range.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 3 and lines[0].startswith("frequency_ghz,model,range_m,probability")
    assert (tmp_path / "scene-range.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({}, {"air": 9}, "--air 9"),
        ({}, {"probability": 1.0}, "between 0 and 1"),
        ({}, {"false_alarm": 0.7}, "between 0 and 0.5"),
        ({}, {"observer": "eye"}, "must be hotelling or npw"),
        ({}, {"ranges": [-4.0]}, "above 0"),
        ({}, {"ranges": [2.0, 10.0]}, "overfills the picture"),
        ({"targets__plate__center_m": [20.0, 0.0, 6.2]}, {"ranges": [4.0]}, "5 m between"),
        ({"variants": [{"name": "a"}, {"name": "b"}]}, {}, "name one with --variant"),
        ({"numerics": {"realizations": 3}}, {}, "--air N is that"),
        ({"sensor": {"kind": "passive-spectral", "frequency_ghz": 340.0}}, {}, "give the sensor"),
    ],
)
def test_what_cannot_be_asked_is_refused(tmp_path, device, changes, options, words):
    with pytest.raises((UsageError, ScenarioError), match=words):
        asked(tmp_path, target(**changes), device, **({"ranges": [10.0]} | options))


def test_default_ranges_that_cannot_be_are_left_out_with_a_note(tmp_path, device, monkeypatch):
    monkeypatch.setattr(ranges, "DEFAULT_RANGES", "2:14:4")
    found = asked(tmp_path, target(), device, ranges=None, air=10)
    assert found.question.range_m == (10.0, 14.0)
    assert any(note.startswith("2 m is left out: at 2 m plate overfills") for note in found.notes)
    with pytest.raises(UsageError, match="did you mean plate"):
        thzcl.detection_range(write(tmp_path, target()), "plat", device=device)


def test_a_part_of_a_mesh_is_a_target(tmp_path, device):
    """It is asked about with the rest of the mesh there, as a box before another box is."""
    plate, button = solids.CUBE * [0.2, 3, 3], solids.CUBE * [0.2, 0.3, 0.3] - [0.4, 0, 0]
    text = solids.obj(("plate", plate, solids.BOX_FACES), ("button", button, solids.BOX_FACES))
    (tmp_path / "two.obj").write_text(text, encoding="utf-8")
    mesh = {"kind": "mesh", "file": "two.obj", "center_m": [20.0, 0.0, 1.2], "temperature_k": 289.0}
    mesh["parts"] = {"button": {"temperature_k": 289.6}}
    box = {"kind": "box", "center_m": [20.0, 0.0, 1.2], "size_m": [0.2, 3.0, 3.0]}
    near = box | {"center_m": [19.6, 0.0, 1.2], "size_m": [0.2, 0.3, 0.3]}
    boxes = {"plate": box | {"temperature_k": 289.0}, "button": near | {"temperature_k": 289.6}}
    found = []
    for targets, name in (({"two": mesh}, "two.button"), (boxes, "button")):
        source = write(tmp_path, target(targets=targets))
        given = {"ranges": [19.6], "air": 40, "seed": 5, "device": device}
        (curve,) = thzcl.detection_range(source, name, **given).curves
        found.append(curve.samples[0])
    one, other = found
    assert one.pixels == other.pixels > 50
    assert one.null == pytest.approx(other.null, rel=1e-4)
    assert one.present == pytest.approx(other.present, rel=1e-4)
