"""The float64 twin against the oracle, which shares nothing with it, and against fifty digits."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import oracle
import pytest

from thzcl.air import radiometry
from thzcl.air.composition import part
from thzcl.air.expansion import fit
from thzcl.air.mean import Air
from thzcl.error import twin

AIR = Air((part("mpm93"),), 290.0, 1013.25, 10.0)
HZ = np.array([183.31e9, 650e9])
HUMIDITY, TEMPERATURE = (-0.9, 3.0), (-5.0, 5.0)
GRID, VOXEL_M = 16, 0.5


def planck_in_fifty_digits(hz, kelvin, reference_k):
    """Planck's law at two temperatures, one less the other."""
    with localcontext() as context:
        context.prec, context.Emin = 50, -(10**6)
        h, k, c = Decimal("6.62607015e-34"), Decimal("1.380649e-23"), Decimal(299792458)
        photons = [
            1 / ((h * Decimal(hz) / (k * Decimal(t))).exp() - 1) if t else Decimal(0)
            for t in (kelvin, reference_k)
        ]
        return 2 * h * Decimal(hz) ** 3 / c**2 * (photons[0] - photons[1])


@pytest.mark.parametrize("hz", [1e9, 183e9, 650e9, 1780e9, 1e13])
@pytest.mark.parametrize("reference_k", [220.0, 290.0, 330.0])
def test_planck_differences_keep_their_digits(hz, reference_k):
    """From 0 K to 1e18 K, and down to a difference of a billionth of a kelvin."""
    near = [reference_k + step for step in (-1e-6, -1e-9, 1e-9, 1e-6, -20.0, 20.0)]
    for kelvin in [0.0, 2.7, 30.0, *near, 3000.0, 1e6, 1e18]:
        right = planck_in_fifty_digits(hz, kelvin, reference_k)
        ours = Decimal(float(twin.planck_difference(hz, kelvin, reference_k)))
        assert abs(ours / right - 1) < 3e-15, kelvin
    assert twin.planck_difference(hz, reference_k, reference_k) == 0.0


def test_planck_is_the_oracles():
    for hz in HZ:
        assert twin.planck(hz, 290.0) / oracle.planck(hz, 290.0) == pytest.approx(1, rel=1e-14)


