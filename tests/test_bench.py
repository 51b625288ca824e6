"""tests/bench compares like with like: each rival does the same work, to the error told of it.

No times are measured here.
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT

from thzcl import pipeline
from thzcl.clock import Clock

sys.path.append(str(ROOT / "tests" / "bench"))
import claims
import mitsuba_march
import processes
import readme
import rivals
import setting
import timing

SMALL = {"camera.pixels": [32, 32], "atmosphere.fluctuations.voxel_m": 0.5}
FLOAT32 = 1e-6  # of the contrast: rounding along a path in float32, with room to spare
HALF_STEPS = 1e-2  # of the contrast: steps of half a voxel, that cross faces unseen


@pytest.fixture(scope="module")
def small(device):
    return setting.make(device, SMALL)


def error(one, paths):
    return one.error(np.exp(-one.depth(paths)))


def test_ours_on_packets_and_on_single_rays(device, small):
    plain = setting.make(setting.OneLane(device.context.devices[0], device.info), SMALL)
    assert error(small, small.trace()) < FLOAT32
    assert error(plain, plain.trace()) < FLOAT32
    assert plain.segments() == pytest.approx(small.segments(), rel=1e-4)


WARM = {"atmosphere.fluctuations.temperature_sigma_k": 0.5, "sensor.frequency_ghz": [640, 660]}


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("slide", {}),
        ("slide", WARM),
        ("slide", {"numerics.ray_stride": 4}),
        ("figure7", {}),
        ("figure8", {}),
        ("raster", {}),
    ],
)
def test_images_of_single_rays_as_a_gpu_has_them(device, name, settings):
    """Kernels with one ray to a work-item give the images of packets, to float32's rounding."""
    single = setting.OneLane(device.context.devices[0], device.info)
    plan = pipeline.prepare(
        name, {"camera.pixels": [24, 24], "numerics.error_budget": False} | settings
    )
    ours, theirs = (
        pipeline.compute_images(plan, one, Clock()).variants for one in (device, single)
    )
    for packed, alone in zip(ours, theirs, strict=True):
        largest = np.abs(packed.image.values).max()
        assert np.allclose(packed.image.values, alone.image.values, rtol=0, atol=FLOAT32 * largest)


def test_a_tolerance_thins_the_rays(device, small):
    thinned = setting.make(device, SMALL | {"numerics.tolerance": 1e-3, "numerics.ray_stride": 4})
    assert thinned.segments() < small.segments()
    assert FLOAT32 < error(thinned, thinned.trace()) < 0.1


def test_numpy_marches_the_same_rays(small):
    depth = rivals.numpy_march(small)()
    assert np.isfinite(depth).sum() == small.rays / rivals.PART
    assert small.error(np.exp(-depth)) < HALF_STEPS


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_numba_marches_the_same_rays(small, real):
    pytest.importorskip("numba")
    assert small.error(np.exp(-rivals.numba_march(small, real)())) < FLOAT32


def test_mitsuba_sees_the_same_image(small):
    """Transmission t of independent samples has the variance t (1 - t) a sample.

    The mean of all pixels is known to 1 %.
    """
    pytest.importorskip("mitsuba")
    call = mitsuba_march.mitsuba_march(small)
    many = 100
    transmission = np.exp(-small.depth(small.trace()))
    image = np.mean([call() for _ in range(many)], axis=0)
    expected = np.sqrt(np.mean(transmission * (1 - transmission)) / many / mitsuba_march.SAMPLES)
    assert np.sqrt(np.mean((image - transmission) ** 2)) == pytest.approx(expected, rel=0.15)
    assert image.mean() == pytest.approx(
        transmission.mean(), abs=4 * expected / np.sqrt(small.rays)
    )


def test_alternate_takes_turns_and_medians():
    turns = []
    times = iter([9.0, 1.0, 5.0, 2.0])

    def one():
        turns.append("one")
        return next(times)

    def other():
        turns.append("other")

    seconds = timing.alternate({"one": one, "other": other}, 3)
    assert turns == ["one", "other"] * 4
    assert seconds["one"] == 2.0  # of 1, 5 and 2: the first warms up
    assert seconds["other"] >= 0


def test_a_record_knows_whether_it_is_met():
    assert timing.Record("a", 1.0, 2.0, "times").met
    assert not timing.Record("a", 1.0, 2.0, "times", at_least=True).met
    assert timing.Record("a", None, 2.0, "times").met is None


def test_a_claim_without_times_is_measured(device):
    """Uniform air has no field and no trace, on any machine."""
    share, memory = claims.uniform(device, 1)
    assert share.measured == memory.measured == 0
    assert share.met and memory.met


def test_a_command_is_held_to_imports_of_what_it_imports(tmp_path):
    """Neither fewer modules nor more, of others than thzcl and Python."""
    names = processes.imported(["sensors"], tmp_path)
    packages = {name.partition(".")[0] for name in names}
    assert {"typer", "pydantic", "numpy", "pluggy"} <= packages
    assert not packages & {"thzcl", "json", "matplotlib", "pyopencl"}
    afterwards = f"{processes.IMPORT}; print(*sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", afterwards, *names], capture_output=True, text=True, check=True
    ).stdout.split()
    assert set(names) == {name for name in found if name.partition(".")[0] in packages}


def test_readme_shows_the_records():
    """The tables of tests/bench/README.md are made of the records, and no one types a figure.

    `python tests/bench --output tests/bench/record.json --readme` writes both.
    """
    found, cases = readme.recorded(), readme.stress_cases()
    text = readme.PAGE.read_text(encoding="utf-8")
    assert readme.section(found) in text and readme.extremes(cases) in text
    assert readme.replaced(text, found, cases) == text
    assert readme.replaced(text, found | {"repeat": 99}, cases) != text
    assert readme.replaced(text, found, cases[1:]) != text


def test_readme_names_what_fails():
    cases = readme.stress_cases()
    wrong = [cases[0] | {"passed": "False"}, *cases[1:]]
    assert f"{len(cases) - 1} of {len(cases)} pass; **these fail: {cases[0]['name']}**" in (
        readme.extremes(wrong)
    )
