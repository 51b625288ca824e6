"""Noise of passive sensors: its law, its size by every reading, and what it is refused for.

The right values are closed forms of the oracle, or printed ones (issue and PHYSICS 6).
"""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import run, scene, write

from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.sensor import noise

NO_AIR = {"temperature_k": 300.0, "relative_humidity_percent": 0.0, "model": "none"}
MILLION = 1000
BAND = {"kind": "passive-broadband", "center_ghz": 350.0, "bandwidth_ghz": 30.0}
NEP = {"noise_equivalent_power_w_rthz": 3e-12}
PHOTONS = BAND | {"photon_noise": True, "integration_time_s": 1e-3}
RADIOMETER = {
    "kind": "radiometer",
    "frequency_ghz": 340.0,
    "if_center_ghz": 5.0,
    "if_bandwidth_ghz": 4.0,
    "receiver_temperature_k": 1500.0,
    "integration_time_s": 2e-3,
}


def wall(sensor, pixels=4, kelvin=300.0, field_mm=2.0, focal_mm=1000.0):
    """Returns a scene of a black wall across the whole field, without air."""
    return {
        "camera": {
            "position_m": [0.0, 0.0, 50.0],
            "look_at_m": [40.0, 0.0, 50.0],
            "focal_length_mm": focal_mm,
            "focal_plane_mm": [field_mm, field_mm],
            "pixels": [pixels, pixels],
        },
        "atmosphere": NO_AIR,
        "targets": {
            "w": {
                "kind": "box",
                "center_m": [40.5, 0.0, 50.0],
                "size_m": [1.0, 400.0, 400.0],
                "temperature_k": kelvin,
            }
        },
        "sensor": sensor,
        "numerics": {"noise_seed": 7},
    }


def imaged(folder, sensor, pixels=4, **more):
    return run(folder, wall(sensor, pixels, **more)).variants[0].image


def received(image):
    return image.layers["received_power"].values


def scan(detector, **more):
    return {"kind": "raster-scan", "dwell_s": 1e-3, "detector": detector} | more


def is_white_and_gaussian(values):
    """Neighbours, mean cube and mean fourth power of a million, each to five of its own sigma."""
    normal = (values - values.mean()) / values.std()
    count = normal.size
    for axis in (0, 1):
        along = np.moveaxis(normal, axis, 0)
        assert abs((along[1:] * along[:-1]).mean()) < 5 / math.sqrt(count)
    assert abs((normal**3).mean()) < 5 * math.sqrt(6 / count)
    assert abs((normal**4).mean() - 3) < 5 * math.sqrt(24 / count)


SLOPE = oracle.K * 30e9 * 0.9997  # W/K of one mode, 350 GHz and 300 K: x^2 e^x / (e^x - 1)^2
READINGS = {
    "integration": (BAND | NEP | {"integration_time_s": 1e-3}, 3e-12 * math.sqrt(500.0)),
    "dwell": (scan(BAND | NEP), 6.7082e-11),
    "settling": (scan(BAND | NEP | {"integration_time_s": 5e-4}), 3e-12 * math.sqrt(1000.0)),
    "focal plane": (
        scan(BAND | NEP, timing="focal-plane", integration_time_s=0.02, samples=1),
        3e-12 * math.sqrt(25.0),
    ),
    "frame rate": (BAND | NEP | {"frame_rate_hz": 100.0}, 3e-11),
    "frame rate, by name": (
        scan(BAND | NEP | {"frame_rate_hz": 100.0, "noise_bandwidth": "frame-rate"}),
        3e-11,
    ),
    "scanned": (
        BAND | NEP | {"frame_rate_hz": 100.0, "noise_bandwidth": "scanned"},
        3e-11 * MILLION,
    ),
    "chopped": (
        BAND | NEP | {"integration_time_s": 1e-3, "modulation": "chopped"},
        6.7082e-11 * math.pi / math.sqrt(2),
    ),
    "efficiency": (
        BAND | NEP | {"integration_time_s": 1e-3, "optical_efficiency": 0.25},
        4 * 6.7082e-11,
    ),
    "NETD": (
        BAND | {"netd_k": 0.1, "netd_time_s": 0.5, "integration_time_s": 0.02},
        0.1 * 5 * SLOPE,
    ),
    "NETD of a frame": (
        BAND | {"netd_k": 0.1, "netd_time_s": 0.5, "frame_rate_hz": 2.0},
        0.1 * SLOPE,
    ),
    "photons": (PHOTONS, oracle.photon_netd(335e9, 365e9, 300.0, 1e-3) * SLOPE),
    "photons and NEP": (
        PHOTONS | {"noise_equivalent_power_w_rthz": 1e-15},
        oracle.photon_netd(335e9, 365e9, 300.0, 1e-3, nep=1e-15) * SLOPE,
    ),
}


