"""Where rays end, found on the device: the nearest surface, or the largest range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import GROUP, Buffer, Device
from thzcl.graph import LeftOut, Memory, Spec, Values, Work, frozen
from thzcl.surfaces import geometry
from thzcl.surfaces.geometry import Geometry, Things

Array = NDArray[np.float64]
_NEEDLESS = {
    "ground": "no [ground]: no ground test in the kernel",
    "boxes": "no box targets: no box test in the kernel",
    "billboards": "no billboards: no texture in the kernel",
}


@dataclass(frozen=True)
class Followed:
    """The rays of a raster that are followed: those of the given `numbers`, or all."""

    count: int
    numbers: Buffer | None

    def padded(self, device: Device, precision: str) -> int:
        """Returns how many slots they take in whole groups of packets."""
        packet = device.lanes(precision) * GROUP
        return -(-self.count // packet) * packet


def follow(device: Device, shape: Geometry, picked: NDArray[Any] | None = None) -> Followed:
    """Returns all rays of a raster, or those picked by number."""
    if picked is None:
        return Followed(shape.raster.rays, None)
    return Followed(len(picked), device.put(picked, np.int32))


@dataclass(frozen=True)
class RayEnds:
    """Where rays end, on the device; arrays are padded to whole groups of packets.

    `reach` is how far the camera's ray goes and `end` how far the ray that is followed, both in the
    ray's parameter; `stretch` metres per unit of the latter's, `path_length` its length in metres.
    `surface` is a number, `blend` how far towards the next one, `cosine` that of the angle between
    ray and normal (one value where it is not asked for). `start` is a transmitter, or None.
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
    start: tuple[float, float, float] | None = None

    @property
    def rays(self) -> int:
        """Returns the number of rays with their padding."""
        return len(self.reach)

    def start_frame(self) -> Array:
        """Returns the frame in the world from which rays start, (6, 3)."""
        start = None if self.start is None else np.array(self.start)
        return geometry.world_frame(self.geometry.frame.array, start)


