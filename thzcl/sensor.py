"""What a sensor plugin sees: the public contract between thzcl and its sensors.

A sensor is a class with a `name`, its parameters `Params`, a manual page as docstring, `needs()` and `observe()`:

    from thzcl.sensor import Image, Needs, Parameters, Sensor, hookimpl, parameter

    class Thermometer(Sensor):
        \"\"\"Brightness temperature at one frequency.\"\"\"

        name = "thermometer"

        class Params(Parameters):
            frequency_ghz: float = parameter(help="centre frequency", unit="GHz", gt=0)

        def needs(self, view):
            return Needs(frequency_hz=[self.params.frequency_ghz * 1e9])

        def observe(self, radiances, rng):
            return Image(radiances.brightness_temperature[0], unit="K", quantity="brightness temperature")

    @hookimpl
    def register_sensors():
        return [Thermometer]

It never sees OpenCL, files or the scene; `observe` is a pure function of the radiances and the random generator.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
import pluggy
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from thzcl import radiometry
from thzcl.scenario import Table as Parameters
from thzcl.scenario import key as parameter

__all__ = [
    "FrequenciesGHz",
    "FrequencyGHz",
    "Image",
    "Layer",
    "Needs",
    "Parameters",
    "Radiances",
    "Sensor",
    "View",
    "hookimpl",
    "parameter",
]

Array = NDArray[np.float64]
FrequencyGHz = Annotated[float, Field(gt=0, le=1780)]  # as far as MPM93 goes
FrequenciesGHz = FrequencyGHz | Annotated[tuple[FrequencyGHz, ...], Field(min_length=1)]
hookimpl = pluggy.HookimplMarker("thzcl")


@dataclass(frozen=True)
class View:
    """What a sensor may know of the scene before anything is traced."""

    pixels: tuple[int, int]  # width, height
    pixel_angle_rad: tuple[float, float]  # at the image centre
    air_temperature_k: float
    longest_path_m: float
    absorption: Callable[[Array], Array]  # of the mean air, 1/m, at frequencies in Hz


@dataclass(frozen=True)
class Needs:
    """What must be computed for a sensor."""

    frequency_hz: ArrayLike  # one or several, ascending


@dataclass(frozen=True)
class Radiances:
    """What reaches each pixel, shapes (frequency, y, x) or (y, x); row 0 is the image's top, column 0 its left.

    Radiance is held as contrast to the black-body radiance of the mean air, so that microkelvins survive.
    """

    frequency_hz: Array  # (frequency,)
    contrast: NDArray[Any]  # W m-2 sr-1 Hz-1 above the air's
    optical_depth: NDArray[Any]  # 1
    path_length: NDArray[Any]  # (y, x), m
    target: NDArray[Any]  # (y, x): 0 background, 1 ground, 2 and up the targets in file order
    air_temperature_k: float

    @property
    def radiance(self) -> Array:
        """Spectral radiance, W m-2 sr-1 Hz-1, (frequency, y, x)."""
        return np.asarray(radiometry.planck(self.frequency_hz[:, None, None], self.air_temperature_k) + self.contrast)

    @cached_property
    def brightness_temperature_contrast(self) -> Array:
        """Brightness temperature above the air's, K, (frequency, y, x)."""
        frequency = self.frequency_hz[:, None, None]
        return radiometry.brightness_temperature_contrast(frequency, self.contrast, self.air_temperature_k)

    @property
    def brightness_temperature(self) -> Array:
        """Brightness temperature, K, (frequency, y, x)."""
        return self.air_temperature_k + self.brightness_temperature_contrast


@dataclass(frozen=True)
class Layer:
    """A further image of a sensor, (y, x), by its netCDF variable name in Image.layers."""

    values: NDArray[Any]
    unit: str
    quantity: str


@dataclass(frozen=True)
class Image:
    """What the sensor records: values (y, x), their unit ("1" for none), and what they are, in words."""

    values: NDArray[Any]
    unit: str
    quantity: str
    layers: Mapping[str, Layer] = field(default_factory=dict)


class Sensor(ABC):
    """Base of every sensor; `params` holds the validated [sensor] table."""

    name: ClassVar[str]
    Params: ClassVar[type[Parameters]]

    def __init__(self, params: Any) -> None:
        self.params = params

    @abstractmethod
    def needs(self, view: View) -> Needs:
        """What must be computed."""

    @abstractmethod
    def observe(self, radiances: Radiances, rng: np.random.Generator) -> Image:
        """The image, from what reaches the pixels. Draw every random number from `rng`."""
