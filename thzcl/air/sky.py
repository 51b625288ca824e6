"""The sky: what the air above a scene sends down, in float64 on the host.

The air is that of the scene, even, up to where rays leave the scene; above that it is that of a
profile, into which the scene's is blended. In each
direction the formal solution of radiative transfer is summed up over layers, as the difference to a
black body of the scene's air, within which the source varies linearly with depth. Upwards the Earth
is a sphere, so that the sky near the horizon is seen through no more air than there is; downwards
the ground is the scene's plane z = 0. Refraction is left out. Behind the last layer there is the
cosmic background.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, radiometry
from thzcl.air.composition import Part
from thzcl.air.mean import Air
from thzcl.air.profile import Profile, State
from thzcl.graph import frozen

Array = NDArray[np.float64]

EARTH_M = 6371e3  # radius
SPACE_K = 2.725  # beyond the air
BLENDED_M = 1000.0  # over which the scene's departure from the profile falls by a factor e
DRIEST = 1e-3  # a scene's vapour counts as at least this part of the profile's
FINEST_M = 25.0  # layers below 1 km
THINNEST_HPA = 0.1  # where the column ends: all that lies above absorbs next to nothing
# Thickness of layers by height, in layers of below 1 km.
_LAYERS = ((1e3, 1), (3e3, 2), (6e3, 4), (15e3, 10), (30e3, 20), (70e3, 40))


@frozen
class Column:
    """The air above a scene: the profile, and the scene's own air at `scene_m` blended into it.

    Up to `even_m` the air is the scene's. `finest_m` is the thickness of layers below 1 km. A
    column that is `plane` has no Earth to curve it, for comparisons.
    """

    air: Air
    profile: Profile
    scene_m: float
    even_m: float = 0.0
    finest_m: float = FINEST_M
    plane: bool = False

    def departure(self) -> tuple[float, float, float]:
        """Returns how the scene's air departs from the profile at its height.

        That is temperature in K, and the ratios of vapour pressure and of pressure.
        """
        there, air = self.profile.at(self.scene_m), self.air
        return (
            air.temperature_k - float(there.temperature_k),
            air.vapour_pressure_hpa / float(there.vapour_hpa),
            air.pressure_hpa / float(there.pressure_hpa),
        )

    def at(self, height_m: Array) -> State:
        """Returns the air at some heights, as it is above the scene."""
        pressure, kelvin, vapour = self.profile.at(height_m)
        warmer, moister, _ = self.departure()
        part = np.exp(-np.maximum(height_m - self.scene_m, 0.0) / BLENDED_M)
        vapour = vapour * max(moister, DRIEST) ** part
        return State(pressure, kelvin + warmer * part, np.minimum(vapour, pressure))


@lru_cache(maxsize=64)
def levels(column: Column) -> Array:
    """Returns the heights of the levels between which layers lie, ascending, m."""
    profile = column.profile
    top = float(np.interp(-THINNEST_HPA, -profile.pressure_hpa.array, profile.height_m.array))
    parts, below = [], 0.0
    for above, thick in _LAYERS:
        parts.append(np.arange(below, above, thick * column.finest_m))
        below = above
    tops = [composition.layer_top_m(part) for part in column.air.parts]
    all_heights = np.concatenate([*parts, profile.height_m.array, [top, column.even_m], tops])
    return np.array(sorted({*all_heights[(all_heights >= 0) & (all_heights <= top)].tolist()}))


class _Layers(NamedTuple):
    """The layers of a column: absorption (frequency, layer) in 1/m, and what they emit.

    `low` and `high`, (frequency, layer), are a black body's radiance at their lower and upper ends,
    less that of the scene's air.
    """

    absorption: Array
    low: Array
    high: Array


def layers(
    column: Column, frequency_hz: Array, heights: Array, without: Sequence[Part] = ()
) -> tuple[Array, Array]:
    """Returns the absorption of layers, (frequency, layer) in 1/m, but of some constituents.

    Returns their temperatures too, (layer, 2) in K, at the lower and at the upper ends. The layers
    lie between some heights, which ascend, m.
    """
    kelvin, even = _temperatures(column, heights)
    hz = np.asarray(frequency_hz)[:, None]
    return _absorption(column, hz, heights, even, without), kelvin


def _temperatures(column: Column, heights: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Returns temperatures of layers, (layer, 2) in K, and whether they are the scene's air."""
    even, kelvin = heights[1:] <= column.even_m, column.at(heights).temperature_k
    ends = np.stack([kelvin[:-1], kelvin[1:]], axis=1)
    return np.where(even[:, None], column.air.temperature_k, ends), even


