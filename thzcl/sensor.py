"""The public contract between thzcl and its sensor plugins, version 1.

A sensor is a class with a `name`, the version of the `contract` that it was written for, its
parameters `Params`, a manual page as docstring, and the methods `needs()` and `observe()`:

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
            kelvin = sight.brightness_temperature[0]
            return Image(kelvin, unit="K", quantity="brightness temperature")

    @hookimpl
    def register_sensors():
        return [Thermometer]

A sensor never sees OpenCL, files or the scene; `observe` is a pure function of what reaches the
pixels and of the random numbers. `thzcl new-sensor NAME` writes a package around such a class,
which can be installed as it is.
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

from thzcl.air import planck_mean, radiometry
from thzcl.scenario.table import Table as Parameters
from thzcl.scenario.table import User
from thzcl.scenario.table import key as parameter
from thzcl.sensing import bands, noise, speckle

__all__ = [
    "CONTRACT",
    "Decibels",
    "Echoes",
    "FrequenciesGHz",
    "FrequencyGHz",
    "Image",
    "Layer",
    "Needs",
    "Optics",
    "Parameters",
    "PathReturn",
    "Radiances",
    "Sensor",
    "User",
    "View",
    "bands",
    "hookimpl",
    "noise",
    "parameter",
    "radiometry",
    "speckle",
]

CONTRACT = 1
_BLOCK = 32768  # pixels at once, which fit the cache: three times faster
Array = NDArray[np.float64]
FrequencyGHz = Annotated[float, Field(gt=0, le=bands.HIGHEST_GHZ)]  # the air's model may end below
FrequenciesGHz = FrequencyGHz | Annotated[tuple[FrequencyGHz, ...], Field(min_length=1)]
hookimpl = pluggy.HookimplMarker("thzcl")

# Names of thzcl's own variables and dimensions in a result, which no layer of a sensor may take;
# "time" and "model" are kept for sequences and for models that are compared.
RESERVED_NAMES = frozenset(
    {
        *("variant", "frequency", "variant_frequency", "time", "model", "x", "y", "x_angle"),
        *("y_angle", "radiance", "brightness_temperature", "brightness_temperature_contrast"),
        *("frequency_bounds", "bounds"),
        *("optical_depth", "path_length", "target", "image", "image_difference"),
        *("image_variance", "image_spread", "absolute_humidity", "air_temperature"),
        *("image_mean", "scintillation_index"),
        *("image_percentile_5", "image_percentile_50", "image_percentile_95"),
        *("x_voxel", "y_voxel", "z_voxel"),
    }
)


class Optics(Parameters):
    """What blurs the image: diffraction, the size of the pixels, and a Gaussian for all else.

    The blur is applied to radiance, or to power for an active sensor. It leaves a uniform scene
    exactly as it is.
    """

    aperture_m: float | None = parameter(
        None,
        ge=1e-6,
        le=1e3,
        unit="m",
        help="diameter of the circular aperture; none: no diffraction",
    )
    pixel: bool = parameter(True, help="average over the area of each pixel")
    blur_mrad: float | None = parameter(
        None, gt=0, le=3e3, unit="mrad", help="full width at half maximum of a Gaussian blur"
    )

    def grain(
        self,
        frequency_hz: float,
        pixel_rad: tuple[float, float],
        illumination: Literal["flood", "beam"] = "flood",
    ) -> speckle.Grain:
        """Returns the grain of speckle that these optics make in pixels of a width and a height.

        Raises ValueError without an aperture, which is what gives speckle its grain.
        """
        if self.aperture_m is None:
            raise ValueError("speckle has no grain without an aperture")
        sigma_rad = 0.0
        if self.blur_mrad is not None:
            sigma_rad = self.blur_mrad * 1e-3 / float(np.sqrt(8 * np.log(2)))
        aperture = self.aperture_m * frequency_hz / radiometry.LIGHT_SPEED
        return speckle.Grain(aperture, pixel_rad, illumination, self.pixel, sigma_rad)


@dataclass(frozen=True)
class View:
    """What a sensor may know of the scene before anything is traced.

    `absorption` is a function that gives the mean air's absorption in 1/m at frequencies in Hz.
    `table` is a function that gives the numbers, (row, column), of a CSV file beside the scenario.
    `tolerance` is the bearable error of a sum over frequency, relative to the radiance that passes
    the shortest path. `dwell_s` is how long a scan stays on each pixel of the sensor that it wraps.
    """

    pixels: tuple[int, int]  # width, height
    pixel_angle_rad: tuple[float, float]  # width, height, at the image centre
    air_temperature_k: float
    path_m: tuple[float, float]  # about the lengths of the shortest and the longest ray
    absorption: Callable[[Array], Array]
    lines_hz: Array  # centre frequencies of the air's lines
    line_width_hz: float  # about the width of the air's lines
    table: Callable[[str], Array]
    tolerance: float = bands.TOLERANCE
    dwell_s: float | None = None


@dataclass(frozen=True)
class PathReturn:
    """A beam by which rain, fog and snow send light back: one aperture sends and receives it.

    The beam is Gauss' of one mode, of an aperture `aperture_m` wide, and focused at `focus_m`, or
    where it is None at the distance of the point that the camera looks at. `gate_m` are the nearest
    and the farthest range received, in m from what a pixel shows on (negative: before it); a pixel
    that shows nothing has them from the focus on. Without a gate all ranges are received.
    """

    aperture_m: float
    focus_m: float | None = None
    gate_m: tuple[float, float] | None = None


@dataclass(frozen=True)
class Needs:
    """What must be computed for a sensor. Nothing else is computed.

    `weights` (band, frequency) ask for sums over frequency in place of single frequencies; each
    row is normalised to a sum of 1. `finer` holds frequencies and weights of the same bands, summed
    far more finely, with which the error budget compares. `transmitter_m` is the place of a
    transmitter that is not at the camera. `cutoff_depth` is the optical depth, one way, at which a
    ray ends; if it is None, rays end where the rest could add 1e-7 of the air's radiance. `times_s`
    (sample, y, x) says when each pixel is taken, in s; samples are averaged. With
    `gain = "lambert"` each ray's echo is multiplied by cos / (pi r^2), in 1/m^2, of the surface
    that it meets, before rays are averaged into pixels or blurred. `errors` are errors that the
    sensor knows, by name: each has a relative size, and words for what that is relative to.

    `bounds_hz` (band, 2) are the lowest and the highest frequency of each band.
    `integration_time_s` is how long the sensor integrates over a pixel, and `passband` the widths
    in Hz of the frequencies and the response at them, 1 at its peak: observe() gets both back.
    With `illumination = "beam"` one beam both lights and receives each pixel, and the optics see a
    point by the fourth power of its amplitude in place of the square. With such a beam, from a
    sensor at the camera, `path_return` asks for what drops and flakes on the way send back.
    `notes` are sentences for whoever runs the scene, shown among the warnings.
    """

    frequency_hz: ArrayLike  # one or several, ascending
    weights: ArrayLike | None = None
    reflection: bool = False  # echoes of a transmitter instead of emission
    transmitter_m: tuple[float, float, float] | None = None
    cutoff_depth: float | None = None
    slant: bool = False  # whether `cosine`, between ray and surface normal, is wanted
    times_s: ArrayLike | None = None
    optics: Optics | None = None
    noise: bool = False  # whether observe() draws random numbers
    finer: tuple[ArrayLike, ArrayLike] | None = None
    errors: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    gain: Literal["none", "lambert"] = "none"
    integration_time_s: float | None = None
    passband: tuple[ArrayLike, ArrayLike] | None = None
    bounds_hz: ArrayLike | None = None
    notes: tuple[str, ...] = ()
    illumination: Literal["flood", "beam"] = "flood"
    path_return: PathReturn | None = None


@dataclass(frozen=True)
class _Sight:
    """What every sensor gets; row 0 is the image's top, column 0 its left.

    If a sensor asks for weights, the axis "frequency" runs over its bands: `frequency_hz` is a
    band's mean frequency, radiance its mean radiance, and `optical_depth` that of its mean
    transmission.
    """

    frequency_hz: Array  # (frequency,)
    optical_depth: NDArray[Any]  # (frequency, y, x)
    path_length: NDArray[Any]  # (y, x), m
    target: NDArray[Any]  # (y, x): 0 background, 1 ground, 2 and up the targets in file order
    cosine: NDArray[Any] | None  # (y, x), None unless asked for
    pixel_solid_angle: float  # sr, at the image centre
    nodes_hz: Array  # (node,): the frequencies that were asked for
    weights: Array | None  # (frequency, node): the weights that were asked for
    pixel_angle_rad: tuple[float, float] = field(default=(0.0, 0.0), kw_only=True)  # as in View
    integration_time_s: float | None = field(default=None, kw_only=True)  # as in Needs
    passband: tuple[Array, Array] | None = field(default=None, kw_only=True)  # as in Needs
    bounds_hz: Array | None = field(default=None, kw_only=True)  # as in Needs

    @property
    def off_axis_cosine(self) -> Array:
        """Returns the cosine of the angle between each pixel's ray and the optical axis, (y, x)."""
        height, width = self.target.shape
        across = (np.arange(width) + 0.5 - width / 2) * self.pixel_angle_rad[0]
        down = (np.arange(height) + 0.5 - height / 2) * self.pixel_angle_rad[1]
        return np.asarray(1 / np.sqrt(1 + across**2 + down[:, None] ** 2))


