"""What rain, fog and snow send back to an active sensor's beam, ray by ray."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, ExpansionSpec
from thzcl.air.mean import Air
from thzcl.air.radiometry import LIGHT_SPEED
from thzcl.air.weather import falling
from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Memory, Spec, Work, frozen
from thzcl.paths.emission import Carried
from thzcl.paths.specs import AnyPath, EmissionSpec
from thzcl.paths.trace import Paths
from thzcl.sensing.path_return import gated, path_return
from thzcl.sensing.spectrum import Bands, Spectrum
from thzcl.sensing.transfer import CarriedSpec, Rays, ShadeSpec, depths, elevations, on_raster
from thzcl.sensor import PathReturn
from thzcl.surfaces.ends import EndsSpec, RayEnds

Array = NDArray[Any]
BLOCK = 1 << 16  # rays at once, which bounds the memory that the integrals take


class Line(NamedTuple):
    """Where rays end, (ray,): their lengths in m, whether that is at a surface, and their sines.

    `sine` is that of the elevation at which the camera looks, which stands at a height of
    `start_m`.
    """

    length_m: Array
    solid: Array
    sine: Array
    start_m: float

    def part(self, some: slice) -> Line:
        """Returns some of the rays."""
        return Line(self.length_m[some], self.solid[some], self.sine[some], self.start_m)


@frozen
class AirEcho:
    """The light that what falls in an air sends back to a beam.

    Results are in the unit of the echoes of surfaces: over the power sent and the area of the
    aperture in m2 if these are spread by Lambert's law, else the reflectivity of a surface at the
    focus that would be as bright.
    """

    air: Air
    beam: PathReturn
    lambert: bool

    @property
    def area_m2(self) -> float:
        """Returns the area of the aperture, m2."""
        return float(np.pi / 4 * self.beam.aperture_m**2)

    @property
    def focus_m(self) -> float:
        """Returns the distance at which the beam is focused, m."""
        assert self.beam.focus_m is not None  # noqa: S101 (whoever plans has settled it)
        return self.beam.focus_m

    def received(self, line: Line) -> tuple[Array, Array]:
        """Returns from which range to which rays receive anything, m, (ray,) each."""
        if self.beam.gate_m is None:
            return gated(line.length_m)
        distance = np.where(line.solid, line.length_m, self.focus_m)
        near, far = gated(distance, self.beam.gate_m, solid=line.solid)
        return near, np.minimum(far, line.length_m)

    def returned(
        self, number: int, frequency_hz: Array, extinction: Array, line: Line, ends: Any
    ) -> Array:
        """Returns what comes back between two ranges, `ends` in m, at one of some frequencies.

        `number` is that of the frequency, and `extinction` (ray,) the mean along each ray, 1/m, of
        gas and all else.
        """
        wavelength = LIGHT_SPEED / frequency_hz[number]
        beam = self.area_m2, wavelength, self.focus_m
        near, far = ends
        rising = line.sine > 0
        total = np.zeros(np.shape(far))
        for kind in falling(self.air, frequency_hz):
            back = float(np.broadcast_to(kind.backscatter, frequency_hz.shape)[number])
            if back == 0:
                continue
            rise = max(kind.top_m - line.start_m, 0.0)
            top = np.divide(rise, line.sine, out=np.full(len(line.sine), np.inf), where=rising)
            within = np.minimum(far, top.reshape(-1, *[1] * (np.ndim(far) - 1)))
            total += path_return(back, extinction, near, within, *beam)
        if self.lambert:
            return np.asarray(total / self.area_m2)
        return np.asarray(total * np.pi * self.focus_m**2 / self.area_m2)


@frozen
class AirEchoSpec(Spec):
    """Rays with what the air sends back to them in place of what surfaces do.

    Along a ray light is attenuated evenly, as it is on average. Bands need depths by frequency,
    which they sum up: `path` has them, with `expansion` unless it carries them. Both are None for
    single frequencies.
    """

    rays: ShadeSpec | CarriedSpec
    ends: EndsSpec
    echo: AirEcho
    spectrum: Spectrum
    path: AnyPath | EmissionSpec | None
    expansion: ExpansionSpec | None
    reads = ("rays", "ends", "path", "expansion")
    stage = "scattering"

    @classmethod
    def of(cls, rays: ShadeSpec | CarriedSpec, echo: AirEcho) -> AirEchoSpec:
        """Returns what the air sends back along rays."""
        common = rays, rays.ends, echo, rays.spectrum
        if not isinstance(rays.spectrum, Bands):
            return cls(*common, None, None)
        if isinstance(rays, CarriedSpec):
            return cls(*common, rays.back, None)
        return cls(*common, rays.path, rays.expansion)

    @property
    def planes(self) -> int:
        """Returns how many frequencies or bands there are."""
        return self.rays.planes

    def run(
        self,
        device: Device,
        rays: Rays,
        ends: RayEnds,
        path: Paths | Carried | None,
        expansion: Expansion | None,
    ) -> Rays:
        """Returns the rays with the air's echo as contrast."""
        del device
        raster = self.ends.geometry.raster
        hz, traced = self.spectrum.nodes_hz.array, rays.reached[0].ravel().astype(np.float64)
        line = Line(
            on_raster(raster, ends.path_length.host()).ravel().astype(np.float64),
            on_raster(raster, ends.surface.host()).ravel() > 0,
            *elevations(self.ends.geometry),
        )
        near_far = self.echo.received(line)
        shares = self.spectrum.planes(np.eye(len(hz)))  # (plane, node)
        found = np.zeros((self.planes, traced.size))
        trips = 2 if path is None else 1  # depths of single frequencies are those out and back
        for number, depth in enumerate(depths(rays, path, expansion)):
            per_m = np.divide(depth, trips * traced, out=np.zeros_like(traced), where=traced > 0)
            back = np.empty_like(traced)
            for start in range(0, traced.size, BLOCK):
                some = slice(start, start + BLOCK)
                one = line.part(some)
                reach = tuple(values[some] for values in near_far)
                back[some] = self.echo.returned(number, hz, per_m[some], one, reach)
            for plane in np.flatnonzero(shares[:, number]):
                found[plane] += shares[plane, number] * back
        return replace(rays, contrast=found.reshape(rays.contrast.shape))

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that light is scattered."""
        return {"scattering": Work("", "what falls sends light back to the beam")}

    def memory(self) -> Memory:
        """Returns the echoes, and what their integrals take."""
        rays = self.ends.geometry.raster.rays
        return Memory((8 * rays * self.planes,), (8 * rays * 8, 16 * BLOCK * 16))