@frozen
class EndsSpec(Spec):
    """Where the rays of a raster end."""

    geometry: Geometry
    precision: str
    cosine: bool = False  # whether the slant of surfaces is wanted

    @property
    def camera(self) -> EndsSpec:
        """Returns these ends: they are the camera's."""
        return self

    def run(self, device: Device) -> RayEnds:
        """Returns the ends on the device."""
        return find_ends(device, self.geometry, self.precision, cosine=self.cosine)

    @property
    def stage(self) -> str:  # type: ignore[override]
        """Returns the kind of surface that takes most time, or "trace" where there is none."""
        return (*self.geometry.things.kinds, "trace")[-2:][0]

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns the kinds of surfaces that rays are tested against."""
        things = self.geometry.things
        boxes, boards = things.boxes.shape[0], things.billboards.shape[0]
        words = {"ground": "the scene has a ground", "boxes": _count(boxes, "box", "boxes")}
        words["billboards"] = _count(boards, "billboard", "billboards")
        return {
            kind: Work("", words[kind]) if kind in things.kinds else LeftOut(why)
            for kind, why in _NEEDLESS.items()
        }

    def memory(self) -> Memory:
        """Returns eight values a ray, some of them wide."""
        rays, real = self.geometry.raster.rays, np.dtype(self.precision).itemsize
        texels = 4 * self.geometry.things.texels.shape[0]
        return Memory((8 * rays, *(real * rays,) * (2 + self.cosine), 4 * rays, texels))


def _count(number: int, one: str, many: str) -> str:
    return f"{number} {one if number == 1 else many}"


@frozen
class OutgoingSpec(Spec):
    """The ways from a transmitter to what each ray of the camera met."""

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
        """Returns the camera's rays and what they can meet."""
        return self.ends.geometry

    @property
    def precision(self) -> str:
        """Returns the arithmetic on the device."""
        return self.ends.precision

    def run(self, device: Device, ends: RayEnds) -> RayEnds:
        """Returns the ways on the device; those to what is not lit have no length."""
        return outgoing_ends(device, ends, self.transmitter_m, self.precision)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that there is a second way."""
        return {"outgoing-path": Work("", "bistatic: from the transmitter to what is seen")}

    def memory(self) -> Memory:
        """Returns three values a ray."""
        rays, real = self.geometry.raster.rays, np.dtype(self.precision).itemsize
        return Memory((8 * rays, real * rays, 4 * rays))


def find_ends(
    device: Device,
    shape: Geometry,
    precision: str,
    *,
    cosine: bool = False,
    picked: NDArray[Any] | None = None,
) -> RayEnds:
    """Returns where every ray of the camera, or every one picked by number, ends."""
    followed = follow(device, shape, picked)
    padded = followed.padded(device, precision)
    options = [*_kinds(shape.things), *(["COSINE"] if cosine else [])]
    program = device.build(("surfaces/camera", "surfaces/surfaces"), precision, options)
    textured = "billboards" in shape.things.kinds
    reach = device.empty((padded,), device.wide)
    stretch, path_length = (device.empty((padded,), precision) for _ in range(2))
    surface = device.empty((padded,), np.int32)
    blend, slant = (
        device.empty((padded if wanted else 1,), precision) for wanted in (textured, cosine)
    )
    program.run(
        "surfaces",
        padded,
        device.put(geometry.world_frame(shape.frame.array), device.wide),
        *raster_size(shape),
        device.wide.type(shape.things.max_range_m),
        *_things(device, shape.things),
        *ray_list(followed),
        reach,
        stretch,
        path_length,
        surface,
        blend,
        slant,
    )
    return RayEnds(shape, followed, reach, reach, stretch, path_length, surface, blend, slant)


def outgoing_ends(
    device: Device, ends: RayEnds, transmitter_m: tuple[float, float, float], precision: str
) -> RayEnds:
    """Returns the ways from a transmitter to what each ray met.

    Where nothing was met, or something stands between, there is no way at all.
    """
    shape = ends.geometry
    options = [*_kinds(shape.things), "OUTGOING"]
    program = device.build(("surfaces/camera", "surfaces/surfaces"), precision, options)
    surface = device.put(ends.surface.host())
    end = device.empty((ends.rays,), device.wide)
    length = device.empty((ends.rays,), precision)
    frame = geometry.world_frame(shape.frame.array, np.array(transmitter_m))
    program.run(
        "outgoing",
        ends.rays,
        device.put(frame, device.wide),
        *raster_size(shape),
        *_things(device, shape.things),
        *ray_list(ends.followed),
        ends.reach,
        surface,
        end,
        length,
    )
    unchanged = ends.blend, ends.cosine, transmitter_m
    return RayEnds(shape, ends.followed, ends.reach, end, length, length, surface, *unchanged)


def _kinds(things: Things) -> list[str]:
    """Returns the build options that name what can be met."""
    return [kind.upper() for kind in things.kinds]


def _things(device: Device, things: Things) -> tuple[object, ...]:
    """Returns the kernel arguments that describe what can be met.

    Of nothing there is one row, which is not looked at.
    """

    def table(rows: Values, dtype: Any) -> Buffer:
        return device.put(rows.array if rows.data else np.zeros(8), dtype)

    return (
        table(things.boxes, device.wide),
        table(things.stripes, np.int32),
        np.int32(things.boxes.shape[0]),
        table(things.billboards, device.wide),
        table(things.textures, np.int32),
        table(things.texels, np.float32),
        np.int32(things.billboards.shape[0]),
    )


def raster_size(shape: Geometry) -> tuple[np.int32, np.int32]:
    """Returns the kernel arguments for a raster's width and height."""
    return np.int32(shape.raster.columns), np.int32(shape.raster.rows)


def ray_list(followed: Followed) -> tuple[Buffer | None, np.int32]:
    """Returns the kernel arguments that say which rays are followed; of all there is no list."""
    return followed.numbers, np.int32(followed.count)
