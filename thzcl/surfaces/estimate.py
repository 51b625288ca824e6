"""Finds on the host where a sample of an image's rays ends, so that plans can be made.

Billboards are taken as whole rectangles of one shade, and boxes as without stripes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thzcl.surfaces.camera import directions
from thzcl.surfaces.geometry import BACKGROUND, FIRST_TARGET, GROUND, Geometry

Array = NDArray[np.float64]
SAMPLED = 64  # rows, and columns, of the raster whose rays are sampled


@dataclass(frozen=True)
class SampledRays:
    """A sample of an image's rays: unit directions (n, 3), lengths (n,) in m, surfaces met (n,).

    They lie in `rows` rows of the raster, with equally many rays in each.
    """

    direction: Array
    length: Array
    surface: NDArray[np.int32]
    rows: int


@lru_cache(maxsize=32)  # variants often have their geometry in common
def sampled_rays(shape: Geometry) -> SampledRays:
    """Returns a few thousand rays of a raster, in regular rows and columns."""
    rows, columns = (
        np.arange(n) if n <= SAMPLED else np.linspace(0, n - 1, SAMPLED).astype(np.int64)
        for n in (shape.raster.rows, shape.raster.columns)
    )
    numbers = (rows[:, None] * shape.raster.columns + columns).ravel()
    direction = directions(shape.frame.array, shape.raster, numbers)
    norm = np.linalg.norm(direction, axis=1)
    reach, surface = first_met(shape, direction)
    return SampledRays(direction / norm[:, None], reach * norm, surface, len(rows))


def first_met(shape: Geometry, direction: Array) -> tuple[Array, NDArray[np.int32]]:
    """Returns the ray parameter at the nearest surface, and the surface's number, both (n,).

    `direction` (n, 3) is what camera.directions returns. Rays that meet nothing end at max_range_m,
    or at the ceiling.
    """
    origin, things = shape.frame.array[0], shape.things
    nearest = things.max_range_m / np.linalg.norm(direction, axis=1)
    rising = direction[:, 2] > 0
    up = np.where(rising, direction[:, 2], 1.0)
    ceiling = np.where(rising, (things.ceiling_m - origin[2]) / up, np.inf)
    nearest = np.minimum(nearest, ceiling)
    surface = np.full(len(direction), BACKGROUND, dtype=np.int32)
    with np.errstate(divide="ignore", invalid="ignore"):
        for number, hit in _hits(shape, origin, direction):
            met = (hit > 0) & (hit < nearest)
            nearest, surface = np.where(met, hit, nearest), np.where(met, np.int32(number), surface)
    if "meshes" in things.kinds:
        hit, struck = things.meshes.struck(origin, direction)
        met = hit < nearest
        nearest, surface = np.where(met, hit, nearest), np.where(met, struck, surface)
    return nearest, surface


def _hits(shape: Geometry, origin: Array, direction: Array) -> list[tuple[int, Array]]:
    """Returns, for each thing, its surface's number and the parameter at which rays meet it.

    The parameters (n,) are inf for rays that do not meet the thing.
    """
    things = shape.things
    hits: list[tuple[int, Array]] = []
    if things.ground:
        down = np.where(direction[:, 2] < 0, -origin[2] / direction[:, 2], np.inf)
        hits.append((GROUND, down))
    for number, box in enumerate(things.boxes.array):
        hits.append((FIRST_TARGET + number, _to_box(origin, direction, box)))
    for board, row in zip(things.billboards.array, things.textures.array, strict=True):
        middle = int(row[4] + row[5] // 2)
        hits.append((middle, _to_billboard(origin, direction, board)))
    return hits


def _to_box(origin: Array, direction: Array, box: Array) -> Array:
    """Returns the ray parameters (n,) at a box, inf for rays that do not meet it."""
    center, half, (cosine, sine) = box[:3], box[3:6], box[6:]
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    o, d = turn @ (origin - center), direction @ turn.T
    one, other = (-half - o) / d, (half - o) / d
    enter, leave = (
        np.nanmax(np.minimum(one, other), axis=1),
        np.nanmin(np.maximum(one, other), axis=1),
    )
    return np.where(enter < leave, np.where(enter > 0, enter, leave), np.inf)


def _to_billboard(origin: Array, direction: Array, board: Array) -> Array:
    """Returns the ray parameters (n,) at a billboard, inf for rays that do not meet it."""
    place, (half_width, half_height, cosine, sine) = board[:3], board[3:]
    normal, across = np.array([cosine, sine, 0.0]), np.array([-sine, cosine, 0.0])
    hit = normal @ (place - origin) / (direction @ normal)
    offset = origin + hit[:, None] * direction - place
    inside = (np.abs(offset @ across) < half_width) & (np.abs(offset[:, 2]) < half_height)
    return np.where(inside, hit, np.inf)
