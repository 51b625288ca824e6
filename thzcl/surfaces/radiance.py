"""What surfaces send towards the camera: emission and reflection, or echoes of a transmitter.

A surface sends own + R (seen - own): `own` is what it would send if it reflected nothing, `seen`
what is seen in it, and R how much it reflects. All three are relative to the mean air. Of R a share
is mirrored. It sees what stands in the mirrored direction: the surroundings, or by one bounce
another thing of the scene, through mean air. A cover makes two such terms of three (fresnel.py's
`exchanged` has the formula).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.mean import Air
from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Spec, Values, Work, frozen
from thzcl.scenario.scene import Scene
from thzcl.surfaces import mirrors
from thzcl.surfaces.fresnel import exchanged
from thzcl.surfaces.geometry import BACKGROUND, Surface
from thzcl.surfaces.mirrors import (
    Backdrop,
    Constant,
    Enclosure,
    Law,
    Mirror,
    Opening,
    Surroundings,
    View,
)
from thzcl.surfaces.sky import Behind, Sky, enclosure_k

Array = NDArray[np.float64]

ELEVATED: tuple[View, ...] = ("behind", "mirrored")  # what is looked up by elevation
SAMPLED = np.array([-1.0, -0.3, -0.03, 0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])


class Covers(NamedTuple):
    """Thin layers over surfaces; those without one have a transmission of 1.

    `parts` (mirror, frequency, 2) are transmission and reflectivity. `exchanged` (surface,
    frequency) is what surface and cover add for each part of light between them.
    """

    parts: Array
    exchanged: Array


class Angular(NamedTuple):
    """Look-ups of what depends on the angle, as surfaces/source.cl describes them."""

    mirror: NDArray[np.int32]  # (surface,): the row of `reflectivity`
    view: NDArray[np.int32]  # (surface,): where in `seen` its set of nodes begins
    laws: tuple[Law, ...]  # what the rows are, the reflectivity first
    reflectivity: Array  # (mirror, frequency, law, node), by the root of the cosine from 0 to 1
    seen: Array  # (frequency, place): sets by elevation, then sets by the normal
    mirrored: int | None  # where in `seen` the set for mirrored shares begins, if there are any
    scattered: int  # where in `seen` the sets by the normal begin
    elevations: int  # nodes of a third of a set by elevation
    tilts: int  # nodes of a set by the normal
    knee: float  # the root of the sine of an elevation
    dip: float  # the root of the sine at which the first set ends below the horizon
    covers: Covers | None
    dimming: Array | None  # (frequency,): absorption along a bounce, 1/m, if there are bounces


class Table(NamedTuple):
    """What surfaces send, as the kernels take it.

    `sent` (surface, frequency) is all that they send, or what they would send if they reflected
    nothing if some of them look different from different angles.
    """

    sent: Array
    angular: Angular | None

    @property
    def rows(self) -> Array:
        """Returns `sent`, and below it what goes with covers if there are any, (row, frequency)."""
        if self.angular is None or self.angular.covers is None:
            return self.sent
        return np.vstack([self.sent, self.angular.covers.exchanged])

    def some(self, part: slice) -> Table:
        """Returns the table at some of its frequencies."""
        if self.angular is None:
            return Table(self.sent[:, part], None)
        covers, dimming = self.angular.covers, self.angular.dimming
        if covers is not None:
            covers = Covers(covers.parts[:, part], covers.exchanged[:, part])
        some = self.angular._replace(
            reflectivity=self.angular.reflectivity[:, part],
            seen=self.angular.seen[part],
            covers=covers,
            dimming=None if dimming is None else dimming[part],
        )
        return Table(self.sent[:, part], some)


class EndAngles(NamedTuple):
    """The angles at which rays end, (ray,), where they make a difference.

    `cosine` is that of the angle between ray and normal, `elevation` the sine of the mirrored
    ray's, and `upward` the vertical component of the normal. `polarization` is the part of the
    power whose field stands across the plane of incidence, or None for half of it. `bounce` is
    where mirrored rays end, if they are followed.
    """

    cosine: Array
    elevation: Array
    upward: Array
    polarization: Array | None = None
    bounce: Bounce | None = None


class Bounce(NamedTuple):
    """Where mirrored rays end, (ray,), at a surface that is 0 where they meet nothing."""

    surface: NDArray[np.int32]
    blend: Array
    length_m: Array
    angles: EndAngles


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
        views = {mirror.view for mirror in self.mirrors}
        return views | {"mirrored"} if self.mirrored else views

    @property
    def angular(self) -> bool:
        """Returns whether what some surface reflects depends on the angle."""
        return any(mirror.angular for mirror in self.mirrors)

    @property
    def mirrored(self) -> bool:
        """Returns whether a share of what some surface reflects is mirrored."""
        return any(mirror.mirrored for mirror in self.mirrors)

    @property
    def polarized(self) -> bool:
        """Returns whether what some surface reflects depends on the polarisation."""
        return any(mirror.polarized for mirror in self.mirrors)

    @property
    def covered(self) -> bool:
        """Returns whether some surface has a cover."""
        return any(mirror.cover is not None for mirror in self.mirrors)

    def covers(self, frequency_hz: Array) -> Array:
        """Returns transmission and reflectivity of the covers, (mirror, frequency, 2)."""
        none = np.ones(len(frequency_hz)), np.zeros(len(frequency_hz))
        each = [none if one.cover is None else one.cover.at(frequency_hz) for one in self.mirrors]
        return np.stack([np.stack(pair, axis=-1) for pair in each])

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
    bounces = False  # whether mirrored rays are followed to the next surface
    lobes = False  # whether mirrored shares send something back to a transmitter

    @abstractmethod
    def own(self, frequency_hz: Array) -> Array:
        """Returns what surfaces would send if they reflected nothing, (surface, frequency).

        Those with a cover are taken without it.
        """

    def of_covers(self, frequency_hz: Array) -> Array:
        """Returns what the surfaces' covers would send if they were black, as `own` does."""
        return np.zeros((self.reflecting.mirror.shape[0], len(frequency_hz)))

    def dimming(self, frequency_hz: Array) -> Array:
        """Returns the absorption of the air along a bounce, (frequency,) in 1/m."""
        return np.zeros(len(frequency_hz))

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
        one = self.reflecting
        return one.angular or self.bounces or (one.anything and not self._sees_alike)

    def table(self, frequency_hz: Array, tolerance: float = mirrors.TOLERANCE) -> Table:
        """Returns what surfaces send at some frequencies.

        `tolerance` is that of look-ups, relative to their largest value.
        """
        own, reflecting = self.own(frequency_hz), self.reflecting
        if not self.angular:
            reflectivity = reflecting.reflectivity(frequency_hz, np.ones(1))
            seen = self.by_tilt(frequency_hz, np.ones(1), 0.0)[:, 0]
            layers = self._layers(frequency_hz)
            return Table(_mixed(own, reflectivity, seen, seen, layers), None)
        covers = None
        if reflecting.covered:
            own, covers = self._under_covers(frequency_hz, own)
        return Table(own, self._angular(frequency_hz, tolerance, covers))

    def _layers(self, frequency_hz: Array) -> _Layers | None:
        """Returns the covers of all surfaces, (surface, frequency), or None if there are none."""
        if not self.reflecting.covered:
            return None
        parts = self.reflecting.covers(frequency_hz)[self.reflecting.mirror.array]
        return _Layers(parts[..., 0], parts[..., 1], self.of_covers(frequency_hz))

    def _under_covers(self, frequency_hz: Array, own: Array) -> tuple[Array, Covers]:
        """Returns what surfaces send under their covers if none reflects, and the rest."""
        layers = self._layers(frequency_hz)
        assert layers is not None  # noqa: S101 (it is called where there are covers)
        parts = self.reflecting.covers(frequency_hz)
        return layers.through(own), Covers(parts, layers.exchanged(own))

    def _angular(self, frequency_hz: Array, tolerance: float, covers: Covers | None) -> Angular:
        """Returns the look-ups, and where in them what is seen in each surface begins."""
        look_ups, reflecting = self._look_ups(frequency_hz, tolerance), self.reflecting
        sets, tilts = look_ups.sets, look_ups.tilts
        scattered, begins = 0, dict[View, int]()
        for view, one in sets.items():
            begins[view], scattered = scattered, scattered + one.shape[1]
        mirror = reflecting.mirror.array
        heights = reflecting.height_of(np.arange(len(mirror), dtype=np.int32))
        views = [reflecting.mirrors[number].view for number in mirror]
        places = [
            begins.get(view, scattered + height * tilts.shape[2])
            for view, height in zip(views, heights, strict=True)
        ]
        laws = self._laws()
        return Angular(
            mirror,
            np.array(places, np.int32),
            laws,
            mirrors.by_cosine(reflecting.mirrors, frequency_hz, tolerance, laws),
            np.hstack([*sets.values(), *tilts]),
            begins.get("mirrored") if reflecting.mirrored or self.bounces else None,
            scattered,
            scattered // (3 * max(len(sets), 1)),
            tilts.shape[2],
            look_ups.knee,
            look_ups.dip,
            covers,
            self.dimming(frequency_hz) if self.bounces else None,
        )

    def _laws(self) -> tuple[Law, ...]:
        """Returns the laws of mirrors that surfaces need, the reflectivity first."""
        reflecting = self.reflecting
        asked: dict[Law, bool] = {
            "reflectivity": True,
            "polarization": reflecting.polarized,
            "share": reflecting.mirrored,
            "lobe": self.lobes,
        }
        return tuple(name for name, wanted in asked.items() if wanted)

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
        laws = {name: self._law(name, frequency_hz, surface, angles) for name in self._laws()}
        reflectivity = laws["reflectivity"]
        if angles.polarization is not None and "polarization" in laws:
            reflectivity = reflectivity + (angles.polarization - 0.5) * laws["polarization"]
        scattered = seen = self._seen(frequency_hz, surface, angles)
        if "share" in laws:
            seen = seen + laws["share"] * (self._mirrored(frequency_hz, angles) - seen)
        layers = self._layers(frequency_hz)
        if layers is not None:
            layers = _Layers(*(one[surface].T for one in layers))
        own = self.own(frequency_hz)[surface].T
        sent = _mixed(own, reflectivity, seen, scattered, layers)
        return sent + laws["lobe"] if "lobe" in laws else sent

    def _law(
        self, name: Law, frequency_hz: Array, surface: NDArray[np.int32], angles: EndAngles
    ) -> Array:
        """Returns a law of the mirrors at the ends of rays, (frequency, ray)."""
        found = np.empty((len(frequency_hz), len(surface)))
        mirror = self.reflecting.mirror.array[surface]
        for number in np.unique(mirror):
            some = mirror == number
            law = getattr(self.reflecting.mirrors[number], name)
            found[:, some] = law(frequency_hz[:, None], angles.cosine[some])
        return found

    def _mirrored(self, frequency_hz: Array, angles: EndAngles) -> Array:
        """Returns what is seen in the mirrored direction, (frequency, ray)."""
        found = self.by_elevation(frequency_hz, angles.elevation, "mirrored")
        bounce = angles.bounce
        if bounce is None:
            return found
        met = bounce.surface > 0
        cosine, elevation, upward = (one[met] for one in bounce.angles[:3])
        second = EndAngles(cosine, elevation, upward)
        sent = self.sent(frequency_hz, bounce.surface[met], bounce.blend[met], second)
        found = found.copy()
        passed = np.exp(-self.dimming(frequency_hz)[:, None] * bounce.length_m[met])
        found[:, met] = sent * passed
        return found

    def _seen(self, frequency_hz: Array, surface: NDArray[np.int32], angles: EndAngles) -> Array:
        """Returns what surfaces (ray,) see but for mirrored shares, (frequency, ray)."""
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


