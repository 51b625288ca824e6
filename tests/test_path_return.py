"""Rain's echo in a focused beam: the beam, the integral along it, the gate, and check values."""

from __future__ import annotations

import numpy as np
import pytest

from thzcl.air import humidity, particles, permittivity
from thzcl.air.constituents import fog, rain
from thzcl.air.constituents.mpm93 import attenuation
from thzcl.sensing.path_return import as_lambert, beam_gain, gated, path_return

APERTURE = np.pi * 0.15**2  # m2, of 0.3 m
KELVIN = 293.15
VAPOUR = float(humidity.vapour_pressure_from_relative(44, KELVIN))


def wavelength(ghz):
    return 0.299792458 / ghz


@pytest.mark.parametrize("focus", [5.0, 40.0, 80.0, 1e6])
def test_the_gain_is_that_of_a_gaussian_beam(focus):
    """By its complex parameter q through a lens: G = lambda^2 / (pi w^2)."""
    length, r = wavelength(650), np.geomspace(1e-3, 300, 50)
    waist = np.sqrt(APERTURE / np.pi)
    q = 1 / (1 / (1j * np.pi * waist**2 / length) - 1 / focus) + r
    width2 = -length / np.pi / (1 / q).imag
    found = beam_gain(r, APERTURE, length, focus)
    assert found == pytest.approx(length**2 / (np.pi * width2), rel=1e-12)


@pytest.mark.parametrize("extinction", [0.0, 1e-9, 1e-3, 0.02, 1.0, 10.0])
@pytest.mark.parametrize(
    ("focus", "near", "far"), [(40, 0, 40), (40, 39.5, 40), (80, 0, 80), (5, 0, 100), (5, 7, 9)]
)
def test_the_integral_is_that_of_quadrature(extinction, focus, near, far):
    edges = np.unique(
        np.concatenate([np.linspace(near, far, 400), near + np.geomspace(1e-6, far - near, 400)])
    )
    node, weight = np.polynomial.legendre.leggauss(8)
    r = (edges[:-1, None] + edges[1:, None] + np.diff(edges)[:, None] * node) / 2
    gain = beam_gain(r, APERTURE, wavelength(650), focus) * np.exp(-2 * extinction * r)
    expected = 3e-6 * np.sum(gain * weight * np.diff(edges)[:, None] / 2)
    found = path_return(3e-6, extinction, near, far, APERTURE, wavelength(650), focus)
    assert found == pytest.approx(expected, rel=1e-9)


def test_opaque_air_sends_back_from_the_lens_alone():
    """As beta G(0) / (2 k), and no number is lost on the way."""
    found = path_return(1.0, 1e4, 0.0, 100.0, APERTURE, wavelength(650), 40.0)
    expected = wavelength(650) ** 2 / APERTURE / 2e4
    assert found == pytest.approx(expected, rel=1e-5)
    assert path_return(1.0, 1e4, 10.0, 100.0, APERTURE, wavelength(650), 40.0) == 0


def test_arrays_broadcast_and_nothing_is_behind_the_end():
    far = np.array([10.0, 40.0, 5.0])
    found = path_return(1e-6, 0.01, 5.0, far, APERTURE, wavelength(650), 40.0)
    assert found.shape == (3,) and found[2] == 0 and 0 < found[0] < found[1]
    assert path_return(1e-6, 0.01, 9.0, 5.0, APERTURE, wavelength(650), 40.0) == 0


def test_a_gate_ends_at_what_is_solid():
    near, far = gated(np.array([40.0, 0.2]), (-0.5, 0.5))
    assert near.tolist() == [39.5, 0.0] and far.tolist() == [40.0, 0.2]
    near, far = gated(np.array([40.0, 40.0]), (-0.5, 0.5), solid=np.array([True, False]))
    assert far.tolist() == [40.0, 40.5]
    near, far = gated(40.0)
    assert (near, far) == (0.0, 40.0)


def equivalent(bulk, ghz, distance, gate=None):
    """The reflectivity of a Lambert surface as bright as the echo, in moist air by MPM93."""
    gas = attenuation("mpm93", ghz, KELVIN, 1013.25, VAPOUR).total_per_m
    k = float(gas) + float(bulk.extinction)
    ends = gated(distance, gate)
    beta = float(bulk.backscatter)
    returned = path_return(beta, k, *ends, APERTURE, wavelength(ghz), distance)
    return float(as_lambert(returned, distance, APERTURE, k * distance))


def drops(ghz, sizes, kelvin=KELVIN, water=permittivity.water):
    return particles.spheres(ghz * 1e9, kelvin, water, sizes)


@pytest.mark.parametrize(
    ("ghz", "distance", "expected"),
    [(650, 40.0, 9.53e-4), (650, 80.0, 9.63e-3), (220, 40.0, 4.30e-3), (220, 80.0, 2.02e-2)],
)
def test_check_values_of_raw_rain(ghz, distance, expected):
    """The law of Marshall and Palmer at 10 mm/h as printed, and Liebe's permittivity."""
    raw = rain.raw_sizes("marshall-palmer", 10.0)
    found = equivalent(drops(ghz, raw, water=permittivity.water_liebe), ghz, distance)
    assert found == pytest.approx(expected, rel=5e-3)


def test_rain_of_a_true_rate():
    """Of drops at the air's temperature, and at the wet bulb's."""
    sizes = rain.scaled_sizes("marshall-palmer", 10.0)
    wet = humidity.wet_bulb_temperature(KELVIN, 1013.25, VAPOUR)
    for kelvin, at_40_m, at_80_m in ((KELVIN, 8.1e-4, 8.1e-3), (wet, 7.7e-4, 7.7e-3)):
        bulk = drops(650, sizes, kelvin)
        assert equivalent(bulk, 650, 40.0) == pytest.approx(at_40_m, rel=0.01)
        assert equivalent(bulk, 650, 80.0) == pytest.approx(at_80_m, rel=0.01)


def test_fog_and_a_range_gate():
    thin = drops(650, fog.droplet_sizes("radiation", 10.0, 0.1), water=permittivity.water_liebe)
    assert equivalent(thin, 650, 40.0) == pytest.approx(1.57e-4, rel=5e-3)
    assert equivalent(thin, 650, 80.0) == pytest.approx(1.47e-3, rel=5e-3)
    raw = drops(650, rain.raw_sizes("marshall-palmer", 10.0), water=permittivity.water_liebe)
    assert equivalent(raw, 650, 40.0, (-0.5, 0.5)) == pytest.approx(1.9e-5, rel=0.01)


def test_the_formula_of_the_far_field_is_wrong_by_30_db():
    """From a quarter of a metre on, A / r^2 says 0.94 where it is 9.5e-4."""
    raw = drops(650, rain.raw_sizes("marshall-palmer", 10.0), water=permittivity.water_liebe)
    gas = attenuation("mpm93", 650.0, KELVIN, 1013.25, VAPOUR).total_per_m
    k = float(gas) + float(raw.extinction)
    r = np.geomspace(0.25, 40, 20_001)
    far = np.trapezoid(APERTURE / r**2 * np.exp(-2 * k * r), r) * float(raw.backscatter)
    assert as_lambert(far, 40.0, APERTURE, k * 40.0) == pytest.approx(0.94, rel=0.01)
