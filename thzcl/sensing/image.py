"""What a sensor records of what its pixels see."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.expansion import Expansion, ExpansionSpec, TrimmedSpec
from thzcl.device.opencl import Device
from thzcl.errors import PluginFailure
from thzcl.graph import LeftOut, Memory, Spec, Values, Work, frozen
from thzcl.scenario import sensors
from thzcl.scenario.scene import SensorChoice
from thzcl.sensing.pixels import Pixels, PixelsSpec, Places, PlacesSpec
from thzcl.sensing.spectrum import Spectrum
from thzcl.sensor import RESERVED_NAMES, Echoes, Image, Radiances
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.radiance import Emission, Sources

Sight = Radiances | Echoes


@dataclass(frozen=True)
class Recorded:
    """What reached the pixels, and the image of it; or, in words, why there is none."""

    sight: Sight
    image: Image | None
    failure: str | None


@frozen
class NoiseKey:
    """What random numbers of an image depend on; nothing else does."""

    seed: int
    variant: str  # the variant's name; empty where there is none
    realization: int = 0
    frame: int = 0

    def generator(self) -> np.random.Generator:
        """Returns the random numbers of this key."""
        name = hashlib.sha256(self.variant.encode()).digest()
        words = [self.seed, *np.frombuffer(name, "<u4").tolist(), self.realization, self.frame]
        return np.random.Generator(np.random.Philox(np.random.SeedSequence(words)))


@frozen
class ImageSpec(Spec):
    """What one sensor records of its pixels."""

    name: str
    pixels: PixelsSpec
    places: PlacesSpec
    sources: Sources
    spectrum: Spectrum
    sensor: SensorChoice  # the [sensor] table
    pixel_rad: tuple[float, float]  # width and height of a pixel at the image centre
    time_s: float | None  # how long the sensor integrates over a pixel, if it says so
    passband: tuple[Values, Values] | None  # widths and response, if the sensor says so
    bounds: Values | None  # of the bands, Hz, (band, 2), if the sensor says so
    noise: NoiseKey
    noisy: bool  # whether the sensor draws random numbers
    asks_echo: bool = False  # whether the sensor asks for what the air sends back
    echo: PixelsSpec | None = None  # what the air sends back, if anything
    reads = ("pixels", "places", "echo")
    stage = "sensor"

    @property
    def precision(self) -> str:
        """Returns the arithmetic on the device, and the type in which images are stored."""
        return self.places.ends.precision

    def run(self, device: Device, pixels: Pixels, places: Places, echo: Pixels | None) -> Recorded:
        """Returns what reached the sensor, and its image or what went wrong."""
        del device
        sight = replace(_sight(self, pixels, places, echo), integration_time_s=self.time_s)
        if self.passband is not None:
            widths, response = self.passband
            sight = replace(sight, passband=(widths.array, response.array))
        if self.bounds is not None:
            sight = replace(sight, bounds_hz=self.bounds.array)
        hole = _hole(sight, self.places.ends.geometry.frame, self.places.ends.geometry.raster)
        if hole:
            return Recorded(sight, None, f"{self.name}: {hole}; please report the scene")
        sensor = sensors.make(self.sensor.model_dump())
        stored = np.dtype(self.precision)
        rng = self.noise.generator()
        try:
            image = sensors.observe(sensor, sight, rng, stored, RESERVED_NAMES)
        except PluginFailure as failure:
            return Recorded(sight, None, f"{self.name}: {failure}")
        return Recorded(sight, image, None)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns whether noise is drawn."""
        drawn = Work("", "drawn by the sensor, from the seed")
        return {"noise": drawn if self.noisy else LeftOut("a noiseless sensor")}

    def memory(self) -> Memory:
        """Returns the planes of what reaches the sensor, and of its image."""
        height, width = self.pixels.steps.pixels
        pixels, real = height * width, np.dtype(self.precision).itemsize
        values = pixels * self.spectrum.count
        # Depth, contrast, and the kelvins of that; places, and the image with as large a layer.
        return Memory((real * values,) * 2 + (8 * values, 12 * pixels, 16 * pixels), (16 * values,))


