"""The truth for stress cases: closed forms, and the float64 twin's walk from voxel to voxel.

Absorption is that of the gas itself at the humidity and temperature of each voxel, without
polynomials, path moments or a cut-off. Nothing is taken from the run but the cube that it saved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition
from thzcl.error.twin import planck, planck_difference, transfer, walk
from thzcl.results.contents import Cube
from thzcl.scenario.scene import Billboard, Box, Ground, Mesh, Scene
from thzcl.studies.stress import sky, things
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
GAS_CONSTANT_OF_VAPOUR = 461.525  # J kg-1 K-1


class RayEnds(NamedTuple):
    """The ends of an image's rays, all (y, x): their distance, and the surfaces they meet."""

    length_m: Array
    temperature_k: Array
    reflectivity: Array
    thing: NDArray[np.intp]  # the number in _things(), after 0 for nothing


@dataclass(frozen=True)
class Truth:
    """What the camera should see, (frequency, y, x).

    The radiances are differences from that of the mean air, in W m-2 sr-1 Hz-1: `surface` that of
    the surface without attenuation, `contrast` that at the camera, `coldest` and `warmest` the
    smallest and the largest on a ray's path, its surface included. `thinnest_voxel` is the optical
    depth along one edge of the voxel that absorbs least.
    """

    optical_depth: Array
    surface: Array
    contrast: Array
    coldest: Array
    warmest: Array
    thinnest_voxel: float


def absorption(
    scene: Scene, frequency_hz: Array, grams_m3: Array | float, temperature_k: Array | float
) -> Array:
    """Returns the absorption in 1/m of air with `grams_m3` of vapour; the arguments broadcast.

    The vapour pressure is limited to the total pressure. What falls is that of the mean air, and
    what it scatters is lost as well.
    """
    air = scene.atmosphere
    pascal = np.maximum(grams_m3, 0) / 1e3 * GAS_CONSTANT_OF_VAPOUR * temperature_k
    vapour_hpa = np.minimum(pascal / 100, air.pressure_hpa)
    gas, *others = air.air.parts
    state = temperature_k, air.pressure_hpa, vapour_hpa
    found = composition.optical_properties(gas, frequency_hz, *state).absorption
    mean = air.air.temperature_k, air.pressure_hpa, air.air.vapour_pressure_hpa
    for part in others:
        optics = composition.optical_properties(part, frequency_hz, *mean)
        found = found + np.asarray(optics.absorption) + np.asarray(optics.scattering)
    return np.asarray(found)


def directions(scene: Scene) -> Array:
    """Returns unit vectors through the middles of the pixels, (y, x, 3)."""
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


def ray_ends(scene: Scene) -> RayEnds:
    """Returns the ends of rays: at the background, the ground, or the near face of a wall.

    A wall is a box larger than the field of view, whose near face lies at a constant x.
    """
    rays, air_k = directions(scene), scene.atmosphere.temperature_k
    x, _, z = scene.camera.position_m
    lengths = [np.full(rays.shape[:2], scene.background.max_range_m)]
    if _open(scene):
        with np.errstate(divide="ignore"):
            rise = (sky.ceiling_m(scene) - z) / np.maximum(rays[..., 2], 0.0)
        lengths = [np.minimum(lengths[0], rise)]
    kelvin = [_kelvin(scene.background.temperature_k, air_k)]
    parts = [np.zeros(rays.shape[:2])]
    with np.errstate(divide="ignore", invalid="ignore"):
        for thing in _things(scene):
            kelvin.append(_kelvin(things.made_of(thing).temperature_k, air_k))
            if isinstance(thing, Ground):
                cosine, away = -rays[..., 2], z
            else:
                cosine, away = rays[..., 0], _face_m(thing) - x
            lengths.append(np.where(cosine > 0, away / cosine, np.inf))
            parts.append(things.reflected(scene, thing, cosine))
    nearest = np.argmin(lengths, axis=0)
    reflectivity = np.take_along_axis(np.array(parts), nearest[None], axis=0)[0]
    return RayEnds(np.min(lengths, axis=0), np.array(kelvin)[nearest], reflectivity, nearest)


def _things(scene: Scene) -> list[Any]:
    """Returns the ground, if there is one, and all walls."""
    ground = [] if scene.ground is None else [scene.ground]
    return [*ground, *(one for one in scene.targets.values() if not isinstance(one, Billboard))]


