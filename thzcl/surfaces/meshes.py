"""Meshes in the world: triangles with their surfaces, and the tree by which rays find them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import FileError
from thzcl.graph import Values, frozen
from thzcl.plugins.names import suggest
from thzcl.scenario.scene import Mesh, Scene
from thzcl.surfaces import mesh_file, tree
from thzcl.surfaces.mesh_file import MeshFile

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Locate = Callable[[str], Path]

LEVELS = 256  # surfaces of a temperature that varies, between which Planck is all but straight
FARTHEST_M = 1e9
COLDEST_K, WARMEST_K = 0.0, 1e19  # the limits of the key temperature_k


@frozen
class Triangles:
    """The triangles of all meshes in the world, and the tree over them, as mesh.cl takes them.

    `boxes` (node, 6) in float32 and `links` (node, 2) are the tree's. `corners` (triangle, 4) hold
    the numbers of three vertices and the surface, `vertices` (vertex, 3) are in m. `levels`
    (triangle, 3) in float32 say how far corners lie beyond their surface; there are none if no
    temperature varies. `first` is the number of the meshes' first surface.
    """

    boxes: Values
    links: Values
    corners: Values
    vertices: Values
    levels: Values
    first: int

    @property
    def tempered(self) -> bool:
        """Returns whether the temperature of some mesh varies."""
        return self.levels.shape[0] > 0

    def struck(self, origin: Array, direction: Array) -> tuple[Array, NDArray[np.int32]]:
        """Returns where rays meet triangles first, inf for none, and the surface, both (ray,)."""
        corners, vertices = self.corners.array, self.vertices.array
        a, b, c = (vertices[corners[:, k]] for k in range(3))
        found = tree.first_struck(self.boxes.array, self.links.array, (a, b, c), origin, direction)
        surface = np.where(found.triangle < 0, 0, corners[found.triangle, 3])
        if self.tempered:  # the middle of a triangle stands for all of it
            middle = self.levels.array.mean(axis=1).astype(np.int32)
            surface = surface + np.where(found.triangle < 0, 0, middle[found.triangle])
        return found.reach, surface.astype(np.int32)


class Group(NamedTuple):
    """The triangles of one part of a mesh: its name, their places, and how warm their corners are.

    `kelvin` (triangle, 3) is None if the part has one temperature.
    """

    part: str
    places: Integers
    kelvin: Array | None


@dataclass(frozen=True)
class Placed:
    """A mesh in the world: `vertices` (vertex, 3) in m, `faces` (triangle, 3), and its groups."""

    path: Path
    read: MeshFile
    vertices: Array
    groups: tuple[Group, ...]

    @property
    def low_m(self) -> tuple[float, float, float]:
        """Returns the lowest corner of the box around it, m."""
        return _corner(self.vertices.min(axis=0))

    @property
    def high_m(self) -> tuple[float, float, float]:
        """Returns the highest corner of the box around it, m."""
        return _corner(self.vertices.max(axis=0))

    def box_m(self, part: str | None = None) -> Array:
        """Returns the corners of the box around it, or around one of its parts, (8, 3) in m."""
        faces = [self.read.faces[one.places] for one in self.groups if part in (None, one.part)]
        points = self.vertices[np.concatenate(faces).ravel()] if faces else self.vertices
        ends = np.stack([points.min(axis=0), points.max(axis=0)])
        return np.stack(np.meshgrid(*ends.T), axis=-1).reshape(8, 3)

    def notes(self, name: str) -> list[str]:
        """Returns what to tell of a mesh that is the target `name`."""
        if not self.read.dropped:
            return []
        many = f"{self.read.dropped:,} triangle{'s' if self.read.dropped > 1 else ''}"
        return [f"{name}: {many} without an area left out of {self.path.name}"]

    def table(self) -> dict[str, Any]:
        """Returns what a plan prints of the mesh."""
        return {
            "file": self.path.name,
            "triangles": len(self.read.faces),
            "vertices": len(self.read.vertices),
            "parts": list(self.read.parts),
            "low_m": [round(one, 6) for one in self.low_m],
            "high_m": [round(one, 6) for one in self.high_m],
        }


def _corner(point: Array) -> tuple[float, float, float]:
    x, y, z = point.tolist()
    return x, y, z


def placed(mesh: Mesh, locate: Locate) -> Placed:
    """Returns a mesh in the world. Raises FileError for a file or a part that cannot be used."""
    path = locate(mesh.file)
    return _placed(mesh, path, mesh_file.read(path))


def top_m(scene: Scene, locate: Locate) -> float:
    """Returns the height of the highest vertex of a scene's meshes, m; -inf without one."""
    tops = [
        placed(one, locate).high_m[2] for one in scene.targets.values() if isinstance(one, Mesh)
    ]
    return max(tops, default=-np.inf)


def _placed(mesh: Mesh, path: Path, read: MeshFile) -> Placed:
    """Returns what `placed` describes, of a file that was read."""
    _refuse_parts(mesh, path, read)
    vertices = _in_world(mesh, read)
    if np.abs(vertices).max() > FARTHEST_M:
        raise FileError(f"{path}: reaches beyond {FARTHEST_M:g} m; lower scale")
    return Placed(path, read, vertices, tuple(_groups(mesh, path, read)))


def _refuse_parts(mesh: Mesh, path: Path, read: MeshFile) -> None:
    """Raises FileError for a part that the file does not have."""
    for name in mesh.parts:
        if name not in read.parts:
            known = [part for part in read.parts if part]
            text = suggest(name, known) if known else "the file names no parts"
            raise FileError(f"{path}: no part {name} ({text})")


