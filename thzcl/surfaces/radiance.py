"""What surfaces send towards the camera: emission and reflection, or echoes of a transmitter.

A surface sends own + R (seen - own): `own` is what it would send if it reflected nothing, `seen`
what is seen in it, and R how much it reflects. All three are relative to the mean air.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Spec, Values, Work, frozen
from thzcl.scenario.scene import Scene
from thzcl.surfaces import mirrors
from thzcl.surfaces.geometry import BACKGROUND, Surface
from thzcl.surfaces.mirrors import (
    Backdrop,
    Constant,
    Enclosure,
    Mirror,
    Opening,
    Surroundings,
    View,
)
from thzcl.surfaces.sky import Behind, Sky, ceiling_m, enclosure_k

Array = NDArray[np.float64]

ELEVATED: tuple[View, ...] = ("behind", "mirrored")  # what is looked up by elevation
SAMPLED = np.array([-1.0, -0.3, -0.03, 0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])


class Angular(NamedTuple):
    """Look-ups of what depends on the angle, as surfaces/source.cl describes them."""

    mirror: NDArray[np.int32]  # (surface,): the row of `reflectivity`
    view: NDArray[np.int32]  # (surface,): where in `seen` its set of nodes begins
    reflectivity: Array  # (mirror, frequency, node), over the cosine of the angle from 0 to 1
    seen: Array  # (frequency, place): sets by elevation, then sets by the normal
    scattered: int  # where in `seen` the sets by the normal begin
    elevations: int  # nodes of a third of a set by elevation
    tilts: int  # nodes of a set by the normal
    knee: float  # the root of the sine of an elevation
    dip: float  # the root of the sine at which the first set ends below the horizon


class Table(NamedTuple):
    """What surfaces send, as the kernels take it.

    `sent` (surface, frequency) is all that they send, or what they would send if they reflected
    nothing if some of them look different from different angles.
    """

    sent: Array
    angular: Angular | None

    def some(self, part: slice) -> Table:
        """Returns the table at some of its frequencies."""
        if self.angular is None:
            return Table(self.sent[:, part], None)
        reflectivity, seen = self.angular.reflectivity[:, part], self.angular.seen[part]
        return Table(
            self.sent[:, part], self.angular._replace(reflectivity=reflectivity, seen=seen)
        )


class EndAngles(NamedTuple):
    """The angles at which rays end, (ray,), where they make a difference.

    `cosine` is that of the angle between ray and normal, `elevation` the sine of the mirrored
    ray's, and `upward` the vertical component of the normal.
    """

    cosine: Array
    elevation: Array
    upward: Array


@dataclass(frozen=True)
class Reflecting:
    """Surfaces by number, each with the numbers of its mirror and of its height.

    Several may have them in common. `heights_m` are rounded to half metres.
    """

    mirrors: tuple[Mirror, ...]
    mirror: Values  # (surface,), int32
    heights_m: tuple[float, ...] = (0.0,)
    height: Values | None = None  # (surface,), int32; all have the first if it is None

    @classmethod
    def of(cls, surfaces: list[Surface], *, heights: bool = False) -> Reflecting:
        """Returns the mirrors of some surfaces, and their heights if these make a difference."""
        number = {one: n for n, one in enumerate(dict.fromkeys(s.mirror for s in surfaces))}
        mirror = Values.of([number[s.mirror] for s in surfaces], np.int32)
        if not heights:
            return cls(tuple(number), mirror)
        metres = [round(2 * max(s.height_m, 0.0)) / 2 for s in surfaces]
        place = {one: n for n, one in enumerate(dict.fromkeys(metres))}
        return cls(
            tuple(number), mirror, tuple(place), Values.of([place[z] for z in metres], np.int32)
        )

    def height_of(self, surface: NDArray[np.int32]) -> NDArray[np.int32]:
        """Returns the numbers of the heights of some surfaces."""
        return np.zeros_like(surface) if self.height is None else self.height.array[surface]

    def views(self) -> set[View]:
        """Returns what is seen in any of the surfaces."""
        return {mirror.view for mirror in self.mirrors}

    @property
    def angular(self) -> bool:
        """Returns whether what some surface reflects depends on the angle."""
        return any(mirror.angular for mirror in self.mirrors)

    @property
    def anything(self) -> bool:
        """Returns whether some surface reflects at all."""
        return set(self.mirrors) != {Constant(0.0)}

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the reflectivity of every surface, (surface, *common shape of the arguments)."""
        of_mirrors = [mirror.reflectivity(frequency_hz, cosine) for mirror in self.mirrors]
        return np.asarray(np.array(of_mirrors)[self.mirror.array])


