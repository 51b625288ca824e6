"""How accurately what is computed: by default as well as the arithmetic allows, or just as well as [numerics] tolerance asks.

A tolerance is an error relative to the image's largest contrast, as a root mean square over its pixels. It is shared out
among arithmetic, absorption polynomial, cut-off, sums over a band, and rays that are interpolated; each takes the cheapest
setting that keeps to its share. What the user gave stays as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.scenario import Scene
from thzcl.sensor import Needs
from thzcl.surfaces.geometry import GROUND, Raster, Surface
from thzcl.turbulence.spectra import Turbulence

Array = NDArray[np.float64]

SURROGATE_TOLERANCE = {
    "float32": 1e-7,
    "float64": 1e-13,
}  # below what the arithmetic adds along a path
NEGLIGIBLE = 1e-7  # of the air's radiance: what a ray past its cut-off depth could still show
SMALLEST_CUTOFF = 16.0
SURROGATE, CUTOFF, BAND, STRIDE = (
    0.2,
    0.1,
    0.2,
    0.5,
)  # shares of a tolerance; they add up as squares
ROUNDING = 2e-7  # float32: relative error of a depth and of its exponential, with room to spare
STRIDES = (16, 8, 4, 2)
SAMPLED = 64  # rows and columns of the raster, of whose rays an image is judged
LOOSEST_FIT, TIGHTEST_FIT = 1e-2, 1e-13


class Accuracy(NamedTuple):
    """Settings of one variant."""

    precision: str
    surrogate: (
        float  # bearable error of the absorption polynomial, relative to the mean air's absorption
    )
    cutoff: float  # optical depth, along the camera's ray, at which it ends
    stride: int  # every so many rays are traced, both ways


@dataclass(frozen=True)
class Rays:
    """A sample of an image's rays: unit directions (n, 3), lengths (n,) in m.

    And the surfaces (n,) that they meet.
    """

    direction: Array
    length: Array
    surface: NDArray[np.int32]


def sources(scene: Scene, needs: Needs, surfaces: list[Surface], frequency_hz: Array) -> Array:
    """What each surface sends to the camera, (surface, frequency).

    Radiance above the mean air's, that of air where no temperature is given; or, for a sensor of
    echoes, its reflectivity.
    """
    reflectivity = np.array([s.reflectivity for s in surfaces])
    if needs.reflection:
        return np.broadcast_to(reflectivity[:, None], (len(surfaces), len(frequency_hz)))
    air_k = scene.atmosphere.temperature_k
    kelvin = np.array([air_k if s.temperature_k is None else s.temperature_k for s in surfaces])
    return radiometry.surface_contrast(
        frequency_hz, kelvin, reflectivity, air_k, scene.background.environment
    )


def settle(
    scene: Scene,
    needs: Needs,
    surfaces: list[Surface],
    frequency_hz: Array,
    weights: Array | None,
    rays: Rays,
    air: AirAlong,
) -> Accuracy:
    """The settings for a variant."""
    given = scene.numerics
    sent = sources(scene, needs, surfaces, frequency_hz)
    if given.tolerance is None:
        precision = given.precision or "float32"
        cutoff = (
            given.cutoff_depth
            or needs.cutoff_depth
            or _default_cutoff(scene, needs, sent, frequency_hz)
        )
        return Accuracy(
            precision, SURROGATE_TOLERANCE[precision], float(cutoff), given.ray_stride or 1
        )
    image = _Image(sent, rays, weights, air, trips=2 if needs.reflection else 1)
    gain = image.gain()
    precision = given.precision or (
        "float32" if ROUNDING * (1 + gain) <= given.tolerance / 2 else "float64"
    )
    fit = float(np.clip(SURROGATE * given.tolerance / max(gain, 1e-300), TIGHTEST_FIT, LOOSEST_FIT))
    cutoff = given.cutoff_depth or needs.cutoff_depth or image.cutoff(CUTOFF * given.tolerance)
    strides = [1, *(s for s in STRIDES if image.stride_error(s) <= STRIDE * given.tolerance)]
    stride = given.ray_stride or min(
        strides, key=lambda s: share_traced(air.raster, surfaces, rays, s)
    )
    return Accuracy(precision, fit, float(cutoff), stride)


def share_traced(raster: Raster, surfaces: list[Surface], rays: Rays, stride: int) -> float:
    """The part of the rays that is traced, about: a lattice.

    And all in the cells that edges cross; of a regular sample.
    """
    if stride == 1:
        return 1.0
    lattice = math.prod((n - 1) // stride + 2 for n in (raster.rows, raster.columns)) / raster.rays
    things = np.array([s.target for s in surfaces])[rays.surface].reshape(
        min(SAMPLED, raster.rows), -1
    )
    cells = [
        max(n / sampled, 1)
        for n, sampled in zip((raster.rows, raster.columns), things.shape, strict=True)
    ]
    edges = sum(
        np.mean(np.diff(things, axis=axis) != 0) / cells[axis]
        for axis in (0, 1)
        if things.shape[axis] > 1
    )
    return float(min(1.0, lattice + edges * 2 * stride))


def _default_cutoff(scene: Scene, needs: Needs, sent: Array, frequency_hz: Array) -> float:
    """The depth behind which nothing that can be seen is worth 1e-7 of the air's radiance."""
    air = (
        1.0 if needs.reflection else radiometry.planck(frequency_hz, scene.atmosphere.temperature_k)
    )
    brightest = float(np.max(np.abs(sent) / air))
    return max(SMALLEST_CUTOFF, math.log(brightest / NEGLIGIBLE) if brightest > 0 else 0.0)


