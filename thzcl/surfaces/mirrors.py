"""What surfaces reflect by the angle, and what stands around them to be seen in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry

Array = NDArray[np.float64]

FEWEST, MOST = 17, 8193  # nodes of a look-up
TOLERANCE = 1e-6  # of a look-up between its nodes, relative to the largest value
HORIZON = 1e-12  # the sine of an elevation that is as good as none

# What is seen in a surface: what stands in the mirrored direction; the mean over the half of space
# that it faces, weighted with the cosine from its normal (Lambert); or, where there is no surface,
# what stands behind.
View = Literal["mirrored", "scattered", "behind"]


class Mirror(Protocol):
    """How much of the light that falls on a surface it reflects. It is hashable."""

    @property
    def angular(self) -> bool:
        """Returns whether that depends on the angle."""

    @property
    def view(self) -> View:
        """Returns what is seen in the surface."""

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the part of the power that is reflected, of the arguments' common shape.

        `cosine` is that of the angle between ray and surface normal.
        """


@dataclass(frozen=True)
class Constant:
    """A rough surface that reflects the same part at every angle and frequency."""

    value: float
    angular = False
    view: ClassVar[View] = "scattered"

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns that part in the arguments' common shape."""
        return np.broadcast_to(self.value, np.broadcast_shapes(frequency_hz.shape, cosine.shape))


@dataclass(frozen=True)
class Opening:
    """No surface: all that stands behind is seen."""

    angular = False
    view: ClassVar[View] = "behind"

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns ones in the arguments' common shape."""
        return np.ones(np.broadcast_shapes(frequency_hz.shape, cosine.shape))


class Backdrop(Protocol):
    """What is seen by elevation where nothing of the scene is. It is hashable."""

    @property
    def knee(self) -> float:
        """Returns the sine of an elevation, between 0 and 1, at which it may have a bend."""

    @property
    def dip(self) -> float:
        """Returns the sine of an angle below the horizon, up to 1, from which on it is constant."""

    def contrast(self, frequency_hz: Array, elevation: Array, air_k: float) -> Array:
        """Returns its radiance less planck(air_k), (frequency, direction).

        `frequency_hz` is (frequency,), and `elevation` (direction,) the sine of the angle above the
        horizon, from -1 to 1.
        """


class Surroundings(Backdrop, Protocol):
    """What is seen in surfaces, from anywhere in the scene."""

    @property
    def angular(self) -> bool:
        """Returns whether it depends on the elevation."""

    def scattered(self, frequency_hz: Array, upward: Array, height_m: float, air_k: float) -> Array:
        """Returns the mean radiance before Lambert faces less planck(air_k), (frequency, face).

        `upward` (face,) is the vertical component of their normals, from -1 to 1, and `height_m`
        that of their place.
        """


@dataclass(frozen=True)
class Enclosure:
    """Black walls of one temperature in kelvin all around; at 0 K there is nothing."""

    temperature_k: float
    angular = False
    knee = 0.5
    dip = 1.0

    def contrast(self, frequency_hz: Array, elevation: Array, air_k: float) -> Array:
        """Returns the radiance of the walls less planck(air_k), (frequency, direction)."""
        found = radiometry.planck_difference(frequency_hz, self.temperature_k, air_k)
        return np.broadcast_to(found[:, None], (len(frequency_hz), len(elevation)))

    def scattered(self, frequency_hz: Array, upward: Array, height_m: float, air_k: float) -> Array:
        """Returns the same before any face, (frequency, face)."""
        del height_m
        return self.contrast(frequency_hz, upward, air_k)


def by_cosine(
    mirrors: tuple[Mirror, ...], frequency_hz: Array, tolerance: float = TOLERANCE
) -> Array:
    """Returns reflectivities at equal steps of the cosine, 0 to 1, (mirror, frequency, node)."""
    hz = frequency_hz[:, None]
    return _look_up(
        lambda cosine: np.array([mirror.reflectivity(hz, cosine) for mirror in mirrors]),
        0.0,
        tolerance,
    )


