"""Radiance at each ray: by depth in isothermal air, or as it was carried along the path.

Everything that belongs to a ray is applied here, before rays are gathered into pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, ExpansionSpec
from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Memory, Spec, Work, frozen
from thzcl.paths.emission import Carried
from thzcl.paths.specs import AnyPath, EmissionSpec
from thzcl.paths.trace import Paths
from thzcl.sensing.spectrum import Spectrum
from thzcl.surfaces import camera
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.ends import EndsSpec, RayEnds
from thzcl.surfaces.geometry import Geometry
from thzcl.surfaces.radiance import SentSpec, Sources, Table

Array = NDArray[Any]
_WAYS_OUT = {
    1: LeftOut("passive sensor: nothing is sent out"),
    2: LeftOut("monostatic: out and back through the same voxels"),
}


@dataclass(frozen=True)
class Rays:
    """What the rays of a raster bring, on the host: (plane, row, column), or (row, column).

    A plane is a frequency or a band. `reached` holds for each way (the ray's own, and one from a
    transmitter) how far it was followed; `shown` is the surface met, or 0 where the cut-off ended
    the ray, or where the surface is not lit.
    """

    depth: Array  # optical depth, 1
    contrast: Array  # W m-2 sr-1 Hz-1 above the air's, or the part that comes back
    reached: tuple[Array, ...]  # m
    shown: NDArray[np.int32]
    interpolated: NDArray[np.bool_]


def on_raster(raster: Raster, values: Array) -> Array:
    """Returns values (..., ray) without their padding in rows and columns."""
    return values[..., : raster.rays].reshape(*values.shape[:-1], raster.rows, raster.columns)


@frozen
class ShadeSpec(Spec):
    """Optical depth and radiance of rays through isothermal air, for one set of surfaces."""

    path: AnyPath
    expansion: ExpansionSpec
    sent: SentSpec
    spectrum: Spectrum
    reads = ("path", "expansion", "sent")
    stage = "shading"

    @property
    def sources(self) -> Sources:
        """Returns the surfaces as sources."""
        return self.sent.sources

    @property
    def ends(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.path.camera

    def run(self, device: Device, path: Paths, expansion: Expansion, sent: Table) -> Rays:
        """Returns the rays on the host."""
        raster = self.ends.geometry.raster
        own = expansion.coefficients[:, :, 0] * self.sources.trips
        # A path that serves other air too can hold more moments than this polynomial has terms.
        terms = np.pad(own, ((0, 0), (0, len(path.moments) + 1 - own.shape[1])))
        sources, precision = self.sources, self.ends.precision
        shaded = self.spectrum.shade(device, path, terms, sources, sent, precision)
        return Rays(
            on_raster(raster, shaded.depth.host()),
            on_raster(raster, shaded.contrast.host()),
            tuple(on_raster(raster, way.host()) for way in path.ways or (path.path_length,)),
            on_raster(raster, path.surface.host()),
            on_raster(raster, path.interpolated),
        )

    @property
    def planes(self) -> int:
        """Returns how many frequencies or bands there are."""
        return self.spectrum.count

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that nothing goes out, or not on a way of its own."""
        return {"outgoing-path": _WAYS_OUT[self.sources.trips]}

    def memory(self) -> Memory:
        """Returns depth and contrast of every ray."""
        rays, real = self.ends.geometry.raster.rays, np.dtype(self.ends.precision).itemsize
        return Memory((real * rays * self.spectrum.count,) * 2)


