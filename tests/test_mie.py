"""Scattering by spheres against 60-digit sums, miepython, and what must hold for any sphere."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from thzcl.air import mie

SIZES = [*np.geomspace(0.1, 1e3, 31), np.pi, 10 * np.pi, 100.0]
INDICES = [1.33 + 0.01j, 2.4 + 0.5j, 1.08 + 1e-4j, 1.78 + 1e-3j, 1.5 + 0j, 3.5 + 2j]
BACK_AT_MOST = 40.0  # above, miepython has lost digits there; the sums of 60 digits have not
BACK = 1e-7
NULL = 1e-9  # of Q_back: where waves cancel, what is left has fewer digits
ROUNDING = 1e-11
NODES = 1e-9  # moments: SciPy's nodes of Gauss' quadrature are a little less exact

# Q_ext, Q_sca, Q_back and g, from sums in 60 digits by the same equations.
EXACT = {
    (1e-6, 2.4 + 0.5j): (
        4.6331971795486e-7,
        1.1196936083872e-24,
        1.6795404125797e-24,
        3.0352549509621e-13,
    ),
    (0.001, 1.78 + 0.001j): (
        1.5992614487469e-6,
        4.6939249740458e-13,
        7.0408837358972e-13,
        2.2763509435545e-7,
    ),
    (0.03, 2.4 + 0.5j): (
        0.013920332690527,
        9.0745428395511e-7,
        1.3603510531556e-6,
        0.00027314542547336,
    ),
    (0.05, 1.08 + 1e-4j): (
        1.2975283890112e-5,
        4.5991912612318e-8,
        6.8917339955549e-8,
        0.00041233585973612,
    ),
    (np.pi, 2.4 + 0.5j): (
        2.7640431312564,
        1.319796980529,
        0.30318096166731,
        0.73831608104688,
    ),
    (10 * np.pi, 1.33 + 0.01j): (
        2.0852673618816,
        1.3566787764993,
        0.13262662204916,
        0.90178134930128,
    ),
    (300.0, 1.08 + 1e-4j): (2.1067557345493, 2.0203838384165, 0.21090904075923, 0.97511084462929),
    (3162.2776601683795, 1.5 + 0j): (
        2.0077198497324,
        2.0077198497324,
        18.507673223888,
        0.82917921745345,
    ),
    (1e4, 2.4 + 0.5j): (2.0043524152538, 1.2300095661357, 0.1871295518797, 0.83980684315079),
}

MIEPYTHON = """
import json, sys, warnings
warnings.simplefilter("ignore")
import miepython
sizes, indices = json.load(sys.stdin)
print(json.dumps([
    [list(map(float, miepython.efficiencies_mx(complex(*m), x))) for x in sizes] for m in indices
]))
"""


def spheres(sizes, index, orders=0):
    sizes = np.asarray(sizes, dtype=np.float64)
    return mie.scatter(sizes, np.full(sizes.shape, complex(index)), orders)


@pytest.mark.parametrize(("size", "index"), EXACT)
def test_sums_of_sixty_digits(size, index):
    found = spheres([size], index)
    extinction, scattering, back, asymmetry = EXACT[size, index]
    assert found.extinction[0] == pytest.approx(extinction, rel=ROUNDING)
    assert found.scattering[0] == pytest.approx(scattering, rel=ROUNDING)
    assert found.backscatter[0] == pytest.approx(back, rel=2e-8)
    assert found.asymmetry[0] == pytest.approx(asymmetry, abs=ROUNDING)


@pytest.mark.slow
def test_miepython_says_the_same():
    """It signs the imaginary part of the index otherwise, and is less exact below a size of 0.1."""
    asked = json.dumps([SIZES, [(m.real, -m.imag) for m in INDICES]])
    command = [sys.executable, "-c", MIEPYTHON]
    done = subprocess.run(command, input=asked, capture_output=True, text=True, check=False)
    if "No module named" in done.stderr:
        pytest.skip("miepython is not installed")
    small = np.array(SIZES) <= BACK_AT_MOST
    for index, rows in zip(INDICES, np.array(json.loads(done.stdout)), strict=True):
        found = spheres(SIZES, index)
        assert found.extinction == pytest.approx(rows[:, 0], rel=1e-9)
        assert found.scattering == pytest.approx(rows[:, 1], rel=1e-9)
        assert found.backscatter[small] == pytest.approx(rows[small, 2], rel=BACK, abs=NULL)
        assert found.asymmetry == pytest.approx(rows[:, 3], abs=1e-9)


def test_small_spheres_are_rayleighs():
    x, m = np.geomspace(1e-6, 1e-4, 7), 2.4 + 0.5j
    pull = (m**2 - 1) / (m**2 + 2)
    found = spheres(x, m, 3)
    assert found.extinction == pytest.approx(4 * x * pull.imag, rel=1e-7)
    assert found.scattering == pytest.approx(8 / 3 * x**4 * abs(pull) ** 2, rel=1e-7)
    assert found.backscatter == pytest.approx(4 * x**4 * abs(pull) ** 2, rel=1e-7)
    # 1 + mu^2 has these moments.
    assert found.legendre[:, 0] == pytest.approx([1, 0, 0.1], abs=1e-8)


def test_large_spheres_extinguish_twice_their_cross_section():
    """By the edge's correction, 2 + 1.99 x^(-2/3) (Nussenzveig and Wiscombe 1980)."""
    x = np.array([1e3, 3e3, 1e4])
    edge = 2 + 1.9923861 * x ** (-2 / 3)
    assert spheres(x, 1.5 + 0.1j).extinction == pytest.approx(edge, rel=1e-3)


def test_a_sphere_that_loses_nothing_scatters_all_that_it_extinguishes():
    found = spheres(np.geomspace(1e-3, 1e4, 40), 1.5)
    assert found.scattering == pytest.approx(found.extinction, rel=ROUNDING)


def test_a_sphere_is_the_same_alone_and_beside_others():
    """To the last digits: how many partial waves there are depends on the largest in a block."""
    x = np.geomspace(1e-6, 1e3, 200)
    together = spheres(x, 1.8 + 0.1j, 49)
    for number in (0, 57, 133, 199):
        alone = spheres(x[number : number + 1], 1.8 + 0.1j, 49)
        for one, many in zip(alone, together, strict=True):
            assert one[..., 0] == pytest.approx(many[..., number], rel=1e-9, abs=1e-12)


def test_moments_are_those_of_the_phase_function():
    x = np.geomspace(0.01, 300, 30)
    found = spheres(x, 1.78 + 0.1j, 97)
    assert found.legendre[0] == pytest.approx(np.ones(30), abs=ROUNDING)
    assert found.legendre[1] == pytest.approx(found.asymmetry, abs=NODES)
    assert np.all(np.abs(found.legendre) <= 1 + ROUNDING)
    # Back-scatter is the series at mu = -1, once all moments are there.
    few = spheres([5.0], 1.78 + 0.1j, 60)
    back = np.sum((2 * np.arange(60) + 1) * (-1.0) ** np.arange(60) * few.legendre[:, 0])
    assert few.scattering[0] * back == pytest.approx(few.backscatter[0], rel=1e-9)