@lru_cache(maxsize=16)
def _layers(column: Column, frequencies: tuple[float, ...]) -> _Layers:
    """Returns the layers between the levels of a column."""
    hz, mean_k = np.array(frequencies)[:, None], column.air.temperature_k
    heights = levels(column)
    kelvin, even = _temperatures(column, heights)
    low, high = (radiometry.planck_difference(hz, one, mean_k) for one in kelvin.T)
    return _Layers(_absorption(column, hz, heights, even), low, high)


def _absorption(
    column: Column,
    hz: Array,
    heights: Array,
    even: NDArray[np.bool_],
    without: Sequence[Part] = (),
) -> Array:
    """Returns the absorption of layers, (frequency, layer) in 1/m, for `hz` (frequency, 1)."""
    mean, state = column.air, column.at(heights)
    gas = np.zeros((len(hz), len(heights)))
    rest, of_scene = np.zeros((len(hz), len(heights) - 1)), np.zeros((len(hz), 1))
    own = mean.temperature_k, mean.pressure_hpa, mean.vapour_pressure_hpa
    for part in mean.parts:
        if part in without:
            continue
        here = np.asarray(composition.optical_properties(part, hz, *own).absorption)
        if composition.constituent_class(part.name).gas:
            above = state.temperature_k, state.pressure_hpa, state.vapour_hpa
            gas += np.asarray(composition.optical_properties(part, hz, *above).absorption)
            of_scene += here
        else:
            rest += here * (heights[1:] <= composition.layer_top_m(part))
    return np.where(even, of_scene, _between(gas[:, :-1], gas[:, 1:])) + rest


def _between(one: Array, other: Array) -> Array:
    """Returns the mean of a quantity that falls exponentially from one value to another."""
    low, high = np.minimum(one, other), np.maximum(one, other)
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log1p((high - low) / low)
        mean = (high - low) / logarithm
    return np.where((low > 0) & (logarithm > 1e-8), mean, (low + high) / 2)


def seen_above(
    column: Column, frequency_hz: Array, sine: Array, height_m: Array | float
) -> tuple[Array, Array]:
    """Returns contrast to the scene's air and optical depth of the sky, (frequency, direction).

    `sine` (direction,) of the elevation is at least 0, and `height_m` is that of the eye, one for
    all or (direction,).
    """
    layers = _layers(column, _hashed(frequency_hz))
    edges, here = levels(column), np.broadcast_to(height_m, sine.shape)
    walk = _Walk(layers, edges, np.maximum(here, 0.0))
    for layer in range(len(edges) - 1):
        low = np.clip(walk.eye, edges[layer], edges[layer + 1])
        if (low < edges[layer + 1]).any():
            far = np.full_like(low, edges[layer + 1])
            length = column_length(column, sine, walk.eye, far)
            walk.cross(layer, low, far, length - column_length(column, sine, walk.eye, low))
    beyond = radiometry.planck_difference(frequency_hz, SPACE_K, column.air.temperature_k)
    return walk.contrast + walk.passed * beyond[:, None], walk.depth


def seen_below(
    column: Column, frequency_hz: Array, sine: Array, height_m: Array | float, ground: Array
) -> Array:
    """Returns the contrast of the ground through the air, (frequency, direction).

    `sine` (direction,) is that of the angle below the horizon, above 0, and `ground` (frequency,)
    the ground's own contrast.
    """
    layers = _layers(column, _hashed(frequency_hz))
    edges, here = levels(column), np.broadcast_to(height_m, sine.shape)
    walk = _Walk(layers, edges, np.maximum(here, 0.0))
    for layer in range(len(edges) - 2, -1, -1):
        high = np.clip(walk.eye, edges[layer], edges[layer + 1])
        if (high > edges[layer]).any():
            far = np.full_like(high, edges[layer])
            walk.cross(layer, high, far, (high - far) / sine)
    return walk.contrast + walk.passed * ground[:, None]


class _Walk:
    """What an eye sees of the layers that its rays have crossed so far, (frequency, direction)."""

    def __init__(self, layers: _Layers, edges: Array, eye: Array) -> None:
        self.layers, self.edges, self.eye = layers, edges, eye
        self.contrast = np.zeros((len(layers.absorption), len(eye)))
        self.depth = np.zeros_like(self.contrast)
        self.passed = np.ones_like(self.contrast)

    def cross(self, layer: int, near_m: Array, far_m: Array, length_m: Array) -> None:
        """Adds a stretch (direction,) of each ray within a layer, from one height to another."""
        tau = self.layers.absorption[:, layer, None] * length_m
        lost = -np.expm1(-tau)
        mean = np.divide(lost, tau, out=np.ones_like(tau), where=tau > 0)  # of what is left on it
        near, far = self._sent(layer, near_m), self._sent(layer, far_m)
        self.contrast += self.passed * (near * (1 - mean) + far * (mean - (1 - lost)))
        self.depth += tau
        self.passed *= 1 - lost

    def _sent(self, layer: int, height_m: Array) -> Array:
        low, high = self.edges[layer : layer + 2]
        part = (height_m - low) / (high - low)
        one, other = self.layers.low[:, layer, None], self.layers.high[:, layer, None]
        return np.asarray(one + part * (other - one))


