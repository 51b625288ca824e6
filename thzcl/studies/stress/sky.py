"""The truth of the sky for stress cases: thin steps along straight rays over a round Earth.

Each step has the air of its middle, by the gas itself. Nothing is taken from the sky of a run but
the rows of the profile.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition
from thzcl.air.profile import shipped
from thzcl.error.twin import planck_difference
from thzcl.scenario.scene import Mesh, Scene

Array = NDArray[np.float64]
EARTH_M = 6371e3
SPACE_K = 2.725
RISE_M = 50.0  # above camera and things rays leave the scene's air
BLENDED_M = 1000.0
TURNS, TILTS = 400, 400  # directions of the mean over half of space
GAS_CONSTANT_OF_VAPOUR = 461.525  # J kg-1 K-1


class _Steps(NamedTuple):
    """Steps upwards: their edges (step + 1,) in m, absorption in 1/m and emission of each.

    The latter two are (frequency, step); emission is a black body's less that of the scene's air.
    """

    edges_m: Array
    absorption: Array
    emitted: Array


def ceiling_m(scene: Scene) -> float:
    """Returns the height at which rays leave the scene's air, m."""
    solid = [one for one in scene.targets.values() if not isinstance(one, Mesh)]
    tops = [one.center_m[2] + one.size_m[-1] / 2 for one in solid]
    return max([scene.camera.position_m[2], *tops]) + RISE_M


def seen_behind(scene: Scene, frequency_hz: Array, sine: Array, length_m: Array) -> Array:
    """Returns what rays see behind the scene's air, less the air's, (frequency, ...).

    `sine` (...) of their elevation at the camera is above 0, and `length_m` (...) is theirs.
    """
    start = EARTH_M + scene.camera.position_m[2]
    low_m = scene.camera.position_m[2] + sine * length_m
    turned = (start * sine + length_m) / (EARTH_M + low_m)
    rays = zip(turned.ravel(), low_m.ravel(), strict=True)
    steps = _steps(scene, frequency_hz)
    planes = [_along(scene, frequency_hz, steps, *ray) for ray in rays]
    return np.array(planes).T.reshape(len(frequency_hz), *sine.shape)


def seen_by_wall(scene: Scene, frequency_hz: Array, height_m: float) -> Array:
    """Returns the mean that an upright face at a height sees, less the air's, (frequency,).

    Half of that is black ground of the air's temperature. Directions are even in azimuth and sine.
    """
    sine = (np.arange(TILTS) + 0.5) / TILTS
    turn = (np.arange(TURNS) + 0.5) / TURNS * np.pi - np.pi / 2
    weight = np.sqrt(1 - sine**2) * np.cos(turn).mean() / TILTS
    steps = _steps(scene, frequency_hz)
    seen = [_along(scene, frequency_hz, steps, one, height_m) for one in sine]
    return np.asarray(weight @ np.array(seen))


def _steps(scene: Scene, frequency_hz: Array) -> _Steps:
    """Returns the steps above a scene, through its own air up to the ceiling."""
    assert scene.sky is not None  # noqa: S101 (else nobody asks)
    rows, air = shipped(scene.sky.profile), scene.atmosphere.air
    even_m, camera_m = ceiling_m(scene), scene.camera.position_m[2]
    parts = np.arange(0, 3e3, 2.0), np.arange(3e3, 2e4, 20.0), np.arange(2e4, 64e3, 100.0)
    edges = np.unique(np.concatenate([*parts, [camera_m, even_m]]))
    middle = (edges[1:] + edges[:-1]) / 2
    z, kelvin_of = rows.height_m.array, rows.temperature_k.array
    of = {name: np.log(getattr(rows, name).array) for name in ("pressure_hpa", "vapour_hpa")}
    own = air.absolute_humidity_g_m3 / 1e5 * GAS_CONSTANT_OF_VAPOUR * air.temperature_k
    moister = np.log(own) - np.interp(camera_m, z, of["vapour_hpa"])
    warmer = air.temperature_k - np.interp(camera_m, z, kelvin_of)
    part = np.exp(-np.maximum(middle - camera_m, 0) / BLENDED_M)
    even = middle < even_m
    kelvin = np.where(even, air.temperature_k, np.interp(middle, z, kelvin_of) + warmer * part)
    vapour = np.exp(np.interp(middle, z, of["vapour_hpa"]) + moister * part)
    hpa = np.where(even, air.pressure_hpa, np.exp(np.interp(middle, z, of["pressure_hpa"])))
    (gas,) = air.parts
    state = kelvin, hpa, np.where(even, own, vapour)
    hz = frequency_hz[:, None]
    absorption = np.asarray(composition.optical_properties(gas, hz, *state).absorption)
    return _Steps(edges, absorption, planck_difference(hz, kelvin, air.temperature_k))


def _along(scene: Scene, frequency_hz: Array, steps: _Steps, sine: float, low_m: float) -> Array:
    """Returns what is seen from a height at an elevation, less the air's, (frequency,)."""
    edges, start = np.maximum(steps.edges_m, low_m), EARTH_M + low_m
    away = np.sqrt((EARTH_M + edges) ** 2 - start**2 * (1 - sine**2)) - start * sine
    tau = steps.absorption * np.diff(away)
    before = np.cumsum(tau, axis=1) - tau
    seen = (np.exp(-before) * -np.expm1(-tau) * steps.emitted).sum(axis=1)
    space = planck_difference(frequency_hz, SPACE_K, scene.atmosphere.temperature_k)
    return np.asarray(seen + np.exp(-tau.sum(axis=1)) * space)
