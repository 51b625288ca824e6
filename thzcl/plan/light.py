"""The ways of light in one variant: through even, turbulent, or unevenly warm air.

The question which of the three it is, is asked once; all that follows are specs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import ExpansionSpec, TrimmedSpec
from thzcl.air.mean import Air
from thzcl.error.budget import Attenuated, Emitted, Light
from thzcl.error.rays import RAYS, EvenAirSpec, VoxelAirSpec, affordable
from thzcl.graph import Values
from thzcl.paths.specs import (
    AnyEnds,
    EmissionSpec,
    RoundTripSpec,
    StraightSpec,
    TraceSpec,
)
from thzcl.paths.trace import DEPTH_CHECKED_EVERY, Motion
from thzcl.plan.numerics import Accuracy
from thzcl.sensing.exposures import Exposure
from thzcl.sensing.spectrum import Spectrum
from thzcl.sensing.transfer import AnyRays, CarriedSpec, LambertSpec, ShadeSpec
from thzcl.surfaces.ends import EndsSpec, OutgoingSpec
from thzcl.surfaces.estimate import SampledRays
from thzcl.surfaces.geometry import Geometry
from thzcl.surfaces.radiance import Sources
from thzcl.turbulence.fields import AnyField
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
Point = tuple[float, float, float]
STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Setup:
    """What the rays of one variant have in common, whatever the air.

    `lambert` says whether echoes are scattered evenly, `cosine` whether the slant of surfaces is
    wanted; `targets` (surface,) holds flags of what each surface belongs to.
    """

    air: Air
    spectrum: Spectrum
    sources: Sources
    settled: Accuracy
    moments: int | None  # a fixed degree of the expansion
    transmitter_m: Point | None
    lambert: bool
    cosine: bool
    targets: Values

    def ends(self, shape: Geometry) -> EndsSpec:
        """Returns where the camera's rays end."""
        return EndsSpec(shape, self.settled.precision, self.cosine)

    def out(self, shape: Geometry) -> OutgoingSpec | None:
        """Returns the ways from a transmitter of its own."""
        if self.transmitter_m is None:
            return None
        return OutgoingSpec(self.ends(shape), self.transmitter_m)

    def ways(self, shape: Geometry) -> tuple[AnyEnds, ...]:
        """Returns the ends of the camera's rays, and of those from a transmitter of its own."""
        out = self.out(shape)
        return (self.ends(shape),) if out is None else (self.ends(shape), out)

    def expansion(self, field: AnyField | None) -> ExpansionSpec:
        """Returns the expansion of absorption over what a cube reaches."""
        fit = self.settled.expansion, self.moments
        return ExpansionSpec(self.air, self.spectrum.nodes_hz, field, *fit)

    def gained(self, rays: ShadeSpec | CarriedSpec) -> AnyRays:
        """Returns rays with the gain that the sensor asks for."""
        return LambertSpec(rays, rays.ends) if self.lambert else rays

    def light(self, transfer: Attenuated | Emitted, spectrum: Spectrum) -> Light:
        """Returns the float64 twin of what reaches the camera."""
        return Light(self.air, self.sources, spectrum, transfer)

    def attenuated(self) -> Attenuated:
        """Returns how the twin takes the air's share."""
        return Attenuated(self.sources.trips)


@dataclass(frozen=True)
class EvenAir:
    """Air that is the same everywhere; `why` there is no cube."""

    setup: Setup
    why: str

    @property
    def expansion(self) -> ExpansionSpec:
        """Returns absorption at each frequency."""
        return self.setup.expansion(None)

    def rays(self, taken: Exposure) -> ShadeSpec:
        """Returns the rays of an exposure."""
        ways = [StraightSpec(ends, self.why) for ends in self.setup.ways(taken.geometry)]
        path = ways[0] if len(ways) == 1 else RoundTripSpec(*ways)
        return ShadeSpec(path, self.expansion, self.setup.sources, self.setup.spectrum)

    def walked(self, taken: Exposure) -> EvenAirSpec:
        """Returns the air for the twin to walk through."""
        del taken
        return EvenAirSpec()

    def budget_rays(self, mean_m: float) -> int:
        """Returns how many rays the twin follows."""
        del mean_m
        return RAYS

    def segments_a_ray(self, longest_m: float) -> float:
        """Returns how many segments a ray has."""
        del longest_m
        return 1.0

    def twin(self, spectrum: Spectrum) -> Light:
        """Returns the twin at some frequencies."""
        return self.setup.light(self.setup.attenuated(), spectrum)


