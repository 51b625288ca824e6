"""Optics: the diffraction pattern where it should be, nothing gained, lost or wrapped around."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import run, scene

from thzcl.sensing import optics
from thzcl.sensor import Optics
from thzcl.surfaces.geometry import Raster

WAVELENGTH = 299792458.0 / 650e9


def star(pixel_rad, pixels, width_rad, **optics_table):
    """A hot square on a background at air temperature, in air that absorbs nothing."""
    focal, width = 1000.0, 100.0 * width_rad
    plane = focal * pixel_rad * pixels
    point = {
        "kind": "box",
        "center_m": [100.0, 0.0, 0.0],
        "size_m": [1e-3, width, width],
        "temperature_k": 1e6,
    }
    return scene(
        camera={
            "position_m": [0.0, 0.0, 0.0], "look_at_m": [100.0, 0.0, 0.0], "focal_length_mm": focal,
            "focal_plane_mm": [plane, plane], "pixels": [pixels, pixels],
        },
        atmosphere={"model": "none", "temperature_k": 290.0, "relative_humidity_percent": 0.0},
        ground=None,
        background={},
        targets={"star": point},
        sensor={"kind": "passive-spectral", "frequency_ghz": 650.0, "optics": optics_table},
    )  # fmt: skip


def test_the_first_zero_of_the_diffraction_pattern(tmp_path):
    """At 1.22 lambda / D, to a per cent, with pixels of 0.05 lambda / D."""
    aperture = 0.3
    resolution = WAVELENGTH / aperture
    image = (
        run(tmp_path, star(0.05 * resolution, 81, 0.05 * resolution, aperture_m=aperture))
        .variants[0]
        .radiances.contrast[0]
    )
    assert np.unravel_index(image.argmax(), image.shape) == (40, 40)
    ring = image[40, 40:] / image[40, 40]
    lowest = 10 + int(np.argmin(ring[10:35]))
    # The minimum between samples, by the parabola through three.
    left, middle, right = ring[lowest - 1 : lowest + 2]
    zero = (lowest + 0.5 * (left - right) / (left - 2 * middle + right)) * 0.05
    assert zero == pytest.approx(1.22, rel=0.01)
    assert ring[lowest] < 1e-3
    airy = [(2 * bessel_j1(math.pi * 0.05 * n) / (math.pi * 0.05 * n)) ** 2 for n in range(1, 40)]
    assert ring[1:40] == pytest.approx(airy, abs=3e-3)


def bessel_j1(x):
    """By its integral."""
    angle = (np.arange(2000) + 0.5) * math.pi / 2000
    return float(np.mean(np.cos(angle - x * np.sin(angle))))


TABLES = [
    {"aperture_m": 0.3},
    {"aperture_m": 0.05, "pixel": False},
    {"blur_mrad": 3.0},
    {"aperture_m": 0.3, "blur_mrad": 1.0},
    {},
]


@pytest.mark.parametrize("table", TABLES)
def test_a_uniform_scene_is_unchanged_up_to_its_edges(tmp_path, table):
    data = scene(
        ground=None, targets={}, background__temperature_k=350.0, atmosphere__model="none",
        sensor={"kind": "passive-spectral", "frequency_ghz": 650.0, "optics": table},
    )  # fmt: skip
    contrast = run(tmp_path, data).variants[0].radiances.contrast[0]
    assert contrast == pytest.approx(contrast[0, 0], rel=1e-6)
    bare = (
        run(tmp_path, data | {"sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0}})
        .variants[0]
        .radiances.contrast
    )
    assert contrast == pytest.approx(bare[0], rel=1e-6)


def test_nothing_wraps_around(tmp_path):
    """A hot half of the frame does not reach the far edge of the other half."""
    wall = {
        "kind": "box",
        "center_m": [100.0, 50.0, 0.0],
        "size_m": [1.0, 100.0, 200.0],
        "temperature_k": 1000.0,
    }
    data = star(1e-3, 64, 1e-3, aperture_m=0.3)
    data["targets"] = {"wall": wall}
    image = run(tmp_path, data).variants[0].radiances.contrast[0]
    hot, cold = image[:, 0].mean(), image[:, -1].mean()
    # y is positive to the left, looking along +x. Of the far tail of the pattern some thousandths
    # arrive, not a half.
    assert hot > 0
    assert abs(cold / hot) < 0.01


def test_light_is_conserved_and_pixels_average(tmp_path):
    """The sum over pixels of a star's image is its radiance times its area, whatever the pixels.

    The star is 2.6 lambda / D wide: neither a whole number of rays nor of pixels.
    """
    resolution = WAVELENGTH / 0.3
    width = 2.6 * resolution
    due = (oracle.planck(650e9, 1e6) - oracle.planck(650e9, 290.0)) * width**2
    for pixel, pixels in ((0.5, 81), (1.0, 41), (2.5, 17)):
        data = star(pixel * resolution, pixels, width, aperture_m=0.3)
        image = run(tmp_path, data).variants[0].radiances.contrast[0]
        assert image.sum() * (pixel * resolution) ** 2 == pytest.approx(due, rel=0.005)


def test_the_sampling_is_as_fine_as_the_optics_ask():
    base = Raster(20, 30, (1, 1))
    fine = optics.sampling(Optics(aperture_m=0.3), base, (3e-3, 3e-3), np.array([650e9]))
    assert fine.block == (4, 4)  # 3 mrad against lambda / 2 D = 0.77 mrad
    assert fine.margin == math.ceil(16 * WAVELENGTH / 0.3 / 0.75e-3)
    assert fine.pixels == base.pixels
    coarse = optics.sampling(Optics(aperture_m=0.3), base, (0.1e-3, 0.1e-3), np.array([650e9]))
    assert coarse.block == (1, 1)
    assert optics.sampling(Optics(), base, (1e-3, 1e-3), np.array([650e9])) == base


def test_mtf_of_a_circular_aperture():
    """1 at 0, 0 at the cut-off and beyond, and 0.391 half way."""
    assert optics.mtf(np.array([0.0, 0.5, 1.0, 2.0])) == pytest.approx(
        [1.0, 0.3910, 0.0, 0.0], abs=1e-4
    )


def test_optics_are_left_out_unless_asked_for(tmp_path):
    assert "optics" in {item["stage"] for item in run(tmp_path, scene()).left_out}
    with_optics = run(tmp_path, scene(sensor__optics={"aperture_m": 0.3}))
    assert "optics" not in {item["stage"] for item in with_optics.left_out}
    assert with_optics.seconds["optics"] > 0