@dataclass(frozen=True)
class Radiances(_Sight):
    """What reaches each pixel of a passive sensor.

    Radiance is stored as its difference from that of the mean air, so that microkelvins survive.
    """

    contrast: NDArray[Any]  # (frequency, y, x), W m-2 sr-1 Hz-1 above the air's
    air_radiance: Array  # (frequency,), W m-2 sr-1 Hz-1
    air_temperature_k: float

    @property
    def radiance(self) -> Array:
        """Returns the spectral radiance, W m-2 sr-1 Hz-1, (frequency, y, x)."""
        return np.asarray(self.air_radiance[:, None, None] + self.contrast)

    @cached_property
    def brightness_temperature_contrast(self) -> Array:
        """Returns the brightness temperature less the air's, K, (frequency, y, x).

        That of a band is the temperature whose Planck mean over the band is the radiance seen.
        """
        kelvin = np.empty(self.contrast.shape)
        for number, (plane, out) in enumerate(zip(self.contrast, kelvin, strict=True)):
            convert = self._to_kelvin(number, plane)
            flat, into = plane.ravel(), out.ravel()
            for start in range(0, len(flat), _BLOCK):
                part = slice(start, start + _BLOCK)
                into[part] = convert(flat[part])
        kelvin.flags.writeable = False
        return kelvin

    def _to_kelvin(self, number: int, plane: NDArray[Any]) -> Callable[[Array], Array]:
        """Returns the function from contrast to kelvins above the air, for one plane."""
        air_k = self.air_temperature_k
        if self.weights is None:
            hz = self.frequency_hz[number]
            return lambda part: radiometry.brightness_temperature_contrast(hz, part, air_k)
        mean = planck_mean.Mean(self.nodes_hz, self.weights[number], air_k)
        single, factor = mean.look_up(plane)

        def of_band(part: Array) -> Array:
            kelvin = mean.at_one_frequency(part)
            return np.asarray(kelvin * np.interp(kelvin, single, factor))

        return of_band

    @property
    def brightness_temperature(self) -> Array:
        """Returns the brightness temperature, K, (frequency, y, x)."""
        return self.air_temperature_k + self.brightness_temperature_contrast


