"""Cubes in NetCDF-4 files: how a variable of three dimensions lies in the world.

Axes are known by the names and coordinates of their dimensions (CF conventions 1.11, chapters 4
and 5). What is not understood is refused, never guessed.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from thzcl.air.cf import Array, Quantity, dimension, text, values_of
from thzcl.air.units import UNITS, plain
from thzcl.errors import FileError

if TYPE_CHECKING:
    import h5py

AXES = "zyx"  # the order in which cubes are returned
UNEVEN = 0.01  # of a step, by which steps of a coordinate may differ
_AXIS = re.compile(r"([xyz])[a-z]?\d*(_.*)?")  # x, xt, x_voxel, zu_3d
_NAMELESS = re.compile(r"((phony_)?dim_?\d+)?")  # what libraries call a dimension without a name
_BARE_DIMENSION = "This is a netCDF dimension but not a netCDF variable"


class Volume(NamedTuple):
    """The values of a variable in its quantity's unit, (z, y, x), each axis ascending.

    `steps_m` are the steps along z, y, x, of those axes whose coordinates are in metres.
    """

    values: Array
    steps_m: tuple[float, ...]
    notes: tuple[str, ...]


def read(place: str, variable: h5py.Dataset, quantity: Quantity) -> Volume:
    """Returns a variable of three dimensions, upright and in its quantity's unit.

    Raises FileError for units and dimensions that are not known, and for values that are missing
    or outside of the quantity's limits.
    """
    place = f"{place}: {quantity.name}"
    values, notes = values_of(place, variable, quantity)
    order, more = _order(place, variable)
    steps = [_step(place, variable, axis) for axis in order]
    ahead = tuple(slice(None, None, -1 if step < 0 else 1) for step, _ in steps)
    metres = tuple(abs(step) * metre for step, metre in steps if metre is not None)
    return Volume(values.transpose(order)[ahead], metres, notes + more)


def _order(place: str, variable: h5py.Dataset) -> tuple[list[int], tuple[str, ...]]:
    """Returns the axes in the file of z, y and x, and a note where they have no names."""
    names = [dimension(variable, axis)[0] for axis in range(len(AXES))]
    told = [_AXIS.fullmatch(name.lower()) for name in names]
    letters = [match[1] if match else "" for match in told]
    if sorted(letters) == sorted(AXES):
        return [letters.index(letter) for letter in AXES], ()
    if all(_NAMELESS.fullmatch(name) for name in names):
        return list(range(len(AXES))), (
            f"{place} names no dimensions and was taken to be (z, y, x); name them z, y, x",
        )
    raise FileError(
        f"{place}: its dimensions are ({', '.join(name or '?' for name in names)}); "
        "interpolate to even steps in metres if need be, and name them z, y, x"
    )


def _step(place: str, variable: h5py.Dataset, axis: int) -> tuple[float, float | None]:
    """Returns the step of an axis' coordinate, and its unit in metres if that is one of length.

    A step is negative where the coordinate descends, or counts downwards; it is 1 without a
    coordinate. Raises FileError where steps differ.
    """
    name, scale = dimension(variable, axis)
    if scale is None or text(scale, "NAME").startswith(_BARE_DIMENSION):
        return 1.0, None
    if scale.shape != (variable.shape[axis],) or scale.dtype.kind not in "fiu":
        raise FileError(f"{place}: its coordinate {name} is not a row of numbers; mend or drop it")
    unit = text(scale, "units")
    metre = UNITS["m"].get(plain(unit))
    if metre is None and unit not in ("", "1"):
        raise FileError(f'{place}: its coordinate {name} is in "{unit}"; give it in m')
    along = np.asarray(scale[...])
    steps = np.diff(along.astype(np.float64))
    mean = float(steps.mean())
    rounding = np.abs(np.spacing(along)).max() if along.dtype.kind == "f" else 0.0
    if not (np.abs(steps - mean) <= UNEVEN * abs(mean) + rounding).all() or mean == 0:
        raise FileError(
            f"{place}: its coordinate {name} has steps of {steps.min():g} to {steps.max():g}; "
            "interpolate to even steps"
        )
    return (-mean if text(scale, "positive") == "down" else mean), metre and metre[0]