@pytest.mark.parametrize("reading", READINGS)
def test_noise_of_a_detector_is_white_gaussian_and_of_its_size(tmp_path, reading):
    """Its variance within 1 % (0.14 % is one sigma of a million pixels)."""
    sensor, due = READINGS[reading]
    image = imaged(tmp_path, sensor, MILLION)
    values = received(image)
    assert values.var() == pytest.approx(due**2, rel=0.01)
    assert image.facts["noise power"] == (pytest.approx(due, rel=1e-3), "W")
    is_white_and_gaussian(values)


MODES = {
    "double": ({}, {"single": False, "drift": 0.0}),
    "single": ({"sideband": "single"}, {"single": True, "drift": 0.0}),
    "drift": ({"gain_drift": 1e-3}, {"single": False, "drift": 1e-3}),
    "single, drift": (
        {"sideband": "single", "gain_drift": 1e-3},
        {"single": True, "drift": 1e-3},
    ),
    "dicke": (
        {"switching": "dicke", "gain_drift": 1e-2, "reference_temperature_k": 77.0},
        {"single": False, "drift": 1e-2, "reference_k": 77.0},
    ),
    "dicke, balanced by the air": (
        {"switching": "dicke", "gain_drift": 1e-2, "sideband": "single"},
        {"single": True, "drift": 1e-2, "reference_k": 300.0},
    ),
}


@pytest.mark.parametrize("mode", MODES)
def test_the_radiometer_equation_in_each_mode(tmp_path, mode):
    """To 1 % over a million pixels, and the image reads the wall's temperature."""
    extra, parts = MODES[mode]
    image = imaged(tmp_path, RADIOMETER | extra, MILLION)
    due = oracle.radiometer_netd(1500.0, 300.0, 4e9, 2e-3, **parts)
    assert image.values.std() == pytest.approx(due, rel=0.01)
    assert image.values.mean() == pytest.approx(300.0, abs=5 * due / MILLION)
    assert image.facts["NEDT at the sensor"] == (pytest.approx(due, rel=1e-6), "K")
    is_white_and_gaussian(image.values)


@pytest.mark.parametrize(
    ("extra", "printed"),
    [
        ({}, 0.0548),
        ({"optical_efficiency": 0.1}, 0.0669),
        ({"optical_efficiency": 0.5, "optics_temperature_k": 293.0}, 0.1083),
    ],
)
def test_netd_of_photons(tmp_path, extra, printed):
    """One mode, 335-365 GHz, a wall of 300 K, 1 ms: to 0.5 % of the printed values."""
    found = imaged(tmp_path, PHOTONS | extra).facts["NEDT at the sensor"][0]
    assert found == pytest.approx(printed, rel=0.005)
    optics_k = extra.get("optics_temperature_k", 0.0)
    efficiency = extra.get("optical_efficiency", 1.0)
    due = oracle.photon_netd(335e9, 365e9, 300.0, 1e-3, efficiency, optics_k)
    assert found == pytest.approx(due, rel=1e-3)


def test_photon_noise_is_that_of_what_each_pixel_sees(tmp_path):
    """A step from 300 K to 1000 K in one image; at high n noise is T / sqrt(B t)."""
    data = wall(PHOTONS, 400)
    data["targets"]["w"] |= {
        "bars": [{"face": "-x", "count": 1000, "temperature_k": 1000.0}],
        "size_m": [1.0, 40.0, 40.0],
    }
    result = run(tmp_path, data).variants[0]
    kelvin = result.radiances.brightness_temperature[0]
    assert 0.3 < (kelvin > 900).mean() < 0.7
    for warm, due in ((kelvin > 900, 1000.0), (kelvin < 400, 300.0)):
        sigma = received(result.image)[warm].std() / SLOPE
        netd = oracle.photon_netd(335e9, 365e9, due, 1e-3)
        slope = 1.0 if due == 300.0 else 1 / 0.9997  # of Planck's law, 1000 K over 300 K
        assert sigma / slope == pytest.approx(netd, rel=0.02)