@dataclass(frozen=True)
class Echoes(_Sight):
    """What comes back to each pixel of an active sensor from its transmitter.

    The optical depth is that of the way out and back. `returned` (frequency, y, x) is reflectivity
    times transmission out and back, without a unit; with `gain = "lambert"` it is in 1/m^2.
    `path_return` (frequency, y, x) is what drops and flakes on the way send back, in the unit of
    `returned`: with "lambert" the power over the power sent and over the area of the aperture,
    without it as a surface at the focus would have to reflect to be as bright. It is None unless
    asked for, and 0 where nothing falls.
    """

    returned: NDArray[Any]
    outgoing_length: NDArray[Any]  # (y, x), m, from the transmitter to what the pixel shows
    path_return: NDArray[Any] | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class Layer:
    """One more image of a sensor, (y, x); its key in Image.layers names it in the result file.

    `flags` are one word each for what the values 0, 1, 2 and so on mean, if they are flags.
    """

    values: NDArray[Any]
    unit: str
    quantity: str
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class Decibels:
    """Says that an image is a layer's power in decibels over a reference in the layer's unit.

    Values below the reference are at 0 dB. Means over realisations are then means of the power.
    """

    layer: str
    reference: float


@dataclass(frozen=True)
class Image:
    """What a sensor records: values (y, x), their unit ("1" for none) and their quantity.

    `layers` are further images by name, `facts` numbers about the image by name: value and unit.
    `decibels` says of which layer an image in decibels is made. `caption` are words for the heading
    of a picture, such as what noise the image has. `mean_over_frequencies` says that the image is
    the mean of the brightness temperatures at the sensor's frequencies, as they are: pictures then
    show each of them.
    """

    values: NDArray[Any]
    unit: str
    quantity: str
    layers: Mapping[str, Layer] = field(default_factory=dict)
    facts: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    decibels: Decibels | None = None
    caption: str = ""
    mean_over_frequencies: bool = False


class Sensor(ABC):
    """The base of every sensor; `params` holds the validated [sensor] table."""

    name: ClassVar[str]
    contract: ClassVar[int]
    Params: ClassVar[type[Parameters]]
    wraps: ClassVar[bool] = False  # whether it takes another sensor, described in [sensor.detector]

    def __init__(self, params: Any, detector: Sensor | None = None) -> None:
        self.params = params
        self._detector = detector

    @property
    def detector(self) -> Sensor:
        """Returns the sensor that this one wraps. Raises TypeError if it wraps none."""
        if self._detector is None:
            raise TypeError(f"{self.name} wraps no other sensor")
        return self._detector

    @abstractmethod
    def needs(self, view: View) -> Needs:
        """Returns what must be computed.

        Raises ValueError if the parameters and the view do not fit together.
        """

    @abstractmethod
    def observe(self, sight: Any, rng: np.random.Generator) -> Image:
        """Returns the image made from Radiances or Echoes.

        Every random number must be drawn from `rng`.
        """
