"""Path moments M_k = integral of delta^k ds, traced from voxel to voxel through the cube.

In isothermal air the optical depth at every frequency is a sum over the path's moments and its
length, so that one trace serves all frequencies, all mean airs and all surface temperatures.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Buffer, Device
from thzcl.graph import Values
from thzcl.surfaces import camera, geometry
from thzcl.surfaces.ends import Facing, Followed, RayEnds, raster_size, ray_list
from thzcl.turbulence.cube import Field
from thzcl.turbulence.lattice import Lattice

Array = NDArray[np.float64]
DEPTH_CHECKED_EVERY = 16  # voxels, where rays can reach the cut-off depth


@dataclass(frozen=True)
class MarchKernels(Kernels):
    """Kernels that go from voxel to voxel, with the options that all of them have.

    After each `cutoff` voxels a ray's depth is looked at; None if no ray ends before its surface.
    """

    gathers = True

    cutoff: int | None
    outgoing: bool
    motion: bool
    clipped: bool


@dataclass(frozen=True)
class TraceKernels(MarchKernels):
    """The kernel that sums up path moments from voxel to voxel."""

    files: ClassVar = ("surfaces/camera", "paths/march", "paths/trace")

    moments: int


@dataclass(frozen=True)
class StepKernels(Kernels):
    """The kernel that sums up path moments by equal steps."""

    files: ClassVar = ("surfaces/camera", "paths/steps")

    moments: int


@dataclass(frozen=True)
class Motion:
    """The orientation of the cube in the world, and the wind that moves it.

    `times_s` (row, column) says when each ray is taken. It is None if that makes no difference, and
    the wind is then (0, 0, 0). `moved_m` is how far the cube lets all rays start from their places:
    -U t for a whole image that is taken at a time t.
    """

    orientation: str
    wind_m_s: tuple[float, float, float]
    times_s: Values | None
    moved_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Medium:
    """The cube that rays cross, with the frame of the rays in units of its voxels.

    `frame` (6, 3) is what geometry.cube_frame returns. `time` (ray,) on the device is when each ray
    is taken, in s, or None if nothing moves. `crossed` are the parameters at which each ray enters
    and leaves a cube that is bounded, both (ray,) on the device, or None if it has no bounds.
    """

    field: Field
    frame: Array
    time: Buffer | None
    crossed: tuple[Buffer, Buffer] | None = None


@dataclass(frozen=True)
class Guard:
    """The optical depth at which a ray ends.

    `coefficients` of the path length and of the moments, in 1/m, give the optical depth at the
    frequency that the air absorbs least; a ray ends where that is more than `depth`.
    """

    coefficients: tuple[float, ...]
    depth: float


@dataclass(frozen=True)
class Paths:
    """The paths of rays on the device: `moments` (k, ray) in metres, for k = 1 and up.

    `path_length` and `surface` are those of the rays' ends; a ray that the cut-off ended is
    shorter, and its surface is 0. `facing` is that of RayEnds. `moments` has no rows in even air.
    `interpolated` (ray,) says which rays were not traced. If the values are sums over the way out
    and the way back, `ways` holds the length of each. `guarded` says whether rays may have ended
    at a cut-off depth.
    """

    path_length: Buffer
    surface: Buffer
    facing: Facing
    moments: Buffer
    interpolated: NDArray[np.bool_]
    ways: tuple[Buffer, ...] = ()
    guarded: bool = False


def medium(device: Device, field: Field, ends: RayEnds, motion: Motion) -> Medium:
    """Returns the cube with the frame of the rays that end at `ends`."""
    wind, start = np.array(motion.wind_m_s), ends.start_frame().copy()
    start[0] += motion.moved_m
    frame = geometry.cube_frame(start, motion.orientation, field.lattice, wind)
    times = np.zeros(ends.rays)
    if motion.times_s is not None:
        taken = motion.times_s.array.ravel()
        times[: taken.size] = taken
    crossed = _crossed(device, field.lattice, ends, frame, times)
    moves = motion.times_s is not None
    return Medium(field, frame, device.put(times, device.wide) if moves else None, crossed)


def _crossed(
    device: Device, lattice: Lattice, ends: RayEnds, frame: Array, times: Array
) -> tuple[Buffer, Buffer] | None:
    """Returns where rays enter and leave a bounded cube, both (ray,), or None without bounds."""
    if not lattice.bounded:
        return None
    start, forward, right, up, drift, offset = frame
    numbers = np.minimum(np.arange(ends.rays), ends.geometry.raster.rays - 1)
    camera_frame = np.array([start, forward, right, up])
    step = camera.directions(camera_frame, ends.geometry.raster, numbers)
    if ends.start is not None:
        step = offset + ends.reach.host().astype(np.float64)[:, None] * step
    begin = start + times[:, None] * drift
    enter, leave = lattice.crossed(begin, step, ends.end.host().astype(np.float64))
    return device.put(enter, device.wide), device.put(leave, device.wide)


def trace(
    device: Device,
    ends: RayEnds,
    medium: Medium,
    moments: int,
    guard: Guard | None,
    precision: str,
    followed: Followed | None = None,
    crossed: float = 0.0,
) -> Paths:
    """Returns the paths of rays with their moments.

    `crossed` is about how many voxels all rays together cross.
    A ray that reaches the depth of the `guard` ends there, and meets no surface. If only some rays
    are `followed`, the moments are those of these rays, in their order.
    """
    some = followed or ends.followed
    path_length, surface = changed_ends(device, ends, guard)
    kernels = TraceKernels(**march_options(guard, ends, medium), moments=moments)
    program = device.build(kernels, precision)
    slots = device.padded(some.count, precision)
    out = device.empty((moments, slots), precision)
    segments = device.empty((slots // program.lanes,), np.int32)
    limit = guard or Guard((0.0,) * (moments + 1), np.inf)
    program.run(
        "trace",
        len(segments),
        crossed / slots,
        delta=medium.field.delta,
        **placed(device, ends, medium, some),
        path_length=path_length,
        surface=surface,
        moments=out,
        segments=segments,
        guard=device.put(np.array(limit.coefficients), precision),
        cutoff=limit.depth,
    )
    device.counters.segments += int(segments.host().sum(dtype=np.int64))
    return Paths(path_length, surface, ends.facing, out, every_ray(ends))


def ended(paths: Paths, ends: RayEnds) -> bool:
    """Returns whether some ray ended in the air, at the cut-off depth, before its surface."""
    return bool((paths.path_length.host() < ends.path_length.host()).any())


def every_ray(ends: RayEnds) -> NDArray[np.bool_]:
    """Returns false for every ray, (ray,): none of them is interpolated."""
    return np.broadcast_to(np.False_, (ends.rays,))


def straight(device: Device, ends: RayEnds, precision: str) -> Paths:
    """Returns paths through even air, of which only the length counts."""
    none = device.empty((0, ends.rays), precision)
    return Paths(ends.path_length, ends.surface, ends.facing, none, every_ray(ends))


def there_and_back(device: Device, back: Paths, out: Paths) -> Paths:
    """Returns the paths of light from a transmitter to a surface and back to the camera.

    A ray that the cut-off ended on either way, or whose surface is not lit, has the surface 0.
    """

    def both(one: Buffer, other: Buffer) -> Buffer:
        return device.put(one.host() + other.host())

    lit = np.where(out.surface.host() > 0, np.iinfo(np.int32).max, 0)
    surface = device.put(np.minimum(back.surface.host(), lit), np.int32)
    length = both(back.path_length, out.path_length)
    moments = both(back.moments, out.moments)
    interpolated = back.interpolated | out.interpolated
    ways = back.path_length, out.path_length
    return Paths(length, surface, back.facing, moments, interpolated, ways)


def march_options(guard: object, ends: RayEnds, medium: Medium) -> dict[str, Any]:
    """Returns the options that all kernels have that go from voxel to voxel."""
    return {
        "cutoff": DEPTH_CHECKED_EVERY if guard else None,
        "outgoing": ends.start is not None,
        "motion": medium.time is not None,
        "clipped": medium.crossed is not None,
    }


def placed(device: Device, ends: RayEnds, medium: Medium, followed: Followed) -> dict[str, Any]:
    """Returns the kernel arguments that describe rays in the cube, and where they end."""
    sizes = (n.bit_length() - 1 for n in medium.field.lattice.shape)
    enter, leave = medium.crossed or (ends.reach, ends.reach)
    return {
        "cube": device.put(medium.frame, device.wide),
        **raster_size(ends.geometry),
        **dict(zip(("log2x", "log2y", "log2z"), sizes, strict=True)),
        "reach": ends.reach,
        "end": ends.end,
        "time": ends.reach if medium.time is None else medium.time,
        "enter": enter,
        "leave": leave,
        "stretch": ends.stretch,
        **ray_list(followed),
    }


def changed_ends(device: Device, ends: RayEnds, guard: object) -> tuple[Buffer, Buffer]:
    """Returns the path lengths and surfaces of rays, as copies if a guard can change them."""
    if not guard:
        return ends.path_length, ends.surface
    return device.put(ends.path_length.host()), device.put(ends.surface.host())


def longest_m(ends: RayEnds) -> float:
    """Returns the length of the longest ray, m."""
    return float(ends.path_length.host()[: ends.followed.count].max())


def trace_steps(
    device: Device, ends: RayEnds, medium: Medium, moments: int, step_m: float, precision: str
) -> Paths:
    """Returns paths whose moments are sums over equal steps of `step_m`.

    A step takes its air from the voxel that holds its middle. It is for comparison with exact
    segments; no segments are counted.
    """
    program = device.build(StepKernels(moments), precision)
    out = device.empty((moments, ends.rays), precision)
    program.run(
        "steps",
        ends.rays // program.lanes,
        longest_m(ends) / step_m,
        delta=medium.field.delta,
        **placed(device, ends, medium, ends.followed),
        step=step_m,
        moments=out,
    )
    return Paths(ends.path_length, ends.surface, ends.facing, out, every_ray(ends))
