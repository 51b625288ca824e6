"""What the stress cases are held to: closed forms, and a walk from voxel to voxel in NumPy and float64.

Absorption is MPM93 itself at each voxel's own humidity and temperature: no polynomial, no path moments, no cut-off. Of the
run, nothing is taken but the cube that it saved. Planck's law and differences are written otherwise than in
thzcl.radiometry, so that a mistake there is seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air.mpm93 import attenuation, line_centers_ghz, line_width_ghz
from thzcl.air.radiometry import BOLTZMANN, LIGHT_SPEED, PLANCK
from thzcl.error.reference import walk
from thzcl.results.result import Cube
from thzcl.scenario import Box, Scene
from thzcl.surfaces.geometry import ROTATIONS

Array = NDArray[np.float64]
GAS_CONSTANT_OF_VAPOUR = 461.525  # J kg-1 K-1


class Ends(NamedTuple):
    """Where the rays of an image end, all (y, x): metres away.

    On a surface of such temperature and reflectivity.
    """

    length_m: Array
    temperature_k: Array
    reflectivity: Array


@dataclass(frozen=True)
class Truth:
    """What the camera should see, (frequency, y, x); radiances in W m-2 sr-1 Hz-1.

    As differences from the mean air's.
    """

    optical_depth: Array
    surface: Array  # unattenuated
    contrast: Array
    coldest: Array  # least and largest difference met on the way, surface included
    warmest: Array
    thinnest_voxel: float  # depth across the least absorbing voxel met, along its edge


def photons(frequency_hz: Array, temperature_k: Array) -> Array:
    """Photons a mode of a black body, n = 1 / (exp(x) - 1) = exp(-x/2) / (2 sinh(x/2)); 0 at 0 K.

    The arguments broadcast.
    """
    hz, kelvin = np.broadcast_arrays(
        np.asarray(frequency_hz, dtype=np.float64), np.asarray(temperature_k, dtype=np.float64)
    )
    half = PLANCK * hz / (2 * BOLTZMANN * np.where(kelvin > 0, kelvin, 1.0))
    warm = (kelvin > 0) & (half < 350)  # else less than 1e-300
    half = np.where(warm, half, 1.0)
    return np.where(warm, np.exp(-half) / (2 * np.sinh(half)), 0.0)


def planck_difference(frequency_hz: Array, temperature_k: Array, reference_k: float) -> Array:
    """B(T) - B(T_r), W m-2 sr-1 Hz-1.

    N - n_r = sinh((x_r - x) / 2) / (2 sinh(x / 2) sinh(x_r / 2)).
    """
    hz, kelvin = np.broadcast_arrays(
        np.asarray(frequency_hz, dtype=np.float64), np.asarray(temperature_k, dtype=np.float64)
    )
    unit = 2 * PLANCK * hz**3 / LIGHT_SPEED**2
    far = (
        (kelvin == 0)
        | (PLANCK * hz > 1000 * BOLTZMANN * kelvin)
        | (np.abs(kelvin - reference_k) > reference_k)
    )
    near = np.where(far, reference_k, kelvin)
    per_kelvin = PLANCK * hz / (2 * BOLTZMANN)
    apart = np.sinh(per_kelvin * (near - reference_k) / (near * reference_k))
    close = apart / (2 * np.sinh(per_kelvin / near) * np.sinh(per_kelvin / reference_k))
    plain = photons(hz, kelvin) - photons(hz, np.asarray(reference_k))
    return np.asarray(unit * np.where(far, plain, close))


def planck(frequency_hz: Array, temperature_k: Array | float) -> Array:
    """Spectral radiance of a black body, W m-2 sr-1 Hz-1."""
    unit = 2 * PLANCK * np.asarray(frequency_hz) ** 3 / LIGHT_SPEED**2
    return np.asarray(unit * photons(frequency_hz, np.asarray(temperature_k)))


def absorption(
    scene: Scene, frequency_hz: Array, grams_m3: Array, temperature_k: Array | float
) -> Array:
    """Absorption in 1/m of air with so much vapour, which cannot be more than there is pressure.

    The arguments broadcast.
    """
    air = scene.atmosphere
    vapour = np.minimum(
        np.maximum(grams_m3, 0) * GAS_CONSTANT_OF_VAPOUR * temperature_k / 1e5, air.pressure_hpa
    )
    return attenuation(
        air.model, frequency_hz / 1e9, temperature_k, air.pressure_hpa, vapour
    ).total_per_m


def directions(scene: Scene) -> Array:
    """Unit vectors through the middles of the pixels, (y, x, 3)."""
    camera = scene.camera
    forward = np.subtract(camera.look_at_m, camera.position_m)
    forward /= np.sqrt(forward @ forward)
    right = np.cross(forward, camera.up)
    right /= np.sqrt(right @ right)
    (plane_x, plane_y), (width, height) = camera.focal_plane_mm, camera.pixels
    x = ((np.arange(width) + 0.5) / width - 0.5) * plane_x / camera.focal_length_mm
    y = (0.5 - (np.arange(height) + 0.5) / height) * plane_y / camera.focal_length_mm
    rays = forward + x[None, :, None] * right + y[:, None, None] * np.cross(right, forward)
    return np.asarray(rays / np.sqrt((rays**2).sum(axis=-1, keepdims=True)))


def ends(scene: Scene) -> Ends:
    """Where rays end: background, ground, or walls.

    Which are boxes larger than the view whose near face is x = constant.
    """
    rays, air_k = directions(scene), scene.atmosphere.temperature_k
    x, _, z = scene.camera.position_m
    far, back = scene.background.max_range_m, scene.background.temperature_k
    found: list[tuple[Array, float | None, float]] = [
        (np.full(rays.shape[:2], far), air_k if back is None else back, 0.0)
    ]
    with np.errstate(divide="ignore"):
        if scene.ground is not None:
            found.append(
                (
                    np.where(rays[..., 2] < 0, -z / rays[..., 2], np.inf),
                    scene.ground.temperature_k,
                    scene.ground.reflectivity,
                )
            )
        for wall in scene.targets.values():
            if isinstance(wall, Box):
                away = wall.center_m[0] - wall.size_m[0] / 2 - x
                found.append(
                    (
                        np.where(rays[..., 0] > 0, away / rays[..., 0], np.inf),
                        wall.temperature_k,
                        wall.reflectivity,
                    )
                )
    lengths = np.array([length for length, _, _ in found])
    nearest = lengths.argmin(axis=0)
    kelvin, reflectivity = (
        np.array([row[k] for row in found], dtype=np.float64)[nearest] for k in (1, 2)
    )
    return Ends(lengths.min(axis=0), kelvin, reflectivity)


def truth(scene: Scene, frequency_hz: Array, cube: Cube | None) -> Truth:
    """What the camera should see, through the saved cube or, without one, through uniform air."""
    stops, air_k = ends(scene), scene.atmosphere.temperature_k
    surroundings = {"air": air_k, "none": 0.0}.get(
        str(scene.background.environment), scene.background.environment
    )
    hz = frequency_hz[:, None, None]
    reflected = planck_difference(hz, np.asarray(surroundings), air_k)
    surface = (1 - stops.reflectivity) * planck_difference(
        hz, stops.temperature_k, air_k
    ) + stops.reflectivity * reflected
    if cube is None:
        uniform = absorption(
            scene, frequency_hz, np.asarray(scene.atmosphere.air.absolute_humidity_g_m3), air_k
        )
        depth = uniform[:, None, None] * stops.length_m
        low, high = np.minimum(surface, 0), np.maximum(surface, 0)
        return Truth(depth, surface, surface * np.exp(-depth), low, high, np.inf)
    return _through(scene, frequency_hz, cube, stops, surface)


def _through(scene: Scene, frequency_hz: Array, cube: Cube, stops: Ends, surface: Array) -> Truth:
    """O'Brien and Tofsted's equation (2), the mean air's radiance taken off every term."""
    n, rays = cube.absolute_humidity_g_m3.shape[0], directions(scene).reshape(-1, 3)
    fluctuations = scene.atmosphere.fluctuations
    rotation = ROTATIONS[fluctuations.grid_orientation if fluctuations else "aligned"]
    start = np.broadcast_to(
        np.mod(rotation @ np.array(scene.camera.position_m) / cube.voxel_m, n), rays.shape
    )
    lengths, voxels = walk(start, rays @ rotation.T, stops.length_m.ravel(), cube.voxel_m, n)
    # Each voxel once, however many rays meet it.
    met, where = np.unique(voxels, return_inverse=True)
    air_k = scene.atmosphere.temperature_k
    kelvin = (
        np.full(len(met), air_k)
        if cube.air_temperature_k is None
        else cube.air_temperature_k.ravel()[met]
    )
    grams = cube.absolute_humidity_g_m3.ravel()[met].astype(np.float64)
    per_m = absorption(scene, frequency_hz[:, None], grams, kelvin)
    source = planck_difference(frequency_hz[:, None], kelvin, air_k)[:, where.reshape(voxels.shape)]
    tau = per_m[:, where.reshape(voxels.shape)] * lengths
    depth, behind = tau.sum(axis=2), surface.reshape(len(frequency_hz), -1)
    emitted = (np.exp(tau - np.cumsum(tau, axis=2)) * -np.expm1(-tau) * source).sum(axis=2)
    crossed = lengths > 0
    low = np.minimum(np.where(crossed, source, np.inf).min(axis=2), behind)
    high = np.maximum(np.where(crossed, source, -np.inf).max(axis=2), behind)
    depth, contrast, low, high = (
        plane.reshape(surface.shape)
        for plane in (depth, emitted + np.exp(-depth) * behind, low, high)
    )
    return Truth(depth, surface, contrast, low, high, float(per_m.min()) * cube.voxel_m)


