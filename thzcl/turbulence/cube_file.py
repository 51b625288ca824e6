"""Humidity cubes in files: those that `save_field` wrote, and those that users bring.

Say from large-eddy simulations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Span = tuple[float, float]


class CubeError(ValueError):
    """A humidity cube cannot be read or used; the text says why and what to do."""


@dataclass(frozen=True)
class CubeFile:
    """A user's cube: where it is, its sizes, mean and spans."""

    path: Path
    grid: int
    voxel_m: float
    mean_g_m3: float
    humidity_span_g_m3: Span
    temperature_span_k: Span | None


def inspect(path: Path, voxel_m: float | None) -> CubeFile:
    """What a plan must know of a cube; nothing of it is kept. `voxel_m` is what the scene says of its voxels, if it does.

    Raises CubeError for a cube that cannot be used.
    """
    humidity, temperature, own_voxel = read(path)
    if (
        voxel_m is not None
        and own_voxel is not None
        and not math.isclose(voxel_m, own_voxel, rel_tol=1e-6)
    ):
        raise CubeError(
            f"{path}: its voxels are {own_voxel:g} m, but voxel_m says {voxel_m:g} m; remove voxel_m"
        )
    edge = voxel_m or own_voxel
    if edge is None:
        raise CubeError(
            f"{path}: does not say how large its voxels are; give voxel_m in [atmosphere.fluctuations]"
        )
    warmth = None if temperature is None else _span(temperature)
    return CubeFile(
        path,
        humidity.shape[0],
        edge,
        float(humidity.mean(dtype=np.float64)),
        _span(humidity),
        warmth,
    )


def read(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None, float | None]:
    """absolute_humidity (g/m3), air_temperature (K) or None, both (z, y, x).

    And the voxel's edge in m or None.
    """
    import h5netcdf

    try:
        with h5netcdf.File(path, "r") as file:
            if "absolute_humidity" not in file.variables:
                raise CubeError(
                    f"{path}: has no variable absolute_humidity(z, y, x) in g/m3; rename or convert yours"
                )
            variable = file.variables["absolute_humidity"]
            humidity = np.asarray(variable[...])
            other = file.variables.get("air_temperature")
            temperature = None if other is None else np.asarray(other[...])
            edge = float(variable.attrs["voxel_m"]) if "voxel_m" in variable.attrs else None
    except OSError as error:
        raise CubeError(
            f"{path}: cannot be read: {error}; give a NetCDF-4 file with absolute_humidity(z, y, x)"
        ) from None
    _check(path, "absolute_humidity", humidity, humidity.shape)
    if temperature is not None:
        _check(path, "air_temperature", temperature, humidity.shape)
    return humidity, temperature, edge


def _check(path: Path, name: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    n = shape[0] if len(shape) == 3 else 0
    if set(shape) != {n} or n & (n - 1) or not 16 <= n <= 512:
        raise CubeError(
            f"{path}: {name} has shape {shape}; it must be a cube of 16, 32, ... 512 voxels along each edge"
        )
    if values.shape != shape:
        raise CubeError(
            f"{path}: {name} has shape {values.shape}, absolute_humidity {shape}; they must agree"
        )
    if not np.isfinite(values).all() or values.min() < 0:
        raise CubeError(f"{path}: {name} holds negative or non-finite values; mend them")


def _span(values: NDArray[Any]) -> Span:
    return float(values.min()), float(values.max())
