"""What surfaces send towards the camera: what they emit and reflect, or echoes of a transmitter."""

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
    """Surfaces of their own temperatures, before air of one mean temperature."""

    temperature_k: Values  # (surface,)
    reflectivity: Values  # (surface,)
    air_k: float
    environment: float | Literal["air", "none"]  # as [background] has it
    unit = "K"
    trips = 1  # how often the air of a path takes its share
    ways = 1
    air_emits = True

    def table(self, frequency_hz: Array) -> Array:
        """Returns radiance above the mean air's, (surface, frequency), W m-2 sr-1 Hz-1."""
        kelvin, reflectivity = self.temperature_k.array, self.reflectivity.array
        return radiometry.surface_contrast(
            frequency_hz, kelvin, reflectivity, self.air_k, self.environment
        )

    def background(self, frequency_hz: Array) -> Array:
        """Returns the radiance that a contrast is seen against: the air's, (frequency,)."""
        return radiometry.planck(frequency_hz, self.air_k)

    def passing(self, weights: Array, frequency_hz: Array) -> Array:
        """Returns weights of a band's mean transmission: those of the air's own radiance.

        Both (band, frequency); rows of the result sum to 1.
        """
        seen = weights * radiometry.planck(frequency_hz, self.air_k)
        return np.asarray(seen / seen.sum(axis=1, keepdims=True))

    def per_unit(self, frequency_hz: Array) -> Array:
        """Returns the radiance of a kelvin of the air's brightness, (frequency,)."""
        return radiometry.planck_slope(frequency_hz, self.air_k)


@dataclass(frozen=True)
class Reflection:
    """Surfaces that send back what a transmitter sends out.

    `trips` is 2 where it goes out and back through the same air, 1 where the way out is its own.
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
        """Returns the power sent, of which echoes are a part: ones, (frequency,)."""
        return np.ones(len(frequency_hz))

    def passing(self, weights: Array, frequency_hz: Array) -> Array:
        """Returns weights of a band's mean transmission: the band's own, (band, frequency)."""
        del frequency_hz
        return weights

    def per_unit(self, frequency_hz: Array) -> Array:
        """Returns ones, (frequency,): echoes are parts of the power sent already."""
        return np.ones(len(frequency_hz))


Sources = Emission | Reflection


def emission(scene: Scene, surfaces: list[Surface]) -> Emission:
    """Returns what a passive sensor sees; surfaces without a temperature have the air's."""
    air_k = scene.atmosphere.temperature_k
    kelvin = [air_k if s.temperature_k is None else s.temperature_k for s in surfaces]
    environment: Any = scene.background.environment
    return Emission(Values.of(kelvin), _reflectivity(surfaces), air_k, environment)


def reflection(surfaces: list[Surface], trips: int) -> Reflection:
    """Returns what an active sensor sees."""
    return Reflection(_reflectivity(surfaces), trips)


def _reflectivity(surfaces: list[Surface]) -> Values:
    return Values.of([surface.reflectivity for surface in surfaces])