def _face_m(wall: Box | Mesh) -> float:
    """Returns where the near face of a wall stands along x: of a mesh, that of a scaled cube."""
    depth = wall.size_m[0] if isinstance(wall, Box) else wall.scale
    return wall.center_m[0] - depth / 2


def _kelvin(temperature_k: float | None, air_k: float) -> float:
    """Returns a surface's temperature, or the air's if it has none."""
    return air_k if temperature_k is None else temperature_k


def truth(scene: Scene, frequency_hz: Array, cube: Cube | None) -> Truth:
    """Returns what the camera should see through a saved cube, or through uniform air if None."""
    ends, air_k = ray_ends(scene), scene.atmosphere.temperature_k
    hz = frequency_hz[:, None, None]
    own = planck_difference(hz, ends.temperature_k, air_k)
    seen = _reflected(scene, frequency_hz)
    surface = own + ends.reflectivity * (seen - own)
    for number, thing in enumerate(_things(scene), start=1):
        view = _mirrored(scene, frequency_hz, ends, thing, seen)
        of_thing = things.sent(scene, frequency_hz, thing, ends.reflectivity, own, view)
        surface = np.where(ends.thing == number, of_thing, surface)
    if _open(scene):
        surface = _under_sky(scene, frequency_hz, ends.length_m, surface)
    if cube is not None:
        return _through(scene, frequency_hz, cube, ends.length_m, surface)
    per_m = absorption(scene, hz, scene.atmosphere.air.absolute_humidity_g_m3, air_k)
    depth = per_m * ends.length_m
    cold, warm = np.minimum(surface, 0), np.maximum(surface, 0)
    return Truth(depth, surface, surface * np.exp(-depth), cold, warm, np.inf)


def _mirrored(scene: Scene, frequency_hz: Array, ends: RayEnds, thing: Any, around: Array) -> Array:
    """Returns what is seen in a thing: a wall, if rays are mirrored by ground of a material.

    The wall is rough, and stands behind mean air.
    """
    walls = [one for one in scene.targets.values() if isinstance(one, Box)]
    bounces = scene.numerics.bounces == 1 and isinstance(thing, Ground) and thing.material
    if not bounces or not walls:
        return around
    rays, air_k, hz = directions(scene), scene.atmosphere.temperature_k, frequency_hz[:, None, None]
    there = scene.camera.position_m[0] + ends.length_m * rays[..., 0]
    onwards = (_face_m(walls[0]) - there) / rays[..., 0]
    own = planck_difference(hz, _kelvin(walls[0].temperature_k, air_k), air_k)
    part = np.array(walls[0].reflectivity)
    of_wall = things.sent(scene, frequency_hz, walls[0], part, own, around)
    per_m = absorption(scene, hz, scene.atmosphere.air.absolute_humidity_g_m3, air_k)
    return np.asarray(of_wall * np.exp(-per_m * onwards))


def _open(scene: Scene) -> bool:
    """Returns whether rays that meet nothing see the sky."""
    return scene.sky is not None and scene.background.temperature_k is None


def _reflected(scene: Scene, frequency_hz: Array) -> Array:
    """Returns what a wall sees, less the air's radiance, (frequency, 1, 1)."""
    environment, air_k = scene.background.environment, scene.atmosphere.temperature_k
    if environment == "sky":
        wall = next(iter(scene.targets.values()))
        height_m = round(2 * wall.center_m[2]) / 2
        return sky.seen_by_wall(scene, frequency_hz, height_m)[:, None, None]
    around_k = {"air": air_k, "none": 0.0}.get(str(environment), environment)
    return planck_difference(frequency_hz[:, None, None], float(around_k), air_k)


def _under_sky(scene: Scene, frequency_hz: Array, length_m: Array, surface: Array) -> Array:
    """Returns what stands at the ends of rays (frequency, y, x), with the sky where that is."""
    up = directions(scene)[..., 2]
    reached = np.minimum(scene.background.max_range_m, (sky.ceiling_m(scene) - _z(scene)) / up)
    behind = (up > 0) & (length_m >= reached)
    found = surface.copy()
    found[:, behind] = sky.seen_behind(scene, frequency_hz, up[behind], length_m[behind])
    return found


