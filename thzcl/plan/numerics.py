"""The accuracy of a variant: as good as the arithmetic allows, or as a tolerance asks.

A tolerance ([numerics] tolerance) is an error relative to the image's largest contrast, as a root
mean square over its pixels. It is divided among arithmetic, absorption polynomial, cut-off, sums
over a band, and interpolated rays. Each of them takes the cheapest setting whose error is within
its share. Settings that the user has fixed are not changed.
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

# Smaller than the errors that the arithmetic adds up along a path.
EXPANSION_TOLERANCE = {"float32": 1e-7, "float64": 1e-13}
NEGLIGIBLE = 1e-7  # of the air's radiance: what lies behind the cut-off depth could add this
SMALLEST_CUTOFF = 16.0
EXPANSION, CUTOFF, BAND, STRIDE = 0.2, 0.1, 0.2, 0.5  # shares of a tolerance, added as squares
ROUNDING = 2e-7  # float32: relative error of a depth and of its exponential, with room to spare
STRIDES = (16, 8, 4, 2)
LOOSEST_FIT, TIGHTEST_FIT = 1e-2, 1e-13


class Accuracy(NamedTuple):
    """The numerical settings of one variant.

    `fixed` holds those of the names "cutoff" and "stride" whose values the user has fixed.
    """

    precision: str
    expansion: float  # tolerance of the absorption polynomial, relative to the mean air's
    cutoff: float  # optical depth along the camera's ray at which it ends
    stride: int  # every `stride`-th ray of a row and of a column is traced
    fixed: frozenset[str]


@dataclass(frozen=True)
class AirAlong:
    """The air that rays cross.

    `absorption` is that of the mean air and `slope` its derivative with delta, both (frequency,) in
    1/m. `turbulence` is None if the cube is not drawn at random. `turn` (3, 3) is the rotation from
    the world to the cube.
    """

    absorption: Array
    slope: Array
    turbulence: Turbulence | None
    turn: Array


def air_along(air: Air, spectrum: Spectrum, turbulence: Turbulence | None, turn: Array) -> AirAlong:
    """Returns the air that rays cross, at the frequencies of a spectrum."""
    step = 1e-3
    absorption, moister = air.absorption(spectrum.nodes_hz.array[:, None], [0.0, step]).T
    return AirAlong(absorption, (moister - absorption) / step, turbulence, turn)


@dataclass(frozen=True)
class Foreseen:
    """A forecast of an image, made from a sample of its rays through mean air.

    `pixel_rad` is the angle between neighbouring rays, and `targets` (surface,) holds the flag of
    the target that each surface belongs to.
    """

    sources: Sources
    spectrum: Spectrum
    rays: SampledRays
    air: AirAlong
    raster: Raster
    pixel_rad: float
    targets: NDArray[np.int32]

    def _brightest(self) -> Array:
        """Returns the most that each surface sends, in absolute value, (surface, frequency)."""
        return self.sources.brightest(self.spectrum.nodes_hz.array)

    def _depth(self) -> Array:
        """Returns the optical depth of all ways of a ray together, (ray, frequency)."""
        return np.asarray(self.sources.ways * self.rays.length[:, None] * self.air.absorption)

    def _camera_contrast(self) -> Array:
        """Returns the absolute contrast that reaches the camera, (ray, frequency)."""
        rays, nodes = self.rays, self.spectrum.nodes_hz.array
        sent = self.sources.brightest_along(nodes, rays.surface, rays.direction[:, 2])
        return np.asarray(sent * np.exp(-self._depth()))

    def contrast(self) -> Array:
        """Returns the largest contrast in the image, (plane,), or 1 if there is none."""
        largest = self.spectrum.sum_by_ray(self._camera_contrast()).max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def gain(self) -> float:
        """Returns the factor from a relative error of all depths to that of the contrast."""
        changed = self.spectrum.sum_by_ray(self._camera_contrast() * self._depth()).max(axis=0)
        return float((changed / self.contrast()).max())

    def default_cutoff(self) -> float:
        """Returns the depth at which what lies behind could add 1e-7 of the air's radiance."""
        background = self.sources.background(self.spectrum.nodes_hz.array)
        brightest = float(np.max(self._brightest() / background))
        return max(SMALLEST_CUTOFF, math.log(brightest / NEGLIGIBLE) if brightest > 0 else 0.0)

    def cutoff(self, share: float) -> float:
        """Returns the depth at which what lies behind could add `share` of the contrast.

        It is the depth of one way, at the frequency that the air absorbs least.
        """
        brightest = self._brightest().max(axis=0)
        if not brightest.any():
            return SMALLEST_CUTOFF
        ratio = self.spectrum.planes(brightest) / (share * self.contrast())
        return max(1.0, self.spectrum.faintest_depth(ratio, self.air.absorption) / self._ways)

    @property
    def _ways(self) -> int:
        """Returns how often light passes the air of a ray: 2 if it goes out and back."""
        return self.sources.ways

    def stride_error(self, stride: int) -> float:
        """Returns the error of interpolating between every `stride`-th ray, over the contrast.

        It is infinite if the cube is not drawn at random, since the error is not known then.
        """
        if self.air.turbulence is None:
            return math.inf
        metres = _moment_error(self.air.turbulence, self, stride)
        lost = self._ways * np.abs(self.air.slope) * metres[:, None] * self._camera_contrast()
        rms = np.sqrt((self.spectrum.sum_by_ray(lost) ** 2).mean(axis=0))
        return float((rms / self.contrast()).max())

    def drift_error_k(self, drift_m: float) -> float:
        """Returns the error of taking rays after the air has drifted by `drift_m`.

        It is in kelvins, or for echoes in parts of the power. Over a length L, the integrals of
        delta along two paths a distance r apart in turbulence of structure constant C^2 differ by a
        variance of 2.914 C^2 L r^(5/3) (Tatarskii 1971, for the phase of a plane wave). This is an
        upper bound, since a cube has no structure finer than its voxels.
        """
        turbulence = self.air.turbulence
        if turbulence is None:
            return 0.0
        constant = turbulence.sigma**2 / turbulence.unit_variance
        metres = np.sqrt(2.914 * constant * self.rays.length) * drift_m ** (5 / 6)
        lost = self._ways * np.abs(self.air.slope) * metres[:, None] * self._camera_contrast()
        unit = self.spectrum.planes(self.sources.per_unit(self.spectrum.nodes_hz.array))
        rms = np.sqrt((self.spectrum.sum_by_ray(lost) ** 2).mean(axis=0))
        return float((rms / unit).max())

    def share_traced(self, stride: int) -> float:
        """Returns about the part of the rays that is traced with a stride.

        These are the rays of a lattice, and all rays in those cells of the lattice that the edge of
        a target crosses.
        """
        if stride == 1:
            return 1.0
        size = self.raster.rows, self.raster.columns
        lattice = math.prod((n - 1) // stride + 2 for n in size) / self.raster.rays
        target = self.targets[self.rays.surface].reshape(self.rays.rows, -1)
        spacing = [max(n / sampled, 1) for n, sampled in zip(size, target.shape, strict=True)]
        edges = sum(
            float(np.mean(np.diff(target, axis=axis) != 0)) / spacing[axis]
            for axis in (0, 1)
            if target.shape[axis] > 1
        )
        return float(min(1.0, lattice + edges * 2 * stride))


def settle(given: Numerics, needs: Needs, image: Foreseen) -> Accuracy:
    """Returns the numerical settings of a variant: given ones as they are, others chosen."""
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


# Fitted to errors measured over views of 30 to 150 m at 0.05 to 0.4 mrad a pixel, in voxels of 0.1
# to 1.5 m. If the error is small, the model below agrees with them within a factor of 1.5.
KINKS, APART, BEYOND = 0.008, 0.2, 0.05


def _moment_error(turbulence: Turbulence, image: Foreseen, stride: int) -> Array:
    """Returns the error of the first path moment, (ray,) in m, interpolated over `stride` rays.

    From one ray to the next, the moment is a chain of straight lines, with a kink where the ray
    passes an edge of a voxel. Where a ray has the component n along an axis of the cube, the lines
    are 1/n as steep. Kinks at the far end of the ray, where the surface slants, are counted
    likewise. The error of a straight line between two lattice points is that of the kinks between
    them: the square root of their number, times their step, times the spacing. The paths of rays
    farther apart than a voxel are unlike, and their difference grows as Kolmogorov's r^(2/3).
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
