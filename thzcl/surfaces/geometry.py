"""Camera, ground, boxes and billboards as flat arrays for the kernels, in float64.

World axes are metres, z up. A ray is its number in the raster of rays, row by row from the image's
top left corner, as the camera sees it; a pixel of several samples is a small block of that raster.
Along a ray the parameter s measures depth along the optical axis in metres: the point at s is
origin + s * direction, and a length is s times the direction's norm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.scenario.scene import Billboard, Box, Camera, Scene
from thzcl.surfaces import texture
from thzcl.surfaces.texture import Texture

Array = NDArray[np.float64]
Integers = NDArray[np.int32]
Locate = Callable[[str], Path]

BACKGROUND, GROUND, FIRST_TARGET = 0, 1, 2  # surfaces, and flags of `target` in the result
FACES = ("-x", "+x", "-y", "+y", "-z", "+z")
LEVELS = 1025  # surfaces that stand for a texture of temperature: Planck is all but straight between two of them


class Surface(NamedTuple):
    """Something that a ray can meet, with one temperature (None.

    Not given) and one reflectivity.
    """

    target: int  # flag of `target` in the result
    temperature_k: float | None
    reflectivity: float


@dataclass(frozen=True)
class Raster:
    """The rays of an image: `rows` x `columns` of them, in blocks of `block` (rows, columns) to a pixel.

    A `margin` of so many rays surrounds the image on every side, for optics that blur it.
    """

    rows: int
    columns: int
    block: tuple[int, int]
    margin: int = 0

    @property
    def rays(self) -> int:
        """Their number."""
        return self.rows * self.columns

    @property
    def pixels(self) -> tuple[int, int]:
        """Image height and width."""
        return (self.rows - 2 * self.margin) // self.block[0], (
            self.columns - 2 * self.margin
        ) // self.block[1]


@dataclass(frozen=True, eq=False)
class Geometry:
    """What the kernels know of the scene: rays, and the surfaces that they can meet.

    `frame` (4, 3) holds the camera's position, the direction of the image centre, and what one
    column to the right and one row up add to it. A row of `boxes` is centre (3), half size (3),
    cosine and sine of the yaw; a row of `stripes` is, for one face of one box in the order of
    FACES, the number of stripes and the surface of the odd ones. A row of `billboards` is centre
    (3), half width and height, cosine and sine of the front's direction; a row of `textures` where
    its `texels` begin, width, height, whether to take the nearest, first surface, number of
    surfaces, and where its mask begins or -1.
    """

    raster: Raster
    frame: Array
    ground: bool
    boxes: Array
    stripes: Integers
    billboards: Array
    textures: Integers
    texels: Array
    max_range_m: float

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Equal for geometries that the same rays can serve: they are equal."""
        arrays = (self.frame, self.boxes, self.stripes, self.billboards, self.textures, self.texels)
        return (self.raster, self.ground, self.max_range_m, *(array.tobytes() for array in arrays))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Geometry) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def raster(camera: Camera) -> Raster:
    """The rays of a camera; n samples per pixel form the most nearly square block of n."""
    n = camera.samples_per_pixel
    rows = max(k for k in range(1, int(n**0.5) + 1) if n % k == 0)
    width, height = camera.pixels
    return Raster(height * rows, width * (n // rows), (rows, n // rows))


def camera_frame(camera: Camera, rays: Raster) -> Array:
    """Position, direction of the centre, and the steps of one column and one row; shape (4, 3)."""
    position, look_at = np.array(camera.position_m), np.array(camera.look_at_m)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, camera.up)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(camera.up):
        right = np.cross(forward, (0.0, 1.0, 0.0))
    if np.linalg.norm(right) < 1e-9:  # up is +y, and so is the line of sight
        right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    width, height = (size / camera.focal_length_mm for size in camera.focal_plane_mm)
    columns, rows = rays.columns - 2 * rays.margin, rays.rows - 2 * rays.margin
    return np.array([position, forward, right * width / columns, up * height / rows])


def geometry(scene: Scene, locate: Locate, rays: Raster) -> tuple[Geometry, list[Surface]]:
    """The flat arrays of a scene, and its surfaces by number: background, ground, boxes, their stripes, billboards.

    `locate` finds the files of pictures. Raises ValueError for those that cannot be used.
    """
    surfaces = [Surface(BACKGROUND, scene.background.temperature_k, 0.0), _ground(scene)]
    numbered = list(enumerate(scene.targets.values(), start=FIRST_TARGET))
    boxes, stripes = _boxes(
        [(flag, target) for flag, target in numbered if isinstance(target, Box)], surfaces
    )
    boards, textures, texels = _billboards(
        [(f, t) for f, t in numbered if isinstance(t, Billboard)], locate, surfaces
    )
    surfaces.append(surfaces[0])  # textures blend with the surface after theirs
    frame, ground = camera_frame(scene.camera, rays), scene.ground is not None
    reach = scene.background.max_range_m
    return Geometry(rays, frame, ground, boxes, stripes, boards, textures, texels, reach), surfaces


def _ground(scene: Scene) -> Surface:
    ground = scene.ground
    return Surface(
        GROUND, ground.temperature_k if ground else None, ground.reflectivity if ground else 0.0
    )


def _boxes(boxes: list[tuple[int, Box]], surfaces: list[Surface]) -> tuple[Array, Integers]:
    """Rows of boxes and of their faces' stripes; adds their surfaces."""
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
    """Rows of billboards and of their textures, and all texels and masks in a line.

    Adds their surfaces.
    """
    rows, textures, texels = [], [], [np.zeros(0)]
    for flag, board in boards:
        picture = texture.read(locate(board.image), board.range)
        height, width = picture.values.shape
        first, masked = sum(map(len, texels)), -1
        texels.append(picture.values.ravel())
        if board.mask is not None:
            masked = first + height * width
            texels.append(texture.read_mask(locate(board.mask), (height, width)).ravel())
        levels = _levels(flag, board, picture)
        textures.append(
            [
                first,
                width,
                height,
                board.interpolation == "nearest",
                len(surfaces),
                len(levels),
                masked,
            ]
        )
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
    """The surfaces that a texture blends between."""
    if board.quantity == "reflectivity":  # in which emission and reflection are straight lines
        return [Surface(flag, board.temperature_k, end) for end in (picture.low, picture.high)]
    return [
        Surface(flag, float(t), board.reflectivity)
        for t in np.linspace(picture.low, picture.high, LEVELS)
    ]


def _turn(degrees: float) -> tuple[float, float]:
    """Cosine and sine; those of quarter turns are exact.

    So that a face along a grid plane stays there.
    """
    angle = np.deg2rad(degrees)
    cosine, sine = (
        0.0 if abs(value) < 1e-15 else float(value) for value in (np.cos(angle), np.sin(angle))
    )
    return cosine, sine


def directions(shape: Geometry, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
    """Directions of the rays at the given rows and columns of the raster, (n, 3).

    1 along the optical axis.
    """
    _, forward, right, up = shape.frame
    u = columns + 0.5 - 0.5 * shape.raster.columns
    v = 0.5 * shape.raster.rows - rows - 0.5
    return np.asarray(forward + u[:, None] * right + v[:, None] * up)


def first_met(shape: Geometry, direction: Array) -> tuple[Array, Integers]:
    """Ray parameter at the nearest surface, or at max_range_m, and that surface's number; rays with the given directions, (n,).

    For estimates: billboards count as whole rectangles of one shade, boxes have no stripes.
    """
    origin = shape.frame[0]
    nearest = shape.max_range_m / np.linalg.norm(direction, axis=1)
    surface = np.full(len(direction), BACKGROUND, dtype=np.int32)
    hits: list[tuple[int, Array]] = []
    with np.errstate(divide="ignore", invalid="ignore"):
        if shape.ground:
            hits.append(
                (GROUND, np.where(direction[:, 2] < 0, -origin[2] / direction[:, 2], np.inf))
            )
        hits += [
            (FIRST_TARGET + number, _to_box(origin, direction, box))
            for number, box in enumerate(shape.boxes)
        ]
        for board, texture_row in zip(shape.billboards, shape.textures, strict=True):
            middle = texture_row[4] + texture_row[5] // 2
            hits.append((int(middle), _to_billboard(origin, direction, board)))
    for number, hit in hits:
        met = (hit > 0) & (hit < nearest)
        nearest, surface = np.where(met, hit, nearest), np.where(met, np.int32(number), surface)
    return nearest, surface


def _to_box(origin: Array, direction: Array, box: Array) -> Array:
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
    place, (half_width, half_height, cosine, sine) = board[:3], board[3:]
    normal, across = np.array([cosine, sine, 0.0]), np.array([-sine, cosine, 0.0])
    hit = normal @ (place - origin) / (direction @ normal)
    offset = origin + hit[:, None] * direction - place
    inside = (np.abs(offset @ across) < half_width) & (np.abs(offset[:, 2]) < half_height)
    return np.where(inside, hit, np.inf)


def _rotation(w: float, x: float, y: float, z: float) -> Array:
    """The rotation of a quaternion."""
    w, x, y, z = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


# From world to cube. The oblique one was searched for: a ray along a world axis or a level diagonal
# that has crossed up to four periods each way still runs a quarter of a period or more beside any
# cell that it has met.
ROTATIONS = {"aligned": np.eye(3), "oblique": _rotation(0.9435, -0.1204, -0.1348, -0.2778)}


def world_frame(frame: Array, start: Array | None = None) -> Array:
    """The kernels' frame (6, 3) in the world: that of the camera, no drift, and where rays start from elsewhere, an offset.

    `start` is where they start, if not at the camera.
    """
    position = frame[0] if start is None else start
    return np.array([position, *frame[1:], np.zeros(3), frame[0] - position])


def cube_frame(frame: Array, orientation: str, voxel_m: float, grid: int, wind_m_s: Array) -> Array:
    """A world frame in voxels of the cube: the start reduced modulo its period.

    Drifting against the wind.
    """
    moving = frame.copy()
    moving[4] = -wind_m_s
    turned = moving @ ROTATIONS[orientation].T / voxel_m
    turned[0] = np.mod(turned[0], grid)
    turned[0][turned[0] == grid] = 0.0  # a tiny negative position rounds up to the period itself
    return np.asarray(turned)
