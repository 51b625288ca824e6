"""The study of error against run time: known orders of convergence, resuming, output."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import ACTIVE, MOIST, scene, write

from thzcl.device.choose import open_device
from thzcl.errors import ScenarioError
from thzcl.graph import evaluate
from thzcl.studies.convergence.knobs import KNOBS
from thzcl.studies.convergence.specs import CoarseSpec
from thzcl.studies.convergence.study import Point, _identity, default_over_front, front, study
from thzcl.studies.convergence.subject import Subject, errors

BAND = {"kind": "passive-broadband", "center_ghz": 650.0, "bandwidth_ghz": 60.0}


def subject_of(folder, data):
    return Subject(write(folder, data), {}, (), open_device())


def studied(folder, data, knobs, repeat=1, progress=lambda _: None):
    return study(subject_of(folder, data), folder, knobs, repeat, progress)


def by_setting(found, knob):
    return {p["setting"]: p["error_rms"] for p in found["points"] if p["knob"] == knob}


def test_errors_fall_as_theory_has_it(tmp_path):
    """Steps: first order, since voxels have edges; a table: second order; polynomials.

    Below rounding from degree 4 on.
    """
    found = studied(
        tmp_path, scene(camera__pixels=[48, 36]), ["march", "table", "surrogate", "arithmetic"]
    )
    steps = np.array(list(by_setting(found, "march").values())[:6])
    order = np.polyfit(np.log([2, 1, 0.5, 0.25, 0.125, 0.0625]), np.log(steps), 1)[0]
    assert 0.7 < order < 1.6
    tables = np.array(list(by_setting(found, "table").values())[:4])
    assert np.polyfit(np.log([10, 5, 2, 1]), np.log(tables), 1)[0] == pytest.approx(2.0, abs=0.35)
    assert by_setting(found, "march")["exact segments"] < 1e-3 * steps.min()
    degrees = by_setting(found, "surrogate")
    assert degrees["degree 1"] > 100 * degrees["degree 2"] > 1e-7
    assert max(degrees[f"degree {k}"] for k in range(4, 9)) < 2e-7
    precision = by_setting(found, "arithmetic")
    assert precision["float64"] < 1e-11 < precision["float32"] < 5e-7


def test_all_other_knobs(tmp_path):
    """Fewer rays, fewer samples, larger voxels and an earlier end cost accuracy.

    The FFT's library does not.
    """
    data = scene(
        camera__pixels=[48, 36],
        atmosphere__relative_humidity_percent=100.0,
        background__max_range_m=400.0,
    )
    found = studied(tmp_path, data, ["stride", "samples", "voxel", "cutoff", "fft"])
    strides = by_setting(found, "stride")
    assert strides["every ray"] < 1e-6 < strides["one ray in 2"] < strides["one ray in 8"]
    samples = list(by_setting(found, "samples").values())
    assert samples[0] > samples[1] > samples[2] > 1e-4
    voxels = list(by_setting(found, "voxel").values())
    assert voxels[0] > voxels[1] > 1e-6
    depths = list(by_setting(found, "cutoff").values())
    assert depths[0] > depths[1] > depths[-1]
    assert depths[-1] < 1e-6
    assert max(by_setting(found, "fft").values()) < 2e-5


def test_quadratures(tmp_path):
    data = scene(sensor=BAND, camera__pixels=[8, 6])
    found = by_setting(studied(tmp_path, data, ["quadrature"]), "quadrature")
    assert found["paper, edges"] > 0.01 > found["resolved to 1e-2"] > found["resolved to 1e-5"]
    assert found["resolved to 1e-5"] < 1e-5


def test_knobs_without_meaning_are_left_out_with_reasons(tmp_path):
    found = studied(
        tmp_path,
        scene(atmosphere__fluctuations=None),
        ["voxel", "march", "quadrature", "table", "arithmetic"],
    )
    assert {item["knob"] for item in found["left_out"]} == {"voxel", "march", "quadrature", "table"}
    assert {point["knob"] for point in found["points"]} == {"arithmetic"}
    with pytest.raises(ScenarioError, match="there is no colour; choose among arithmetic"):
        studied(tmp_path, scene(), ["colour"])


def test_an_interrupted_study_goes_on(tmp_path):
    """What was measured stays as it was, to the last digit of its time; the rest is added."""
    told = []

    def interrupt(text):
        told.append(text)
        if len(told) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        studied(tmp_path, scene(), ["surrogate"], progress=interrupt)
    kept = json.loads((tmp_path / "scene-convergence.json").read_text())["points"]
    assert [point["setting"] for point in kept] == ["degree 1", "degree 2", "degree 3"]
    later = []
    found = studied(tmp_path, scene(), ["surrogate"], progress=later.append)
    assert [p["seconds"] for p in found["points"][:3]] == [p["seconds"] for p in kept]
    assert len(found["points"]) == 8
    assert len(later) == 5
    changed = []
    studied(tmp_path, scene(ground__temperature_k=280.0), ["surrogate"], progress=changed.append)
    assert len(changed) == 8  # another scene: nothing of the first holds


def test_a_study_without_a_seed_is_of_one_air_and_goes_on(tmp_path):
    """Every setting sees the same realisation, and the next command too."""
    seedless = scene(atmosphere__fluctuations__seed=None)
    found = studied(tmp_path, seedless, ["arithmetic"])
    assert found["seed"] == 1
    assert by_setting(found, "arithmetic")["float32"] < 5e-7
    started = []
    assert studied(tmp_path, seedless, ["arithmetic"], progress=started.append)["points"]
    assert started == []


def test_a_file_that_changed_begins_a_study_again(tmp_path):
    """It is known by its bytes; and points of another driver do not stand with these."""
    board = {"kind": "billboard", "center_m": [25.0, 7.0, 2.0], "size_m": [3.0, 3.0]}
    board |= {"facing_deg": 180.0, "image": "a.npy", "quantity": "temperature"}
    data, started = scene(targets={"board": board}), []
    for kelvin in (300.0, 300.0, 310.0):
        np.save(tmp_path / "a.npy", np.full((4, 4), kelvin))
        started.append([])
        studied(tmp_path, data, ["arithmetic"], progress=started[-1].append)
    assert [len(one) for one in started] == [2, 0, 2]
    subject = subject_of(tmp_path, data)
    info = replace(subject.device.info, driver="another")
    device = SimpleNamespace(info=info)
    assert _identity(subject, 1) != _identity(replace(subject, device=device), 1)


def test_the_front_and_the_default_on_it():
    points = [
        Point("k", "slow, exact", False, 3.0, 1e-6, 1e-5),
        Point("k", "beaten", True, 3.2, 1e-3, 1e-2),
        Point("k", "fast", False, 1.0, 1e-3, 1e-2),
        Point("other", "slower still", True, 9.0, 1e-2, 1e-1),
    ]
    assert [point.on_front for point in front(points)] == [True, False, True, True]
    assert default_over_front(points) == pytest.approx({"k": 3.2, "other": 1.0})


def test_errors_are_of_the_worst_variant():
    exact = {"a": np.ones((1, 2, 2)), "b": 2 * np.ones((1, 2, 2))}
    found = {"a": exact["a"] + 0.1, "b": exact["b"] + np.array([[[0, 0], [0, 0.8]]])}
    assert errors(found, exact) == pytest.approx((0.2, 0.4))


def test_the_command(thzcl_json, tmp_path):
    file = write(tmp_path, scene(camera__pixels=[8, 6]))
    found = thzcl_json(
        "convergence", file, "-o", tmp_path, "--knobs", "arithmetic,march", "--repeat", "1"
    )
    assert set(found["points"][0]) >= {
        "knob",
        "setting",
        "seconds",
        "error_rms",
        "error_max",
        "on_front",
    }
    assert set(KNOBS) > {point["knob"] for point in found["points"]}
    with (tmp_path / "scene-convergence.csv").open(newline="") as file_:
        assert len(list(csv.DictReader(file_))) == len(found["points"])
    assert (tmp_path / "scene-convergence.png").stat().st_size > 10_000


def variants(data, **changes):
    """The data with two variants, of which the second changes some keys."""
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return data | {"variants": [{"name": "one", "set": {}}, {"name": "other", "set": named}]}


def test_each_frequency_has_a_table_of_its_own(tmp_path):
    """Variants whose polynomials share one trace share none where absorption is looked up."""
    data = variants(scene(), sensor__frequency_ghz=850.0)
    tables = by_setting(studied(tmp_path, data, ["table"]), "table")
    assert tables["10 %"] > 30 * tables["1 %"] > 1e-7
    assert tables["0.5 %"] < 2e-6


@pytest.mark.long
def test_levels_and_directions_of_the_sky(tmp_path):
    """They err the less the finer they are, and are left out where no sky is seen."""
    knobs = ["sky-levels", "sky-directions", "sky-look-up"]
    changes = {
        "atmosphere__fluctuations": None,
        "sky": {"profile": "us-standard"},
        "background__environment": "sky",
        "camera__look_at_m": [30.0, 8.0, 5.0],
        "sensor__frequency_ghz": 94.0,
    }
    found = studied(tmp_path, scene(**changes), knobs)
    layers = by_setting(found, "sky-levels")
    assert layers["layers of 100 m"] > 3 * layers["layers of 25 m"] > 1e-7
    assert layers["layers of 25 m"] < 2e-5
    directions = by_setting(found, "sky-directions")
    assert directions["4 of a hemisphere"] > 10 * directions["64 of a hemisphere"]
    assert directions["64 of a hemisphere"] < 2e-6
    look_ups = by_setting(found, "sky-look-up")
    assert look_ups["to 1e-02"] > 100 * look_ups["to 1e-06"]
    assert look_ups["to 1e-06"] < 2e-6
    (tmp_path / "none").mkdir()
    none = studied(tmp_path / "none", scene(atmosphere__fluctuations=None), knobs)
    assert {one["reason"] for one in none["left_out"]} == {"no [sky] is seen"}


def test_layers_and_directions_of_scattered_light(tmp_path):
    """They err the less the finer they are, and are left out where nothing falls."""
    knobs = ["scattering-layers", "scattering-directions"]
    rain = MOIST | {"rain": {"rate_mm_h": 10.0}}
    changes = {"sky": {"profile": "us-standard"}, "sensor__frequency_ghz": 94.0}
    found = studied(tmp_path, scene(atmosphere=rain, **changes), knobs)
    layers = by_setting(found, "scattering-layers")
    assert layers["layers of 0.3 depth"] > 1.5 * layers["layers of 0.01 depth"]
    directions = by_setting(found, "scattering-directions")
    assert directions["2 of a hemisphere"] > 3 * directions["8 of a hemisphere"] > 1e-9
    (tmp_path / "none").mkdir()
    none = studied(tmp_path / "none", scene(atmosphere=MOIST), knobs)
    assert {one["reason"] for one in none["left_out"]} == {"no light is scattered into rays"}


def test_sizes_of_drops(tmp_path):
    """Sums over sizes err the less the more there are, in what is seen and in echoes."""
    rain = MOIST | {"rain": {"rate_mm_h": 10.0}}
    for name, sensor in (("seen", {"sensor__frequency_ghz": 94.0}), ("echoes", {"sensor": ACTIVE})):
        (tmp_path / name).mkdir()
        found = by_setting(
            studied(tmp_path / name, scene(atmosphere=rain, **sensor), ["size-nodes"]), "size-nodes"
        )
        assert found["12 sizes"] > 30 * found["50 sizes"] > 1e-9
        assert found["200 sizes"] < 1e-5
    (tmp_path / "none").mkdir()
    none = studied(tmp_path / "none", scene(atmosphere=MOIST), ["size-nodes"])
    assert {one["reason"] for one in none["left_out"]} == {"nothing falls through the air"}


def test_libraries_differ_by_rounding_alone(tmp_path):
    libraries = by_setting(studied(tmp_path, scene(), ["fft"]), "fft")
    assert len(set(libraries.values())) == len(libraries)
    assert max(libraries.values()) < 1e-6


def test_coarse_air_is_the_mean_of_finer_voxels(tmp_path):
    fluctuations = {"sigma_percent": 20.0, "voxel_m": 0.7, "grid": 16, "temperature_sigma_k": 1.0}
    warm = scene(atmosphere__fluctuations=fluctuations | {"seed": 3})
    subject = subject_of(tmp_path, warm)
    cube = subject.plan.variants[0].cube
    ((fine, coarse),) = evaluate([(cube, CoarseSpec(cube, 8))], subject.device)
    assert (coarse.grid, coarse.voxel_m) == (8, pytest.approx(1.4))
    for finer, mean in ((fine.delta, coarse.delta), (fine.offset, coarse.offset)):
        block = finer.host()[4:6, 14:16, 0:2].astype(float)
        assert mean.host()[2, 7, 0] == pytest.approx(block.mean(), abs=1e-6)


def test_knobs_that_some_variant_defeats_are_left_out(tmp_path):
    data = variants(scene(), atmosphere__fluctuations__grid=16)
    (left_out,) = studied(tmp_path, data, ["voxel"])["left_out"]
    assert left_out["reason"] == "a variant sets grid or voxel_m itself"
    (left_out,) = studied(tmp_path, scene(atmosphere__fluctuations=None), ["cutoff"])["left_out"]
    assert "none is cut off" in left_out["reason"]


def test_what_stands_in_the_study_s_place_is_no_study(tmp_path):
    """Neither a pipe, which would be waited for, nor nonsense is gone on with."""
    path = tmp_path / "scene-convergence.json"
    os.mkfifo(path)
    assert len(studied(tmp_path, scene(), ["arithmetic"])["points"]) == 2
    path.write_text("[" * 100_000)
    assert len(studied(tmp_path, scene(), ["arithmetic"])["points"]) == 2
