"""Ground, boxes and billboards as flat arrays for the kernels, in float64.

World axes are metres, z up. A ray is its number in the raster of rays, row by row from the image's
top left corner, as the camera sees it; a pixel of several samples is a small block of that raster.
Along a ray the parameter s measures depth along the optical axis in metres: the point at s is
origin + s * direction, and a length is s times the direction's norm.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.graph import Values, frozen
from thzcl.scenario.scene import Billboard, Box, Scene
from thzcl.surfaces import texture
from thzcl.surfaces.camera import Raster, camera_frame
from thzcl.surfaces.texture import Texture
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
Integers = NDArray[np.int32]
Locate = Callable[[str], Path]

BACKGROUND, GROUND, FIRST_TARGET = 0, 1, 2  # surfaces, and flags of `target` in the result
FACES = ("-x", "+x", "-y", "+y", "-z", "+z")
LEVELS = 1025  # surfaces that stand for a texture of temperature: Planck is all but straight


class Surface(NamedTuple):
    """Something that a ray can meet, with one temperature (None: not given) and reflectivity."""

    target: int  # flag of `target` in the result
    temperature_k: float | None
    reflectivity: float


@frozen
class Things:
    """What rays can meet, as tables for the kernels.

    A row of `boxes` is centre (3), half size (3), cosine and sine of the yaw; a row of `stripes`
    is, for one face of one box in the order of FACES, the number of stripes and the surface of the
    odd ones. A row of `billboards` is centre (3), half width and height, cosine and sine of the
    front's direction; a row of `textures` where its `texels` begin, width, height, whether to take
    the nearest, first surface, number of surfaces, and where its mask begins or -1.
    """

    ground: bool
    boxes: Values  # (box, 8)
    stripes: Values  # (6 box, 2), int32
    billboards: Values  # (billboard, 7)
    textures: Values  # (billboard, 7), int32
    texels: Values  # (texel,)
    max_range_m: float

    @property
    def kinds(self) -> tuple[str, ...]:
        """Returns the kinds of surfaces there are: "ground", "boxes", "billboards"."""
        there = {
            "ground": self.ground,
            "boxes": self.boxes.shape[0] > 0,
            "billboards": self.billboards.shape[0] > 0,
        }
        return tuple(name for name, present in there.items() if present)


@frozen
class Geometry:
    """A raster of rays and the things that they can meet.

    `frame` (4, 3) holds the camera's position, the direction of the image centre, and what one
    column to the right and one row up add to it.
    """

    raster: Raster
    frame: Values
    things: Things


def geometry(scene: Scene, locate: Locate, rays: Raster) -> tuple[Geometry, list[Surface]]:
    """Returns a scene's geometry, and its surfaces by number.

    Surfaces are in order: background, ground, boxes, their stripes, billboards. `locate` finds the
    files of pictures. Raises ValueError for those that cannot be used.
    """
    surfaces = [Surface(BACKGROUND, scene.background.temperature_k, 0.0), _ground(scene)]
    numbered = list(enumerate(scene.targets.values(), start=FIRST_TARGET))
    boxes = [(flag, target) for flag, target in numbered if isinstance(target, Box)]
    boards = [(flag, target) for flag, target in numbered if isinstance(target, Billboard)]
    box_rows, stripes = _boxes(boxes, surfaces)
    board_rows, textures, texels = _billboards(boards, locate, surfaces)
    surfaces.append(surfaces[0])  # textures blend with the surface after theirs
    things = Things(
        scene.ground is not None,
        Values.of(box_rows),
        Values.of(stripes, np.int32),
        Values.of(board_rows),
        Values.of(textures, np.int32),
        Values.of(texels),
        scene.background.max_range_m,
    )
    return Geometry(rays, Values.of(camera_frame(scene.camera, rays)), things), surfaces


def _ground(scene: Scene) -> Surface:
    ground = scene.ground
    return Surface(
        GROUND, ground.temperature_k if ground else None, ground.reflectivity if ground else 0.0
    )


def _boxes(boxes: list[tuple[int, Box]], surfaces: list[Surface]) -> tuple[Array, Integers]:
    """Returns rows of boxes and of their faces' stripes; adds their surfaces."""
    surfaces += [Surface(flag, box.temperature_k, box.reflectivity) for flag, box in boxes]
    stripes = np.zeros((len(boxes) * len(FACES), 2), dtype=np.int32)
    rows = []
    for number, (flag, box) in enumerate(boxes):
        rows.append([*box.center_m, *(size / 2 for size in box.size_m), *_turn(box.yaw_deg)])
        for bars in box.bars:
            stripes[number * len(FACES) + FACES.index(bars.face)] = bars.count, len(surfaces)
            surfaces.append(Surface(flag, bars.temperature_k, box.reflectivity))
    return np.array(rows).reshape(-1, 8), stripes


