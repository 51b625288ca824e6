"""Computes what reaches the camera from path moments, at single frequencies or over bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import Buffer, Device, Program
from thzcl.paths.trace import Paths
from thzcl.surfaces import source
from thzcl.surfaces.radiance import Table
from thzcl.surfaces.source import SourceKernels

Array = NDArray[np.float64]
ROWS_APART = 64  # values between spectral rows: rows of a power of two would share cache lines


@dataclass(frozen=True)
class ShadeKernels(SourceKernels):
    """The kernels that shade paths; `bands` is the number of bands, or None without any."""

    files: ClassVar = ("surfaces/source", "paths/attenuate", "paths/shade")

    moments: int
    bands: int | None = None


@dataclass(frozen=True)
class Shaded:
    """Optical depth and contrast on the device, both (frequency, ray).

    For bands in place of frequencies, the depth is that of a band's mean transmission.
    """

    depth: Buffer
    contrast: Buffer


def shade(device: Device, paths: Paths, coefficients: Array, sent: Table, precision: str) -> Shaded:
    """Returns depth and contrast behind isothermal air at single frequencies.

    `coefficients` (frequency, power) in 1/m are those of absorption in powers of delta, and `sent`
    is what surfaces send.
    """
    program, rays = _program(device, paths, sent, precision), len(paths.path_length)
    count, row = len(coefficients), rays + ROWS_APART
    depth, contrast = (device.empty((count, row), precision) for _ in range(2))
    program.run(
        "shade",
        rays // program.lanes,
        count,
        **_shaded_paths(paths),
        coefficients=device.put(coefficients, precision),
        **source.arguments(device, paths.facing, sent, precision),
        frequencies=count,
        row=row,
        depth=depth,
        contrast=contrast,
    )
    return Shaded(depth, contrast)


def shade_bands(
    device: Device,
    paths: Paths,
    coefficients: Array,
    sent: Table,
    weights: Array,
    passing: Array,
    precision: str,
) -> Shaded:
    """Returns depth and contrast behind isothermal air in bands, without storing a spectrum.

    `coefficients` and `sent` are those of `shade`. Contrast is summed with `weights`,
    transmission with `passing`, both (band, frequency).
    """
    absorbing = np.where(passing > 0, coefficients[:, 0], np.inf)
    thinnest = coefficients[absorbing.argmin(axis=1)]
    # Frequencies that are not in a band add nothing to it.
    beyond = np.where(passing[..., None] > 0, coefficients - thinnest[:, None], 0.0)
    program, rays = _program(device, paths, sent, precision, len(weights)), len(paths.path_length)
    depth, contrast = (device.empty((len(weights), rays), precision) for _ in range(2))
    program.run(
        "shade_bands",
        rays // program.lanes,
        len(coefficients),
        **_shaded_paths(paths),
        thinnest=device.put(thinnest, precision),
        beyond=device.put(beyond, precision),
        weights=device.put(passing, precision),
        **source.arguments(device, paths.facing, sent, precision, weights),
        frequencies=len(coefficients),
        rows=len(sent.rows),
        depth=depth,
        contrast=contrast,
    )
    return Shaded(depth, contrast)


def _program(
    device: Device, paths: Paths, sent: Table, precision: str, bands: int | None = None
) -> Program:
    """Returns the shading kernels for some number of moments, and of bands if there are any."""
    moments, options = len(paths.moments), source.options(paths.facing, sent)
    return device.build(ShadeKernels(moments=moments, bands=bands, **options), precision)


def _shaded_paths(paths: Paths) -> dict[str, Any]:
    """Returns the kernel arguments that describe paths."""
    return {
        "path_length": paths.path_length,
        "moments": paths.moments,
        "surface": paths.surface,
    }
