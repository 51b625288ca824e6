"""Statistics over realisations of the air."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scenes import ACTIVE, run, scene, write

from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.graph import evaluate, everything
from thzcl.plan import memory
from thzcl.plan import report as overview
from thzcl.results.contents import VariantResult
from thzcl.sensor import Image, Layer, Radiances
from thzcl.studies.ensemble import Ensemble, Running
from thzcl.turbulence.fields import FieldSpec


def test_running_statistics_are_numpys():
    values = np.random.default_rng(1).normal(1e3, 1.0, (7, 4, 5))
    running = Running()
    for one in values:
        running.add(one)
    assert running.mean == pytest.approx(values.mean(axis=0), rel=1e-12)
    assert running.variance == pytest.approx(values.var(axis=0, ddof=1), rel=1e-9)
    assert np.array_equal(running.high - running.low, values.max(axis=0) - values.min(axis=0))


def seed_of(batch):
    """Returns the seed of the one field that a batch reads."""
    (field,) = (spec for spec in everything(batch) if isinstance(spec, FieldSpec))
    return field.turbulence.seed


def test_an_ensemble_is_its_realisations(tmp_path):
    """Mean, variance and spread are those of five images computed alone from their own seeds."""
    data = scene(numerics={"realizations": 5})
    together = run(tmp_path, data)
    plan = pipeline.prepare(write(tmp_path, data))
    seeds = [seed_of(plan.batch(number)) for number in range(5)]
    assert len(set(seeds)) == 5
    assert seeds[0] == 3
    alone = [run(tmp_path, scene(atmosphere__fluctuations__seed=seed)) for seed in seeds]
    images = np.array([one.variants[0].image.values for one in alone])
    image = together.variants[0].image
    assert image.values == pytest.approx(images.mean(axis=0), abs=1e-9)
    assert image.layers["image_variance"].values == pytest.approx(
        images.var(axis=0, ddof=1), abs=1e-9
    )
    assert image.layers["image_spread"].values == pytest.approx(np.ptp(images, axis=0), abs=1e-9)
    assert together.variants[0].radiances.contrast.dtype == np.float32
    assert together.voxel_segments == sum(one.voxel_segments for one in alone)
    assert overview.voxel_segments(plan) == pytest.approx(together.voxel_segments, rel=0.1)
    assert image.layers["image_variance"].values.max() > 1e-3


def test_an_ensemble_is_saved_and_drawn(tmp_path):
    result = run(tmp_path, scene(numerics={"realizations": 2}))
    dataset = result.to_xarray()
    assert dataset["image_variance"].attrs["units"] == "(K)^2"
    assert dataset["image_spread"].dims == ("variant", "y", "x")
    assert result.save(tmp_path / "out.nc").stat().st_size > 0
    assert result.figure(tmp_path / "out.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    "changes", [{"atmosphere__fluctuations": None}, {"atmosphere__model": "none"}]
)
def test_air_that_does_not_fluctuate_has_no_realisations_without_noise(tmp_path, changes):
    with pytest.raises(ScenarioError, match="needs air that fluctuates at random"):
        run(tmp_path, scene(numerics={"realizations": 3}, **changes))


def test_progress_tells_which_realisation(tmp_path):
    told = []
    pipeline.run(write(tmp_path, scene(numerics={"realizations": 3})), progress=told.append)
    assert any("] 3 of 3: trace" in text for text in told)


NOISY = {
    "kind": "passive-broadband",
    "center_ghz": 650.0,
    "bandwidth_ghz": 100.0,
    "noise_equivalent_power_w_rthz": 3e-12,
}
EVEN = {"atmosphere__fluctuations": None, "sensor": NOISY}


def power(result):
    return result.variants[0].image.layers["received_power"].values


def test_noise_of_a_scene_without_seeds_is_drawn_told_and_repeated(tmp_path):
    """Two runs differ; a run of the stored scene, and one with the stored seed, do not."""
    one, other = (run(tmp_path, scene(**EVEN)) for _ in range(2))
    assert one.noise_seed != other.noise_seed
    assert not np.array_equal(power(one), power(other))
    stored = one.save(tmp_path / "one.nc")
    assert np.array_equal(power(pipeline.run(stored)), power(one))
    again = run(tmp_path, scene(**EVEN, numerics__noise_seed=one.noise_seed))
    assert np.array_equal(power(again), power(one))
    assert one.summary()["noise_seed"] == one.to_xarray().attrs["noise_seed"] == one.noise_seed
    quiet = run(tmp_path, scene(atmosphere__fluctuations=None))
    assert quiet.noise_seed is None
    assert "noise_seed" not in quiet.to_xarray().attrs


def test_the_same_air_is_seen_with_other_noise_and_other_air_with_the_same(tmp_path):
    def seen(air, noise):
        changes = {} if noise is None else {"numerics__noise_seed": noise}
        found = run(tmp_path, scene(atmosphere__fluctuations__seed=air, sensor=NOISY, **changes))
        sight = found.variants[0].radiances
        scale = power(found).mean() / sight.radiance.mean()
        return sight.contrast, power(found) - scale * sight.radiance[0]

    (air, noise), (same_air, other_noise), (other_air, same_noise) = (
        seen(3, 8),
        seen(3, 9),
        seen(4, 8),
    )
    assert np.array_equal(air, same_air)
    assert not np.array_equal(air, other_air)
    assert abs(np.corrcoef(noise.ravel(), other_noise.ravel())[0, 1]) < 0.3
    assert np.corrcoef(noise.ravel(), same_noise.ravel())[0, 1] > 0.99
    assert np.array_equal(seen(3, None)[1], seen(3, 3)[1])  # noise follows the air's seed


def test_realisations_of_noise_in_even_air(tmp_path, device):
    """The mean of 64 has an eighth of the noise; the air's transfer is computed once."""
    data = scene(**EVEN, numerics={"realizations": 64, "noise_seed": 5}, camera__pixels=[40, 30])
    found = run(tmp_path, data).variants[0].image
    one = 3e-12
    left = found.layers["received_power"].values - found.layers["received_power"].values.mean()
    exact = run(
        tmp_path,
        scene(
            **EVEN | {"sensor": NOISY | {"noise_equivalent_power_w_rthz": 0.0}},
            camera__pixels=[40, 30],
        ),
    )
    left = found.layers["received_power"].values - power(exact)
    assert left.std() == pytest.approx(one / 8, rel=0.06)  # 2.9 sigma of 1200 pixels
    per_kelvin = found.values[0, 0] / found.layers["received_power"].values[0, 0]
    spread = np.sqrt(found.layers["image_variance"].values.mean())
    assert spread == pytest.approx(one * per_kelvin, rel=0.02)
    low, middle, high = (
        found.layers[f"image_percentile_{percent}"].values for percent in (5, 50, 95)
    )
    # Of a Gaussian, 5 and 95 % lie 1.645 sigma from the median.
    assert (high - low).mean() == pytest.approx(2 * 1.645 * one * per_kelvin, rel=0.05)
    assert (low < middle).all() and (middle < high).all()
    assert found.facts["noise power"] == (pytest.approx(one), "W")
    plan, runs = pipeline.prepare(write(tmp_path, data)), Counter()
    list(evaluate((plan.batch(n) for n in range(4)), device, runs=runs))
    assert (runs["ShadeSpec"], runs["ImageSpec"]) == (1, 4)


