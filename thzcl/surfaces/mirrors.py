"""What surfaces reflect by the angle, and what stands around them to be seen in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.surfaces.fresnel import exchanged, lobe

Array = NDArray[np.float64]

FEWEST, MOST = 17, 8193  # nodes of a look-up
TOLERANCE = 1e-6  # of a look-up between its nodes, relative to the largest value
HORIZON = 1e-12  # the sine of an elevation that is as good as none

# What is seen in a surface: what stands in the mirrored direction; the mean over the half of space
# that it faces, weighted with the cosine from its normal (Lambert); or, where there is no surface,
# what stands behind.
View = Literal["mirrored", "scattered", "behind"]
Law = Literal["reflectivity", "polarization", "share", "lobe"]  # methods of a mirror


class Cover(Protocol):
    """A thin layer over a surface. It is hashable."""

    @property
    def temperature_k(self) -> float | None:
        """Returns its temperature in kelvin, or None for the air's."""

    def at(self, frequency_hz: Array) -> tuple[Array, Array]:
        """Returns what part it lets through, and what part it scatters back, (frequency,) each."""


class Mirror:
    """How much of the light that falls on a surface it reflects. Its subclasses are hashable.

    Of what is reflected, a share is `mirrored`, and the rest shows the `view`. Where light is
    `polarized`, the reflectivity is that for unpolarised light plus (q - 1/2) times the
    polarisation, with the part q of the power whose electric field stands across the plane of
    incidence.
    """

    angular: ClassVar[bool] = False  # whether the reflectivity depends on the angle
    mirrored: ClassVar[bool] = False  # whether there is a mirrored share
    view: ClassVar[View] = "scattered"
    polarized: bool = False
    slope: float | None = None  # rms, of the facets that send light back where it came from
    cover: Cover | None = None

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the part of the power that is reflected, of the arguments' common shape.

        `cosine` is that of the angle between ray and surface normal.
        """
        raise NotImplementedError

    def polarization(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns R_s - R_p, of the arguments' common shape."""
        return np.zeros(np.broadcast_shapes(frequency_hz.shape, cosine.shape))

    def share(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the mirrored share of what is reflected, of the arguments' common shape."""
        return np.zeros(np.broadcast_shapes(frequency_hz.shape, cosine.shape))

    def lobe(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns pi times what the mirrored share sends back to a transmitter, per steradian.

        It is of the arguments' common shape, and 0 without a `slope`.
        """
        if self.slope is None:
            return np.zeros(np.broadcast_shapes(frequency_hz.shape, cosine.shape))
        upright = self.reflectivity(frequency_hz, np.ones(1))
        passed, back = (
            (np.ones(1), np.zeros(1)) if self.cover is None else self.cover.at(frequency_hz)
        )
        sent = passed**2 * exchanged(upright, back) * lobe(self.slope, cosine)
        return np.asarray(self.share(frequency_hz, cosine) * sent)


@dataclass(frozen=True)
class Constant(Mirror):
    """A rough surface that reflects the same part at every angle and frequency."""

    value: float

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns that part in the arguments' common shape."""
        return np.broadcast_to(self.value, np.broadcast_shapes(frequency_hz.shape, cosine.shape))


@dataclass(frozen=True)
class Opening(Mirror):
    """No surface: all that stands behind is seen."""

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
    mirrors: tuple[Mirror, ...],
    frequency_hz: Array,
    tolerance: float = TOLERANCE,
    laws: tuple[Law, ...] = ("reflectivity",),
) -> Array:
    """Returns laws at equal steps of the cosine's root, (mirror, frequency, law, node).

    The root runs from 0 to 1: most laws change fast near grazing incidence.
    """
    hz = frequency_hz[:, None]

    def rows(name: Law, root: Array) -> Array:
        return np.array([getattr(mirror, name)(hz, root**2) for mirror in mirrors])

    nodes = [_look_up(partial(rows, name), 0.0, tolerance) for name in laws]
    most = max(one.shape[2] for one in nodes)
    root = np.linspace(0.0, 1.0, most)
    fine = [
        one if one.shape[2] == most else rows(name, root)
        for name, one in zip(laws, nodes, strict=True)
    ]
    return np.stack(fine, axis=2)


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
