"""What eddies larger than the cube add to the moments of rays.

The mean of delta along a ray is exact. Higher moments take the large eddies as even along the ray:
with their mean l, the integral of (delta + l)^k is the sum of C(k, j) l^(k - j) M_j.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import Device
from thzcl.paths.trace import Motion, Paths
from thzcl.surfaces.ends import RayEnds
from thzcl.turbulence.large_scales import Waves
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
DRIEST = -1.0  # delta of air without vapour


@dataclass(frozen=True)
class RayMeans:
    """Rays through large eddies: starts and unit directions (ray, 3) along the cube's axes, in m.

    `length` (ray,) is in m, `mean` (ray,) what the eddies add to delta in the mean of each ray.
    """

    waves: Waves
    start: Array
    direction: Array
    length: Array
    mean: Array

    @classmethod
    def of(cls, waves: Waves, ends: RayEnds, motion: Motion) -> RayMeans:
        """Returns the rays that end at `ends`, with their means."""
        turn = ROTATIONS[motion.orientation].T
        direction, origin = ends.ways()
        starts = np.broadcast_to(origin, direction.shape)
        if motion.times_s is not None:
            times = np.zeros(ends.rays)
            times[: ends.geometry.raster.rays] = motion.times_s.array.ravel()
            starts = starts - times[:, None] * np.array(motion.wind_m_s)
        norm = np.linalg.norm(direction, axis=1)[:, None]
        unit = np.divide(direction, norm, out=np.zeros_like(direction), where=norm > 0) @ turn
        length = ends.path_length.host().astype(np.float64)
        mean = np.maximum(waves.mean(starts @ turn, length[:, None] * unit), DRIEST)
        return cls(waves, starts @ turn, unit, length, mean)

    @property
    def lowest(self) -> float:
        """Returns the smallest mean of a ray, at most 0."""
        return min(float(self.mean.min()), 0.0)

    def added(self, device: Device, paths: Paths) -> Paths:
        """Returns paths with what the large eddies add to their moments."""
        length = paths.path_length.host().astype(np.float64)
        mean, cut = self.mean, length < self.length
        if cut.any():  # the cut-off has ended rays
            mean = mean.copy()
            way = length[cut, None] * self.direction[cut]
            mean[cut] = np.maximum(self.waves.mean(self.start[cut], way), DRIEST)
        own = np.concatenate([length[None], paths.moments.host().astype(np.float64)])
        sums = np.array(
            [
                sum(math.comb(k, j) * mean ** (k - j) * own[j] for j in range(k + 1))
                for k in range(1, len(own))
            ]
        )
        return replace(paths, moments=device.put(sums, str(paths.moments.dtype)))