def test_percentiles_are_numpys_or_those_of_targets_beyond_the_bound(tmp_path, monkeypatch):
    data = scene(numerics={"realizations": 6})
    plan = pipeline.prepare(write(tmp_path, data))
    alone = [
        run(tmp_path, scene(atmosphere__fluctuations__seed=seed_of(plan.batch(number))))
        for number in range(6)
    ]
    images = np.array([one.variants[0].image.values for one in alone])
    shown = alone[0].variants[0].radiances.target == 2
    means = images[:, shown].mean(axis=1)
    for bound in (memory.PERCENTILE_BYTES, 4 * images.size - 1):
        monkeypatch.setattr(memory, "PERCENTILE_BYTES", bound)
        image = run(tmp_path, data).variants[0].image
        for percent in (5, 50, 95):
            found = image.facts[f"box: percentile {percent} of the mean"]
            assert found == (pytest.approx(np.percentile(means, percent), abs=1e-9), "K")
            name = f"image_percentile_{percent}"
            assert (name in image.layers) == (bound >= 4 * images.size)
            if name in image.layers:
                due = np.percentile(images, percent, axis=0)
                assert image.layers[name].values == pytest.approx(due, abs=1e-4)


def test_powers_are_averaged_as_powers_and_flags_become_fractions(tmp_path):
    """Through air that takes the echoes below the floor in some realisations, not in others."""
    sensor = ACTIVE | {"dynamic_range_db": 32.0}
    changes = {"sensor": sensor, "atmosphere__fluctuations__sigma_percent": 60.0}
    plan = pipeline.prepare(write(tmp_path, scene(numerics={"realizations": 8}, **changes)))
    seeds = [seed_of(plan.batch(number)) for number in range(8)]
    alone = [
        run(tmp_path, scene(**changes, atmosphere__fluctuations__seed=seed)).variants[0].image
        for seed in seeds
    ]
    image = run(tmp_path, scene(numerics={"realizations": 8}, **changes)).variants[0].image
    powers = np.array([one.layers["received_power"].values for one in alone])
    mean, floor = powers.mean(axis=0), alone[0].facts["floor"][0]
    assert image.values == pytest.approx(10 * np.log10(np.maximum(mean, floor) / floor), abs=1e-9)
    decibels = np.mean([one.values for one in alone], axis=0)
    assert np.abs(decibels - image.values).max() > 0.05  # which means of decibels are not
    fraction = image.layers["below_floor"]
    assert fraction.quantity == "fraction of realisations: the power is below the floor"
    assert fraction.values == pytest.approx((powers < floor).mean(axis=0), abs=1e-12)
    assert 0 < fraction.values[(mean > 0) & (fraction.values < 1)].max() < 1


def test_decibels_of_a_plugin_that_does_not_say_of_what(tmp_path):
    """They are averaged as powers too; whole numbers that are no flags have a mean."""
    sight = run(tmp_path, scene(camera__pixels=[2, 1])).variants[0].sight
    assert isinstance(sight, Radiances)
    many = Ensemble(("background", "ground", "box"))
    for decibels, count in ((0.0, 3), (10.0, 4)):
        layer = Layer(np.full((1, 2), count), "1", "whether it counts")
        image = Image(np.full((1, 2), decibels), "dB", "power", {"count": layer})
        many.add(VariantResult("one", sight, image))
    image = many.mean().image
    assert image is not None
    assert image.values == pytest.approx(np.full((1, 2), 10 * np.log10(5.5)))
    assert image.layers["count"].quantity == "mean of it counts"
    assert image.layers["count"].values == pytest.approx(np.full((1, 2), 3.5))
