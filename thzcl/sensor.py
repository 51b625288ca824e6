"""What a sensor plugin sees: the public contract between thzcl and its sensors, version 1.

A sensor is a class with a `name`, the version of the `contract` it was written for, its parameters
`Params`, a manual page as docstring, `needs()` and `observe()`:

    from thzcl.sensor import Image, Needs, Parameters, Sensor, hookimpl, parameter

    class Thermometer(Sensor):
        \"\"\"Brightness temperature at one frequency.\"\"\"

        name = "thermometer"
        contract = 1

        class Params(Parameters):
            frequency_ghz: float = parameter(help="centre frequency", unit="GHz", gt=0)

        def needs(self, view):
            return Needs(frequency_hz=[self.params.frequency_ghz * 1e9])

        def observe(self, sight, rng):
            return Image(sight.brightness_temperature[0], unit="K", quantity="brightness temperature")

    @hookimpl
    def register_sensors():
        return [Thermometer]

It never sees OpenCL, files or the scene; `observe` is a pure function of what reaches the pixels
and of the random numbers. `thzcl new-sensor NAME` writes a package around such a class that can be
installed as it is.
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

from thzcl.air import radiometry
from thzcl.scenario import Table as Parameters
from thzcl.scenario import key as parameter
from thzcl.sensing import bands

__all__ = [
    "CONTRACT",
    "Echoes",
    "FrequenciesGHz",
    "FrequencyGHz",
    "Image",
    "Layer",
    "Needs",
    "Optics",
    "Parameters",
    "Radiances",
    "Sensor",
    "View",
    "bands",
    "hookimpl",
    "parameter",
    "radiometry",
]

CONTRACT = 1
_BLOCK = 32768  # pixels
Array = NDArray[np.float64]
FrequencyGHz = Annotated[float, Field(gt=0, le=1780)]  # as far as MPM93 goes
FrequenciesGHz = FrequencyGHz | Annotated[tuple[FrequencyGHz, ...], Field(min_length=1)]
hookimpl = pluggy.HookimplMarker("thzcl")


class Optics(Parameters):
    """What blurs the image before it is recorded: diffraction, the pixels' own size, and a Gaussian for all else.

    Applied to radiance (power, for an active sensor), at a gain of exactly 1 for a uniform scene.
    """

    aperture_m: float | None = parameter(
        None, gt=0, unit="m", help="diameter of the circular aperture; none: no diffraction"
    )
    pixel: bool = parameter(True, help="average over the area of each pixel")
    blur_mrad: float | None = parameter(
        None, gt=0, unit="mrad", help="full width at half maximum of a Gaussian blur"
    )


@dataclass(frozen=True)
class View:
    """What a sensor may know of the scene before anything is traced."""

    pixels: tuple[int, int]  # width, height
    pixel_angle_rad: tuple[float, float]  # at the image centre
    air_temperature_k: float
    path_m: tuple[float, float]  # shortest and longest ray, about
    absorption: Callable[[Array], Array]  # of the mean air, 1/m, at frequencies in Hz
    lines_hz: Array  # where its lines are
    line_width_hz: float  # and how wide, about
    table: Callable[[str], Array]  # rows of numbers of a CSV file beside the scenario
    tolerance: float = (
        bands.TOLERANCE
    )  # bearable error of a sum over frequency, of what the shortest path lets through


@dataclass(frozen=True)
class Needs:
    """What must be computed for a sensor. What is not asked for is left out."""

    frequency_hz: ArrayLike  # one or several, ascending
    weights: ArrayLike | None = (
        None  # (band, frequency): only these sums over frequency; rows are normalised to 1
    )
    reflection: bool = False  # echoes of a transmitter instead of emission
    transmitter_m: tuple[float, float, float] | None = (
        None  # where it stands; at the camera if None
    )
    cutoff_depth: float | None = (
        None  # one way; by default where the rest is worth 1e-7 of the air's radiance
    )
    slant: bool = False  # the cosine between ray and surface normal
    times_s: ArrayLike | None = (
        None  # (sample, y, x): when each pixel is taken; samples are averaged
    )
    optics: Optics | None = None
    noise: bool = False  # whether observe() draws random numbers
    finer: tuple[ArrayLike, ArrayLike] | None = (
        None  # frequencies and weights of the same bands, summed far more finely
    )
    errors: Mapping[str, tuple[float, str]] = field(
        default_factory=dict
    )  # known errors: part -> relative size, of what


@dataclass(frozen=True)
class _Sight:
    """What every sensor gets; shapes (frequency, y, x) or (y, x), row 0 the image's top, column 0 its left.

    Where weights were asked for, bands stand in place of frequencies: their mean frequency, mean radiance, and the depth of
    their mean transmission.
    """

    frequency_hz: Array  # (frequency,)
    optical_depth: NDArray[Any]  # 1
    path_length: NDArray[Any]  # (y, x), m
    target: NDArray[Any]  # (y, x): 0 background, 1 ground, 2 and up the targets in file order
    cosine: NDArray[Any] | None  # (y, x), where asked for
    pixel_solid_angle: float  # sr, at the image centre
    nodes_hz: Array  # (node,): what was asked for
    weights: Array | None  # (frequency, node): as they were asked for


@dataclass(frozen=True)
class Radiances(_Sight):
    """What reaches each pixel. Radiance is held as contrast to that of the mean air.

    So that microkelvins survive.
    """

    contrast: NDArray[Any]  # W m-2 sr-1 Hz-1 above the air's
    air_radiance: Array  # (frequency,), W m-2 sr-1 Hz-1
    air_temperature_k: float

    @property
    def radiance(self) -> Array:
        """Spectral radiance, W m-2 sr-1 Hz-1, (frequency, y, x)."""
        return np.asarray(self.air_radiance[:, None, None] + self.contrast)

    @cached_property
    def brightness_temperature_contrast(self) -> Array:
        """Brightness temperature above the air's, K, (frequency, y, x)."""
        # A band's mean radiance differs a little from that at its mean frequency.
        share = radiometry.planck(self.frequency_hz, self.air_temperature_k) / self.air_radiance
        found = np.empty(self.contrast.shape)
        for frequency, factor, plane, out in zip(
            self.frequency_hz, share, self.contrast, found, strict=True
        ):
            flat, into = plane.ravel(), out.ravel()
            for start in range(
                0, len(flat), _BLOCK
            ):  # small enough for the cache: three times faster
                part = slice(start, start + _BLOCK)
                contrast = flat[part] if factor == 1 else flat[part] * factor
                into[part] = radiometry.brightness_temperature_contrast(
                    frequency, contrast, self.air_temperature_k
                )
        return found

    @property
    def brightness_temperature(self) -> Array:
        """Brightness temperature, K, (frequency, y, x)."""
        return self.air_temperature_k + self.brightness_temperature_contrast


