"""How the pixels of one variant sample rays: when the rays are taken, and how densely they lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.graph import Values
from thzcl.plan.numerics import Foreseen
from thzcl.sensing import exposures, optics
from thzcl.sensing.exposures import Blur, Exposure
from thzcl.sensing.spectrum import Spectrum
from thzcl.sensor import Needs
from thzcl.surfaces.geometry import Geometry

Array = NDArray[np.float64]
Point = tuple[float, float, float]

FINER = 22  # lattice points, each way, to half of the finest detail that optics pass
FEWEST_POINTS = 17  # lattice points to a cell
MOST_LATTICE_RAYS = 4_000_000
BEARABLE_DRIFT_K = 0.0075  # error that the fast axis of a scan may add, if no tolerance is given
BEARABLE_DRIFT = 1e-3  # that error for echoes, as a part of the largest


@dataclass(frozen=True)
class Sampling:
    """What the sampling of one variant's pixels depends on.

    `shape` are the rays of the camera and what they can meet, `pixel_rad` is the width and the
    height of a pixel, `parts` what rays are seen in, `foreseen` a forecast of the image, and
    `tolerance` that of [numerics].
    """

    needs: Needs
    shape: Geometry
    pixel_rad: tuple[float, float]
    parts: Spectrum
    foreseen: Foreseen
    tolerance: float | None

    @property
    def _nodes_hz(self) -> Array:
        """Returns the frequencies of the image, (node,) in Hz."""
        return np.asarray(self.foreseen.spectrum.nodes_hz.array)

    @property
    def _blur(self) -> Blur:
        """Returns what blurs the image, at the frequency of each plane."""
        plane_hz = Values.of(self.parts.planes(self._nodes_hz))
        return Blur(self.needs.optics, self.pixel_rad, plane_hz, self._two_way)

    @property
    def _two_way(self) -> bool:
        """Returns whether the beam lights what it receives."""
        return self.needs.illumination == "beam"

    def still(self) -> list[Exposure]:
        """Returns the one exposure of an image whose pixels are all taken at once."""
        return exposures.still(self._blur, self.shape)

    def exposures(self, wind_m_s: Point) -> list[Exposure]:
        """Returns the exposures in which rays cross air that moves with the wind.

        There is one, unless the sensor takes its pixels at times of their own.
        """
        if self.needs.times_s is None or not any(wind_m_s):
            return self.still()
        times = np.asarray(self.needs.times_s, dtype=np.float64)
        groups = self._groups(times, math.hypot(*wind_m_s))
        return exposures.timed(self._blur, self.shape, times, groups)

    def _groups(self, times_s: Array, wind_m_s: float) -> int:
        """Returns the number of parts into which a beam is cut along a scan's fast axis.

        It is the least number for which the drift of the air, while the scan crosses one part, adds
        no more than the bearable error.
        """
        rays = self.shape.raster
        sample = np.broadcast_to(times_s[0], rays.pixels)
        if rays.margin == 0 or np.ptp(sample) == 0:
            return 1
        slow = exposures.slow_axis(sample)
        weights = exposures.profile(self._blur.beam(rays), slow)
        apart = np.abs(np.diff(sample, axis=1 - slow))
        dwell = float(np.median(apart)) if apart.size else 0.0
        drift_m = wind_m_s * dwell / rays.block[1 - slow]  # while the scan crosses one ray
        lost = [
            self.foreseen.drift_error_k(drift_m * n)
            for n in range(min(len(weights), rays.pixels[1 - slow] * rays.block[1 - slow]) + 1)
        ]
        for groups in range(1, len(weights), 2):
            if exposures.fast_axis_error(weights, groups, lost) <= self._bearable_drift():
                return groups
        return len(weights)

    def _bearable_drift(self) -> float:
        """Returns the bearable error of a scan's fast axis, in K or as a part of the power."""
        sources = self.foreseen.sources
        unit = self.foreseen.spectrum.planes(sources.per_unit(self._nodes_hz))
        largest = float((self.foreseen.contrast() / unit).max())
        if self.tolerance is not None:
            return self.tolerance * largest
        return BEARABLE_DRIFT_K if sources.air_emits else BEARABLE_DRIFT * largest

    def lattice(self, turn: int = 0) -> list[Exposure]:
        """Returns the exposures of a lattice that samples surfaces finely where optics blur them.

        A `turn` of 1 gives another lattice, as fine as that of `turn` 0. There are no exposures if
        nothing is blurred, or if there are no surfaces.
        """
        cell, points = self._cell()
        if not points:
            return []
        return exposures.lattice(self._blur, self.shape, cell, points, turn=turn)

    def _cell(self) -> tuple[int, int]:
        """Returns the size of a lattice's cells in rays, each way, and the points in each cell."""
        blurring, rays = self.needs.optics, self.shape.raster
        if blurring is None or not optics.blurs(blurring) or not self.shape.things.kinds:
            return 1, 0
        detail = optics.finest_rad(blurring, self._nodes_hz, two_way=self._two_way) / FINER
        density = math.prod(self.pixel_rad) / math.prod(rays.block) / detail**2  # points for a ray
        density = min(density, MOST_LATTICE_RAYS / rays.rays)
        common = math.gcd(*rays.block)
        cells = [n for n in range(1, common + 1) if common % n == 0]
        cell = next((n for n in cells if density * n**2 >= FEWEST_POINTS), common)
        wanted = density * cell**2
        points = min((n for n in exposures.PRIMES if n >= wanted), default=exposures.PRIMES[-1])
        return cell, points
