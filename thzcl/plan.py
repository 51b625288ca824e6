"""What a scenario needs computed, and what it does not: made on the host, from scenario and sensors alone, no device touched.

Variants share every stage that their differences do not reach: those whose rays are the same share the surfaces found, and
those whose fluctuations are the same too share the field and, in isothermal air, the trace.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from thzcl import field_file, geometry, radiometry
from thzcl.absorption import Air, Surrogate, fit
from thzcl.field_file import CubeFile
from thzcl.geometry import Geometry, Surface
from thzcl.scenario import Scenario, Scene
from thzcl.sensor import Needs, Sensor, View
from thzcl.turbulence import Turbulence, turbulence

Array = NDArray[np.float64]
Span = tuple[float, float]

SURROGATE_TOLERANCE = {"float32": 1e-7, "float64": 1e-13}  # below what the arithmetic adds along a path
NEGLIGIBLE = 1e-7  # of the air's radiance: what a ray past its cut-off depth could still show
SMALLEST_CUTOFF = 16.0
DEPTH_CHECKED_EVERY = 16  # voxels, where rays can reach the cut-off depth
EMISSION_AT_ONCE = 8  # frequencies that one pass through fluctuating temperature carries


@dataclass(frozen=True)
class FieldPlan:
    """A cube, generated or read; `ceiling` is the largest delta that the air's pressure admits, where that is in reach."""

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
        """Ranges of delta and of the temperature's departure: a file's own, or left with probability 1e-6."""
        if isinstance(self.source, Turbulence):
            return self.source.humidity_span(), self.source.temperature_span()
        mean_g_m3, mean_k = self.mean or (1.0, 0.0)
        low, high = (value / mean_g_m3 - 1 for value in self.source.humidity_span_g_m3)
        warmth = self.source.temperature_span_k
        return (low, high), (0.0, 0.0) if warmth is None else (warmth[0] - mean_k, warmth[1] - mean_k)


@dataclass(frozen=True)
class VariantPlan:
    """One image: its scene and sensor, the rays, surfaces and cube, and the polynomial planned for its air."""

    name: str
    scene: Scene
    sensor: Sensor
    needs: Needs
    frequency_hz: Array
    geometry: Geometry
    surfaces: list[Surface]
    field: FieldPlan | None
    surrogate: Surrogate
    cutoff: float  # optical depth at which its rays end

    @property
    def isothermal(self) -> bool:
        """Whether all its air has one temperature."""
        return self.field is None or not self.field.temperature_fluctuates

    @property
    def precision(self) -> str:
        """Arithmetic on the device."""
        return self.scene.numerics.precision

    @property
    def orientation(self) -> str:
        """Of the cube against the world."""
        fluctuations = self.scene.atmosphere.fluctuations
        return fluctuations.grid_orientation if fluctuations else "aligned"

    @property
    def thinnest(self) -> float:
        """The mean air's absorption at the frequency where it is least, 1/m."""
        return float(self.surrogate.coefficients[:, 0, 0].min())

    @property
    def rays_key(self) -> object:
        """Equal for variants whose rays end at the same places."""
        return self.geometry.key, self.precision

    @property
    def path_key(self) -> object:
        """Equal for variants that share cube and trace; path emission belongs to one air and one set of surfaces."""
        return self.rays_key, self.field, self.orientation, "" if self.isothermal else self.name


@dataclass(frozen=True)
class Group:
    """Variants that share one trace; or, with a single variant in fluctuating temperature, one pass of path emission."""

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
        return max(variant.cutoff for variant in self.variants)

    @cached_property
    def sample(self) -> tuple[Array, Array]:
        """A few thousand rays: unit directions (n, 3) and lengths in m (n,), the cut-off not regarded."""
        raster = self.first.geometry.raster
        rows, columns = (np.unique(np.linspace(0, count - 1, 64).astype(np.int64)) for count in (raster.rows, raster.columns))
        direction = geometry.directions(self.first.geometry, np.repeat(rows, len(columns)), np.tile(columns, len(rows)))
        norm = np.linalg.norm(direction, axis=1)
        return direction / norm[:, None], geometry.reach(self.first.geometry, direction) * norm

    @property
    def visible_m(self) -> float:
        """How far the rays of all of them reach in mean air before the cut-off depth."""
        thinnest = self.thinnest.thinnest
        return self.cutoff / thinnest if thinnest > 0 else math.inf

    @property
    def cut(self) -> bool:
        """Whether rays reach the cut-off depth, so that their depth must be watched."""
        return float(self.sample[1].max()) >= self.visible_m


