"""Files that constituents ask for: a variable of a NetCDF-4 file over axes with names and units.

Units, packing, missing values and the order of dimensions are as the CF conventions have them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air import cf, units
from thzcl.constituent import File, Grid
from thzcl.errors import FileError

if TYPE_CHECKING:
    import h5py

Array = NDArray[np.float64]
MOST_VALUES = 64_000_000


@lru_cache(maxsize=8)  # by path and digest: planned and run, the same file is read once
def read(file: File, holds: Grid) -> File:
    """Returns a file with the arrays and attributes that a constituent asks for.

    Raises FileError for a file that cannot be read, does not hold them, or has changed since its
    digest was taken.
    """
    path = file.path
    if path is None:
        raise FileError(f"{file.name}: nothing says in which folder it lies")
    place = f"{path}: {holds.variable}"
    if files.digest(path, files.GRID) != file.digest:
        raise FileError(f"{path}: has changed since the run was planned; run it again")
    with files.open_netcdf(path, files.GRID) as opened:
        variable = cf.dataset(str(path), opened, holds.variable)
        if variable is None:
            over = ", ".join(name for name, _ in holds.axes)
            raise FileError(f"{path}: has no variable {holds.variable}({over}); rename yours")
        order = _order(place, variable, holds)
        if not cf.text(variable, "units"):
            raise FileError(f'{place} has no units; give it units = "{holds.unit}"')
        limits = holds.least, holds.most
        values = cf.values_of(place, variable, _quantity(holds.variable, holds.unit, limits))[0]
        arrays = {holds.variable: values.astype(np.float64).transpose(order)}
        for (name, unit), count in zip(holds.axes, arrays[holds.variable].shape, strict=True):
            arrays[name] = _axis(str(path), opened, name, unit, count)
        attributes = {name: _attribute(place, opened, variable, name) for name in holds.attributes}
    for array in arrays.values():
        array.flags.writeable = False
    return replace(file, arrays=arrays, attributes=attributes)


def _order(place: str, variable: h5py.Dataset, holds: Grid) -> list[int]:
    """Returns which dimension of the file each axis is."""
    names = [cf.dimension(variable, axis)[0] for axis in range(len(variable.shape))]
    wanted = [name for name, _ in holds.axes]
    if sorted(names) != sorted(wanted):
        raise FileError(
            f"{place}: its dimensions are ({', '.join(name or '?' for name in names)}); "
            f"it must be {holds.variable}({', '.join(wanted)}), each with its coordinate"
        )
    if not 0 < variable.size <= MOST_VALUES:
        raise FileError(f"{place}: {variable.size} values; give 1 to {MOST_VALUES}")
    return [names.index(name) for name in wanted]


def _axis(path: str, opened: h5py.File, name: str, unit: str, count: int) -> Array:
    """Returns a dimension's coordinate, ascending."""
    place = f"{path}: {name}"
    found = cf.dataset(path, opened, name)
    if found is None or found.shape != (count,):
        raise FileError(f"{place}: has no coordinate of {count} values; give it one in {unit}")
    # The name says the unit, so that an attribute may be left out.
    values = cf.values_of(place, found, _quantity(name, unit, (-np.inf, np.inf)))[0]
    along = values.astype(np.float64)
    if not (np.diff(along) > 0).all():
        raise FileError(f"{place}: does not ascend; sort it, and give each value once")
    return along


def _attribute(place: str, opened: h5py.File, variable: h5py.Dataset, name: str) -> float:
    """Returns a number that the variable, or else the file, carries as an attribute."""
    found = cf.number(place, variable, name)
    if found is None:
        found = cf.number(place, opened, name)
    if found is None:
        raise FileError(f"{place}: has no attribute {name}; give it that number")
    return found


def _quantity(name: str, unit: str, limits: tuple[float, float]) -> cf.Quantity:
    if unit not in units.UNITS:  # a third party's own
        return cf.Quantity(name, unit, {unit: (1.0, 0.0)}, unit, *limits)
    return cf.Quantity(name, unit, units.UNITS[unit], units.listed(units.UNITS[unit]), *limits)
