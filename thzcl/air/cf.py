"""Variables of NetCDF-4 files, as the CF conventions (1.11) say how to read them.

Units (section 3.1), packing (8.1), missing values (2.5.1), and names of dimensions (chapters 4 and
5). What is not understood is refused, never guessed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.units import plain
from thzcl.errors import FileError

if TYPE_CHECKING:
    import h5py

Array = NDArray[Any]

UNWRITTEN = 9.969209968386869e36  # what the NetCDF library fills numbers with a fraction with


@dataclass(frozen=True)
class Quantity:
    """What a variable is to hold: its name, its unit, other units' worth in it, and its limits.

    `units` gives factor and offset to `unit` by name, as thzcl.air.units has it; `known` is what
    messages call them.
    """

    name: str
    unit: str
    units: Mapping[str, tuple[float, float]]
    known: str
    least: float
    most: float


def dataset(place: str, file: h5py.File, name: str) -> h5py.Dataset | None:
    """Returns the variable of that name, or None if there is none.

    Raises FileError for one that holds no numbers, or keeps them in another file.
    """
    import h5py

    if name not in list(file):
        return None
    found = file[name]
    if found.file != file:
        raise FileError(f"{place}: {name} is a link to another file; copy the values in")
    if not isinstance(found, h5py.Dataset) or found.shape is None or found.dtype.kind not in "fiu":
        raise FileError(f"{place}: {name} holds no numbers; store it as an array of numbers")
    if found.is_virtual or found.external:
        raise FileError(f"{place}: {name} has its values in other files; copy them in")
    return found


def number(place: str, variable: h5py.Dataset, name: str) -> float | None:
    """Returns the number that an attribute holds, or None if it is absent. Raises FileError."""
    found = numbers(place, variable, name)
    if found is None:
        return None
    if found.size != 1 or not np.isfinite(found).all():
        raise FileError(f"{place}: its attribute {name} is {found.tolist()}; give one number")
    return float(found[0])


def numbers(place: str, variable: h5py.Dataset | h5py.File, name: str) -> Array | None:
    """Returns the numbers of an attribute, (n,), or None if it is absent. Raises FileError."""
    if name not in variable.attrs:
        return None
    found = np.asarray(variable.attrs[name]).reshape(-1)
    if found.dtype.kind not in "fiu" or not found.size:
        raise FileError(f"{place}: its attribute {name} is not a number; give it as one")
    return found


def text(holder: h5py.Dataset, name: str) -> str:
    """Returns the text of an attribute, empty if it is absent."""
    import h5py

    found = holder.attrs.get(name, "")
    if isinstance(found, np.ndarray) and found.size == 1:
        found = found.reshape(-1)[0]
    if isinstance(found, bytes):
        return found.decode("utf-8", "replace").strip()
    return "" if isinstance(found, h5py.Empty) else str(found).strip()


def values_of(
    place: str, variable: h5py.Dataset, quantity: Quantity, some: Any = ...
) -> tuple[Array, tuple[str, ...]]:
    """Returns unpacked values in the quantity's unit, as they lie in the file, and notes.

    `some` is the index of the part that is read; it is all if left out.

    Raises FileError for units that are not known, and for values that are missing or outside of
    the quantity's limits.
    """
    factor, offset, notes = _unit(place, variable, quantity)
    scale = number(place, variable, "scale_factor")
    shift = number(place, variable, "add_offset")
    values = np.asarray(variable[some])
    missing = _missing(place, variable, values)
    if missing.any():
        raise FileError(
            f"{place}: {_count(missing)} missing (not finite, fill, or out of the valid range); "
            "fill the gaps, or cut out a part without any"
        )
    if scale is not None or shift is not None:
        values = values.astype(np.float64) * (1.0 if scale is None else scale) + (shift or 0.0)
    if (factor, offset) != (1.0, 0.0):
        values = values.astype(np.float64) * factor + offset
    _check_limits(place, values, quantity)
    return values, notes


def _unit(
    place: str, variable: h5py.Dataset, quantity: Quantity
) -> tuple[float, float, tuple[str, ...]]:
    """Returns factor and offset to the quantity's unit, and a note where none is given."""
    given = text(variable, "units")
    if not given:
        note = f'{place} has no units and was taken to be in {quantity.unit}; give it "units"'
        return 1.0, 0.0, (note,)
    found = quantity.units.get(plain(given))
    if found is None:
        raise FileError(
            f'{place}: units "{given[:40]}" are not known; convert it to {quantity.known}, '
            "and name that in units"
        )
    return *found, ()


def _missing(place: str, variable: h5py.Dataset, values: Array) -> NDArray[np.bool_]:
    """Returns where values are missing; values and attributes are as packed."""
    with np.errstate(invalid="ignore", over="ignore"):
        missing = np.isnan(values)
        fills = [numbers(place, variable, name) for name in ("_FillValue", "missing_value")]
        if fills[0] is None and values.dtype.kind == "f":
            fills[0] = np.array([UNWRITTEN])
        for fill in (fill for given in fills if given is not None for fill in given):
            missing |= values == fill
            if values.dtype.kind == "f":  # as it is in the file, it may have fewer digits
                missing |= values == fill.astype(values.dtype)
        valid = numbers(place, variable, "valid_range")
        low, high = (numbers(place, variable, name) for name in ("valid_min", "valid_max"))
    if valid is not None and valid.size == 2:
        low, high = valid[:1], valid[1:]
    if low is not None:
        missing |= values < low[0]
    if high is not None:
        missing |= values > high[0]
    return missing


def _check_limits(place: str, values: Array, quantity: Quantity) -> None:
    """Raises FileError for values outside of the quantity's limits."""
    low, high = values.min(), values.max()
    if quantity.least <= low and high <= quantity.most:  # which NaN never passes
        return
    limit = f"{quantity.unit}; are the units right?"
    for wrong, words in (
        (~np.isfinite(values), "not finite; mend them"),
        (values < 0, f"negative, the lowest {low:g}; mend them"),
        (values < quantity.least, f"below {quantity.least:g} {limit}"),
        (values > quantity.most, f"above {quantity.most:g} {limit}"),
    ):
        if wrong.any():
            raise FileError(f"{place}: {_count(wrong)} {words}")


def _count(wrong: NDArray[np.bool_]) -> str:
    """Returns how many values are so, of how many, and the index of the first."""
    first = ", ".join(map(str, np.argwhere(wrong)[0]))
    return f"{np.count_nonzero(wrong)} of {wrong.size} values (the first at [{first}]) are"


def dimension(variable: h5py.Dataset, axis: int) -> tuple[str, h5py.Dataset | None]:
    """Returns the name of an axis' dimension, empty if it has none, and its scale."""
    scales = list(variable.dims[axis].values())
    if not scales:
        return str(variable.dims[axis].label), None
    return str(scales[0].name or "").rsplit("/", 1)[-1], scales[0]
