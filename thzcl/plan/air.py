"""How light goes through the air of one variant, which is even, turbulent, or unevenly warm.

Each of the three kinds of air is a class, which makes the specs of paths and of their float64 twins
(the same physics without what makes a run fast, for the error budget).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import ExpansionSpec, TrimmedSpec
from thzcl.air.mean import Air
from thzcl.air.weather import Weather
from thzcl.error.budget import Attenuated, Emitted, Light, Transfer
from thzcl.error.rays import RAYS, UniformAirSpec, VoxelAirSpec, affordable
from thzcl.graph import Values
from thzcl.paths.emission import AT_ONCE
from thzcl.paths.specs import (
    AnyEnds,
    EmissionSpec,
    RoundTripSpec,
    StraightSpec,
    TraceSpec,
)
from thzcl.paths.trace import DEPTH_CHECKED_EVERY, Motion
from thzcl.plan.numerics import Accuracy
from thzcl.sensing.air_echo import AirEcho, AirEchoSpec
from thzcl.sensing.exposures import Exposure
from thzcl.sensing.spectrum import Spectrum
from thzcl.sensing.transfer import CarriedSpec, LambertSpec, ShadeSpec
from thzcl.sensing.weather import AnyRays, WeatherSpec
from thzcl.surfaces.ends import Asked, EndsSpec, OutgoingSpec
from thzcl.surfaces.estimate import SampledRays
from thzcl.surfaces.geometry import Geometry
from thzcl.surfaces.radiance import SentSpec, Sources
from thzcl.turbulence.fields import AnyField
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
Point = tuple[float, float, float]
STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Setup:
    """What all rays of one variant have in common.

    `moments` is the degree of the expansion in humidity, if the scene fixes it. `transmitter_m` is
    the place of a transmitter that is not at the camera. `lambert` says whether surfaces scatter
    echoes evenly, `cosine` whether the cosine between ray and surface normal is wanted. `targets`
    (surface,) holds the flag of the target that each surface belongs to. `polarization_deg` is the
    direction of the field that the camera sees, or None if it sees all.
    """

    air: Air
    spectrum: Spectrum
    sources: Sources
    settled: Accuracy
    moments: int | None
    transmitter_m: Point | None
    lambert: bool
    cosine: bool
    targets: Values
    polarization_deg: float | None = None
    weather: Weather | None = None
    scattered: bool = False
    echo: AirEcho | None = None  # what falls sends back to the sensor's beam

    @property
    def sent(self) -> SentSpec:
        """Returns what surfaces send at the sensor's frequencies."""
        return SentSpec(self.sources, self.spectrum.nodes_hz)

    def ends(self, shape: Geometry) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        angular = self.sources.angular
        polarized = angular and self.sources.reflecting.polarized
        asked = Asked(
            self.cosine or angular,
            angular,
            self.polarization_deg if polarized else None,
            self.sources.bounces,
        )
        return EndsSpec(shape, self.settled.precision, asked)

    def out(self, shape: Geometry) -> OutgoingSpec | None:
        """Returns the ways from a transmitter that is not at the camera, or None."""
        if self.transmitter_m is None:
            return None
        return OutgoingSpec(self.ends(shape), self.transmitter_m)

    def ways(self, shape: Geometry) -> tuple[AnyEnds, ...]:
        """Returns the ends of the camera's rays, and of the ways from a transmitter elsewhere."""
        out = self.out(shape)
        return (self.ends(shape),) if out is None else (self.ends(shape), out)

    def expansion(self, field: AnyField | None) -> ExpansionSpec:
        """Returns the expansion of absorption over the values of a cube, or for even air."""
        fit = self.settled.expansion, self.moments
        return ExpansionSpec(self.air, self.spectrum.nodes_hz, field, *fit)

    def gained(self, rays: ShadeSpec | CarriedSpec) -> AnyRays:
        """Returns rays with the gain that the sensor asks for, or the light that weather adds."""
        if self.weather is not None and self.scattered:
            return WeatherSpec.of(rays, self.weather)
        return LambertSpec(rays, rays.ends) if self.lambert else rays

    def echoed(self, rays: AnyRays) -> AirEchoSpec:
        """Returns what the air sends back along rays of echoes."""
        assert self.echo is not None  # noqa: S101 (asked only where something falls)
        assert not isinstance(rays, WeatherSpec | AirEchoSpec)  # noqa: S101 (echoes of surfaces)
        return AirEchoSpec.of(rays.rays if isinstance(rays, LambertSpec) else rays, self.echo)

    def light(self, transfer: Transfer, spectrum: Spectrum) -> Light:
        """Returns the float64 twin of what reaches the camera at some frequencies."""
        weather = self.weather if self.scattered else None
        return Light(self.air, self.sources, spectrum, transfer, weather, self.echo)

    def attenuated(self) -> Attenuated:
        """Returns how light is attenuated in the float64 twin."""
        return Attenuated(self.sources.trips)