@frozen
class CarriedSpec(Spec):
    """Depth and radiance, in planes, of rays through air whose temperature fluctuates.

    `out` is the way out of an active sensor's beam, if it has one: the way back itself, or its own.
    """

    back: EmissionSpec
    out: tuple[EmissionSpec, ...]
    sources: Sources
    spectrum: Spectrum
    reads = ("back", "out")
    stage = "shading"

    @property
    def ends(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.back.camera

    def run(self, device: Device, back: Carried, out: Iterator[Carried]) -> Rays:
        """Returns the rays on the host."""
        del device
        depth, contrast, shown = back.depth, back.contrast, back.surface
        ways = {self.back: back.path_length}  # out and back through the same air are one way
        for spec, way in zip(self.out, out, strict=True):
            contrast = contrast * np.exp(-way.depth) * (way.surface > 0)
            depth = depth + way.depth
            shown = np.where(way.surface > 0, shown, np.int32(0))
            ways[spec] = way.path_length
        raster = self.ends.geometry.raster
        return Rays(
            on_raster(raster, self.spectrum.mean_depth(depth, self.sources)),
            on_raster(raster, self.spectrum.planes(contrast)),
            tuple(on_raster(raster, way) for way in ways.values()),
            on_raster(raster, shown),
            np.broadcast_to(np.False_, (raster.rows, raster.columns)),
        )

    @property
    def planes(self) -> int:
        """Returns how many frequencies or bands there are."""
        return self.spectrum.count

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that nothing goes out, or not on a way of its own."""
        return {"outgoing-path": _WAYS_OUT[self.sources.trips]}

    def memory(self) -> Memory:
        """Returns depth and contrast of every ray, and what their sums over frequency need."""
        rays = self.ends.geometry.raster.rays
        return Memory((8 * rays * self.spectrum.count,) * 2, self.back.memory().held)


@frozen
class LambertSpec(Spec):
    """Echoes that rough surfaces scatter evenly: each ray's times cos / (pi r^2), 1/m^2.

    The angle is that between ray and normal, r the distance from the surface to the camera.
    """

    rays: ShadeSpec | CarriedSpec
    ends: EndsSpec
    reads = ("rays", "ends")
    stage = "shading"

    @property
    def planes(self) -> int:
        """Returns how many frequencies or bands there are."""
        return self.rays.planes

    def run(self, device: Device, rays: Rays, ends: RayEnds) -> Rays:
        """Returns the rays with each echo times its own gain."""
        del device
        raster = self.ends.geometry.raster
        cosine, length = (
            on_raster(raster, values.host().astype(np.float64))
            for values in (ends.facing.cosine, ends.path_length)
        )
        return replace(rays, contrast=rays.contrast * lambert_gain(cosine, length))

    def memory(self) -> Memory:
        """Returns the echoes."""
        return Memory((8 * self.ends.geometry.raster.rays * self.rays.planes,))


def depths(
    rays: Rays, path: Paths | Carried | None, expansion: Expansion | None
) -> Iterator[Array]:
    """Yields the optical depth of every ray, (ray,), at one frequency after the other.

    Without a path it is that of the planes of the rays, the way out included; with one it is that
    of the way back alone, with an expansion unless the path carries depths.
    """
    planes, number = len(rays.depth), rays.shown.size
    if path is None:
        yield from rays.depth.reshape(planes, -1).astype(np.float64)
    elif isinstance(path, Carried):
        yield from path.depth[:, :number].astype(np.float64)
    else:
        assert expansion is not None  # noqa: S101 (see above)
        length = path.path_length.host()[:number].astype(np.float64)
        moments = path.moments.host()[:, :number]
        for constant, *rest in expansion.coefficients[:, :, 0]:
            yield constant * length + np.asarray(rest) @ moments[: len(rest)]


def elevations(shape: Geometry) -> tuple[Array, float]:
    """Returns the sine of the elevation of rays, (ray,), and the height of the camera, m."""
    direction = camera.directions(shape.frame.array, shape.raster, np.arange(shape.raster.rays))
    sine = direction[:, 2] / np.linalg.norm(direction, axis=1)
    return sine, float(shape.frame.array[0, 2])


def lambert_gain(cosine: Array, length_m: Array) -> Array:
    """Returns the part of an echo that reaches a unit of area at the camera, 1/m^2.

    Lambert's law: cos / (pi r^2), by the `cosine` between ray and normal.
    """
    return np.asarray(cosine / (np.pi * length_m**2))