@dataclass(frozen=True)
class Plan:
    """Everything that a run will do."""

    scenario: Scenario
    variants: tuple[VariantPlan, ...]

    @cached_property
    def groups(self) -> list[Group]:
        """The variants by what they trace together, in order of first appearance."""
        return [Group(tuple(some)) for some in by_key(self.variants, lambda variant: variant.path_key).values()]

    @property
    def frequency_hz(self) -> Array:
        """Every frequency of every variant."""
        return np.unique(np.concatenate([variant.frequency_hz for variant in self.variants]))

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
    """The plan of a scenario whose variants have the given sensors. Raises CubeError for a cube that cannot be used."""
    planned = [
        _plan_variant(scenario.folder, variant.name, variant.scene, sensor)
        for variant, sensor in zip(scenario.variants, sensors, strict=True)
    ]
    return Plan(scenario, tuple(planned))


def _plan_variant(folder: Path, name: str, scene: Scene, sensor: Sensor) -> VariantPlan:
    shape, surfaces = geometry.geometry(scene)
    air = scene.atmosphere.air
    needs = sensor.needs(_view(scene, air))
    frequency_hz = np.unique(np.asarray(needs.frequency_hz, dtype=np.float64))
    field = _plan_field(folder, scene, air)
    humidity, temperature = field.spans() if field else ((0.0, 0.0), (0.0, 0.0))
    tolerance = SURROGATE_TOLERANCE[scene.numerics.precision]
    surrogate = fit(air, frequency_hz, humidity, temperature, tolerance=tolerance, moments=scene.numerics.moments)
    cutoff = _cutoff(scene, surfaces, frequency_hz)
    return VariantPlan(name, scene, sensor, needs, frequency_hz, shape, surfaces, field, surrogate, cutoff)


def _view(scene: Scene, air: Air) -> View:
    camera = scene.camera
    angles = [size / camera.focal_length_mm / count for size, count in zip(camera.focal_plane_mm, camera.pixels, strict=True)]
    longest = scene.background.max_range_m
    return View(camera.pixels, (angles[0], angles[1]), air.temperature_k, longest, air.absorption)


def _plan_field(folder: Path, scene: Scene, air: Air) -> FieldPlan | None:
    """The cube, or None where nothing that matters fluctuates."""
    if air.model == "none":
        return None
    fluctuations = scene.atmosphere.fluctuations
    if fluctuations is not None and fluctuations.file is not None:
        cube = field_file.inspect(folder / fluctuations.file, fluctuations.voxel_m)
        return FieldPlan(cube, air.most_vapour, (air.absolute_humidity_g_m3, air.temperature_k))
    source = turbulence(scene.atmosphere)
    if source is None or not (source.temperature_fluctuates or (source.sigma > 0 and air.absolute_humidity_g_m3 > 0)):
        return None
    # Only where the ceiling is within reach does it tell apart the cubes of two climates.
    bites = source.humidity_span()[1] > air.most_vapour
    return FieldPlan(source, air.most_vapour if bites else math.inf, None)


def _cutoff(scene: Scene, surfaces: list[Surface], frequency_hz: Array) -> float:
    """The depth behind which nothing that can be seen is worth 1e-7 of the air's radiance."""
    if scene.numerics.cutoff_depth is not None:
        return scene.numerics.cutoff_depth
    air = radiometry.planck(frequency_hz, scene.atmosphere.temperature_k)
    brightest = float(np.max(np.abs(emitted(scene, surfaces, frequency_hz)) / air))
    return max(SMALLEST_CUTOFF, math.log(brightest / NEGLIGIBLE) if brightest > 0 else 0.0)


def emitted(scene: Scene, surfaces: list[Surface], frequency_hz: Array) -> Array:
    """Radiance of each surface above the mean air's, (surface, frequency); where no temperature is given, that of air."""
    air_k = scene.atmosphere.temperature_k
    kelvin = np.array([air_k if s.temperature_k is None else s.temperature_k for s in surfaces])
    reflectivity = np.array([s.reflectivity for s in surfaces])
    return radiometry.surface_contrast(frequency_hz, kelvin, reflectivity, air_k, scene.background.environment)
