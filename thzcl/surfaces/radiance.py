"""What surfaces send towards the camera: emission and reflection, or echoes of a transmitter.

A surface sends own + R (seen - own): `own` is what it would send if it reflected nothing, `seen`
what is seen in it, and R how much it reflects. All three are relative to the mean air.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.graph import Values
from thzcl.scenario.scene import Scene
from thzcl.surfaces import mirrors
from thzcl.surfaces.geometry import Surface
from thzcl.surfaces.mirrors import Constant, Enclosure, Mirror, Surroundings

Array = NDArray[np.float64]


class Angular(NamedTuple):
    """Look-ups of what depends on the angle, at equal steps."""

    mirror: NDArray[np.int32]  # (surface,): the row of `reflectivity`
    reflectivity: Array  # (mirror, frequency, node), over the cosine of the angle from 0 to 1
    seen: Array  # (frequency, node), over the sine of the mirrored ray's elevation from -1 to 1


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
        mirror, reflectivity, seen = self.angular
        return Table(self.sent[:, part], Angular(mirror, reflectivity[:, part], seen[part]))


class EndAngles(NamedTuple):
    """The angles at which rays end, (ray,), where they make a difference.

    `cosine` is that of the angle between ray and normal, `elevation` the sine of the mirrored
    ray's.
    """

    cosine: Array
    elevation: Array


@dataclass(frozen=True)
class Reflecting:
    """Surfaces by number, each with the number of its mirror; several may have one in common."""

    mirrors: tuple[Mirror, ...]
    mirror: Values  # (surface,), int32

    @classmethod
    def of(cls, surfaces: list[Surface]) -> Reflecting:
        """Returns the mirrors of some surfaces."""
        number = {one: n for n, one in enumerate(dict.fromkeys(s.mirror for s in surfaces))}
        return cls(tuple(number), Values.of([number[s.mirror] for s in surfaces], np.int32))

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
    def seen(self, frequency_hz: Array, elevation: Array) -> Array:
        """Returns what is seen in a mirror, of the arguments' common shape."""

    @abstractmethod
    def _seen_by_elevation(self, frequency_hz: Array) -> Array:
        """Returns `seen` as a look-up, (frequency, node)."""

    @property
    def _sees_alike(self) -> bool:
        """Returns whether the same is seen at every elevation."""
        return True

    @property
    def angular(self) -> bool:
        """Returns whether what surfaces send depends on the angle at which rays meet them."""
        return self.reflecting.angular or (self.reflecting.anything and not self._sees_alike)

    def table(self, frequency_hz: Array) -> Table:
        """Returns what surfaces send at some frequencies."""
        own = self.own(frequency_hz)
        if not self.angular:
            reflectivity = self.reflecting.reflectivity(frequency_hz, np.ones(1))
            seen = self.seen(frequency_hz, np.ones(1))
            return Table(_mixed(own, reflectivity, seen), None)
        look_ups = Angular(
            self.reflecting.mirror.array,
            mirrors.by_cosine(self.reflecting.mirrors, frequency_hz),
            self._seen_by_elevation(frequency_hz),
        )
        return Table(own, look_ups)

    def brightest(self, frequency_hz: Array) -> Array:
        """Returns a bound on what surfaces send, in absolute value, (surface, frequency)."""
        sent, angular = self.table(frequency_hz)
        if angular is None:
            return np.abs(sent)
        most = angular.reflectivity.max(axis=2)[angular.mirror] * np.abs(angular.seen).max(axis=1)
        least = angular.reflectivity.min(axis=2)[angular.mirror]
        return np.asarray((1 - least) * np.abs(sent) + most)

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
            first, second = (self._from(frequency_hz, row, angles) for row in (surface, following))
        return np.asarray(first + blend * (second - first))

    def _from(self, frequency_hz: Array, surface: NDArray[np.int32], angles: EndAngles) -> Array:
        """Returns what a surface (ray,) sends at the end of each ray, (frequency, ray)."""
        hz, rays = frequency_hz[:, None], np.arange(len(surface))
        mirror = self.reflecting.mirror.array[surface]
        laws = [one.reflectivity(hz, angles.cosine) for one in self.reflecting.mirrors]
        reflectivity = np.array(laws)[mirror, :, rays].T
        seen = self.seen(hz, angles.elevation)
        return _mixed(self.own(frequency_hz)[surface].T, reflectivity, seen)


def _mixed(own: Array, reflectivity: Array, seen: Array) -> Array:
    """Returns what surfaces send, as the module says."""
    return np.asarray((1 - reflectivity) * own + reflectivity * seen)


@dataclass(frozen=True)
class Emission(_Sending):
    """Surfaces that emit and reflect thermal radiation, in air of one mean temperature."""

    temperature_k: Values  # (surface,)
    reflecting: Reflecting
    air_k: float
    surroundings: Surroundings
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

    def seen(self, frequency_hz: Array, elevation: Array) -> Array:
        """Returns the radiance of the surroundings less the mean air's, W m-2 sr-1 Hz-1."""
        return self.surroundings.contrast(frequency_hz, elevation, self.air_k)

    def _seen_by_elevation(self, frequency_hz: Array) -> Array:
        """Returns the surroundings as a look-up, (frequency, node)."""
        return mirrors.by_elevation(self.surroundings, frequency_hz, self.air_k)

    @property
    def _sees_alike(self) -> bool:
        """Returns whether the surroundings are the same at every elevation."""
        return not self.surroundings.angular

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

    def seen(self, frequency_hz: Array, elevation: Array) -> Array:
        """Returns ones: the power sent, at every frequency and elevation."""
        return np.ones(np.broadcast_shapes(frequency_hz.shape, elevation.shape))

    def _seen_by_elevation(self, frequency_hz: Array) -> Array:
        """Returns ones, (frequency, 2): one straight line is enough for them."""
        return np.ones((len(frequency_hz), 2))

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


def emission(scene: Scene, surfaces: list[Surface]) -> Emission:
    """Returns what surfaces send to a passive sensor; without a temperature they have the air's."""
    air_k = scene.atmosphere.temperature_k
    kelvin = [air_k if s.temperature_k is None else s.temperature_k for s in surfaces]
    named = {"air": air_k, "none": 0.0}
    environment: Any = scene.background.environment
    around = Enclosure(named.get(environment, environment))
    return Emission(Values.of(kelvin), Reflecting.of(surfaces), air_k, around)


def reflection(surfaces: list[Surface], trips: int) -> Reflection:
    """Returns what surfaces send to an active sensor."""
    return Reflection(Reflecting.of(surfaces), trips)