def _z(scene: Scene) -> float:
    return scene.camera.position_m[2]


def _through(scene: Scene, frequency_hz: Array, cube: Cube, path_m: Array, surface: Array) -> Truth:
    """Returns what the camera should see through a cube.

    `path_m` (y, x) are the lengths of rays, `surface` (frequency, y, x) the contrast at their ends.
    """
    grid, rays = len(cube.absolute_humidity_g_m3), directions(scene).reshape(-1, 3)
    voxel_m = cube.lattice.voxel_m[0]
    fluctuations, air_k = scene.atmosphere.fluctuations, scene.atmosphere.temperature_k
    turn = ROTATIONS[fluctuations.orientation if fluctuations else "aligned"]
    start = np.mod(turn @ np.array(scene.camera.position_m) / voxel_m, grid)
    lengths, voxels = walk(
        np.broadcast_to(start, rays.shape), rays @ turn.T / voxel_m, path_m.ravel(), (grid,) * 3
    )
    # The gas is asked of each voxel once, however many rays meet it.
    met, where = np.unique(voxels, return_inverse=True)
    where = where.reshape(voxels.shape)
    grams = cube.absolute_humidity_g_m3.ravel()[met].astype(np.float64)
    warmth = cube.air_temperature_k
    kelvin = np.full(len(met), air_k) if warmth is None else warmth.ravel()[met]
    per_m = absorption(scene, frequency_hz[:, None], grams, kelvin)
    tau = per_m[:, where] * lengths
    emitted = planck_difference(frequency_hz[:, None], kelvin, air_k)[:, where]
    behind, crossed = surface.reshape(len(frequency_hz), -1), lengths > 0
    planes = (
        tau.sum(axis=2),
        behind,
        transfer(tau, emitted, behind),
        np.minimum(np.where(crossed, emitted, np.inf).min(axis=2), behind),
        np.maximum(np.where(crossed, emitted, -np.inf).max(axis=2), behind),
    )
    depth, source, contrast, cold, warm = (plane.reshape(surface.shape) for plane in planes)
    return Truth(depth, source, contrast, cold, warm, float(per_m.min()) * voxel_m)


class BandTruth(NamedTuple):
    """What a flat band brings through uniform air: its mean transmission and its contrast.

    The contrast is relative to the air's radiance in the band.
    """

    transmission: float
    contrast: float


def band(scene: Scene, low_hz: float, high_hz: float, power: float) -> BandTruth:
    """Returns the sums over a flat band for a ray that ends at max_range_m.

    Radiance is weighted by frequency to the power `power`.
    """
    hz, weights = _fine_rule(low_hz, high_hz, *scene.atmosphere.air.lines())
    air_k = scene.atmosphere.temperature_k
    behind_k = _kelvin(scene.background.temperature_k, air_k)
    per_m = absorption(scene, hz, scene.atmosphere.air.absolute_humidity_g_m3, air_k)
    passed = np.exp(-per_m * scene.background.max_range_m)
    weights = weights * (hz / low_hz) ** power
    of_air = planck(hz, air_k)
    behind, whole = planck_difference(hz, behind_k, air_k), weights @ of_air
    return BandTruth(
        float(weights @ (of_air * passed) / whole), float(weights @ (behind * passed) / whole)
    )


def _fine_rule(
    low_hz: float, high_hz: float, lines_hz: Array, line_width_hz: float
) -> tuple[Array, Array]:
    """Returns frequencies and weights in Hz, some hundred times as many as a run takes.

    The band is cut into parts, each with a Gauss-Legendre rule of twelve points. The cuts approach
    every line by factors of 1.6, from the width of the band down to a hundredth of a line's width.
    """
    span = 100 * (high_hz - low_hz) / line_width_hz
    steps = 0.01 * line_width_hz * 1.6 ** np.arange(np.ceil(np.log(span) / np.log(1.6)))
    near = np.add.outer(lines_hz, [*-steps, 0.0, *steps]).ravel()
    cuts = np.concatenate([near, np.linspace(low_hz, high_hz, 201)])
    cuts = np.unique(np.clip(cuts, low_hz, high_hz))
    x, w = np.polynomial.legendre.leggauss(12)
    half = np.diff(cuts)[:, None] / 2
    return (cuts[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()