class _Sending(ABC):
    """What emission and echoes have in common."""

    reflecting: Reflecting

    @abstractmethod
    def own(self, frequency_hz: Array) -> Array:
        """Returns what surfaces would send if they reflected nothing, (surface, frequency)."""

    @abstractmethod
    def by_elevation(self, frequency_hz: Array, elevation: Array, view: View) -> Array:
        """Returns what is seen behind a scene or in a mirror, (frequency, direction)."""

    @abstractmethod
    def by_tilt(self, frequency_hz: Array, upward: Array, height_m: float) -> Array:
        """Returns what is seen in rough surfaces, (frequency, face)."""

    @abstractmethod
    def _look_ups(self, frequency_hz: Array, tolerance: float) -> _Seen:
        """Returns both as look-ups."""

    @property
    def _sees_alike(self) -> bool:
        """Returns whether the same is seen everywhere."""
        return True

    @property
    def angular(self) -> bool:
        """Returns whether what surfaces send depends on the angle at which rays meet them."""
        return self.reflecting.angular or (self.reflecting.anything and not self._sees_alike)

    def table(self, frequency_hz: Array, tolerance: float = mirrors.TOLERANCE) -> Table:
        """Returns what surfaces send at some frequencies.

        `tolerance` is that of look-ups, relative to their largest value.
        """
        own, reflecting = self.own(frequency_hz), self.reflecting
        if not self.angular:
            reflectivity = reflecting.reflectivity(frequency_hz, np.ones(1))
            seen = self.by_tilt(frequency_hz, np.ones(1), 0.0)[:, 0]
            return Table(_mixed(own, reflectivity, seen), None)
        return Table(own, self._angular(frequency_hz, len(own), tolerance))

    def _angular(self, frequency_hz: Array, surfaces: int, tolerance: float) -> Angular:
        """Returns the look-ups, and where in them what is seen in each surface begins."""
        look_ups, reflecting = self._look_ups(frequency_hz, tolerance), self.reflecting
        sets, tilts = look_ups.sets, look_ups.tilts
        scattered, begins = 0, dict[View, int]()
        for view, one in sets.items():
            begins[view], scattered = scattered, scattered + one.shape[1]
        mirror = reflecting.mirror.array
        heights = reflecting.height_of(np.arange(surfaces, dtype=np.int32))
        views = [reflecting.mirrors[number].view for number in mirror]
        places = [
            begins.get(view, scattered + height * tilts.shape[2])
            for view, height in zip(views, heights, strict=True)
        ]
        return Angular(
            mirror,
            np.array(places, np.int32),
            mirrors.by_cosine(reflecting.mirrors, frequency_hz, tolerance),
            np.hstack([*sets.values(), *tilts]),
            scattered,
            scattered // (3 * max(len(sets), 1)),
            tilts.shape[2],
            look_ups.knee,
            look_ups.dip,
        )

    def brightest(self, frequency_hz: Array) -> Array:
        """Returns about the most that surfaces send, in absolute value, (surface, frequency)."""
        return _brightest(self, tuple(frequency_hz.tolist()))

    def brightest_along(
        self, frequency_hz: Array, surface: NDArray[np.int32], elevation: Array
    ) -> Array:
        """Returns the same for the surfaces (ray,) that rays meet, (ray, frequency).

        `elevation` (ray,) is the sine of the angle above the horizon at which they go.
        """
        del elevation
        return np.asarray(self.brightest(frequency_hz)[surface])

    def sky_views(self) -> list[View]:
        """Returns in what the sky is seen."""
        return []

    def sent(
        self,
        frequency_hz: Array,
        surface: NDArray[np.int32],
        blend: Array,
        angles: EndAngles | None,
    ) -> Array:
        """Returns what the ends of rays send, (frequency, ray), without any look-up.

        A ray that ends at `surface` (ray,) has the part `blend` (ray,) of the next surface.
        `angles` are None where they make no difference.
        """
        following = np.minimum(surface + 1, self.reflecting.mirror.shape[0] - 1)
        if angles is None:
            table = self.table(frequency_hz).sent.T
            first, second = table[:, surface], table[:, following]
        else:
            first = second = self._from(frequency_hz, surface, angles)
            if blend.any():
                second = self._from(frequency_hz, following, angles)
        return np.asarray(first + blend * (second - first))

    def _from(self, frequency_hz: Array, surface: NDArray[np.int32], angles: EndAngles) -> Array:
        """Returns what a surface (ray,) sends at the end of each ray, (frequency, ray)."""
        hz, rays = frequency_hz[:, None], np.arange(len(surface))
        mirror = self.reflecting.mirror.array[surface]
        laws = [one.reflectivity(hz, angles.cosine) for one in self.reflecting.mirrors]
        reflectivity = np.array(laws)[mirror, :, rays].T
        seen = self._seen(frequency_hz, surface, angles)
        return _mixed(self.own(frequency_hz)[surface].T, reflectivity, seen)

    def _seen(self, frequency_hz: Array, surface: NDArray[np.int32], angles: EndAngles) -> Array:
        """Returns what is seen in the surface (ray,) at the end of each ray, (frequency, ray)."""
        seen = np.zeros((len(frequency_hz), len(surface)))
        kinds = np.array([mirror.view for mirror in self.reflecting.mirrors])
        kind = kinds[self.reflecting.mirror.array[surface]]
        for view in ELEVATED:
            some = kind == view
            if some.any():
                seen[:, some] = self.by_elevation(frequency_hz, angles.elevation[some], view)
        place = self.reflecting.height_of(surface)
        for number, height_m in enumerate(self.reflecting.heights_m):
            some = (kind == "scattered") & (place == number)
            if some.any():
                upward, back = np.unique(angles.upward[some], return_inverse=True)
                seen[:, some] = self.by_tilt(frequency_hz, upward, height_m)[:, back]
        return seen


