"""Formulas of contrast, resolution and detection, against Monte Carlo and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ACTIVE, facing, run, scene
from scipy.stats import norm

from thzcl import metrics
from thzcl.sensing import optics
from thzcl.sensor import Optics

SIZE = 16
WHITE = 1.0
DRAWS = 20000


def red():
    """A spectrum of white noise of variance 1 and clutter of variance 1/4 that falls as k^-11/3."""
    k = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.fftfreq(SIZE))
    clutter = np.where(k > 0, np.maximum(k, 1e-9) ** (-11 / 3), 0.0)
    return WHITE + clutter * 0.25 / clutter.mean()


def disc():
    y, x = np.indices((SIZE, SIZE)) - SIZE / 2
    return 0.4 * (np.hypot(x, y) < 3.5)


def drawn(spectrum, count, seed):
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(count, SIZE, SIZE))
    return np.fft.ifft2(np.fft.fft2(white) * np.sqrt(spectrum)).real


def area_of(null, present):
    """The share of pairs in which the statistic is larger with a target (Mann and Whitney)."""
    ranks = np.argsort(np.argsort(np.r_[null, present])) + 1.0
    n0, n1 = len(null), len(present)
    return (ranks[n0:].sum() - n1 * (n1 + 1) / 2) / (n0 * n1)


def test_the_matched_filter_detects_as_its_formulas_say():
    spectrum, signal = red(), disc()
    template = metrics.hotelling_template(signal, spectrum)
    d_prime = metrics.template_d_prime(template, signal, spectrum)
    null, present = (drawn(spectrum, DRAWS, seed) for seed in (1, 2))
    t0, t1 = ((part * template).sum((1, 2)) for part in (null, present + signal))
    assert metrics.sample_d_prime(t0, t1) == pytest.approx(d_prime, abs=4 * np.sqrt(2 / DRAWS))
    assert area_of(t0, t1) == pytest.approx(float(metrics.area(d_prime)), abs=0.008)
    found = np.mean(t1 > np.quantile(t0, 0.99))
    assert found == pytest.approx(float(metrics.detection_probability(d_prime, 0.01)), abs=0.02)


def test_red_clutter_looks_like_a_target_unless_it_is_whitened():
    spectrum, signal = red(), disc()
    matched = metrics.template_d_prime(
        metrics.hotelling_template(signal, spectrum), signal, spectrum
    )
    plain = metrics.template_d_prime(signal, signal, spectrum)
    as_white = np.sqrt((signal**2).sum() / spectrum.mean())
    t0, t1 = ((part * signal).sum((1, 2)) for part in (drawn(spectrum, DRAWS, 3),) * 2)
    t1 = t1 + (signal**2).sum()
    assert metrics.sample_d_prime(t0, t1) == pytest.approx(plain, abs=0.03)
    assert plain < 0.7 * matched and as_white > 2 * plain


@pytest.mark.parametrize(("cells", "looks", "ratio"), [(1, 1, 10.0), (16, 1, 2.0), (16, 4, 0.6)])
def test_speckle_is_detected_by_its_gamma_law(cells, looks, ratio):
    rng = np.random.default_rng(5)
    null, present = rng.gamma(looks, 1 / looks, (2, 60000, cells)).mean(2)
    present = ratio * present
    if ratio >= 1:
        found = np.mean(present > np.quantile(null, 0.99))
    else:
        found = np.mean(present < np.quantile(null, 0.01))
    told = float(metrics.speckle_detection(ratio, cells * looks, 0.01))
    assert found == pytest.approx(told, abs=0.02)
    area = float(metrics.speckle_area(ratio, cells * looks))
    assert area_of(null, present) == pytest.approx(area, abs=0.006)
    one_cell = float(metrics.speckle_cnr(ratio, cells * looks))
    assert metrics.cnr(present, null) == pytest.approx(one_cell, rel=0.02)


def test_gaussian_formulas_would_claim_more_of_speckle():
    gaussian = norm.cdf((10 - 1 - norm.isf(0.01)) / 10)  # of the same means and spreads
    assert gaussian == pytest.approx(0.748, abs=1e-3)
    assert metrics.speckle_detection(10.0, 1.0, 0.01) == pytest.approx(0.6310, abs=1e-4)


def test_spectra_are_averaged_by_radius_and_keep_their_variance():
    drawn_spectrum = np.mean([np.abs(np.fft.fft2(one)) ** 2 for one in drawn(red(), 400, 7)], 0)
    smooth = metrics.radial_mean(drawn_spectrum / SIZE**2)
    assert smooth.mean() == pytest.approx((drawn_spectrum / SIZE**2).mean())
    ratio = smooth[1:4, 0] / metrics.radial_mean(red())[1:4, 0]
    assert ratio == pytest.approx(1.0, abs=0.15)


def test_modulation_transfer_is_that_of_the_kernel_that_blurs_images():
    blur, hz, pixel = Optics(aperture_m=0.3, blur_mrad=0.4), 650e9, 2e-3
    cycles = np.linspace(0.0, 600.0, 61)
    curve = metrics.mtf(cycles, blur, hz, pixel)
    assert curve[0] == 1 and np.all(np.diff(curve[:20]) < 0)
    rays = optics.sampling(blur, optics.Raster(9, 9, (1, 1)), (pixel, pixel), np.array([hz]))
    kernel = optics.kernels(blur, rays, (pixel, pixel), np.array([hz]))[0].sum(axis=0)
    places = (np.arange(len(kernel)) - (len(kernel) - 1) / 2) * pixel / rays.block[1]
    for at in (10, 20, 30):
        seen = (kernel * np.cos(2 * np.pi * cycles[at] * places)).sum()
        assert seen == pytest.approx(curve[at], abs=0.02)  # the kernel ends at 16 lambda / D
    assert metrics.mtf(cycles, blur, hz, pixel, two_way=True)[5] > curve[5]


def test_surroundings_are_as_large_as_the_target_and_hold_no_occluder():
    target = np.zeros((12, 12), int)
    target[4:8, 4:8] = 2
    target[5:7, 8:11] = 3  # another target, beside it
    far, near = np.full((12, 12), 50.0), np.full((12, 12), 50.0)
    near[target == 3] = 10.0
    behind, ahead = (metrics.surroundings(target, length, 2) for length in (far, near))
    assert behind.sum() == ahead.sum() == 16
    assert behind[5:7, 8].all() and not ahead[target == 3].any()
    assert not (behind & (target == 2)).any()
    assert metrics.surroundings(target, far, 7).sum() == 0
    whole = np.full((4, 4), 2)
    assert metrics.surroundings(whole, np.ones((4, 4)), 2).sum() == 0


def test_noise_is_averaged_over_resolution_cells_and_not_over_pixels():
    rng = np.random.default_rng(9)
    inside = np.zeros((60, 60), bool)
    inside[5:55, 5:55] = True
    values = rng.normal(size=(60, 60))
    cells = metrics.cell_means(values, inside, (5, 2))
    assert len(cells) == 250 and cells.mean() == pytest.approx(values[inside].mean())
    assert np.std(cells) == pytest.approx(1 / np.sqrt(10), rel=0.15)
    few = metrics.cell_means(values, inside, (80, 80))
    assert few == pytest.approx(values[inside].mean())
    assert metrics.resolution_cell(Optics(aperture_m=0.3), 650e9, (0.5e-3, 1.6e-3)) == (1, 3)
    assert metrics.resolution_cell(None, 650e9, (1e-6, 1e-6)) == (1, 1)


def test_results_tell_how_a_target_stands_out(tmp_path):
    wall = {"kind": "box", "center_m": [41.0, 0.0, 1.2], "size_m": [2.0, 1.0, 1.0]}
    base = {
        "camera__pixels": [32, 32],
        "camera__focal_length_mm": 300.0,
        "numerics": {"error_budget": False, "noise_seed": 4},
        "background": {"temperature_k": 280.0, "max_range_m": 45.0},
    }
    noisy = {
        "kind": "radiometer", "frequency_ghz": 340.0, "if_center_ghz": 5.0, "if_bandwidth_ghz": 4.0,
        "receiver_temperature_k": 1500.0, "integration_time_s": 1e-3,
    }  # fmt: skip
    box = wall | {"temperature_k": 300.0}
    data = facing(40.0, **base, targets={"box": box}, sensor=noisy)
    told = run(tmp_path, data).summary()["variants"][0]
    target, facts = told["targets"]["box"], told["facts"]
    image = run(tmp_path, data).variants[0]
    seen = image.sight.brightness_temperature_contrast[0]
    ring = metrics.surroundings(image.sight.target, image.sight.path_length, 2)
    step = seen[image.sight.target == 2].mean() - seen[ring].mean()
    expected = abs(step) / facts["NEDT at the sensor"]["value"]
    assert target["cnr"] == pytest.approx(expected, rel=0.2)  # some 100 pixels a side
    assert target["contrast_db"] is None
    assert told["targets"]["background"]["cnr"] is None

    mirrors = {
        "box": wall | {"reflectivity": 0.4},
        "wall": wall | {"center_m": [45.0, 0.0, 1.2], "size_m": [2.0, 40.0, 40.0],
                        "reflectivity": 0.1},
    }  # fmt: skip
    dry = {"atmosphere__model": "none", "atmosphere__relative_humidity_percent": 0.0}
    data = facing(40.0, **(base | dry), targets=mirrors, sensor=ACTIVE)
    found = run(tmp_path, data).summary()["variants"][0]["targets"]["box"]
    assert found["contrast_db"] == pytest.approx(10 * np.log10(4.0), abs=1e-4)
    assert found["cnr"] is None  # nothing varies


def test_compared_models_and_means_tell_it_too(tmp_path):
    data = scene(
        atmosphere__compare=["r24"], numerics={"realizations": 3}, sensor__frequency_ghz=340.0
    )
    found = run(tmp_path, data).summary()["variants"][0]
    assert found["targets"]["box"]["cnr"] > 0
    assert found["models"]["r24"]["targets"]["box"]["cnr"] is None
