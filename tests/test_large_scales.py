"""Eddies larger than the cube: closed sums against the continuum, drawn waves against the sums."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import ACTIVE, run, scene, write
from scipy import integrate, special

from thzcl import pipeline
from thzcl.device.choose import open_device
from thzcl.errors import ScenarioError
from thzcl.plan import report as plan_report
from thzcl.turbulence import cube, large_scales, spectra
from thzcl.turbulence.orientation import ROTATIONS

PERIOD_M, GRID, PATH_M = 128 * 0.65, 128, 66.0
CONSTANT = 9.6935e-3  # of Kolmogorov's spectrum in cycles per metre


def directions(count=50):
    towards = np.random.default_rng(1).normal(size=(count, 3))
    return towards / np.linalg.norm(towards, axis=1)[:, None]


def cube_waves(outer_scale_m):
    """Wave vectors (n, 3) of the cube, and the variance of each for C^2 = 1."""
    number = np.fft.fftfreq(GRID, 1 / GRID)
    vector = np.stack(np.meshgrid(number, number, number, indexing="ij"), -1).reshape(-1, 3)[1:]
    vector /= PERIOD_M
    least = 0 if outer_scale_m is None else outer_scale_m**-2
    square = (vector**2).sum(axis=1) + least
    return vector, CONSTANT * square ** (-11 / 6) / PERIOD_M**3


def continuum(outer_scale_m):
    """The variance of the path mean in von Karman's air, for C^2 = 1."""

    def along(wave):  # the mean of sinc^2(wave mu) over directions
        a = math.pi * wave
        return (special.sici(2 * a)[0] - math.sin(a) ** 2 / a) / a if a > 1e-4 else 1 - a * a / 9

    def density(log_xi):
        xi = math.exp(log_xi)
        psi = CONSTANT * (xi * xi + outer_scale_m**-2) ** (-11 / 6)
        return 4 * math.pi * xi**3 * psi * along(xi * PATH_M)

    return integrate.quad(density, math.log(1e-7), math.log(5.0), limit=500)[0]


@pytest.mark.parametrize(
    ("outer_scale_m", "cube_alone"), [(30, 0.983), (100, 0.852), (300, 0.551), (1000, 0.322)]
)
def test_the_path_mean_varies_as_in_open_air(outer_scale_m, cube_alone):
    """The rms over that of the continuum, as a sum over all waves, in 50 directions."""
    vector, variance = cube_waves(outer_scale_m)
    large = large_scales.spread(PERIOD_M, outer_scale_m)
    due, without, both = continuum(outer_scale_m), [], []
    for towards in directions():
        own = variance @ np.sinc(vector @ towards * PATH_M) ** 2
        more = CONSTANT * large.variance @ np.sinc(large.vector @ towards * PATH_M) ** 2
        without.append(math.sqrt(own / due))
        both.append(math.sqrt((own + more) / due))
    assert np.mean(without) == pytest.approx(cube_alone, abs=0.002)
    assert np.mean(both) >= 0.94
    assert np.min(both) >= 0.93
    assert np.max(both) < 1.02


def test_kolmogorov_differences_reach_the_law():
    vector, variance = cube_waves(None)
    large = large_scales.spread(PERIOD_M, None)
    ratios = []
    for towards in directions():
        apart = 83.0 * towards
        own = 2 * variance @ (1 - np.cos(2 * np.pi * vector @ apart))
        more = 2 * CONSTANT * large.variance @ (1 - np.cos(2 * np.pi * large.vector @ apart))
        ratios.append([own / 83.0 ** (2 / 3), (own + more) / 83.0 ** (2 / 3)])
    without, both = np.mean(ratios, axis=0)
    assert without == pytest.approx(0.41, abs=0.03)
    assert 0.9 < both < 1.1


def test_across_the_image_little_changes():
    """The rms difference of paths side by side, in units of that of the cube alone."""
    vector, variance = cube_waves(None)
    large = large_scales.spread(PERIOD_M, None)
    sums = np.zeros(2)
    for towards in directions(20):
        aside = 0.3 * np.cross(towards, [0.0, 0.6, 0.8])
        for waves, power in ((vector, variance), (large.vector, CONSTANT * large.variance)):
            each = power * np.sinc(waves @ towards * PATH_M) ** 2
            part = each @ (2 - 2 * np.cos(2 * np.pi * waves @ aside))
            sums += [part * (waves is vector), part]
    assert 1 < math.sqrt(sums[1] / sums[0]) < 1.03


