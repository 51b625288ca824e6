"""Meshes from files: OBJ, STL, PLY and GLB by trimesh, and NPZ; checked before they are trusted."""

from __future__ import annotations

import io
import logging
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import FileError
from thzcl.files import MESH, digest, parse_json, read_bytes

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Attribute = tuple[Literal["vertex", "face"], Array]

MOST_TRIANGLES = 5_000_000
FARTHEST = 1e9  # of a coordinate, before it is scaled
STL_HEAD, STL_TRIANGLE = 84, 50  # bytes
FORMATS = ("obj", "stl", "ply", "glb", "npz")
UPWARD = {"glb": "y"}  # formats whose y axis points up


@dataclass(frozen=True)
class MeshFile:
    """Triangles of a file, in its own axes and units.

    `faces` (triangle, 3) are numbers of `vertices` (vertex, 3), and `part` (triangle,) numbers of
    `parts`, of which there is one in a file that names none. `attributes` by name are of each
    "vertex" or "face", or of as many values as the file has, if these are other numbers. Triangles
    without an area are left out; `dropped` counts them.
    """

    vertices: Array
    faces: Integers
    part: Integers
    parts: tuple[str, ...]
    up: str
    dropped: int
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


def read(path: Path) -> MeshFile:
    """Returns the mesh in a file.

    Raises FileError for a file that is missing, too large, broken, empty or of another kind, for
    numbers that are not finite, and where trimesh is needed but not installed.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise FileError(f"{path}: no mesh by its name; {MESH.give}")
    return _read(path, kind, digest(path, MESH))


@lru_cache(maxsize=4)  # the variants of a scenario share their meshes
def _read(path: Path, kind: str, content: str) -> MeshFile:  # noqa: ARG001 (as texture.py's)
    """Returns what `read` describes, for a file whose bytes have the SHA-256 `content`."""
    data = read_bytes(path, MESH)
    try:
        if kind == "npz":
            pieces, attributes = _arrays(path, data)
        else:
            data = _sound(path, kind, data)
            pieces, attributes = _by_trimesh(path, kind, data)
    except FileError:
        raise
    except Exception as error:  # noqa: BLE001 (whatever a reader makes of a hostile file)
        reason = str(error).partition("\n")[0][:120] or type(error).__name__
        raise FileError(f"{path}: cannot be read: {reason}; {MESH.give}") from None
    return _checked(path, kind, pieces, attributes)


@dataclass(frozen=True)
class _Piece:
    """A named piece of a file, or one of several names, of which `part` numbers the triangles'."""

    name: str
    vertices: Array
    faces: Integers
    names: tuple[str, ...] = ()
    part: Integers | None = None


def _by_trimesh(path: Path, kind: str, data: bytes) -> tuple[list[_Piece], dict[str, Attribute]]:
    """Returns the pieces of a file as trimesh reads it, and the attributes of a PLY."""
    try:
        import trimesh
    except ImportError:
        text = f"{kind.upper()} files are read by trimesh, which is not installed"
        raise FileError(f"{path}: {text}; run: pip install 'thzcl[mesh]'") from None
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    given: dict[str, Any] = {"file_type": kind, "process": False}
    split = b"o" if _named(data, b"o") else b"g"  # objects, or groups where there are none
    if kind == "obj":
        given |= {"group_material": False, "skip_materials": True}
        given |= {"split_objects": split == b"o", "split_groups": split == b"g"}
    with warnings.catch_warnings(action="ignore"):
        scene = trimesh.load_scene(io.BytesIO(data), **given)
    pieces = list(_pieces(scene))
    if kind == "stl":
        _refuse_lost(path, data, sum(len(piece.faces) for piece in pieces))
    if kind == "obj":  # objects come in another order than the file's
        order = _named(data, split)
        pieces.sort(key=lambda piece: order.get(piece.name, len(order)))
    return pieces, _ply_attributes(scene) if kind == "ply" else {}


def _pieces(scene: Any) -> Iterator[_Piece]:
    """Yields the pieces of a scene of trimesh, each where its node places it."""
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces"):  # points or lines
            continue
        vertices = np.asarray(mesh.vertices, np.float64)
        matrix = np.asarray(matrix, np.float64)
        if not np.array_equal(matrix, np.eye(4)):
            vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
        yield _Piece(str(node), vertices, np.asarray(mesh.faces, np.int64))


