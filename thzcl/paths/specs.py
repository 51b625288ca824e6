"""The specs of paths: straight through even air, or through the voxels of a cube."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import field as dataclass_field
from dataclasses import replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from thzcl.air.expansion import Expansion, ExpansionSpec, TrimmedSpec
from thzcl.air.weather import Weather
from thzcl.device.opencl import Device
from thzcl.graph import (
    Held,
    LeftOut,
    Memory,
    Spec,
    Values,
    Work,
    evaluate,
    everything,
    frozen,
    rewrite,
)
from thzcl.paths import trace
from thzcl.paths.emission import Carried, emitting, trace_emission
from thzcl.paths.large_scales import RayMeans
from thzcl.paths.thinning import trace_thinned
from thzcl.paths.trace import Guard, Motion, Paths
from thzcl.surfaces.ends import EndsSpec, OutgoingSpec, RayEnds
from thzcl.surfaces.radiance import SentSpec, Table
from thzcl.turbulence.cube import Field
from thzcl.turbulence.fields import AnyField

AnyEnds = EndsSpec | OutgoingSpec
_COMPARED = 33  # humidities at which two absorptions are compared
_ISOTHERMAL = LeftOut("isothermal air: emission follows from optical depth")


@frozen
class StraightSpec(Spec):
    """The paths of rays through even air, of which only the length counts."""

    ends: AnyEnds
    why: str = dataclass_field(compare=False)  # there is no cube: a reason is no work
    reads = ("ends",)
    stage = "shading"

    @property
    def camera(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.ends.camera

    def run(self, device: Device, ends: RayEnds) -> Paths:
        """Returns the paths, which have lengths but no moments."""
        return trace.straight(device, ends, self.ends.precision)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns why there is no cube and no trace."""
        return {
            "humidity-field": LeftOut(self.why),
            "temperature-field": LeftOut("air temperature does not fluctuate"),
            "trace": LeftOut("uniform air: the path's length is all that counts"),
            "path-emission": _ISOTHERMAL,
        }


