"""What a scenario needs computed, and what it does not: made on the host, from scenario and sensors alone, no device touched.

Variants share every stage that their differences do not reach: those whose rays are the same share the surfaces found, and
those whose fluctuations are the same too share the field and, in isothermal air, the trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thzcl import files
from thzcl.air import radiometry
from thzcl.air.expansion import Surrogate, fit
from thzcl.air.mean import Air
from thzcl.air.mpm93 import REFUSED_ABOVE_GHZ, line_centers_ghz, line_width_ghz
from thzcl.plan.numerics import Accuracy, AirAlong, Rays
from thzcl.plan import numerics as accuracy
from thzcl.plugins.loader import SensorFailure
from thzcl.plugins import loader as plugins
from thzcl.scenario import Scenario, Scene
from thzcl.sensing import bands, optics
from thzcl.sensor import Needs, Sensor, View
from thzcl.surfaces import geometry
from thzcl.surfaces.geometry import Geometry, Surface
from thzcl.turbulence.cube_file import CubeFile
from thzcl.turbulence import spectrum_table
from thzcl.turbulence.spectra import Turbulence, turbulence
from thzcl.turbulence import cube_file as field_file

Array = NDArray[np.float64]
Span = tuple[float, float]

DEPTH_CHECKED_EVERY = 16  # voxels, where rays can reach the cut-off depth
EMISSION_AT_ONCE = 8  # frequencies that one pass through fluctuating temperature carries


class PlanError(ValueError):
    """A scenario cannot be run as it is; the text says why."""


@dataclass(frozen=True)
class FieldPlan:
    """A cube, generated or read; `ceiling` is the largest delta that the air's pressure admits.

    Where that is in reach.
    """

    source: Turbulence | CubeFile
    ceiling: float
    mean: tuple[float, float] | None  # g/m3 and K that a cube from a file is measured against

    @property
    def temperature_fluctuates(self) -> bool:
        """Whether the cube has a temperature of its own."""
        if isinstance(self.source, Turbulence):
            return self.source.temperature_fluctuates
        return self.source.temperature_span_k is not None

    def spans(self) -> tuple[Span, Span]:
        """Ranges of delta and of the temperature's departure: a file's own.

        Or left with probability 1e-6.
        """
        if isinstance(self.source, Turbulence):
            return self.source.humidity_span(), self.source.temperature_span()
        mean_g_m3, mean_k = self.mean or (1.0, 0.0)
        low, high = (value / mean_g_m3 - 1 for value in self.source.humidity_span_g_m3)
        warmth = self.source.temperature_span_k
        return (low, high), (0.0, 0.0) if warmth is None else (
            warmth[0] - mean_k,
            warmth[1] - mean_k,
        )


@dataclass(frozen=True)
class VariantPlan:
    """One image: its scene and sensor, the rays, surfaces and cube.

    And the polynomial planned for its air.
    """

    name: str
    scene: Scene
    sensor: Sensor
    needs: Needs
    frequency_hz: Array
    weights: Array | None  # (band, frequency), rows of sum 1
    geometry: Geometry
    surfaces: list[Surface]
    field: FieldPlan | None
    surrogate: Surrogate
    accuracy: Accuracy

    @property
    def isothermal(self) -> bool:
        """Whether all its air has one temperature."""
        return self.field is None or not self.field.temperature_fluctuates

    @property
    def precision(self) -> str:
        """Arithmetic on the device."""
        return self.accuracy.precision

    @property
    def stride(self) -> int:
        """Every so many rays are traced, both ways; all where interpolating would not do."""
        return (
            self.accuracy.stride
            if self.field is not None and self.isothermal and self.times_s is None
            else 1
        )

    @property
    def orientation(self) -> str:
        """Of the cube against the world."""
        fluctuations = self.scene.atmosphere.fluctuations
        return fluctuations.grid_orientation if fluctuations else "aligned"

    @property
    def wind_m_s(self) -> Array:
        """What carries the cube along."""
        fluctuations = self.scene.atmosphere.fluctuations
        return np.array(fluctuations.wind_m_s if fluctuations else (0.0, 0.0, 0.0))

    @cached_property
    def times_s(self) -> Array | None:
        """When each pixel is taken, (sample, y, x); None where that makes no difference."""
        if self.needs.times_s is None or self.field is None or not self.wind_m_s.any():
            return None
        times = np.asarray(self.needs.times_s, dtype=np.float64)
        return np.broadcast_to(times, (len(times), *self.geometry.raster.pixels))

    @cached_property
    def transmission_weights(self) -> Array | None:
        """What a band's mean transmission is weighted with: for emission.

        The power that the air's temperature makes.
        """
        if self.weights is None or self.needs.reflection:
            return self.weights
        return normalised(
            self.weights * radiometry.planck(self.frequency_hz, self.scene.atmosphere.temperature_k)
        )

    @property
    def pixel_rad(self) -> tuple[float, float]:
        """Width and height of a pixel at the image centre."""
        return pixel_angles(self.scene)

    @property
    def thinnest(self) -> float:
        """The mean air's absorption at the frequency where it is least, 1/m."""
        return float(self.surrogate.coefficients[:, 0, 0].min())

    @property
    def rays_key(self) -> object:
        """Equal for variants whose rays end at the same places."""
        return self.geometry.key, self.precision, self.needs.transmitter_m, self.needs.slant

    @cached_property
    def path_key(self) -> object:
        """Equal for variants that share cube and trace.

        Path emission belongs to one air and one set of surfaces.
        """
        times = None if self.times_s is None else (self.times_s.tobytes(), self.wind_m_s.tobytes())
        return (
            self.rays_key,
            self.field,
            self.orientation,
            times,
            "" if self.isothermal else self.name,
        )