def rays(count):
    """Rays of all directions, some along axes; of some the origin is a voxel's corner."""
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(count, 3))
    direction[:4] = (0, 0, 1), (-1, 0, 0), (1, 1, 0), (-1, -1, -1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin, length = rng.uniform(0, GRID, (count, 3)), rng.uniform(1, 30, count)
    origin[2:6] = np.floor(origin[2:6])
    return origin, direction, length


def cubes():
    """Departures of humidity and of temperature, (z, y, x)."""
    rng = np.random.default_rng(3)
    shape = (GRID, GRID, GRID)
    return rng.uniform(*HUMIDITY, shape), rng.uniform(*TEMPERATURE, shape)


def walked(*, warm):
    """Rays through the cubes, and for each the oracle's humidity, temperature and metres."""
    (origin, direction, length), (delta, offset) = rays(20), cubes()
    lengths, voxel = twin.walk(origin, direction / VOXEL_M, length, (GRID,) * 3)
    kelvin = offset.ravel()[voxel] if warm else None
    path = twin.Path(lengths, delta.ravel()[voxel], kelvin, HUMIDITY)
    met = []
    for o, d, metres in zip(origin, direction, length, strict=True):
        cells, parts = oracle.segments(o, d, metres / VOXEL_M, GRID)
        place = cells[:, 2], cells[:, 1], cells[:, 0]
        met.append((delta[place], offset[place] if warm else 0.0 * parts, parts * VOXEL_M))
    return path, met


def absorbed(hz, delta, offset):
    """The oracle's absorption, 1/m."""
    grams = AIR.absolute_humidity_g_m3 * (1 + delta)
    return oracle.absorption_per_m(hz, AIR.temperature_k + offset, AIR.pressure_hpa, grams)


def test_it_walks_as_the_oracle_does():
    """The same voxels for the same lengths, through faces and corners too."""
    path, met = walked(warm=False)
    for ray, (delta, _, metres) in enumerate(met):
        assert path.length[ray].sum() == pytest.approx(metres.sum(), rel=1e-14)
        for power in (1, 2, 3):
            ours = (path.length[ray] * path.delta[ray] ** power).sum()
            assert ours == pytest.approx((metres * delta**power).sum(), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("pressure", [1.0, 1013.25])
@pytest.mark.parametrize("ghz", [183.31, 556.936, 650.0])
def test_its_absorption_is_the_models(ghz, pressure):
    """To 1e-12 of the largest at line centres, and to 1e-11 at 1 hPa: 33 nodes miss nothing."""
    air = Air((part("mpm93"),), 290.0, pressure, 10.0 * pressure / 1013.25)
    absorber = twin.exact(air, np.array([ghz * 1e9]), HUMIDITY, TEMPERATURE)
    delta, offset = np.linspace(*HUMIDITY, 57), np.linspace(*TEMPERATURE, 57)
    even = np.linspace(-1, 1, 57)
    ours = np.polynomial.chebyshev.chebgrid2d(even, even, absorber.series[0])
    grams = air.absolute_humidity_g_m3 * (1 + delta[:, None])
    right = oracle.absorption_per_m(ghz * 1e9, 290.0 + offset, pressure, grams)
    assert np.abs(ours - right).max() < (1e-12 if pressure > 100 else 1e-11) * right.max()


@pytest.mark.parametrize("warm", [False, True])
def test_depth_is_absorption_along_the_path(warm):
    path, met = walked(warm=warm)
    absorber = twin.exact(AIR, HZ, HUMIDITY, TEMPERATURE if warm else (0.0, 0.0))
    right = [
        [(absorbed(hz, delta, offset) * metres).sum() for delta, offset, metres in met] for hz in HZ
    ]
    np.testing.assert_allclose(absorber.depth(path), right, rtol=1e-12)


def test_a_path_is_cut_where_it_is_told():
    """A cut ray is a shorter ray; the uncut path stays as it was."""
    path, _ = walked(warm=False)
    whole, half = path.length.sum(axis=1), path.length.sum(axis=1) / 2
    absorber = twin.exact(AIR, HZ, HUMIDITY, (0.0, 0.0))
    before = absorber.depth(path)
    cut = path.cut(half)
    origin, direction, _ = rays(20)
    lengths, voxel = twin.walk(origin, direction / VOXEL_M, half, (GRID,) * 3)
    short = twin.Path(lengths, cubes()[0].ravel()[voxel], None, HUMIDITY)
    np.testing.assert_allclose(cut.length.sum(axis=1), half, rtol=1e-14)
    np.testing.assert_allclose(absorber.depth(cut), absorber.depth(short), rtol=1e-12)
    np.testing.assert_array_equal(absorber.depth(path.cut(2 * whole)), before)


def test_moments_are_the_same_however_many_are_asked_for():
    path, _ = walked(warm=False)
    few, many = path.moments(3), path.moments(40)
    np.testing.assert_array_equal(few, many[:3])
    u = (2 * path.delta - sum(HUMIDITY)) / (HUMIDITY[1] - HUMIDITY[0])
    for k in (0, 1, 7, 39):
        right = (np.polynomial.chebyshev.chebval(u, np.eye(40)[k]) * path.length).sum(axis=1)
        np.testing.assert_allclose(many[k], right, rtol=1e-10, atol=1e-10)


def test_emission_is_the_oracles_radiance_less_the_airs():
    path, met = walked(warm=True)
    absorber = twin.exact(AIR, HZ, HUMIDITY, TEMPERATURE)
    source = np.array([[1e-17], [-3e-16]]) * np.ones(len(met))
    ours = twin.emission(absorber, HZ, 290.0, path, source, np.zeros(len(HZ)))
    for hz, row, behind in zip(HZ, ours, source[:, 0], strict=True):
        air = oracle.planck(hz, 290.0)
        for contrast, (delta, offset, metres) in zip(row, met, strict=True):
            emitted = [oracle.planck(hz, 290.0 + t) for t in offset]
            right = oracle.transfer(absorbed(hz, delta, offset), metres, emitted, air + behind)
            assert contrast == pytest.approx(right - air, abs=2e-14 * air)


def test_a_mistake_in_the_packages_planck_is_seen(monkeypatch):
    """The twin does not make it too."""
    path, met = walked(warm=True)
    absorber = twin.exact(AIR, HZ, HUMIDITY, TEMPERATURE)
    source = np.zeros((2, len(met)))
    before = (
        twin.emission(absorber, HZ, 290.0, path, source, np.zeros(len(HZ))),
        twin.planck(HZ, 290.0),
    )
    for name in ("planck", "planck_difference", "planck_slope", "radiance_unit", "_occupation"):
        monkeypatch.setattr(radiometry, name, lambda *_: np.nan)
    after = (
        twin.emission(absorber, HZ, 290.0, path, source, np.zeros(len(HZ))),
        twin.planck(HZ, 290.0),
    )
    for one, other in zip(before, after, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("warm", [False, True])
def test_a_polynomial_is_followed_as_it_is(warm):
    """Of low degree, and so unlike the model: the depth is the polynomial's along the path."""
    path, met = walked(warm=warm)
    spans = HUMIDITY, TEMPERATURE if warm else (0.0, 0.0)
    polynomial = fit(AIR, HZ, *spans, tolerance=1e-2)
    right = [
        (polynomial.absorption(delta, offset) * metres).sum(axis=1) for delta, offset, metres in met
    ]
    ours = twin.of_surrogate(polynomial).depth(path)
    np.testing.assert_allclose(ours, np.transpose(right), rtol=1e-12)
    exact = twin.exact(AIR, HZ, *spans).depth(path)
    assert np.abs(ours / exact - 1).max() > 1e-5


STEPPED = """
import numpy as np
from thzcl.constituent import Constituent, OpticalProperties, Parameters, hookimpl

class Odd(Constituent):
    name = "odd"
    contract = 1
    Params = Parameters

    def optics(self, frequency_hz, temperature_k, pressure_hpa, vapour_hpa):
        return OpticalProperties(np.where(vapour_hpa > 17.0, 0.05, 0.0005) + 0 * frequency_hz)

@hookimpl
def register_constituents(): return [Odd]
"""


@pytest.mark.parametrize("warm", [False, True])
def test_a_model_with_steps_is_asked_itself(odd, warm):
    """No series follows a step; what is smooth is followed by one."""
    path, _ = walked(warm=warm)
    air = Air((part("none"), part(odd(STEPPED))), 290.0, 1013.25, 10.0)
    spans = HUMIDITY, TEMPERATURE if warm else (0.0, 0.0)
    absorber = twin.exact(air, HZ, *spans)
    assert set(absorber.direct) == {0, 1}
    offset = path.offset if warm else np.zeros_like(path.delta)
    right = (air.absorption(HZ[:, None, None], path.delta, offset) * path.length).sum(axis=2)
    np.testing.assert_allclose(absorber.depth(path), right, rtol=1e-12)
    assert not twin.exact(AIR, HZ, *spans).direct
