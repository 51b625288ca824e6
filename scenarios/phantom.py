"""Makes the phantom: a clothed upper body with a pistol under the cloth.

It is what a terahertz imager might see close by. The subject of O'Brien and Tofsted's figures 7 to
9 is not public; this one is drawn from simple shapes and round numbers for 650 GHz. Skin reflects
15 % (its refractive index is about 2), one layer of cotton passes 60 % and scatters 3 % back, and
metal reflects all; surfaces that turn away send less back. Skin is at 305 K, cloth at 300 K; metal
shows, through the cloth, surroundings of 293 K. As a passive picture it stands before a cooled
backdrop of 253 K, as passive imagers have been shown.

    python -m thzcl.scenarios.phantom FOLDER

writes phantom_reflectivity.png (0 to 0.5), phantom_temperature.png (250 to 310 K) and
phantom_mask.png, in 8 bit greyscale.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, HEIGHT = 0.9, 1.2  # m
PIXELS = (240, 320)  # width, height
REFLECTIVITY_RANGE = (0.0, 0.5)
TEMPERATURE_RANGE = (250.0, 310.0)  # K
BACKDROP = 253.0  # K
SKIN, CLOTH, METAL = 0.15, 0.03, 1.0  # power reflected
THROUGH_CLOTH = 0.60  # power passed, one way


def phantom() -> tuple[Array, Array, Array]:
    """Returns reflectivity, temperature in K, and mask, each (height, width), row 0 at the top."""
    columns, rows = PIXELS
    x, y = np.meshgrid(
        (np.arange(columns) + 0.5) / columns - 0.5, 1 - (np.arange(rows) + 0.5) / rows
    )
    x, y = x * WIDTH, y * HEIGHT
    head = _ellipsoid(x, y, (0.0, 1.03), (0.085, 0.12), 0.10)
    neck = _ellipsoid(x, y, (0.0, 0.88), (0.055, 0.12), 0.07)
    # Half widths of the trunk from hips to neck.
    half = np.interp(
        y,
        [0.0, 0.15, 0.42, 0.64, 0.76, 0.80, 0.84, 0.87],
        [0.185, 0.185, 0.160, 0.190, 0.215, 0.205, 0.13, 0.0],
    )
    torso = 0.12 * np.sqrt(np.maximum(1 - (x / np.maximum(half, 1e-9)) ** 2, 0.0)) * (half > 0)
    arms = np.maximum(
        _limb(x, y, (-0.205, 0.745), (-0.30, 0.02), 0.056),
        _limb(x, y, (0.205, 0.745), (0.30, 0.02), 0.056),
    )
    bare, clothed = np.maximum(head, neck), np.maximum(torso, arms)
    depth = np.maximum(bare, clothed)
    covered = clothed >= bare
    pistol = _pistol(x, y) & (torso > 0)

    # Folds of the cloth, and how squarely each part faces the imager.
    folds = 0.004 * np.sin(38 * y + 9 * x) * np.sin(21 * x - 4 * y + 1.0) * covered
    dy, dx = np.gradient(depth + folds, HEIGHT / rows, WIDTH / columns)
    squarely = 1 / (1 + dx**2 + dy**2)
    inside = depth > 0
    beneath = np.where(pistol, METAL * 0.7, SKIN * squarely)
    reflectivity = np.where(covered, CLOTH + THROUGH_CLOTH**2 * beneath, SKIN * squarely) * inside
    body = np.where(pistol, 293.0, 305.0)
    temperature = np.where(covered, THROUGH_CLOTH * body + (1 - THROUGH_CLOTH) * 300.0, 305.0)
    # Limbs seen at a slant reflect more of their cooler surroundings.
    temperature = np.where(inside, temperature - 4.0 * (1 - squarely), BACKDROP)
    return reflectivity, temperature, inside.astype(np.float64)


def _ellipsoid(
    x: Array, y: Array, center: tuple[float, float], half: tuple[float, float], depth: float
) -> Array:
    """Returns how far an ellipsoid stands out at each point, in m; 0 beside it."""
    inside = 1 - ((x - center[0]) / half[0]) ** 2 - ((y - center[1]) / half[1]) ** 2
    return np.asarray(depth * np.sqrt(np.maximum(inside, 0.0)))


def _limb(
    x: Array, y: Array, start: tuple[float, float], end: tuple[float, float], radius: float
) -> Array:
    """Returns how far a round rod between two points stands out at each point, in m."""
    along = np.subtract(end, start)
    part = np.clip(((x - start[0]) * along[0] + (y - start[1]) * along[1]) / (along @ along), 0, 1)
    distance = np.hypot(x - start[0] - part * along[0], y - start[1] - part * along[1])
    return np.sqrt(np.maximum(radius**2 - distance**2, 0.0))


def _pistol(x: Array, y: Array) -> NDArray[np.bool_]:
    """Returns where a pistol is, which points down and inwards at the belt."""
    turn = np.deg2rad(-62.0)
    u = (x - 0.07) * np.cos(turn) + (y - 0.46) * np.sin(turn)
    v = -(x - 0.07) * np.sin(turn) + (y - 0.46) * np.cos(turn)
    barrel = (np.abs(u - 0.03) < 0.085) & (np.abs(v) < 0.014)
    w = v - 0.35 * (u + 0.045)
    grip = (np.abs(u + 0.045) < 0.017) & (w > 0) & (w < 0.085)
    guard_at = np.hypot(u + 0.005, v - 0.026)
    guard = (guard_at > 0.011) & (guard_at < 0.017) & (v > 0.01)
    return np.asarray(barrel | grip | guard)


def write(folder: Path) -> None:
    """Writes the three pictures into a folder."""
    from PIL import Image

    reflectivity, temperature, mask = phantom()
    for name, values, (low, high) in (
        ("reflectivity", reflectivity, REFLECTIVITY_RANGE),
        ("temperature", temperature, TEMPERATURE_RANGE),
        ("mask", mask, (0.0, 1.0)),
    ):
        grey = np.rint(255 * np.clip((values - low) / (high - low), 0, 1)).astype(np.uint8)
        Image.fromarray(grey).save(folder / f"phantom_{name}.png", optimize=True)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
