"""The sky as surfaces and rays see it: above them the air's column, below them the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, radiometry, sky, weather
from thzcl.air.mean import Air
from thzcl.air.profile import Profile
from thzcl.air.sky import Column
from thzcl.air.weather import Weather
from thzcl.scenario.scene import Box, Mesh, Scene
from thzcl.surfaces.materials import mean_reflectivity
from thzcl.surfaces.mirrors import Mirror

Array = NDArray[np.float64]
RISE_M = 50.0  # above camera and things a ray that meets nothing leaves the scene's air


@dataclass(frozen=True)
class Floor:
    """The ground, of one temperature in kelvin, that scatters a part of what it sees.

    It sees the sky, or black walls of `around_k` if that is not None. One that is made of a
    `material` reflects evenly here what it reflects of diffuse light, instead of `reflectivity`.
    """

    temperature_k: float
    reflectivity: float
    around_k: float | None = None
    material: Mirror | None = None

    def reflected(self, frequency_hz: Array) -> Array:
        """Returns the part of the light that it scatters, (frequency,)."""
        if self.material is None:
            return np.full(len(frequency_hz), self.reflectivity)
        return mean_reflectivity(self.material, frequency_hz)


@dataclass(frozen=True)
class Sky:
    """The sky over a ground, which is black at the air's temperature if there is no floor.

    Contrasts are those to the air of the column, whose temperature `air_k` of all methods is. The
    mean over what a face sees is taken over `points` directions above the horizon, and as many
    below.
    """

    column: Column
    floor: Floor | None
    points: int = sky.POINTS
    angular = True
    knee = 0.5
    dip = 1.0

    @property
    def weather(self) -> Weather:
        """Returns what falls under this sky."""
        return Weather(self.column.air, self.column, self.floor)

    def contrast(self, frequency_hz: Array, elevation: Array, air_k: float) -> Array:
        """Returns what is seen from the scene's own height, (frequency, direction)."""
        del air_k
        return self.seen(frequency_hz, elevation, self.column.scene_m)

    def seen(self, frequency_hz: Array, elevation: Array, height_m: Array | float) -> Array:
        """Returns what is seen from some heights, (frequency, direction)."""
        found = np.empty((len(frequency_hz), len(elevation)))
        heights, up = np.broadcast_to(height_m, elevation.shape), elevation >= 0
        if weather.falls(self.column.air, frequency_hz):
            return self.weather.seen(frequency_hz, elevation, np.maximum(heights, 0.0))
        found[:, up] = sky.seen_above(self.column, frequency_hz, elevation[up], heights[up])[0]
        down = -elevation[~up]
        found[:, ~up] = sky.seen_below(
            self.column, frequency_hz, down, heights[~up], self.of_ground(frequency_hz)
        )
        return found

    def scattered(self, frequency_hz: Array, upward: Array, height_m: float, air_k: float) -> Array:
        """Returns what Lambert faces at a height see, (frequency, face)."""
        del air_k
        _, weight = sky.tilted(upward, self.points)
        return np.asarray(_around(self, tuple(frequency_hz.tolist()), height_m) @ weight.T)

    def of_ground(self, frequency_hz: Array) -> Array:
        """Returns what the ground sends less a black body as warm as the air, (frequency,)."""
        return _of_ground(self, tuple(frequency_hz.tolist()))


@lru_cache(maxsize=64)
def _around(seen: Sky, frequencies: tuple[float, ...], height_m: float) -> Array:
    """Returns what is seen from a height in the directions of sky.tilted, (frequency, point)."""
    sine, _ = sky.tilted(np.zeros(1), seen.points)
    return seen.seen(np.array(frequencies), sine, height_m)


@lru_cache(maxsize=16)
def _of_ground(seen: Sky, frequencies: tuple[float, ...]) -> Array:
    hz, floor, air_k = np.array(frequencies), seen.floor, seen.column.air.temperature_k
    if floor is None:
        return np.zeros(len(hz))
    own = radiometry.planck_difference(hz, floor.temperature_k, air_k)
    part = floor.reflected(hz)
    if not part.any():
        return own
    if floor.around_k is not None:
        lit = radiometry.planck_difference(hz, floor.around_k, air_k)
    else:
        sine, weight = sky.tilted(np.ones(1), seen.points)
        above = sine > 0
        lit = sky.seen_above(seen.column, hz, sine[above], 0.0)[0] @ weight[0, above]
    return np.asarray((1 - part) * own + part * lit)


