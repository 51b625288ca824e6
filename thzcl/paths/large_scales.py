"""What eddies larger than the cube add to the moments of rays.

The mean of delta along a ray is exact. Higher moments take the large eddies as even along the ray:
with their mean l, the integral of (delta + l)^k is the sum of C(k, j) l^(k - j) M_j.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Buffer, Device
from thzcl.paths.trace import Motion, Paths
from thzcl.surfaces.ends import RayEnds
from thzcl.turbulence.large_scales import Waves
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
DRIEST = -1.0  # delta of air without vapour


@dataclass(frozen=True)
class LargeScaleKernels(Kernels):
    """The kernel that takes the means of plane waves along rays."""

    files: ClassVar = ("paths/large_scales",)

    motion: bool


@dataclass(frozen=True)
class RayMeans:
    """Rays through large eddies: unit directions (ray, 3) along the cube's axes, lengths in m.

    `waves` (wave, 6) are the kernel's, `time` (ray,) on the device is when each ray is taken, or
    None, and `mean` (ray,) what the eddies add to delta in the mean of each ray.
    """

    waves: Array
    taken_off: float
    direction: Array
    length: Array
    time: Buffer | None
    precision: str
    mean: Array

    @classmethod
    def of(cls, device: Device, waves: Waves, ends: RayEnds, motion: Motion) -> RayMeans:
        """Returns the rays that end at `ends`, with their means."""
        turn = ROTATIONS[motion.orientation].T
        direction, origin = ends.ways()
        phase = np.mod(waves.vector @ (origin @ turn) + waves.phase, 1.0)
        drift = waves.vector @ (np.array(motion.wind_m_s) @ turn)
        table = np.column_stack([waves.vector, phase, waves.size, drift])
        precision, time = str(ends.stretch.dtype), None
        if motion.times_s is not None:
            times = np.zeros(ends.rays)
            times[: ends.geometry.raster.rays] = motion.times_s.array.ravel()
            time = device.put(times, precision)
        norm = np.linalg.norm(direction, axis=1)[:, None]
        unit = np.divide(direction, norm, out=np.zeros_like(direction), where=norm > 0) @ turn
        length = ends.path_length.host().astype(np.float64)
        rays = cls(table, waves.taken_off, unit, length, time, precision, length)
        return replace(rays, mean=rays.means(device, length))

    def means(self, device: Device, length: Array) -> Array:
        """Returns the means over the first `length` (ray,) in m of each ray, (ray,)."""
        program = device.build(LargeScaleKernels(self.time is not None), self.precision)
        mean = device.empty(length.shape, self.precision)
        program.run(
            "means",
            len(length) // program.lanes,
            len(self.waves),
            waves=device.put(self.waves, self.precision),
            count=len(self.waves),
            way=device.put((length[:, None] * self.direction).T, self.precision),
            time=mean if self.time is None else self.time,
            mean=mean,
        )
        return np.maximum(mean.host().astype(np.float64) - self.taken_off, DRIEST)

    @property
    def lowest(self) -> float:
        """Returns the smallest mean of a ray, at most 0."""
        return min(float(self.mean.min()), 0.0)

    def added(self, device: Device, paths: Paths) -> Paths:
        """Returns paths with what the large eddies add to their moments."""
        length = paths.path_length.host().astype(np.float64)
        mean, cut = self.mean, length < self.length
        if cut.any():  # the cut-off has ended rays
            mean = self.means(device, length)
        sums = np.concatenate([length[None], paths.moments.host().astype(np.float64)])
        for lowest in range(1, len(sums)):  # row by row of Pascal's triangle
            for power in range(len(sums) - 1, lowest - 1, -1):
                sums[power] += mean * sums[power - 1]
        return replace(paths, moments=device.put(sums[1:], str(paths.moments.dtype)))
