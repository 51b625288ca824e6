"""Makes the solids of the scenes: a vehicle, and a clothed person with a pistol under the cloth.

Both are drawn from simple shapes and round numbers, and closed. The person has the outline of
phantom.py's picture, rounded; the pistol lies on the belly, just above the skin.

    python -m thzcl.scenarios.solids FOLDER

writes vehicle.npz (parts body, hood, glass, tyres, rims; x forwards, on the plane z = 0) and
person.npz (parts head, body, pistol; facing -x, from hips to head, z = 0 at the hips), in m.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Solid = tuple[Array, Integers]

ROUND = 40  # points of a ring
# Of the person's trunk, from hips to neck: height, half width and half depth in m.
TRUNK = (
    (0.00, 0.185, 0.120),
    (0.15, 0.185, 0.125),
    (0.42, 0.160, 0.115),
    (0.64, 0.190, 0.120),
    (0.76, 0.200, 0.110),
    (0.82, 0.150, 0.090),
    (0.87, 0.060, 0.060),
)
# Of the vehicle's body, from tail to nose: x, half width, lowest and highest z in m.
BODY = (
    (-2.15, 0.70, 0.45, 0.85),
    (-2.05, 0.82, 0.32, 0.98),
    (-1.40, 0.88, 0.26, 1.02),
    (0.60, 0.88, 0.26, 0.98),
    (1.50, 0.86, 0.26, 0.86),
    (2.00, 0.80, 0.30, 0.76),
    (2.15, 0.68, 0.40, 0.66),
)
EDGE = 6  # points of a ring from the body's side to the edge of its hood
# Of its cabin, upwards from the body: z, half width, tail and front x in m.
CABIN = (
    (0.90, 0.80, -1.75, 0.85),
    (1.02, 0.79, -1.68, 0.70),
    (1.34, 0.64, -1.25, 0.10),
    (1.42, 0.58, -1.12, -0.05),
    (1.45, 0.48, -0.98, -0.20),
)


def loft(rings: Array) -> Solid:
    """Returns the closed solid through rings of points, (ring, point, 3), with flat ends."""
    count, points, _ = rings.shape
    ends = rings[[0, -1]].mean(axis=1)
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    ring, at = (n.ravel() for n in np.mgrid[: count - 1, :points])
    here, there = ring * points + at, ring * points + (at + 1) % points
    sides = [
        np.stack(three, 1)
        for three in ((here, there, there + points), (here, there + points, here + points))
    ]
    around = np.arange(points)
    after = (around + 1) % points
    last, first = (count - 1) * points, count * points
    caps = [
        np.stack([after, around, np.full(points, first)], 1),
        np.stack([last + around, last + after, np.full(points, first + 1)], 1),
    ]
    return vertices, np.concatenate([*sides, *caps])


def rounded(
    half_x: float, half_y: float, power: float = 2.0, x: float = 0.0, y: float = 0.0
) -> Array:
    """Returns a ring around (x, y) in a plane, (point, 2).

    Its points obey |x / half_x|^power + |y / half_y|^power = 1.
    """
    angle = 2 * np.pi * np.arange(ROUND) / ROUND
    c, s = np.cos(angle), np.sin(angle)
    size = (np.abs(c) ** power + np.abs(s) ** power) ** (-1 / power)
    return np.stack([x + half_x * size * c, y + half_y * size * s], axis=1)


def between(table: tuple[tuple[float, ...], ...], count: int) -> Array:
    """Returns rows of a table at `count` equal steps of its first column."""
    rows = np.array(table)
    at = np.linspace(rows[0, 0], rows[-1, 0], count)
    return np.stack([at, *(np.interp(at, rows[:, 0], column) for column in rows[:, 1:].T)], axis=1)


def rod(start: Iterable[float], end: Iterable[float], radius: float) -> Solid:
    """Returns a round rod with rounded ends."""
    a, b = np.array(list(start)), np.array(list(end))
    along = (b - a) / np.linalg.norm(b - a)
    side = np.cross(along, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    other, ring = np.cross(along, side), rounded(1, 1)
    turn = np.linspace(0.05, np.pi / 2, 6)
    steps = [(a - radius * np.cos(t) * along, radius * np.sin(t)) for t in turn]
    steps += [(a + (b - a) * part, radius) for part in np.linspace(0, 1, 14)[1:-1]]
    steps += [(b + radius * np.cos(t) * along, radius * np.sin(t)) for t in turn[::-1]]
    return loft(
        np.array([p + size * (ring[:, :1] * side + ring[:, 1:] * other) for p, size in steps])
    )


def egg(center: tuple[float, float, float], half: tuple[float, float, float]) -> Solid:
    """Returns an ellipsoid."""
    turn = np.linspace(0.04, np.pi - 0.04, 20)
    ring = rounded(half[0], half[1])
    rings = [
        np.column_stack([np.sin(t) * ring, np.full(ROUND, -half[2] * np.cos(t))]) for t in turn
    ]
    return loft(np.array(rings) + np.array(center))


def slab(corners: Array, thickness: float) -> Solid:
    """Returns a flat polygon, (corner, 2) of y and z, as a solid around the plane x = 0."""
    front = np.column_stack([np.full(len(corners), -thickness / 2), corners])
    return loft(np.array([front, front + np.array([thickness, 0.0, 0.0])]))


def person() -> dict[str, list[Solid]]:
    """Returns the person's solids by part."""
    rows = between(TRUNK, 40)
    trunk = loft(
        np.array(
            [
                np.column_stack([rounded(depth, half, 2.4), np.full(ROUND, z)])
                for z, half, depth in rows
            ]
        )
    )
    arms = [rod((0.0, side * 0.225, 0.75), (-0.02, side * 0.30, 0.03), 0.052) for side in (-1, 1)]
    neck = rod((0.0, 0.0, 0.84), (0.0, 0.0, 0.96), 0.055)
    head = egg((0.0, 0.0, 1.05), (0.10, 0.085, 0.12))
    turn = np.deg2rad(-28.0)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    barrel = np.array([[-0.02, -0.085], [0.014, -0.085], [0.014, 0.085], [-0.02, 0.085]])
    grip = np.array([[0.010, 0.045], [0.085, 0.070], [0.080, 0.102], [0.010, 0.080]])
    place = np.array([-0.137, 0.02, 0.45])
    pistol = []
    for outline in (barrel, grip):
        vertices, faces = slab(outline @ axes, 0.022)
        pistol.append((vertices + place, faces))
    return {"head": [neck, head], "body": [trunk, *arms], "pistol": pistol}


