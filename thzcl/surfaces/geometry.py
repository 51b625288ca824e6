"""Ground, boxes, billboards and meshes as flat arrays for the kernels, in float64.

World axes are in metres, with z up. A ray is given by its number in the raster of rays, row by row
from the top left corner of the image; a pixel of several samples is a small block of that raster.
The parameter s of a ray is the depth along the optical axis in metres: the point at s is
origin + s * direction, and its distance from the origin is s times the norm of the direction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.graph import Values, frozen
from thzcl.scenario.scene import Billboard, Box, Mesh, Scene
from thzcl.surfaces import meshes, texture
from thzcl.surfaces.camera import Raster, camera_frame
from thzcl.surfaces.materials import Workshop
from thzcl.surfaces.meshes import NONE, Laid, Triangles, triangles, turn
from thzcl.surfaces.mirrors import Constant, Mirror
from thzcl.surfaces.texture import Texture
from thzcl.turbulence.lattice import Lattice

Array = NDArray[np.float64]
Integers = NDArray[np.int32]
Locate = Callable[[str], Path]

BACKGROUND, GROUND, FIRST_TARGET = 0, 1, 2  # surfaces, and flags of `target` in the result
FACES = ("-x", "+x", "-y", "+y", "-z", "+z")
LEVELS = 1025  # surfaces of a texture of temperature, between which Planck is all but straight


class Surface(NamedTuple):
    """A surface that a ray can meet, of one temperature (None if not given)."""

    target: int  # the flag in the result's variable `target`
    temperature_k: float | None
    mirror: Mirror
    height_m: float = 0.0  # of its middle, from where it sees its surroundings


KINDS = (
    "ground",
    "boxes",
    "billboards",
    "meshes",
)  # of surfaces: options of kernels, stages of a plan


@frozen
class Things:
    """The things that rays can meet, as tables for the kernels.

    A row of `boxes` holds the centre (3), half the size (3), and the cosine and sine of the yaw. A
    row of `stripes` belongs to one face of one box, faces in the order of FACES; it holds the
    number of stripes, and the surface of the odd stripes. A row of `billboards` holds the centre
    (3), half the width and the height, and the cosine and sine of the direction that it faces. A
    row of `textures` holds the index of its first texel in `texels`, its width and height, whether
    the nearest texel is taken, its first surface, its number of surfaces, and the index of the
    first texel of its mask, or -1.
    """

    ground: bool
    boxes: Values  # (box, 8)
    stripes: Values  # (6 box, 2), int32
    billboards: Values  # (billboard, 7)
    textures: Values  # (billboard, 7), int32
    texels: Values  # (texel,)
    max_range_m: float
    meshes: Triangles = NONE
    ceiling_m: float = math.inf  # the height at which rays end that meet nothing

    @property
    def kinds(self) -> tuple[str, ...]:
        """Returns the kinds that exist, of KINDS."""
        boxes, boards = self.boxes.shape[0] > 0, self.billboards.shape[0] > 0
        there = self.ground, boxes, boards, self.meshes.corners.shape[0] > 0
        return tuple(kind for kind, present in zip(KINDS, there, strict=True) if present)

    @property
    def blended(self) -> bool:
        """Returns whether rays can end between two surfaces."""
        return self.billboards.shape[0] > 0 or self.meshes.tempered


@frozen
class Geometry:
    """A raster of rays and the things that they can meet.

    `frame` (4, 3) holds the camera's position in m, the direction of the image centre, and what one
    column to the right and one row up add to that direction.
    """

    raster: Raster
    frame: Values
    things: Things


def geometry(
    scene: Scene, locate: Locate, rays: Raster, names: Sequence[str]
) -> tuple[Geometry, list[Surface]]:
    """Returns a scene's geometry, and its surfaces by number.

    The surfaces are, in this order: background, ground, boxes, their stripes, billboards, meshes.
    `locate` returns the path of a picture's or a mesh's file. `names` are those of all targets that
    have a flag in the result. Raises FileError for a file that cannot be used.
    """
    polarized = scene.camera.polarization_deg is not None
    air_k = scene.atmosphere.temperature_k
    workshop = Workshop(scene.materials, locate, polarized, air_k)
    background = Surface(BACKGROUND, scene.background.temperature_k, Constant(0.0))
    surfaces = [background, _ground(scene, workshop)]
    numbered = [(_flag(names, name), target) for name, target in scene.targets.items()]
    boxes = [(flag, target) for flag, target in numbered if isinstance(target, Box)]
    boards = [(flag, target) for flag, target in numbered if isinstance(target, Billboard)]
    box_rows, stripes = _boxes(boxes, workshop, surfaces)
    board_rows, textures, texels = _billboards(boards, workshop, surfaces)
    pairs = [(name, target) for name, target in scene.targets.items() if isinstance(target, Mesh)]
    first = len(surfaces)
    laid = [one for pair in pairs for one in _laid(*pair, names, workshop, surfaces)]
    surfaces.append(surfaces[0])  # the last level of a texture blends with the surface after it
    things = Things(
        scene.ground is not None,
        Values.of(box_rows),
        Values.of(stripes, np.int32),
        Values.of(board_rows),
        Values.of(textures, np.int32),
        Values.of(texels),
        scene.background.max_range_m,
        triangles(laid, first),
    )
    return Geometry(rays, Values.of(camera_frame(scene.camera, rays)), things), surfaces


def _ground(scene: Scene, workshop: Workshop) -> Surface:
    """Returns the ground's surface; without a ground it has no temperature and reflects nothing."""
    ground = scene.ground
    if ground is None:
        return Surface(GROUND, None, Constant(0.0))
    law = workshop.law(ground.material, ground.reflectivity, None, ground.temperature_k)
    return Surface(GROUND, ground.temperature_k, law)


