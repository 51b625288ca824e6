"""What surfaces send towards the camera: emission and reflection, or echoes of a transmitter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.graph import Values
from thzcl.scenario.scene import Scene
from thzcl.surfaces.geometry import Surface

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Emission:
    """Surfaces that emit and reflect thermal radiation, in air of one mean temperature."""

    temperature_k: Values  # (surface,)
    reflectivity: Values  # (surface,)
    air_k: float
    environment: float | Literal["air", "none"]  # as [background] has it
    unit = "K"
    trips = 1  # how often light passes the same path
    ways = 1  # how often light crosses the air, on one path or on two
    air_emits = True

    def table(self, frequency_hz: Array) -> Array:
        """Returns the radiance less the mean air's, (surface, frequency), W m-2 sr-1 Hz-1."""
        kelvin, reflectivity = self.temperature_k.array, self.reflectivity.array
        return radiometry.surface_contrast(
            frequency_hz, kelvin, reflectivity, self.air_k, self.environment
        )

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
class Reflection:
    """Surfaces that reflect what a transmitter sends out.

    `trips` is 2 if light goes out and back through the same air, and 1 if the way out is another
    path.
    """

    reflectivity: Values  # (surface,)
    trips: int
    unit = "of the power sent"
    ways = 2  # out and back
    air_emits = False

    def table(self, frequency_hz: Array) -> Array:
        """Returns the reflectivity, (surface, frequency)."""
        rows = self.reflectivity.array[:, None]
        return np.broadcast_to(rows, (len(rows), len(frequency_hz)))

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
    environment: Any = scene.background.environment
    return Emission(Values.of(kelvin), _reflectivity(surfaces), air_k, environment)


def reflection(surfaces: list[Surface], trips: int) -> Reflection:
    """Returns what surfaces send to an active sensor."""
    return Reflection(_reflectivity(surfaces), trips)


def _reflectivity(surfaces: list[Surface]) -> Values:
    """Returns the reflectivity of each surface, (surface,)."""
    return Values.of([surface.reflectivity for surface in surfaces])