@dataclass(frozen=True)
class UniformAir:
    """Air that is the same everywhere; `why` is the reason why there is no cube."""

    setup: Setup
    why: str

    @property
    def expansion(self) -> ExpansionSpec:
        """Returns the absorption at each frequency."""
        return self.setup.expansion(None)

    def rays(self, taken: Exposure) -> ShadeSpec:
        """Returns the rays of an exposure, through this air."""
        ways = [StraightSpec(ends, self.why) for ends in self.setup.ways(taken.geometry)]
        path = ways[0] if len(ways) == 1 else RoundTripSpec(*ways)
        return ShadeSpec(path, self.expansion, self.setup.sent, self.setup.spectrum)

    def walked(self, taken: Exposure) -> UniformAirSpec:
        """Returns the air that the float64 twin walks through."""
        del taken
        return UniformAirSpec()

    def budget_rays(self, mean_m: float) -> int:
        """Returns the number of rays that the float64 twin follows."""
        del mean_m
        return RAYS

    def segments_a_ray(self, longest_m: float) -> float:
        """Returns the number of segments of a ray."""
        del longest_m
        return 1.0

    def twin(self, spectrum: Spectrum) -> Light:
        """Returns the float64 twin of what reaches the camera at some frequencies."""
        return self.setup.light(self.setup.attenuated(), spectrum)


@dataclass(frozen=True)
class Moving:
    """A cube of air, its orientation and wind, and what is needed to estimate the voxels crossed.

    `sample` are some of the camera's rays, and `visible_m` is their length in mean air down to the
    cut-off depth. `share_traced` is the part of all rays that is traced.
    """

    field: AnyField
    orientation: str
    wind_m_s: Point
    sample: SampledRays
    visible_m: float
    share_traced: float

    def motion(self, times_s: Values | None) -> Motion:
        """Returns the motion of the cube for rays that are taken at given times, in s.

        Without times nothing moves.
        """
        wind = STILL if times_s is None else self.wind_m_s
        return Motion(self.orientation, wind, times_s)

    def segments(self, ends: AnyEnds, camera_m: Point) -> float:
        """Returns about how many voxels the rays that end at `ends` cross, all together."""
        direction, length = self.sample.direction, self.sample.length
        if isinstance(ends, OutgoingSpec):
            away = np.array(camera_m) + length[:, None] * direction - np.array(ends.transmitter_m)
            length = np.linalg.norm(away, axis=1)
            direction = away / np.maximum(length, 1e-300)[:, None]
            length = np.where(self.sample.surface > 0, length, 0.0)
        turn = ROTATIONS[self.orientation].T
        per_metre = np.abs(direction @ turn / self.field.lattice.voxel_m).sum(axis=1)
        voxels = length * per_metre + 1
        checks = np.ceil((self.visible_m * per_metre + 1) / DEPTH_CHECKED_EVERY)
        voxels = np.minimum(voxels, checks * DEPTH_CHECKED_EVERY)
        return float(voxels.mean()) * ends.geometry.raster.rays * self.share_traced


def _camera(shape: Geometry) -> Point:
    """Returns the camera's position in the world, m."""
    x, y, z = shape.frame.array[0]
    return float(x), float(y), float(z)


