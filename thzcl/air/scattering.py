"""Scattered light in plane layers, in float64 on the host: intensities, and what is scattered in.

In air of one temperature the difference of radiance to a black body's of that temperature obeys the
source-free equation of transfer. All radiances here are such differences, in any unit: what is as
warm as that is 0, and layers within a black enclosure of that temperature give exactly 0, however
they scatter.

Directions are cosines `mu` of light's travel from the zenith: above 0 it goes up, and a camera that
looks up sees light of mu below 0. Layers are counted from the top down, and so are the levels that
bound them. Phase functions with a narrow peak are cut by delta-M (Wiscombe 1977, J. Atmos. Sci. 34,
1408); there are 24 directions to a hemisphere, Gauss' of each, and moments of order 0 to 47.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import mie

Array = NDArray[np.float64]

DIRECTIONS = 24  # to a hemisphere
THICKEST = 0.1  # depth of the pieces into which layers that scatter are cut
FINER = 8  # pieces more, for what is thicker than a piece by that
MOST_PIECES = 256  # of a layer
SAME = 1e-9  # relative to the largest source: the series of scatterings is summed up to there
MOST_PASSES = 3000
LEVEL = 1e-9  # cosine that counts as that of a level direction


class Layers(NamedTuple):
    """Plane layers from the top down.

    `depth` (frequency, layer) is that of extinction, `albedo` (frequency, layer) the part of it
    that is scattered, `legendre` (order, frequency, layer) the moments of the phase function, of
    order 0 to 2 n for n directions to a hemisphere. `emission` (frequency, layer, 2) is what is
    emitted along a unit of depth, at the upper and at the lower end: 1 - albedo, times the black
    body's.
    """

    depth: Array
    albedo: Array
    legendre: Array
    emission: Array


class Bounds(NamedTuple):
    """What lies above and below the layers.

    `above` (frequency,) is the radiance that comes in from above, the same from everywhere; `below`
    (frequency,) the radiance of a black ground. Lambert's ground of `reflectivity` (frequency,)
    sends that part of what falls on it in all directions, and the rest of `below`.
    """

    above: Array
    below: Array
    reflectivity: Array


class Scattered(NamedTuple):
    """The light in layers: its moments (order, frequency, level), half its integrals with P_l(mu).

    The layers are those of the cut phase function. `peak` (frequency, layer) is the part of the
    scattered light that the cut counts as not scattered, and `passes` how often light is scattered
    until nothing is left.
    """

    layers: Layers
    bounds: Bounds
    peak: Array
    moments: Array
    passes: int


def henyey_greenstein(asymmetry: Array, orders: int = 2 * DIRECTIONS + 1) -> Array:
    """Returns the moments g^l of a phase function by Henyey and Greenstein (1941), (order, ...)."""
    g = np.asarray(asymmetry, dtype=np.float64)
    return g ** np.arange(orders).reshape(-1, *(1,) * g.ndim)


def cut(layers: Layers, thickest: float = THICKEST) -> tuple[Layers, NDArray[np.intp]]:
    """Returns layers cut into pieces, and which layer each of them is of.

    Pieces are thinner towards a layer's ends, where what is scattered changes fastest. What
    scatters nothing is left whole, since what it emits varies linearly with depth in it.
    """
    scattering = np.where(layers.albedo > 0, layers.depth, 0.0).max(axis=0)
    pieces = np.ceil(np.pi / 2 * scattering / thickest) + FINER * (scattering > thickest / FINER)
    pieces = np.clip(pieces, 1, MOST_PIECES).astype(np.int64)
    of = np.repeat(np.arange(len(pieces)), pieces)
    number = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    ends = (1 - np.cos(np.pi * (number[:, None] + [0, 1]) / pieces[of][:, None])) / 2
    upper, lower = layers.emission[:, of, :1], layers.emission[:, of, 1:]
    emission = upper + ends * (lower - upper)
    depth = layers.depth[:, of] * (ends[:, 1] - ends[:, 0])
    return Layers(depth, layers.albedo[:, of], layers.legendre[:, :, of], emission), of


def solve(layers: Layers, bounds: Bounds, directions: int = DIRECTIONS) -> Scattered:
    """Returns the light in layers, which should be thin where they scatter (see `cut`).

    Light is scattered once more in each pass, until what that adds is nothing to speak of. Raises
    ArithmeticError if there is always something, as in deep layers that absorb nothing.
    """
    orders = 2 * directions
    if len(layers.legendre) <= orders:
        raise ValueError(f"{directions} directions need moments of order 0 to {orders}")
    peak = np.where(layers.albedo > 0, layers.legendre[orders], 0.0)
    rest = 1 - layers.albedo * peak
    moments = (layers.legendre[:orders] - peak) / (1 - peak)
    scaled = Layers(
        layers.depth * rest,
        layers.albedo * (1 - peak) / rest,
        moments,
        layers.emission / rest[..., None],
    )
    mu, weight = _hemisphere(directions)
    polynomials = mie.legendre(np.concatenate([mu, -mu]), orders)
    halved = polynomials * np.concatenate([weight, weight]) / 2
    levels = layers.depth.shape[1] + 1
    found = Scattered(
        scaled, bounds, peak, np.zeros((orders, layers.depth.shape[0], levels)), passes=0
    )
    steps = _steps(scaled, mu)
    while True:
        up, down = _both_ways(found, steps, polynomials, weight)
        new = np.tensordot(halved, np.concatenate([up, down], axis=-1), axes=(1, 2))
        change, largest = np.abs(new - found.moments).max(initial=0.0), np.abs(new).max(initial=0.0)
        found = found._replace(moments=new, passes=found.passes + 1)
        if change <= SAME * largest or not scaled.albedo.any():
            return found
        if found.passes == MOST_PASSES:
            raise ArithmeticError(f"light is still scattered after {MOST_PASSES} times")


@cache
def _hemisphere(directions: int) -> tuple[Array, Array]:
    """Returns cosines from 0 to 1, and their weights."""
    node, weight = mie.gauss(directions)
    return (node + 1) / 2, weight / 2


class _Steps(NamedTuple):
    """What is left of light across each layer in some directions, (frequency, layer, direction).

    `near` and `far` are the weights of the sources at the end where light leaves, and at the other.
    """

    passed: Array
    near: Array
    far: Array


def _steps(layers: Layers, mu: Array) -> _Steps:
    """Returns the steps across layers in directions of cosines above 0."""
    slant = layers.depth[..., None] / mu
    mean, passed = mean_transmission(slant), np.exp(-slant)
    return _Steps(passed, 1 - mean, mean - passed)


def _scattered_in(found: Scattered, polynomials: Array, some: NDArray[np.intp]) -> Array:
    """Returns the mean radiance over the cut phase function, (frequency, layer, end, direction).

    `polynomials` (order, direction) are those of the directions into which light is scattered, and
    `some` (layer,) the layers.
    """
    order = np.arange(len(found.moments)).reshape(-1, 1, 1, 1)
    ends = np.stack([found.moments[:, :, some], found.moments[:, :, some + 1]], axis=-1)
    weighted = (2 * order + 1) * found.layers.legendre[:, :, some, None] * ends
    return np.tensordot(weighted, polynomials, axes=(0, 0))


def _sources(found: Scattered, polynomials: Array) -> Array:
    """Returns what is added to light along a unit of depth, (frequency, layer, end, direction)."""
    sources = np.repeat(found.layers.emission[..., None], polynomials.shape[1], axis=-1)
    some = np.flatnonzero(found.layers.albedo.any(axis=0))
    albedo = found.layers.albedo[:, some, None, None]
    sources[:, some] += albedo * _scattered_in(found, polynomials, some)
    return sources


def _both_ways(
    found: Scattered, steps: _Steps, polynomials: Array, weight: Array
) -> tuple[Array, Array]:
    """Returns the light that goes up and down, (frequency, level, direction)."""
    sources, count = _sources(found, polynomials), len(weight)
    down = _down(found, steps, sources[..., count:])
    falling = 2 * down[:, -1] @ (weight * _hemisphere(count)[0])
    return _up(found, steps, sources[..., :count], falling), down


def _down(found: Scattered, steps: _Steps, sources: Array) -> Array:
    """Returns the light that goes down, (frequency, level, direction)."""
    added = steps.far * sources[:, :, 0] + steps.near * sources[:, :, 1]
    light = np.empty((added.shape[0], added.shape[1] + 1, added.shape[2]))
    light[:, 0] = found.bounds.above[:, None]
    for layer in range(added.shape[1]):
        light[:, layer + 1] = light[:, layer] * steps.passed[:, layer] + added[:, layer]
    return light


def _up(found: Scattered, steps: _Steps, sources: Array, falling: Array) -> Array:
    """Returns the light that goes up, (frequency, level, direction).

    `falling` (frequency,) is the flux that falls on the ground, over pi.
    """
    added = steps.near * sources[:, :, 0] + steps.far * sources[:, :, 1]
    light = np.empty((added.shape[0], added.shape[1] + 1, added.shape[2]))
    mirrored = found.bounds.reflectivity
    light[:, -1] = ((1 - mirrored) * found.bounds.below + mirrored * falling)[:, None]
    for layer in range(added.shape[1] - 1, -1, -1):
        light[:, layer] = light[:, layer + 1] * steps.passed[:, layer] + added[:, layer]
    return light


def intensity(found: Scattered, mu: Array) -> Array:
    """Returns the light in any directions at each level, (frequency, level, direction).

    It is the formal solution along each direction: between Gauss' directions it would be less
    exact to interpolate. Light of mu = 0 is what a level ray sees.
    """
    along = _off_level(mu)
    return _intensity(found, along, _sources(found, mie.legendre(along, len(found.moments))))


def _off_level(mu: Array) -> Array:
    """Returns cosines that are not 0, with their own sign."""
    mu = np.asarray(mu, dtype=np.float64)
    return np.where(np.abs(mu) < LEVEL, np.where(mu < 0, -LEVEL, LEVEL), mu)


def _intensity(found: Scattered, along: Array, sources: Array) -> Array:
    """Returns the light in some directions at each level, with the sources in these directions."""
    light = np.empty((*found.moments.shape[1:], len(along)))
    up = along > 0
    if up.any():
        steps = _steps(found.layers, along[up])
        light[..., up] = _up(found, steps, sources[..., up], _falling(found))
    if not up.all():
        light[..., ~up] = _down(found, _steps(found.layers, -along[~up]), sources[..., ~up])
    return light


def within(found: Scattered, mu: Array, layer: NDArray[np.intp], part: Array) -> Array:
    """Returns the light in given directions at places within layers, (frequency, place).

    `layer` (place,) is the layer, and `part` (place,) how much of it lies above the place. Light of
    each direction goes on from the level at which it enters the layer.
    """
    directions, back = np.unique(mu, return_inverse=True)
    along = _off_level(directions)
    sources = _sources(found, mie.legendre(along, len(found.moments)))
    light = _intensity(found, along, sources)
    up = along[back] > 0
    entry, crossed = np.where(up, layer + 1, layer), np.where(up, 1 - part, part)
    near = sources[:, layer, np.where(up, 1, 0), back]  # at the level where light enters
    far = sources[:, layer, np.where(up, 0, 1), back]
    here = near + crossed * (far - near)
    slant = found.layers.depth[:, layer] * crossed / np.abs(along[back])
    mean, passed = mean_transmission(slant), np.exp(-slant)
    entering = light[:, entry, back]
    return np.asarray(entering * passed + here * (1 - mean) + near * (mean - passed))


def _falling(found: Scattered) -> Array:
    """Returns the flux that falls on the ground over pi, (frequency,)."""
    mu, weight = _hemisphere(len(found.moments) // 2)
    sources = _sources(found, mie.legendre(-mu, len(found.moments)))
    down = _down(found, _steps(found.layers, mu), sources)
    return np.asarray(2 * down[:, -1] @ (weight * mu))


def scattered_in(found: Scattered, mu: Array) -> Array:
    """Returns the mean radiance over the phase function, (frequency, layer, end, direction).

    That is what light of directions `mu` gains by scattering, over what it loses by it: with the
    whole phase function, the peak that was cut off included. The ends are the upper and the lower.
    """
    light = intensity(found, mu)
    ends = np.stack([light[:, :-1], light[:, 1:]], axis=2)
    every = np.arange(found.peak.shape[1])
    polynomials = mie.legendre(np.asarray(mu, np.float64), len(found.moments))
    apart = _scattered_in(found, polynomials, every)
    peak = found.peak[..., None, None]
    return peak * ends + (1 - peak) * apart


def mean_transmission(depth: Array) -> Array:
    """Returns the mean of exp(-t) for t from 0 to a depth: (1 - exp(-depth)) / depth."""
    depth = np.asarray(depth, dtype=np.float64)
    lost = -np.expm1(-depth)
    return np.asarray(np.divide(lost, depth, out=np.ones_like(depth), where=depth > 0))
