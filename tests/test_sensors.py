"""What built-in sensors refuse, and what they make of the paper's figures."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from scenes import ACTIVE, BROAD, run, scene

from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.scenario.sensors import HOOK, sensor_class

SCAN = {"kind": "raster-scan", "dwell_s": 1.0}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": 650.0}
TABLE = {"kind": "passive-broadband"}
BISTATIC = ACTIVE | {"arrangement": "bistatic"}
REFUSED = {
    "empty band": (BROAD | {"bandwidth_ghz": 0.0}, "bandwidth_ghz: must be above 0 GHz"),
    "band below 0": (
        BROAD | {"center_ghz": 30.0},
        "make a band of -20 to 80 GHz; it must lie above 0",
    ),
    "negative NEP": (
        BROAD | {"noise_equivalent_power_w_rthz": -1.0},
        "must be at least 0 W/sqrt(Hz)",
    ),
    "no band": (TABLE, "needs center_ghz and bandwidth_ghz"),
    "two bands": (TABLE | {"response": "x.csv", "center_ghz": 650.0}, "remove center_ghz"),
    "no table": (TABLE | {"response": "no.csv"}, "no.csv: cannot be read"),
    "outside": (TABLE | {"response": "../no.csv"}, "leads out of the scenario's folder"),
    "overlapping": (TABLE | {"response": "back.csv"}, "its frequencies do not ascend"),
    "broken table": (
        TABLE | {"response": "words.csv"},
        "words.csv:3: not comma-separated numbers",
    ),
    "geometric": (BROAD | {"throughput": "geometric"}, '"geometric" needs aperture_m'),
    "0 dB": (ACTIVE | {"dynamic_range_db": 0.0}, "must be above 0 dB, not 0"),
    "400 dB": (ACTIVE | {"dynamic_range_db": 400.0}, "must be at most 300 dB, not 400"),
    "transmitter in the box": (
        BISTATIC | {"transmitter_m": [25.0, 7.0, 1.0]},
        'the transmitter stands inside the target "box"',
    ),
    "transmitter below": (
        BISTATIC | {"transmitter_m": [0.0, 0.0, -1.0]},
        "not above the ground",
    ),
    "no transmitter": (BISTATIC, "transmitter_m"),
    "no detector": (SCAN, "needs a table [sensor.detector]"),
    "bad detector": (
        SCAN | {"detector": {"kind": "passive-spectral", "frequency": 1.0}},
        "did you mean frequency_ghz?",
    ),
    "no dwell": ({"kind": "raster-scan", "detector": SPECTRAL}, "needs dwell_s"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(tmp_path, case):
    (tmp_path / "back.csv").write_text("700,1\n600,1\n", encoding="utf-8")
    (tmp_path / "words.csv").write_text("frequency,response\n600,1\nlater,1\n", encoding="utf-8")
    sensor, expected = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        run(tmp_path, scene(sensor=sensor))
    assert expected in str(caught.value)


@pytest.mark.parametrize("kind", HOOK.built_ins)
def test_a_manual_page_tells_noise_and_what_is_left_out(kind):
    """And what the sensor was held against."""
    page = inspect.cleandoc(sensor_class(kind).__doc__).split("\n\n")
    for word in ("Noise: ", "Left out: ", "Validation: "):
        assert sum(part.startswith(word) for part in page) == 1, word


def test_figures_7_to_9_show_what_the_paper_says():
    """Of the active ones figure 9 loses the wettest 80 m panel entirely, figure 8 none.

    In the passive one, figure 7, noise hides more, farther and wetter: at 40 m the subject is seen
    up to 7.6 g/m3, at 80 m nowhere, the cold and dry climate included.
    """
    for name, lost in (("figure8", 0), ("figure9", 1)):
        result = pipeline.run(name)
        gone = [bool(v.image.layers["below_floor"].values.all()) for v in result.variants]
        assert sum(gone) == lost
        assert gone[-1] == bool(lost)
    seven = pipeline.run("figure7")
    strength = [
        v.sight.brightness_temperature_contrast[0].std() / v.image.facts["NEDT at the sensor"][0]
        for v in seven.variants
    ]
    assert strength[0] > strength[1] > strength[2] > strength[3]
    assert all(near > far for near, far in zip(strength[:4], strength[4:], strict=True))
    assert strength[0] > 0.6 and strength[1] > 0.3
    assert max(strength[4:]) < 0.2 and strength[7] < 0.01
    assert all(v.image.facts["noise power"] == (pytest.approx(3e-11), "W") for v in seven.variants)


def test_active_noise_is_figure_8_with_speckle_and_noise():
    """Its mean power is the clean image's; its noise that of the receiver, its looks four."""
    noisy = pipeline.run("active-noise", variants=["40 m, 20 °C, 44 % RH"]).variants[0]
    clean = {f"sensor.{key}": None for key in ("looks", "looks_from")}
    clean |= {f"sensor.{key}": None for key in ("noise_figure_db", "bandwidth_hz")}
    bare = pipeline.run("active-noise", settings=clean, variants=["40 m, 20 °C, 44 % RH"]).variants[
        0
    ]
    power, mean = (v.image.layers["received_power"].values for v in (noisy, bare))
    body = mean > 0.5 * np.percentile(mean, 90)
    watts = noisy.image.facts["noise power"][0]
    assert watts == pytest.approx(1.38e-23 * 290 * 10**1.5 * 1e7, rel=2e-3)
    ratio = power[body] / mean[body]
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
    assert ratio.std() == pytest.approx(0.5 / np.sqrt(1.09), rel=0.1)
    assert power[mean < 1e-3 * watts].mean() == pytest.approx(watts, rel=0.02)
    assert noisy.image.layers["snr"].values == pytest.approx(mean / watts, rel=1e-9)


def test_the_radiometer_scene_has_the_noise_that_it_tells():
    found = {v.name: v.image.facts for v in pipeline.run("radiometer", figure=False).variants}
    for name, dwell_s in (("0.1 ms a pixel", 1e-4), ("1 ms a pixel", 1e-3)):
        netd = found[name]["NEDT at the sensor"][0]
        system = found[name]["system temperature"][0]
        assert system == pytest.approx(3000 + 283, abs=10)
        assert netd == pytest.approx(np.hypot(system / np.sqrt(4e9 * dwell_s), 0.328), rel=1e-3)
