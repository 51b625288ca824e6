"""Finds on the device where rays end: at the nearest surface, or at the largest range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Buffer, Device
from thzcl.graph import LeftOut, Memory, Spec, Values, Work, frozen
from thzcl.surfaces import camera, geometry
from thzcl.surfaces.geometry import Geometry, Things

Array = NDArray[np.float64]
_LEFT_OUT = {
    "ground": "no [ground]: no ground test in the kernel",
    "boxes": "no box targets: no box test in the kernel",
    "billboards": "no billboards: no texture in the kernel",
    "meshes": "no meshes: no triangle test in the kernel",
}


@dataclass(frozen=True)
class SurfaceKernels(Kernels):
    """The kernels that find where rays end, with the kinds of surfaces that there are."""

    files: ClassVar = ("surfaces/camera", "surfaces/mesh", "surfaces/surfaces")

    ground: bool
    boxes: bool
    billboards: bool
    meshes: bool = False
    tempered: bool = False
    blended: bool = False
    cosine: bool = False
    elevation: bool = False
    across: bool = False
    bounces: bool = False
    ceiling: bool = False
    outgoing: bool = False


@dataclass(frozen=True)
class Followed:
    """The rays of a raster that are followed: those of some `numbers`, or all if that is None."""

    count: int
    numbers: Buffer | None


def follow(device: Device, shape: Geometry, picked: NDArray[Any] | None = None) -> Followed:
    """Returns all rays of a raster, or those picked by number."""
    if picked is None:
        return Followed(shape.raster.rays, None)
    return Followed(len(picked), device.put(picked, np.int32))


@dataclass(frozen=True)
class Facing:
    """How rays meet their surfaces, (ray,); an array that is not asked for holds a single value.

    `blend` is the weight of the surface with the next number, `cosine` that of the angle between
    ray and normal, `elevation` the sine of the angle above the horizon at which a mirrored ray goes
    on, or at which a ray comes that meets nothing, and `upward` the vertical component of the
    surface's normal on the camera's side. `across` is the part of the power whose field stands
    across the plane of incidence. `met` is the surface that the mirrored ray meets, or 0, and
    `bounce` (ray, 5) its blend, cosine, elevation and upward there, and its length in metres.
    """

    blend: Buffer
    cosine: Buffer
    elevation: Buffer
    upward: Buffer
    across: Buffer
    met: Buffer
    bounce: Buffer


@dataclass(frozen=True)
class Asked:
    """What is wanted to be known of how rays meet their surfaces.

    `cosine` is the slant, `elevation` the directions of mirrored rays and of normals.
    `polarization_deg` is the direction of the field that is seen, or None if it makes no
    difference; `bounces` says whether mirrored rays are followed to the next surface.
    """

    cosine: bool = False
    elevation: bool = False
    polarization_deg: float | None = None
    bounces: bool = False


PLAIN = Asked()


@dataclass(frozen=True)
class RayEnds:
    """The ends of rays, (ray,) on the device, padded to whole groups of packets.

    `reach` is the parameter at which the camera's ray ends. `end` is the parameter at which the ray
    that is followed ends; it differs from `reach` on the way from a transmitter. `stretch` is the
    length in metres of one unit of that parameter, and `path_length` the ray's length in metres.
    `surface` is the number of the surface met, and `facing` says how the camera's ray meets it.
    `start` is the place of a transmitter, or None for rays of the camera.
    """

    geometry: Geometry
    followed: Followed
    reach: Buffer
    end: Buffer
    stretch: Buffer
    path_length: Buffer
    surface: Buffer
    facing: Facing
    start: tuple[float, float, float] | None = None

    @property
    def rays(self) -> int:
        """Returns the number of rays with their padding."""
        return len(self.reach)

    def start_frame(self) -> Array:
        """Returns the frame of the rays in the world, (6, 3), as geometry.world_frame makes it."""
        start = None if self.start is None else np.array(self.start)
        return geometry.world_frame(self.geometry.frame.array, start)

    def ways(self) -> tuple[Array, Array]:
        """Returns the rays in the world: directions (ray, 3) and the start (3,), in m.

        A ray reaches the place start + s * direction at its parameter s.
        """
        start, forward, right, up, _, offset = self.start_frame()
        raster = self.geometry.raster
        numbers = np.minimum(np.arange(self.rays), raster.rays - 1)
        direction = camera.directions(np.array([start, forward, right, up]), raster, numbers)
        if self.start is not None:
            direction = offset + self.reach.host().astype(np.float64)[:, None] * direction
        return direction, start


@frozen
class EndsSpec(Spec):
    """The ends of all rays of a raster, on the device."""

    geometry: Geometry
    precision: str
    asked: Asked = PLAIN

    @property
    def camera(self) -> EndsSpec:
        """Returns this spec, since its ends are those of the camera's rays."""
        return self

    def run(self, device: Device) -> RayEnds:
        """Returns the ends of the rays on the device."""
        return find_ends(device, self.geometry, self.precision, self.asked)

    @property
    def stage(self) -> str:  # type: ignore[override]
        """Returns the kind of surface that takes most time, or "trace" if there are no surfaces."""
        return (*self.geometry.things.kinds, "trace")[-2:][0]

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns, by kind of surface, how many rays are tested against, or why none is."""
        things = self.geometry.things
        boxes, boards = things.boxes.shape[0], things.billboards.shape[0]
        words = {"ground": "the scene has a ground", "boxes": _count(boxes, "box", "boxes")}
        words["billboards"] = _count(boards, "billboard", "billboards")
        words["meshes"] = _count(things.meshes.corners.shape[0], "triangle", "triangles")
        return {
            kind: Work("", words[kind]) if kind in things.kinds else LeftOut(why)
            for kind, why in _LEFT_OUT.items()
        }

    def memory(self) -> Memory:
        """Returns the sizes of the arrays of ends, and of the textures."""
        rays, real = self.geometry.raster.rays, np.dtype(self.precision).itemsize
        things = self.geometry.things
        texels = 4 * things.texels.shape[0]
        wide, meshes = np.dtype(np.float64).itemsize, things.meshes
        nodes, corners = meshes.boxes.shape[0], meshes.corners.shape[0]
        triangles = (
            32 * nodes,
            (16 + 12 * meshes.tempered) * corners,
            3 * wide * meshes.vertices.shape[0],
        )
        asked = self.asked
        reals = 2 + asked.cosine + 2 * asked.elevation + (asked.polarization_deg is not None)
        bounced = (5 * real * rays, 4 * rays) if asked.bounces else ()
        return Memory((8 * rays, *(real * rays,) * reals, 4 * rays, *bounced, texels, *triangles))


def _count(number: int, one: str, many: str) -> str:
    """Returns a number with its noun in singular or plural."""
    return f"{number} {one if number == 1 else many}"


@frozen
class OutgoingSpec(Spec):
    """The ways from a transmitter to the surface that each ray of the camera meets."""

    ends: EndsSpec
    transmitter_m: tuple[float, float, float]
    reads = ("ends",)
    stage = "outgoing-path"

    @property
    def camera(self) -> EndsSpec:
        """Returns the ends of the camera's rays."""
        return self.ends

    @property
    def geometry(self) -> Geometry:
        """Returns the geometry of the camera's rays and of what they can meet."""
        return self.ends.geometry

    @property
    def precision(self) -> str:
        """Returns the type of the arithmetic on the device."""
        return self.ends.precision

    def run(self, device: Device, ends: RayEnds) -> RayEnds:
        """Returns the ways on the device; a way has no length if its surface is not lit."""
        return outgoing_ends(device, ends, self.transmitter_m, self.precision)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that light goes out on another way than it comes back."""
        return {"outgoing-path": Work("", "bistatic: from the transmitter to what is seen")}

    def memory(self) -> Memory:
        """Returns the sizes of the arrays of ends and surfaces."""
        rays, real = self.geometry.raster.rays, np.dtype(self.precision).itemsize
        return Memory((8 * rays, real * rays, 4 * rays))


def find_ends(
    device: Device,
    shape: Geometry,
    precision: str,
    asked: Asked = PLAIN,
    picked: NDArray[Any] | None = None,
) -> RayEnds:
    """Returns the ends of all rays of the camera, or of those picked by number.

    `asked` says what is computed of `facing`; `blend` is if surfaces blend.
    """
    followed = follow(device, shape, picked)
    padded = device.padded(followed.count, precision)
    polarized, blended = asked.polarization_deg is not None, shape.things.blended
    kernels = SurfaceKernels(
        **_kinds(shape.things),
        blended=blended,
        cosine=asked.cosine,
        elevation=asked.elevation,
        across=polarized,
        bounces=asked.bounces,
        ceiling=math.isfinite(shape.things.ceiling_m),
    )
    program = device.build(kernels, precision)
    reach = device.empty((padded,), device.wide)
    stretch, path_length = (device.empty((padded,), precision) for _ in range(2))
    surface = device.empty((padded,), np.int32)
    wanted = blended, asked.cosine, asked.elevation, asked.elevation, polarized
    bounced = padded if asked.bounces else 1
    blend, cosine, elevation, upward, across = (
        device.empty((padded if one else 1,), precision) for one in wanted
    )
    met, bounce = device.empty((bounced,), np.int32), device.empty((bounced, 5), precision)
    facing = Facing(blend, cosine, elevation, upward, across, met, bounce)
    program.run(
        "surfaces",
        padded,
        _tests_a_ray(shape.things),
        camera=device.put(geometry.world_frame(shape.frame.array), device.wide),
        **raster_size(shape),
        max_range=shape.things.max_range_m,
        ceiling=shape.things.ceiling_m,
        **_things(device, shape.things),
        **ray_list(followed),
        reach=reach,
        stretch=stretch,
        path_length=path_length,
        surface=surface,
        blend=facing.blend,
        cosine=facing.cosine,
        elevation=facing.elevation,
        upward=facing.upward,
        polarization=(
            device.put(_field(shape, asked.polarization_deg), device.wide)
            if asked.polarization_deg is not None
            else None
        ),
        across=facing.across,
        met=facing.met,
        bounce=facing.bounce,
    )
    return RayEnds(shape, followed, reach, reach, stretch, path_length, surface, facing)


def _field(shape: Geometry, polarization_deg: float) -> Array:
    """Returns the direction of the field that is seen, (3,), from the image's right towards up."""
    right, up = (axis / np.linalg.norm(axis) for axis in shape.frame.array[2:])
    angle = np.deg2rad(polarization_deg)
    return np.asarray(np.cos(angle) * right + np.sin(angle) * up)