@dataclass(frozen=True)
class AirAlong:
    """The air that rays cross: mean absorption and its slope with delta, (frequency,) in 1/m, and what makes it uneven.

    `turbulence` is None where the cube is not a generated one, `turn` from the world to it; `pixel_rad` is the angle from a
    ray to the next.
    """

    absorption: Array
    slope: Array
    turbulence: Turbulence | None
    turn: Array
    pixel_rad: float
    raster: Raster


@dataclass(frozen=True)
class _Image:
    """What the image will be, by a sample of its rays through mean air."""

    sent: Array  # (surface, frequency)
    rays: Rays
    weights: Array | None  # (band, frequency)
    air: AirAlong
    trips: int

    def _bands(self, values: Array) -> Array:
        """(ray, frequency) to (ray, band)."""
        return values if self.weights is None else np.asarray(values @ self.weights.T)

    def _depth(self) -> Array:
        """(ray, frequency)."""
        return np.asarray(self.trips * self.rays.length[:, None] * self.air.absorption)

    def _seen(self) -> Array:
        """Contrast to the air, (ray, frequency)."""
        return np.asarray(np.abs(self.sent)[self.rays.surface] * np.exp(-self._depth()))

    def _contrast(self) -> Array:
        """The largest in the image, (band,); 1 where there is none at all."""
        largest = self._bands(self._seen()).max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def gain(self) -> float:
        """What an error relative to every depth becomes, relative to the contrast."""
        return float(
            (self._bands(self._seen() * self._depth()).max(axis=0) / self._contrast()).max()
        )

    def cutoff(self, share: float) -> float:
        """The depth, in the thinnest frequency.

        Behind which nothing is worth a share of the contrast.
        """
        brightest = np.abs(self.sent).max(axis=0)
        if not brightest.any():
            return SMALLEST_CUTOFF
        thinnest = self.air.absorption.min()
        if self.weights is not None:
            beyond = np.log((self.weights @ brightest) / (share * self._contrast()))
        else:
            seen = brightest > 0
            ratio = np.divide(
                thinnest,
                self.air.absorption,
                out=np.ones_like(brightest),
                where=self.air.absorption > 0,
            )
            beyond = np.log(brightest[seen] / (share * self._contrast()[seen])) * ratio[seen]
        return max(1.0, float(beyond.max()) / self.trips)

    def stride_error(self, stride: int) -> float:
        """What interpolating between every `stride`-th ray costs, relative to the contrast.

        Infinite where it is not known.
        """
        if self.air.turbulence is None:
            return math.inf
        metres = _moment_error(self.air.turbulence, self.rays, self.air, stride)
        lost = self.trips * np.abs(self.air.slope) * metres[:, None] * self._seen()
        return float((np.sqrt((self._bands(lost) ** 2).mean(axis=0)) / self._contrast()).max())


# Measured over views of 30 to 150 m at 0.05 to 0.4 mrad a pixel, in voxels of 0.1 to 1.5 m: where
# the error is small, the model below is met within a factor of 1.5.
KINKS, APART, BEYOND = 0.008, 0.2, 0.05


def _moment_error(turbulence: Turbulence, rays: Rays, air: AirAlong, stride: int) -> Array:
    """Error of the first path moment between rays `stride` apart, in m, by ray.

    Across the rays a moment is a chain of straight lines with kinks where a ray passes a voxel's
    edge, n^-1 as steep along an axis whose planes it crosses at a slant n; at the far end, where
    the surface slants, likewise. Between lattice points the error of a straight line is that of the
    kinks within: the root of their number times step times spacing. Rays farther apart than a voxel
    have the difference of unlike paths, which grows as Kolmogorov's r^(2/3).
    """
    voxel = turbulence.voxel_m
    slant = np.maximum(
        np.abs(rays.direction @ air.turn.T), voxel / np.maximum(rays.length, voxel)[:, None]
    )
    apart = stride * air.pixel_rad * rays.length
    down = np.abs(rays.direction[:, 2])
    beyond = np.where(rays.surface == GROUND, apart / np.maximum(down, 1e-3), apart)
    steps, more = (np.maximum(distance / voxel, 1.0) ** (2 / 3) for distance in (apart, beyond))
    across = np.minimum(
        KINKS * apart**3 * rays.length / voxel**2 * (slant**-2.0).sum(axis=1),
        APART * rays.length * np.maximum(apart, voxel) * steps,
    )
    along = np.minimum(KINKS * beyond**3 / voxel, BEYOND * beyond**2 * more)
    return np.asarray(np.sqrt(turbulence.neighbour_difference() * (across + along)))