def test_geometric_photons_have_many_modes(tmp_path):
    """N modes have N times the variance and N times the slope: 1 / sqrt(N) of the NETD."""
    lens = {"throughput": "geometric", "aperture_m": 0.3}
    sensor = PHOTONS | lens
    found = imaged(tmp_path, sensor, field_mm=12.0).facts["NEDT at the sensor"][0]
    modes = 2 * math.pi / 4 * 0.09 * (3e-3) ** 2 * (350e9 / oracle.C) ** 2
    due = oracle.photon_netd(335e9, 365e9, 300.0, 1e-3) / math.sqrt(modes)
    assert modes > 1
    assert found == pytest.approx(due, rel=2e-3)


def test_a_table_of_half_height_has_the_noise_of_a_flat_band_of_its_own(tmp_path):
    """Response is relative to its peak: half a response everywhere halves the power alone."""
    for height in (1.0, 0.5):
        rows = f"335,{height}\n365,{height}\n"
        (tmp_path / f"{height}.csv").write_text(rows, encoding="utf-8")
    sensor = {"kind": "passive-broadband", "photon_noise": True, "integration_time_s": 1e-3}
    full, half = (
        imaged(tmp_path, sensor | {"response": f"{height}.csv"}).facts for height in (1.0, 0.5)
    )
    assert full["noise power"][0] == pytest.approx(half["noise power"][0], rel=1e-9)
    assert full["NEDT at the sensor"][0] == pytest.approx(0.0548, rel=0.005)


def test_signal_to_noise_of_each_target(tmp_path):
    """Contrast over noise, and noise over transmission, by hand."""
    data = scene(sensor=BAND | NEP, numerics={"noise_seed": 1})
    found = run(tmp_path, data)
    (variant,) = found.summary()["variants"]
    target = variant["targets"]["box"]
    at_sensor = variant["facts"]["NEDT at the sensor"]["value"]
    assert target["snr"] == pytest.approx(abs(target["mean_contrast_k"]) / at_sensor)
    assert target["netd_k"] == pytest.approx(at_sensor / target["transmission"])
    assert variant["facts"]["SNR"] == {"value": pytest.approx(target["snr"]), "unit": "1"}
    quiet = run(tmp_path, scene()).summary()["variants"][0]
    assert quiet["targets"]["box"]["snr"] is quiet["targets"]["box"]["netd_k"] is None
    assert not quiet["facts"]


def test_a_scan_says_whose_time_it_is(tmp_path):
    told = {
        "integrates for the scan's 0.001 s a pixel": BAND | NEP,
        "integrates for 0.0005 s of the scan's 0.001 s": BAND | NEP | {"integration_time_s": 5e-4},
        "does not follow from the scan's 0.001 s": BAND | NEP | {"noise_bandwidth": "frame-rate"},
    }
    for words, detector in told.items():
        assert any(words in one for one in run(tmp_path, wall(scan(detector))).warnings)
    assert not run(tmp_path, wall(scan(BAND))).warnings
    plain = {name: v for name, v in RADIOMETER.items() if name != "integration_time_s"}
    image = imaged(tmp_path, scan(plain))
    assert image.facts["integration time"] == (1e-3, "s")


def test_corners_of_a_wide_field_and_less_than_one_mode(tmp_path):
    """A field of 90 degrees: cos^4 of the angle off the axis, by the power of every pixel."""
    lens = {"throughput": "geometric", "aperture_m": 0.3}
    result = run(tmp_path, wall(BAND | lens, 16, field_mm=20.0, focal_mm=10.0))
    tangent = ((np.arange(16) - 7.5) * 20 / 16 / 10) ** 2
    due = (1 + tangent + tangent[:, None]) ** -2
    power = received(result.variants[0].image)
    assert power / power.max() == pytest.approx(due / due.max(), rel=1e-6)
    kelvin = result.variants[0].image.values
    assert kelvin == pytest.approx(np.full((16, 16), kelvin[0, 0]), rel=1e-6)
    assert not result.warnings
    (warning,) = run(tmp_path, wall(BAND | lens)).warnings
    assert "less than one mode" in warning