def column_length(column: Column, sine: Array, eye_m: Array, height_m: Array) -> Array:
    """Returns how far an eye looks until its ray is at a height, (direction,), m.

    It is the root of a quadratic equation over the sphere, written so that no digits are lost.
    """
    rise = height_m - eye_m
    if column.plane:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(rise > 0, rise / sine, 0.0)
    upright = (EARTH_M + eye_m) * sine
    square = rise**2 + 2 * (EARTH_M + eye_m) * rise
    with np.errstate(invalid="ignore"):
        length = square / (np.sqrt(upright**2 + square) + upright)
    return np.where(rise > 0, length, 0.0)


POINTS = 64  # directions above the horizon, and as many below, of the mean over a hemisphere


def tilted(upward: Array, points: int = POINTS) -> tuple[Array, Array]:
    """Returns sines of elevation (point,), and their weights (tilt, point) in what a face sees.

    `upward` (tilt,) is the vertical component of the face's normal. The face is Lambert's: light is
    weighted with the cosine from the normal, averaged over all azimuths. The first half of the
    points lies above the horizon and has (1 + upward) / 2 of the weight.
    """
    nodes, _ = _gauss(points)
    root = (1 + nodes) / 2  # of the sine, since the sky changes fast near the horizon
    halves = [
        np.array([_of_tilt(float(one), side, nodes) for one in upward]) for side in (1.0, -1.0)
    ]
    return np.concatenate([root**2, -(root**2)]), np.hstack(halves)


def _of_tilt(upward: float, side: float, nodes: Array) -> Array:
    """Returns the weights of directions above (1) or below (-1) the horizon, (point,).

    The weight of a direction has a bend where all azimuths begin to lie before the face, at the
    elevation of its tilt. The integral is cut there, and what is seen is taken as the polynomial
    through the points.
    """
    x, w = _gauss(max(len(nodes) // 2, 4))
    bend = (1 - upward**2) ** 0.25  # the root of the sine of that elevation
    parts = [(low, high) for low, high in ((0.0, bend), (bend, 1.0)) if high > low]
    root = np.concatenate([low + (high - low) * (1 + x) / 2 for low, high in parts])
    step = np.concatenate([(high - low) * w for low, high in parts])
    sine = side * root**2
    along, across = upward * sine, np.sqrt((1 - upward**2) * (1 - sine**2))
    with np.errstate(divide="ignore", invalid="ignore"):
        lit = np.arccos(np.clip(-along / across, -1, 1))  # half of the azimuths before the face
    lit = np.where(across > 0, lit, np.where(along > 0, np.pi, 0.0))
    weight = np.maximum(along * lit + across * np.sin(lit), 0.0) * root * step
    total, share = weight.sum(), (1 + side * upward) / 2
    if not total > 0:
        return np.zeros(len(nodes))
    return np.asarray((weight * (share / total)) @ _polynomials(nodes, 2 * root - 1))


def _polynomials(nodes: Array, at: Array) -> Array:
    """Returns the polynomials that are 1 at one of the nodes and 0 at the others, (place, node).

    It is the barycentric formula for Gauss' nodes (Berrut and Trefethen 2004, SIAM Review 46, 501).
    """
    _, w = _gauss(len(nodes))
    signs = (-1.0) ** np.arange(len(nodes)) * np.sqrt((1 - nodes**2) * w)
    apart = at[:, None] - nodes
    met = np.abs(apart) < 1e-14
    terms = signs / np.where(met, 1.0, apart)
    found = terms / terms.sum(axis=1, keepdims=True)
    return np.where(met.any(axis=1, keepdims=True), met.astype(np.float64), found)


@lru_cache(maxsize=8)
def _gauss(points: int) -> tuple[Array, Array]:
    """Returns the nodes and weights of Gauss and Legendre's rule from -1 to 1."""
    x, w = np.polynomial.legendre.leggauss(points)
    return x, w


def _hashed(frequency_hz: Array) -> tuple[float, ...]:
    return tuple(np.asarray(frequency_hz, dtype=np.float64).ravel().tolist())
