"""A virtual hygrometer: a transect through a scene's cube, written as a record to analyse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import pipeline
from thzcl.air import humidity
from thzcl.air.units import KELVIN
from thzcl.device.choose import open_device
from thzcl.errors import RecordError
from thzcl.files import write_whole
from thzcl.graph import evaluate
from thzcl.records.moisture import SONIC_HUMIDITY
from thzcl.turbulence.lattice import Lattice

Array = NDArray[np.float64]

CALM_M_S = 5.0  # the wind where the scene has none
STEPS_PER_VOXEL = 2  # two, so that waves oblique to all axes are not folded
# Along y and z for each step along x: of all slopes they keep passes apart, and the waves'
# frequencies (Roberts 2018).
SLOPES = (0.2451, 0.4302)
PASSES = 128  # at most, through the cube


def write(
    source: str | Path, folder: Path, separations_m: Sequence[float] = ()
) -> tuple[Path, ...]:
    """Writes NAME-virtual.csv, a hygrometer's record in the air of a scenario's first image.

    The record has time_s, h2o_g_m3, Ux_m_s and Uy_m_s, and Ts_C and press_hPa if temperature
    fluctuates. For each separation NAME-virtual-Dm.csv is another hygrometer's, which stands across
    the wind at the same height. Returns the paths. Raises RecordError if the air does not
    fluctuate, or if a separation exceeds half the cube, and ScenarioError, DeviceError and OSError.
    """
    variant = pipeline.prepare(source).variants[0]
    flow = variant.scene.atmosphere.fluctuations
    if variant.cube is None or flow is None:
        raise RecordError(
            f"{source}: its air does not fluctuate; expected [atmosphere.fluctuations] and "
            "an absorbing model"
        )
    ((cube,),) = evaluate([(variant.cube,)], open_device())
    same = cube.lattice == Lattice.cubic(cube.grid, cube.voxel_m)
    if cube.waves is not None or cube.layers is not None or not same:
        raise RecordError(
            f"{source}: a virtual record needs a cube with equal edges, without large_scales and "
            "[atmosphere.profile]; remove them"
        )
    period = cube.grid * cube.voxel_m
    for separation in separations_m:
        if separation > period / 2:
            raise RecordError(
                f"--separation-m {separation:g}: {source}'s cube repeats after {period:g} m; "
                f"expected {period / 2:g} m at most"
            )
    air = variant.scene.atmosphere.air
    speed = math.hypot(*flow.wind_m_s) or CALM_M_S
    delta = np.asarray(cube.delta.host(), dtype=np.float64)
    offset = None if cube.offset is None else np.asarray(cube.offset.host(), dtype=np.float64)
    name, files = Path(source).stem, []
    for separation in (0.0, *separations_m):
        voxels = separation / cube.voxel_m
        grams = air.absolute_humidity_g_m3 * (1 + transect(moved(delta, voxels)))
        grams = np.maximum(grams, 0.0)  # between voxels, waves overshoot
        columns: dict[str, Any] = {
            "time_s": np.arange(len(grams)) * step_m(cube.grid, cube.voxel_m) / speed,
            "h2o_g_m3": grams,
            "Ux_m_s": np.full(len(grams), speed),
            "Uy_m_s": np.zeros(len(grams)),
        }
        if offset is not None:
            kelvin = air.temperature_k + transect(moved(offset, voxels))
            vapour_hpa = humidity.vapour_pressure_from_absolute(grams, kelvin)
            columns["Ts_C"] = kelvin * (1 + SONIC_HUMIDITY * vapour_hpa / air.pressure_hpa) - KELVIN
            columns["press_hPa"] = np.full(len(grams), air.pressure_hpa)
        files.append(folder / f"{name}-virtual{f'-{separation:g}m' if separation else ''}.csv")
        _save(files[-1], columns)
    return tuple(files)


def _save(path: Path, columns: dict[str, Any]) -> None:
    """Writes columns by name as CSV."""
    rows = np.stack(list(columns.values()), axis=1)
    write_whole(
        path,
        lambda part: np.savetxt(part, rows, "%.9g", ",", header=",".join(columns), comments=""),
    )


def moved(cube: Array, voxels: float) -> Array:
    """Returns a periodic cube (z, y, x) as seen so many voxels across the wind, at equal height.

    The wind blows along a transect, whose horizontal part is (n, rise in y): across is
    (-rise in y, n). Between voxels the cube's own Fourier series is taken.
    """
    from scipy import fft

    if not voxels:
        return cube
    grid = cube.shape[0]
    climb, _ = rise(grid)
    size = math.hypot(climb, grid)
    along_y, along_x = np.fft.fftfreq(grid)[:, None], np.fft.rfftfreq(grid)
    phase = voxels * (along_y * grid - along_x * climb) / size
    shifted = fft.rfft2(cube, axes=(1, 2)) * np.exp(2j * np.pi * phase)
    return np.asarray(fft.irfft2(shifted, cube.shape[1:], axes=(1, 2)))


def rise(grid: int) -> tuple[int, int]:
    """Returns the voxels by which a transect climbs along y and z in one pass along x.

    They are odd, so that the transect closes after `grid` passes.
    """
    y, z = (2 * math.floor(grid * slope / 2) + 1 for slope in SLOPES)
    return y, z


def step_m(grid: int, voxel_m: float) -> float:
    """Returns the distance from one sample of a transect to the next, in m."""
    return voxel_m / STEPS_PER_VOXEL * math.hypot(grid, *rise(grid)) / grid


def transect(cube: NDArray[Any]) -> Array:
    """Returns a periodic cube (z, y, x) along a straight line from voxel (0, 0, 0).

    The line is oblique to the cube's axes, and makes at most 128 passes. Between voxels the cube's
    own Fourier series is taken, since any other interpolation changes the spectrum.
    """
    from scipy import fft

    grid = cube.shape[0]
    climb = rise(grid)
    finer = STEPS_PER_VOXEL * fft.irfft(
        fft.rfft(cube.transpose(2, 1, 0), axis=0), STEPS_PER_VOXEL * grid, axis=0
    )  # (x, y, z)
    waves = np.fft.fftfreq(grid)[:, None], np.fft.rfftfreq(grid)
    at = tuple(steps * np.arange(min(grid, PASSES)) % grid for steps in climb)
    samples = np.empty((len(at[0]), len(finer)))
    for number, plane in enumerate(finer):
        # At a given x all passes lie whole voxels apart in y and z: one shift of the series serves
        # them all.
        along_y, along_z = (
            np.exp(2j * np.pi * number / len(finer) * steps * k)
            for steps, k in zip(climb, waves, strict=True)
        )
        samples[:, number] = fft.irfft2(fft.rfft2(plane) * along_y * along_z, plane.shape)[at]
    return samples.ravel()
