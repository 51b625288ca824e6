"""Sequences: frames of moving air are single images of a moved scene, written as they come."""

from __future__ import annotations

import h5netcdf
import numpy as np
import pytest
from PIL import Image
from scenes import scene, write

import thzcl
from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.errors import ScenarioError
from thzcl.graph import everything
from thzcl.paths.specs import TraceSpec
from thzcl.studies.sequence import images
from thzcl.surfaces.ends import EndsSpec

WIND = [2.0, -3.0, 0.0]
QUICK = {"numerics": {"error_budget": False}}
RADIOMETER = {
    "kind": "radiometer", "frequency_ghz": 340.0, "if_center_ghz": 5.0, "if_bandwidth_ghz": 4.0,
    "receiver_temperature_k": 1500.0, "integration_time_s": 2e-3,
}  # fmt: skip


def moving(frames=4, rate_hz=5.0, **changes):
    flow = scene()["atmosphere"]["fluctuations"] | {"wind_m_s": WIND}
    given = {"rate_hz": rate_hz, "frames": frames}
    base = {"atmosphere__fluctuations": flow, "sequence": given} | QUICK
    return scene(**(base | changes))


def frames_of(source, device):
    return list(images(pipeline.prepare(source), device, Clock()))


@pytest.mark.parametrize(
    "changes",
    [{}, {"atmosphere__fluctuations__temperature_sigma_k": 1.0}, {"numerics__ray_stride": 4}],
    ids=["one temperature", "temperature", "thinned"],
)
def test_each_frame_is_the_image_of_a_scene_moved_against_the_wind(tmp_path, device, changes):
    data = moving(ground=None, **changes)
    found = frames_of(write(tmp_path, data), device)
    assert len(found) == 4
    for number in (0, 1, 3):
        step = -np.array(WIND) * number / 5.0
        moved = scene(**(QUICK | changes), ground=None, sequence=None)
        moved["atmosphere"] = data["atmosphere"]
        for table, keys in ((moved["camera"], ("position_m", "look_at_m")),
                            (moved["targets"]["box"], ("center_m",))):  # fmt: skip
            for key in keys:
                table[key] = (np.array(table[key]) + step).tolist()
        alone = thzcl.run(write(tmp_path, moved, "alone"), device=device).variants[0].sight
        sight = found[number].variants[0].sight
        assert (sight.target == alone.target).all()
        assert sight.optical_depth == pytest.approx(alone.optical_depth, rel=5e-7 if not changes
                                                    else 5e-5)  # fmt: skip
    first, last = (found[n].variants[0].sight.optical_depth for n in (0, 3))
    assert np.abs(first - last).max() > 0.01


def test_frames_share_all_but_what_moves(tmp_path):
    plan = pipeline.prepare(write(tmp_path, moving(sensor__frequency_ghz=[340.0, 650.0])))
    specs = everything(spec for number in range(3) for spec in plan.frame(number))
    assert sum(isinstance(spec, EndsSpec) for spec in specs) == 1
    assert sum(isinstance(spec, TraceSpec) for spec in specs) == 3
    alone = pipeline.prepare(write(tmp_path, moving(sequence=None)))
    still = pipeline.prepare(write(tmp_path, moving()))
    assert still.frame(0) == alone.batch()


def test_the_file_holds_every_frame_and_what_they_have_in_common(tmp_path, device):
    variants = [{"name": "a"}, {"name": "b", "set": {"sensor.frequency_ghz": 340.0}}]
    source = write(tmp_path, moving(variants=variants))
    told = thzcl.sequence(source, tmp_path / "out.nc", device=device)
    assert told.frames == 4 and [p.name for p in told.files] == ["out.nc", "out.gif"]
    expected = frames_of(source, device)
    with h5netcdf.File(tmp_path / "out.nc") as file:
        assert file["time"][...] == pytest.approx([0.0, 0.2, 0.4, 0.6])
        assert file["image"].dimensions == ("time", "variant", "y", "x")
        assert file["optical_depth"].dimensions == ("time", "variant", "frequency", "y", "x")
        assert file["target"].dimensions == ("y", "x")
        stack = np.array([[v.image.values for v in frame.variants] for frame in expected])
        assert (file["image"][...] == stack.astype(np.float32)).all()
        mean, variance = stack.mean(0, dtype=float), stack.var(0, ddof=1, dtype=float)
        assert file["image_mean"][...] == pytest.approx(mean, rel=1e-6)
        assert file["image_variance"][...] == pytest.approx(variance, rel=1e-3, abs=1e-9)
        index = file["scintillation_index"][...]
        assert index == pytest.approx(variance / mean**2, rel=1e-3, abs=1e-14)
    with Image.open(tmp_path / "out.gif") as picture:
        assert picture.n_frames == 4 and picture.info["duration"] == 200
    again = thzcl.run(tmp_path / "out.nc", settings={"sequence": None}, device=device)
    assert (again.variants[0].image.values == expected[0].variants[0].image.values).all()


