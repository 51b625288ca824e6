"""Exposures: rays that are taken together, and what each of them weighs in the pixels.

A pixel sees a weighted sum over the rays of one or more exposures. Several are needed where a
scanning beam moves on while an image is taken, and where thin things and edges must be sampled more
finely than the air is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.graph import Values, frozen
from thzcl.sensing import optics
from thzcl.sensing.optics import Pair
from thzcl.sensor import Optics
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.geometry import Geometry

Array = NDArray[np.float64]
PRIMES = (2, 3, 5, 7, 11, 17, 23, 31, 41, 53, 71, 89)


@frozen
class Beam:
    """What the rays of a raster weigh in a pixel, as optics and pixel spread it, times `scale`.

    Of a beam that moves on while a pixel is taken, one `line` (axis and number) can stand alone, or
    `part` (width,) of its width on the other axis: 1 where rays belong to it, 0 elsewhere.
    """

    optics: Optics | None
    pixel_rad: Pair
    plane_hz: Values  # (plane,)
    raster: Raster
    scale: float = 1.0
    shift: Pair = (0.0, 0.0)  # how far down and right of their places the rays lie, in rays
    line: tuple[int, int] | None = None
    part: Values | None = None
    two_way: bool = False  # whether the beam lights what it receives

    def weights(self) -> Array:
        """Returns the weights, (plane or 1, row, column)."""
        hz = self.plane_hz.array
        whole = optics.kernels(
            self.optics, self.raster, self.pixel_rad, hz, self.shift, two_way=self.two_way
        )
        weights = self.scale * whole
        if self.line is None or self.part is None:
            return weights
        axis, number = self.line
        part = self.part.array[None, None, :] if axis == 0 else self.part.array[None, :, None]
        return np.asarray((weights * part).take([number], axis + 1))

    def own(self) -> Beam:
        """Returns what the rays weigh that lie in the pixel, where nothing is blurred."""
        return replace(self, optics=None, two_way=False)


class Exposure(NamedTuple):
    """Rays that are taken together.

    `times_s` (row, column) is when each is taken, or None where that makes no difference; `beam`
    weighs radiance, `own` what no optics blur.
    """

    geometry: Geometry
    times_s: Values | None
    beam: Beam
    own: Beam


class Blur(NamedTuple):
    """What spreads a pixel over rays: optics, or none, at the frequency of each plane."""

    optics: Optics | None
    pixel_rad: Pair
    plane_hz: Values
    two_way: bool = False

    def beam(self, rays: Raster) -> Beam:
        """Returns what the rays of a raster weigh in a pixel."""
        return Beam(self.optics, self.pixel_rad, self.plane_hz, rays, two_way=self.two_way)


def still(blur: Blur, shape: Geometry) -> list[Exposure]:
    """Returns the one exposure of a camera that takes all pixels at once."""
    beam = blur.beam(shape.raster)
    return [Exposure(shape, None, beam, beam.own())]


def timed(blur: Blur, shape: Geometry, times_s: Array, groups: int) -> list[Exposure]:
    """Returns the exposures of pixels that are taken at `times_s` (sample, y, x).

    Samples are averaged. Where a beam is wider than its pixel, each line of it along the scan's
    slow axis is an exposure of its own, in which each ray is taken in the line of the pixel that
    receives it. Along the fast axis the beam's width is cut into `groups`, in which a ray is taken
    when the pixels are that it serves; what is left is the air's drift within a group.
    """
    beam, found = replace(blur.beam(shape.raster), scale=1 / len(times_s)), []
    for sample in np.broadcast_to(times_s, (len(times_s), *shape.raster.pixels)):
        if shape.raster.margin == 0 or np.ptp(sample) == 0:
            times = sample.repeat(shape.raster.block[0], 0).repeat(shape.raster.block[1], 1)
            times = np.pad(times, shape.raster.margin, mode="edge")
            found.append(Exposure(shape, Values.of(times), beam, beam.own()))
        else:
            found += _scanned(shape, sample, beam, groups)
    return found


def slow_axis(sample: Array) -> int:
    """Returns the axis, 0 or 1, along which the times (y, x) of a scan change most."""
    return int(np.ptp(sample, axis=0).max() < np.ptp(sample, axis=1).max())


def _scanned(shape: Geometry, sample: Array, beam: Beam, groups: int) -> Iterator[Exposure]:
    """Yields an exposure for each line of the beam along the slow axis, and each group across."""
    slow, rays = slow_axis(sample), shape.raster
    weights = profile(beam, slow)
    lines = 2 * rays.margin + rays.block[slow]
    for inside in _groups(weights, groups):
        times = Values.of(_fast_times(sample, weights * inside, rays, 1 - slow))
        part = Values.of(inside)
        for line in range(lines):
            one = replace(beam, line=(slow, line), part=part)
            yield Exposure(_lines(shape, slow, line), times, one, one.own())


def _fast_times(sample: Array, weights: Array, rays: Raster, fast: int) -> Array:
    """Returns when rays are taken, in pixels' lines along the slow axis and rays along the fast.

    A ray has the time of the pixels that it serves with part of a beam's width, `weights` (width,):
    their mean, as they weigh it.
    """
    block, size = rays.block[fast], (rays.rows, rays.columns)[fast]
    ray, places = np.arange(size), np.arange(len(weights))
    served = np.empty(size)
    for rest in range(block):  # the beam's rays are a whole number of pixels away
        mine = weights[rest::block]
        middle = float(mine @ places[rest::block] / mine.sum()) if mine.any() else 0.0
        served[rest::block] = (ray[rest::block] - middle) / block
    served = np.clip(served, 0, rays.pixels[fast] - 1)
    before = np.floor(served).astype(int)
    after = np.minimum(before + 1, rays.pixels[fast] - 1)
    share = np.expand_dims(served - before, 1 - fast)
    return np.asarray((1 - share) * sample.take(before, fast) + share * sample.take(after, fast))


def profile(beam: Beam, slow: int) -> Array:
    """Returns a beam's weights summed along the slow axis, (width,), of sum 1."""
    weights = np.abs(beam.weights()).mean(axis=0).sum(axis=slow)
    return np.asarray(weights / weights.sum())