class _Layers(NamedTuple):
    """Covers as they lie on surfaces, in arrays of one shape: fresnel.exchanged has the formulas.

    `own` is what a black cover would send; where there is none, `transmission` is 1.
    """

    transmission: Array
    reflectivity: Array
    own: Array

    def through(self, own: Array) -> Array:
        """Returns what comes from surface and cover if the surface reflects nothing."""
        absorbed = self._absorbed()
        return np.asarray(self.transmission * own + absorbed * self.own)

    def exchanged(self, own: Array) -> Array:
        """Returns what the light between surface and cover changes of that, for each part of it."""
        lost = (1 - self.reflectivity) * own
        return np.asarray(self.transmission * (self._absorbed() * self.own - lost))

    def _absorbed(self) -> Array:
        """Returns the part of light that covers absorb."""
        return np.maximum(1 - self.transmission - self.reflectivity, 0.0)


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
    mirror, own = reflecting.mirror.array, np.abs(sources.own(hz))
    if reflecting.mirrored or reflecting.covered:
        around = np.max([*seen.values()], axis=0)
        if sources.bounces:
            around = np.maximum(around, own.max(axis=0))
        lobes = np.array([one.lobe(hz[:, None], np.ones(1))[:, 0] for one in reflecting.mirrors])
        most = np.maximum(own, np.maximum(np.abs(sources.of_covers(hz)), around))
        return np.asarray(most * (1 + (lobes[mirror] if sources.lobes else 0.0)))
    look_up = mirrors.by_cosine(reflecting.mirrors, hz)[:, :, 0]
    of_mirrors = zip(reflecting.mirrors, look_up, strict=True)
    most = np.array([seen[one.view] * rows.max(axis=1) for one, rows in of_mirrors])
    least = look_up.min(axis=2)
    return np.asarray((1 - least[mirror]) * own + most[mirror])