def test_noise_is_another_in_every_frame(tmp_path, device):
    calm = scene()["atmosphere"]["fluctuations"]
    data = moving(sensor=RADIOMETER, atmosphere__fluctuations=calm)
    one, other, *_ = (frame.variants[0] for frame in frames_of(write(tmp_path, data), device))
    assert (one.sight.optical_depth == other.sight.optical_depth).all()
    assert np.std(one.image.values - other.image.values) > 0.1


def test_a_scan_goes_on_from_where_the_wind_has_moved_the_air(tmp_path, device):
    scan = {"kind": "raster-scan", "dwell_s": 1e-4,
            "detector": {"kind": "passive-spectral", "frequency_ghz": 650.0}}  # fmt: skip
    slow = moving(sensor=scan, rate_hz=50.0, camera__pixels=[16, 12])
    one, other, *_ = frames_of(write(tmp_path, slow), device)
    first, second = (f.variants[0].sight.optical_depth for f in (one, other))
    assert np.abs(first - second).max() > 1e-3
    too_fast = moving(sensor=scan, rate_hz=60.0, camera__pixels=[16, 12])
    with pytest.raises(ScenarioError, match=r"leaves no time for the 0.0192 s .* at most 52"):
        pipeline.prepare(write(tmp_path, too_fast))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sequence": {"rate_hz": 5.0}}, "duration_s"),
        ({"sequence": {"rate_hz": 5.0, "duration_s": 0.1}}, "makes 0 frames"),
        ({"atmosphere__fluctuations__wind_m_s": [0.0, 0.0, 0.0]}, "nothing changes from frame"),
        ({"numerics": {"realizations": 3}}, "exclude each other"),
        ({"sensor": RADIOMETER, "sequence": {"rate_hz": 501.0, "frames": 2}}, "no time for"),
        (
            {"variants": [{"name": "a"}, {"name": "b", "set": {"sequence.frames": 9}}]},
            "give it",
        ),
    ],
)
def test_sequences_that_cannot_be_are_refused(tmp_path, changes, words):
    with pytest.raises(ScenarioError, match=words):
        pipeline.prepare(write(tmp_path, moving(**changes)))


def test_one_image_is_not_taken_for_a_sequence_nor_the_reverse(tmp_path, device):
    with pytest.raises(ScenarioError, match=r"call thzcl\.sequence"):
        thzcl.run(write(tmp_path, moving()), device=device)
    with pytest.raises(ScenarioError, match=r"has no \[sequence\]"):
        thzcl.sequence(write(tmp_path, scene()), tmp_path / "x.nc", device=device)
    with pytest.raises(ScenarioError, match=r"\[sequence\] is refused in a study"):
        thzcl.study(write(tmp_path, moving()), tmp_path / "s", seeds=1, device=device)


def test_a_sequence_that_fails_leaves_nothing(tmp_path, device, monkeypatch):
    from thzcl.results.frames import Writer

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "add", full)
    with pytest.raises(OSError, match="No space"):
        thzcl.sequence(write(tmp_path, moving()), tmp_path / "out.nc", device=device)
    assert not list(tmp_path.glob("*.nc"))


def test_the_command_takes_a_sequence(thzcl_json, tmp_path):
    source = write(tmp_path, moving(frames=3))
    told = thzcl_json("run", source)
    assert told["frames"] == 3
    assert told["files"] == ["scene.nc", "scene.gif", "scene.png"]
    assert all((tmp_path / name).is_file() for name in told["files"])
