"""The broadband imager: sums over its band, power, and noise."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import oracle
import pytest
from scenes import BROAD, MIRROR, facing, run, scene

from thzcl.air import radiometry
from thzcl.air.composition import part
from thzcl.air.constituents.mpm93 import line_centers_ghz, line_width_ghz
from thzcl.air.mean import Air
from thzcl.sensing import bands
from thzcl.sensor import Radiances

MILD = {"temperature_k": 293.15, "relative_humidity_percent": 44.0}


@pytest.mark.parametrize(
    ("changes", "expected", "within"),
    [
        ({}, 0.2105, 0.002),
        ({"quadrature": "paper"}, 0.185, 0.004),
        ({"quadrature": "paper", "paper_steps": "trapezoid"}, 0.197, 0.004),
        ({"quadrature": "paper", "paper_steps": "bins"}, 0.227, 0.004),
    ],
)
def test_mean_transmission_of_the_band(tmp_path, changes, expected, within):
    """Of 80 m of uniform air at 20 degrees and 44 %, by each quadrature (PHYSICS 4)."""
    wall = MIRROR | {"center_m": [81.0, 0.0, 1.2], "reflectivity": 0.0, "temperature_k": 310.0}
    result = run(
        tmp_path, facing(80.0, sensor=BROAD | changes, atmosphere=MILD, targets={"wall": wall})
    )
    assert np.exp(-result.variants[0].sight.optical_depth[0, 1, 1]) == pytest.approx(
        expected, rel=within
    )
    error = result.error_budget["band-quadrature"]["relative"]
    assert (
        error < 1e-5 if not changes else error == pytest.approx(abs(0.2105 / expected - 1), rel=0.1)
    )


def test_a_resolved_band_is_the_integral(tmp_path):
    """The power of a single mode before a warm wall behind 80 m of air, by brute force."""
    found = run(
        tmp_path, facing(80.0, sensor=BROAD, atmosphere=MILD, numerics={"precision": "float64"})
    ).variants[0]
    hz = np.linspace(600e9, 700e9, 20001)
    grams = 0.44 * oracle.saturation_hpa(293.15) * 1e5 / (461.525 * 293.15)
    depth = oracle.absorption_per_m(hz, 293.15, 1013.25, grams) * 80.0
    air = np.array([oracle.planck(f, 293.15) for f in hz])
    # A mirror of surroundings at air temperature: its reflectivity is 1, so nothing differs from
    # air.
    assert np.abs(found.sight.contrast).max() == 0
    power = np.trapezoid((oracle.C / hz) ** 2 / 2 * air, hz)
    assert found.image.layers["received_power"].values[1, 1] == pytest.approx(power, rel=1e-6)
    wall = MIRROR | {"center_m": [81.0, 0.0, 1.2], "reflectivity": 0.0, "temperature_k": 310.0}
    warm = run(
        tmp_path,
        facing(
            80.0,
            sensor=BROAD,
            atmosphere=MILD,
            targets={"wall": wall},
            numerics={"precision": "float64"},
        ),
    )
    above = np.array([oracle.planck(f, 310.0) for f in hz]) - air
    expected = np.trapezoid((oracle.C / hz) ** 2 / 2 * (air + above * np.exp(-depth)), hz)
    assert warm.variants[0].image.layers["received_power"].values[1, 1] == pytest.approx(
        expected, rel=1e-6
    )


def test_single_mode_at_300_kelvin():
    """0.39 nW over 100 GHz, 1.38e-12 W/K, and so 21.7 K for 3e-11 W (PHYSICS 4)."""
    band = bands.named("flat", 650e9, 100e9)
    hz = np.linspace(band.low_hz, band.high_hz, 2001)
    modes = (radiometry.LIGHT_SPEED / hz) ** 2 / 2
    assert np.trapezoid(modes * radiometry.planck(hz, 300.0), hz) == pytest.approx(
        0.39e-9, rel=0.01
    )
    slope = np.trapezoid(modes * radiometry.planck_slope(hz, 300.0), hz)
    assert slope == pytest.approx(1.38e-12, rel=0.003)
    assert 3e-11 / slope == pytest.approx(21.7, abs=0.05)


def test_noise_of_a_million_pixels(tmp_path):
    """NEP sqrt(B), within 1 %; the same seed gives the same image.

    One detector for all pixels is noisier by the root of their number.
    """
    noisy = BROAD | {"noise_equivalent_power_w_rthz": 3e-12, "frame_rate_hz": 100.0}
    seeded = {"noise_seed": 1}
    data = facing(40.0, sensor=noisy, camera__pixels=[1000, 1000], numerics=seeded)
    one, again = (run(tmp_path, data).variants[0].image for _ in range(2))
    power = one.layers["received_power"].values
    assert power.std() == pytest.approx(3e-11, rel=0.01)
    assert np.array_equal(power, again.layers["received_power"].values)
    assert one.facts["noise power"] == (pytest.approx(3e-11), "W")
    assert one.facts["NEDT at the sensor"][0] == pytest.approx(21.75, abs=0.1)
    passed = np.exp(
        -float(run(tmp_path, facing(40.0, sensor=BROAD)).variants[0].sight.optical_depth[0, 1, 1])
    )
    assert one.facts["NEDT at the targets"][0] == pytest.approx(21.75 / passed, rel=0.01)
    scanned = run(
        tmp_path,
        facing(
            40.0,
            sensor=noisy | {"noise_bandwidth": "scanned"},
            camera__pixels=[300, 300],
            numerics=seeded,
        ),
    )
    assert scanned.variants[0].image.layers["received_power"].values.std() == pytest.approx(
        3e-11 * 300, rel=0.02
    )
    quiet = run(
        tmp_path,
        facing(40.0, sensor=BROAD | {"noise_equivalent_power_w_rthz": 0.0}, camera__pixels=[9, 9]),
    )
    assert quiet.variants[0].image.values.std() < 1e-6
    assert not quiet.variants[0].image.facts


def test_antenna_temperature_and_geometric_throughput(tmp_path):
    """Both throughputs give nearly the same antenna temperature.

    The geometric one collects A Omega in two polarisations.
    """
    single = run(tmp_path, facing(40.0, sensor=BROAD)).variants[0]
    geometric = run(
        tmp_path, facing(40.0, sensor=BROAD | {"throughput": "geometric", "aperture_m": 0.3})
    ).variants[0]
    kelvin = single.image.values[1, 1]
    # Planck against Rayleigh-Jeans: x / (exp(x) - 1) with x = 0.108 at 650 GHz and 290 K.
    assert kelvin == pytest.approx(290.0 * 0.108 / math.expm1(0.108), rel=0.002)
    assert geometric.image.values[1, 1] == pytest.approx(kelvin, rel=0.002)
    solid_angle = (12.0 / 30000 / 3) * (9.0 / 30000 / 3)
    hz = np.linspace(600e9, 700e9, 1001)
    expected = (
        math.pi / 4 * 0.09 * solid_angle * np.trapezoid([oracle.planck(f, 290.0) for f in hz], hz)
    )
    assert geometric.image.layers["received_power"].values[1, 1] == pytest.approx(
        expected, rel=1e-5
    )


def test_responses(tmp_path):
    """A table that says flat is flat; a Gaussian is its integral."""
    (tmp_path / "flat.csv").write_text(
        "# any\nfrequency_ghz,response\n600,1\n650,1\n700,1\n", encoding="utf-8"
    )
    flat = (
        run(tmp_path, facing(80.0, sensor=BROAD, atmosphere=MILD))
        .variants[0]
        .sight.optical_depth[0, 1, 1]
    )
    table = {"kind": "passive-broadband", "response": "flat.csv"}
    found = (
        run(tmp_path, facing(80.0, sensor=table, atmosphere=MILD))
        .variants[0]
        .sight.optical_depth[0, 1, 1]
    )
    assert found == pytest.approx(flat, rel=1e-5)
    gaussian = run(
        tmp_path,
        facing(
            80.0, sensor=BROAD | {"response": "gaussian", "bandwidth_ghz": 40.0}, atmosphere=MILD
        ),
    )
    hz = np.linspace(590e9, 710e9, 20001)
    grams = 0.44 * oracle.saturation_hpa(293.15) * 1e5 / (461.525 * 293.15)
    passed = np.exp(-80.0 * oracle.absorption_per_m(hz, 293.15, 1013.25, grams))
    weight = 0.5 ** ((hz - 650e9) / 20e9) ** 2
    expected = (weight * passed).sum() / weight.sum()
    assert np.exp(-gaussian.variants[0].sight.optical_depth[0, 1, 1]) == pytest.approx(
        expected, rel=0.002
    )


@pytest.mark.slow
def test_lines_of_thin_air_are_found():
    """At 1 hPa, lines a few MHz wide in a band of 100 GHz agree with a brute sum at 50 kHz.

    A quadrature that is not told of the lines misses them.
    """
    air = Air((part("mpm93"),), 288.0, 1.0, 0.2)
    view = {
        "air_temperature_k": 288.0,
        "path_m": (10.0, 10.0),
        "absorption": air.absorption,
        "lines_hz": line_centers_ghz() * 1e9,
    }
    band = bands.named("flat", 650e9, 100e9)
    hz = np.linspace(600e9, 700e9, 2000001)
    absorbed = np.trapezoid(1 - np.exp(-10.0 * air.absorption(hz)), hz) / 100e9
    found, blind = (
        bands.resolve(band, SimpleNamespace(**view, line_width_hz=width))
        for width in (line_width_ghz(1.0) * 1e9, 1e12)
    )
    errors = [
        q.weights @ (1 - np.exp(-10.0 * air.absorption(q.frequency_hz))) / 100e9 - absorbed
        for q in (found, blind)
    ]
    assert absorbed > 5e-4
    assert abs(errors[0]) < 1e-8
    assert abs(errors[1]) > 0.9 * absorbed


def test_bands_of_fluctuating_temperature(tmp_path):
    """The sum over the band of separate frequencies, path emission included."""
    warm = {"atmosphere__fluctuations__temperature_sigma_k": 1.0, "camera__pixels": [6, 4]}
    band = run(tmp_path, scene(**warm, sensor=BROAD | {"quadrature": "paper"})).variants[0].sight
    single = (
        run(tmp_path, scene(**warm, sensor__frequency_ghz=[600.0, 625.0, 650.0, 675.0, 700.0]))
        .variants[0]
        .sight
    )
    weights = (oracle.C / single.frequency_hz) ** 2
    expected = np.einsum("f,fyx->yx", weights, single.contrast) / weights.sum()
    assert band.contrast[0] == pytest.approx(expected, rel=1e-4, abs=1e-6 * np.abs(expected).max())


def test_radiances_of_a_band_know_their_nodes(tmp_path):
    sight = run(tmp_path, facing(40.0, sensor=BROAD)).variants[0].radiances
    assert isinstance(sight, Radiances)
    assert sight.weights.shape == (1, len(sight.nodes_hz))
    assert sight.frequency_hz == pytest.approx(650e9, rel=0.02)