BOTH = {"netd_k": 0.1, "netd_time_s": 1.0}
REFUSED = {
    "NETD and NEP": (BAND | NEP | BOTH, "is part of netd_k"),
    "NETD and photons": (BAND | BOTH | {"photon_noise": True}, "is part of netd_k"),
    "NETD and efficiency": (BAND | BOTH | {"optical_efficiency": 0.5}, "is part of netd_k"),
    "NETD and chopping": (BAND | BOTH | {"modulation": "chopped"}, "is part of netd_k"),
    "NETD without time": (BAND | {"netd_k": 0.1}, "netd_time_s: missing"),
    "time without NETD": (BAND | NEP | {"netd_time_s": 1.0}, "netd_k: missing"),
    "zero dwell": (scan(BAND | NEP, dwell_s=0.0), "dwell_s: must be above 0 s, not 0"),
    "zero time": (BAND | NEP | {"integration_time_s": 0.0}, "must be above 0 s, not 0"),
    "longer than the dwell": (
        scan(BAND | NEP | {"integration_time_s": 1.0}),
        "is longer than the 0.001 s for which the scan stays on a pixel",
    ),
    "longer than the frame": (
        BAND | NEP | {"integration_time_s": 1.0, "frame_rate_hz": 2.0},
        "is longer than a frame at 2 Hz",
    ),
    "rate and dwell": (scan(BAND | NEP | {"frame_rate_hz": 1.0}), "remove frame_rate_hz, or say"),
    "time and named rate": (
        BAND | NEP | {"integration_time_s": 0.1, "noise_bandwidth": "frame-rate"},
        "has no effect with noise_bandwidth",
    ),
    "no time": (BAND | NEP | {"noise_bandwidth": "integration"}, "needs integration_time_s"),
    "optics that absorb nothing": (
        PHOTONS | {"optics_temperature_k": 293.0},
        "needs an optical_efficiency below 1",
    ),
    "optics without photons": (
        BAND | NEP | {"optics_temperature_k": 293.0, "optical_efficiency": 0.5},
        "set photon_noise = true",
    ),
    "time without noise": (BAND | {"integration_time_s": 0.1}, "integration_time_s: is a matter"),
    "chopping without noise": (BAND | {"modulation": "chopped"}, "but there is none"),
    "NEP of a noiseless sensor": (
        {"kind": "passive-spectral", "frequency_ghz": 650.0} | NEP,
        "noise_equivalent_power_w_rthz: unknown key",
    ),
    "no time of the radiometer": (
        {name: v for name, v in RADIOMETER.items() if name != "integration_time_s"},
        "integration_time_s: missing",
    ),
    "IF below 0": (RADIOMETER | {"if_center_ghz": 1.0}, "reaches below 0 GHz"),
    "IF above the oscillator": (
        RADIOMETER | {"frequency_ghz": 6.0},
        "must lie above the intermediate-frequency band",
    ),
    "reference without switch": (
        RADIOMETER | {"reference_temperature_k": 77.0},
        'goes with switching = "dicke"',
    ),
    "drift above 1": (RADIOMETER | {"gain_drift": 1.0}, "must be below 1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_noise_that_makes_no_sense_is_refused_in_one_message(tmp_path, case):
    sensor, expected = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, wall(sensor)))
    assert expected in str(caught.value)
    assert len(caught.value.problems) == 1


def test_a_frame_rate_without_noise_is_told(tmp_path):
    """Rather than refused: scenes of before go on."""
    (warning,) = run(tmp_path, wall(BAND | {"frame_rate_hz": 9.0})).warnings
    assert "frame_rate_hz: is used with noise_equivalent_power_w_rthz or netd_k" in warning
    assert not run(tmp_path, wall(PHOTONS | {"noise_bandwidth": "integration"})).warnings


def test_a_noise_seed_is_always_allowed(tmp_path):
    found = run(tmp_path, wall({"kind": "passive-spectral", "frequency_ghz": 650.0}))
    assert not found.warnings
    assert found.noise_seed is None


def test_photon_noise_by_look_up_is_photon_noise():
    """From 2.7 K to 1000 K, each temperature by itself."""
    hz, width = np.linspace(300e9, 900e9, 31), np.full(31, 20e9)
    one = np.ones(31)
    kelvin = np.array([2.7, 20.0, 77.0, 300.0, 1000.0])
    together = noise.photon_nep_squared(kelvin, hz, width, one, one, 0.7, 4.0)
    for number, single in enumerate(kelvin):
        alone = noise.photon_nep_squared(np.array([single]), hz, width, one, one, 0.7, 4.0)
        assert together[number] == pytest.approx(alone[0], rel=0.01 if single < 10 else 1e-3)
