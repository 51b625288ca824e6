"""Scattered light in plane layers: check values, and what must hold however light is scattered."""

from __future__ import annotations

import numpy as np
import pytest

from thzcl.air import scattering
from thzcl.air.radiometry import brightness_temperature_contrast, planck_difference
from thzcl.air.scattering import Bounds, Layers
from thzcl.constituent import DB_KM_PER_INVERSE_METRE as DB_KM

DARK = np.zeros(1)
SUMMED = 1e-7  # what the series of scatterings leaves out


def layers(*given, emission=None, orders=49):
    """Layers of (depth, albedo, asymmetry) from the top down; each emits as a black body of 1."""
    depth, albedo, asymmetry = (
        np.array([column], dtype=float) for column in zip(*given, strict=True)
    )
    sent = np.repeat((1 - albedo)[..., None], 2, axis=-1) if emission is None else emission
    phase = scattering.henyey_greenstein(asymmetry, orders)
    return scattering.cut(Layers(depth, albedo, phase, sent))[0]


def lit(above=0.0, below=0.0, reflectivity=0.0):
    return Bounds(*(np.array([value]) for value in (above, below, reflectivity)))


# Emissivities 1 - reflected - transmitted of a slab of depth, albedo and asymmetry at a cosine, lit
# by nothing: an independent solver with 80 directions, and Monte Carlo, to 5e-4.
SLABS = {
    (1, 0.5, 0.8, 0.5): 0.6482,
    (1, 0.5, 0.8, 0.2): 0.7994,
    (3, 0.5, 0.6, 0.5): 0.8856,
    (1, 0.97, 0.7, 1): 0.0389,
    (5, 0.95, 0.9, 0.2): 0.3860,
}


@pytest.mark.parametrize("slab", SLABS)
def test_emissivities_of_slabs(slab):
    *of, mu = slab
    found = scattering.solve(layers(of), lit())
    up = scattering.intensity(found, np.array([mu, -mu]))
    assert up[0, 0, 0] == pytest.approx(SLABS[slab], abs=1e-3)
    assert up[0, -1, 1] == pytest.approx(up[0, 0, 0], rel=1e-9)  # it looks the same from below
    more = scattering.solve(layers(of, orders=97), lit(), directions=48)
    assert scattering.intensity(more, np.array([mu]))[0, 0, 0] == pytest.approx(
        up[0, 0, 0], abs=1e-5
    )


def test_a_level_ray_through_rain_and_what_it_lacks():
    """Beside Monte Carlo in three dimensions: 0.680 +- 0.005 K and 16.10 +- 0.03 K.

    Gas and rain of 0.35 and 8.17 dB/km at 94 GHz, 288.2 K, over black ground, under 2.725 K.
    """
    gas, rain, hz = 0.35 / DB_KM, 8.17 / DB_KM, np.array([94e9])
    scatters = 0.492 * rain
    space = float(planck_difference(94e9, 2.725, 288.2))
    for top_m, length_m, deficit in ((1000.0, 64.0, 0.676), (300.0, 500.0, 16.03)):
        depth = (gas + rain) * top_m
        column = layers((depth, scatters / (gas + rain), 0.279), emission=np.zeros((1, 1, 2)))
        found = scattering.solve(column, lit(above=space))
        there = scattering.scattered_in(found, np.array([0.0]))[0, -1, 1, 0]
        passed = float(scattering.mean_transmission(np.array((gas + rain) * length_m)))
        contrast = scatters * there * length_m * passed
        kelvin = brightness_temperature_contrast(hz, contrast, 288.2)
        assert -float(kelvin[0]) == pytest.approx(deficit, rel=0.005)


def test_within_a_black_enclosure_of_its_temperature_there_is_nothing():
    """To the bit, for any albedo and asymmetry."""
    for albedo, asymmetry in ((0.0, 0.0), (0.5, 0.3), (0.97, 0.99), (1.0, -0.4)):
        still = layers((3.0, albedo, asymmetry), (0.2, 0.5, 0.8), emission=np.zeros((1, 2, 2)))
        found = scattering.solve(still, lit(reflectivity=0.3))
        mu = np.array([-1.0, -0.3, 0.0, 0.6])
        assert not scattering.intensity(found, mu).any()
        assert not scattering.scattered_in(found, mu).any()