@dataclass(frozen=True)
class _CubeAir:
    """What both kinds of air that fill a cube have in common."""

    setup: Setup
    cube: Moving

    def walked(self, taken: Exposure) -> VoxelAirSpec:
        """Returns the air that the float64 twin walks through."""
        return VoxelAirSpec(self.cube.field, self.cube.motion(taken.times_s))

    def segments_a_ray(self, longest_m: float) -> float:
        """Returns about the number of segments of a ray of `longest_m`."""
        return 1.8 * longest_m / self.cube.field.lattice.shortest_m + 3


class TurbulentAir(_CubeAir):
    """Air of one temperature whose humidity fluctuates; one trace serves all frequencies."""

    @property
    def expansion(self) -> ExpansionSpec:
        """Returns the absorption in powers of humidity."""
        return self.setup.expansion(self.cube.field)

    def rays(self, taken: Exposure) -> ShadeSpec:
        """Returns the rays of an exposure, through this air."""
        ways = [self._trace(ends, taken) for ends in self.setup.ways(taken.geometry)]
        path = ways[0] if len(ways) == 1 else RoundTripSpec(*ways)
        return ShadeSpec(path, self.expansion, self.setup.sent, self.setup.spectrum)

    def _trace(self, ends: AnyEnds, taken: Exposure) -> TraceSpec:
        """Returns the trace through the cube of the rays that end at `ends`."""
        settled = self.setup.settled
        # Rays that are taken at different times share no voxels with their neighbours.
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

    def budget_rays(self, mean_m: float) -> int:
        """Returns the number of rays that the twin follows, of a mean length of `mean_m` in all."""
        return affordable(mean_m, self.cube.field.lattice.shortest_m, 1)

    def twin(self, spectrum: Spectrum) -> Light:
        """Returns the float64 twin of what reaches the camera at some frequencies."""
        return self.setup.light(self.setup.attenuated(), spectrum)


class NonIsothermalAir(_CubeAir):
    """Air whose temperature fluctuates too, so that radiance is summed up along each path."""

    @property
    def expansion(self) -> TrimmedSpec:
        """Returns the absorption in powers of humidity and temperature."""
        return TrimmedSpec(self.setup.expansion(self.cube.field))

    def rays(self, taken: Exposure) -> CarriedSpec:
        """Returns the rays of an exposure, through this air."""
        setup = self.setup
        ways = [self._emission(ends, taken) for ends in setup.ways(taken.geometry)]
        out = () if setup.sources.ways == 1 else (ways[-1],)
        return CarriedSpec(ways[0], out, setup.sources, setup.spectrum)

    def _emission(self, ends: AnyEnds, taken: Exposure) -> EmissionSpec:
        """Returns the emission trace through the cube of the rays that end at `ends`."""
        passes = -(-self.setup.spectrum.nodes_hz.shape[0] // AT_ONCE)
        return EmissionSpec(
            self.cube.field,
            ends,
            self.expansion,
            self.setup.sent,
            self.cube.motion(taken.times_s),
            self.setup.settled.cutoff,
            self.setup.weather,
            passes * self.cube.segments(ends, _camera(taken.geometry)),
        )

    def budget_rays(self, mean_m: float) -> int:
        """Returns the number of rays that the twin follows, of a mean length of `mean_m` in all."""
        work = 2 * self.setup.spectrum.nodes_hz.shape[0]
        return affordable(mean_m, self.cube.field.lattice.shortest_m, work)

    def twin(self, spectrum: Spectrum) -> Light:
        """Returns the float64 twin of what reaches the camera at some frequencies."""
        if self.setup.sources.air_emits:
            weather, nodes = self.setup.weather, spectrum.nodes_hz.array
            veil = None if weather is None else Values.of(weather.extinction(nodes))
            return self.setup.light(Emitted(self.setup.air.temperature_k, veil), spectrum)
        return self.setup.light(self.setup.attenuated(), spectrum)


AnyAir = UniformAir | TurbulentAir | NonIsothermalAir
