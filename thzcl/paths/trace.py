"""From geometry and field to what reaches the camera: surfaces, path moments, shading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import GROUP, Buffer, Device, Program, Recipe
from thzcl.plan.plan import DEPTH_CHECKED_EVERY
from thzcl.surfaces.geometry import Geometry, world_frame

Array = NDArray[np.float64]
ROWS_APART = 64  # numbers between spectral rows: rays are often a power of two, whose rows would share a few lines of the cache


@dataclass(frozen=True)
class Medium:
    """The cube that rays cross: fluctuations on the device, and the rays' frame in its voxels.

    `delta` is rho / rho_mean - 1, `offset` the temperature's departure from the mean in K (None in
    isothermal air), within `temperature_span`; `frame` is as geometry.cube_frame makes it; `time`
    (ray,) is when each ray is taken, in s, if that makes a difference.
    """

    delta: Buffer
    offset: Buffer | None
    temperature_span: tuple[float, float]
    frame: Array
    grid: int
    voxel_m: float
    time: Buffer | None


@dataclass(frozen=True)
class Followed:
    """The rays of a raster that are followed: those whose numbers are `picked`, or all."""

    count: int
    numbers: Buffer | None

    def padded(self, device: Device, precision: str) -> int:
        """How many slots they take in whole groups of packets."""
        packet = device.lanes(precision) * GROUP
        return -(-self.count // packet) * packet


def follow(device: Device, geometry: Geometry, picked: NDArray[Any] | None = None) -> Followed:
    """All rays of a raster, or those picked by number."""
    if picked is None:
        return Followed(geometry.raster.rays, None)
    return Followed(len(picked), device.put(picked, np.int32))


@dataclass(frozen=True)
class Ends:
    """Where rays end, on the device; arrays are padded to whole groups of packets.

    `reach` is how far the camera's ray goes and `end` how far the ray that is followed, both in the
    ray's parameter; `stretch` metres per unit of the latter's, `path_length` its length in metres.
    `surface` is a number, `blend` how far towards the next one, `cosine` that of the angle between
    ray and normal.
    """

    geometry: Geometry
    followed: Followed
    reach: Buffer
    end: Buffer
    stretch: Buffer
    path_length: Buffer
    surface: Buffer
    blend: Buffer
    cosine: Buffer
    outgoing: bool = False

    @property
    def rays(self) -> int:
        """With the padding."""
        return len(self.reach)


@dataclass(frozen=True)
class Paths:
    """What the rays went through: `moments` (k, ray) in metres, k = 1 and up; none in uniform air.

    `path_length` and `surface` are those of the ends, but for rays that the cut-off ended sooner.
    """

    path_length: Buffer
    surface: Buffer
    blend: Buffer
    moments: Buffer | None
    segments: int  # voxels crossed over positive length
    between: NDArray[np.bool_] | None = None  # the rays that were interpolated


@dataclass(frozen=True)
class Guard:
    """When a ray ends: the smallest depth over the frequencies.

    As coefficients of the moments in 1/m, and its limit.
    """

    coefficients: tuple[float, ...]
    depth: float


@dataclass(frozen=True)
class Shaded:
    """Optical depth and contrast, (frequency, ray), on the device; in bands.

    The depth of their mean transmission.
    """

    depth: Buffer
    contrast: Buffer


def find_ends(
    device: Device,
    geometry: Geometry,
    precision: str,
    *,
    cosine: bool = False,
    picked: NDArray[Any] | None = None,
) -> Ends:
    """Where every ray of the camera, or every one picked by number, ends: the nearest surface.

    Or max_range_m.
    """
    followed = follow(device, geometry, picked)
    padded = followed.padded(device, precision)
    program = device.build(*surfaces_recipe(geometry, precision, cosine=cosine))
    reach = device.empty((padded,), device.wide)
    stretch, path_length = (device.empty((padded,), precision) for _ in range(2))
    surface = device.empty((padded,), np.int32)
    blend, slant = (
        device.empty((padded if wanted else 1,), precision)
        for wanted in (len(geometry.billboards), cosine)
    )
    program.run(
        "surfaces",
        padded,
        device.put(world_frame(geometry.frame), device.wide),
        *_size(geometry),
        device.wide.type(geometry.max_range_m),
        *_things(device, geometry),
        *_list(followed),
        reach,
        stretch,
        path_length,
        surface,
        blend,
        slant,
    )
    return Ends(geometry, followed, reach, reach, stretch, path_length, surface, blend, slant)


def outgoing_ends(
    device: Device, ends: Ends, transmitter_m: tuple[float, float, float], precision: str
) -> Ends:
    """The ways from a transmitter to what each ray met; where nothing was.

    Or something stands between, no way at all.
    """
    geometry = ends.geometry
    program = device.build(
        ("surfaces/camera", "surfaces/surfaces"), precision, [*_surfaces(geometry), "OUTGOING"]
    )
    surface = device.put(ends.surface.host())
    end = device.empty((ends.rays,), device.wide)
    length = device.empty((ends.rays,), precision)
    program.run(
        "outgoing",
        ends.rays,
        device.put(world_frame(geometry.frame, np.array(transmitter_m)), device.wide),
        *_size(geometry),
        *_things(device, geometry),
        *_list(ends.followed),
        ends.reach,
        surface,
        end,
        length,
    )
    return Ends(
        geometry,
        ends.followed,
        ends.reach,
        end,
        length,
        length,
        surface,
        ends.blend,
        ends.cosine,
        outgoing=True,
    )


def trace(
    device: Device,
    ends: Ends,
    medium: Medium,
    moments: int,
    guard: Guard | None,
    precision: str,
    followed: Followed | None = None,
) -> Paths:
    """The path moments of every ray; a guarded ray stops past its depth, keeps its path so far, and meets nothing.

    Where only some rays are `followed`, the moments are theirs alone, in their order.
    """
    some = followed or ends.followed
    path_length, surface = changed_ends(device, ends, guard)
    program = device.build(
        *trace_recipe(
            moments, precision, guard, outgoing=ends.outgoing, moving=medium.time is not None
        )
    )
    slots = some.padded(device, precision)
    out = device.empty((moments, slots), precision)
    segments = device.empty((slots // device.lanes(precision),), np.int32)
    limit = guard or Guard((0.0,) * (moments + 1), np.inf)
    program.run(
        "trace",
        len(segments),
        medium.delta,
        *placed(device, ends, medium, some),
        path_length,
        surface,
        out,
        segments,
        device.put(np.array(limit.coefficients), precision),
        np.dtype(precision).type(limit.depth),
    )
    return Paths(path_length, surface, ends.blend, out, int(segments.host().sum(dtype=np.int64)))


def trace_steps(
    device: Device, ends: Ends, medium: Medium, moments: int, step_m: float, precision: str
) -> Paths:
    """The same by equal steps, each of the voxel that holds its middle: for comparison.

    No segments are counted.
    """
    program = device.build(("surfaces/camera", "paths/steps"), precision, [f"MOMENTS={moments}"])
    out = device.empty((moments, ends.rays), precision)
    step = np.dtype(precision).type(step_m)
    program.run(
        "steps",
        ends.rays // device.lanes(precision),
        medium.delta,
        *placed(device, ends, medium, ends.followed),
        step,
        out,
    )
    return Paths(ends.path_length, ends.surface, ends.blend, out, 0)


def straight(ends: Ends) -> Paths:
    """Paths through uniform air: their length is all that counts."""
    return Paths(ends.path_length, ends.surface, ends.blend, None, 0)


def there_and_back(device: Device, back: Paths, out: Paths) -> Paths:
    """The path of what a transmitter sends out and the camera gets back: both ways together."""

    def both(one: Buffer, other: Buffer) -> Buffer:
        return device.put(one.host() + other.host())

    moments = (
        None if back.moments is None or out.moments is None else both(back.moments, out.moments)
    )
    # What the cut-off ended on either way, or what is not lit, sends nothing back.
    surface = device.put(
        np.minimum(
            back.surface.host(), np.where(out.surface.host() > 0, np.iinfo(np.int32).max, 0)
        ),
        np.int32,
    )
    length = both(back.path_length, out.path_length)
    return Paths(length, surface, back.blend, moments, back.segments + out.segments, back.between)


def shade(
    device: Device, paths: Paths, coefficients: Array, sources: Array, precision: str
) -> Shaded:
    """Depth and contrast of isothermal air; `coefficients` (frequency, power) per metre.

    `sources` (surface, frequency).
    """
    program, rays = _shading(device, paths, precision), len(paths.path_length)
    count, row = len(coefficients), rays + ROWS_APART
    depth, contrast = (device.empty((count, row), precision) for _ in range(2))
    program.run(
        "shade",
        rays // device.lanes(precision),
        *_shaded_paths(paths),
        device.put(coefficients, precision),
        device.put(sources, precision),
        np.int32(count),
        np.int32(row),
        depth,
        contrast,
    )
    return Shaded(depth, contrast)


def shade_bands(
    device: Device,
    paths: Paths,
    coefficients: Array,
    sources: Array,
    weights: Array,
    passing: Array,
    precision: str,
) -> Shaded:
    """The same in bands: contrast summed with `weights`, transmission with `passing`, both (band, frequency).

    No spectrum is stored.
    """
    thinnest = coefficients[np.where(passing > 0, coefficients[:, 0], np.inf).argmin(axis=1)]
    beyond = np.where(
        passing[..., None] > 0, coefficients - thinnest[:, None], 0.0
    )  # of what a band has none of, nothing
    program, rays = _shading(device, paths, precision, len(weights)), len(paths.path_length)
    depth, contrast = (device.empty((len(weights), rays), precision) for _ in range(2))
    program.run(
        "shade_bands",
        rays // device.lanes(precision),
        *_shaded_paths(paths),
        device.put(thinnest, precision),
        device.put(beyond, precision),
        device.put(passing, precision),
        device.put(weights[:, None, :] * sources, precision),
        np.int32(len(coefficients)),
        np.int32(len(sources)),
        depth,
        contrast,
    )
    return Shaded(depth, contrast)


def _shading(device: Device, paths: Paths, precision: str, bands: int = 0) -> Program:
    moments = 0 if paths.moments is None else len(paths.moments)
    return device.build(
        *shading_recipe(moments, precision, textured=len(paths.blend) > 1, bands=bands)
    )


def _shaded_paths(paths: Paths) -> tuple[Buffer, ...]:
    return (
        paths.path_length,
        paths.path_length if paths.moments is None else paths.moments,
        paths.surface,
        paths.blend,
    )


def _surfaces(geometry: Geometry) -> list[str]:
    """The build options that name what can be met."""
    present = (
        ("GROUND", geometry.ground),
        ("BOXES", len(geometry.boxes)),
        ("BILLBOARDS", len(geometry.billboards)),
    )
    return [name for name, there in present if there]


def _things(device: Device, geometry: Geometry) -> tuple[object, ...]:
    """The kernel arguments that describe what can be met; of nothing.

    One row that is not looked at.
    """

    def table(rows: NDArray[Any], dtype: Any) -> Buffer:
        return device.put(rows if rows.size else np.zeros(8), dtype)

    return (
        table(geometry.boxes, device.wide),
        table(geometry.stripes, np.int32),
        np.int32(len(geometry.boxes)),
        table(geometry.billboards, device.wide),
        table(geometry.textures, np.int32),
        table(geometry.texels, np.float32),
        np.int32(len(geometry.billboards)),
    )


def surfaces_recipe(geometry: Geometry, precision: str, *, cosine: bool) -> Recipe:
    """The program that finds where rays end."""
    return Recipe(
        ("surfaces/camera", "surfaces/surfaces"),
        precision,
        (*_surfaces(geometry), *(["COSINE"] if cosine else [])),
    )


def trace_recipe(
    moments: int, precision: str, guarded: object, *, outgoing: bool, moving: bool
) -> Recipe:
    """The program that adds up path moments."""
    options = march_options(guarded, outgoing=outgoing, moving=moving, MOMENTS=moments)
    return Recipe(("surfaces/camera", "paths/march", "paths/trace"), precision, options)


def shading_recipe(moments: int, precision: str, *, textured: bool, bands: int = 0) -> Recipe:
    """The program that makes depth and contrast of path moments.

    `bands` if only those are wanted.
    """
    options = (
        f"MOMENTS={moments}",
        *([f"BANDS={bands}"] if bands else []),
        *(["BILLBOARDS"] if textured else []),
    )
    return Recipe(("surfaces/source", "paths/attenuate", "paths/shade"), precision, options)


def march_options(
    guarded: object, *, outgoing: bool, moving: bool, **numbers: int
) -> tuple[str, ...]:
    """The build options of kernels that go from voxel to voxel."""
    present = (
        (f"CUTOFF={DEPTH_CHECKED_EVERY}", guarded),
        ("OUTGOING", outgoing),
        ("MOTION", moving),
    )
    return (
        *(f"{name}={value}" for name, value in numbers.items()),
        *(name for name, there in present if there),
    )


def _size(geometry: Geometry) -> tuple[np.int32, np.int32]:
    return np.int32(geometry.raster.columns), np.int32(geometry.raster.rows)


def _list(followed: Followed) -> tuple[Buffer | None, np.int32]:
    """The kernel arguments that say which rays are followed; of all there is no list."""
    return followed.numbers, np.int32(followed.count)


def placed(device: Device, ends: Ends, medium: Medium, followed: Followed) -> tuple[object, ...]:
    """The kernel arguments that place the rays in the cube and say how far they reach."""
    frame, log2n = device.put(medium.frame, device.wide), np.int32(medium.grid.bit_length() - 1)
    time = ends.reach if medium.time is None else medium.time
    return (
        frame,
        *_size(ends.geometry),
        log2n,
        ends.reach,
        ends.end,
        time,
        ends.stretch,
        *_list(followed),
    )


def changed_ends(device: Device, ends: Ends, cut: object) -> tuple[Buffer, Buffer]:
    """Path lengths and surfaces that a trace may change, where the cut-off can end its rays."""
    if not cut:
        return ends.path_length, ends.surface
    return device.put(ends.path_length.host()), device.put(ends.surface.host())
