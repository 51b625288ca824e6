"""A band's own brightness temperature, and its optics by parts of the band.

The right values are walls of a known temperature, and sums of the oracle over frequency.
"""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import run
from test_noise import wall

from thzcl.air import planck_mean
from thzcl.graph import Values
from thzcl.sensing.spectrum import Bands, Frequencies, Split
from thzcl.surfaces.radiance import Emission, Enclosure, Reflecting

BAND = {"kind": "passive-broadband", "center_ghz": 650.0, "bandwidth_ghz": 100.0}
WIDE = BAND | {"center_ghz": 600.0, "bandwidth_ghz": 600.0}
APERTURE = 0.3


@pytest.mark.parametrize("sensor", [BAND, WIDE], ids=["100 GHz", "600 GHz"])
@pytest.mark.parametrize("kelvin", [77.0, 300.0, 1000.0])
@pytest.mark.parametrize("quadrature", ["resolved", "paper"])
def test_a_wall_reads_its_temperature(tmp_path, sensor, kelvin, quadrature):
    """To 1e-6 of itself, in bands whose mean frequency would tell 75.4 K for 77 K."""
    found = run(tmp_path, wall(sensor | {"quadrature": quadrature}, kelvin=kelvin))
    read = found.variants[0].radiances.brightness_temperature
    assert read == pytest.approx(np.full((1, 4, 4), kelvin), rel=1e-6)
    stored = found.to_xarray()["brightness_temperature"].values
    assert stored == pytest.approx(np.full((1, 1, 4, 4), kelvin), rel=1e-6)


def test_the_look_up_holds_from_cold_to_hot_and_for_microkelvins():
    """Of one image that holds all of them; the oracle sums Planck's law."""
    hz, weights = np.linspace(300e9, 900e9, 41), np.linspace(1.0, 3.0, 41)
    kelvin = [3.0, 20.0, 77.0, 299.0, 300.0 + 1e-6, 300.0, 500.0, 1e4, 1e9]
    means = [weights @ [oracle.planck(f, k) for f in hz] / weights.sum() for k in kelvin]
    contrast = np.array(means) - means[5]
    slope = (means[3] - means[5]) / (299.0 - 300.0)
    contrast[4] = 1e-6 * slope * (1 + 0.5 / 300)  # subtraction has lost its digits
    mean = planck_mean.Mean(hz, weights, 300.0)
    single, factor = mean.look_up(contrast)
    above = mean.at_one_frequency(contrast)
    found = 300.0 + above * np.interp(above, single, factor)
    assert found == pytest.approx(kelvin, rel=2e-4)  # a look-up that spans nine decades
    assert found[2:] == pytest.approx(kelvin[2:], rel=1e-6)
    assert found[4] - 300.0 == pytest.approx(1e-6, rel=3e-3)


def test_no_radiance_is_no_temperature():
    hz, weights = np.linspace(600e9, 700e9, 5), np.ones(5)
    mean = planck_mean.Mean(hz, weights, 300.0)
    dark = -mean.difference(np.array([300.0])) - np.array(
        [weights @ [oracle.planck(f, 300.0) for f in hz] / 5]
    )
    single, factor = mean.look_up(np.array([dark[0], 0.0]))
    above = mean.at_one_frequency(dark)
    assert 300.0 + above * np.interp(above, single, factor) == pytest.approx([0.0], abs=20.0)


