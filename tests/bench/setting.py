"""The work that all rivals do: optical depths along rays of the slides' scene, of given ends."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from thzcl import pipeline
from thzcl.air.expansion import Expansion
from thzcl.device.opencl import Device
from thzcl.error import twin
from thzcl.error.rays import Lines, Voxels
from thzcl.graph import evaluate, everything
from thzcl.paths import trace as tracing
from thzcl.paths.specs import TraceSpec
from thzcl.paths.trace import Medium, Paths
from thzcl.scenario.scene import Scene
from thzcl.sensing.transfer import ShadeSpec
from thzcl.surfaces import camera
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.ends import RayEnds
from thzcl.turbulence.cube import Field
from thzcl.turbulence.orientation import ROTATIONS

VARIANT = "284 K"
CHECKED = 4096  # rays followed again in float64, from which errors are measured


class OneLane(Device):
    """The same kernels with one work-item a pixel, as they are written for a GPU."""

    def lanes(self, precision: str, *, gathers: bool = False) -> int:
        """Returns 1: one ray to a work-item."""
        del precision, gathers
        return 1


@dataclass(frozen=True)
class Setting:
    """One trace, ready to start: the specs of its path and its image, and what the path reads."""

    device: Device
    scene: Scene
    path: TraceSpec
    shade: ShadeSpec
    cube: Field
    ends: RayEnds
    expansion: Expansion

    def trace(self) -> Paths:
        """Returns our paths, once the device has ended."""
        paths = self.path.run(self.device, self.cube, self.ends, iter([self.expansion]), iter(()))
        self.device.finish()
        return paths

    def segments(self) -> int:
        """Returns how many voxels our rays cross over positive length."""
        before = self.device.counters.segments
        self.trace()
        return self.device.counters.segments - before

    def depth(self, paths: Paths) -> np.ndarray:
        """Returns optical depth (ray,) at the first frequency."""
        first, *others = self.expansion.coefficients[0, :, 0]
        depth = first * paths.path_length.host().astype(np.float64)
        for coefficient, moment in zip(others, paths.moments.host(), strict=True):
            depth += coefficient * moment
        return depth[: self.rays]

    @property
    def raster(self) -> Raster:
        """Returns the raster of rays."""
        return self.ends.geometry.raster

    @property
    def rays(self) -> int:
        """Returns the number of rays of all pixels together."""
        return self.raster.rays

    @cached_property
    def medium(self) -> Medium:
        """Returns the cube as the rays cross it, with their frame in its voxels."""
        return tracing.medium(self.device, self.cube, self.ends, self.path.motion)

    @cached_property
    def absorption(self) -> np.ndarray:
        """Returns each voxel's absorption, 1/m, float64 (z, y, x): rivals get it for humidity."""
        return self.absorption_at(0)

    def absorption_at(self, frequency: int) -> np.ndarray:
        """Returns each voxel's absorption at one of several frequencies, by number."""
        delta = self.cube.delta.host().astype(np.float64)
        return np.polynomial.polynomial.polyval(delta, self.expansion.coefficients[frequency, :, 0])

    @cached_property
    def checked(self) -> np.ndarray:
        """Returns numbers of the rays from which errors are measured."""
        return np.unique(np.linspace(0, self.rays - 1, CHECKED).astype(np.int64))

    def directions(self, numbers: np.ndarray) -> np.ndarray:
        """Returns directions of some rays, (ray, 3), in voxels per unit of the ray's parameter."""
        return camera.directions(self.medium.frame[:4], self.raster, numbers)

    @cached_property
    def exact(self) -> np.ndarray:
        """Returns optical depths of the checked rays by MPM93 itself, in float64."""
        shape, rays = self.ends.geometry, self.checked
        direction = camera.directions(shape.frame.array, shape.raster, rays)
        norm = np.linalg.norm(direction, axis=1)
        metres = self.ends.reach.host()[rays] * norm
        place = np.divmod(rays, shape.raster.columns)
        lines = Lines(shape.frame.array[0], direction / norm[:, None], metres, place)
        met = Voxels(self.cube, self.path.motion).way(lines)
        span = self.expansion.humidity_span
        nodes = self.expansion.frequency_hz[:1]
        absorber = twin.exact(self.expansion.air, nodes, span, (0.0, 0.0))
        return absorber.depth(twin.Path(met.length, met.delta, None, span))[0]

    def error(self, transmission: np.ndarray) -> float:
        """Returns the rms error of the contrast over the checked rays, relative to the largest.

        `transmission` (ray,) is that of all rays; NaN where it is not known.
        """
        rays, nodes = self.checked, self.expansion.frequency_hz
        emitted = self.shade.sources.table(nodes).sent[self.ends.surface.host()[rays], 0]
        right = emitted * np.exp(-self.exact)
        wrong = emitted * transmission[rays] - right
        return float(np.sqrt(np.nanmean(wrong**2)) / np.abs(right).max())

    @property
    def turn(self) -> np.ndarray:
        """Returns the rotation from the world to the cube."""
        return ROTATIONS[self.path.motion.orientation]


def make(device: Device, settings: Mapping[str, Any]) -> Setting:
    """Returns a variant of `slide` with some settings: its cube made, and its rays' ends found.

    The cut-off depth, which rivals do not know, is taken away.
    """
    (variant,) = pipeline.prepare("slide", settings, [VARIANT]).variants
    specs = everything([variant.image])
    (path,) = (spec for spec in specs if isinstance(spec, TraceSpec))
    (shade,) = (spec for spec in specs if isinstance(spec, ShadeSpec))
    wanted = path.field, path.ends, shade.expansion
    cube, ends, expansion = next(evaluate([wanted], device))
    uncut = replace(path, cutoff=math.inf)
    return Setting(device, variant.scene, uncut, shade, cube, ends, expansion)