@dataclass(frozen=True)
class Behind:
    """The sky as rays see it that meet nothing, from where they leave the scene's air.

    That is where they have risen to `ceiling_m`, or `max_range_m` from the camera at `camera_m`.
    """

    sky: Sky
    camera_m: float
    ceiling_m: float
    max_range_m: float

    @property
    def knee(self) -> float:
        """Returns the sine of the elevation of a ray that reaches the ceiling at its end."""
        sine = (self.ceiling_m - self.camera_m) / self.max_range_m
        return sine if sine < 1 else 0.5

    @property
    def dip(self) -> float:
        """Returns the sine of the angle at which a ray reaches the ground at its end."""
        sine = self.camera_m / self.max_range_m
        return sine if self.sky.floor is not None and 0 < sine < 1 else 1.0

    def contrast(self, frequency_hz: Array, elevation: Array, air_k: float) -> Array:
        """Returns what rays see behind the scene's air, (frequency, direction)."""
        del air_k
        up = np.maximum(elevation, 1e-300)
        rise = self.ceiling_m - self.camera_m
        length = np.where(elevation > 0, np.minimum(self.max_range_m, rise / up), self.max_range_m)
        end_m = self.camera_m + length * elevation
        # Over a round Earth a straight ray has turned away from the ground by its end.
        start, end = sky.EARTH_M + self.camera_m, sky.EARTH_M + end_m
        turned = np.minimum((start * elevation + length) / end, 1.0)
        return self.sky.seen(frequency_hz, np.where(elevation >= 0, turned, elevation), end_m)


def weather_of(
    scene: Scene, air: Air, above: Sky | None, ground_law: Mirror | None = None
) -> Weather:
    """Returns what falls in a scene, under its sky if it has one; its ground as in `sky_of`."""
    if above is not None:
        return above.weather
    ground, environment = scene.ground, scene.background.environment
    if ground is None or ground.temperature_k is None:
        return Weather(air)
    around_k = None if environment in ("air", "sky") else enclosure_k(scene)
    law = None if ground.material is None else ground_law
    return Weather(air, None, Floor(ground.temperature_k, ground.reflectivity, around_k, law))


def sky_of(
    scene: Scene,
    air: Air,
    profile: Profile,
    ground_law: Mirror | None = None,
    meshes_top_m: float = -math.inf,
) -> Sky:
    """Returns the sky over a scene, whose ground reflects by a law if it is made of a material.

    `meshes_top_m` is the height of the highest mesh. Rays that meet nothing leave the scene's air
    50 m above the camera and all things, or at the top of the lowest layer.
    """
    even_m = min(highest_m(scene, meshes_top_m) + RISE_M, layer_top_m(air))
    column = Column(air, profile, max(scene.camera.position_m[2], 0.0), even_m)
    ground = scene.ground
    if ground is None or ground.temperature_k is None:
        return Sky(column, None)
    around_k = None if scene.background.environment == "sky" else enclosure_k(scene)
    law = None if ground.material is None else ground_law
    return Sky(column, Floor(ground.temperature_k, ground.reflectivity, around_k, law))


def enclosure_k(scene: Scene) -> float:
    """Returns the temperature of the black walls that surfaces reflect, if it is not the sky."""
    environment = scene.background.environment
    if environment in ("air", "sky"):
        return scene.atmosphere.temperature_k
    return 0.0 if environment == "none" else float(environment)


def highest_m(scene: Scene, meshes_top_m: float = -math.inf) -> float:
    """Returns the height of the highest of the camera and all things, meshes among them, m."""
    tops = [
        one.center_m[2] + (one.size_m[2] if isinstance(one, Box) else one.size_m[1]) / 2
        for one in scene.targets.values()
        if not isinstance(one, Mesh)
    ]
    return max([scene.camera.position_m[2], meshes_top_m, *tops])


def layer_top_m(air: Air) -> float:
    """Returns the height of the lowest top of a layer in the air, m; inf without one."""
    return min((composition.layer_top_m(part) for part in air.parts), default=math.inf)