def _in_world(mesh: Mesh, read: MeshFile) -> Array:
    """Returns the vertices in the world, m: scaled, upright, pitched, turned and moved."""
    x, y, z = (read.vertices * mesh.scale).T
    if (mesh.up or read.up) == "y":
        y, z = -z, y
    cosine, sine = turn(mesh.pitch_deg)
    x, z = cosine * x - sine * z, sine * x + cosine * z
    cosine, sine = turn(mesh.yaw_deg)
    x, y = cosine * x - sine * y, sine * x + cosine * y
    return np.asarray(np.stack([x, y, z], axis=1) + np.array(mesh.center_m))


def turn(degrees: float) -> tuple[float, float]:
    """Returns cosine and sine, exact for quarter turns, so that faces stay on planes of a grid."""
    angle = np.deg2rad(degrees)
    cosine, sine = (
        0.0 if abs(value) < 1e-15 else float(value) for value in (np.cos(angle), np.sin(angle))
    )
    return cosine, sine


def _groups(mesh: Mesh, path: Path, read: MeshFile) -> list[Group]:
    """Returns the triangles by part, those of parts that the mesh does not name last."""
    found = []
    named = [read.parts.index(name) for name in mesh.parts]
    rest = np.flatnonzero(~np.isin(read.part, named))
    pieces = [
        (name, np.flatnonzero(read.part == n)) for name, n in zip(mesh.parts, named, strict=True)
    ]
    for name, places in [*pieces, ("", rest)]:
        if name in mesh.parts and not mesh.parts[name].shown:
            continue
        attribute = mesh.made_of(name).temperature
        kelvin = None if attribute is None else _kelvin(path, read, attribute)[places]
        if len(places):
            found.append(Group(name, places, kelvin))
    return found


def _kelvin(path: Path, read: MeshFile, name: str) -> Array:
    """Returns the temperature of the triangles' corners, (triangle, 3), from an attribute."""
    if name not in read.attributes:
        text = suggest(name, read.attributes) if read.attributes else "the file has none"
        raise FileError(f"{path}: no attribute {name} of vertices or faces ({text})")
    element, values = read.attributes[name]
    wanted = len(read.vertices) if element == "vertex" else len(read.faces)
    if len(values) != wanted:
        text = f"{len(values):,} values for {wanted:,} triangles; split all faces into triangles"
        raise FileError(f"{path}: {name}: {text}")
    corners = values[read.faces] if element == "vertex" else np.repeat(values[:, None], 3, axis=1)
    if not np.isfinite(corners).all():
        raise FileError(f"{path}: {name}: a value is not finite; mend the file")
    low, high = float(corners.min()), float(corners.max())
    if low < COLDEST_K or high > WARMEST_K:
        text = f"{low:g} to {high:g}; a temperature must lie between 0 and {WARMEST_K:g} K"
        raise FileError(f"{path}: {name}: {text}")
    return corners


class Laid(NamedTuple):
    """A group of triangles in a scene: of which mesh, its first surface and their levels."""

    mesh: Placed
    group: Group
    surface: int
    levels: Array | None  # (triangle, 3)


def triangles(laid: Sequence[Laid], first: int) -> Triangles:
    """Returns the triangles of some groups, in the order of the tree over them."""
    if not laid:
        return NONE
    meshes = list({id(one.mesh): one.mesh for one in laid}.values())
    before = dict(
        zip(map(id, meshes), np.cumsum([0, *(len(m.vertices) for m in meshes)]), strict=False)
    )
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    corners = np.concatenate(
        [
            np.column_stack(
                [
                    one.mesh.read.faces[one.group.places] + before[id(one.mesh)],
                    np.full(len(one.group.places), one.surface),
                ]
            )
            for one in laid
        ]
    ).astype(np.int32)
    grown = _grown(vertices.tobytes(), corners[:, :3].tobytes())
    levels = np.zeros((0, 3))
    if any(one.levels is not None for one in laid):
        each = [
            np.zeros((len(one.group.places), 3)) if one.levels is None else one.levels
            for one in laid
        ]
        levels = np.concatenate(each)[grown.order]
    return Triangles(
        Values.of(grown.boxes, np.float32),
        Values.of(grown.links, np.int32),
        Values.of(corners[grown.order], np.int32),
        Values.of(vertices),
        Values.of(levels, np.float32),
        first,
    )


@lru_cache(maxsize=4)  # the variants of a scenario share their meshes
def _grown(vertices: bytes, faces: bytes) -> tree.Tree:
    """Returns the tree over some triangles."""
    points = np.frombuffer(vertices).reshape(-1, 3)
    corners = [points[number] for number in np.frombuffer(faces, np.int32).reshape(-1, 3).T]
    low = np.minimum(np.minimum(corners[0], corners[1]), corners[2])
    high = np.maximum(np.maximum(corners[0], corners[1]), corners[2])
    return tree.grow(low, high)


def _none() -> Triangles:
    """Returns no triangles."""
    empty = Values.of(np.zeros((0, 3)), np.float32)
    whole = Values.of(np.zeros((0, 4)), np.int32)
    boxes = Values.of(np.zeros((0, 6)), np.float32)
    return Triangles(boxes, whole, whole, Values.of(np.zeros((0, 3))), empty, 0)


NONE = _none()
