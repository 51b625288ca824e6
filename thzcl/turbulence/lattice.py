"""How the voxels of a cube lie in the world: their number and edges, and where the cube ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
_Filled = tuple[int | None, int | None, int | None]


@dataclass(frozen=True)
class Lattice:
    """The voxels of a cube, in numbers and in metres along its own axes x, y and z.

    `shape` are the voxels in memory, a power of two along each axis, and `voxel_m` their edges.
    `corner_m` is the place of the first voxel's corner. Along an axis that is not periodic the cube
    ends after `filled` voxels; along others `filled` is None.
    """

    shape: tuple[int, int, int]
    voxel_m: tuple[float, float, float]
    corner_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    filled: _Filled = (None, None, None)

    @classmethod
    def cubic(cls, grid: int, voxel_m: float) -> Lattice:
        """Returns a periodic cube with `grid` voxels along each edge, from the origin."""
        return cls((grid,) * 3, (voxel_m,) * 3)

    @property
    def voxels(self) -> int:
        """Returns the number of voxels in memory."""
        return math.prod(self.shape)

    @property
    def bounded(self) -> bool:
        """Returns whether the cube ends along any axis."""
        return any(count is not None for count in self.filled)

    @property
    def held(self) -> tuple[slice, slice, slice]:
        """Returns the part of the arrays (z, y, x) in memory that is the cube and no padding."""
        x, y, z = (slice(count) for count in self.filled)
        return z, y, x

    @property
    def shortest_m(self) -> float:
        """Returns the shortest edge of a voxel, m."""
        return min(self.voxel_m)

    @property
    def diagonal_m(self) -> float:
        """Returns the longest way through a voxel, m."""
        return math.sqrt(sum(edge**2 for edge in self.voxel_m))

    @property
    def period_m(self) -> float:
        """Returns the shortest period, m, which is infinite for a cube that ends on all sides."""
        each = zip(self.shape, self.voxel_m, self.filled, strict=True)
        return min((n * edge for n, edge, count in each if count is None), default=math.inf)

    def turned(self, vectors: Array, orientation: str) -> Array:
        """Returns vectors (..., 3) in the world, in m, along the cube's axes in voxels."""
        return np.asarray(vectors @ ROTATIONS[orientation].T / np.array(self.voxel_m))

    def placed(self, points: Array) -> Array:
        """Returns points (..., 3), in voxels from the origin, in voxels from the cube's corner.

        Along periodic axes they are reduced to the first period.
        """
        found = points - np.array(self.corner_m) / np.array(self.voxel_m)
        reduced = np.mod(found, self.shape)
        # What is slightly negative is rounded up to the period itself.
        reduced = np.where(reduced == np.array(self.shape), 0.0, reduced)
        return np.where([count is None for count in self.filled], reduced, found)

    def crossed(self, start: Array, step: Array, end: Array) -> tuple[Array, Array]:
        """Returns where rays enter the cube and where they leave it, both (ray,).

        A ray goes from `start` by `step` for each unit of its parameter, both (ray, 3) in voxels,
        up to the parameter `end` (ray,). The two are equal for a ray that misses the cube, and 0
        and `end` for a cube without an end.
        """
        enter, leave = np.zeros(len(step)), np.array(end, dtype=np.float64)
        for axis, count in enumerate(self.filled):
            if count is None:
                continue
            o, d = np.broadcast_to(start[..., axis], leave.shape), step[:, axis]
            with np.errstate(divide="ignore", invalid="ignore"):
                near, far = np.sort(np.stack([-o / d, (count - o) / d]), axis=0)
            within = np.where((o >= 0) & (o < count), 0.0, np.inf)
            enter = np.maximum(enter, np.where(d == 0, within, near))
            leave = np.minimum(leave, np.where(d == 0, np.inf, far))
        enter = np.minimum(enter, end)
        return enter, np.maximum(leave, enter)
