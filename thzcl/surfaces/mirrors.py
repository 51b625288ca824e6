"""What surfaces reflect by the angle, and what stands around them to be seen in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry

Array = NDArray[np.float64]

FEWEST, MOST = 17, 8193  # nodes of a look-up
TOLERANCE = 1e-6  # of a look-up between its nodes, relative to the largest value


class Mirror(Protocol):
    """How much of the light that falls on a surface it reflects. It is hashable."""

    @property
    def angular(self) -> bool:
        """Returns whether that depends on the angle."""

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the part of the power that is reflected, of the arguments' common shape.

        `cosine` is that of the angle between ray and surface normal.
        """


@dataclass(frozen=True)
class Constant:
    """A surface that reflects the same part at every angle and frequency."""

    value: float
    angular = False

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns that part in the arguments' common shape."""
        return np.broadcast_to(self.value, np.broadcast_shapes(frequency_hz.shape, cosine.shape))


class Surroundings(Protocol):
    """What is seen where nothing of the scene is. It is hashable."""

    @property
    def angular(self) -> bool:
        """Returns whether it depends on the elevation."""

    def contrast(self, frequency_hz: Array, elevation: Array, air_k: float) -> Array:
        """Returns its radiance less planck(air_k), of the first two arguments' common shape.

        `elevation` is the sine of the angle above the horizon, from -1 to 1.
        """


@dataclass(frozen=True)
class Enclosure:
    """Black walls of one temperature in kelvin all around; at 0 K there is nothing."""

    temperature_k: float
    angular = False

    def contrast(self, frequency_hz: Array, elevation: Array, air_k: float) -> Array:
        """Returns the radiance of the walls less planck(air_k)."""
        found = radiometry.planck_difference(frequency_hz, self.temperature_k, air_k)
        return np.broadcast_to(found, np.broadcast_shapes(frequency_hz.shape, elevation.shape))


def by_cosine(mirrors: tuple[Mirror, ...], frequency_hz: Array) -> Array:
    """Returns reflectivities at equal steps of the cosine, 0 to 1, (mirror, frequency, node)."""
    hz = frequency_hz[:, None]
    return _look_up(
        lambda cosine: np.array([mirror.reflectivity(hz, cosine) for mirror in mirrors]), 0.0
    )


def by_elevation(surroundings: Surroundings, frequency_hz: Array, air_k: float) -> Array:
    """Returns contrasts at equal steps of the elevation's sine from -1 to 1, (frequency, node)."""
    hz = frequency_hz[:, None]
    return _look_up(lambda sine: surroundings.contrast(hz, sine, air_k), -1.0)


def _look_up(law: Callable[[Array], Array], low: float) -> Array:
    """Returns a law at equal steps from `low` to 1, (..., node), doubled until it is good between.

    Straight lines between nodes then err by at most TOLERANCE of the law's largest value, if MOST
    nodes suffice for that.
    """
    nodes = FEWEST
    values = law(np.linspace(low, 1.0, nodes))
    while nodes < MOST:
        finer = law(np.linspace(low, 1.0, 2 * nodes - 1))
        middle = (values[..., 1:] + values[..., :-1]) / 2
        wrong = np.abs(finer[..., 1::2] - middle).max()
        if wrong <= TOLERANCE * np.abs(finer).max():
            break
        nodes, values = 2 * nodes - 1, finer
    return np.ascontiguousarray(values)