def outgoing_ends(
    device: Device, ends: RayEnds, transmitter_m: tuple[float, float, float], precision: str
) -> RayEnds:
    """Returns the ways from a transmitter to the surface that each ray of the camera meets.

    A way has no length if the ray meets no surface, or if another surface stands in the way.
    """
    shape = ends.geometry
    program = device.build(SurfaceKernels(**_kinds(shape.things), outgoing=True), precision)
    surface = device.put(ends.surface.host())
    end = device.empty((ends.rays,), device.wide)
    length = device.empty((ends.rays,), precision)
    frame = geometry.world_frame(shape.frame.array, np.array(transmitter_m))
    program.run(
        "outgoing",
        ends.rays,
        _tests_a_ray(shape.things),
        transmitter=device.put(frame, device.wide),
        **raster_size(shape),
        **_things(device, shape.things),
        **ray_list(ends.followed),
        reach=ends.reach,
        surface=surface,
        first_of_meshes=shape.things.meshes.first,
        end=end,
        length=length,
    )
    unchanged = ends.facing, transmitter_m
    return RayEnds(shape, ends.followed, ends.reach, end, length, length, surface, *unchanged)


def _tests_a_ray(things: Things) -> float:
    """Returns about how many surfaces and boxes of trees a ray is tested against."""
    boxes, boards, triangles = (
        one.shape[0] for one in (things.boxes, things.billboards, things.meshes.corners)
    )
    return 1.0 + boxes + boards + 10.0 * math.log2(1 + triangles)


