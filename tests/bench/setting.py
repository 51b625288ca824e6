"""The work that all rivals do: optical depths along the rays of the slides' scene.

Their ends given.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from thzcl import pipeline
from thzcl.air.expansion import Surrogate, fit
from thzcl.clock import Clock
from thzcl.device.opencl import Device
from thzcl.error import twin
from thzcl.paths import thinning
from thzcl.paths import trace as tracing
from thzcl.paths.trace import Ends, Medium, Paths
from thzcl.plan.numerics import sources
from thzcl.plan import compute
from thzcl.plan.plan import VariantPlan
from thzcl.surfaces.geometry import ROTATIONS, cube_frame, world_frame
from thzcl.turbulence.cube import Field

VARIANT = "284 K"
CHECKED = 4096  # rays followed again in float64, from which errors are measured


class OneLane(Device):
    """The same kernels with one work-item a pixel, as they are written for a GPU."""

    def lanes(self, precision: str) -> int:
        """One ray to a work-item."""
        return 1


@dataclass(frozen=True)
class Setting:
    """One trace, ready to start."""

    device: Device
    variant: VariantPlan
    cube: Field
    ends: Ends
    medium: Medium
    surrogate: Surrogate

    def trace(self) -> Paths:
        """Ours; it waits for the device."""
        moments, precision = self.surrogate.moments, self.variant.precision
        if self.variant.stride == 1:
            return tracing.trace(self.device, self.ends, self.medium, moments, None, precision)
        things = np.array([surface.target for surface in self.variant.surfaces])
        stride = self.variant.stride
        paths = thinning.trace_thinned(
            self.device, self.ends, self.medium, moments, None, stride, things
        )
        self.device.finish()
        return paths

    def depth(self, paths: Paths) -> np.ndarray:
        """Optical depth (ray,) at the first frequency."""
        first, *others = self.surrogate.coefficients[0, :, 0]
        depth = first * paths.path_length.host().astype(np.float64)
        for coefficient, moment in zip(others, paths.moments.host(), strict=True):
            depth += coefficient * moment
        return depth[: self.rays]

    @property
    def rays(self) -> int:
        """How many there are, all pixels'."""
        return self.variant.geometry.raster.rays

    @cached_property
    def absorption(self) -> np.ndarray:
        """Of each voxel, 1/m, float64 [z, y, x]: what the rivals are given in place of humidity."""
        return self.absorption_at(0)

    def absorption_at(self, frequency: int) -> np.ndarray:
        """The same at one of several frequencies."""
        delta = self.cube.delta.host().astype(np.float64)
        return np.polynomial.polynomial.polyval(delta, self.surrogate.coefficients[frequency, :, 0])

    @cached_property
    def checked(self) -> np.ndarray:
        """Numbers of the rays from which errors are measured."""
        return np.unique(np.linspace(0, self.rays - 1, CHECKED).astype(np.int64))

    def directions(self, numbers: np.ndarray) -> np.ndarray:
        """Of some rays, (ray, 3), in voxels per unit of the ray's parameter."""
        raster, (_, forward, right, up, *_) = self.variant.geometry.raster, self.medium.frame
        u = (numbers % raster.columns + 0.5 - raster.columns / 2)[:, None]
        v = (raster.rows / 2 - numbers // raster.columns - 0.5)[:, None]
        return forward + u * right + v * up

    @cached_property
    def exact(self) -> np.ndarray:
        """Optical depths of the checked rays: MPM93 itself, float64."""
        rays, field = self.checked, self.variant.field
        direction = self.directions(rays)
        unit = direction / np.linalg.norm(direction, axis=1)[:, None]
        metres = (
            self.ends.reach.host()[rays] * np.linalg.norm(direction, axis=1) * self.cube.voxel_m
        )
        origin = np.broadcast_to(self.medium.frame[0], unit.shape)
        length, voxel = twin.walk(origin, unit, metres, self.cube.voxel_m, field.source.grid)
        delta = self.cube.delta.host().ravel()[voxel].astype(np.float64)
        absorber = twin.exact(
            self.surrogate.air, self.variant.frequency_hz[:1], self.cube.humidity_span, (0.0, 0.0)
        )
        return twin.depth(absorber, twin.Path(length, delta, None, self.cube.humidity_span))[0]

    def error(self, transmission: np.ndarray) -> float:
        """Of transmissions of all rays: rms error of the contrast over the checked ones.

        Relative to the largest.
        """
        v, rays = self.variant, self.checked
        emitted = sources(v.scene, v.needs, v.surfaces, v.frequency_hz)[
            self.ends.surface.host()[rays], 0
        ]
        right = emitted * np.exp(-self.exact)
        wrong = emitted * transmission[rays] - right
        return float(np.sqrt(np.nanmean(wrong**2)) / np.abs(right).max())

    @property
    def turn(self) -> np.ndarray:
        """From the world to the cube."""
        return ROTATIONS[self.variant.orientation]


def make(device: Device, settings: Mapping[str, Any]) -> Setting:
    """A variant of `slide` with some settings: its field made, and its rays' ends found."""
    plan = pipeline.prepare("slide", settings, [VARIANT])
    (group,), (variant,) = plan.groups, plan.variants
    if group.cut:
        raise ValueError("rays reach the cut-off depth, which the rivals do not know")
    cube = compute.make_field(device, variant, Clock())
    ends = compute.find_lines(device, variant, Clock()).camera
    frame = cube_frame(
        world_frame(variant.geometry.frame),
        variant.orientation,
        cube.voxel_m,
        cube.grid,
        np.zeros(3),
    )
    medium = Medium(cube.delta, None, (0.0, 0.0), frame, cube.grid, cube.voxel_m, None)
    air, tolerance, moments = variant.surrogate.air, variant.accuracy.surrogate, group.moments
    fitted = fit(
        air,
        variant.frequency_hz,
        cube.humidity_span,
        (0.0, 0.0),
        tolerance=tolerance,
        moments=moments,
    )
    return Setting(device, variant, cube, ends, medium, fitted)
