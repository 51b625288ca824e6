"""What many spheres of different sizes do to light: sums over sizes, kept and interpolated.

Sizes are diameters in mm with the number of spheres per m3 that each stands for. Sums are kept in
the cache's folder under a digest of all that they depend on; where that cannot be read or written
they are made again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import mie
from thzcl.device import cache

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Permittivity = Callable[[Array, Array], Complex]  # of frequency in Hz and temperature in K

LIGHT_SPEED = 299792458.0  # m/s
SIZES = 200  # from the smallest to the largest: sums are then good to 1e-5
ORDERS = 97  # moments of the phase function: twice what 24 directions a hemisphere need, and one
FORMULA = "1"  # changes whatever was kept before
DIRECT = 12  # as many frequencies, or temperatures, are not interpolated between
NODES = 9  # of a narrow band
NODES_PER_OCTAVE = 12  # more of a wide one
NODES_OF_TEMPERATURE = 33  # between freezing drops and hot ones water changes a lot
LEAST = 1e-300  # 1/m: a coefficient of 0 has a logarithm too
_count: ContextVar[int] = ContextVar("sizes", default=SIZES)


class Sizes(NamedTuple):
    """Diameters in mm, ascending, and how many spheres per m3 each of them stands for."""

    diameter_mm: Array
    per_m3: Array

    @property
    def water_g_m3(self) -> float:
        """Returns the mass of spheres of water, g/m3."""
        return float(np.pi / 6 * 1e-3 * np.sum(self.diameter_mm**3 * self.per_m3))


class Bulk(NamedTuple):
    """What a volume of spheres does: coefficients in 1/m, `backscatter` in 1/m/sr.

    `legendre` holds the moments of the phase function along its first axis.
    """

    extinction: Array
    scattering: Array
    backscatter: Array
    legendre: Array


@contextmanager
def sizes_of(count: int) -> Iterator[None]:
    """Lets airs that are described within have `count` sizes, as studies of convergence do."""
    token = _count.set(count)
    try:
        yield
    finally:
        _count.reset(token)


def usual_count() -> int:
    """Returns how many sizes sums are over."""
    return _count.get()


def spread_sizes(
    density: Callable[[Array], Array], least_mm: float, most_mm: float, count: int | None = None
) -> Sizes:
    """Returns sizes in equal steps of the logarithm, by the trapezoidal rule.

    `density` is the number of spheres per m3 and mm of diameter. Without a `count` there are SIZES
    of them.
    """
    count = usual_count() if count is None else count
    diameter = np.geomspace(least_mm, most_mm, count)
    step = np.full(count, np.log(most_mm / least_mm) / (count - 1))
    step[[0, -1]] /= 2
    return Sizes(diameter, density(diameter) * diameter * step)


def spheres(
    frequency_hz: Any, temperature_k: Any, permittivity: Permittivity, sizes: Sizes
) -> Bulk:
    """Returns what spheres do at frequencies and at temperatures of theirs, which broadcast.

    Of a few frequencies or temperatures each is computed for itself. Of more, Chebyshev's nodes
    between the least and the largest are, and the others lie on polynomials through them: the
    logarithms of what is absorbed, scattered and scattered back. That adds 1e-5 at most, but 0.1 to
    the back-scatter of large flakes, which ripples with frequency.
    """
    hz, kelvin = np.broadcast_arrays(
        np.asarray(frequency_hz, dtype=np.float64), np.asarray(temperature_k, dtype=np.float64)
    )
    octaves = np.log2(hz.max() / hz.min())
    along_hz = _axis(hz.ravel(), NODES + int(NODES_PER_OCTAVE * octaves))
    along_kelvin = _axis(kelvin.ravel(), NODES_OF_TEMPERATURE)
    grid = np.meshgrid(along_hz.nodes, along_kelvin.nodes, indexing="ij")
    known = bulk(grid[0].ravel(), permittivity(*grid).ravel(), sizes)

    def between(values: Array) -> Array:
        on_grid = values.reshape(*values.shape[:-1], *grid[0].shape)
        at_hz = np.einsum("pf,...ft->...pt", along_hz.weights, on_grid)
        at_both = np.einsum("...pt,pt->...p", at_hz, along_kelvin.weights)
        return np.asarray(at_both.reshape((*values.shape[:-1], *hz.shape)))

    if not (along_hz.between or along_kelvin.between):
        return Bulk(*(between(values) for values in known))
    absorbed, scattered, back = (
        np.exp(between(np.log(np.maximum(values, LEAST))))
        for values in (known.extinction - known.scattering, known.scattering, known.backscatter)
    )
    return Bulk(absorbed + scattered, scattered, back, between(known.legendre))


class _Axis(NamedTuple):
    """Nodes of a quantity, and their weights (point, node) in its value at each point."""

    nodes: Array
    weights: Array
    between: bool  # whether points lie between the nodes


def _axis(points: Array, nodes: int) -> _Axis:
    """Returns the points themselves as nodes, or if they are many, nodes between their ends.

    The weights are those of the polynomial in the logarithm through Chebyshev's nodes, in
    barycentric form (Berrut and Trefethen 2004, SIAM Review 46, 501).
    """
    known, which = np.unique(points, return_inverse=True)
    if len(known) <= max(DIRECT, nodes):
        return _Axis(known, np.eye(len(known))[which], between=False)
    low, high = np.log(known[0]), np.log(known[-1])
    number = np.arange(nodes)
    at = (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * number / (nodes - 1))
    sign = (-1.0) ** number
    sign[[0, -1]] /= 2
    away = np.log(known)[:, None] - at
    near = np.abs(away) < 1e-13 * np.maximum(1.0, np.abs(at))
    share = sign / np.where(near, 1.0, away)
    share[near.any(axis=1)] = 0.0
    share[near] = 1.0
    return _Axis(np.exp(at), (share / share.sum(axis=1, keepdims=True))[which], between=True)


def bulk(frequency_hz: Array, permittivity: Complex, sizes: Sizes) -> Bulk:
    """Returns what spheres do at frequencies and permittivities (frequency,).

    What was computed once is kept on disk, if anything can be.
    """
    shape = 3 + ORDERS, len(frequency_hz)
    inputs = frequency_hz, permittivity, sizes.diameter_mm, sizes.per_m3
    entry = cache.entry("mie", [FORMULA, str(ORDERS), *(array.tobytes().hex() for array in inputs)])
    kept = cache.load(entry)
    if kept is not None and len(kept) == 8 * shape[0] * shape[1]:
        table = np.frombuffer(kept).reshape(shape)
    else:
        # One frequency after the other: each is the same to the bit alone and beside others.
        singles = (
            scattered(hz, complex(eps), sizes.diameter_mm.tobytes())
            for hz, eps in zip(frequency_hz.tolist(), permittivity, strict=True)
        )
        table = np.stack([_summed(single, sizes) for single in singles], axis=1)
        cache.keep(entry, table.tobytes())
    return Bulk(table[0], table[1], table[2], table[3:])


@lru_cache(maxsize=128)  # the laws of drop sizes that are compared have their diameters in common
def scattered(frequency_hz: float, permittivity: complex, diameters: bytes) -> mie.Spheres:
    """Returns what single spheres of some diameters in mm do, (diameter,)."""
    size = np.pi * 1e-3 / LIGHT_SPEED * frequency_hz * np.frombuffer(diameters)
    return mie.scatter(size, np.full(size.shape, np.sqrt(permittivity)), ORDERS)


def _summed(single: mie.Spheres, sizes: Sizes) -> Array:
    """Returns the sums over sizes: three coefficients and the moments, (quantity,)."""
    section = np.pi / 4 * 1e-6 * sizes.diameter_mm**2 * sizes.per_m3  # m2 per m3
    extinction, scattering = single.extinction @ section, single.scattering @ section
    backscatter = single.backscatter @ section / (4 * np.pi)
    moments = single.legendre @ (single.scattering * section)
    if scattering > 0:
        moments = moments / scattering
    return np.array([extinction, scattering, backscatter, *moments])