@dataclass(frozen=True)
class Moving:
    """The cube, how it lies and moves, and how many voxels rays cross in it.

    `sample` is of the camera's rays; `visible_m` how far they reach in mean air before the cut-off.
    """

    field: AnyField
    orientation: str
    wind_m_s: Point
    sample: SampledRays
    visible_m: float
    share_traced: float

    def motion(self, times_s: Values | None) -> Motion:
        """Returns the cube's motion for rays taken at some times."""
        wind = STILL if times_s is None else self.wind_m_s
        return Motion(self.orientation, wind, times_s)

    def segments(self, ends: AnyEnds, camera_m: Point) -> float:
        """Returns about how many voxels all rays of a raster cross that end at `ends`."""
        direction, length = self.sample.direction, self.sample.length
        if isinstance(ends, OutgoingSpec):
            away = np.array(camera_m) + length[:, None] * direction - np.array(ends.transmitter_m)
            length = np.linalg.norm(away, axis=1)
            direction = away / np.maximum(length, 1e-300)[:, None]
            length = np.where(self.sample.surface > 0, length, 0.0)
        turn = ROTATIONS[self.orientation].T
        per_metre = np.abs(direction @ turn).sum(axis=1) / self.field.voxel_m
        voxels = length * per_metre + 1
        checks = np.ceil((self.visible_m * per_metre + 1) / DEPTH_CHECKED_EVERY)
        voxels = np.minimum(voxels, checks * DEPTH_CHECKED_EVERY)
        return float(voxels.mean()) * ends.geometry.raster.rays * self.share_traced


def _camera(shape: Geometry) -> Point:
    x, y, z = shape.frame.array[0]
    return float(x), float(y), float(z)


@dataclass(frozen=True)
class TurbulentAir:
    """Air of one temperature whose humidity fluctuates: one trace serves every frequency."""

    setup: Setup
    cube: Moving

    @property
    def expansion(self) -> ExpansionSpec:
        """Returns absorption in powers of humidity."""
        return self.setup.expansion(self.cube.field)

    def rays(self, taken: Exposure) -> ShadeSpec:
        """Returns the rays of an exposure."""
        ways = [self._trace(ends, taken) for ends in self.setup.ways(taken.geometry)]
        path = ways[0] if len(ways) == 1 else RoundTripSpec(*ways)
        return ShadeSpec(path, self.expansion, self.setup.sources, self.setup.spectrum)

    def _trace(self, ends: AnyEnds, taken: Exposure) -> TraceSpec:
        settled = self.setup.settled
        # Rays at times of their own share no voxels with their neighbours.
        stride = settled.stride if taken.times_s is None else 1
        return TraceSpec(
            self.cube.field,
            ends,
            (self.expansion,),
            self.cube.motion(taken.times_s),
            settled.cutoff,
            stride,
            settled.fixed,
            self.setup.targets,
            self.cube.segments(ends, _camera(taken.geometry)),
        )

    def walked(self, taken: Exposure) -> VoxelAirSpec:
        """Returns the air for the twin to walk through."""
        return VoxelAirSpec(self.cube.field, self.cube.motion(taken.times_s))

    def budget_rays(self, mean_m: float) -> int:
        """Returns how many rays the twin follows, of a mean length of all ways together."""
        return affordable(mean_m, self.cube.field.voxel_m, 1)

    def segments_a_ray(self, longest_m: float) -> float:
        """Returns how many segments the longest ray has."""
        return 1.8 * longest_m / self.cube.field.voxel_m + 3

    def twin(self, spectrum: Spectrum) -> Light:
        """Returns the twin at some frequencies."""
        return self.setup.light(self.setup.attenuated(), spectrum)


@dataclass(frozen=True)
class WarmAir:
    """Air whose temperature fluctuates too: radiance is carried along each path."""

    setup: Setup
    cube: Moving

    @property
    def expansion(self) -> TrimmedSpec:
        """Returns absorption in powers of humidity and temperature."""
        return TrimmedSpec(self.setup.expansion(self.cube.field))

    def rays(self, taken: Exposure) -> CarriedSpec:
        """Returns the rays of an exposure."""
        setup = self.setup
        ways = [self._emission(ends, taken) for ends in setup.ways(taken.geometry)]
        out = {1: (), 2: (ways[-1],)}[setup.sources.ways]
        return CarriedSpec(ways[0], out, setup.sources, setup.spectrum)

    def _emission(self, ends: AnyEnds, taken: Exposure) -> EmissionSpec:
        passes = -(-self.setup.spectrum.nodes_hz.shape[0] // 8)
        return EmissionSpec(
            self.cube.field,
            ends,
            self.expansion,
            self.setup.sources,
            self.cube.motion(taken.times_s),
            self.setup.settled.cutoff,
            passes * self.cube.segments(ends, _camera(taken.geometry)),
        )

    def walked(self, taken: Exposure) -> VoxelAirSpec:
        """Returns the air for the twin to walk through."""
        return VoxelAirSpec(self.cube.field, self.cube.motion(taken.times_s))

    def budget_rays(self, mean_m: float) -> int:
        """Returns how many rays the twin follows, of a mean length of all ways together."""
        work = 2 * self.setup.spectrum.nodes_hz.shape[0]
        return affordable(mean_m, self.cube.field.voxel_m, work)

    def segments_a_ray(self, longest_m: float) -> float:
        """Returns how many segments the longest ray has."""
        return 1.8 * longest_m / self.cube.field.voxel_m + 3

    def twin(self, spectrum: Spectrum) -> Light:
        """Returns the twin at some frequencies."""
        transfer: Any = self.setup.attenuated()
        if self.setup.sources.air_emits:
            transfer = Emitted(self.setup.air.temperature_k)
        return self.setup.light(transfer, spectrum)


AnyAir = EvenAir | TurbulentAir | WarmAir