def transfer(hz, weights, k):
    """Returns the mean MTF of a circular aperture at k cycles/rad, by sums over frequency."""
    u = np.minimum(k[:, None] * oracle.C / hz / APERTURE, 1)
    mtf = 2 / math.pi * (np.arccos(u) - u * np.sqrt(1 - u * u))
    return (mtf * weights).sum(axis=1) / weights.sum()


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high"), [(600.0, 700.0), (300.0, 900.0)])
def test_a_bar_through_optics_is_blurred_at_each_frequency(tmp_path, low, high):
    """Its transfer to 0.02; with one point spread for 300-900 GHz it would be 0.12 off."""
    pixels, pitch, width = 128, 0.25e-3, 0.0104
    powers = []
    for kelvin in (300.0, 400.0):
        data = wall(BAND, kelvin=kelvin)
        data["camera"] |= {"focal_plane_mm": [pixels * pitch * 1e3, 1.0], "pixels": [pixels, 4]}
        data["targets"]["w"] |= {"size_m": [0.1, width, 20.0], "center_m": [40.05, 0.0, 50.0]}
        data["background"] = {"max_range_m": 100.0}
        lens = {"optics": {"aperture_m": APERTURE, "pixel": False}}
        band = {"center_ghz": (low + high) / 2, "bandwidth_ghz": high - low}
        result = run(tmp_path, data | {"sensor": BAND | band | lens})
        powers.append(result.variants[0].image.layers["received_power"].values[2])
    assert result.error_budget["pixel-sampling"]["relative"] < 0.03
    found = np.abs(np.fft.rfft(powers[1] - powers[0]))
    k = np.fft.rfftfreq(pixels, pitch)
    hz = np.linspace(low, high, 201) * 1e9
    weights = np.array(
        [hz_ * (oracle.photons(hz_, 400.0) - oracle.photons(hz_, 300.0)) for hz_ in hz]
    )
    due = transfer(hz, weights, k) * np.abs(np.sinc(k * width / 40))
    assert np.abs(found / found[0] - due).max() < 0.02
    middle = (low + high) / 2 * 1e9
    one = transfer(np.array([middle]), np.ones(1), k) * np.abs(np.sinc(k * width / 40))
    assert (np.abs(one - due).max() > 0.05) == (high == 900.0)  # which parts of a band mend


def test_bands_are_cut_where_they_are_wide_and_blurred():
    """Parts are at most 1.2 wide, add up to their bands, and mean what the bands mean."""
    hz = np.linspace(300e9, 900e9, 61)
    rows = np.array([np.where(hz < 400e9, 1.0, 0.0), np.ones(61), np.where(hz > 850e9, 2.0, 0.0)])
    bands = Bands(Values.of(hz), Values.of(rows))
    assert Split.of(bands, blurred=False).parts == bands
    assert Split.of(Frequencies(Values.of(hz)), blurred=True).parts == Frequencies(Values.of(hz))
    split = Split.of(bands, blurred=True)
    given = split.parts.given.array
    for row, number in zip(given, split.band, strict=True):
        inside = hz[row > 0]
        assert inside[-1] / inside[0] <= 1.2
        assert np.array_equal(row[row > 0], rows[number][row > 0])
    assert [np.array(split.band).tolist().count(n) for n in range(3)] == [2, 7, 1]
    spectrum = np.random.default_rng(1).random((61, 5))
    whole = bands.planes(spectrum)
    assert split.contrast(split.parts.planes(spectrum)) == pytest.approx(whole, rel=1e-12)
    sources = Emission(Values.of([300.0]), Reflecting.of([]), 290.0, Enclosure(290.0))
    for scale in (1e-9, 1.0, 300.0):
        depth = scale * spectrum
        parts = split.parts.mean_depth(depth, sources)
        due = bands.mean_depth(depth, sources)
        assert split.depth(parts, sources) == pytest.approx(due, rel=1e-9)


@pytest.mark.long
def test_optics_leave_a_wide_band_before_an_even_wall_as_it_is(tmp_path):
    """Power, contrast and depth through humid air, with and without optics."""
    data = wall(WIDE, kelvin=330.0)
    data["atmosphere"] = {"temperature_k": 300.0, "relative_humidity_percent": 30.0}
    data["targets"]["w"]["size_m"] = [1.0, 400.0, 400.0]
    plain = run(tmp_path, data).variants[0]
    data["sensor"] = WIDE | {"optics": {"aperture_m": APERTURE}}
    blurred = run(tmp_path, data).variants[0]
    assert blurred.sight.optical_depth == pytest.approx(plain.sight.optical_depth, rel=1e-5)
    assert blurred.sight.contrast == pytest.approx(plain.sight.contrast, rel=2e-3)
    assert blurred.sight.weights.shape == plain.sight.weights.shape