@frozen
class TraceSpec(Spec):
    """The paths of rays through a cube, with as many moments as the expansions that it serves need.

    Those in `serves` settle where rays end; those in `also`, of models to compare with, settle
    nothing. `fixed` holds those of the names "cutoff" and "stride" whose values the user has fixed.
    Paths with different values are joined only if thzcl has chosen them.
    """

    field: AnyField
    ends: AnyEnds
    serves: tuple[ExpansionSpec, ...]
    motion: Motion
    cutoff: float  # optical depth, one way, at which a ray ends
    stride: int  # every `stride`-th ray of a row and of a column is traced
    fixed: frozenset[str]
    targets: Values  # (surface,): flags of what each surface belongs to
    planned_segments: float = dataclass_field(default=0.0, compare=False)
    also: tuple[ExpansionSpec, ...] = ()
    reads = ("field", "ends", "serves", "also")

    @property
    def camera(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.ends.camera

    @property
    def stage(self) -> str:  # type: ignore[override]
        """Returns the stage of the way back, or of the way out."""
        return "outgoing-path" if isinstance(self.ends, OutgoingSpec) else "trace"

    def run(
        self,
        device: Device,
        field: Field,
        ends: RayEnds,
        serves: Iterator[Expansion],
        also: Iterator[Expansion],
    ) -> Paths:
        """Returns the paths; their cut-off follows from `serves`, their moments from `also` too."""
        fits, precision = list(serves), self.ends.precision
        moments = max(fit.moments for fit in (*fits, *also))
        if not moments:  # absorption does not vary, as in even air
            return trace.straight(device, ends, precision)
        varies = any(fit.moments for fit in fits)
        large = None if field.waves is None else RayMeans.of(device, field.waves, ends, self.motion)
        driest = 0.0 if large is None else large.lowest
        guard = _guard(fits, moments, ends, self.cutoff, driest) if varies else None
        medium = trace.medium(device, field, ends, self.motion)
        if self.stride == 1:
            paths = trace.trace(
                device, ends, medium, moments, guard, precision, crossed=self.planned_segments
            )
        else:
            thinned = self.stride, self.targets.array, self.planned_segments
            paths = trace_thinned(device, ends, medium, moments, guard, *thinned)
        paths = replace(paths, guarded=guard is not None and trace.ended(paths, ends))
        return paths if large is None else large.added(device, paths)

    def kin(self) -> TraceSpec:
        """Returns a key, which is equal for paths that one trace can serve."""
        cutoff = self.cutoff if "cutoff" in self.fixed else 0.0
        stride = self.stride if "stride" in self.fixed else 1
        return replace(self, serves=(), also=(), cutoff=cutoff, stride=stride)

    def join(self, other: TraceSpec) -> TraceSpec:
        """Returns the path that serves both: all expansions, deeper cut-off, smaller stride.

        Cut-off and stride are those of paths that serve more than models to compare with.
        """
        both = self, other
        settling = [path for path in both if path.serves] or both
        joint = replace(
            self,
            serves=tuple(dict.fromkeys(self.serves + other.serves)),
            also=tuple(dict.fromkeys(self.also + other.also)),
            cutoff=max(path.cutoff for path in settling),
            stride=min(path.stride for path in settling),
        )
        segments = max(path.planned_segments for path in both)
        return replace(joint, planned_segments=segments)

    def beside(self) -> TraceSpec:
        """Returns the path for which all that it serves is compared, and settles nothing."""
        return replace(self, serves=(), also=self.serves)

    def planned_moments(self) -> int:
        """Returns an upper bound of the number of moments, before the cube is made."""
        return max(fit.planned().moments for fit in (*self.serves, *self.also))

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that rays are traced, and which of them are interpolated."""
        thinned = ""
        if self.stride > 1:
            ray = f"one ray in {self.stride} both ways and the edges"
            thinned = f"; {ray}, the rest interpolated"
        return {"trace": Work("trace", thinned), "path-emission": _ISOTHERMAL}

    def memory(self) -> Memory:
        """Returns the size of the moments of every ray."""
        rays, real = self.ends.geometry.raster.rays, np.dtype(self.ends.precision).itemsize
        return Memory((real * rays * self.planned_moments(),))

    def segments(self) -> float:
        """Returns the estimate that the plan made."""
        return self.planned_segments


def _guard(
    fits: list[Expansion], moments: int, ends: RayEnds, cutoff: float, driest: float
) -> Guard | None:
    """Returns the guard that ends rays at the cut-off depth, or None if no ray can reach it.

    It watches the depth at the frequency, and in the expansion, that absorb least, in air whose
    delta is `driest` where the cube's is 0.
    """
    rows = [row for fit in fits for row in fit.coefficients[:, :, 0]]
    thinnest = min(rows, key=lambda row: float(row[0]))
    if thinnest[0] * trace.longest_m(ends) < cutoff:
        return None
    if driest:
        thinnest = np.array(Polynomial(thinnest)(Polynomial([driest, 1.0])).coef)
    return Guard(tuple(np.pad(thinnest, (0, moments + 1 - len(thinnest)))), cutoff)


@frozen
class RoundTripSpec(Spec):
    """The paths from a transmitter to what each ray of the camera meets, and back along the ray."""

    back: StraightSpec | TraceSpec
    out: StraightSpec | TraceSpec
    reads = ("back", "out")
    stage = "outgoing-path"

    @property
    def camera(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.back.camera

    def run(self, device: Device, back: Paths, out: Paths) -> Paths:
        """Returns the paths, with the lengths and moments of both ways added up."""
        return trace.there_and_back(device, back, out)

    def memory(self) -> Memory:
        """Returns the sizes of the arrays, which are those of one way."""
        return self.back.memory()


AnyPath = StraightSpec | TraceSpec | RoundTripSpec


@frozen
class EmissionSpec(Spec):
    """Depth and radiance summed up along rays through air whose temperature fluctuates."""

    field: AnyField
    ends: AnyEnds
    expansion: TrimmedSpec
    sent: SentSpec
    motion: Motion
    cutoff: float  # optical depth, one way, at which a ray ends
    weather: Weather | None = None  # what falls, and takes light without emitting as the air does
    planned_segments: float = dataclass_field(default=0.0, compare=False)
    reads = ("field", "ends", "expansion", "sent")

    @property
    def camera(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.ends.camera

    @property
    def stage(self) -> str:  # type: ignore[override]
        """Returns the stage of the way back, or of the way out."""
        return "outgoing-path" if isinstance(self.ends, OutgoingSpec) else "path-emission"

    def run(
        self, device: Device, field: Field, ends: RayEnds, expansion: Expansion, sent: Table
    ) -> Carried:
        """Returns the depth and the contrast of every ray at every frequency."""
        precision, air = self.ends.precision, self.sent.sources.air_emits
        veil = np.zeros(len(expansion.frequency_hz))
        if self.weather is not None:
            veil = self.weather.extinction(expansion.frequency_hz)
        tables = emitting(expansion, field.temperature_span, sent, veil, precision, air=air)
        thinnest = float(expansion.coefficients[:, 0, 0].min())
        reached = thinnest * trace.longest_m(ends) >= self.cutoff
        medium = trace.medium(device, field, ends, self.motion)
        cutoff = self.cutoff if reached else None
        crossed = self.planned_segments
        return trace_emission(device, ends, medium, tables, cutoff, precision, crossed)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that radiance is summed up along the path, in place of a trace of moments."""
        carried = LeftOut("path emission carries the depth along")
        return {"trace": carried, "path-emission": Work("", "temperature fluctuates")}

    def memory(self) -> Memory:
        """Returns the sizes of depth and contrast at every frequency."""
        rays, real = self.ends.geometry.raster.rays, np.dtype(self.ends.precision).itemsize
        count = self.expansion.expansion.frequency_hz.shape[0]
        return Memory((real * rays * count,) * 2)

    def segments(self) -> float:
        """Returns the estimate that the plan made."""
        return self.planned_segments


def joined(wanted: Iterable[Spec]) -> tuple[Any, ...]:
    """Returns the wanted specs of the graph in which paths with the same kin() are one path.

    It is meant for the variants of a scene, and for members of a study that share rays and cube. It
    must not be used where the effect of a cut-off or a stride is compared, since it would make them
    equal.
    """
    wanted = tuple(wanted)
    kin: dict[TraceSpec, list[TraceSpec]] = {}
    for path in everything(wanted):
        if isinstance(path, TraceSpec):
            kin.setdefault(path.kin(), []).append(path)
    joint = {path: reduce(TraceSpec.join, paths) for paths in kin.values() for path in paths}
    return rewrite(wanted, lambda spec: joint.get(spec, spec))


class Served(NamedTuple):
    """The wanted specs of a graph, and in words why paths that are held do not serve it."""

    specs: tuple[Any, ...]
    lacking: str


def served(wanted: Iterable[Spec], held: Held, device: Device) -> Served:
    """Returns the wanted specs of the graph in which held paths stand for those that they serve.

    A path serves another if it was traced for the same rays and cube, at least as closely, with as
    many moments as the other's expansions need, and was not cut off where the other would go on.
    """
    wanted = tuple(wanted)
    instead: dict[Spec, TraceSpec] = {}
    lacking = ""
    for path in everything(wanted, held.values):
        if not isinstance(path, TraceSpec):
            continue
        for other in _kin(path, held):
            why = _lacking(path, other, held, device)
            if not why:
                instead[path] = other
                break
            lacking = lacking or why
    return Served(rewrite(wanted, lambda spec: instead.get(spec, spec)), lacking)


def _kin(path: TraceSpec, held: Held) -> list[TraceSpec]:
    """Returns the paths that are held of the same rays through the same cube."""
    kin = path.kin()
    traces = (one for one in held.values if isinstance(one, TraceSpec))
    return [one for one in traces if one.kin() == kin]


def _lacking(path: TraceSpec, other: TraceSpec, held: Held, device: Device) -> str:
    """Returns what a path that is held lacks to stand for another, in words; empty if nothing."""
    if other.stride > path.stride:
        return f"of the rays every {other.stride}th both ways was traced, not all that are needed"
    traced: Paths = held.values[other]
    sets = path.serves, (*path.serves, *path.also), other.serves
    fits, every, earlier = (_fits(specs, held, device) for specs in sets)
    moments, needed = traced.moments.shape[0], max(fit.moments for fit in every)
    if needed > moments:
        return f"{needed} moments of the humidity are needed, and {moments} were traced"
    if traced.guarded and not _ends_before(fits, path.cutoff, earlier, other.cutoff):
        return "rays had ended in air that lets less through"
    return ""


def _fits(specs: tuple[ExpansionSpec, ...], held: Held, device: Device) -> tuple[Expansion, ...]:
    """Returns the expansions of some specs, in cubes that are held."""
    (fits,) = evaluate([specs], device, held=held)
    return fits


def _ends_before(
    fits: Iterable[Expansion], cutoff: float, earlier: Iterable[Expansion], depth: float
) -> bool:
    """Returns whether rays end by some expansions at a `cutoff` wherever they did by earlier ones.

    `depth` is the cut-off of the earlier ones.
    """
    fits, earlier = list(fits), list(earlier)
    if not fits or not earlier:
        return False
    low = min(fit.humidity_span[0] for fit in (*fits, *earlier))
    high = max(fit.humidity_span[1] for fit in (*fits, *earlier))
    delta = np.linspace(low, high, _COMPARED)
    now, then = (
        np.min([fit.absorption(delta).min(axis=0) for fit in some], axis=0)
        for some in (fits, earlier)
    )
    return bool((now / cutoff >= then / depth).all())
