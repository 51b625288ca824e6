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

from thzcl.air.cf import Quantity, dataset, number
from thzcl.air.units import UNITS
from thzcl.errors import FileError
from thzcl.files import CUBE, digest, open_netcdf
from thzcl.turbulence import cf, orientation

if TYPE_CHECKING:
    import h5py

Span = tuple[float, float]

VOXEL_M = (1e-4, 1e5)  # the limits of the key voxel_m
FEWEST, MOST = 16, 512  # voxels along an edge, as the key grid
SAME_VOXEL = 1e-6  # relative: two numbers that mean one edge
SAME_STEP = 0.01  # relative: steps of coordinates, which are rounded, against that edge
SAME_MEAN = 0.01  # relative: means of cube and scene that need no note
# Times the scene's mean that a cube may hold: the fourth power of their ratio, which fits take, is
# well within float32 (3e38). A plan refuses higher powers where they are not.
MOST_RATIO = 1e4

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


@dataclass(frozen=True)
class CubeFile:
    """A user's cube: where it is, its sizes, mean and spans, and its bytes' SHA-256.

    `orientation` is how it lies in the world: as the file says (thzcl's own do), else upright.
    `notes` tell what was taken for granted where the file does not say it.
    """

    path: Path
    grid: int
    voxel_m: float
    mean_g_m3: float
    humidity_span_g_m3: Span
    temperature_span_k: Span | None
    digest: str
    notes: tuple[str, ...]
    orientation: str = "aligned"


class _Content(NamedTuple):
    """What a file holds; `voxel_m` as its attribute says, `steps_m` as its coordinates say."""

    humidity: cf.Volume
    temperature: cf.Volume | None
    voxel_m: float | None
    steps_m: tuple[float, ...]
    orientation: str


def inspect(path: Path, voxel_m: float | None) -> CubeFile:
    """Returns what a plan must know of a cube; none of its values are kept.

    `voxel_m` is what the scene says of its voxels, if it does. Raises FileError for a cube that
    cannot be used.
    """
    content = _load(path)
    humidity, temperature = content.humidity, content.temperature
    return CubeFile(
        path,
        humidity.values.shape[0],
        _edge(path, voxel_m, content),
        float(humidity.values.mean(dtype=np.float64)),
        _span(humidity.values),
        None if temperature is None else _span(temperature.values),
        digest(path, CUBE),
        humidity.notes + (() if temperature is None else temperature.notes),
        content.orientation,
    )


def read(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None, float | None]:
    """Returns absolute humidity in g/m3, air temperature in K or None, and the voxel's edge in m.

    The cubes are (z, y, x); the edge is None if the file does not tell it. Raises FileError.
    """
    humidity, temperature, voxel_m, steps_m, _ = _load(path)
    edge = steps_m[0] if voxel_m is None and steps_m else voxel_m
    return humidity.values, None if temperature is None else temperature.values, edge


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


def _load(path: Path) -> _Content:
    """Reads and checks a file. Raises FileError."""
    with open_netcdf(path, CUBE) as file:
        humidity = dataset(str(path), file, HUMIDITY.name)
        if humidity is None:
            raise FileError(
                f"{path}: has no variable absolute_humidity(z, y, x); rename or convert yours"
            )
        _check_shape(path, humidity)
        temperature = dataset(str(path), file, TEMPERATURE.name)
        if temperature is not None and temperature.shape != humidity.shape:
            raise FileError(
                f"{path}: air_temperature has shape {temperature.shape}, absolute_humidity "
                f"{humidity.shape}; they must agree"
            )
        voxel_m = number(f"{path}: absolute_humidity", humidity, "voxel_m")
        warmth = None if temperature is None else cf.read(str(path), temperature, TEMPERATURE)
        content = cf.read(str(path), humidity, HUMIDITY)
        return _Content(
            content,
            warmth,
            None if voxel_m is None else _within(path, voxel_m),
            content.steps_m,
            _orientation(file),
        )


def _orientation(file: h5py.File) -> str:
    """Returns how a file says that its cube lies in the world, as thzcl's own do; else upright."""
    try:
        rotation = json.loads(file.attrs.get("grid_rotation", "null"))
    except (TypeError, ValueError):
        return "aligned"
    return orientation.name_of(rotation) or "aligned"


def _check_shape(path: Path, humidity: h5py.Dataset) -> None:
    shape = humidity.shape
    n = shape[0] if len(shape) == 3 else 0
    if set(shape) != {n} or n & (n - 1) or not FEWEST <= n <= MOST:
        raise FileError(
            f"{path}: absolute_humidity has shape {shape}; it must be a cube of 16, 32, ... 512 "
            "voxels along each edge"
        )


def _edge(path: Path, asked_m: float | None, content: _Content) -> float:
    """Returns the voxels' edge in m, on which scene, attribute and coordinates must agree."""
    sizes = [size for size in (asked_m, content.voxel_m, *content.steps_m) if size is not None]
    if not sizes:
        raise FileError(
            f"{path}: does not say how large its voxels are; give voxel_m in "
            "[atmosphere.fluctuations]"
        )
    edge, own = _within(path, sizes[0]), content.voxel_m
    if own is not None and not math.isclose(edge, own, rel_tol=SAME_VOXEL):
        raise FileError(
            f"{path}: its voxels are {own:g} m, but voxel_m says {edge:g} m; remove voxel_m"
        )
    for step in content.steps_m:
        if not math.isclose(step, edge, rel_tol=SAME_STEP):
            raise FileError(
                f"{path}: its coordinates have steps of {step:g} m, but the edge of its voxels is "
                f"{edge:g} m; make them agree, and interpolate to voxels that are cubes"
            )
    return edge


def _within(path: Path, edge: float) -> float:
    """Returns the edge of a voxel in m. Raises FileError if it is beyond the key's limits."""
    low, high = VOXEL_M
    if not low <= edge <= high:
        raise FileError(
            f"{path}: its voxels are {edge:g} m; voxel_m must lie between {low:g} and {high:g} m"
        )
    return edge


def _span(values: NDArray[Any]) -> Span:
    return float(values.min()), float(values.max())