class _Seen(NamedTuple):
    """What is seen in surfaces, as look-ups.

    `sets` by elevation are (frequency, 3 node) by what is seen, `tilts` (height, frequency, node).
    """

    sets: dict[View, Array]
    tilts: Array
    knee: float
    dip: float  # of what is seen behind


@lru_cache(maxsize=16)  # a plan asks several times
def _brightest(sources: _Sending, frequencies: tuple[float, ...]) -> Array:
    """Returns what _Sending.brightest describes; what depends on the angle is sampled."""
    hz, reflecting = np.array(frequencies), sources.reflecting
    if not sources.angular:
        return np.abs(sources.table(hz).sent)
    seen: dict[View, Array] = {
        view: np.abs(sources.by_elevation(hz, SAMPLED, view)).max(axis=1)
        for view in ELEVATED
        if view in reflecting.views()
    }
    seen["scattered"] = np.abs(sources.by_tilt(hz, SAMPLED, 0.0)).max(axis=1)
    look_up = mirrors.by_cosine(reflecting.mirrors, hz)
    of_mirrors = zip(reflecting.mirrors, look_up, strict=True)
    most = np.array([seen[one.view] * rows.max(axis=1) for one, rows in of_mirrors])
    least, mirror = look_up.min(axis=2), reflecting.mirror.array
    return np.asarray((1 - least[mirror]) * np.abs(sources.own(hz)) + most[mirror])


def _mixed(own: Array, reflectivity: Array, seen: Array) -> Array:
    """Returns what surfaces send, as the module says."""
    return np.asarray((1 - reflectivity) * own + reflectivity * seen)


