"""No silent NaN: a value that is no number ends the run, with its pixel and ray named.

What was computed before is kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import lens, run, scene

from thzcl.errors import NumbersError, ThzclError
from thzcl.sensing.pixels import PixelsSpec

ACTIVE = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 80.0}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("sensor", "plane"), [(None, "contrast"), (None, "depth"), (ACTIVE, "contrast")]
)
def test_a_number_that_is_none_ends_the_run(tmp_path, monkeypatch, value, sensor, plane):
    """Of two bad pixels the first is named, with the direction of its ray as the oracle has it."""
    healthy = PixelsSpec.run

    def spoilt(spec, device, parts):
        pixels = healthy(spec, device, parts)
        values = np.array(getattr(pixels, plane))
        values[0, 7, 3] = values[0, 9, 1] = value
        return replace(pixels, **{plane: values})

    monkeypatch.setattr(PixelsSpec, "run", spoilt)
    data = scene(numerics={"error_budget": False}, **({"sensor": sensor} if sensor else {}))
    with pytest.raises(
        NumbersError, match="2 pixels are not finite numbers; the first is row 7, column 3"
    ) as caught:
        run(tmp_path, data)
    told = np.array(
        [float(number) for number in str(caught.value).split("along (")[1].split(")")[0].split(",")]
    )
    assert told / np.linalg.norm(told) == pytest.approx(lens(data).ray(7, 3), abs=1e-5)
    kept = caught.value.result
    assert kept.variants[0].image is None
    assert kept.save(tmp_path / "kept.nc").stat().st_size > 0


def test_depths_beyond_every_exponential_are_numbers(tmp_path):
    """A saturated line along 100 km makes thousands of depths, and no NaN of them."""
    data = scene(
        sensor={"kind": "passive-spectral", "frequency_ghz": 556.936},
        background__max_range_m=1e5,
        numerics={"cutoff_depth": 1e6},
        ground=None,
        targets=None,
        atmosphere__fluctuations__voxel_m=50.0,
    )
    sight = run(tmp_path, data).variants[0].radiances
    assert sight.optical_depth.min() > 1e4
    assert np.all(sight.contrast == 0)


def test_a_bug_while_a_scene_is_planned_is_no_bad_input(tmp_path, monkeypatch):
    """A ValueError that no file caused says that thzcl is wrong, and comes through."""

    def broken(*_, **__):
        raise ValueError("could not broadcast")

    for name in ("plan.variant.geometry.geometry", "plan.variant.cube_source"):
        with monkeypatch.context() as patch:
            patch.setattr(f"thzcl.{name}", broken)
            with pytest.raises(ValueError, match="could not broadcast") as caught:
                run(tmp_path, scene())
            assert not isinstance(caught.value, ThzclError)