def vehicle() -> dict[str, list[Solid]]:
    """Returns the vehicle's solids by part."""
    rows = between(BODY, 44)
    rings = [
        np.column_stack(
            [np.full(ROUND, x), rounded(half, (high - low) / 2, 5.0, y=(low + high) / 2)]
        )
        for x, half, low, high in rows
    ]
    body = loft(np.array(rings))
    shape, engine = rows.T, rows[np.searchsorted(rows[:, 0], 0.85), 0]
    rows = between(CABIN, 14)
    rings = [
        np.column_stack([rounded((x1 - x0) / 2, half, 5.0, x=(x0 + x1) / 2), np.full(ROUND, z)])
        for z, half, x0, x1 in rows
    ]
    cabin = loft(np.array(rings))
    tyres, rims = [], []
    for x in (-1.35, 1.35):
        for side in (-1, 1):
            outer = np.array([0.27, 0.33, 0.34, 0.33, 0.27])
            tyres.append(wheel(x, side * 0.78, outer, np.linspace(-0.11, 0.11, 5)))
            rims.append(
                wheel(x, side * 0.80, np.array([0.25, 0.26, 0.25]), np.linspace(-0.10, 0.10, 3))
            )

    def over_engine(middle: Array, _: Array) -> NDArray[np.bool_]:
        # Between points of the rings, so that no face of theirs is cut; without the flat nose.
        x, y, z = middle.T
        half, low, high = (np.interp(x, shape[0], column) for column in shape[1:])
        turn = np.arctan2((2 * z - low - high) / (high - low), y / half) * ROUND / (2 * np.pi)
        across = (turn > EDGE) & (turn < ROUND / 2 - EDGE)
        return (x > engine) & (x < shape[0, -1] - 1e-6) & across

    hood = _where(body, over_engine)
    rest = _where(body, lambda middle, up: ~over_engine(middle, up))
    low, high = rows[3, 0], rows[11, 0]  # at rings, so that no triangle is cut

    def pane(middle: Array, up: Array) -> NDArray[np.bool_]:
        # Windows lie between sill and roof, and posts between them.
        post = (np.abs(middle[:, 0] + 0.45) < 0.06) & (np.abs(middle[:, 1]) > 0.45)
        return (middle[:, 2] > low) & (middle[:, 2] < high) & (up < 0.9) & ~post

    glass = _where(cabin, pane)
    roof = _where(cabin, lambda middle, up: ~pane(middle, up))
    return {"body": [rest, roof], "hood": [hood], "glass": [glass], "tyres": tyres, "rims": rims}


def wheel(x: float, y: float, radii: Array, across: Array) -> Solid:
    """Returns a wheel around an axle along y, of some radii at offsets across."""
    ring = rounded(1, 1)
    rings = [
        np.column_stack([x + r * ring[:, 0], np.full(ROUND, y + dy), 0.34 + r * ring[:, 1]])
        for r, dy in zip(radii, across, strict=True)
    ]
    return loft(np.array(rings))


def _where(solid: Solid, wanted: Callable[[Array, Array], NDArray[np.bool_]]) -> Solid:
    """Returns the triangles of a solid that are wanted by their middles and their slopes.

    The slope is the vertical component of the normal, in absolute value.
    """
    vertices, faces = solid
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1)
    return vertices, faces[wanted(corners.mean(axis=1), up)]


def save(path: Path, parts: dict[str, list[Solid]]) -> None:
    """Writes solids by part as a mesh file."""
    solids = [solid for each in parts.values() for solid in each]
    before = np.cumsum([0, *(len(vertices) for vertices, _ in solids)])
    faces = [faces + offset for (_, faces), offset in zip(solids, before, strict=False)]
    counts = [sum(len(faces) for _, faces in each) for each in parts.values()]
    vertices = np.round(np.concatenate([vertices for vertices, _ in solids]), 5)
    np.savez_compressed(
        path,
        vertices=vertices.astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
        part=np.repeat(np.arange(len(parts)), counts).astype(np.int8),
        parts=np.array(list(parts)),
    )


def write(folder: Path) -> None:
    """Writes both meshes into a folder."""
    save(folder / "vehicle.npz", vehicle())
    save(folder / "person.npz", person())


if __name__ == "__main__":
    write(Path(sys.argv[1]))
