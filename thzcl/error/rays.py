"""Rays of the error budget: drawn from those of an image, and walked through the cube again."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.layers import Departures
from thzcl.air.mean import Span
from thzcl.device.opencl import Buffer, Device
from thzcl.error import twin
from thzcl.error.twin import Path
from thzcl.graph import Memory, Spec, Values, frozen
from thzcl.paths.large_scales import DRIEST
from thzcl.paths.trace import Motion
from thzcl.sensing.transfer import lambert_gain
from thzcl.surfaces import camera
from thzcl.surfaces import ends as ray_ends
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.ends import EndsSpec, Facing, OutgoingSpec, RayEnds
from thzcl.surfaces.geometry import Geometry
from thzcl.surfaces.radiance import Bounce, EndAngles
from thzcl.turbulence.cube import Field
from thzcl.turbulence.fields import AnyField
from thzcl.turbulence.large_scales import Waves
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

RAYS = 200  # the most rays that are followed again
PIXELS = 32  # the most pixels whose samples are doubled
FEWEST_PIXELS = 8  # the fewest with one sample, and so many fewer as they have more
EDGES = 0.75  # of them beside a pixel of another surface
FINEST = 32, 8, 2  # places each way, in the part of the image of one sample, for another
MOST_NUMBERS = 2**31  # rays have 32 bits
WORK = 60_000  # segments, or segments times frequencies, beyond which there are fewer rays
FEWEST = 8  # the fewest rays that are followed again


@dataclass(frozen=True)
class Way:
    """Straight lines through the air, in segments: arrays (ray, segment).

    `length` is in m, `delta` the humidity over its mean less 1, and `offset` the temperature's
    departure from the mean in K, or None in isothermal air. `evened` is `delta` with eddies larger
    than the cube as even along each ray, as a run has them, or None without such eddies.
    """

    length: Array
    delta: Array
    offset: Array | None
    evened: Array | None = None


@dataclass(frozen=True)
class Walked:
    """Rays that were followed again: their numbers, weights of sum 1, and where they end.

    `surface` and `blend` are those of RayEnds, and `gain` multiplies the contrast that a ray
    brings; all are (ray,). `angles` are None where they make no difference.
    """

    number: Integers
    weight: Array
    surface: NDArray[np.int32]
    blend: Array
    angles: EndAngles | None
    gain: Array
    sine: Array  # of the elevation at which the camera looks
    start_m: float  # height of the camera
    ways: tuple[Way, ...]  # the camera's ray, and the way from a transmitter if there is one

    @cached_property
    def _paths(self) -> dict[Span, tuple[Path, ...]]:
        """Returns the paths that have been made, by their span of humidity."""
        return {}

    def paths(self, span: Span) -> tuple[Path, ...]:
        """Returns the ways as paths whose humidity lies within `span`.

        Paths with the same span are one object, so that their moments are computed once.
        """
        if span not in self._paths:
            self._paths[span] = tuple(
                Path(way.length, way.delta, way.offset, span) for way in self.ways
            )
        return self._paths[span]

    def evened(self) -> Walked | None:
        """Returns the rays through large eddies that are even along each, or None without any."""
        if any(way.evened is None for way in self.ways):
            return None
        ways = (replace(way, delta=np.asarray(way.evened)) for way in self.ways)
        return replace(self, ways=tuple(ways))

    def ended(self, ended: NDArray[np.bool_]) -> Walked:
        """Returns the rays with the surface 0 for those in `ended` (ray,), which were cut off."""
        return replace(self, surface=np.where(ended, np.int32(0), self.surface))


def affordable(mean_length_m: float, voxel_m: float, work: float) -> int:
    """Returns how many rays can be followed again at little cost.

    `mean_length_m` is the mean length of all ways of a ray together, and `work` the number of times
    that each segment counts.
    """
    each = (1.7 * mean_length_m / voxel_m + 3) * work
    return int(np.clip(WORK / each, FEWEST, RAYS))


@dataclass(frozen=True)
class Lines:
    """Straight lines in the world: starts and unit directions (ray, 3), lengths (ray,) in m.

    `place` holds the row and the column, both (ray,), of each in the raster that the run traced.
    """

    start: Array
    direction: Array
    length: Array
    place: tuple[Integers, Integers]


class Even:
    """Air that is the same everywhere."""

    def way(self, lines: Lines) -> Way:
        """Returns the way along some lines, with one segment each."""
        length = lines.length[:, None]
        return Way(length, np.zeros(length.shape), None)


@dataclass(frozen=True)
class Voxels:
    """A cube of air and its motion."""

    field: Field
    motion: Motion

    def way(self, lines: Lines) -> Way:
        """Returns the way along some lines, with one segment for each voxel that they cross."""
        field, lattice, how = self.field, self.field.lattice, self.motion.orientation
        origin = np.broadcast_to(lines.start, lines.direction.shape)
        if self.motion.times_s is not None:
            taken = self.motion.times_s.array[lines.place]
            origin = origin - taken[:, None] * np.array(self.motion.wind_m_s)
        start = lattice.placed(lattice.turned(origin, how))
        step = lattice.turned(lines.direction, how)
        enter, leave = lattice.crossed(start, step, lines.length)
        entry = start + enter[:, None] * step
        lengths, voxel = twin.walk(entry, step, leave - enter, lattice.shape)
        delta, offset = (
            None if values is None else values.host().ravel()[voxel].astype(np.float64)
            for values in (field.delta, field.offset)
        )
        way = Way(lengths, np.asarray(delta), offset)
        if field.layers is not None:
            return _by_height(way, field.layers, lines)
        if field.waves is not None:
            start_m = origin @ ROTATIONS[how].T
            return _in_large_eddies(way, field.waves, start_m, lines.direction @ ROTATIONS[how].T)
        return _between(way, enter, lines.length - leave) if lattice.bounded else way


def _by_height(way: Way, layers: Departures, lines: Lines) -> Way:
    """Returns a way with the mean air by height, that of the middle of each segment."""
    middle = np.cumsum(way.length, axis=1) - way.length / 2
    start = np.broadcast_to(lines.start, lines.direction.shape)
    moister, warmer = layers.at(start[:, 2:] + middle * lines.direction[:, 2:])
    offset = warmer if way.offset is None else way.offset + warmer
    return Way(way.length, (1 + way.delta) * (1 + moister) - 1, offset)


def _in_large_eddies(way: Way, waves: Waves, start: Array, direction: Array) -> Way:
    """Returns a way with what eddies larger than the cube add; air holds no less than none.

    `start` and unit `direction` (ray, 3) are in m along the cube's axes.
    """
    before = np.cumsum(way.length, axis=1) - way.length
    begin = start[:, None] + before[..., None] * direction[:, None]
    parts = way.length[..., None] * direction[:, None]
    each = waves.mean(begin.reshape(-1, 3), parts.reshape(-1, 3)).reshape(way.length.shape)
    whole = way.length.sum(axis=1, keepdims=True)
    mean = np.maximum(waves.mean(start, whole * direction), DRIEST)
    delta = np.maximum(way.delta + each, DRIEST)
    return replace(way, delta=delta, evened=way.delta + mean[:, None])


def _between(way: Way, before: Array, behind: Array) -> Way:
    """Returns a way with mean air before and behind it, of lengths (ray,) in m."""
    length = np.concatenate([before[:, None], way.length, behind[:, None]], axis=1)
    ends = ((0, 0), (1, 1))
    offset = None if way.offset is None else np.pad(way.offset, ends)
    return Way(length, np.pad(way.delta, ends), offset)


Air = Even | Voxels


@frozen
class UniformAirSpec(Spec):
    """Air that is the same everywhere, for the error budget."""

    stage = "error-budget"

    def run(self, device: Device) -> Even:
        """Returns the air."""
        del device
        return Even()


@frozen
class VoxelAirSpec(Spec):
    """A cube of air, for the error budget."""

    field: AnyField
    motion: Motion
    reads = ("field",)
    stage = "error-budget"

    def run(self, device: Device, field: Field) -> Voxels:
        """Returns the air."""
        del device
        return Voxels(field, self.motion)


@frozen
class WalkSpec(Spec):
    """Some rays of an image, drawn from all that it shows and walked through the air."""

    air: UniformAirSpec | VoxelAirSpec
    ends: EndsSpec
    out: OutgoingSpec | None
    targets: Values  # (surface,): flag of the target that each surface belongs to
    lambert: bool  # whether echoes are scattered evenly
    rays: int
    seed: int
    segments_a_ray: float = field(compare=False)  # about the most
    reads = ("air", "ends", "out")
    stage = "error-budget"

    def run(self, device: Device, air: Air, ends: RayEnds, out: RayEnds | None) -> Walked:
        """Returns the rays with the air along them."""
        del device
        number, weight = drawn(ends, self.targets.array, self.rays, self.seed)
        place = np.divmod(number, ends.geometry.raster.columns)
        return _followed(air, ends, out, number, number, place, weight, self.lambert)

    def memory(self) -> Memory:
        """Returns the sizes of the segments' arrays, and of those that sort them."""
        segments = int(self.rays * self.segments_a_ray)
        return Memory((24 * segments,), (48 * segments,))


