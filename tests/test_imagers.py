"""Imagers that exist: the page is what thzcl computes, and that is what closed forms say."""

from __future__ import annotations

import math

import imagers
import oracle
import pytest

ROWS = {imager.name.split(",")[0]: imager for imager in imagers.IMAGERS + imagers.UNDECIDED}


def transistor_k():
    """Returns sqrt(NEP^2 / (2 t)) over the power of one kelvin in one mode, 0.1 to 1.5 THz."""
    step, slope = 1.4e12 / 4000, 0.0
    for number in range(4000):
        hz = 0.1e12 + (number + 0.5) * step
        more, less = (oracle.photons(hz, 300.0 + d) for d in (0.01, -0.01))
        slope += oracle.H * hz * (more - less) / 0.02 * step
    return 42e-12 / math.sqrt(2.0) / slope


def class_k():
    """Returns the photon noise of 1.6 pW spread evenly over the band, W s^1/2, in K."""
    width = 1 / (13.1e12 * 0.48 * oracle.K)
    photons = 1.6e-12 / (oracle.H * 38.4e9 * width)
    return oracle.H * 38.4e9 * math.sqrt(width * photons * (1 + photons)) * 13.1e12


HYMS = {"bandwidth_hz": 1e7, "time_s": 0.3, "drift": 0.0}
DUE = {
    "CLASS": [class_k()],
    "Field-effect transistor of silicon": [
        transistor_k(),
        transistor_k() * math.pi / math.sqrt(2),
    ],
    "SiGe chip with an amplifier before its detector": [
        23e-15 / math.sqrt(2 * 3.125e-3) / (oracle.K * 147e9)
    ],
    "SiGe receiver with an amplifier before its detector": [1935 / math.sqrt(1e10 * 3.125e-3)],
    "Hot-electron bolometer as a mixer": [4100 / math.sqrt(5e8)],
    "HYMS": [
        oracle.radiometer_netd(200.0, 290.0, **HYMS, single=single) for single in (False, True)
    ],
    "Camera of kinetic inductance detectors": [
        oracle.photon_netd(332.5e9, 367.5e9, 300.0, 0.5, efficiency) for efficiency in (1.0, 0.1)
    ],
    "Fourier imager with a source of 56 uW": [
        10 * math.log10(56e-6 / (42e-12 / math.sqrt(2 * time_s))) for time_s in (0.01, 0.5)
    ],
}


@pytest.mark.parametrize("name", ROWS)
def test_an_imager_has_the_noise_of_its_equation(name):
    assert imagers.computed(ROWS[name]) == pytest.approx(DUE[name], rel=3e-3)


def test_the_transistor_is_that_of_the_literature():
    """In closed form 1.54 K, or 3.42 K if chopped."""
    found = imagers.computed(ROWS["Field-effect transistor of silicon"])
    assert found == pytest.approx([1.54, 3.42], rel=2e-3)


def test_the_page_is_what_thzcl_computes():
    """`python tests/imagers.py` writes it. It has six imagers, and the fourth kind as a bound."""
    assert imagers.PAGE.read_text(encoding="utf-8") == imagers.page()
    assert len(imagers.IMAGERS) >= 6
    kinds = {imager.kind for imager in imagers.IMAGERS + imagers.UNDECIDED}
    assert kinds == {"cooled direct", "uncooled direct", "heterodyne", "active"}
