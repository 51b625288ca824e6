"""Speckle's law, grain and looks, and the receiver of an active imager.

The right values are closed forms: Goodman, Speckle Phenomena in Optics (2007), by sums of the
oracle over the pupil, and the figures printed in the issue.
"""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import ACTIVE, run, write
from scipy.stats import kstest
from test_noise import is_white_and_gaussian, wall

from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.sensing import optics
from thzcl.sensor import Optics, noise, speckle
from thzcl.surfaces.camera import Raster

HZ = 650e9
APERTURE = 0.3  # m
CELL = oracle.C / HZ / APERTURE  # lambda / D, rad
PRINTED = {
    "flood": {1 / 9.5: 0.973, 1 / 4: 0.855, 1 / 2: 0.521, 1.0: 0.033},
    "beam": {1 / 9.5: 0.967, 1 / 4: 0.829, 1 / 2: 0.469, 1.0: 0.047},
}


def grain(cells, illumination="flood", *, pixel=False):
    """Returns the grain of square pixels of so many lambda / D."""
    optic = Optics(aperture_m=APERTURE, pixel=pixel)
    return optic.grain(HZ, (cells * CELL, cells * CELL), illumination)


def images(one, looks, count=16, size=1024):
    """Yields images of a mean over looks, by fixed seeds."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        yield sum(one.draw((size, size), rng) for _ in range(looks)) / looks


def contrast(image):
    return image.std() / image.mean()


# --- the law, the grain and the looks of a pixel ---------------------------------------------


@pytest.mark.parametrize("illumination", PRINTED)
def test_correlation_is_the_printed_one_and_the_pupils_transform(illumination):
    for apart, printed in PRINTED[illumination].items():
        found = float(speckle.correlation(np.array(apart), illumination))
        assert found == pytest.approx(printed, abs=6e-4)
        due = oracle.speckle_correlation(apart, illumination == "beam")
        assert found == pytest.approx(due, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("illumination", PRINTED)
@pytest.mark.parametrize("apart", PRINTED["flood"])
def test_neighbours_correlate_as_printed(illumination, apart):
    """To 0.03, along rows and along columns."""
    one = grain(apart, illumination)
    for image in images(one, 1, count=2):
        less = image - image.mean()
        for axis in (0, 1):
            along = np.moveaxis(less, axis, 0)
            found = (along[1:] * along[:-1]).mean() / image.var()
            assert found == pytest.approx(PRINTED[illumination][apart], abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("looks", [1, 4])
@pytest.mark.parametrize("illumination", PRINTED)
def test_contrast_of_points_is_that_of_their_looks(illumination, looks):
    """1 / sqrt(looks) to 1 %: the mean of 16 images of 1024^2 pixels, half a cell apart."""
    found = [contrast(image) for image in images(grain(0.5, illumination), looks)]
    assert np.mean(found) == pytest.approx(1 / math.sqrt(looks), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [0.1, 0.2, 0.35])
def test_contrast_of_pixels_counts_the_looks_within_them(cells):
    """Whose number is printed as 1.008, 1.033 and 1.104."""
    printed = {0.1: 1.008, 0.2: 1.033, 0.35: 1.104}[cells]
    one = grain(cells, pixel=True)
    assert one.looks() == pytest.approx(printed, abs=6e-4)
    found = np.mean([contrast(image) for image in images(one, 1)])
    assert found == pytest.approx(1 / math.sqrt(printed), rel=0.01)


@pytest.mark.parametrize(("cells", "printed"), [(0.5, 1.22), (1.0, 1.98), (2.0, 5.15)])
def test_looks_of_square_pixels(cells, printed):
    """To 3 %, by the formula, by the oracle's sum, and by the contrast of what is drawn."""
    one = grain(cells, pixel=True)
    assert one.looks() == pytest.approx(printed, rel=0.03)
    assert one.looks() == pytest.approx(oracle.looks_of_square(cells, beam=False), rel=5e-3)
    drawn = np.mean([contrast(image) ** -2 for image in images(one, 1, count=2, size=512)])
    assert drawn == pytest.approx(printed, rel=0.03)
    beam = grain(cells, "beam", pixel=True)
    assert beam.looks() == pytest.approx(oracle.looks_of_square(cells, beam=True), rel=5e-3)
    drawn = np.mean([contrast(image) ** -2 for image in images(beam, 1, count=2, size=512)])
    assert drawn == pytest.approx(beam.looks(), rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("looks", [1, 3])
@pytest.mark.parametrize("illumination", PRINTED)
def test_power_of_points_has_a_gamma_law(illumination, looks):
    """By Kolmogorov and Smirnov, p above 1e-3, on pixels 1.25 lambda / D apart."""
    (image,) = images(grain(1.25, illumination), looks, count=1, size=200)
    p = kstest(image.ravel(), "gamma", args=(looks, 0, 1 / looks)).pvalue
    assert p > 1e-3


def test_nothing_wraps_around_and_a_narrow_image_has_its_whole_law():
    """Opposite edges of a small image are independent; its mean over seeds is 1."""
    one = grain(1 / 4)
    many = np.array([one.draw((8, 8), np.random.default_rng(seed)) for seed in range(4000)])
    edges = many[:, 0, 0] - 1, many[:, 0, 7] - 1
    apart = 7 / 4
    due = oracle.speckle_correlation(apart, beam=False)
    assert (edges[0] * edges[1]).mean() == pytest.approx(due, abs=0.08)
    assert many[:, 0, 0].mean() == pytest.approx(1.0, abs=0.08)
    assert many[:, 0, 0].var() == pytest.approx(1.0, abs=0.2)


def test_pixels_that_hold_too_much_have_a_law_of_their_own(monkeypatch):
    """Beyond the bound each has the gamma law of its own looks, white."""
    one = grain(2.0, pixel=True)
    monkeypatch.setattr(speckle, "MOST_SAMPLES", 1000)
    (image,) = images(one, 1, count=1, size=256)
    assert image.mean() == pytest.approx(1.0, abs=0.01)
    assert contrast(image) ** -2 == pytest.approx(5.15, rel=0.03)


def test_blur_averages_speckle_too():
    """A Gaussian blur of a cell's width leaves less contrast than the pixel alone."""
    sharp = grain(0.25, pixel=True)
    blurred = Optics(aperture_m=APERTURE, blur_mrad=1e3 * CELL).grain(HZ, sharp.pixel_rad)
    (one,), (other,) = (list(images(g, 1, count=1, size=512)) for g in (sharp, blurred))
    assert contrast(other) < 0.8 * contrast(one)
    assert other.mean() == pytest.approx(1.0, abs=0.02)


# --- the mean power of a scanned beam ---------------------------------------------------------


def test_a_scanned_beam_sees_a_point_by_the_fourth_power():
    """Its kernel is |h|^4 of the Airy amplitude, 0.74 of lambda / D wide where a flood's is 1.03.

    But for 1e-4 of its light it lies within the margin.
    """
    from scipy.special import j1

    for two_way, width in ((False, 1.03), (True, 0.74)):
        optic = Optics(aperture_m=APERTURE, pixel=False)
        fine = CELL / 32
        reach = (5 if two_way else 16) * 32
        rays = Raster(2 * reach + 1, 2 * reach + 1, (1, 1), reach)
        kernel = optics.kernels(optic, rays, (fine, fine), np.array([HZ]), two_way=two_way)[0]
        middle = kernel[reach] / kernel[reach, reach]
        x = np.pi * np.arange(-reach, reach + 1) / 32 + 1e-9
        h = 2 * j1(x) / x
        assert middle == pytest.approx(h**4 if two_way else h**2, abs=2e-4)
        half = np.interp(0.5, middle[reach:][::-1][-40:], np.arange(40)[::-1]) / 32
        assert 2 * half == pytest.approx(width, abs=0.01)


@pytest.mark.parametrize("illumination", ["flood", "beam"])
def test_mean_power_of_a_bar_is_blurred_by_the_light(tmp_path, illumination):
    """The transfer of a bar's power, by its spectrum, against the oracle's pupil."""
    pixels, pitch = 256, CELL / 4
    data = wall(ACTIVE, pixels, field_mm=1.0)
    data["camera"] |= {
        "focal_plane_mm": [pixels * pitch * 1e3, 4 * pitch * 1e3],
        "pixels": [pixels, 4],
    }
    width = 10 * CELL * 40
    data["targets"]["w"] |= {"size_m": [1.0, width, 400.0], "reflectivity": 1.0}
    lens = {"aperture_m": APERTURE, "pixel": False}
    data["sensor"] = ACTIVE | {"optics": lens, "illumination": illumination}
    row = run(tmp_path, data).variants[0].image.layers["received_power"].values[2]
    k = np.fft.rfftfreq(pixels, pitch) * CELL
    found = np.abs(np.fft.rfft(row))
    _, inside = oracle.pupil_points(400)
    plane = np.abs(np.fft.ifft2(inside.astype(float), (1600, 1600)))  # |h| on a lattice
    power = plane**4 if illumination == "beam" else plane**2
    transfer = np.abs(np.fft.fft2(power))[0]
    transfer /= transfer[0]
    due = np.interp(k, np.arange(800) / 400, transfer[:800]) * np.abs(np.sinc(k * 10))
    lost = 0.013 if illumination == "flood" else 0.005  # of the light, beyond the kernel's end
    assert found / found[0] == pytest.approx(due, abs=lost)


# --- the receiver -----------------------------------------------------------------------------

NEP = {"noise_equivalent_power_w_rthz": 1e-9, "bandwidth_hz": 1e4}
FIGURE = {"noise_figure_db": 10.0, "bandwidth_hz": 1e9}
BOLTZMANN_NOISE = 1.380649e-23 * 290 * 10 * 1e9  # W


def echo(folder, sensor, pixels=500, **more):
    """Returns the image of a wall that sends back 1e-12 W in 0.1 mW times its reflectivity."""
    data = wall(ACTIVE | {"source_power_w": 4e-11} | sensor, pixels, **more)
    data["targets"]["w"]["reflectivity"] = 0.25
    return run(folder, data).variants[0].image


def received(image):
    return image.layers["received_power"].values


def test_a_nep_adds_white_gaussian_noise_to_the_power(tmp_path):
    """NEP sqrt(B), its variance to 1 % over a million pixels; by bandwidth, time and scan."""
    for more in ({}, {"bandwidth_hz": None, "integration_time_s": 5e-5}):
        sensor = {name: v for name, v in (NEP | more).items() if v is not None}
        image = echo(tmp_path, sensor, 1000)
        values = received(image)
        assert values.var() == pytest.approx(1e-14, rel=0.01)
        assert values.mean() == pytest.approx(1e-11, abs=5e-10)
        is_white_and_gaussian(values)
        np.testing.assert_allclose(image.layers["noise_power"].values, 1e-7, rtol=1e-6)
        np.testing.assert_allclose(image.layers["snr"].values, 1e-4, rtol=1e-6)
        assert image.facts["SNR"] == (pytest.approx(1e-4), "1")
    detector = ACTIVE | {"noise_equivalent_power_w_rthz": 1e-9}
    scan = {"kind": "raster-scan", "dwell_s": 5e-5, "detector": detector}
    found = run(tmp_path, wall(scan)).variants[0].image.facts
    assert found["noise power"] == (pytest.approx(1e-7), "W")
    assert found["integration time"] == (5e-5, "s")


def test_a_noise_figure_adds_noise_to_the_field(tmp_path):
    """|s + n|^2: mean P + P_n, variance 2 P P_n + P_n^2, to 1 % over a million pixels."""
    image = echo(tmp_path, FIGURE, 1000)
    values, p, n = received(image), 1e-11, BOLTZMANN_NOISE
    assert values.mean() == pytest.approx(p + n, rel=0.002)
    assert values.var() == pytest.approx(2 * p * n + n**2, rel=0.01)
    neighbours = np.corrcoef(values[:, 1:].ravel(), values[:, :-1].ravel())[0, 1]
    assert abs(neighbours) < 5e-3
    assert image.facts["noise power"] == (pytest.approx(n), "W")
    assert image.layers["snr"].values[0, 0] == pytest.approx(p / n)
    dark = run(tmp_path, wall(ACTIVE | FIGURE, 500)).variants[0].image
    assert kstest(received(dark).ravel(), "expon", args=(0, n)).pvalue > 1e-3  # Rayleigh's field


def test_samples_of_a_receivers_noise_are_averaged(tmp_path):
    """B t = 8 of them have an eighth of the variance, and the same mean."""
    image = echo(tmp_path, FIGURE | {"integration_time_s": 8e-9})
    values, p, n = received(image), 1e-11, BOLTZMANN_NOISE
    assert values.mean() == pytest.approx(p + n, rel=0.002)
    assert values.var() == pytest.approx((2 * p * n + n**2) / 8, rel=0.02)
    by_hand = np.random.default_rng(1).standard_normal((2, 40000, 3)) * math.sqrt(n / 2)
    by_hand = ((math.sqrt(p) + by_hand[0]) ** 2 + by_hand[1] ** 2).mean(axis=1)
    three = noise.detected(np.full(40000, p), n, np.random.default_rng(2), 3.0)
    assert three.mean() == pytest.approx(by_hand.mean(), rel=0.02)


@pytest.mark.parametrize("speckled", [{"speckle_looks": 4.0}, {"looks": 4}])
def test_noise_and_speckle_add_up_look_by_look(tmp_path, speckled):
    """Speckle and noise are both circular: the sum of each look is exponential of mean P + P_n."""
    lens = {"optics": {"aperture_m": APERTURE, "pixel": False}} if "looks" in speckled else {}
    field = 1e3 * 500 * 1.25 * CELL
    image = echo(tmp_path, FIGURE | speckled | lens, field_mm=field)
    values, total = received(image), 1e-11 + BOLTZMANN_NOISE
    assert values.mean() == pytest.approx(total, rel=0.01)
    assert kstest(values[::2, ::2].ravel(), "gamma", args=(4, 0, total / 4)).pvalue > 1e-3
    assert image.facts["looks"] == (4.0, "1")


def test_without_noise_or_speckle_the_picture_is_clean_and_says_so(tmp_path):
    """Every echo is the same, no random number is drawn, and the caption tells it."""
    data = wall(ACTIVE, 8)
    data["targets"]["w"]["reflectivity"] = 0.25
    result = run(tmp_path, data)
    image = result.variants[0].image
    assert set(received(image).ravel()) == {received(image)[0, 0]}
    assert image.caption == "without speckle and receiver noise"
    assert "without speckle and receiver noise" in result.conditions[0]
    assert set(image.layers) == {"received_power", "below_floor"}
    assert {"stage": "noise", "reason": "a noiseless sensor"} in result.left_out
    noisy = echo(tmp_path, FIGURE | {"speckle_looks": 2.0}, 8)
    assert noisy.caption == "speckle of 2 looks, noise figure 10 dB"
    assert "NEP 1e-09 W/√Hz" in echo(tmp_path, NEP, 8).caption


LENS = {"optics": {"aperture_m": APERTURE}}
BISTATIC = {"arrangement": "bistatic", "transmitter_m": [0.0, 5.0, 50.0]}
REFUSED = {
    "NEP and figure": (NEP | FIGURE, "give only one of"),
    "looks and looks": (LENS | {"looks": 2, "speckle_looks": 2.0}, "give only one of"),
    "no look": (LENS | {"looks": 0}, "looks: must be at least 1, not 0"),
    "less than a look": ({"speckle_looks": 0.5}, "speckle_looks: must be at least 1"),
    "broken looks": (LENS | {"looks": 2.5}, "looks: must be a whole number"),
    "broken looks with a grain": (LENS | {"speckle_looks": 2.5}, "must be whole"),
    "broken looks with noise": (FIGURE | {"speckle_looks": 2.5}, "must be whole"),
    "looks without aperture": ({"looks": 2}, "needs an aperture_m in [sensor.optics]"),
    "looks from nothing": (LENS | {"looks_from": "frequency"}, "goes with looks"),
    "polarizations": (
        LENS | {"looks": 3, "looks_from": "polarization"},
        "polarization makes at most 2",
    ),
    "no beam": (
        {"optics": {"aperture_m": 4e-4}, "looks": 1},
        "optics.aperture_m: 0.0004 m is no wider than the wavelength, 0.000461 m",
    ),
    "no aperture of a beam": ({"illumination": "beam"}, '"beam" needs an aperture_m'),
    "two places of a beam": (
        LENS | BISTATIC | {"illumination": "beam"},
        "lights and receives from one place",
    ),
    "bandwidth without noise": ({"bandwidth_hz": 1e3}, "bandwidth_hz: is a matter of noise"),
    "time without noise": ({"integration_time_s": 1e-3}, "is a matter of noise"),
    "NEP without bandwidth": (
        {"noise_equivalent_power_w_rthz": 1e-9},
        "bandwidth_hz: missing; give it or integration_time_s",
    ),
    "two bandwidths": (NEP | {"integration_time_s": 1.0}, "is 1/(2 t) of integration_time_s"),
    "zero bandwidth": (NEP | {"bandwidth_hz": 0.0}, "bandwidth_hz: must be above 0 Hz"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_light_that_makes_no_sense_is_refused_in_one_message(tmp_path, case):
    sensor, expected = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, wall(ACTIVE | sensor)))
    assert expected in str(caught.value)
    assert len(caught.value.problems) == 1


def test_an_aperture_that_makes_no_beam_is_refused_for_any_sensor(tmp_path):
    sensor = {"kind": "passive-spectral", "frequency_ghz": 650.0, "optics": {"aperture_m": 1e-4}}
    with pytest.raises(ScenarioError, match="makes no beam; widen it"):
        pipeline.prepare(write(tmp_path, wall(sensor)))