@dataclass(frozen=True)
class Compared:
    """What reached the pixels by a model to compare with.

    `planes` are the numbers of the image's planes at which the model is valid, and `error` is that
    of its fit, relative to the mean air's absorption. `failure` says in words where something is
    not a number.
    """

    model: str
    planes: tuple[int, ...]
    sight: Sight
    error: float
    failure: str | None


@frozen
class ComparedSpec(Spec):
    """What reaches the pixels if a model to compare with says what the gas absorbs."""

    model: str
    planes: tuple[int, ...]
    pixels: PixelsSpec
    places: PlacesSpec
    expansion: ExpansionSpec | TrimmedSpec
    sources: Sources
    spectrum: Spectrum  # of these planes
    pixel_rad: tuple[float, float]  # width and height of a pixel at the image centre
    asks_echo: bool = False  # whether the sensor asks for what the air sends back
    echo: PixelsSpec | None = None  # what the air sends back, if anything
    reads = ("pixels", "places", "expansion", "echo")
    stage = "shading"

    def run(
        self,
        device: Device,
        pixels: Pixels,
        places: Places,
        expansion: Expansion,
        echo: Pixels | None,
    ) -> Compared:
        """Returns what reached the pixels."""
        del device
        sight = _sight(self, pixels, places, echo)
        hole = _hole(sight, self.places.ends.geometry.frame, self.places.ends.geometry.raster)
        failure = f'by "{self.model}" {hole}; please report the scene' if hole else None
        return Compared(self.model, self.planes, sight, expansion.error, failure)

    def memory(self) -> Memory:
        """Returns the planes of what reaches the pixels."""
        height, width = self.pixels.steps.pixels
        values = height * width * self.spectrum.count
        return Memory((np.dtype(self.places.ends.precision).itemsize * values,) * 2 + (8 * values,))


def _sight(
    image: ImageSpec | ComparedSpec, pixels: Pixels, places: Places, echo: Pixels | None
) -> Sight:
    """Returns what reaches the pixels of an image, as sensors take it."""
    spectrum, sources, precision = image.spectrum, image.sources, image.places.ends.precision
    nodes = spectrum.nodes_hz.array
    common = (
        np.asarray(spectrum.planes(nodes)),
        np.asarray(pixels.depth, precision),
        np.asarray(places.path_length, precision),
        places.target,
        None if places.cosine is None else np.asarray(places.cosine, precision),
        math.prod(image.pixel_rad),
        nodes,
        spectrum.asked(),
    )
    angles = image.pixel_rad
    if isinstance(sources, Emission):
        air = np.asarray(spectrum.planes(radiometry.planck(nodes, sources.air_k)))
        air_k = sources.air_k
        return Radiances(*common, pixels.contrast, air, air_k, pixel_angle_rad=angles)
    outgoing = np.asarray(places.outgoing_length, precision)
    found = Echoes(*common, pixels.contrast, outgoing, pixel_angle_rad=angles)
    if not image.asks_echo:
        return found
    shape = found.optical_depth.shape
    back = np.zeros(shape, precision) if echo is None else np.asarray(echo.contrast, precision)
    return replace(found, path_return=back)


def _hole(sight: Sight, frame: Values, rays: Raster) -> str | None:
    """Returns the first pixel that is not a number, and its ray, in words; None if all are."""
    signal = sight.returned if isinstance(sight, Echoes) else sight.contrast
    planes: list[NDArray[Any]] = [sight.optical_depth, signal]
    if isinstance(sight, Echoes) and sight.path_return is not None:
        planes.append(sight.path_return)
    if all(np.isfinite(plane.sum(dtype=np.float64)) for plane in planes):
        return None
    bad = ~np.all([np.isfinite(plane).all(axis=0) for plane in planes], axis=0)
    if not bad.any():
        return None
    row, column = (int(n) for n in np.argwhere(bad)[0])
    position, forward, right, up = frame.array
    across = (column + 0.5) * rays.block[1] + rays.margin - 0.5 * rays.columns
    above = 0.5 * rays.rows - rays.margin - (row + 0.5) * rays.block[0]
    x, y, z = forward + across * right + above * up
    a, b, c = position
    return (
        f"{int(bad.sum())} pixels are not finite numbers; the first is row {row}, column {column}, "
        f"whose ray runs from ({a:g}, {b:g}, {c:g}) m along ({x:.6g}, {y:.6g}, {z:.6g})"
    )