def drawn(ends: RayEnds, targets: NDArray[Any], count: int, seed: int) -> tuple[Integers, Array]:
    """Returns the numbers and the weights, of sum 1, of about `count` rays of an image.

    Each target that the image shows has rays in proportion to its share of the image, but at least
    two and at least an eighth of `count`, if it has as many. `targets` (surface,) holds the flag of
    the target that each surface belongs to.
    """
    raster, rng = ends.geometry.raster, np.random.Generator(np.random.Philox(key=[seed, 1]))
    m = raster.margin
    all_rays = np.arange(raster.rays).reshape(raster.rows, raster.columns)
    inside = all_rays[m : raster.rows - m, m : raster.columns - m].ravel()
    shown = targets[ends.surface.host()[: raster.rays]][inside]
    picks, weights = [], []
    for target in sorted({*targets.tolist()}):
        members = np.flatnonzero(shown == target)
        if not len(members):
            continue
        n = min(len(members), max(count // 8, round(count * len(members) / len(inside)), 2))
        picks.append(inside[rng.choice(members, n, replace=False)])
        weights.append(np.full(n, len(members) / len(inside) / n))
    return np.concatenate(picks), np.concatenate(weights)


def _followed(
    air: Air,
    ends: RayEnds,
    out: RayEnds | None,
    number: Integers,
    slots: Integers,
    place: tuple[Integers, Integers],
    weight: Array,
    lambert: bool,
) -> Walked:
    """Returns rays that are walked through the air.

    `number` (ray,) are their numbers in the raster of `ends`, `slots` (ray,) their indices in the
    arrays of `ends`, and `place` their rows and columns in the raster that the run traced.
    `lambert` says whether echoes are scattered evenly.
    """
    shape = ends.geometry
    direction = camera.directions(shape.frame.array, shape.raster, number)
    norm = np.linalg.norm(direction, axis=1)
    reach = ends.reach.host()[slots].astype(np.float64)
    here = shape.frame.array[0]
    ways = [air.way(Lines(here, direction / norm[:, None], reach * norm, place))]
    surface = ends.surface.host()[slots]
    if out is not None:
        surface = np.where(out.surface.host()[slots] > 0, surface, 0)
        start = np.array(out.start)
        away = here + reach[:, None] * direction - start
        length = np.linalg.norm(away, axis=1)
        ways.append(air.way(Lines(start, away / length[:, None], length, place)))
    facing = ends.facing
    blend, cosine = (_asked(values, slots) for values in (facing.blend, facing.cosine))
    angles = _angles(facing, slots)
    blended, gain = np.zeros(len(slots)) if blend is None else blend, np.ones(len(slots))
    if lambert:
        assert cosine is not None  # noqa: S101 (whoever asks for the gain asks for the cosine)
        gain = lambert_gain(cosine, ends.path_length.host()[slots].astype(np.float64))
    sine, start_m = direction[:, 2] / norm, float(here[2])
    return Walked(number, weight, surface, blended, angles, gain, sine, start_m, tuple(ways))


def _angles(facing: Facing, slots: Integers) -> EndAngles | None:
    """Returns the angles at which some rays end, or None if they were not asked for."""
    cosine, elevation, upward, across = (
        _asked(values, slots)
        for values in (facing.cosine, facing.elevation, facing.upward, facing.across)
    )
    if cosine is None or elevation is None or upward is None:
        return None
    if len(facing.met) == 1:
        return EndAngles(cosine, elevation, upward, across)
    blend, *angles, length_m = facing.bounce.host()[slots].T.astype(np.float64)
    bounce = Bounce(facing.met.host()[slots], blend, length_m, EndAngles(*angles))
    return EndAngles(cosine, elevation, upward, across, bounce)


def _asked(values: Buffer, slots: Integers) -> Array | None:
    """Returns some values of an array by ray, in float64, or None if it was not asked for."""
    return values.host()[slots].astype(np.float64) if len(values) > 1 else None


@dataclass(frozen=True)
class FinePixels:
    """Pixels with more samples: their rays, pixel by pixel, their numbers and their weights."""

    walked: Walked
    pixel: Integers
    weight: Array


@frozen
class FineWalkSpec(Spec):
    """Some pixels with twice as many samples each way, most of them at edges of surfaces.

    Each new sample lies at random in its own part of the pixel: at a regular grid, straight edges
    would show all of their error or none.
    """

    air: UniformAirSpec | VoxelAirSpec
    ends: EndsSpec
    transmitter_m: tuple[float, float, float] | None
    lambert: bool  # whether echoes are scattered evenly
    rays: int
    seed: int
    reads = ("air", "ends")
    stage = "error-budget"

    def run(self, device: Device, air: Air, ends: RayEnds) -> FinePixels:
        """Returns the pixels and their rays."""
        pixel, weight = _near_edges(ends, self.rays, self.seed)
        fine, number, place = _doubled(self.ends.geometry, pixel, self.seed)
        precision = self.ends.precision
        found = ray_ends.find_ends(device, fine, precision, self.ends.asked, number)
        out = None
        if self.transmitter_m is not None:
            out = ray_ends.outgoing_ends(device, found, self.transmitter_m, precision)
        slots, weights = np.arange(len(number)), np.ones(len(number))
        walked = _followed(air, found, out, number, slots, place, weights, self.lambert)
        return FinePixels(walked, pixel, weight)


def _near_edges(ends: RayEnds, rays: int, seed: int) -> tuple[Integers, Array]:
    """Returns numbers and weights of pixels, most of them beside a pixel of another surface."""
    raster, rng = ends.geometry.raster, np.random.Generator(np.random.Philox(key=[seed, 2]))
    rows, columns = raster.block
    surface = ends.surface.host()[: raster.rays].reshape(raster.rows, raster.columns)
    shown = surface[rows // 2 :: rows, columns // 2 :: columns].astype(np.int64)
    # Straight edges fall alike in all of their pixels. Those at edges are of one kind if they or
    # their neighbours show the same last surface, on the same side of edges that are as steep.
    around = np.pad(shown, 1, mode="edge")
    four = around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]
    differ = [beside != shown for beside in four]
    edge, steep = np.any(differ, axis=0), np.any(differ[2:], axis=0)
    last = np.max([shown, *four], axis=0)
    kind = np.where(edge, 4 * last + 2 * steep + (shown == last), -1)
    samples = rows * columns
    most = max(2, FEWEST_PIXELS // samples, min(PIXELS, rays // (4 * samples)))
    there = min(round(EDGES * most), most - 1) if edge.any() else 0
    if len(np.unique(kind)) > PIXELS:
        kind = np.where(edge, 0, -1)
    kinds = np.unique(kind)
    share = max(2, there // max(1, int((kinds >= 0).sum())))
    pixels, weights = [], []
    for one in kinds:
        members = np.flatnonzero(kind == one)
        n = min(len(members), share if one >= 0 else most - there)
        pixels.append(rng.choice(members, n, replace=False))
        weights.append(np.full(n, len(members) / shown.size / max(n, 1)))
    return np.concatenate(pixels), np.concatenate(weights)


def _doubled(
    shape: Geometry, pixel: Integers, seed: int
) -> tuple[Geometry, Integers, tuple[Integers, Integers]]:
    """Returns twice as many rays each way of some pixels: a finer raster, and their numbers in it.

    The last are the row and the column of each in the raster that the run traced.
    """
    raster, frame = shape.raster, shape.frame.array.copy()
    rng = np.random.Generator(np.random.Philox(key=[seed, 3]))
    finest = next(n for n in FINEST if raster.rays * n**2 < MOST_NUMBERS or n == 2)
    rows, columns = (2 * n for n in raster.block)
    block = finest * raster.block[0], finest * raster.block[1]
    fine = Raster(finest * raster.rows, finest * raster.columns, block)
    frame[2:] /= finest
    row, column = (n[:, None, None] for n in divmod(pixel, raster.pixels[1]))
    places = len(pixel), rows, columns
    cell = finest // 2  # places of the finer raster for each of the new samples
    down, right = (rng.integers(cell, size=places) for _ in range(2))
    # Neighbours mirror each other, so that an edge parts two of them rather than none or both.
    down[:, :, 1::2] = cell - 1 - down[:, :, ::2]
    right[:, 1::2] = cell - 1 - right[:, ::2]
    down += (row * rows + np.arange(rows)[:, None]) * cell
    right += (column * columns + np.arange(columns)) * cell
    down, right = down.ravel(), right.ravel()
    made = replace(shape, raster=fine, frame=Values.of(frame))
    return made, down * fine.columns + right, (down // finest, right // finest)