def test_waves_have_the_strengths_that_are_told():
    """Over the cube's sigma: 4.6 for Kolmogorov; 1.6, 0.8 and 0.28 with an outer scale."""
    for outer_scale_m, due in ((None, 4.6), (1000.0, 1.6), (300.0, 0.8), (100.0, 0.28)):
        large = large_scales.spread(PERIOD_M, outer_scale_m)
        assert large.vector.shape == (104, 3)
        own = spectra.variance(GRID, 0.65, outer_scale_m)
        found = math.sqrt(CONSTANT * large.variance.sum() / own)
        assert found == pytest.approx(due, rel=0.02)


def test_drawn_waves_have_the_variance_of_the_sum():
    """That of the path mean, over 400 seeds and ten directions, within four of its scatters."""
    towards, seeds = directions(10), range(400)
    large = large_scales.spread(PERIOD_M, 300.0)
    means = [
        large_scales.drawn(PERIOD_M, 300.0, 1.0, seed).mean(np.zeros(3), PATH_M * towards)
        for seed in seeds
    ]
    due = [large.variance @ np.sinc(large.vector @ one * PATH_M) ** 2 for one in towards]
    ratio = np.mean(np.square(means), axis=0) / due
    assert np.abs(ratio - 1).max() < 4 * math.sqrt(2 / len(seeds))


def test_the_mean_along_a_line_is_that_of_its_points():
    waves = large_scales.drawn(PERIOD_M, None, 1.0, 7).less(np.array([1.0, 2.0, 3.0]))
    assert waves.at(np.array([[1.0, 2.0, 3.0]])) == pytest.approx(0.0, abs=1e-12)
    start, way = np.array([[3.0, -20.0, 800.0]]), np.array([[40.0, 30.0, -10.0]])
    parts = (np.arange(20000)[:, None] + 0.5) / 20000
    points = waves.at(start + parts * way)
    assert waves.mean(start, way)[0] == pytest.approx(points.mean(), rel=1e-6)
    low, high = waves.span(np.array([1.0, 2.0, 3.0]), 60.0)
    around = directions(500) * np.random.default_rng(2).uniform(0, 60, 500)[:, None]
    found = waves.at(np.array([1.0, 2.0, 3.0]) + around)
    assert low < found.min() <= 0 <= found.max() < high


# --- images ---------------------------------------------------------------------------------------


def air(**fluctuations):
    """Returns a scene in weak turbulence that is larger than its cube."""
    data = scene(background__max_range_m=40.0, output={"save_field": True})
    flow = {"sigma_percent": 4.0, "voxel_m": 1.3, "grid": 32, "seed": 5}
    data["atmosphere"]["fluctuations"] = flow | fluctuations
    return data


def test_depths_are_those_of_cube_and_waves(tmp_path):
    """By the oracle's sum over the saved cube, with the waves' own sum along each ray."""
    result = run(tmp_path, air(large_scales=True))
    saved, sight = result.cubes[0], result.variants[0].radiances
    grams = saved.absolute_humidity_g_m3.astype(float)
    mean = float(np.mean(grams))
    strength = CONSTANT * 0.04**2 / gaussian_variance(5)
    waves = large_scales.drawn(32 * 1.3, None, strength, 5)
    turn = ROTATIONS["oblique"]
    origin = np.array([1.0, -2.0, 4.0])
    waves = waves.less(turn @ origin)
    camera = oracle.Camera((1, -2, 4), (30, 8, 1), 30, (12, 9), (16, 12))
    for row, column in ((2, 3), (8, 12), (11, 0)):
        far = float(sight.path_length[row, column])
        ray = camera.ray(row, column)
        held, metres = oracle.path(grams, origin, ray, far, 1.3, turn)
        middle = np.cumsum(metres) - metres / 2
        large = waves.at((origin + middle[:, None] * ray) @ turn.T)
        per_m = oracle.absorption_per_m(650e9, 290.0, 1013.25, held + mean * large)
        due = float(np.sum(per_m * metres))
        assert sight.optical_depth[0, row, column] == pytest.approx(due, rel=1e-4)


def gaussian_variance(seed):
    """Returns the variance of the air's Gaussian of C^2 = 1, which is not rescaled."""
    plain = spectra.Turbulence(32, 1.3, seed, None, 0.01, False, False, 0.0, False, 0.0)
    made = cube.generate(open_device(), plain, "float32")
    return float(np.var(made.delta.host().astype(float))) * spectra.variance(32, 1.3, None) / 1e-4