@dataclass(frozen=True)
class Group:
    """Variants that share one trace; or, with a single variant in fluctuating temperature.

    One pass of path emission.
    """

    variants: tuple[VariantPlan, ...]

    @property
    def first(self) -> VariantPlan:
        """Any of them, for what they share."""
        return self.variants[0]

    @property
    def moments(self) -> int:
        """Path moments that serve all of them."""
        return max(variant.surrogate.moments for variant in self.variants)

    @property
    def thinnest(self) -> VariantPlan:
        """The variant whose rays grow deep last."""
        return min(self.variants, key=lambda variant: variant.thinnest)

    @property
    def cutoff(self) -> float:
        """Optical depth at which a ray is of no more use to any of them."""
        return max(variant.accuracy.cutoff for variant in self.variants)

    @property
    def stride(self) -> int:
        """Every so many rays are traced, both ways: as few as serve all."""
        return min(variant.stride for variant in self.variants)

    @cached_property
    def sample(self) -> Rays:
        """A few thousand rays, the cut-off not regarded."""
        return sample_rays(self.first.geometry)

    @property
    def visible_m(self) -> float:
        """How far the rays of all of them reach in mean air before the cut-off depth."""
        thinnest = self.thinnest.thinnest
        return self.cutoff / thinnest if thinnest > 0 else math.inf

    @property
    def cut(self) -> bool:
        """Whether rays reach the cut-off depth, so that their depth must be watched."""
        return float(self.sample.length.max()) >= self.visible_m

    @property
    def passes(self) -> int:
        """How often its rays go through the cube."""
        first = self.first
        ways = 2 if first.needs.transmitter_m is not None else 1
        samples = 1 if first.times_s is None else len(first.times_s)
        return (
            ways
            * samples
            * (1 if first.isothermal else -(-len(first.frequency_hz) // EMISSION_AT_ONCE))
        )


@dataclass(frozen=True)
class Plan:
    """Everything that a run will do."""

    scenario: Scenario
    variants: tuple[VariantPlan, ...]

    @cached_property
    def groups(self) -> list[Group]:
        """The variants by what they trace together, in order of first appearance."""
        return [
            Group(tuple(some))
            for some in by_key(self.variants, lambda variant: variant.path_key).values()
        ]

    @property
    def realizations(self) -> int:
        """Independent realisations of the air, of which the mean image is wanted."""
        return self.variants[0].scene.numerics.realizations

    @property
    def frequency_hz(self) -> Array:
        """Every frequency of every variant."""
        return np.array(
            sorted({*np.concatenate([variant.frequency_hz for variant in self.variants])})
        )

    @property
    def moments(self) -> int:
        """The most path moments of any variant."""
        return max(variant.surrogate.moments for variant in self.variants)

    @property
    def surrogate_error(self) -> float:
        """Bound relative to the mean air's absorption."""
        return max(variant.surrogate.error for variant in self.variants)


Item = TypeVar("Item")


def by_key(items: Iterable[Item], key: Callable[[Item], object]) -> dict[object, list[Item]]:
    """Items by a key, in order of first appearance."""
    found: dict[object, list[Item]] = {}
    for item in items:
        found.setdefault(key(item), []).append(item)
    return found


def make_plan(scenario: Scenario, sensors: list[Sensor]) -> Plan:
    """The plan of a scenario whose variants have the given sensors.

    Raises PlanError for files that cannot be used and for what a sensor cannot work with,
    SensorFailure where it breaks.
    """
    planned = [
        _plan_variant(scenario, variant.name, variant.scene, sensor)
        for variant, sensor in zip(scenario.variants, sensors, strict=True)
    ]
    return Plan(scenario, tuple(planned))


def _plan_variant(scenario: Scenario, name: str, scene: Scene, sensor: Sensor) -> VariantPlan:
    plain = geometry.raster(scene.camera)
    air = scene.atmosphere.air
    try:
        shape, surfaces = geometry.geometry(scene, scenario.locate, plain)
        field = _plan_field(scenario, scene, air)
    except ValueError as error:
        raise PlanError(f"{scenario.name}: {error}") from None
    needs = _needs(sensor, _view(scene, air, shape, scenario), scenario.name)
    frequency_hz = np.asarray(needs.frequency_hz, dtype=np.float64)
    if needs.optics is not None:
        rays = optics.sampling(needs.optics, plain, pixel_angles(scene), frequency_hz)
        shape = replace(shape, raster=rays, frame=geometry.camera_frame(scene.camera, rays))
    weights = None if needs.weights is None else normalised(needs.weights)
    settled = accuracy.settle(
        scene,
        needs,
        surfaces,
        frequency_hz,
        weights,
        sample_rays(shape),
        _air_along(scene, field, air, frequency_hz, shape),
    )
    spans = field.spans() if field else ((0.0, 0.0), (0.0, 0.0))
    surrogate = fit(
        air, frequency_hz, *spans, tolerance=settled.surrogate, moments=scene.numerics.moments
    )
    return VariantPlan(
        name,
        scene,
        sensor,
        needs,
        frequency_hz,
        weights,
        shape,
        surfaces,
        field,
        surrogate,
        settled,
    )


def _air_along(
    scene: Scene, field: FieldPlan | None, air: Air, frequency_hz: Array, shape: Geometry
) -> AirAlong:
    """What the plan knows of the air that rays cross."""
    absorption = air.absorption(frequency_hz)
    step = 1e-3
    slope = (air.absorption(frequency_hz, step) - absorption) / step
    source = field.source if field is not None and isinstance(field.source, Turbulence) else None
    fluctuations = scene.atmosphere.fluctuations
    turn = geometry.ROTATIONS[fluctuations.grid_orientation if fluctuations else "aligned"]
    apart = max(
        angle / n
        for angle, n in zip(pixel_angles(scene), reversed(shape.raster.block), strict=True)
    )
    return AirAlong(absorption, slope, source, turn, apart, shape.raster)


def normalised(weights: ArrayLike) -> Array:
    """Weights of bands, (band, frequency), with rows of sum 1."""
    rows = np.atleast_2d(np.asarray(weights, dtype=np.float64))
    return np.asarray(rows / rows.sum(axis=1, keepdims=True))


def pixel_angles(scene: Scene) -> tuple[float, float]:
    """Width and height of a pixel at the image centre, rad."""
    camera = scene.camera
    width, height = (
        s / camera.focal_length_mm / n
        for s, n in zip(camera.focal_plane_mm, camera.pixels, strict=True)
    )
    return width, height


@lru_cache(maxsize=16)  # variants often have their geometry in common
def sample_rays(shape: Geometry) -> Rays:
    """A few thousand rays; variants that have them in common ask once."""
    rows, columns = (
        np.arange(n)
        if n <= accuracy.SAMPLED
        else np.linspace(0, n - 1, accuracy.SAMPLED).astype(np.int64)
        for n in (shape.raster.rows, shape.raster.columns)
    )
    direction = geometry.directions(
        shape, np.repeat(rows, len(columns)), np.tile(columns, len(rows))
    )
    norm = np.linalg.norm(direction, axis=1)
    reach, surface = geometry.first_met(shape, direction)
    return Rays(direction / norm[:, None], reach * norm, surface)


def _needs(sensor: Sensor, view: View, name: str) -> Needs:
    """What a sensor asks for, checked."""

    def failed(reason: str) -> SensorFailure:
        return SensorFailure(f"{plugins.describe(sensor.name)}: {reason}")

    try:
        needs = sensor.needs(view)
    except ValueError as error:
        raise PlanError(f"{name}: [sensor] {error}") from None
    except Exception as error:  # whatever a stranger's sensor raises
        raise failed(f"{type(error).__name__}: {error}") from error
    if not isinstance(needs, Needs):
        raise failed(f"needs() returned {type(needs).__name__} instead of Needs")
    frequency = np.asarray(needs.frequency_hz, dtype=np.float64)
    if (
        frequency.ndim != 1
        or not frequency.size
        or not (np.isfinite(frequency).all() and (np.diff(frequency) > 0).all())
    ):
        raise failed("needs() asked for frequencies that are not a list of ascending numbers in Hz")
    if not 0 < frequency[0] <= frequency[-1] <= REFUSED_ABOVE_GHZ * 1e9:
        raise PlanError(
            f"{name}: [sensor] asks for {frequency[-1] / 1e9:g} GHz; MPM93 ends at {REFUSED_ABOVE_GHZ:g} GHz"
        )
    if needs.weights is not None and np.shape(np.atleast_2d(np.asarray(needs.weights)))[1] != len(
        frequency
    ):
        raise failed("needs() gave weights of another length than its frequencies")
    return needs


def _view(scene: Scene, air: Air, shape: Geometry, scenario: Scenario) -> View:
    lengths = sample_rays(shape).length
    paths = float(lengths.min()), float(lengths.max())
    pixels, angles = scene.camera.pixels, pixel_angles(scene)
    lines_hz, width_hz = line_centers_ghz() * 1e9, line_width_ghz(air.pressure_hpa) * 1e9
    read = lambda name: files.read_table(scenario.locate(name))  # noqa: E731 (a view's one verb)
    bearable = scene.numerics.tolerance
    tolerance = bands.TOLERANCE if bearable is None else accuracy.BAND * bearable
    return View(
        pixels,
        angles,
        air.temperature_k,
        paths,
        air.absorption,
        lines_hz,
        width_hz,
        read,
        tolerance,
    )


def _plan_field(scenario: Scenario, scene: Scene, air: Air) -> FieldPlan | None:
    """The cube, or None where nothing that matters fluctuates."""
    if air.model == "none":
        return None
    fluctuations = scene.atmosphere.fluctuations
    table = None
    if fluctuations is not None and fluctuations.file is not None:
        if fluctuations.spectrum == "file":
            cube = field_file.inspect(scenario.folder / fluctuations.file, fluctuations.voxel_m)
            return FieldPlan(cube, air.most_vapour, (air.absolute_humidity_g_m3, air.temperature_k))
        table = spectrum_table.read(scenario.locate(fluctuations.file))
    source = turbulence(scene.atmosphere, table)
    if source is None or not (
        source.temperature_fluctuates or (source.sigma > 0 and air.absolute_humidity_g_m3 > 0)
    ):
        return None
    # Only where the ceiling is within reach does it tell apart the cubes of two climates.
    bites = source.humidity_span()[1] > air.most_vapour
    return FieldPlan(source, air.most_vapour if bites else math.inf, None)
