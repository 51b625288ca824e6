"""Humidity cubes in files: those that `save_field` wrote, and those that users bring.

A user's cube comes, for example, from a large-eddy simulation.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import humidity as humidities
from thzcl.air.cf import Quantity, dataset, numbers, text
from thzcl.air.units import UNITS
from thzcl.errors import FileError
from thzcl.files import CUBE, digest, open_netcdf
from thzcl.turbulence import cf, orientation, remap
from thzcl.turbulence.lattice import Lattice
from thzcl.turbulence.remap import Cut

if TYPE_CHECKING:
    import h5py

Span = tuple[float, float]

VOXEL_M = (1e-4, 1e5)  # the limits of the key voxel_m
MOST_VOXELS = 512**3  # as the key grid
SAME_VOXEL = 1e-6  # relative: two numbers that mean one edge
SAME_STEP = 0.01  # relative: steps of coordinates, which are rounded, against that edge
SAME_MEAN = 0.01  # relative: means of cube and scene that need no note
# Times the scene's mean that a cube may hold: the fourth power of their ratio, which fits take, is
# well within float32 (3e38). A plan refuses higher powers where they are not.
MOST_RATIO = 1e4
WATER_OVER_DRY_AIR = 0.62198  # molar masses

HUMIDITY = Quantity(
    "absolute_humidity",
    "g/m3",
    UNITS["g/m3"],
    "g m-3, kg m-3, mg m-3 or ug m-3",
    0.0,
    4334.0,  # 2000 hPa of vapour at 100 K, as far as the keys of [atmosphere] go
)
TEMPERATURE = Quantity(
    "air_temperature",
    "K",
    UNITS["K"],
    "K or degC",
    100.0,  # the limits of the key temperature_k
    400.0,
)


PRESSURE = Quantity("air_pressure", "hPa", UNITS["hPa"], "Pa or hPa", 1e-6, 2000.0)
_SHARES = {"1": 1.0, "kgkg-1": 1.0, "kg/kg": 1.0, "gg-1": 1.0, "gkg-1": 1e-3, "g/kg": 1e-3}
_RATIO = {name: (worth, 0.0) for name, worth in _SHARES.items()}
_PERCENT = {"%": (1.0, 0.0), "percent": (1.0, 0.0), "1": (100.0, 0.0)}
# What else tells how humid the air is, with its temperature and pressure.
RELATED = (
    Quantity("specific_humidity", "kg/kg", _RATIO, "kg kg-1 or g kg-1", 0.0, 1.0),
    Quantity("humidity_mixing_ratio", "kg/kg", _RATIO, "kg kg-1 or g kg-1", 0.0, 1e3),
    Quantity("relative_humidity", "%", _PERCENT, "% or 1", 0.0, 1e4),
)
# Standard names of CF by the names of quantities, where they differ.
_STANDARD = {"absolute_humidity": "mass_concentration_of_water_vapor_in_air"}


@dataclass(frozen=True)
class Asked:
    """What a scene says of a file: the edge of its voxels in m, which axes repeat, and its time.

    `periodic` is along x, y and z. `pressure_hpa` is the air's where the file does not hold it.
    """

    voxel_m: float | None = None
    periodic: tuple[bool, bool, bool] | None = None
    time_index: int | None = None
    pressure_hpa: float = 1013.25


@dataclass(frozen=True)
class CubeFile:
    """A user's cube: where it is, its voxels, mean and spans, and its bytes' SHA-256.

    `orientation` is how it lies in the world: as the file says (thzcl's own do), else upright.
    `notes` tell what was taken for granted where the file does not say it.
    """

    path: Path
    asked: Asked
    lattice: Lattice
    mean_g_m3: float
    humidity_span_g_m3: Span
    temperature_span_k: Span | None
    digest: str
    notes: tuple[str, ...]
    orientation: str = "aligned"


class _Content(NamedTuple):
    """What a file holds: humidity in g/m3, temperature in K or None, (z, y, x), on even voxels."""

    humidity: NDArray[Any]
    temperature: NDArray[Any] | None
    lattice: Lattice
    notes: tuple[str, ...]
    orientation: str


def inspect(path: Path, asked: Asked | None = None) -> CubeFile:
    """Returns what a plan must know of a cube; none of its values are kept.

    Raises FileError for a cube that cannot be used.
    """
    asked = asked or Asked()
    content = _load(path, asked)
    humidity, temperature = content.humidity, content.temperature
    return CubeFile(
        path,
        asked,
        content.lattice,
        float(humidity.mean(dtype=np.float64)),
        _span(humidity),
        None if temperature is None else _span(temperature),
        digest(path, CUBE),
        content.notes,
        content.orientation,
    )


def read(path: Path, asked: Asked | None = None) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Returns absolute humidity in g/m3, and air temperature in K or None.

    The cubes are (z, y, x), on the voxels of the lattice that `inspect` finds, without padding.
    Raises FileError.
    """
    content = _load(path, asked or Asked())
    return content.humidity, content.temperature


def mean_note(cube: CubeFile, mean_g_m3: float) -> str | None:
    """Returns a note where a cube's mean is not the scene's; None where they agree to 1 %."""
    own = cube.mean_g_m3
    if abs(own - mean_g_m3) <= SAME_MEAN * mean_g_m3:
        return None
    return (
        f"{cube.path}: the air is the cube's, {own:.4g} g/m3 in the mean, and not the scene's "
        f"{mean_g_m3:.4g} g/m3; give absolute_humidity_g_m3 = {own:.4g}"
    )


def refuse_zero_mean(cube: CubeFile, mean_g_m3: float) -> None:
    """Raises FileError where a scene's mean is 0, or too dry, to measure its cube by."""
    wettest, own = cube.humidity_span_g_m3[1], cube.mean_g_m3
    if mean_g_m3 > 0 and wettest <= MOST_RATIO * mean_g_m3:
        return
    remedy = (
        f"give the cube's own mean: absolute_humidity_g_m3 = {own:.4g}"
        if own > 0
        else "give any mean above 0, say absolute_humidity_g_m3 = 0.001"
    )
    raise FileError(
        f"{cube.path}: the cube holds up to {wettest:.4g} g/m3, and the scene's mean of "
        f"{mean_g_m3:.4g} g/m3 is no measure for that; {remedy}"
    )


def _load(path: Path, asked: Asked) -> _Content:
    """Reads and checks a file. Raises FileError."""
    place = str(path)
    with open_netcdf(path, CUBE) as file:
        quantity, variable = _humidity(place, file)
        _check_size(place, quantity.name, variable)
        own = cf.read(place, variable, quantity, asked.time_index)
        beside = {}
        for other, wanted in ((TEMPERATURE, True), (PRESSURE, quantity is not HUMIDITY)):
            stored = _variable(place, file, other.name) if wanted else None
            if stored is not None:
                beside[other.name] = _beside(place, stored, other, own, asked)
        turned, periodic = _orientation(place, file), _periodic(place, file, variable, own, asked)
        edges = _edges(place, variable, own, asked)
    notes = [note for volume in (own, *beside.values()) for note in volume.notes]
    values = {name: volume.values for name, volume in beside.items()}
    grams, kelvin = own.values, values.get(TEMPERATURE.name)
    if quantity is not HUMIDITY:
        hpa = values.get(PRESSURE.name, asked.pressure_hpa)
        grams = _grams(place, quantity, grams, kelvin, hpa)
    cuts = _cuts(own, edges, periodic)
    lattice, placed = _lattice(place, cuts), _on_voxels(grams, cuts)
    notes += _remapped(place, cuts, grams, placed)
    warm = None if kelvin is None else _on_voxels(kelvin, cuts)
    return _Content(placed, warm, lattice, tuple(notes), turned)


def _humidity(place: str, file: h5py.File) -> tuple[Quantity, h5py.Dataset]:
    """Returns what tells how humid the air is, and its variable. Raises FileError."""
    for quantity in (HUMIDITY, *RELATED):
        variable = _variable(place, file, quantity.name)
        if variable is not None:
            return quantity, variable
    raise FileError(
        f"{place}: has no variable absolute_humidity(z, y, x), and none with the standard name "
        f"{', '.join(quantity.name for quantity in RELATED)}; rename or convert yours"
    )


def _variable(place: str, file: h5py.File, name: str) -> h5py.Dataset | None:
    """Returns the variable of a name, or of the standard name that it stands for, or None.

    Raises FileError where several have the standard name.
    """
    import h5py

    found = dataset(place, file, name)
    if found is not None:
        return found
    hard = [one for one in file if isinstance(file.get(one, getlink=True), h5py.HardLink)]
    stored = [one for one in hard if isinstance(file[one], h5py.Dataset)]
    standard = _STANDARD.get(name, name)
    named = [one for one in stored if text(file[one], "standard_name") == standard]
    if len(named) > 1:
        raise FileError(
            f"{place}: {' and '.join(named)} both have the standard name {standard}; rename the "
            f"one that counts to {name}"
        )
    return dataset(place, file, named[0]) if named else None


def _check_size(place: str, name: str, variable: h5py.Dataset) -> None:
    """Raises FileError for an array that is no box, or too large a one."""
    shape = cf.sizes(variable)
    if len(shape) == len(cf.AXES) and 0 < math.prod(shape) <= MOST_VOXELS:
        return
    raise FileError(
        f"{place}: {name} has shape {variable.shape}; it must be a box (z, y, x) of at most "
        f"{MOST_VOXELS} voxels, and may have a time before them"
    )


def _beside(
    place: str, variable: h5py.Dataset, quantity: Quantity, own: cf.Volume, asked: Asked
) -> cf.Volume:
    """Returns a variable that stands beside humidity, in the same cells. Raises FileError."""
    _check_size(place, quantity.name, variable)
    times = asked.time_index if variable.ndim > len(cf.AXES) else None
    found = cf.read(place, variable, quantity, times)
    if found.values.shape != own.values.shape:
        raise FileError(
            f"{place}: {quantity.name} has shape {found.values.shape}, the humidity "
            f"{own.values.shape}; they must agree"
        )
    for letter, one, other in zip(cf.AXES, found.axes, own.axes, strict=True):
        if one is None or other is None:
            continue
        apart = float(np.abs(one.centres_m - other.centres_m).max())
        if apart > SAME_STEP * float(np.ptp(other.centres_m)):
            raise FileError(
                f"{place}: {quantity.name} stands up to {apart:g} m from the humidity along "
                f"{letter}; interpolate both to the same coordinates"
            )
    return found


def _grams(
    place: str, quantity: Quantity, values: NDArray[Any], kelvin: Any, hpa: Any
) -> NDArray[Any]:
    """Returns absolute humidity in g/m3 from a quantity that tells it with temperature.

    A specific humidity q is vapour over moist air, a mixing ratio w vapour over dry air:
    e = q p / (eps + (1 - eps) q), e = w p / (eps + w) with eps = 0.62198 (World Meteorological
    Organization 2018, WMO-No. 8, annex 4.A). Raises FileError where there is no temperature.
    """
    if kelvin is None:
        raise FileError(
            f"{place}: {quantity.name} needs air_temperature beside it; add that, or convert to "
            "absolute_humidity in g m-3"
        )
    eps = WATER_OVER_DRY_AIR
    if quantity.name == "relative_humidity":
        vapour = humidities.vapour_pressure_from_relative(values, kelvin)
    elif quantity.name == "specific_humidity":
        vapour = values * hpa / (eps + (1 - eps) * values)
    else:
        vapour = values * hpa / (eps + values)
    return humidities.absolute_humidity(vapour, kelvin)


def _orientation(place: str, file: h5py.File) -> str:
    """Returns how a file says that its cube lies in the world, as thzcl's own do; else upright."""
    told = file.attrs.get("grid_rotation")
    if told is None:
        return "aligned"
    try:
        name = orientation.name_of(json.loads(told))
    except (TypeError, ValueError):
        name = None
    if name is None:
        raise FileError(
            f"{place}: its grid_rotation is none of thzcl's own; turn the cube upright, and remove "
            "that attribute"
        )
    return name


def _periodic(
    place: str, file: h5py.File, variable: h5py.Dataset, own: cf.Volume, asked: Asked
) -> tuple[bool, bool, bool]:
    """Returns which of x, y and z repeat: as the scene says, or the file, or else the usual ones.

    A cube with coordinates repeats along x and y, one without along all three.
    """
    if asked.periodic is not None:
        return asked.periodic
    for holder in (variable, file):
        told = numbers(place, holder, "periodic")
        if told is None:
            continue
        if told.shape != (3,) or not np.isin(told, (0, 1)).all():
            raise FileError(
                f"{place}: its attribute periodic is {told.tolist()}; give three of 0 and 1, for "
                "x, y and z"
            )
        x, y, z = (bool(one) for one in told)
        return x, y, z
    return True, True, all(axis is None for axis in own.axes)


def _edges(
    place: str, variable: h5py.Dataset, own: cf.Volume, asked: Asked
) -> tuple[float | None, float | None, float | None]:
    """Returns the edges of voxels along z, y, x in m, None where steps are uneven.

    Scene, attribute and coordinates must agree on them. Raises FileError.
    """
    told = numbers(f"{place}: absolute_humidity", variable, "voxel_m")
    if told is not None and (told.size not in (1, 3) or not np.isfinite(told).all()):
        raise FileError(
            f"{place}: absolute_humidity: its attribute voxel_m is {told.tolist()}; give one "
            "number, or three for x, y and z"
        )
    sizes = None if told is None else np.broadcast_to(told, 3)[::-1].astype(float).tolist()
    steps = [axis.step_m for axis in own.axes if axis is not None and axis.step_m is not None]
    found: list[float | None] = []
    for number, (letter, axis) in enumerate(zip(cf.AXES, own.axes, strict=True)):
        size = asked.voxel_m if sizes is None else _within(place, sizes[number])
        if sizes is not None and asked.voxel_m is not None:
            _agree(place, sizes[number], asked.voxel_m)
        if axis is not None and (axis.step_m is not None or len(axis.centres_m) > 1):
            found.append(_of_coordinate(place, letter, axis, size))
            continue
        if size is None and not steps:
            raise FileError(
                f"{place}: does not say how large its voxels are; give voxel_m in "
                "[atmosphere.fluctuations]"
            )
        found.append(_within(place, steps[0] if size is None else size))
    z, y, x = found
    return z, y, x


def _agree(place: str, own: float, asked: float) -> None:
    """Raises FileError where the scene's edge of a voxel is not the file's own."""
    if not math.isclose(own, asked, rel_tol=SAME_VOXEL):
        raise FileError(
            f"{place}: its voxels are {own:g} m, but voxel_m says {asked:g} m; remove voxel_m"
        )


def _of_coordinate(place: str, letter: str, axis: cf.Axis, size: float | None) -> float | None:
    """Returns the edge of voxels along an axis with a coordinate, None if that is uneven."""
    if size is None:
        return None if axis.step_m is None else _within(place, axis.step_m)
    if axis.step_m is not None and math.isclose(axis.step_m, size, rel_tol=SAME_STEP):
        return size
    steps = np.diff(axis.centres_m)
    has = f"{axis.step_m:g} m" if axis.step_m else f"{steps.min():g} to {steps.max():g} m"
    raise FileError(
        f"{place}: its coordinates along {letter} have steps of {has}, but the edge of its voxels "
        f"is {size:g} m; make them agree, or remove voxel_m"
    )


def _within(place: str, edge: float) -> float:
    """Returns the edge of a voxel in m. Raises FileError if it is beyond the key's limits."""
    low, high = VOXEL_M
    if not low <= edge <= high:
        raise FileError(
            f"{place}: its voxels are {edge:g} m; voxel_m must lie between {low:g} and {high:g} m"
        )
    return edge


def _cuts(
    own: cf.Volume, edges: tuple[float | None, ...], periodic: tuple[bool, bool, bool]
) -> list[Cut]:
    """Returns how z, y and x are cut into even voxels."""
    cuts = []
    rows = zip(own.axes, edges, own.values.shape, periodic[::-1], strict=True)
    for axis, edge, count, repeats in rows:
        if edge is not None:
            first = edge / 2 if axis is None else float(axis.centres_m[0])
            cuts.append(remap.even(first, edge, count, periodic=repeats))
        elif axis is not None:
            cuts.append(remap.uneven(axis.centres_m, periodic=repeats))
    return cuts


def _lattice(place: str, cuts: list[Cut]) -> Lattice:
    """Returns the voxels of cuts along z, y, x. Raises FileError if there are too many."""
    x, y, z = cuts[::-1]
    count = math.prod(cut.size for cut in cuts)
    if count > MOST_VOXELS:
        sizes = " x ".join(str(cut.size) for cut in (x, y, z))
        raise FileError(
            f"{place}: makes {sizes} voxels (each edge a power of two), more than {MOST_VOXELS}; "
            "cut a part out, or average its cells"
        )
    fill = tuple(None if cut.periodic else cut.count for cut in (x, y, z))
    return Lattice(
        (x.size, y.size, z.size),
        (x.voxel_m, y.voxel_m, z.voxel_m),
        (x.faces_m[0], y.faces_m[0], z.faces_m[0]),
        (fill[0], fill[1], fill[2]),
    )


def _on_voxels(values: NDArray[Any], cuts: list[Cut]) -> NDArray[Any]:
    """Returns the means of cells (z, y, x) over voxels."""
    for axis, cut in enumerate(cuts):
        values = cut.cells(values, axis)
    return values


def _remapped(place: str, cuts: list[Cut], before: NDArray[Any], after: NDArray[Any]) -> list[str]:
    """Returns a note on axes whose cells are not voxels as they are, with sigma before and after.

    `before` are values of cells, `after` those of voxels, g/m3.
    """
    told = [
        f"{letter} from {count} cells to {cut.count} voxels of {cut.voxel_m:.4g} m"
        for letter, cut, count in zip(cf.AXES, cuts, before.shape, strict=True)
        if not cut.same
    ]
    if not told:
        return []
    one, other = (float(np.std(values, dtype=np.float64)) for values in (before, after))
    return [
        f"{place}: remapped along {', '.join(told)}; sigma was {one:.4g} g/m3, and is {other:.4g}"
    ]


def _span(values: NDArray[Any]) -> Span:
    return float(values.min()), float(values.max())