def fast_axis_error(weights: Array, groups: int, lost: Sequence[float]) -> float:
    """Returns the error of a beam cut into `groups` along the scan's fast axis.

    `weights` (width,) is the beam's profile; `lost[n]` the error of a ray taken when the pixel n
    rays away is.
    """
    error, places = 0.0, np.arange(len(weights))
    for inside in _groups(weights, groups):
        middle = np.average(places[inside], weights=weights[inside])
        apart = np.minimum(np.abs(places - middle), len(lost) - 1)
        error += float(weights[inside] @ np.interp(apart[inside], np.arange(len(lost)), lost))
    return error


def _groups(weights: Array, number: int) -> Iterator[NDArray[np.bool_]]:
    """Yields parts of a beam's width, as which rays lie in each, (width,).

    Their own widths are as the power -1/3 of the weights there, which leaves the least spread for a
    number of groups (Panter and Dite 1951).
    """
    share = np.cumsum(np.cbrt(weights))
    share = (share - np.cbrt(weights) / 2) / share[-1]
    of_ray = np.minimum((share * number).astype(int), number - 1)
    for group in range(number):
        inside = of_ray == group
        if weights[inside].any():
            yield inside


def _lines(shape: Geometry, axis: int, line: int) -> Geometry:
    """Returns the rays that lie in one row (axis 0) or column (1) of the beams of all pixels."""
    rays, frame = shape.raster, shape.frame.array.copy()  # position, forward, right, up
    size, block = [rays.rows, rays.columns], list(rays.block)
    count, step, side = rays.pixels[axis], block[axis], (3, 2)[axis]
    shift = 0.5 * size[axis] - line - 0.5 - step * (0.5 * count - 0.5)
    frame[1] += (shift if axis == 0 else -shift) * frame[side]
    frame[side] *= step
    size[axis], block[axis] = count, 1
    raster = Raster(size[0], size[1], (block[0], block[1]))
    return replace(shape, raster=raster, frame=Values.of(frame))


def lattice(blur: Blur, shape: Geometry, cell: int, number: int, turn: int = 0) -> list[Exposure]:
    """Returns exposures that sample the surfaces finely.

    There are `number` lattice points, one of PRIMES, to each cell of `cell` rays each way. `turn` 1
    gives another lattice, as fine. Each point is an exposure of a raster with one ray to a cell.
    """
    coarse = _cells(shape, cell)
    beam = replace(blur.beam(coarse.raster), scale=1 / number)
    across = generator(number) if turn == 0 else number - generator(number)
    found = []
    for point in range(number):
        # The other lattice's lines lie between those of the first, whatever their direction.
        down = ((point + 0.5 + 0.25 * turn) / number) % 1 - 0.5
        right = ((point * across + 0.5 + 0.5 * turn) / number) % 1 - 0.5
        frame = coarse.frame.array.copy()
        frame[1] += right * frame[2] - down * frame[3]
        moved = replace(coarse, frame=Values.of(frame))
        there = replace(beam, shift=(down, right))
        found.append(Exposure(moved, None, there, replace(beam.own(), scale=0.0)))
    return found


def _cells(shape: Geometry, cell: int) -> Geometry:
    """Returns a raster with one ray in the middle of every `cell` rays each way."""
    rays, frame = shape.raster, shape.frame.array.copy()
    block = rays.block[0] // cell, rays.block[1] // cell
    margin = -(-rays.margin // cell)
    rows, columns = (n * b + 2 * margin for n, b in zip(rays.pixels, block, strict=True))
    frame[2:] *= cell
    return replace(shape, raster=Raster(rows, columns, block, margin), frame=Values.of(frame))


@cache
def generator(number: int) -> int:
    """Returns g of the lattice points (i, i g) / number, number prime, that lie most evenly.

    That is the longest shortest vector (a, b) of those with a + b g = 0 modulo `number`: lattice
    points lie on lines no farther apart than its inverse (Niederreiter 1992, the spectral test).
    """
    steps = np.arange(-number, number + 1)
    a, b = (grid.ravel() for grid in np.meshgrid(steps, steps))
    length = np.hypot(a, b)

    def shortest(g: int) -> float:
        dual = ((a + b * g) % number == 0) & (length > 0)
        return float(length[dual].min())

    return max(range(1, max(number // 2, 2)), key=shortest)