@dataclass(frozen=True)
class Emission(_Sending):
    """Surfaces that emit and reflect thermal radiation, in air of one mean temperature."""

    temperature_k: Values  # (surface,)
    reflecting: Reflecting
    air_k: float
    surroundings: Surroundings  # what is seen in surfaces
    behind: Backdrop | None = None  # what is seen where there is no surface
    unit = "K"
    trips = 1  # how often light passes the same path
    ways = 1  # how often light crosses the air, on one path or on two
    air_emits = True

    def own(self, frequency_hz: Array) -> Array:
        """Returns the black-body radiance less the mean air's, (surface, frequency).

        It is in W m-2 sr-1 Hz-1.
        """
        kelvin = self.temperature_k.array[:, None]
        return radiometry.planck_difference(frequency_hz, kelvin, self.air_k)

    def by_elevation(self, frequency_hz: Array, elevation: Array, view: View) -> Array:
        """Returns what is seen less the mean air's radiance, W m-2 sr-1 Hz-1."""
        return self._backdrop(view).contrast(frequency_hz, elevation, self.air_k)

    def by_tilt(self, frequency_hz: Array, upward: Array, height_m: float) -> Array:
        """Returns what rough surfaces see less the mean air's radiance, W m-2 sr-1 Hz-1."""
        return self.surroundings.scattered(frequency_hz, upward, height_m, self.air_k)

    def _backdrop(self, view: View) -> Backdrop:
        """Returns what stands behind the scene, or what is seen in its mirrors."""
        return self.surroundings if view == "mirrored" or self.behind is None else self.behind

    def _look_ups(self, frequency_hz: Array, tolerance: float) -> _Seen:
        """Returns behind and surroundings as look-ups."""
        air_k, knee = self.air_k, float(np.sqrt(self._backdrop("behind").knee))
        sets = {
            view: mirrors.by_elevation(self._backdrop(view), frequency_hz, air_k, knee, tolerance)
            for view in ELEVATED
            if view in self.reflecting.views()
        }
        heights = self.reflecting.heights_m
        tilts = mirrors.by_tilt(self.surroundings, frequency_hz, heights, air_k, tolerance)
        dip = float(np.sqrt(self._backdrop("behind").dip)) if "behind" in sets else 1.0
        return _Seen(_as_fine(sets), tilts, knee, dip)

    @property
    def _sees_alike(self) -> bool:
        """Returns whether the same is seen everywhere."""
        return not self.surroundings.angular and self.behind is None

    def brightest_along(
        self, frequency_hz: Array, surface: NDArray[np.int32], elevation: Array
    ) -> Array:
        """Returns the most that rays receive, in absolute value, (ray, frequency)."""
        found = super().brightest_along(frequency_hz, surface, elevation)
        if self.behind is not None:
            open_air = surface == BACKGROUND
            seen = np.abs(self.by_elevation(frequency_hz, SAMPLED, "behind"))
            rows = [np.interp(elevation[open_air], SAMPLED, row) for row in seen]
            found[open_air] = np.transpose(rows)
        return found

    def sky_views(self) -> list[View]:
        """Returns in what the sky is seen."""
        if not self.angular:
            return []
        views: list[View] = [] if self.behind is None else ["behind"]
        if self.surroundings.angular:
            seen = {one.view for one in self.reflecting.mirrors if one != Constant(0.0)}
            views += sorted(seen - {"behind"})
        return views

    def background(self, frequency_hz: Array) -> Array:
        """Returns the radiance of the mean air, (frequency,), to which contrasts are relative."""
        return radiometry.planck(frequency_hz, self.air_k)

    def passing(self, weights: Array, frequency_hz: Array) -> Array:
        """Returns the weights of the mean transmission of bands, (band, frequency).

        They are the bands' `weights` (band, frequency) times the air's radiance, and each row is
        normalised to a sum of 1.
        """
        radiance = weights * radiometry.planck(frequency_hz, self.air_k)
        return np.asarray(radiance / radiance.sum(axis=1, keepdims=True))

    def per_unit(self, frequency_hz: Array) -> Array:
        """Returns the change of radiance for one kelvin at the air's temperature, (frequency,).

        It is in W m-2 sr-1 Hz-1 K-1.
        """
        return radiometry.planck_slope(frequency_hz, self.air_k)


