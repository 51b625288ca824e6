"""What falls through the air adds its light to rays: what it scatters into them, and emits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, ExpansionSpec
from thzcl.air.scattering import mean_transmission
from thzcl.air.weather import Weather
from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Memory, Spec, Work, frozen
from thzcl.paths.emission import Carried
from thzcl.paths.specs import AnyPath, EmissionSpec
from thzcl.paths.trace import Paths
from thzcl.sensing.air_echo import AirEchoSpec
from thzcl.sensing.spectrum import Bands, Spectrum
from thzcl.sensing.transfer import (
    CarriedSpec,
    LambertSpec,
    Rays,
    ShadeSpec,
    depths,
    elevations,
)
from thzcl.surfaces.ends import EndsSpec

Array = NDArray[Any]


@frozen
class WeatherSpec(Spec):
    """Rays with the light that what falls scatters into them, and emits.

    Bands need depths by frequency, which they sum up: `path` has them, with `expansion` unless it
    carries them. Both are None for single frequencies.
    """

    rays: ShadeSpec | CarriedSpec
    weather: Weather
    spectrum: Spectrum
    path: AnyPath | EmissionSpec | None
    expansion: ExpansionSpec | None
    reads = ("rays", "path", "expansion")
    stage = "scattering"

    @classmethod
    def of(cls, rays: ShadeSpec | CarriedSpec, weather: Weather) -> WeatherSpec:
        """Returns the rays with what weather adds."""
        if not isinstance(rays.spectrum, Bands):
            return cls(rays, weather, rays.spectrum, None, None)
        if isinstance(rays, CarriedSpec):
            return cls(rays, weather, rays.spectrum, rays.back, None)
        return cls(rays, weather, rays.spectrum, rays.path, rays.expansion)

    @property
    def ends(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.rays.ends

    @property
    def planes(self) -> int:
        """Returns how many frequencies or bands there are."""
        return self.rays.planes

    def run(
        self,
        device: Device,
        rays: Rays,
        path: Paths | Carried | None,
        expansion: Expansion | None,
    ) -> Rays:
        """Returns the rays with a new contrast."""
        del device
        hz, length = self.spectrum.nodes_hz.array, rays.reached[0].ravel().astype(np.float64)
        sine, start_m = elevations(self.ends.geometry)
        height = start_m + sine * length / 2
        look_up = self.weather.look_up(hz, sine, height)
        added = np.zeros((self.planes, length.size))
        shares = self.spectrum.planes(np.eye(len(hz)))  # (plane, node)
        for number, depth in enumerate(depths(rays, path, expansion)):
            seen = look_up.at(number, sine, height) * length * mean_transmission(depth)
            for plane in np.flatnonzero(shares[:, number]):
                added[plane] += shares[plane, number] * seen
        contrast = rays.contrast + added.reshape(rays.contrast.shape)
        return replace(rays, contrast=contrast.astype(rays.contrast.dtype))

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that light is scattered."""
        return {"scattering": Work("", "what falls scatters light into rays, and emits")}

    def memory(self) -> Memory:
        """Returns the new contrast, and what it is made of."""
        rays = self.ends.geometry.raster.rays
        real = np.dtype(self.ends.precision).itemsize
        return Memory((real * rays * self.planes,), (8 * rays * (self.planes + 12),))


AnyRays = ShadeSpec | CarriedSpec | LambertSpec | WeatherSpec | AirEchoSpec
