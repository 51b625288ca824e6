"""Statistics over realisations of the air."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import run, scene, write

from thzcl import pipeline
from thzcl.errors import ScenarioError
from thzcl.graph import everything
from thzcl.plan import report as overview
from thzcl.studies.ensemble import Running
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
def test_air_that_does_not_fluctuate_has_no_realisations(tmp_path, changes):
    with pytest.raises(ScenarioError, match="needs air that fluctuates at random"):
        run(tmp_path, scene(numerics={"realizations": 3}, **changes))


def test_progress_tells_which_realisation(tmp_path):
    told = []
    pipeline.run(write(tmp_path, scene(numerics={"realizations": 3})), progress=told.append)
    assert any("] 3 of 3: trace" in text for text in told)
