"""What a plan counts of memory; `python tests/memory.py` measures it beside runs."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import scene, write

from thzcl.pipeline import prepare
from thzcl.plan.memory import PERCENTILE_BYTES, by_pixel, needed

PIXELS = 2000
MORE = {  # at least so many bytes a pixel more
    "realisations": ({"numerics": {"realizations": 5}}, 8 * 8),
    "compared models": ({"atmosphere__compare": ["r24"]}, 4 * 2),
    "frequencies": ({"sensor__frequency_ghz": [340.0, 650.0, 850.0]}, 2 * 4 * 4),
    "float64": ({"numerics": {"precision": "float64"}}, 4 * 4),
}


def bytes_of(folder, **changes):
    return needed(prepare(write(folder, scene(camera__pixels=[PIXELS, PIXELS], **changes))))[0]


@pytest.mark.parametrize("case", MORE)
def test_what_takes_more_is_counted(tmp_path, case):
    changes, each = MORE[case]
    more = bytes_of(tmp_path, **changes) - bytes_of(tmp_path)
    assert more >= each * PIXELS**2


def test_triangles_are_counted(tmp_path):
    def with_triangles(n):
        corners = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, 1]])
        faces = np.tile(np.arange(3), (n, 1)) + 3 * np.arange(n)[:, None]
        vertices = np.tile(corners, (n, 1)) + 0.01 * np.repeat(np.arange(n), 3)[:, None]
        np.savez(tmp_path / "mesh.npz", vertices=vertices, faces=faces)
        mesh = {"kind": "mesh", "file": "mesh.npz", "center_m": [20.0, 0.0, 1.0]}
        return bytes_of(tmp_path, targets__thing=mesh | {"temperature_k": 290.0})

    assert with_triangles(2000) - with_triangles(1000) >= 100 * 1000


def test_images_are_kept_for_percentiles_within_a_bound():
    most = PERCENTILE_BYTES // 4
    assert by_pixel(1, 1, most)
    assert not by_pixel(1, 1, most + 1)