def _boxes(
    boxes: list[tuple[int, Box]], workshop: Workshop, surfaces: list[Surface]
) -> tuple[Array, Integers]:
    """Returns the rows of boxes and of their stripes, and appends their surfaces to `surfaces`."""

    def surface(flag: int, box: Box, kelvin: float | None) -> Surface:
        law = workshop.law(box.material, box.reflectivity, box.cover, kelvin)
        return Surface(flag, kelvin, law, box.center_m[2])

    surfaces += [surface(flag, box, box.temperature_k) for flag, box in boxes]
    stripes = np.zeros((len(boxes) * len(FACES), 2), dtype=np.int32)
    rows = []
    for number, (flag, box) in enumerate(boxes):
        rows.append([*box.center_m, *(size / 2 for size in box.size_m), *turn(box.yaw_deg)])
        for bars in box.bars:
            stripes[number * len(FACES) + FACES.index(bars.face)] = bars.count, len(surfaces)
            surfaces.append(surface(flag, box, bars.temperature_k))
    return np.array(rows).reshape(-1, 8), stripes


def _billboards(
    boards: list[tuple[int, Billboard]], workshop: Workshop, surfaces: list[Surface]
) -> tuple[Array, Integers, Array]:
    """Returns the rows of billboards and of their textures, and all texels, those of masks too.

    The billboards' surfaces are appended to `surfaces`.
    """
    rows, textures, texels = [], [], [np.zeros(0)]
    for flag, board in boards:
        picture = texture.read(workshop.locate(board.image), board.range, board.quantity)
        height, width = picture.values.shape
        first, masked = sum(map(len, texels)), -1
        texels.append(picture.values.ravel())
        if board.mask is not None:
            masked = first + height * width
            texels.append(texture.read_mask(workshop.locate(board.mask), (height, width)).ravel())
        levels = _levels(flag, board, picture, workshop)
        nearest = board.interpolation == "nearest"
        textures.append([first, width, height, nearest, len(surfaces), len(levels), masked])
        surfaces += levels
        rows.append(
            [*board.center_m, *(size / 2 for size in board.size_m), *turn(board.facing_deg)]
        )
    return (
        np.array(rows).reshape(-1, 7),
        np.array(textures, dtype=np.int32).reshape(-1, 7),
        np.concatenate(texels),
    )


def _levels(flag: int, board: Billboard, picture: Texture, workshop: Workshop) -> list[Surface]:
    """Returns the surfaces between which a texture blends, from its lowest value to its highest."""
    z, cover = board.center_m[2], board.cover
    if board.quantity == "reflectivity":
        # Emission and reflection are linear in it, but for light that goes to and fro.
        ends = picture.low, picture.high
        values = np.linspace(*ends, LEVELS).tolist() if cover else ends
        return [
            Surface(flag, board.temperature_k, workshop.law(None, one, cover, None), z)
            for one in values
        ]
    kelvins = np.linspace(picture.low, picture.high, LEVELS).tolist()
    laws = (workshop.law(board.material, board.reflectivity, cover, t) for t in kelvins)
    return [Surface(flag, t, law, z) for t, law in zip(kelvins, laws, strict=True)]


def _laid(
    name: str, mesh: Mesh, names: Sequence[str], workshop: Workshop, surfaces: list[Surface]
) -> Iterator[Laid]:
    """Yields the groups of a mesh, and appends their surfaces to `surfaces`."""
    placed = meshes.placed(mesh, workshop.locate)
    height_m = (placed.low_m[2] + placed.high_m[2]) / 2
    for group in placed.groups:
        made = mesh.made_of(group.part)
        flag = _flag(names, f"{name}.{group.part}" if group.part in mesh.parts else name)
        kelvins, levels = [made.temperature_k], None
        if group.kelvin is not None:
            low, high = float(group.kelvin.min()), float(group.kelvin.max())
            kelvins = np.linspace(low, high, meshes.LEVELS).tolist()
            levels = (group.kelvin - low) / ((high - low) or 1.0) * (meshes.LEVELS - 1)
            levels = np.minimum(levels, np.nextafter(np.float32(meshes.LEVELS - 1), 0))
        yield Laid(placed, group, len(surfaces), levels)
        for kelvin in kelvins:
            law = workshop.law(made.material, made.reflectivity or 0.0, made.cover, kelvin)
            surfaces.append(Surface(flag, kelvin, law, height_m))


def _flag(names: Sequence[str], name: str) -> int:
    """Returns the flag of a target in the result."""
    return FIRST_TARGET + names.index(name)


def world_frame(frame: Array, start: Array | None = None) -> Array:
    """Returns the frame of rays in the world, (6, 3), as kernels take it.

    Its rows are the start of the rays, the direction of the image centre, the steps of a column and
    of a row, the drift in a second (which is zero), and the offset from the start to the camera.
    `frame` (4, 3) is that of the camera. Rays start at `start` (3,), or at the camera if that is
    None.
    """
    position = frame[0] if start is None else start
    return np.array([position, *frame[1:], np.zeros(3), frame[0] - position])


def cube_frame(frame: Array, orientation: str, lattice: Lattice, wind_m_s: Array) -> Array:
    """Returns a frame in the world, (6, 3), transformed into the axes and voxels of the cube.

    It drifts against the wind. The start is reduced modulo the period of the cube, along axes that
    have one.
    """
    moving = frame.copy()
    moving[4] = -wind_m_s
    turned = lattice.turned(moving, orientation)
    turned[0] = lattice.placed(turned[0])
    return turned
