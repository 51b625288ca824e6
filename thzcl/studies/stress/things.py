"""The truth of materials, covers and bounces for stress cases, in float64.

Fresnel's equations stand here in admittances, and layers as a ratio of what is lost, other than in
the surfaces that are tested.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.error.twin import planck_difference
from thzcl.scenario.scene import Mesh, Scene

Array = NDArray[np.float64]
WALL_FILE = "wall.npz"  # a cube of edge 1 around its origin, of many triangles
WALL_CUTS = 16  # squares along an edge of it


def write_wall(folder: Any) -> None:
    """Writes the mesh of WALL_FILE: six faces of squares, each cut in two triangles."""
    n = WALL_CUTS
    u, v = (axis.ravel() for axis in np.meshgrid(*(np.arange(n + 1) / n - 0.5,) * 2))
    cell = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    square = np.concatenate(
        [
            np.stack([cell, cell + 1, cell + n + 2], axis=1),
            np.stack([cell, cell + n + 2, cell + n + 1], axis=1),
        ]
    )
    vertices: list[Array] = []
    faces: list[NDArray[np.intp]] = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            faces.append(square + len(vertices) * len(u))
            vertices.append(np.insert(np.stack([u, v], axis=1), axis, side, axis=1))
    points, numbers = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
    np.savez(folder / WALL_FILE, vertices=points, faces=numbers.ravel()[np.concatenate(faces)])


def made_of(thing: Any) -> Any:
    """Returns the keys of what a thing is made of: its own, or those of the whole mesh."""
    return thing.made_of("") if isinstance(thing, Mesh) else thing


def reflected(scene: Scene, thing: Any, cosine: Array) -> Array:
    """Returns the part of unpolarised light that a thing reflects, of the cosine's shape."""
    made = made_of(thing)
    material = scene.materials.get(made.material or "")
    if material is None:
        return np.full(cosine.shape, float(made.reflectivity or 0.0))
    if material.permittivity is None:
        return np.full(cosine.shape, float(material.reflectivity or 0.0))
    eps = complex(*material.permittivity)
    inside = np.sqrt(eps - 1 + cosine**2)
    across, within = inside / cosine, eps * cosine / inside  # admittances over that of the air
    parts = (np.abs((1 - across) / (1 + across)) ** 2, np.abs((within - 1) / (within + 1)) ** 2)
    return np.asarray((parts[0] + parts[1]) / 2)


def sent(
    scene: Scene, frequency_hz: Array, thing: Any, part: Array, own: Array, seen: Array
) -> Array:
    """Returns what a thing sends that reflects a `part` of what is `seen`.

    `own` is what it would send if it were black; both are less the air's radiance.
    """
    cover = getattr(made_of(thing), "cover", None)
    if cover is None:
        return np.asarray(own + part * (seen - own))
    air_k = scene.atmosphere.temperature_k
    kelvin = air_k if cover.temperature_k is None else cover.temperature_k
    of_cover = planck_difference(frequency_hz[:, None, None], kelvin, air_k)
    passed, back = cover.transmission or 0.0, cover.reflectivity
    kept = 1 - part * back
    absorbed = 1 - passed - back
    of_thing = passed * (1 - part) / kept
    of_layer = absorbed * (kept + passed * part) / kept
    return np.asarray(of_thing * own + of_layer * of_cover + (1 - of_thing - of_layer) * seen)
