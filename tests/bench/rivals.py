"""What a user would write instead of thzcl.

That is: a march by fixed steps in NumPy, the voxel loop in Numba, and a field by NumPy and SciPy.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

STEP = 0.5  # voxels, of the fixed-step march
PART = 16  # NumPy marches one in so many rows, and its time is multiplied: all would take minutes


def numpy_march(setting) -> Callable[[], np.ndarray]:
    """Returns a function that marches every PART-th row of rays, all abreast, by fixed steps.

    It returns optical depth (ray,), NaN for rays of other rows.
    """
    raster, grid = setting.raster, setting.cube.grid
    rays = np.arange(setting.rays).reshape(raster.rows, raster.columns)[::PART].ravel()
    direction = setting.directions(rays)
    voxels = np.linalg.norm(direction, axis=1)
    length = setting.ends.reach.host()[rays] * voxels
    step = (direction / voxels[:, None] * STEP).T.astype(np.float32)
    start = setting.medium.frame[0].astype(np.float32)[:, None]
    absorption = (setting.absorption * setting.cube.voxel_m).astype(np.float32).ravel()

    def march() -> np.ndarray:
        depth = np.full(setting.rays, np.nan)
        sums = np.zeros(len(rays))
        for number in range(int(np.ceil(length.max() / STEP))):
            x, y, z = np.floor(start + np.float32(number + 0.5) * step).astype(np.int32) & (
                grid - 1
            )
            within = np.clip(length - number * STEP, 0, STEP)
            sums += absorption[(z * grid + y) * grid + x] * within
        depth[rays] = sums
        return depth

    return march


def has_numba() -> bool:
    return find_spec("numba") is not None


def numba_march(
    setting, real: type = np.float64, absorption: np.ndarray | None = None
) -> Callable[[], np.ndarray]:
    """Returns a function that runs the voxel loop of Amanatides and Woo (1987) on all cores.

    It returns optical depth (ray,). Rays are in float32 or float64, the cube in float32 in any
    case, which is quicker and errs by no more.
    """
    raster = setting.raster
    march = _compiled(real)
    per_m = setting.absorption if absorption is None else absorption
    cube = per_m.astype(np.float32).ravel()
    frame = setting.medium.frame.astype(real)
    end = setting.ends.reach.host()[: setting.rays].astype(real)
    stretch = setting.ends.stretch.host()[: setting.rays].astype(real)
    log2n = setting.cube.grid.bit_length() - 1

    def call() -> np.ndarray:
        depth = np.empty(setting.rays, real)
        march(cube, log2n, frame, raster.columns, raster.rows, end, stretch, depth)
        return depth

    return call


def _axis_start(real: type) -> Callable:
    """Where a ray starts along one axis, compiled."""
    from numba import njit

    far = real(1e30)

    @njit
    def start(origin, direction):
        """Returns an axis's voxel, its step, and the parameters to and between crossings."""
        voxel = int(origin)
        if direction == 0:
            return voxel, 0, far, real(0)
        between = abs(real(1) / direction)
        inside = origin - voxel
        return (
            (voxel, 1, (real(1) - inside) * between, between)
            if direction > 0
            else (voxel, -1, inside * between, between)
        )

    return start


_KEPT: dict[type, Callable] = {}


def _compiled(real: type) -> Callable:
    """The loop in one precision, compiled once."""
    if real in _KEPT:
        return _KEPT[real]
    from numba import njit, prange

    start = _axis_start(real)

    @njit(parallel=True, fastmath=True)
    def march(cube, log2n, frame, width, height, end, stretch, depth):
        mask = (1 << log2n) - 1
        for ray in prange(width * height):
            u, v = real(ray % width + 0.5 - 0.5 * width), real(0.5 * height - ray // width - 0.5)
            x, step_x, next_x, size_x = start(
                frame[0, 0], frame[1, 0] + u * frame[2, 0] + v * frame[3, 0]
            )
            y, step_y, next_y, size_y = start(
                frame[0, 1], frame[1, 1] + u * frame[2, 1] + v * frame[3, 1]
            )
            z, step_z, next_z, size_z = start(
                frame[0, 2], frame[1, 2] + u * frame[2, 2] + v * frame[3, 2]
            )
            here, last, tau = real(0), end[ray], real(0)
            while True:
                absorption = cube[(((z & mask) << log2n | y & mask) << log2n) | x & mask]
                if next_x <= next_y and next_x <= next_z:
                    if next_x >= last:
                        break
                    tau += absorption * (next_x - here)
                    here = next_x
                    x += step_x
                    next_x += size_x
                elif next_y <= next_z:
                    if next_y >= last:
                        break
                    tau += absorption * (next_y - here)
                    here = next_y
                    y += step_y
                    next_y += size_y
                else:
                    if next_z >= last:
                        break
                    tau += absorption * (next_z - here)
                    here = next_z
                    z += step_z
                    next_z += size_z
            tau += absorption * (last - here)
            depth[ray] = tau * stretch[ray]

    _KEPT[real] = march
    return march


def field_parts(grid: int, seed: int) -> Callable[[], np.ndarray]:
    """Returns a function that does the two costly parts of a field, in float32.

    They are Philox normals by NumPy, and SciPy's real inverse transform on all cores.
    """
    import scipy.fft

    def call() -> np.ndarray:
        generator = np.random.Generator(np.random.Philox(seed))
        normals = generator.standard_normal((grid, grid, grid + 2), dtype=np.float32)
        return scipy.fft.irfftn(
            normals.view(np.complex64), (grid,) * 3, workers=-1, overwrite_x=True
        )

    return call
