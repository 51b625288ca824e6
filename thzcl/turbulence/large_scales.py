"""Eddies larger than the cube, as plane waves whose mean along a ray has a closed form.

The cube has no wave below its lowest wave number, 1 over its period. What a spectrum holds there is
added as subharmonics (Lane, Glindemann and Dainty 1992, "Simulation of a Kolmogorov phase screen",
Waves in Random Media 2, 209): the cell around the wave vector 0 is divided into 3 x 3 x 3 cells,
the one in the middle again, and so on. Each cell is one wave, of the variance that the spectrum has
over the whole cell. (With the spectrum in its middle instead, the path mean would lack some 2 %.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVELS = 4
NODES = 8  # along each edge of a cell, in which the spectrum is averaged: good to 1e-6
STREAM = 0x6C61726765  # the waves' own random numbers: the cube's are the same with and without
AT_ONCE = 1 << 21  # rays times waves that are summed at once
DIRECTIONS, RADII = 200, 12  # points at which the waves' range is looked for
MARGIN = 1.1  # of that range, since it lies between the points too
KOLMOGOROV_EXPONENT = -11 / 6


@dataclass(frozen=True)
class Spread:
    """The waves before any random number: wave vectors in cycles/m along the cube's axes.

    `vector` is (wave, 3) and `variance` (wave,), that of each wave for C^2 = 1 over Kolmogorov's
    constant.
    """

    vector: Array
    variance: Array


@lru_cache(maxsize=16)
def spread(period_m: float, outer_scale_m: float | None) -> Spread:
    """Returns the 104 waves below the lowest wave of a cube with a period."""
    node, weight = np.polynomial.legendre.leggauss(NODES)
    offsets = np.stack(np.meshgrid(node, node, node, indexing="ij"), axis=-1).reshape(-1, 3) / 2
    weights = np.einsum("i,j,k->ijk", weight, weight, weight).ravel() / 8
    least = 0.0 if outer_scale_m is None else 1 / outer_scale_m**2
    cells = np.array([cell for cell in product((-1, 0, 1), repeat=3) if any(cell)], dtype=float)
    vectors, variances = [], []
    for level in range(1, LEVELS + 1):
        step = 1 / period_m / 3**level
        square = ((cells[:, None] + offsets) ** 2).sum(axis=-1) * step**2 + least
        vectors.append(cells * step)
        variances.append(square**KOLMOGOROV_EXPONENT @ weights * step**3)
    return Spread(np.concatenate(vectors), np.concatenate(variances))


@dataclass(frozen=True)
class Waves:
    """Plane waves: the sum of size * cos(2 pi (vector . place + phase)), less `taken_off`.

    `vector` (wave, 3) is in cycles per metre along the cube's axes; `size` and `phase`, in cycles,
    are (wave,). The sum is a departure of humidity from its mean, over the mean.
    """

    vector: Array
    size: Array
    phase: Array
    taken_off: float = 0.0

    def less(self, place: Array) -> Waves:
        """Returns the waves less their value at a place (3,), at which they are 0 then."""
        value = float(self.at(place[None]).item())
        return replace(self, taken_off=self.taken_off + value)

    def at(self, place: Array) -> Array:
        """Returns the sum at places (point, 3), in m along the cube's axes, (point,)."""
        return self.mean(place, np.zeros_like(place))

    def mean(self, start: Array, way: Array) -> Array:
        """Returns the means of the sum along straight lines, (ray,), exactly.

        They go from `start` by `way`, both (ray, 3) in m along the cube's axes.
        """
        found = np.empty(len(way))
        start = np.broadcast_to(start, way.shape)
        rows = max(1, AT_ONCE // len(self.size))
        for first in range(0, len(way), rows):
            some = slice(first, first + rows)
            along = way[some] @ self.vector.T
            phase = start[some] @ self.vector.T + along / 2 + self.phase
            found[some] = (np.sinc(along) * np.cos(2 * np.pi * phase)) @ self.size
        return found - self.taken_off

    def span(self, place: Array, reach_m: float) -> tuple[float, float]:
        """Returns about the smallest and the largest sum within `reach_m` of a place (3,)."""
        if not len(self.size):
            return 0.0, 0.0
        number = np.arange(DIRECTIONS) + 0.5
        z, angle = 1 - 2 * number / DIRECTIONS, np.pi * (1 + 5**0.5) * number
        level = np.sqrt(1 - z * z)
        around = np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=-1)
        radii = reach_m * np.linspace(0, 1, RADII)
        values = self.at((place + radii[:, None, None] * around).reshape(-1, 3))
        low, high = float(values.min()), float(values.max())
        more = (MARGIN - 1) * (high - low)
        return low - more, high + more


def drawn(period_m: float, outer_scale_m: float | None, variance: float, seed: int) -> Waves:
    """Returns a realisation of the waves; `variance` multiplies that of `spread`.

    Each wave is drawn as the cube's are: cosine and sine with normal numbers of the wave's own
    variance, of which the real part is taken.
    """
    waves = spread(period_m, outer_scale_m)
    rng = np.random.Generator(np.random.Philox(key=[seed, STREAM]))
    real, imaginary = rng.standard_normal((2, len(waves.variance)))
    sizes = np.sqrt(variance * waves.variance)
    # Waves of opposite vectors differ by the sign of their sine alone, and are added up.
    numbers = [n for n, vector in enumerate(waves.vector) if tuple(vector) > (0.0, 0.0, 0.0)]
    sums = []
    for number in numbers:
        other = int(np.flatnonzero((waves.vector == -waves.vector[number]).all(axis=1))[0])
        one = sizes[number] * complex(real[number], imaginary[number])
        sums.append(one + sizes[other] * complex(real[other], -imaginary[other]))
    amplitude = np.array(sums)
    phase = np.angle(amplitude) / (2 * np.pi)
    return Waves(waves.vector[numbers], np.abs(amplitude), phase)