class BandTruth(NamedTuple):
    """Of a flat band behind uniform air of one depth: mean transmission and contrast.

    The latter over the air's radiance.
    """

    transmission: float
    contrast: float


def band(
    scene: Scene, low_hz: float, high_hz: float, power: float, *, points: int = 12
) -> BandTruth:
    """Sums over a flat band, radiance weighted with frequency to a `power`, for a ray that ends at max_range_m.

    Gauss-Legendre rules of many points between cuts that close in on every line by factors of 1.6, from the whole band down to
    a hundredth of the line's width: some hundred times as many frequencies as a run takes.
    """
    lines, width = line_centers_ghz() * 1e9, line_width_ghz(scene.atmosphere.pressure_hpa) * 1e9
    steps = (
        0.01
        * width
        * 1.6 ** np.arange(np.ceil(np.log(100 * (high_hz - low_hz) / width) / np.log(1.6)))
    )
    near = [line + np.array([*-steps, 0.0, *steps]) for line in lines]
    cuts = np.unique(
        np.clip(np.concatenate([*near, np.linspace(low_hz, high_hz, 201)]), low_hz, high_hz)
    )
    x, w = np.polynomial.legendre.leggauss(points)
    half = np.diff(cuts)[:, None] / 2
    hz, weights = (cuts[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()
    air = scene.atmosphere
    per_m = absorption(scene, hz, np.asarray(air.air.absolute_humidity_g_m3), air.temperature_k)
    passed = np.exp(-per_m * scene.background.max_range_m)
    weights = weights * (hz / low_hz) ** power
    radiance = weights @ planck(hz, air.temperature_k)
    behind = planck_difference(hz, np.asarray(scene.background.temperature_k), air.temperature_k)
    return BandTruth(
        float(weights @ (planck(hz, air.temperature_k) * passed) / radiance),
        float(weights @ (behind * passed) / radiance),
    )
