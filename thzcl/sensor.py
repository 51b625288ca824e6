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
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pluggy
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from thzcl.air import radiometry
from thzcl.scenario.table import Table as Parameters
from thzcl.scenario.table import key as parameter
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

# Names of thzcl's own variables and dimensions in a result, which no layer of a sensor may take.
RESERVED_NAMES = frozenset(
    {
        *("variant", "frequency", "variant_frequency", "time", "model", "x", "y", "x_angle"),
        *("y_angle", "radiance", "brightness_temperature", "brightness_temperature_contrast"),
        *("optical_depth", "path_length", "target", "image", "image_difference"),
        *("image_variance", "image_spread", "absolute_humidity", "air_temperature"),
        *("x_voxel", "y_voxel", "z_voxel"),
    }
)


class Optics(Parameters):
    """What blurs the image: diffraction, the pixels' own size, and a Gaussian for all else.

    Applied to radiance (power, for an active sensor), at a gain of exactly 1 for a uniform scene.
    """

    aperture_m: float | None = parameter(
        None, ge=1e-6, unit="m", help="diameter of the circular aperture; none: no diffraction"
    )
    pixel: bool = parameter(True, help="average over the area of each pixel")
    blur_mrad: float | None = parameter(
        None, gt=0, unit="mrad", help="full width at half maximum of a Gaussian blur"
    )


@dataclass(frozen=True)
class View:
    """What a sensor may know of the scene before anything is traced.

    `absorption` gives that of the mean air in 1/m at frequencies in Hz, `table` the rows of numbers
    of a CSV file beside the scenario, `tolerance` the bearable error of a sum over frequency,
    relative to what the shortest path lets through.
    """

    pixels: tuple[int, int]  # width, height
    pixel_angle_rad: tuple[float, float]  # at the image centre
    air_temperature_k: float
    path_m: tuple[float, float]  # shortest and longest ray, about
    absorption: Callable[[Array], Array]
    lines_hz: Array  # where the air's lines are
    line_width_hz: float  # and how wide, about
    table: Callable[[str], Array]
    tolerance: float = bands.TOLERANCE


@dataclass(frozen=True)
class Needs:
    """What must be computed for a sensor. What is not asked for is left out.

    `weights` (band, frequency) ask for these sums over frequency only; rows are normalised to 1.
    `finer` holds frequencies and weights of the same bands, summed far more finely: the error
    budget compares. `transmitter_m` is where a transmitter stands, if not at the camera.
    `cutoff_depth` is the optical depth, one way, at which a ray ends; by default where the rest is
    worth 1e-7 of the air's radiance. `times_s` (sample, y, x) is when each pixel is taken; samples
    are averaged. `gain = "lambert"` multiplies each ray's echo by cos / (pi r^2), 1/m^2, of the
    surface that it meets, before rays are averaged into pixels or blurred. `errors` are known
    errors: part to relative size, and of what.
    """

    frequency_hz: ArrayLike  # one or several, ascending
    weights: ArrayLike | None = None
    reflection: bool = False  # echoes of a transmitter instead of emission
    transmitter_m: tuple[float, float, float] | None = None
    cutoff_depth: float | None = None
    slant: bool = False  # the cosine between ray and surface normal
    times_s: ArrayLike | None = None
    optics: Optics | None = None
    noise: bool = False  # whether observe() draws random numbers
    finer: tuple[ArrayLike, ArrayLike] | None = None
    errors: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    gain: Literal["none", "lambert"] = "none"


@dataclass(frozen=True)
class _Sight:
    """What every sensor gets; row 0 is the image's top, column 0 its left.

    Where weights were asked for, bands stand in place of frequencies: their mean frequency, mean
    radiance, and the depth of their mean transmission.
    """

    frequency_hz: Array  # (frequency,)
    optical_depth: NDArray[Any]  # (frequency, y, x), 1
    path_length: NDArray[Any]  # (y, x), m
    target: NDArray[Any]  # (y, x): 0 background, 1 ground, 2 and up the targets in file order
    cosine: NDArray[Any] | None  # (y, x), where asked for
    pixel_solid_angle: float  # sr, at the image centre
    nodes_hz: Array  # (node,): what was asked for
    weights: Array | None  # (frequency, node): as they were asked for


@dataclass(frozen=True)
class Radiances(_Sight):
    """What reaches each pixel of a passive sensor.

    Radiance is held as contrast to that of the mean air, so that microkelvins survive.
    """

    contrast: NDArray[Any]  # (frequency, y, x), W m-2 sr-1 Hz-1 above the air's
    air_radiance: Array  # (frequency,), W m-2 sr-1 Hz-1
    air_temperature_k: float

    @property
    def radiance(self) -> Array:
        """Returns spectral radiance, W m-2 sr-1 Hz-1, (frequency, y, x)."""
        return np.asarray(self.air_radiance[:, None, None] + self.contrast)

    @cached_property
    def brightness_temperature_contrast(self) -> Array:
        """Returns brightness temperature above the air's, K, (frequency, y, x)."""
        # A band's mean radiance differs a little from that at its mean frequency.
        share = radiometry.planck(self.frequency_hz, self.air_temperature_k) / self.air_radiance
        found = np.empty(self.contrast.shape)
        planes = zip(self.frequency_hz, share, self.contrast, found, strict=True)
        for frequency, factor, plane, out in planes:
            flat, into = plane.ravel(), out.ravel()
            for start in range(0, len(flat), _BLOCK):  # fits the cache: three times faster
                part = slice(start, start + _BLOCK)
                contrast = flat[part] if factor == 1 else flat[part] * factor
                into[part] = radiometry.brightness_temperature_contrast(
                    frequency, contrast, self.air_temperature_k
                )
        found.flags.writeable = False
        return found

    @property
    def brightness_temperature(self) -> Array:
        """Returns brightness temperature, K, (frequency, y, x)."""
        return self.air_temperature_k + self.brightness_temperature_contrast


@dataclass(frozen=True)
class Echoes(_Sight):
    """What comes back to each pixel of what a transmitter sends out.

    The optical depth is that of the way out and back. `returned` (frequency, y, x) is reflectivity
    times transmission out and back, 1; with `gain = "lambert"` in 1/m^2.
    """

    returned: NDArray[Any]
    outgoing_length: NDArray[Any]  # (y, x), m, from the transmitter to what the pixel shows


@dataclass(frozen=True)
class Layer:
    """A further image of a sensor, (y, x), by its netCDF variable name in Image.layers."""

    values: NDArray[Any]
    unit: str
    quantity: str


@dataclass(frozen=True)
class Image:
    """What a sensor records: values (y, x), their unit ("1" for none), and what they are.

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
