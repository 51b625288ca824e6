"""Fluxes at the surface from a sonic anemometer: friction velocity and Obukhov length."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KARMAN, GRAVITY = 0.4, 9.81  # -, m/s2


class Surface(NamedTuple):
    """Friction velocity in m/s and Obukhov length in m (negative where heat rises)."""

    friction_velocity_m_s: float
    obukhov_length_m: float


def rotated(wind: Array) -> Array:
    """Returns wind (3, n) turned twice: mean v and mean w are 0 (Kaimal and Finnigan 1994, 6.6)."""
    u, v, w = (float(np.nanmean(part)) for part in wind)
    level = math.hypot(u, v)
    about_z = np.array([[u, v, 0], [-v, u, 0], [0, 0, level]]) / level
    size = math.hypot(level, w)
    about_y = np.array([[level, 0, w], [0, size, 0], [-w, 0, level]]) / size
    return np.asarray(about_y @ about_z @ wind)


def fluxes(winds: Sequence[Array], sonics: Sequence[Array]) -> Surface | None:
    """Returns fluxes from the winds (3, n) and sonic temperatures (n,) of batches, or None.

    u* = (<u'w'>^2 + <v'w'>^2)^(1/4), L = -u*^3 <Ts> / (0.4 g <w'Ts'>) (Obukhov 1946; Stull 1988,
    equation 5.7c); sonic temperature is close to virtual temperature, whose flux belongs there.
    Covariances are about the means of batches, and are averaged over them.
    """
    rows = []
    for wind, sonic in zip(winds, sonics, strict=True):
        turned = rotated(wind)
        there = np.isfinite(turned).all(axis=0) & np.isfinite(sonic)
        if there.sum() < 2:
            continue
        u, v, w, t = (x[there] - x[there].mean() for x in (*turned, sonic))
        rows.append((np.mean(u * w), np.mean(v * w), np.mean(w * t), np.mean(sonic[there])))
    if not rows:
        return None
    uw, vw, wt, kelvin = (float(x) for x in np.mean(rows, axis=0))
    velocity = (uw**2 + vw**2) ** 0.25
    if wt == 0:
        return Surface(velocity, math.inf)
    return Surface(velocity, -(velocity**3) * kelvin / (KARMAN * GRAVITY * wt))