@dataclass(frozen=True)
class Reflection(_Sending):
    """Surfaces that reflect what a transmitter sends out, which is all that is seen in them.

    `trips` is 2 if light goes out and back through the same air, and 1 if the way out is another
    path.
    """

    reflecting: Reflecting
    trips: int
    unit = "of the power sent"
    ways = 2  # out and back
    air_emits = False

    def own(self, frequency_hz: Array) -> Array:
        """Returns zeros, (surface, frequency)."""
        return np.zeros((self.reflecting.mirror.shape[0], len(frequency_hz)))

    def by_elevation(self, frequency_hz: Array, elevation: Array, view: View) -> Array:
        """Returns ones: the power sent, at every frequency and elevation."""
        del view
        return np.ones((len(frequency_hz), len(elevation)))

    def by_tilt(self, frequency_hz: Array, upward: Array, height_m: float) -> Array:
        """Returns ones: the power sent, whatever the normal."""
        del height_m
        return np.ones((len(frequency_hz), len(upward)))

    def _look_ups(self, frequency_hz: Array, tolerance: float) -> _Seen:
        """Returns ones: straight lines are enough for them."""
        del tolerance
        count = len(frequency_hz)
        sets = {view: np.ones((count, 6)) for view in ELEVATED if view in self.reflecting.views()}
        return _Seen(sets, np.ones((1, count, 2)), 0.5, 1.0)

    def background(self, frequency_hz: Array) -> Array:
        """Returns ones, (frequency,): the power sent, to which echoes are relative."""
        return np.ones(len(frequency_hz))

    def passing(self, weights: Array, frequency_hz: Array) -> Array:
        """Returns the weights of the mean transmission of bands, which are the bands' own."""
        del frequency_hz
        return weights

    def per_unit(self, frequency_hz: Array) -> Array:
        """Returns ones, (frequency,), since echoes are parts of the power sent."""
        return np.ones(len(frequency_hz))


Sources = Emission | Reflection


@frozen
class SentSpec(Spec):
    """What surfaces send, as the kernels take it, at some frequencies."""

    sources: Sources
    frequency_hz: Values
    tolerance: float = mirrors.TOLERANCE  # of look-ups

    @property
    def stage(self) -> str:  # type: ignore[override]
        """Returns the stage of the sky, if it is seen, or else that of shading."""
        return "sky" if self.sources.sky_views() else "shading"

    def run(self, device: Device) -> Table:
        """Returns the table."""
        del device
        return self.sources.table(self.frequency_hz.array, self.tolerance)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns where the sky is seen, or that it is not."""
        if not self.sources.air_emits:
            return {"sky": LeftOut("active sensor: only echoes are seen")}
        if not self.sources.sky_views():
            return {"sky": LeftOut("no [sky] is seen: nothing above the scene's air is solved")}
        words = {"behind": "behind the scene", "scattered": "in surfaces", "mirrored": "in mirrors"}
        seen = " and ".join(words[view] for view in self.sources.sky_views())
        return {"sky": Work("", f"seen {seen}")}


def emission(scene: Scene, surfaces: list[Surface], above: Sky | None = None) -> Emission:
    """Returns what surfaces send to a passive sensor; without a temperature they have the air's.

    `above` is the sky, or None without one.
    """
    air_k = scene.atmosphere.temperature_k
    given = scene.background
    kelvin = [air_k if s.temperature_k is None else s.temperature_k for s in surfaces]
    around, behind = _around(scene, above), None
    if above is not None and given.temperature_k is None:
        surfaces = [s._replace(mirror=Opening()) if s.target == BACKGROUND else s for s in surfaces]
        camera_m = scene.camera.position_m[2]
        behind = Behind(above, camera_m, ceiling_m(scene, above.column.air), given.max_range_m)
    heights = isinstance(around, Sky)
    reflecting = Reflecting.of(surfaces, heights=heights)
    return Emission(Values.of(kelvin), reflecting, air_k, around, behind)


def _around(scene: Scene, above: Sky | None) -> Surroundings:
    """Returns what is seen in surfaces."""
    environment = scene.background.environment
    if environment == "sky" and above is not None:
        return above
    return Enclosure(enclosure_k(scene))


def reflection(surfaces: list[Surface], trips: int) -> Reflection:
    """Returns what surfaces send to an active sensor."""
    return Reflection(Reflecting.of(surfaces), trips)


def _as_fine(sets: dict[View, Array]) -> dict[View, Array]:
    """Returns sets of nodes by elevation with as many nodes as the finest of them has."""
    most = max((one.shape[1] // 3 for one in sets.values()), default=2)

    def finer(one: Array) -> Array:
        parts = one.reshape(len(one), 3, -1)
        old, new = np.linspace(0, 1, parts.shape[2]), np.linspace(0, 1, most)
        return np.array([[np.interp(new, old, row) for row in rows] for rows in parts]).reshape(
            len(one), -1
        )

    return {view: one if one.shape[1] == 3 * most else finer(one) for view, one in sets.items()}
