"""The random cube: against its float64 twin.

And in its statistics against what a discrete periodic field should have.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import oracle
import pytest

from thzcl.turbulence import cube as field
from thzcl.turbulence import spectra as turbulence
from thzcl.turbulence.spectra import Turbulence

PLAIN = Turbulence(
    grid=64, voxel_m=0.5, seed=7, outer_scale_m=None, sigma=0.2, exact=True, lognormal=False,
    temperature_sigma_k=0.0, temperature_exact=True, correlation=0.0,
)  # fmt: skip
SEEDS = 40  # one realisation's variance scatters by 17 %
OTHER_ARITHMETIC = (
    1e-5  # of sigma: float32 noise and transform against float64, or another library's
)


def psi(constant, outer=None):
    """Kolmogorov or von Karman in cycles per metre, for C^2 = `constant` (PHYSICS 2)."""
    return lambda xi: 9.6935e-3 * constant * (xi**2 + (1 / outer**2 if outer else 0)) ** (-11 / 6)


def cube(device, **changes):
    made = field.generate(device, dataclasses.replace(PLAIN, **changes), "float32")
    return made.delta.host().astype(np.float64)


@pytest.mark.parametrize("grid", [16, 32, 64])
@pytest.mark.parametrize("outer", [None, 3.0])
def test_the_field_is_its_twin(device, grid, outer):
    expected = oracle.gaussian_fields(grid, 0.5, 7, psi(1.0, outer))[0]
    found = cube(device, grid=grid, outer_scale_m=outer)
    assert found == pytest.approx(expected / expected.std() * 0.2, abs=0.2 * OTHER_ARITHMETIC)


def test_temperature_and_humidity_come_from_one_transform(device):
    """Humidity does not change when temperature is asked for.

    And the correlation is the one asked for.
    """
    both = dataclasses.replace(PLAIN, temperature_sigma_k=1.5, correlation=-0.6)
    made = field.generate(device, both, "float32")
    one, other = oracle.gaussian_fields(64, 0.5, 7, psi(1.0))
    assert made.delta.host() == pytest.approx(one / one.std() * 0.2, abs=0.2 * OTHER_ARITHMETIC)
    mixed = -0.6 * one + 0.8 * other
    assert made.offset.host() == pytest.approx(
        mixed / mixed.std() * 1.5, abs=1.5 * OTHER_ARITHMETIC
    )


def test_a_transform_on_the_device_gives_the_same_field(device):
    found = field.generate(device, PLAIN, "float32", library="reikna").delta.host()
    assert found == pytest.approx(cube(device), abs=0.2 * OTHER_ARITHMETIC)


def test_the_same_seed_gives_the_same_field(device):
    assert np.array_equal(cube(device), cube(device))
    assert abs(np.corrcoef(cube(device).ravel(), cube(device, seed=8).ravel())[0, 1]) < 0.5
    assert not np.array_equal(cube(device), cube(device, seed=7 + 2**32))


@pytest.mark.parametrize("group", [1, 2, 4, 32])
def test_the_same_field_on_any_work_group_size(device, monkeypatch, group):
    expected = cube(device, grid=32)
    monkeypatch.setattr(device, "group", group)
    assert np.array_equal(cube(device, grid=32), expected)


def test_a_given_sigma_is_met_exactly(device):
    for sigma in (1e-6, 0.05, 0.2):
        assert cube(device, sigma=sigma).std() == pytest.approx(sigma, rel=1e-6)
    assert abs(cube(device).mean()) < 1e-7


def test_a_given_structure_constant_is_met_on_average(device):
    """Variance over seeds against 0.2106 C^2 (N dx)^(2/3), the sum of Psi dxi^3 at N = 128.

    No realisation is rescaled.
    """
    unit = turbulence.variance(128, 0.5, None)
    assert unit == pytest.approx(0.2106 * 64 ** (2 / 3), rel=1e-3)
    unit = turbulence.variance(64, 0.5, None)
    found = [cube(device, exact=False, sigma=0.1, seed=s).var() / 0.01 for s in range(SEEDS)]
    scatter = np.std(found) / math.sqrt(SEEDS)
    assert 0.05 < np.std(found) < 0.4  # not rescaled
    assert abs(np.mean(found) - 1) < 3 * scatter
    assert unit > 0


def test_the_sum_of_psi_is_the_variance():
    """By brute force over all wave vectors."""
    for n, outer in ((16, None), (32, 2.0)):
        wave = np.fft.fftfreq(n, 1 / n)
        xi = np.sqrt(sum(g**2 for g in np.meshgrid(wave, wave, wave))) / (n * 0.3)
        total = psi(1.0, outer)(xi[xi > 0]).sum() / (n * 0.3) ** 3
        assert turbulence.variance(n, 0.3, outer) == pytest.approx(total, rel=1e-4)


@pytest.mark.slow
def test_structure_function_and_slope_of_the_discrete_field(device):
    """D(r) / (C^2 r^(2/3)) and the line spectrum's slope are a discrete field's, not 1 and -5/3.

    They are averages over seeds and axes of a periodic cube of 128 voxels (PHYSICS 2).
    """
    expected = {1: 0.48, 2: 0.68, 4: 0.79, 8: 0.85, 16: 0.87, 32: 0.83, 64: 0.65}
    unit = turbulence.variance(128, 0.5, None)
    ratios, spectra = [], []
    for seed in range(30):
        f = cube(device, grid=128, exact=False, sigma=0.05, seed=seed)
        constant = 0.05**2 / unit
        for axis in range(3):
            ratios.append(
                [
                    np.mean((np.roll(f, r, axis) - f) ** 2) / (constant * (0.5 * r) ** (2 / 3))
                    for r in expected
                ]
            )
            lines = np.moveaxis(f, axis, -1)[::4, ::4]
            spectra.append(np.mean(np.abs(np.fft.rfft(lines)) ** 2, axis=(0, 1)))
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0) / math.sqrt(30)
    assert np.all(
        np.abs(mean - list(expected.values())) < 3 * error + 0.005
    )  # the table's own rounding
    modes = np.arange(2, 21)
    slope = np.polyfit(np.log(modes), np.log(np.mean(spectra, axis=0)[modes]), 1)[0]
    assert slope == pytest.approx(-1.715, abs=0.02)


def test_humidity_stays_positive(device):
    """Clipped Gaussian at low sigma; lognormal from 30 % on.

    Which keeps mean and variance of the ensemble.
    """
    assert cube(device, sigma=0.5).min() >= -1
    means, squares = [], []
    for seed in range(3 * SEEDS):
        f = cube(device, sigma=0.6, exact=False, lognormal=True, grid=32, seed=seed)
        assert f.min() > -1
        means.append(f.mean())
        squares.append(np.mean(f**2))
    assert abs(np.mean(means)) < 3 * np.std(means) / math.sqrt(3 * SEEDS)
    assert abs(np.mean(squares) - 0.36) < 3 * np.std(squares) / math.sqrt(3 * SEEDS)


def test_a_lognormal_of_given_sigma(device):
    """Rescaled on the Gaussian: the logarithm's sigma is exact in every realisation.

    Humidity's own to a few per cent.
    """
    logs = math.sqrt(math.log1p(1.0))
    found = []
    for seed in range(SEEDS):
        f = cube(device, sigma=1.0, lognormal=True, grid=32, seed=seed)
        assert np.log1p(f).std() == pytest.approx(logs, rel=1e-5)
        found.append(f.std())
    assert np.mean(found) == pytest.approx(1.0, abs=0.08)


def test_the_range_of_a_plan_holds_and_is_not_idle(device):
    """A cube leaves the planned range with probability 1e-6, and most reach a third of it."""
    for lognormal, sigma in ((False, 0.1), (True, 0.5)):
        t = dataclasses.replace(PLAIN, sigma=sigma, lognormal=lognormal, grid=32)
        low, high = t.humidity_span()
        for seed in range(10):
            f = cube(device, sigma=sigma, lognormal=lognormal, grid=32, seed=seed)
            assert low <= f.min() < low / 6
            assert high / 6 < f.max() <= high


def test_vapour_is_limited_counted_and_reported(device):
    made = field.generate(device, PLAIN, "float32", ceiling=0.3)
    assert made.delta.host().max() == pytest.approx(0.3)
    assert made.humidity_span[1] == 0.3
    assert "limited" in made.notes[0]
    wet = field.generate(device, dataclasses.replace(PLAIN, sigma=0.6), "float32")
    assert "clipped" in wet.notes[0]


def test_spans_are_those_of_the_cube(device):
    made = field.generate(device, dataclasses.replace(PLAIN, temperature_sigma_k=2.0), "float64")
    for values, span in (
        (made.delta.host(), made.humidity_span),
        (made.offset.host(), made.temperature_span),
    ):
        assert values.dtype == np.float64
        assert (values.min(), values.max()) == span
