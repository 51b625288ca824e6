"""Meshes that tests make: boxes, spheres, and what files of them look like."""

from __future__ import annotations

import numpy as np

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
BOX_FACES = np.array([f for a, b, c, d in QUADS for f in ((a, b, c), (a, c, d))])


def sphere(times):
    """Vertices and faces of an icosahedron whose triangles were divided by four so many times."""
    g = (1 + 5**0.5) / 2
    points = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    points += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    ring = "0 11 5 0 5 1 0 1 7 0 7 10 0 10 11 1 5 9 5 11 4 11 10 2 10 7 6 7 1 8 "
    ring += "3 9 4 3 4 2 3 2 6 3 6 8 3 8 9 4 9 5 2 4 11 6 2 10 8 6 7 9 8 1"
    vertices, faces = np.array(points, float), np.array(list(map(int, ring.split()))).reshape(-1, 3)
    for _ in range(times):
        vertices, faces = divided(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def divided(vertices, faces):
    """The same surface with each triangle divided into four, at the middles of its edges."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[unique].mean(axis=1)
    ab, bc, ca = (number.reshape(3, -1) + len(vertices)).tolist()
    a, b, c = faces.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    made = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate([vertices, middle]), made


def obj(*parts):
    """An OBJ file of named parts, each (name, vertices, faces)."""
    lines, before = [], 1
    for name, vertices, faces in parts:
        lines.append(f"o {name}")
        lines += ["v " + " ".join(map(repr, map(float, v))) for v in vertices]
        lines += ["f " + " ".join(str(n + before) for n in f) for f in faces]
        before += len(vertices)
    return "\n".join(lines) + "\n"


def npz(path, vertices, faces, **attributes):
    """Writes a mesh as NPZ."""
    np.savez(path, vertices=vertices, faces=faces, **attributes)
