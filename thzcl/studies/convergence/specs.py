"""Pieces of work that only a study of convergence does, and how they come into a graph.

Each change takes a spec and returns what stands in its place; graph.rewrite applies it to a graph.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, ExpansionSpec
from thzcl.air.mean import NOWHERE, Air
from thzcl.air.weather import Weather
from thzcl.device.opencl import Buffer, Device
from thzcl.graph import Spec, Values, frozen
from thzcl.paths import trace
from thzcl.paths.large_scales import RayMeans
from thzcl.paths.specs import AnyEnds, TraceSpec
from thzcl.paths.trace import Motion, Paths
from thzcl.sensing.transfer import ShadeSpec
from thzcl.sensing.weather import WeatherSpec
from thzcl.surfaces.ends import EndsSpec, RayEnds
from thzcl.surfaces.radiance import Emission, SentSpec
from thzcl.surfaces.sky import Behind, Sky
from thzcl.turbulence.cube import Field
from thzcl.turbulence.fields import AnyField, FieldSpec
from thzcl.turbulence.lattice import Lattice

Array = NDArray[np.float64]
Change = Callable[[Any], Any]


def unchanged(spec: Any) -> Any:
    """Returns a spec as it is."""
    return spec


def by_library(name: str) -> Change:
    """Returns the change to fields that the named library transforms."""

    def change(spec: Any) -> Any:
        return replace(spec, library=name) if isinstance(spec, FieldSpec) else spec

    return change


def under_sky(change: Callable[[Sky], Sky]) -> Change:
    """Returns the change to surfaces and rays that see another sky."""

    def changed(spec: Any) -> Any:
        if not isinstance(spec, SentSpec) or not isinstance(spec.sources, Emission):
            return spec
        around, behind = spec.sources.surroundings, spec.sources.behind
        if isinstance(around, Sky):
            around = change(around)
        if isinstance(behind, Behind):
            behind = replace(behind, sky=change(behind.sky))
        return replace(spec, sources=replace(spec.sources, surroundings=around, behind=behind))

    return changed


def in_weather(change: Callable[[Weather], Weather]) -> Change:
    """Returns the change to rays that bring the light of another weather."""

    def changed(spec: Any) -> Any:
        if not isinstance(spec, WeatherSpec):
            return spec
        return replace(spec, weather=change(spec.weather))

    return changed


def by_look_up(tolerance: float) -> Change:
    """Returns the change to look-ups by the angle as fine as a tolerance asks."""

    def change(spec: Any) -> Any:
        return replace(spec, tolerance=tolerance) if isinstance(spec, SentSpec) else spec

    return change


@frozen
class CoarseSpec(Spec):
    """A cube averaged down to fewer voxels over the same period.

    Its spans stay those of the finer cube, so that absorption is fitted alike for every size.
    """

    field: AnyField
    grid: int  # voxels along an edge, a divisor of the finer cube's
    reads = ("field",)
    stage = "humidity-field"

    def run(self, device: Device, field: Field) -> Field:
        """Returns the means over blocks of voxels."""

        def mean(cube: Buffer) -> Buffer:
            n, blocks = self.grid, field.grid // self.grid
            values = cube.host().astype(np.float64).reshape(n, blocks, n, blocks, n, blocks)
            return device.put(values.mean(axis=(1, 3, 5)), self.field.precision)

        voxel_m = field.voxel_m * field.grid / self.grid
        offset = None if field.offset is None else mean(field.offset)
        lattice = Lattice.cubic(self.grid, voxel_m)
        return replace(field, lattice=lattice, delta=mean(field.delta), offset=offset)


def in_coarse_air(finer: Mapping[AnyField, AnyField], grid: int) -> Change:
    """Returns the change to cubes of `grid` voxels an edge, averaged from finer ones.

    `finer` holds the finer cube of each cube that there is in the graph.
    """

    def change(spec: Any) -> Any:
        return CoarseSpec(finer[spec], grid) if isinstance(spec, FieldSpec) else spec

    return change


@frozen
class StepsSpec(Spec):
    """Rays through a cube by steps of equal length, each of the voxel that holds its middle.

    All rays are followed, and to their ends.
    """

    field: AnyField
    ends: AnyEnds
    serves: tuple[ExpansionSpec, ...]
    motion: Motion
    step_m: float
    reads = ("field", "ends", "serves")
    stage = "trace"

    @property
    def camera(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.ends.camera

    def run(
        self, device: Device, field: Field, ends: RayEnds, serves: Iterator[Expansion]
    ) -> Paths:
        """Returns as many moments as the fits need."""
        precision, moments = self.ends.precision, max(fit.moments for fit in serves)
        if not moments:
            return trace.straight(device, ends, precision)
        medium = trace.medium(device, field, ends, self.motion)
        paths = trace.trace_steps(device, ends, medium, moments, self.step_m, precision)
        if field.waves is None:
            return paths
        return RayMeans.of(device, field.waves, ends, self.motion).added(device, paths)


def by_steps(step_m: float) -> Change:
    """Returns the change to paths that are summed in steps of equal length."""

    def change(spec: Any) -> Any:
        if not isinstance(spec, TraceSpec):
            return spec
        return StepsSpec(spec.field, spec.ends, spec.serves, spec.motion, step_m)

    return change


@frozen
class TableSpec(Spec):
    """A cube of absorption over the mean air's, less 1, as a table over humidity gives it.

    The table has equal steps of relative humidity, and straight lines between them.
    """

    field: AnyField
    air: Air
    frequency_hz: Values  # (1,)
    step_percent: float
    reads = ("field",)
    stage = "surrogate"

    def run(self, device: Device, field: Field) -> Field:
        """Returns the cube, which holds absorption in place of humidity."""
        delta, relative = self._table(field.humidity_span[1])
        values = np.interp(field.delta.host(), delta, relative)
        span = float(values.min()), float(values.max())
        looked_up = device.put(values, self.field.precision)
        return replace(field, delta=looked_up, humidity_span=span)

    def _table(self, highest: float) -> tuple[Array, Array]:
        """Returns delta and relative absorption less 1, (row,), for delta up to `highest`."""
        step = self.step_percent / self.air.relative_humidity_percent
        rows = math.ceil((1 + highest) / step) + 1
        delta = np.minimum(np.arange(rows) * step - 1, self.air.most_vapour)
        frequency_hz = self.frequency_hz.array
        mean = self.air.absorption(frequency_hz)[0]
        return delta, self.air.absorption(frequency_hz, delta) / mean - 1


@frozen
class LinearSpec(Spec):
    """The expansion that gives the absorption of a cube which holds absorption itself."""

    table: TableSpec
    reads = ("table",)
    stage = "surrogate"

    def run(self, device: Device, table: Field) -> Expansion:
        """Returns the mean air's absorption as constant and as slope."""
        del device
        air, frequency_hz = self.table.air, self.table.frequency_hz.array
        coefficients = np.repeat(air.absorption(frequency_hz)[:, None, None], 2, axis=1)
        spans = table.humidity_span, NOWHERE
        return Expansion(air, frequency_hz, coefficients, *spans, error=0.0, measured=0.0)


def by_table(step_percent: float) -> Change:
    """Returns the change to absorption looked up for every voxel, in steps of relative humidity.

    Each shading gets a cube and a trace of its own, of all rays.
    """

    def change(spec: Any) -> Any:
        if not (isinstance(spec, ShadeSpec) and isinstance(spec.path, TraceSpec)):
            return spec
        air, frequency_hz = spec.expansion.air, spec.expansion.frequency_hz
        table: Any = TableSpec(spec.path.field, air, frequency_hz, step_percent)
        linear: Any = LinearSpec(table)
        path = replace(spec.path, field=table, serves=(linear,), stride=1)
        return replace(spec, path=path, expansion=linear)

    return change
