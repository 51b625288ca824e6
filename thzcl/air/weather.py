"""What falls through the air: light that rain, fog and snow scatter into rays, and emit.

Along a ray of depth tau and length d, what falls adds

    [k_s (S - B) + sum k_a (B(T_h) - B)] d phi(tau),    phi(x) = (1 - exp(-x)) / x,

to the contrast. B is a black body of the air's temperature, k_s what is scattered and k_a what each
kind absorbs per metre, T_h the temperature of its drops or flakes, and S the mean radiance over the
phase function. S comes from plane layers without end: the sky's, or, without a sky, those of what
falls alone, black at the air's temperature above. It is taken at the mean height of a ray's two
ends. d phi(tau) stands for the integral of the transmission, which it is in even air.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, radiometry, scattering, sky
from thzcl.air.composition import Part
from thzcl.air.mean import Air
from thzcl.air.sky import SPACE_K, Column
from thzcl.air.validity import ROUNDING
from thzcl.graph import frozen

Array = NDArray[np.float64]

ORDERS = 2 * scattering.DIRECTIONS + 1  # moments of a phase function
SINES, HEIGHTS = 65, 9  # nodes of a look-up above the horizon, as many below, and in height
THINNEST = 0.01  # depth of layers beside the ground and a top
COARSE_M, GROWTH = 50.0, 0.2  # of layers: the thickest below 1 km, and how fast they grow
LEVEL = 1e-6  # sine of the lowest elevation that is looked up


class Kind(NamedTuple):
    """One kind of what falls, at some frequencies: coefficients in 1/m, (frequency,).

    `legendre` (order, frequency) are the moments of its phase function, `kelvin` its temperature,
    `top_m` the height up to which it falls, and `backscatter` what it scatters back, in 1/m/sr.
    """

    absorption: Array
    scattering: Array
    legendre: Array
    kelvin: Array
    top_m: float
    backscatter: Array | float = 0.0


def falling(air: Air, frequency_hz: Array) -> list[Kind]:
    """Returns what falls in an air: what scatters, or has a temperature of its own."""
    return [kind for _, kind in _kinds(air, _hashed(frequency_hz))]


def falls(air: Air, frequency_hz: Array) -> bool:
    """Returns whether anything falls."""
    return bool(_kinds(air, _hashed(frequency_hz)))


def falling_parts(air: Air, frequency_hz: Array) -> list[Part]:
    """Returns the constituents that fall."""
    return [part for part, _ in _kinds(air, _hashed(frequency_hz))]


@lru_cache(maxsize=64)
def _kinds(air: Air, frequencies: tuple[float, ...]) -> tuple[tuple[Part, Kind], ...]:
    hz, found = np.array(frequencies), []
    state = air.temperature_k, air.pressure_hpa, air.vapour_pressure_hpa
    for part in air.parts:
        if composition.constituent_class(part.name).gas:
            continue
        optics = composition.optical_properties(part, hz, *state)
        scattered = np.broadcast_to(np.asarray(optics.scattering), hz.shape)
        absorbed = np.broadcast_to(np.asarray(optics.absorption), hz.shape)
        own = air.temperature_k if optics.temperature_k is None else optics.temperature_k
        kelvin = np.broadcast_to(np.asarray(own, dtype=np.float64), hz.shape)
        alike = np.allclose(kelvin, air.temperature_k, rtol=ROUNDING, atol=0)
        if not (scattered.any() or (absorbed.any() and not alike)):
            continue
        moments = np.zeros((ORDERS, len(hz)))
        moments[0] = 1.0
        if scattered.any():
            given = composition.moments(part, optics)[:ORDERS]
            moments[: len(given)] = np.where(scattered > 0, given, moments[: len(given)])
        back = np.broadcast_to(np.asarray(optics.backscatter), hz.shape)
        kind = Kind(absorbed, scattered, moments, kelvin, composition.layer_top_m(part), back)
        found.append((part, kind))
    return tuple(found)


class Ground(Protocol):
    """The ground: of one temperature in kelvin, it scatters evenly what falls on it.

    With `around_k` it scatters the light of black walls of that temperature instead.
    """

    @property
    def temperature_k(self) -> float:
        """Returns its temperature, K."""

    @property
    def around_k(self) -> float | None:
        """Returns the temperature of the walls, K."""

    def reflected(self, frequency_hz: Array) -> Array:
        """Returns the part of the light that it scatters, (frequency,)."""


@frozen
class Weather:
    """What falls over a ground, under a sky or, without a column, under black at air temperature.

    Without a ground it is black at the air's temperature below, too.
    """

    air: Air
    column: Column | None = None
    ground: Ground | None = None
    directions: int = scattering.DIRECTIONS
    highest_m: float = math.inf  # the layers end there, if they do not before
    thinnest: float = THINNEST

    def extinction(self, frequency_hz: Array) -> Array:
        """Returns what falls takes from light, 1/m, (frequency,)."""
        kinds = falling(self.air, frequency_hz)
        return np.asarray(sum((k.absorption + k.scattering for k in kinds), np.zeros(())))

    def source(self, frequency_hz: Array, sine: Array, height_m: Array) -> Array:
        """Returns what is added along a metre of rays, W m-2 sr-1 Hz-1 m-1, (frequency, ray).

        `sine` (ray,) is that of the elevation at which the camera looks, `height_m` (ray,) that of
        the place.
        """
        found = np.zeros((len(frequency_hz), len(sine)))
        for kind in falling(self.air, frequency_hz):
            own = radiometry.planck_difference(frequency_hz, kind.kelvin, self.air.temperature_k)
            found += (kind.absorption * own)[:, None]
        lost = sum(kind.scattering for kind in falling(self.air, frequency_hz))
        if np.any(lost):
            found += np.asarray(lost)[:, None] * self._mean(frequency_hz, sine, height_m)
        return found

    def look_up(self, frequency_hz: Array, sine: Array, height_m: Array) -> LookUp:
        """Returns a look-up of `source` for all rays between the ends of these."""
        sines = _nodes(float(sine.min()), float(sine.max()))
        low, high = float(height_m.min()), float(height_m.max())
        heights = np.linspace(low, high, HEIGHTS) if high > low else np.array([low])
        where = np.meshgrid(sines, heights, indexing="ij")
        values = self.source(frequency_hz, *(one.ravel() for one in where))
        return LookUp(sines, heights, values.reshape(-1, len(sines), len(heights)))

    def seen(self, frequency_hz: Array, sine: Array, height_m: Array) -> Array:
        """Returns the contrast of what rays see from some heights, (frequency, ray)."""
        solved = self._solved(frequency_hz)
        layer, part = solved.place(height_m)
        return scattering.within(solved.light, -sine, layer, part)

    def _mean(self, frequency_hz: Array, sine: Array, height_m: Array) -> Array:
        """Returns the mean radiance over the phase function, less B, (frequency, ray)."""
        solved, found = self._solved(frequency_hz), np.empty((len(frequency_hz), len(sine)))
        directions, back = np.unique(-sine, return_inverse=True)
        ends = scattering.scattered_in(solved.light, directions)
        layer, part = solved.place(height_m)
        for number in range(len(directions)):
            rays = back == number
            upper, lower = ends[:, layer[rays], 0, number], ends[:, layer[rays], 1, number]
            found[:, rays] = upper + part[rays] * (lower - upper)
        return found

    def _solved(self, frequency_hz: Array) -> _Solved:
        return _solve(self, _hashed(frequency_hz))


class LookUp(NamedTuple):
    """What falls adds along a metre, over the sine of the elevation and the height, as nodes."""

    sines: Array
    heights_m: Array
    values: Array  # (frequency, sine, height)

    def at(self, number: int, sine: Array, height_m: Array) -> Array:
        """Returns the values at one frequency, by its number, linear between the nodes, (ray,)."""
        rows = self.values[number]
        left, part = _place(self.sines, sine)
        if len(self.heights_m) == 1:
            column = rows[:, 0]
            return np.asarray(column[left] + part * (column[left + 1] - column[left]))
        below, share = _place(self.heights_m, height_m)
        low = rows[left, below] + part * (rows[left + 1, below] - rows[left, below])
        above = below + 1
        high = rows[left, above] + part * (rows[left + 1, above] - rows[left, above])
        return np.asarray(low + share * (high - low))


def _place(nodes: Array, values: Array) -> tuple[NDArray[np.intp], Array]:
    """Returns between which nodes values lie, and where."""
    left = np.clip(np.searchsorted(nodes, values, side="right") - 1, 0, len(nodes) - 2)
    return left, np.clip((values - nodes[left]) / (nodes[left + 1] - nodes[left]), 0.0, 1.0)


def _nodes(low: float, high: float) -> Array:
    """Returns sines from low to high: what is seen jumps at the horizon, and bends beside it."""
    sides = []
    if low < 0:
        far, near = -low, max(LEVEL, -high)
        sides.append(-_root_spaced(near, far)[::-1])
    if high >= 0:
        sides.append(_root_spaced(max(LEVEL, low), high))
    return np.concatenate(sides)


def _root_spaced(near: float, far: float) -> Array:
    """Returns sines that lie closer together towards the horizon."""
    far = max(far, near * (1 + 1e-6))
    return np.asarray(np.linspace(np.sqrt(near), np.sqrt(far), SINES) ** 2)


class _Solved(NamedTuple):
    """The light in layers, and the heights of their edges from the top down, m."""

    light: scattering.Scattered
    edges_m: Array

    def place(self, height_m: Array) -> tuple[NDArray[np.intp], Array]:
        """Returns in which layers heights lie, and how much of the layer lies above them."""
        depth = -self.edges_m
        layer, part = _place(depth, np.clip(-height_m, depth[0], depth[-1]))
        return layer, part


@lru_cache(maxsize=32)
def _solve(weather: Weather, frequencies: tuple[float, ...]) -> _Solved:
    hz, air = np.array(frequencies), weather.air
    edges, gas, low_k, high_k = _gas(weather, hz)
    thick = np.diff(edges)
    of_air = radiometry.planck_difference(
        hz[:, None, None], np.stack([high_k, low_k], axis=-1), air.temperature_k
    )  # at the upper and at the lower end of each layer
    extinction, scattered = gas.copy(), np.zeros_like(gas)
    emission = gas[..., None] * of_air
    moments = np.zeros((ORDERS, *gas.shape))
    for kind in falling(air, hz):
        there = edges[1:] <= min(kind.top_m, weather.highest_m) * (1 + 1e-12)
        absorbed, turned = (one[:, None] * there for one in (kind.absorption, kind.scattering))
        warmer = (kind.kelvin - air.temperature_k)[:, None, None]
        own_k = np.maximum(np.stack([high_k, low_k], axis=-1) + warmer, 1.0)
        own = radiometry.planck_difference(hz[:, None, None], own_k, air.temperature_k)
        emission += absorbed[..., None] * own
        extinction += absorbed + turned
        scattered += turned
        moments += turned * kind.legendre[:, :, None]
    dense = extinction > 0
    over = np.where(dense, extinction, 1.0)
    moments = np.divide(moments, scattered, out=np.zeros_like(moments), where=scattered > 0)
    moments[0] = 1.0
    down = slice(None, None, -1)
    layers = scattering.Layers(
        (extinction * thick)[:, down],
        (scattered / over)[:, down],
        moments[:, :, down],
        (emission / over[..., None])[:, down],
    )
    light = scattering.solve(layers, _bounds(weather, hz), weather.directions)
    return _Solved(light, edges[down])


def _gas(weather: Weather, hz: Array) -> tuple[Array, Array, Array, Array]:
    """Returns the edges of layers, what else than what falls absorbs there, and temperatures.

    Edges ascend; absorption is (frequency, layer) in 1/m, and the temperatures at the lower and at
    the upper ends (layer,), K.
    """
    air, column = weather.air, weather.column
    whole = air.absorption(hz)
    tops = sorted({min(kind.top_m, weather.highest_m) for kind in falling(air, hz)})
    if column is not None:
        highest = float(sky.levels(column)[-1])
        tops = [min(top, highest) for top in tops]
    edges = _graded(np.array([0.0, *tops]), whole, weather.thinnest)
    if column is None:
        other = np.maximum(whole - weather.extinction(hz), 0.0)
        kelvin = np.full(len(edges) - 1, air.temperature_k)
        return edges, np.repeat(other[:, None], len(kelvin), axis=1), kelvin, kelvin
    above = sky.levels(replace(column, finest_m=COARSE_M))
    edges = np.array(sorted({*edges.tolist(), *above[above > tops[-1]].tolist()}))
    absorption, kelvin = sky.layers(column, hz, edges, falling_parts(air, hz))
    return edges, absorption, kelvin[:, 0], kelvin[:, 1]


def _graded(ends: Array, extinction: Array, thinnest: float) -> Array:
    """Returns heights between some ends, closer together towards these, where light changes fast.

    Steps are of `thinnest` depth at the densest frequency beside an end, grow with the distance
    from it, and end at scattering.THICKEST of that at the clearest.
    """
    dense, clear = max(float(extinction.max()), 1e-12), max(float(extinction.min()), 1e-12)
    fine, coarse = thinnest / dense, min(scattering.THICKEST / clear, COARSE_M)
    found = []
    for low, high in pairwise(ends.tolist()):
        steps, middle = [0.0], (high - low) / 2
        while steps[-1] < middle:
            step = max(min(GROWTH * steps[-1], coarse), min(fine, coarse))
            steps.append(steps[-1] + step)
        rise = np.array(steps) * (middle / steps[-1])
        found += [low + rise, high - rise]
    return np.unique(np.concatenate(found))


def _bounds(weather: Weather, hz: Array) -> scattering.Bounds:
    """Returns what lies above and below the layers."""
    air_k, zero = weather.air.temperature_k, np.zeros(len(hz))
    above = zero if weather.column is None else radiometry.planck_difference(hz, SPACE_K, air_k)
    ground = weather.ground
    if ground is None:
        return scattering.Bounds(above, zero, zero)
    own = radiometry.planck_difference(hz, ground.temperature_k, air_k)
    mirrored = ground.reflected(hz)
    if ground.around_k is None:
        return scattering.Bounds(above, own, mirrored)
    lit = radiometry.planck_difference(hz, ground.around_k, air_k)
    return scattering.Bounds(above, (1 - mirrored) * own + mirrored * lit, zero)


def _hashed(frequency_hz: Array) -> tuple[float, ...]:
    return tuple(np.asarray(frequency_hz, dtype=np.float64).ravel().tolist())
