"""Camera, ground and boxes as flat arrays for the kernels, in float64.

World axes are metres, z up. A ray is its number in the raster of rays, row by row from the image's top left corner, as the
camera sees it; a pixel of several samples is a small block of that raster. Along a ray the parameter s measures depth along
the optical axis in metres: the point at s is origin + s * direction, and a length is s times the direction's norm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.scenario.scene import Bars, Box, Camera, Scene

Array = NDArray[np.float64]

BACKGROUND, GROUND, FIRST_TARGET = 0, 1, 2  # surfaces, and flags of `target` in the result
FACES = ("-x", "+x", "-y", "+y", "-z", "+z")


class Surface(NamedTuple):
    """Something that a ray can meet, with one temperature (None: not given) and one reflectivity."""

    target: int  # flag of `target` in the result
    temperature_k: float | None
    reflectivity: float


@dataclass(frozen=True)
class Raster:
    """The rays of an image: `rows` x `columns` of them, in blocks of `block` (rows, columns) to a pixel."""

    rows: int
    columns: int
    block: tuple[int, int]

    @property
    def rays(self) -> int:
        """Their number."""
        return self.rows * self.columns

    @property
    def pixels(self) -> tuple[int, int]:
        """Image height and width."""
        return self.rows // self.block[0], self.columns // self.block[1]


@dataclass(frozen=True)
class Geometry:
    """What the kernels know of the scene: rays, and the surfaces that they can meet.

    `frame` (4, 3) holds the camera's position, the direction of the image centre, and what one column to the right and one
    row up add to it. Each row of `boxes` is centre (3), half size (3), cosine and sine of the yaw; each row of `stripes`
    is, for one face of one box in the order of FACES, the number of stripes and the surface of the odd ones.
    """

    raster: Raster
    frame: Array
    ground: bool
    boxes: Array
    stripes: NDArray[np.int32]
    max_range_m: float

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for geometries that the same rays can serve."""
        arrays = (self.frame, self.boxes, self.stripes)
        return (self.raster, self.ground, self.max_range_m, *(array.tobytes() for array in arrays))


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
    return np.array([position, forward, right * width / rays.columns, up * height / rays.rows])


def geometry(scene: Scene) -> tuple[Geometry, list[Surface]]:
    """The flat arrays of a scene, and its surfaces by number: background, ground, targets, then their stripes."""
    rays = raster(scene.camera)
    ground, background = scene.ground, scene.background
    surfaces = [Surface(BACKGROUND, background.temperature_k, 0.0)]
    surfaces.append(Surface(GROUND, ground.temperature_k if ground else None, ground.reflectivity if ground else 0.0))
    boxes = list(scene.targets.values())
    surfaces += [Surface(FIRST_TARGET + n, box.temperature_k, box.reflectivity) for n, box in enumerate(boxes)]
    stripes = np.zeros((len(boxes) * len(FACES), 2), dtype=np.int32)
    for n, box in enumerate(boxes):
        for bars in box.bars:
            stripes[n * len(FACES) + FACES.index(bars.face)] = bars.count, len(surfaces)
            surfaces.append(_striped(FIRST_TARGET + n, box, bars))
    rows = np.array([_box_row(box) for box in boxes]).reshape(-1, 8)
    frame = camera_frame(scene.camera, rays)
    return Geometry(rays, frame, ground is not None, rows, stripes, background.max_range_m), surfaces


def _striped(target: int, box: Box, bars: Bars) -> Surface:
    return Surface(target, bars.temperature_k, box.reflectivity)


def _box_row(box: Box) -> list[float]:
    yaw = np.deg2rad(box.yaw_deg)
    # Quarter turns are exact, so that a face along a grid plane stays there.
    cosine, sine = (0.0 if abs(v) < 1e-15 else float(v) for v in (np.cos(yaw), np.sin(yaw)))
    return [*box.center_m, *(size / 2 for size in box.size_m), cosine, sine]


def directions(shape: Geometry, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
    """Directions of the rays at the given rows and columns of the raster, (n, 3); 1 along the optical axis."""
    _, forward, right, up = shape.frame
    u = columns + 0.5 - 0.5 * shape.raster.columns
    v = 0.5 * shape.raster.rows - rows - 0.5
    return np.asarray(forward + u[:, None] * right + v[:, None] * up)


def reach(shape: Geometry, direction: Array) -> Array:
    """Ray parameter at the nearest surface, or at max_range_m, of rays with the given directions, (n,)."""
    origin = shape.frame[0]
    nearest = shape.max_range_m / np.linalg.norm(direction, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        if shape.ground:
            to_ground = -origin[2] / direction[:, 2]
            nearest = np.where((to_ground > 0) & (to_ground < nearest), to_ground, nearest)
        for box in shape.boxes:
            center, half, (cosine, sine) = box[:3], box[3:6], box[6:]
            turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
            o, d = turn @ (origin - center), direction @ turn.T
            one, other = (-half - o) / d, (half - o) / d
            enter, leave = np.nanmax(np.minimum(one, other), axis=1), np.nanmin(np.maximum(one, other), axis=1)
            hit = np.where(enter > 0, enter, leave)
            nearest = np.where((enter < leave) & (hit > 0) & (hit < nearest), hit, nearest)
    return np.asarray(nearest)


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


# From world to cube. The oblique one was searched for: a ray along a world axis or a level diagonal that has crossed up to
# four periods each way still runs a quarter of a period or more beside any cell that it has met.
ROTATIONS = {"aligned": np.eye(3), "oblique": _rotation(0.9435, -0.1204, -0.1348, -0.2778)}


def cube_frame(frame: Array, rotation: Array, voxel_m: float, grid: int) -> Array:
    """A camera frame in voxels of the cube, the position reduced modulo its period."""
    turned = frame @ rotation.T / voxel_m
    turned[0] = np.mod(turned[0], grid)
    turned[0][turned[0] == grid] = 0.0  # a tiny negative position rounds up to the period itself
    return np.asarray(turned)
