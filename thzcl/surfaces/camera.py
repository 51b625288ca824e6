"""The pinhole camera: its rasters of rays, their frame in the world, and their angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.scenario.scene import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Raster:
    """The rays of an image, in `rows` and `columns`; `block` (rows, columns) of them form a pixel.

    On every side of the image there are `margin` more rays, for optics that blur it. They are
    included in `rows` and `columns`.
    """

    rows: int
    columns: int
    block: tuple[int, int]
    margin: int = 0

    @property
    def rays(self) -> int:
        """Returns the number of rays."""
        return self.rows * self.columns

    @property
    def pixels(self) -> tuple[int, int]:
        """Returns the image's height and width in pixels."""
        height, width = self.rows - 2 * self.margin, self.columns - 2 * self.margin
        return height // self.block[0], width // self.block[1]


def raster(camera: Camera) -> Raster:
    """Returns a camera's rays; the samples of a pixel form a block as square as possible."""
    n = camera.samples_per_pixel
    rows = max(k for k in range(1, int(n**0.5) + 1) if n % k == 0)
    width, height = camera.pixels
    return Raster(height * rows, width * (n // rows), (rows, n // rows))


def pixel_angles(camera: Camera) -> tuple[float, float]:
    """Returns the width and the height of a pixel at the image centre, rad."""
    sizes = zip(camera.focal_plane_mm, camera.pixels, strict=True)
    width, height = (size / camera.focal_length_mm / n for size, n in sizes)
    return width, height


def camera_frame(camera: Camera, rays: Raster) -> Array:
    """Returns the frame of a camera in the world, (4, 3), for a raster of rays.

    Its rows are the position in m, the direction of the image centre, and the steps of one column
    to the right and of one row up.
    """
    position, look_at = np.array(camera.position_m), np.array(camera.look_at_m)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, camera.up)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(camera.up):
        right = np.cross(forward, (0.0, 1.0, 0.0))
    if np.linalg.norm(right) < 1e-9:  # up and the line of sight are both along y
        right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    width, height = (size / camera.focal_length_mm for size in camera.focal_plane_mm)
    columns, rows = rays.columns - 2 * rays.margin, rays.rows - 2 * rays.margin
    return np.array([position, forward, right * width / columns, up * height / rows])


def directions(frame: Array, rays: Raster, numbers: NDArray[np.int64]) -> Array:
    """Returns the directions of rays by number, (n, 3).

    Their component along the optical axis is 1. `frame` (4, 3) is that of the camera.
    """
    _, forward, right, up = frame
    rows, columns = np.divmod(numbers, rays.columns)
    u = columns + 0.5 - 0.5 * rays.columns
    v = 0.5 * rays.rows - rows - 0.5
    return np.asarray(forward + u[:, None] * right + v[:, None] * up)


def pixel_frame(camera: Camera) -> tuple[Array, Raster]:
    """Returns the frame and the raster of a camera with one ray through each pixel's middle."""
    width, height = camera.pixels
    middles = Raster(height, width, (1, 1))
    return camera_frame(camera, middles), middles
