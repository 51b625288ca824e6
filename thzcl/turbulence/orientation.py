"""How the periodic cube lies against the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _rotation(w: float, x: float, y: float, z: float) -> Array:
    """Returns the rotation of a quaternion, (3, 3)."""
    w, x, y, z = np.array([w, x, y, z]) / np.linalg.norm([w, x, y, z])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


# From world to cube. The oblique one was searched for: a ray along a world axis or a level diagonal
# that has crossed up to four periods each way still runs a quarter of a period or more beside any
# cell that it has met.
ROTATIONS = {"aligned": np.eye(3), "oblique": _rotation(0.9435, -0.1204, -0.1348, -0.2778)}


def name_of(rotation: Any) -> str | None:
    """Returns the name of a stored rotation (3, 3) from world to cube; None if it is another."""
    try:
        given = np.asarray(rotation, dtype=np.float64)
    except (TypeError, ValueError):
        return None
    near = (name for name, own in ROTATIONS.items() if given.shape == own.shape)
    return next((name for name in near if np.allclose(given, ROTATIONS[name], atol=1e-9)), None)
