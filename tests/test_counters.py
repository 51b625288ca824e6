"""Work counted rather than timed: what a change makes the device do more often shows here.

On any machine, without noise.
"""

from __future__ import annotations

import pytest

from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.device.choose import open_device
from thzcl.plan.compute import recipes
from thzcl.scenario.source import shipped

# Change these where a scene, a kernel's place in the flow, or what is handed to it changes on
# purpose, and say why; never because a change that should not have touched them did. They hold for
# a CPU device, whose work-items carry 8 rays.
SEGMENTS = {
    "figure6": 25_713,
    "figure7": 398_200,
    "figure8": 764_332,
    "figure9": 764_332,
    "quick": 27_184,
    "raster": 59_504,
    "slide": 29_799,
    "uniform": 0,
}
COUNTERS = {"programs": 4, "launches": 12, "bytes_copied": 17_487_640}


@pytest.fixture(scope="module")
def counted():
    """Voxel segments and counters of a scene, alone on a device of its own.

    Without the error budget's extra rays.
    """

    def call(name, *pixels):
        settings = {"camera.pixels": list(pixels), "numerics.error_budget": False}
        opened = open_device()
        if opened.lanes("float32") != 8:
            pytest.skip("the counts are those of a CPU device")
        plan = pipeline.prepare(name, settings)
        result = pipeline.compute_images(plan, opened, Clock())
        return result.voxel_segments, vars(opened.counters)

    return call


@pytest.mark.parametrize("name", list(shipped()))
def test_every_scene_crosses_as_many_voxels_as_ever(counted, name):
    assert counted(name, 16, 16)[0] == SEGMENTS.get(name)


def test_the_device_is_asked_to_do_as_much_as_ever(counted):
    """One field, one trace and six shadings: kernels built, launched.

    And bytes that change hands.
    """
    assert counted("slide", 64, 64)[1] == COUNTERS


@pytest.mark.parametrize("name", list(shipped()))
def test_what_will_be_built_is_known_beforehand(name):
    """So that two processes can share the work of a first run: no program too few.

    And none too many.
    """
    plan = pipeline.prepare(name, {"camera.pixels": [16, 16]})
    foretold, found = open_device(), open_device()
    for recipe in recipes(plan):
        foretold.build(*recipe)
    pipeline.compute_images(plan, found, Clock())
    assert set(foretold.build_options) == set(found.build_options)
