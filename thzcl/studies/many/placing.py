"""A target at another range: it moves, the camera looks at it, and nothing else changes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.scenario.scene import Billboard, Box, Camera
from thzcl.surfaces.camera import camera_frame, raster

Array = NDArray[np.float64]
RAYS_ACROSS = 4  # rays that a target's width must take
MOST_SAMPLES = 256  # as many as a camera takes in a pixel


def at_range(
    camera: Mapping[str, Any],
    target: Mapping[str, Any],
    name: str,
    range_m: float,
    keep: bool,
    beside_m: Array | None = None,
) -> dict[str, Any]:
    """Returns the keys that put a target at a slant range from the camera to its centre.

    It moves along the horizontal line from camera to target, at its own height; the camera looks at
    its centre; with `keep` the focal length follows, so that it covers as many pixels. `camera` and
    `target` are their tables. What is looked at lies `beside_m` (3,) from the target's center_m, or
    there if that is None. Raises ValueError for a range at which it cannot be.
    """
    beside = np.zeros(3) if beside_m is None else beside_m
    place = np.array(camera["position_m"], float)
    centre = np.array(target["center_m"], float) + beside
    away = centre - place
    height, along = float(away[2]), math.hypot(away[0], away[1])
    if not range_m > abs(height):
        raise ValueError(
            f"{range_m:g} m is no more than the {abs(height):g} m between the heights of camera "
            f"and {name}; give a longer range"
        )
    if along == 0:
        raise ValueError(
            f"{name} stands straight above or below the camera, so that no line leads to it; move "
            "its center_m"
        )
    level = math.sqrt(range_m**2 - height**2)
    there = [*(place[:2] + away[:2] / along * level).tolist(), float(centre[2])]
    stands = (np.array(there) - beside).tolist()
    found: dict[str, Any] = {f"targets.{name}.center_m": stands, "camera.look_at_m": there}
    if keep:
        focal = float(camera["focal_length_mm"])
        found["camera.focal_length_mm"] = focal * range_m / math.hypot(along, height)
    return found


class Outline(NamedTuple):
    """How a target lies in the picture: the extent of its corners, in widths of the picture.

    The picture reaches from -0.5 to 0.5 each way. `rays` is the target's width in rays, the smaller
    of across and down. `ahead` is False if a corner is not in front of the camera.
    """

    across: tuple[float, float]
    down: tuple[float, float]
    rays: float
    ahead: bool

    @property
    def within(self) -> bool:
        """Returns whether the whole target lies in the picture."""
        return self.ahead and all(-0.5 <= end <= 0.5 for end in (*self.across, *self.down))


def outline(camera: Camera, points_m: Array) -> Outline:
    """Returns how a target whose corners are `points_m` (n, 3) lies in the picture of a camera."""
    rays = raster(camera)
    position, forward, right, up = camera_frame(camera, rays)
    away = points_m - position
    depth = away @ forward
    if depth.min() <= 0:
        return Outline((0.0, 0.0), (0.0, 0.0), 0.0, ahead=False)
    u = away @ right / (right @ right) / depth / rays.columns
    v = -(away @ up) / (up @ up) / depth / rays.rows
    wide, high = float(np.ptp(u)) * rays.columns, float(np.ptp(v)) * rays.rows
    return Outline(_ends(u), _ends(v), min(wide, high), ahead=True)


def _ends(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def corners(target: Box | Billboard) -> Array:
    """Returns the corners of a target in the world, (n, 3), m."""
    if isinstance(target, Box):
        turn, sizes = math.radians(target.yaw_deg), target.size_m
    else:
        turn, sizes = (
            math.radians(target.facing_deg + 90),
            (target.size_m[0], 0.0, target.size_m[1]),
        )
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
    own = signs * np.array(sizes)
    cosine, sine = math.cos(turn), math.sin(turn)
    turned = own @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turned + np.array(target.center_m))


def samples(camera: Camera, seen: Outline) -> int:
    """Returns the samples a pixel with which a target's width takes RAYS_ACROSS rays."""
    own = camera.samples_per_pixel
    if seen.rays >= RAYS_ACROSS or seen.rays <= 0:
        return own
    each_way = math.ceil(math.sqrt(own) * RAYS_ACROSS / seen.rays)
    return min(each_way**2, MOST_SAMPLES)


def named(path: str) -> str | None:
    """Returns the target whose range a key is, "targets.NAME.range_m", or None."""
    parts: Sequence[str] = path.split(".")
    is_range = len(parts) == 3 and parts[0] == "targets" and parts[2] == "range_m"
    return parts[1] if is_range else None
