"""The slide's grid, camera and surfaces in Mitsuba 3, a path tracer for media that also scatter.

Every surface shines with a radiance of 1 and the air absorbs without scattering, so that a pixel's
value is its transmission. `volpath` estimates that by null-collision tracking, and its error falls
with the root of the number of samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

SAMPLES = 4  # a pixel
VARIANT = "scalar_rgb"


def has_mitsuba() -> bool:
    return find_spec("mitsuba") is not None


def mitsuba_march(setting) -> Callable[[], np.ndarray]:
    """Transmission (ray,) with SAMPLES samples a pixel, another seed with every call."""
    import mitsuba as mi

    mi.set_variant(VARIANT)
    scene = mi.load_dict(_scene(mi, setting))
    seeds = iter(range(10**6))

    def call() -> np.ndarray:
        return np.array(mi.render(scene, spp=SAMPLES, seed=next(seeds)))[..., 0].ravel()

    return call


def _scene(mi, setting) -> dict:
    scene = setting.scene
    shining = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    box = scene.targets["box"]
    placed = (
        mi.ScalarTransform4f()
        .translate(box.center_m)
        .rotate([0, 0, 1], box.yaw_deg)
        .scale([s / 2 for s in box.size_m])
    )
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": 4, "rr_depth": 1000},
        "air": _air(mi, setting),
        "sensor": _sensor(mi, scene.camera),
        "ground": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().scale(1e4),
            "emitter": shining,
        },
        "box": {"type": "cube", "to_world": placed, "emitter": shining},
    }


def _sensor(mi, camera) -> dict:
    (width, height), focal = camera.pixels, camera.focal_length_mm
    return {
        "type": "perspective",
        "fov": 2 * math.degrees(math.atan(camera.focal_plane_mm[0] / 2 / focal)),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(camera.position_m, camera.look_at_m, camera.up),
        "medium": {"type": "ref", "id": "air"},
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "independent", "sample_count": SAMPLES},
    }


def _air(mi, setting) -> dict:
    """Returns the periodic cube, turned as it lies in the world.

    It is repeated over the box of voxels that the rays cross.
    """
    ends = _ends(setting)
    camera = setting.turn @ np.array(setting.scene.camera.position_m) / setting.cube.voxel_m
    low = np.floor(np.minimum(ends.min(axis=0), camera)).astype(int) - 2
    high = np.ceil(np.maximum(ends.max(axis=0), camera)).astype(int) + 2
    x, y, z = (np.arange(a, b) % setting.cube.grid for a, b in zip(low, high, strict=True))
    cube = setting.absorption.astype(np.float32)[np.ix_(z, y, x)]
    to_world = np.eye(4)
    to_world[:3, :3] = setting.turn.T * setting.cube.voxel_m
    in_voxels = mi.ScalarTransform4f().translate(low.tolist()).scale((high - low).tolist())
    grid = {
        "type": "gridvolume",
        "grid": mi.VolumeGrid(cube[..., None]),
        "filter_type": "nearest",
        "raw": True,
        "to_world": mi.ScalarTransform4f(to_world) @ in_voxels,
    }
    return {"type": "heterogeneous", "id": "air", "albedo": 0.0, "sigma_t": grid}


def _ends(setting) -> np.ndarray:
    """Returns where the image's outermost rays end, (ray, 3), in voxels of the cube.

    Places are not reduced by its period.
    """
    raster = setting.raster
    numbers = np.arange(setting.rays).reshape(raster.rows, raster.columns)
    edge = np.concatenate([numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]])
    start = setting.turn @ np.array(setting.scene.camera.position_m) / setting.cube.voxel_m
    return start + setting.directions(edge) * setting.ends.reach.host()[edge][:, None]