@dataclass(frozen=True)
class Echoes(_Sight):
    """What comes back to each pixel of what a transmitter sends out.

    The optical depth is that of the way out and back.
    """

    returned: NDArray[Any]  # reflectivity times transmission out and back, 1
    outgoing_length: NDArray[Any]  # (y, x), m, from the transmitter to what the pixel shows


@dataclass(frozen=True)
class Layer:
    """A further image of a sensor, (y, x), by its netCDF variable name in Image.layers."""

    values: NDArray[Any]
    unit: str
    quantity: str


@dataclass(frozen=True)
class Image:
    """What the sensor records: values (y, x), their unit ("1" for none), and what they are, in words.

    `facts` are numbers about the image, by name: value and unit.
    """

    values: NDArray[Any]
    unit: str
    quantity: str
    layers: Mapping[str, Layer] = field(default_factory=dict)
    facts: Mapping[str, tuple[float, str]] = field(default_factory=dict)


class Sensor(ABC):
    """Base of every sensor; `params` holds the validated [sensor] table."""

    name: ClassVar[str]
    contract: ClassVar[int]
    Params: ClassVar[type[Parameters]]
    wraps: ClassVar[bool] = False  # whether it takes another sensor, described in [sensor.detector]

    def __init__(self, params: Any, detector: Sensor | None = None) -> None:
        self.params = params
        self._detector = detector

    @property
    def detector(self) -> Sensor:
        """The sensor that this one wraps. Raises TypeError if it wraps none."""
        if self._detector is None:
            raise TypeError(f"{self.name} wraps no other sensor")
        return self._detector

    @abstractmethod
    def needs(self, view: View) -> Needs:
        """What must be computed.

        Raises ValueError where the parameters and the view do not fit together.
        """

    @abstractmethod
    def observe(self, sight: Any, rng: np.random.Generator) -> Image:
        """The image, from Radiances or Echoes. Draw every random number from `rng`."""