def _named(data: bytes, key: bytes) -> dict[str, int]:
    """Returns the names of an OBJ's objects ("o") or groups ("g"), numbered in the file's order."""
    names = re.findall(rb"^" + key + rb"[ \t]+(.*?)\s*$", data, re.MULTILINE)
    return {name.decode("utf-8", "replace"): n for n, name in enumerate(dict.fromkeys(names))}


def _refuse_lost(path: Path, data: bytes, read: int) -> None:
    """Raises FileError where an STL in text has more triangles than were read: it is cut off."""
    if _binary_stl(data):
        return
    told = len(re.findall(rb"^\s*facet\b", data, re.MULTILINE | re.IGNORECASE))
    if told != read:
        raise FileError(f"{path}: cut off or broken: {told:,} triangles begin, {read:,} are whole")


def _ply_attributes(scene: Any) -> dict[str, Attribute]:
    """Returns the properties of a PLY's vertices and faces that are single numbers."""
    found: dict[str, Attribute] = {}
    elements: tuple[Literal["vertex", "face"], ...] = "face", "vertex"
    for mesh in scene.geometry.values():
        raw = mesh.metadata.get("_ply_raw", {})
        for element in elements:
            part = raw.get(element, {})
            for name in part.get("properties", {}) if part.get("length") else ():
                values = np.asarray(part["data"][name])
                if values.dtype.kind in "fiu" and values.size == part["length"]:
                    found[name] = element, values.ravel().astype(np.float64)
    return found


def _arrays(path: Path, data: bytes) -> tuple[list[_Piece], dict[str, Attribute]]:
    """Returns the pieces of an NPZ file, and its other arrays as attributes.

    `parts` are their names, and `part` (triangle,) numbers them; without these there is one piece.
    """
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise FileError(f"{path}: no NPZ file; write it by numpy.savez(file, vertices=, faces=)")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        for name in ("vertices", "faces"):
            if name not in arrays:
                raise FileError(f"{path}: no array {name}; it needs vertices and faces")
        size = sum(info.file_size for info in arrays.zip.infolist())
        if size > MESH.most_bytes:
            raise FileError(f"{path}: holds {size / 1e6:.6g} MB when unpacked; give less")
        read = {name: arrays[name] for name in arrays.files}
    vertices, faces = read.pop("vertices"), read.pop("faces")
    names, part = read.pop("parts", np.array([""])), read.pop("part", np.zeros(len(faces), np.int8))
    numbered = part.shape == (len(faces),) and part.dtype.kind in "iu" and names.dtype.kind == "U"
    if not numbered or (len(part) and not 0 <= part.min() <= part.max() < names.size):
        raise FileError(f"{path}: part must number the parts (names) of its triangles from 0")
    if vertices.dtype.kind not in "fiu" or faces.dtype.kind not in "iu":
        raise FileError(f"{path}: vertices must be numbers, and faces whole numbers")
    attributes: dict[str, Attribute] = {
        name: ("vertex" if len(values) == len(vertices) else "face", values.astype(np.float64))
        for name, values in read.items()
        if values.ndim == 1 and values.dtype.kind in "fiu"
    }
    whole = _Piece("", vertices.astype(np.float64), faces.astype(np.int64))
    return [replace(whole, names=tuple(names.tolist()), part=part.astype(np.int64))], attributes


def _binary_stl(data: bytes) -> bool:
    """Returns whether an STL is binary: text begins with "solid" and has no zeros."""
    return len(data) >= STL_HEAD and (
        b"\0" in data[:STL_HEAD] or not data[:STL_HEAD].lstrip().lower().startswith(b"solid")
    )


def _sound(path: Path, kind: str, data: bytes) -> bytes:
    """Returns a file's bytes as trimesh reads them: text in UTF-8, nothing after its triangles.

    Raises FileError where a file says that it holds more than its bytes can.
    """
    if kind == "stl" and _binary_stl(data):
        return _whole_stl(path, data)
    if kind == "ply":
        _check_ply(path, data)
    elif kind == "glb":
        _check_glb(path, data)
    else:
        try:
            data.decode("utf-8")
        except UnicodeDecodeError:
            return data.decode("latin-1").encode("utf-8")
    return data


def _whole_stl(path: Path, data: bytes) -> bytes:
    """Returns a binary STL up to its last triangle. Raises FileError where that is not there."""
    told = int.from_bytes(data[STL_HEAD - 4 : STL_HEAD], "little")
    there = (len(data) - STL_HEAD) // STL_TRIANGLE
    if told != there:
        raise FileError(f"{path}: says {told:,} triangles but holds {there:,}: cut off or broken")
    return data[: STL_HEAD + STL_TRIANGLE * told]