def _kinds(things: Things) -> dict[str, bool]:
    """Returns the kernels' options that say which kinds of surfaces there are."""
    there = {kind: kind in things.kinds for kind in geometry.KINDS}
    return there | {"tempered": things.meshes.tempered}


def _things(device: Device, things: Things) -> dict[str, Any]:
    """Returns the kernel arguments that describe the things that rays can meet.

    A table without rows is passed as one row of zeros, which the kernel does not read.
    """

    def table(rows: Values, dtype: DTypeLike) -> Buffer:
        return device.put(rows.array if rows.data else np.zeros(8), dtype)

    def of_meshes(rows: Values, dtype: DTypeLike) -> Buffer | None:
        return device.put(rows.array, dtype) if rows.data else None

    meshes = things.meshes
    return {
        "boxes": table(things.boxes, device.wide),
        "stripes": table(things.stripes, np.int32),
        "box_count": things.boxes.shape[0],
        "billboards": table(things.billboards, device.wide),
        "textures": table(things.textures, np.int32),
        "texels": table(things.texels, np.float32),
        "billboard_count": things.billboards.shape[0],
        "mesh_boxes": of_meshes(meshes.boxes, np.float32),
        "mesh_links": of_meshes(meshes.links, np.int32),
        "mesh_triangles": of_meshes(meshes.corners, np.int32),
        "mesh_vertices": of_meshes(meshes.vertices, device.wide),
        "mesh_levels": of_meshes(meshes.levels, np.float32),
    }


def raster_size(shape: Geometry) -> dict[str, Any]:
    """Returns the kernel arguments for the columns and the rows of a raster."""
    return {"width": shape.raster.columns, "height": shape.raster.rows}


def ray_list(followed: Followed) -> dict[str, Any]:
    """Returns the kernel arguments for the rays that are followed, with no list if all are."""
    return {"picked": followed.numbers, "count": followed.count}
