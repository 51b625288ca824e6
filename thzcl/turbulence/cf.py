"""Cubes in NetCDF-4 files: how a variable of three dimensions lies in the world.

Axes are known by the names, attributes and coordinates of their dimensions (CF conventions 1.11,
chapters 4 and 5). What is not understood is refused, never guessed.
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
_TIME = re.compile(r"(time|t)\d*(_.*)?")
_STANDARD = {"projection_x_coordinate": "x", "projection_y_coordinate": "y"}
_STANDARD |= dict.fromkeys(("height", "altitude", "height_above_mean_sea_level"), "z")
_NAMELESS = re.compile(r"((phony_)?dim_?\d+)?")  # what libraries call a dimension without a name
_BARE_DIMENSION = "This is a netCDF dimension but not a netCDF variable"


class Axis(NamedTuple):
    """The coordinate of an axis: the middles of its cells in m, which ascend or descend.

    `step_m` is the distance between neighbours, or None where it is uneven.
    """

    centres_m: Array
    step_m: float | None

    @property
    def falls(self) -> bool:
        """Returns whether the coordinate descends."""
        return bool(self.centres_m[0] > self.centres_m[-1])

    def upwards(self) -> Axis:
        """Returns the coordinate so that it ascends."""
        return Axis(self.centres_m[::-1], self.step_m) if self.falls else self


class Volume(NamedTuple):
    """The values of a variable in its quantity's unit, (z, y, x), each axis ascending.

    `axes` are the coordinates of z, y and x; None where there is none in metres.
    """

    values: Array
    axes: tuple[Axis | None, Axis | None, Axis | None]
    notes: tuple[str, ...]


def read(
    place: str, variable: h5py.Dataset, quantity: Quantity, time_index: int | None = None
) -> Volume:
    """Returns a variable of three dimensions, upright and in its quantity's unit.

    `time_index` chooses one of the times of a variable that has them. Raises FileError for units
    and dimensions that are not known, and for values that are missing or outside of the quantity's
    limits.
    """
    place = f"{place}: {quantity.name}"
    time = _time(place, variable, time_index)
    some = tuple(time[1] if axis == time[0] else slice(None) for axis in range(variable.ndim))
    values, notes = values_of(place, variable, quantity, some)
    spatial = [axis for axis in range(variable.ndim) if axis != time[0]]
    order, more = _order(place, variable, spatial)
    found = [_axis(place, variable, spatial[axis]) for axis in order]
    ahead = tuple(slice(None, None, -1 if falls else 1) for _, falls in found)
    z, y, x = (None if axis is None else axis.upwards() for axis, _ in found)
    return Volume(values.transpose(order)[ahead], (z, y, x), notes + more)


def sizes(variable: h5py.Dataset) -> tuple[int, ...]:
    """Returns the lengths of the axes of a variable that are not time."""
    times = [_is_time(*dimension(variable, axis)) for axis in range(variable.ndim)]
    some = variable.ndim > len(AXES)
    return tuple(n for n, time in zip(variable.shape, times, strict=True) if not (time and some))


def _is_time(name: str, scale: h5py.Dataset | None) -> bool:
    """Returns whether a dimension is one of time."""
    if _TIME.fullmatch(name.lower()):
        return True
    return scale is not None and (text(scale, "axis") == "T" or " since " in text(scale, "units"))


def _time(place: str, variable: h5py.Dataset, index: int | None) -> tuple[int | None, int]:
    """Returns the axis of time, or None, and the index along it. Raises FileError."""
    if variable.ndim != len(AXES) + 1:
        if index is not None:
            raise FileError(f"{place}: has no times to choose from; remove time_index")
        return None, 0
    axes = [axis for axis in range(variable.ndim) if _is_time(*dimension(variable, axis))]
    if len(axes) != 1:
        names = ", ".join(dimension(variable, axis)[0] or "?" for axis in range(variable.ndim))
        raise FileError(f"{place}: its dimensions are ({names}); keep three, or time and three")
    count = variable.shape[axes[0]]
    if index is None and count != 1:
        raise FileError(
            f"{place}: has {count} times; choose one of 0 to {count - 1} with time_index in "
            "[atmosphere.fluctuations]"
        )
    if index is not None and index >= count:
        raise FileError(f"{place}: has {count} times, and no time_index = {index}; lower it")
    return axes[0], index or 0


def _letter(variable: h5py.Dataset, axis: int) -> str:
    """Returns which of x, y and z an axis is, by its coordinate's attributes or its name."""
    name, scale = dimension(variable, axis)
    if scale is not None:
        told = text(scale, "axis").lower()
        told = told if told in AXES else _STANDARD.get(text(scale, "standard_name"), "")
        if told:
            return told
    match = _AXIS.fullmatch(name.lower())
    return match[1] if match else ""


def _order(
    place: str, variable: h5py.Dataset, spatial: list[int]
) -> tuple[list[int], tuple[str, ...]]:
    """Returns where z, y and x are among some axes, and a note where they have no names."""
    names = [dimension(variable, axis)[0] for axis in spatial]
    letters = [_letter(variable, axis) for axis in spatial]
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


def _axis(place: str, variable: h5py.Dataset, number: int) -> tuple[Axis | None, bool]:
    """Returns the coordinate of an axis, if it is in metres, and whether it falls along the axis.

    It is made to count upwards. Raises FileError for one that neither ascends nor descends, and
    for one that is no length.
    """
    name, scale = dimension(variable, number)
    if scale is None or text(scale, "NAME").startswith(_BARE_DIMENSION):
        return None, False
    if scale.shape != (variable.shape[number],) or scale.dtype.kind not in "fiu":
        raise FileError(f"{place}: its coordinate {name} is not a row of numbers; mend or drop it")
    unit = text(scale, "units")
    metre = UNITS["m"].get(plain(unit))
    if metre is None and unit not in ("", "1"):
        raise FileError(f'{place}: its coordinate {name} is in "{unit}"; give it in m')
    stored = np.asarray(scale[...])
    along = stored.astype(np.float64) * (-1 if text(scale, "positive") == "down" else 1)
    steps = np.diff(along)
    one_way = np.isfinite(along).all() and ((steps > 0).all() or (steps < 0).all())
    mean = abs(float(steps.mean())) if len(steps) else 0.0
    rounding = np.abs(np.spacing(stored)).max() if stored.dtype.kind == "f" else 0.0
    even = bool((abs(abs(steps) - mean) <= UNEVEN * mean + rounding).all())
    if not one_way or not (even or metre):
        remedy = "give it in m" if one_way else "let it ascend, or descend, throughout"
        raise FileError(
            f"{place}: its coordinate {name} has steps of {steps.min():g} to {steps.max():g}; "
            + remedy
        )
    falls = bool((steps < 0).any())
    if metre is None:
        return None, falls
    return Axis(along * metre[0], mean * metre[0] if mean and even else None), falls