def by_elevation(
    backdrop: Backdrop,
    frequency_hz: Array,
    air_k: float,
    knee: float,
    tolerance: float = TOLERANCE,
) -> Array:
    """Returns contrasts by elevation, (frequency, 3 node), as surfaces/source.cl looks them up.

    The three parts are: from the horizon down to the dip, from the horizon up to the knee, and from
    the knee to straight up. `knee` is the root of its sine. Nodes are at equal steps of such roots,
    since what is seen changes fast near the horizon, where it jumps.
    """
    dip = np.sqrt(backdrop.dip)

    def law(part: Array) -> Array:
        down = -np.maximum((dip * part) ** 2, HORIZON)
        low, high = (knee * part) ** 2, np.minimum((knee + (1 - knee) * part) ** 2, 1.0)
        sines = down, low, high
        return np.stack([backdrop.contrast(frequency_hz, one, air_k) for one in sines], axis=1)

    found = _look_up(law, 0.0, tolerance)
    return np.ascontiguousarray(found.reshape(len(frequency_hz), -1))


def by_tilt(
    surroundings: Surroundings,
    frequency_hz: Array,
    heights_m: tuple[float, ...],
    air_k: float,
    tolerance: float = TOLERANCE,
) -> Array:
    """Returns what Lambert faces see at equal steps of their tilt, (height, frequency, node).

    It runs from faces that look down to faces that look up.
    """

    def law(part: Array) -> Array:
        upward = np.sin(np.pi / 2 * part)
        return np.array([surroundings.scattered(frequency_hz, upward, z, air_k) for z in heights_m])

    return _look_up(law, -1.0, tolerance)


def _look_up(law: Callable[[Array], Array], low: float, tolerance: float) -> Array:
    """Returns a law at equal steps from `low` to 1, (..., node), doubled until it is good between.

    Straight lines between nodes then err by at most `tolerance` of the law's largest value, if MOST
    nodes suffice for that. The law itself is asked until cubic splines do.
    """
    nodes = FEWEST
    at = np.linspace(low, 1.0, nodes)
    values = law(at)
    while nodes < MOST:
        middle = (at[1:] + at[:-1]) / 2
        between = law(middle)
        bearable = tolerance / 2 * max(np.abs(values).max(), np.abs(between).max())
        smooth = np.abs(between - _spline(at, values, middle)).max() <= bearable
        values = _merged(values, between)
        nodes = 2 * nodes - 1
        at = np.linspace(low, 1.0, nodes)
        if smooth:
            return _straight(at, values, bearable)
    return np.ascontiguousarray(values)


def _straight(at: Array, values: Array, bearable: float) -> Array:
    """Returns a smooth law at so many nodes that straight lines between them serve."""
    nodes = len(at)
    fewer = values
    while nodes > FEWEST and nodes % 2:  # what is straight anyway needs no more than the fewest
        half = fewer[..., ::2]
        if np.abs(fewer[..., 1::2] - (half[..., 1:] + half[..., :-1]) / 2).max() > bearable:
            break
        fewer, nodes = half, half.shape[-1]
    if nodes < len(at):
        return np.ascontiguousarray(fewer)
    while nodes < MOST:
        fine = np.linspace(at[0], at[-1], 2 * nodes - 1)
        finer = _spline(at, values, fine)
        half = finer[..., ::2]
        wrong = np.abs(finer[..., 1::2] - (half[..., 1:] + half[..., :-1]) / 2).max()
        fewer, nodes = finer, 2 * nodes - 1
        if wrong <= bearable:
            break
    return np.ascontiguousarray(fewer)


def _merged(values: Array, between: Array) -> Array:
    """Returns values at nodes and at the middles between them, in order."""
    found = np.empty((*values.shape[:-1], values.shape[-1] + between.shape[-1]))
    found[..., ::2], found[..., 1::2] = values, between
    return found


def _spline(at: Array, values: Array, wanted: Array) -> Array:
    """Returns the cubic spline through values (..., node) at other places, (..., place)."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(at, values, axis=-1)(wanted))