def _billboards(
    boards: list[tuple[int, Billboard]], locate: Locate, surfaces: list[Surface]
) -> tuple[Array, Integers, Array]:
    """Returns rows of billboards and of their textures, and all texels and masks in a line.

    Adds their surfaces to `surfaces`.
    """
    rows, textures, texels = [], [], [np.zeros(0)]
    for flag, board in boards:
        picture = texture.read(locate(board.image), board.range, board.quantity)
        height, width = picture.values.shape
        first, masked = sum(map(len, texels)), -1
        texels.append(picture.values.ravel())
        if board.mask is not None:
            masked = first + height * width
            texels.append(texture.read_mask(locate(board.mask), (height, width)).ravel())
        levels = _levels(flag, board, picture)
        nearest = board.interpolation == "nearest"
        textures.append([first, width, height, nearest, len(surfaces), len(levels), masked])
        surfaces += levels
        rows.append(
            [*board.center_m, *(size / 2 for size in board.size_m), *_turn(board.facing_deg)]
        )
    return (
        np.array(rows).reshape(-1, 7),
        np.array(textures, dtype=np.int32).reshape(-1, 7),
        np.concatenate(texels),
    )


def _levels(flag: int, board: Billboard, picture: Texture) -> list[Surface]:
    """Returns the surfaces that a texture blends between."""
    if board.quantity == "reflectivity":  # in which emission and reflection are straight lines
        return [Surface(flag, board.temperature_k, end) for end in (picture.low, picture.high)]
    return [
        Surface(flag, float(t), board.reflectivity)
        for t in np.linspace(picture.low, picture.high, LEVELS)
    ]


def _turn(degrees: float) -> tuple[float, float]:
    """Returns cosine and sine, exact for quarter turns: a face along a grid plane stays there."""
    angle = np.deg2rad(degrees)
    cosine, sine = (
        0.0 if abs(value) < 1e-15 else float(value) for value in (np.cos(angle), np.sin(angle))
    )
    return cosine, sine


def world_frame(frame: Array, start: Array | None = None) -> Array:
    """Returns the kernels' frame in the world, (6, 3).

    Its rows are where rays start, the direction of the image centre, the steps of a column and of
    a row, the drift in a second (none), and the offset from the start to the camera. `frame` is the
    camera's (4, 3); rays start at `start` (3,) if they do not start at the camera.
    """
    position = frame[0] if start is None else start
    return np.array([position, *frame[1:], np.zeros(3), frame[0] - position])


def cube_frame(frame: Array, orientation: str, voxel_m: float, grid: int, wind_m_s: Array) -> Array:
    """Returns a world frame in voxels of the cube, (6, 3), drifting against the wind.

    The start is reduced modulo the cube's period.
    """
    moving = frame.copy()
    moving[4] = -wind_m_s
    turned = moving @ ROTATIONS[orientation].T / voxel_m
    turned[0] = np.mod(turned[0], grid)
    turned[0][turned[0] == grid] = 0.0  # a tiny negative position rounds up to the period itself
    return np.asarray(turned)
