"""How accurately what is computed: as well as the arithmetic allows, or as a tolerance asks.

A tolerance ([numerics] tolerance) is an error relative to the image's largest contrast, as a root
mean square over its pixels. It is shared out among arithmetic, absorption polynomial, cut-off, sums
over a band, and rays that are interpolated; each takes the cheapest setting that keeps to its
share. What the user gave stays as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air.mean import Air
from thzcl.scenario.scene import Numerics
from thzcl.sensing.spectrum import Spectrum
from thzcl.sensor import Needs
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.estimate import SampledRays
from thzcl.surfaces.geometry import GROUND
from thzcl.surfaces.radiance import Sources
from thzcl.turbulence.spectra import Turbulence

Array = NDArray[np.float64]

# Below what the arithmetic adds along a path.
EXPANSION_TOLERANCE = {"float32": 1e-7, "float64": 1e-13}
NEGLIGIBLE = 1e-7  # of the air's radiance: what a ray past its cut-off depth could still show
SMALLEST_CUTOFF = 16.0
EXPANSION, CUTOFF, BAND, STRIDE = 0.2, 0.1, 0.2, 0.5  # shares of a tolerance, added as squares
ROUNDING = 2e-7  # float32: relative error of a depth and of its exponential, with room to spare
STRIDES = (16, 8, 4, 2)
LOOSEST_FIT, TIGHTEST_FIT = 1e-2, 1e-13


class Accuracy(NamedTuple):
    """The numerical settings of one variant. `fixed` names those of cutoff and stride given."""

    precision: str
    expansion: float  # bearable error of the absorption polynomial, relative to the mean air's
    cutoff: float  # optical depth, along the camera's ray, at which it ends
    stride: int  # every so many rays are traced, both ways
    fixed: frozenset[str]


@dataclass(frozen=True)
class AirAlong:
    """The air that rays cross.

    `absorption` of the mean air and its `slope` with delta, (frequency,) in 1/m, and what makes it
    uneven: `turbulence`, or None where the cube is not drawn at random. `turn` (3, 3) leads from
    the world to the cube.
    """

    absorption: Array
    slope: Array
    turbulence: Turbulence | None
    turn: Array


def air_along(air: Air, spectrum: Spectrum, turbulence: Turbulence | None, turn: Array) -> AirAlong:
    """Returns what a plan knows of the air that rays cross."""
    frequency_hz, step = spectrum.nodes_hz.array, 1e-3
    absorption = air.absorption(frequency_hz)
    slope = (air.absorption(frequency_hz, step) - absorption) / step
    return AirAlong(absorption, slope, turbulence, turn)


@dataclass(frozen=True)
class Foreseen:
    """What an image will be, by a sample of its rays through mean air.

    `pixel_rad` is the angle from a ray to the next, `targets` (surface,) flags of what each surface
    belongs to.
    """

    sources: Sources
    spectrum: Spectrum
    rays: SampledRays
    air: AirAlong
    raster: Raster
    pixel_rad: float
    targets: NDArray[np.int32]

    def _sent(self) -> Array:
        """Returns what each surface sends, (surface, frequency)."""
        return self.sources.table(self.spectrum.nodes_hz.array)

    def _depth(self) -> Array:
        """Returns the depth of all ways, (ray, frequency)."""
        return np.asarray(self.sources.ways * self.rays.length[:, None] * self.air.absorption)

    def _seen(self) -> Array:
        """Returns contrast to the air, (ray, frequency)."""
        return np.asarray(np.abs(self._sent())[self.rays.surface] * np.exp(-self._depth()))

    def contrast(self) -> Array:
        """Returns the largest contrast in the image, (plane,); 1 where there is none at all."""
        largest = self.spectrum.sum_by_ray(self._seen()).max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def gain(self) -> float:
        """Returns what an error relative to every depth becomes, relative to the contrast."""
        changed = self.spectrum.sum_by_ray(self._seen() * self._depth()).max(axis=0)
        return float((changed / self.contrast()).max())

    def default_cutoff(self) -> float:
        """Returns the depth behind which nothing is worth 1e-7 of the air's radiance."""
        background = self.sources.background(self.spectrum.nodes_hz.array)
        brightest = float(np.max(np.abs(self._sent()) / background))
        return max(SMALLEST_CUTOFF, math.log(brightest / NEGLIGIBLE) if brightest > 0 else 0.0)

    def cutoff(self, share: float) -> float:
        """Returns the depth, in the thinnest frequency, behind which nothing is worth a share.

        The share is one of the contrast.
        """
        brightest = np.abs(self._sent()).max(axis=0)
        if not brightest.any():
            return SMALLEST_CUTOFF
        ratio = self.spectrum.planes(brightest) / (share * self.contrast())
        return max(1.0, self.spectrum.faintest_depth(ratio, self.air.absorption) / self._ways)

    @property
    def _ways(self) -> int:
        return self.sources.ways

    def stride_error(self, stride: int) -> float:
        """Returns what interpolating between every `stride`-th ray costs, over the contrast.

        It is infinite where it is not known.
        """
        if self.air.turbulence is None:
            return math.inf
        metres = _moment_error(self.air.turbulence, self, stride)
        lost = self._ways * np.abs(self.air.slope) * metres[:, None] * self._seen()
        rms = np.sqrt((self.spectrum.sum_by_ray(lost) ** 2).mean(axis=0))
        return float((rms / self.contrast()).max())

    def drift_error_k(self, drift_m: float) -> float:
        """Returns the error in kelvins of taking rays after the air has drifted by `drift_m`.

        Two paths a distance r apart through turbulence of structure constant C^2 differ by a
        variance of 2.914 C^2 L r^(5/3) over a length L (Tatarskii 1971, of a plane wave's phase);
        a cube of voxels has no finer structure than its voxels. Echoes are in parts of the power.
        """
        turbulence = self.air.turbulence
        if turbulence is None:
            return 0.0
        constant = turbulence.sigma**2 / turbulence.unit_variance
        metres = np.sqrt(2.914 * constant * self.rays.length) * drift_m ** (5 / 6)
        lost = self._ways * np.abs(self.air.slope) * metres[:, None] * self._seen()
        unit = self.spectrum.planes(self.sources.per_unit(self.spectrum.nodes_hz.array))
        rms = np.sqrt((self.spectrum.sum_by_ray(lost) ** 2).mean(axis=0))
        return float((rms / unit).max())

    def share_traced(self, stride: int) -> float:
        """Returns about the part of the rays that is traced, where `stride` thins them.

        That is a lattice, and all rays in the cells that edges cross.
        """
        if stride == 1:
            return 1.0
        size = self.raster.rows, self.raster.columns
        lattice = math.prod((n - 1) // stride + 2 for n in size) / self.raster.rays
        things = self.targets[self.rays.surface].reshape(self.rays.rows, -1)
        cells = [max(n / sampled, 1) for n, sampled in zip(size, things.shape, strict=True)]
        edges = sum(
            float(np.mean(np.diff(things, axis=axis) != 0)) / cells[axis]
            for axis in (0, 1)
            if things.shape[axis] > 1
        )
        return float(min(1.0, lattice + edges * 2 * stride))


def settle(given: Numerics, needs: Needs, image: Foreseen) -> Accuracy:
    """Returns the settings of a variant."""
    cutoff = given.cutoff_depth or needs.cutoff_depth
    fixed = {"cutoff": given.cutoff_depth, "stride": given.ray_stride}
    names = frozenset(name for name, value in fixed.items() if value is not None)
    if given.tolerance is None:
        precision = given.precision or "float32"
        depth = float(cutoff or image.default_cutoff())
        tolerance = EXPANSION_TOLERANCE[precision]
        return Accuracy(precision, tolerance, depth, given.ray_stride or 1, names)
    gain, bearable = image.gain(), given.tolerance
    single = ROUNDING * (1 + gain) <= bearable / 2
    precision = given.precision or ("float32" if single else "float64")
    fit = float(np.clip(EXPANSION * bearable / max(gain, 1e-300), TIGHTEST_FIT, LOOSEST_FIT))
    depth = float(cutoff or image.cutoff(CUTOFF * bearable))
    strides = [1, *(s for s in STRIDES if image.stride_error(s) <= STRIDE * bearable)]
    stride = given.ray_stride or min(strides, key=image.share_traced)
    return Accuracy(precision, fit, depth, stride, names)


# Measured over views of 30 to 150 m at 0.05 to 0.4 mrad a pixel, in voxels of 0.1 to 1.5 m: where
# the error is small, the model below is met within a factor of 1.5.
KINKS, APART, BEYOND = 0.008, 0.2, 0.05


def _moment_error(turbulence: Turbulence, image: Foreseen, stride: int) -> Array:
    """Returns the error of the first path moment between rays `stride` apart, in m, by ray.

    Across the rays a moment is a chain of straight lines with kinks where a ray passes a voxel's
    edge, n^-1 as steep along an axis whose planes it crosses at a slant n; at the far end, where
    the surface slants, likewise. Between lattice points the error of a straight line is that of the
    kinks within: the root of their number times step times spacing. Rays farther apart than a voxel
    have the difference of unlike paths, which grows as Kolmogorov's r^(2/3).
    """
    rays, air = image.rays, image.air
    voxel = turbulence.voxel_m
    slant = np.maximum(
        np.abs(rays.direction @ air.turn.T), voxel / np.maximum(rays.length, voxel)[:, None]
    )
    apart = stride * image.pixel_rad * rays.length
    down = np.abs(rays.direction[:, 2])
    beyond = np.where(rays.surface == GROUND, apart / np.maximum(down, 1e-3), apart)
    steps, more = (np.maximum(distance / voxel, 1.0) ** (2 / 3) for distance in (apart, beyond))
    across = np.minimum(
        KINKS * apart**3 * rays.length / voxel**2 * (slant**-2.0).sum(axis=1),
        APART * rays.length * np.maximum(apart, voxel) * steps,
    )
    along = np.minimum(KINKS * beyond**3 / voxel, BEYOND * beyond**2 * more)
    return np.asarray(np.sqrt(turbulence.neighbour_difference() * (across + along)))
