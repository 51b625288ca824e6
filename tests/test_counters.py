"""Work is counted, not timed: what a change makes the device do more often shows without noise."""

from __future__ import annotations

import pytest

from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.device.choose import open_device
from thzcl.scenario.source import shipped

# Change these where a scene, a kernel's place in the flow, or what is handed to it changes on
# purpose, and say why; never because a change that should not have touched them did. They hold for
# a CPU device, whose work-items carry 8 rays. Figure 7 had 398,200 before its lens was twice as
# long at 80 m; scenes with optics trace more rays, the larger their few pixels are.
SEGMENTS = {
    "active-noise": 86_863_617,
    "concealed": 0,
    "concealed-active": 0,
    "figure6": 25_713,
    "figure7": 306_724,
    "figure8": 764_332,
    "figure9": 764_332,
    "fog": 25_713,
    "lookout": 5_119_844,
    "outdoor": 0,
    "quick": 27_184,
    "radiometer": 124_760_895,
    "rain": 25_713,
    "rain-active": 44_687_486,
    "raster": 59_504,
    "snow": 25_713,
    "slide": 29_799,
    "uniform": 0,
    "vehicle": 0,
}
# Since variants are a graph, lengths and surfaces of the 64 x 64 rays are read once for what all
# six images show, and once for the cut-off (3 readings of 16 KiB more), but the way out, which is
# the way back, no more for each image (6 fewer): 17,487,640 bytes before. Bounds of the cube and
# heights of its air take 24 bytes where there are none.
COUNTERS = {"programs": 4, "launches": 12, "segments": 476_713, "bytes_copied": 17_436_440}
RAYS = 64 * 64  # of that scene; a count of voxels comes back for each packet of the trace beside


@pytest.fixture(scope="module")
def counted():
    """Returns a scene's voxel segments and the counters of a device that runs nothing else.

    The error budget, with rays of its own, is left out.
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


SLOW = dict.fromkeys(("active-noise", "rain-active"), pytest.mark.slow)  # images through optics


@pytest.mark.parametrize("name", [pytest.param(n, marks=SLOW.get(n, ())) for n in shipped()])
def test_every_scene_crosses_as_many_voxels_as_ever(counted, name):
    assert counted(name, 16, 16)[0] == SEGMENTS.get(name)


def test_the_device_is_asked_to_do_as_much_as_ever(counted):
    """One field, one trace and six shadings: kernels built and launched, and bytes moved."""
    counts = 4 * RAYS // open_device().lanes("float32", gathers=True)  # bytes
    expected = COUNTERS | {"bytes_copied": COUNTERS["bytes_copied"] + counts}
    assert counted("slide", 64, 64)[1] == expected