def _check_ply(path: Path, data: bytes) -> None:
    """Raises FileError for a PLY that says that it holds more than its bytes can."""
    head, _, body = data.partition(b"end_header")
    counts = [line.split() for line in head[:100_000].splitlines() if line.startswith(b"element")]
    for words in counts:
        if len(words) != 3 or not words[2].isdigit() or int(words[2]) > len(data):
            shown = b" ".join(words).decode("ascii", "replace")[:60]
            raise FileError(f"{path}: cannot hold {shown}: it is cut off or broken")
    if b"format ascii" not in head:
        return
    rows, lines = sum(int(words[2]) for words in counts), len(re.findall(rb"\S[^\r\n]*", body))
    if lines < rows:
        raise FileError(f"{path}: says {rows:,} lines but holds {lines:,}: it is cut off")


def _check_glb(path: Path, data: bytes) -> None:
    """Raises FileError for a GLB that says that it holds more than its bytes can."""
    size = int.from_bytes(data[12:16], "little")
    if data[:4] != b"glTF" or data[16:20] != b"JSON" or size > len(data) - 20:
        raise FileError(f"{path}: no GLB file; export it as binary glTF 2.0")
    told = parse_json(data[20 : 20 + size], str(path), MESH)
    for one in told.get("accessors", ()):
        if not 0 <= int(one.get("count", 0)) <= len(data):
            raise FileError(f"{path}: cannot hold {one['count']} values: it is broken")
    if any(not str(one.get("uri", "data:")).startswith("data:") for one in told.get("buffers", ())):
        raise FileError(f"{path}: its data lie in another file; export it as one GLB")


def _checked(
    path: Path, kind: str, pieces: list[_Piece], attributes: Mapping[str, Attribute]
) -> MeshFile:
    """Returns the triangles of some pieces. Raises FileError for what is no mesh."""
    for piece in pieces:
        _refuse_broken(path, piece)
    count = sum(len(piece.faces) for piece in pieces)
    if not count:
        raise FileError(f"{path}: holds no triangles; {MESH.give}")
    if count > MOST_TRIANGLES:
        raise FileError(f"{path}: holds {count:,} triangles; simplify it to {MOST_TRIANGLES:,}")
    before = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    vertices = np.concatenate([piece.vertices for piece in pieces])
    faces = np.concatenate([p.faces + b for p, b in zip(pieces, before, strict=False)])
    part = np.repeat(np.arange(len(pieces)), [len(piece.faces) for piece in pieces])
    names = [piece.name for piece in pieces]
    if pieces[0].part is not None:
        names, part = list(pieces[0].names), pieces[0].part
    used = vertices[faces]
    if not np.isfinite(used).all() or np.abs(used).max() > FARTHEST:
        raise FileError(f"{path}: a vertex is not finite, or beyond {FARTHEST:g}; mend the mesh")
    good = _has_area(used)
    if not good.any():
        raise FileError(f"{path}: no triangle has an area; {MESH.give}")
    parts = tuple(dict.fromkeys(names))
    numbered = np.array([parts.index(name) for name in names])[part]
    numbers, faces = np.unique(faces[good], return_inverse=True)  # of vertices that are used
    kept = {}
    for name, (element, values) in attributes.items():
        fits = len(values) == (len(vertices) if element == "vertex" else count)
        chosen = numbers if element == "vertex" else good
        kept[name] = element, values[chosen] if fits else values
    up, dropped = UPWARD.get(kind, "z"), int((~good).sum())
    faces = faces.reshape(-1, 3)
    return MeshFile(vertices[numbers], faces, numbered[good], parts, up, dropped, kept)


def _refuse_broken(path: Path, piece: _Piece) -> None:
    """Raises FileError for a piece that is not made of triangles."""
    shapes = piece.vertices.ndim == piece.faces.ndim == 2
    if not shapes or piece.vertices.shape[1] != 3 or piece.faces.shape[1] != 3:
        raise FileError(f"{path}: needs vertices (n, 3) and triangles (m, 3); {MESH.give}")
    if len(piece.faces) and not 0 <= piece.faces.min() <= piece.faces.max() < len(piece.vertices):
        raise FileError(f"{path}: a face names a vertex that there is not; it is broken")


def _has_area(corners: Array) -> NDArray[np.bool_]:
    """Returns which triangles (triangle, corner, 3) have an area."""
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray((np.cross(one, other) != 0).any(axis=1))
