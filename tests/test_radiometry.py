"""Planck's law and its differences against fifty-digit arithmetic, from 0 K to 1e18 K."""

from __future__ import annotations

from decimal import Decimal, getcontext

import numpy as np
import oracle
import pytest

from thzcl.air import radiometry

getcontext().prec = 60
ROUNDING = 1e-12  # of a handful of float64 operations, each well conditioned


def exact_planck(hz, kelvin):
    h, k, c = Decimal(repr(oracle.H)), Decimal(repr(oracle.K)), Decimal(repr(oracle.C))
    if kelvin == 0:
        return Decimal(0)
    x = h * Decimal(hz) / (k * Decimal(kelvin))
    return 2 * h * Decimal(hz) ** 3 / c**2 / (x.exp() - 1)


@pytest.mark.parametrize("ghz", [1, 650, 1780])
@pytest.mark.parametrize("kelvin", [2.7, 275.0, 3000.0, 1e6, 1e18])
def test_planck(ghz, kelvin):
    assert radiometry.planck(ghz * 1e9, kelvin) == pytest.approx(
        float(exact_planck(ghz * 1e9, kelvin)), rel=ROUNDING
    )


@pytest.mark.parametrize("ghz", [1, 650, 1780])
@pytest.mark.parametrize(
    ("one", "other"),
    [
        (275.0, 275.001),
        (275.000001, 275.0),
        (2.7, 300.0),
        (1e18, 275.0),
        (275.0, 0.0),
        (0.01, 275.0),
    ],
)
def test_differences_keep_their_digits(ghz, one, other):
    expected = float(exact_planck(ghz * 1e9, one) - exact_planck(ghz * 1e9, other))
    assert radiometry.planck_difference(ghz * 1e9, one, other) == pytest.approx(
        expected, rel=ROUNDING
    )
    # Subtraction would not do: this is what the remedy is for.
    if abs(one - other) < 1e-5:
        plain = oracle.planck(ghz * 1e9, one) - oracle.planck(ghz * 1e9, other)
        assert abs(plain / expected - 1) > 100 * ROUNDING


def test_nothing_and_equality_are_exact():
    assert radiometry.planck(650e9, 0.0) == 0
    assert radiometry.planck_difference(650e9, 0.0, 0.0) == 0
    assert radiometry.planck_difference(650e9, 275.0, 275.0) == 0
    assert radiometry.brightness_temperature(650e9, 0.0) == 0


@pytest.mark.parametrize("kelvin", [2.7, 100.0, 274.999999, 275.0, 275.000001, 300.0, 1e6, 1e18])
def test_contrast_inverts_the_difference(kelvin):
    contrast = radiometry.planck_difference(650e9, kelvin, 275.0)
    found = float(radiometry.brightness_temperature_contrast(650e9, contrast, 275.0))
    assert found == pytest.approx(
        kelvin - 275.0, rel=1e-9 if abs(kelvin - 275) > 1e-3 else 1e-7, abs=0
    )
    assert radiometry.brightness_temperature(
        650e9, radiometry.planck(650e9, kelvin)
    ) == pytest.approx(kelvin, rel=1e-9)


def test_no_radiance_is_zero_kelvin_below_the_reference():
    dark = -radiometry.planck(650e9, 275.0)
    assert radiometry.brightness_temperature_contrast(650e9, dark, 275.0) == -275.0


def test_zero_kelvin_has_no_sign():
    hz = np.array([650e9])
    assert radiometry.planck(hz, -0.0) == 0.0
    due = radiometry.planck_difference(hz, 0.0, 290.0)
    assert radiometry.planck_difference(hz, -0.0, 290.0) == due == -radiometry.planck(hz, 290.0)