def test_the_cube_keeps_its_bits_and_what_is_left_out_is_not_there(tmp_path):
    plain, large = (run(tmp_path, air(large_scales=on)) for on in (False, True))
    default = run(tmp_path, air())
    one, other = (made.cubes[0].absolute_humidity_g_m3 for made in (plain, large))
    assert np.array_equal(one, other)
    sights = [made.variants[0].radiances.contrast for made in (default, plain, large)]
    assert np.array_equal(sights[0], sights[1])
    assert not np.array_equal(sights[0], sights[2])
    assert "large-scales" not in default.error_budget
    assert 0 < large.error_budget["large-scales"]["relative"] < 1e-3


def depth(tmp_path, **more):
    """Returns the depth of a scene with large scales less that of the same without."""
    with_waves, without = (
        run(tmp_path, air(large_scales=on) | more).variants[0].radiances.optical_depth
        for on in (True, False)
    )
    return with_waves - without


def test_thinned_rays_and_another_arithmetic_have_the_same_large_scales(tmp_path):
    due = depth(tmp_path)
    assert np.abs(due).max() > 0.01
    assert depth(tmp_path, numerics={"ray_stride": 4}) == pytest.approx(due, abs=2e-4)
    assert depth(tmp_path, numerics={"precision": "float64"}) == pytest.approx(due, abs=2e-6)


SCAN = {
    "kind": "raster-scan",
    "dwell_s": 0.02,
    "detector": {"kind": "passive-spectral", "frequency_ghz": 650.0},
}
BISTATIC = ACTIVE | {"arrangement": "bistatic", "transmitter_m": [4.0, 6.0, 3.0]}


@pytest.mark.parametrize("sensor", [SCAN, BISTATIC], ids=["scan", "bistatic"])
def test_the_float64_twin_walks_through_the_same_large_eddies(tmp_path, sensor):
    """Segment by segment, from the place and at the time of each ray."""
    data = air(large_scales=True, wind_m_s=[3.0, 1.0, 0.0]) | {"sensor": sensor}
    budget = run(tmp_path, data).error_budget
    assert budget["arithmetic"]["relative"] < 1e-6
    assert 0 < budget["large-scales"]["relative"] < 1e-3


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"temperature_sigma_k": 0.5}, "large_scales: is for air of one temperature"),
        ({"distribution": "lognormal"}, "large_scales: is for Gaussian humidity"),
        ({"sigma_percent": 40.0}, "large_scales: is for Gaussian humidity"),
    ],
)
def test_air_without_a_closed_form_is_refused(tmp_path, keys, text):
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, air(large_scales=True, **keys)))
    assert text in str(caught.value)


def test_what_a_user_is_told(tmp_path):
    """That a saved cube lacks the waves, and that rescaled cubes vary less than open air."""
    plan = pipeline.prepare(write(tmp_path, air(large_scales=True)))
    told = plan_report.warnings(plan, [0.0])
    assert any("large_scales" in note and "saved cube" in note for note in told)
    stages = {one.name: one for one in plan_report.stages(plan, figure=False)}
    assert "larger than the cube" in stages["humidity-field"].reason
    many = air() | {"numerics": {"realizations": 20}, "output": {}}
    for keys, due in (({}, True), ({"sigma_of": "ensemble"}, False)):
        many["atmosphere"]["fluctuations"] |= keys
        notes = plan_report.warnings(pipeline.prepare(write(tmp_path, many)), [0.0])
        assert any('sigma_of = "ensemble"' in note for note in notes) == due


def test_sigma_of_an_ensemble_is_an_expectation(tmp_path):
    """A cube then differs from that of the structure constant by rounding alone."""
    unit = spectra.variance(32, 1.3, None)
    mean = pipeline.prepare(write(tmp_path, air())).variants[0].air.absolute_humidity_g_m3
    ratios = []
    for seed in range(4):
        keys = {"seed": seed, "sigma_of": "ensemble"}
        one = run(tmp_path, air(**keys)).cubes[0].absolute_humidity_g_m3
        given = air(seed=seed)
        del given["atmosphere"]["fluctuations"]["sigma_percent"]
        given["atmosphere"]["fluctuations"]["structure_constant_q"] = (0.04 * mean) ** 2 / unit
        other = run(tmp_path, given).cubes[0].absolute_humidity_g_m3
        ratios.append(float(one.astype(float).var() / other.astype(float).var()))
    assert np.abs(np.array(ratios) - 1).max() < 1e-4