def test_light_of_one_radiance_all_around_stays_that():
    given = layers((2.0, 0.5, 0.3), (0.3, 0.97, 0.9), (5.0, 0.0, 0.0))
    found = scattering.solve(given, lit(above=1.0, below=1.0, reflectivity=0.4))
    light = scattering.intensity(found, np.array([-1.0, -0.01, 0.0, 0.5]))
    assert light == pytest.approx(np.ones_like(light), abs=SUMMED)
    inside = scattering.scattered_in(found, np.array([-0.5, 0.2]))
    assert inside == pytest.approx(np.ones_like(inside), abs=SUMMED)


def test_what_scatters_nothing_absorbs_alone():
    """To the bit, whatever its phase function would be; and by exp(-tau) and 1 - exp(-tau)."""
    mu = np.array([-0.2, -1.0, 0.7])
    one, other = (
        scattering.solve(layers((1.5, 0.0, g)), lit(above=0.3, below=0.2)) for g in (0.0, 0.9)
    )
    light = scattering.intensity(one, mu)
    assert np.array_equal(light, scattering.intensity(other, mu)) and one.passes == 1
    passed = np.exp(-1.5 / np.abs(mu))
    assert light[0, -1, :2] == pytest.approx((0.3 * passed + 1 - passed)[:2], rel=1e-12)
    assert light[0, 0, 2] == pytest.approx(0.2 * passed[2] + 1 - passed[2], rel=1e-12)


def test_as_much_passes_from_above_as_from_below():
    """Reciprocity, of layers that differ: light from everywhere above, or everywhere below."""
    given = layers((1.0, 0.9, 0.8), (2.0, 0.4, 0.1), (0.5, 0.99, 0.95))
    dark = given._replace(emission=np.zeros_like(given.emission))
    mu, weight = np.polynomial.legendre.leggauss(64)
    mu, weight = (mu + 1) / 2, weight / 2
    down = scattering.intensity(scattering.solve(dark, lit(above=1.0)), -mu)[0, -1]
    up = scattering.intensity(scattering.solve(dark, lit(below=1.0)), mu)[0, 0]
    assert down @ (weight * mu) == pytest.approx(up @ (weight * mu), abs=1e-4)
    assert abs(down - up).max() > 1e-3  # in single directions they differ


def test_what_absorbs_nothing_sends_back_all_that_it_does_not_pass():
    found = scattering.solve(layers((2.0, 1.0, 0.6)), lit(above=1.0))
    mu, weight = np.polynomial.legendre.leggauss(64)
    mu, weight = (mu + 1) / 2, weight / 2
    passed = 2 * scattering.intensity(found, -mu)[0, -1] @ (weight * mu)
    back = 2 * scattering.intensity(found, mu)[0, 0] @ (weight * mu)
    assert passed + back == pytest.approx(1.0, abs=1e-3)


def test_frequencies_do_not_mix():
    given = [(1.0, 0.5, 0.3), (2.0, 0.9, 0.8)]
    one, other = (Layers(*(np.asarray(x) for x in layers(of))) for of in given)
    many = scattering.cut(
        Layers(
            np.array([[1.0], [2.0]]),
            np.array([[0.5], [0.9]]),
            scattering.henyey_greenstein(np.array([[0.3], [0.8]])),
            np.array([[[0.5, 0.5]], [[0.1, 0.1]]]),
        )
    )[0]
    pair = Bounds(np.zeros(2), np.zeros(2), np.zeros(2))
    both = scattering.intensity(scattering.solve(many, pair), np.array([0.5]))
    for number, alone in enumerate((one, other)):
        single = scattering.intensity(scattering.solve(alone, lit()), np.array([0.5]))
        assert both[number, 0, 0] == pytest.approx(single[0, 0, 0], abs=2e-4)  # cut otherwise


def test_a_ground_that_mirrors_all_is_not_seen_to_emit():
    thin = layers((1e-9, 0.0, 0.0))
    found = scattering.solve(thin, lit(above=0.7, below=5.0, reflectivity=1.0))
    assert scattering.intensity(found, np.array([0.5]))[0, 0, 0] == pytest.approx(0.7, rel=1e-6)


def test_too_few_moments_are_refused():
    with pytest.raises(ValueError, match="need moments of order 0 to 48"):
        scattering.solve(layers((1.0, 0.5, 0.3), orders=48), lit())
