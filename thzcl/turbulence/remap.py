"""From the cells of a user's cube to the voxels that rays cross, along one axis after another.

Rays cross even voxels, a power of two of them along a period. Cells that are uneven, or that are
another number in a period, are remapped conservatively: each voxel takes the mean of the cells that
it overlaps, so that the integral along every line of cells stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MOST = 512  # even voxels into which the smallest cells may cut an axis


@dataclass(frozen=True)
class Cut:
    """One axis of cells, whose `faces_m` (cells + 1,) ascend, as it is cut into even voxels.

    There are `count` voxels along its whole length. They are the cells themselves if `same`.
    """

    faces_m: tuple[float, ...]
    count: int
    same: bool
    periodic: bool
    voxel_m: float

    @property
    def size(self) -> int:
        """Returns the power of two of voxels along the axis, padding included."""
        return 1 << (self.count - 1).bit_length()

    def cells(self, values: NDArray[Any], axis: int) -> NDArray[Any]:
        """Returns values as means over voxels, in the place of cells along an axis of theirs."""
        if self.same:
            return values
        old = np.array(self.faces_m)
        new = np.linspace(old[0], old[-1], self.count + 1)
        rows = np.moveaxis(values, axis, 0).astype(np.float64)
        shape = (len(old) - 1,) + (1,) * (rows.ndim - 1)
        sums = np.concatenate([0 * rows[:1], np.cumsum(rows * np.diff(old).reshape(shape), axis=0)])
        cell = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 2)
        inside = ((new - old[cell]) / np.diff(old)[cell]).reshape(-1, *shape[1:])
        at = sums[cell] + inside * (sums[cell + 1] - sums[cell])
        means = np.diff(at, axis=0) / (new[1] - new[0])
        low, high = rows.min(), rows.max()  # a mean lies between, but for rounding
        return np.moveaxis(np.clip(means, low, high), 0, axis)


def even(first_m: float, step_m: float, count: int, *, periodic: bool) -> Cut:
    """Returns an axis of even cells, the first of which has its middle at `first_m`."""
    corner = first_m - step_m / 2
    power = 1 << (count - 1).bit_length()
    if not periodic or power == count:
        faces = corner, corner + count * step_m
        return Cut(faces, count, True, periodic, step_m)
    faces = tuple((corner + np.arange(count + 1) * step_m).tolist())
    return Cut(faces, power, False, periodic, count * step_m / power)


def uneven(centres_m: Array, *, periodic: bool) -> Cut:
    """Returns an axis of cells whose faces lie midway between their middles.

    Its voxels are as small as the smallest cell, if that makes at most 512 of them.
    """
    between = (centres_m[1:] + centres_m[:-1]) / 2
    ends = 2 * centres_m[0] - between[0], 2 * centres_m[-1] - between[-1]
    faces = np.array([ends[0], *between, ends[1]])
    length = float(faces[-1] - faces[0])
    wanted = math.ceil(length / float(np.diff(faces).min()) * (1 - 1e-9))
    count = min(wanted, max(MOST, len(centres_m)))
    if periodic:
        count = 1 << (count - 1).bit_length()
    return Cut(tuple(faces.tolist()), count, False, periodic, length / count)