def _mixed(
    own: Array, reflectivity: Array, seen: Array, scattered: Array, layers: _Layers | None
) -> Array:
    """Returns what surfaces send, as the module says.

    `seen` is what they see, through their covers too, and `scattered` what their covers see.
    """
    if layers is None:
        return np.asarray((1 - reflectivity) * own + reflectivity * seen)
    between = exchanged(reflectivity, layers.reflectivity)
    through = layers.transmission**2 * between * seen
    sent = layers.through(own) + between * layers.exchanged(own)
    return np.asarray(sent + layers.reflectivity * scattered + through)


@dataclass(frozen=True)
class Emission(_Sending):
    """Surfaces that emit and reflect thermal radiation, in air of one mean temperature."""

    temperature_k: Values  # (surface,)
    reflecting: Reflecting
    air_k: float
    surroundings: Surroundings  # what is seen in surfaces
    behind: Backdrop | None = None  # what is seen where there is no surface
    through: Air | None = None  # the mean air along mirrored rays, if these are followed
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

    def of_covers(self, frequency_hz: Array) -> Array:
        """Returns a black cover's radiance less the mean air's, (surface, frequency)."""
        given = [
            None if one.cover is None else one.cover.temperature_k
            for one in self.reflecting.mirrors
        ]
        kelvin = np.array([self.air_k if one is None else one for one in given])
        found = radiometry.planck_difference(frequency_hz, kelvin[:, None], self.air_k)
        return np.asarray(found[self.reflecting.mirror.array])

    @property
    def bounces(self) -> bool:  # type: ignore[override]
        """Returns whether mirrored rays are followed to the next surface."""
        return self.through is not None

    def dimming(self, frequency_hz: Array) -> Array:
        """Returns the absorption of the mean air, (frequency,) in 1/m."""
        if self.through is None:
            return super().dimming(frequency_hz)
        return np.asarray(self.through.absorption(frequency_hz))

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
            some = [one for one in self.reflecting.mirrors if one != Constant(0.0)]
            seen = {one.view for one in some}
            seen |= {"mirrored"} if self.reflecting.mirrored else set()
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
    path. If the sensor takes surfaces as rough (`lambert`), mirrored shares send back what their
    slopes do, or nothing.
    """

    reflecting: Reflecting
    trips: int
    lambert: bool = False
    unit = "of the power sent"
    ways = 2  # out and back
    air_emits = False

    def own(self, frequency_hz: Array) -> Array:
        """Returns zeros, (surface, frequency)."""
        return np.zeros((self.reflecting.mirror.shape[0], len(frequency_hz)))

    def by_elevation(self, frequency_hz: Array, elevation: Array, view: View) -> Array:
        """Returns ones: the power sent, at every frequency and elevation."""
        none = self.lambert and view == "mirrored"
        return np.full((len(frequency_hz), len(elevation)), 0.0 if none else 1.0)

    def by_tilt(self, frequency_hz: Array, upward: Array, height_m: float) -> Array:
        """Returns ones: the power sent, whatever the normal."""
        del height_m
        return np.ones((len(frequency_hz), len(upward)))

    def _look_ups(self, frequency_hz: Array, tolerance: float) -> _Seen:
        """Returns ones: straight lines are enough for them."""
        del tolerance
        count = len(frequency_hz)
        sets = {
            view: self.by_elevation(frequency_hz, np.zeros(6), view)
            for view in ELEVATED
            if view in self.reflecting.views()
        }
        return _Seen(sets, np.ones((1, count, 2)), 0.5, 1.0)

    @property
    def lobes(self) -> bool:  # type: ignore[override]
        """Returns whether mirrored shares send something back to a transmitter."""
        return self.lambert and any(mirror.slope for mirror in self.reflecting.mirrors)

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


def emission(
    scene: Scene, surfaces: list[Surface], above: Sky | None = None, through: Air | None = None
) -> Emission:
    """Returns what surfaces send to a passive sensor; without a temperature they have the air's.

    `above` is the sky, or None without one; `through` is the air along mirrored rays, or None if
    these are not followed.
    """
    air_k = scene.atmosphere.temperature_k
    given = scene.background
    kelvin = [air_k if s.temperature_k is None else s.temperature_k for s in surfaces]
    around, behind = _around(scene, above), None
    if above is not None and given.temperature_k is None:
        surfaces = [s._replace(mirror=Opening()) if s.target == BACKGROUND else s for s in surfaces]
        camera_m = scene.camera.position_m[2]
        behind = Behind(above, camera_m, above.column.even_m, given.max_range_m)
    heights = isinstance(around, Sky)
    reflecting = Reflecting.of(surfaces, heights=heights)
    return Emission(Values.of(kelvin), reflecting, air_k, around, behind, through)


def _around(scene: Scene, above: Sky | None) -> Surroundings:
    """Returns what is seen in surfaces."""
    environment = scene.background.environment
    if environment == "sky" and above is not None:
        return above
    return Enclosure(enclosure_k(scene))


def reflection(surfaces: list[Surface], trips: int, *, lambert: bool = False) -> Reflection:
    """Returns what surfaces send to an active sensor, which may take them as rough."""
    return Reflection(Reflecting.of(surfaces), trips, lambert)


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
