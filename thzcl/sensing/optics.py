"""Blur by diffraction, pixels and all else, as one kernel of unit sum over a margin of rays around the frame.

The incoherent MTF of a circular aperture is (2/pi) (acos u - u sqrt(1 - u^2)), u = frequency over the cut-off D / lambda
(Goodman, "Introduction to Fourier Optics"); a pixel's is the sinc of its width. The kernel ends 16 lambda / D from its centre,
where 1.3 % of a point's light would still lie farther out, and its sum is 1: a uniform scene stays as it is, up to its
edges, and nothing wraps around. For a coherent transmitter this holds once speckle is averaged.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.radiometry import LIGHT_SPEED
from thzcl.sensor import Optics
from thzcl.surfaces.geometry import Raster

Array = NDArray[np.float64]
Pair = tuple[float, float]

AIRY_RADII = 16.0  # of lambda / D, where the kernel of diffraction ends
GAUSSIAN_SIGMAS = 5.0  # where that of the blur ends
_SIGMA_OF_WIDTH = 1 / np.sqrt(8 * np.log(2))


def sampling(optics: Optics, base: Raster, pixel_rad: Pair, frequency_hz: Array) -> Raster:
    """The rays that the optics need: enough per pixel for the finest detail that passes, and a margin around the frame.

    `pixel_rad` is a pixel's width and height, `base` the raster without optics.
    """
    rows, columns = base.pixels
    block = [base.block[0], base.block[1]]
    for axis, pixel in enumerate(reversed(pixel_rad)):
        finest = np.inf
        if optics.aperture_m is not None:
            finest = LIGHT_SPEED / frequency_hz.max() / optics.aperture_m / 2
        if optics.blur_mrad is not None:
            finest = min(finest, optics.blur_mrad * 1e-3 / 2)
        # A pixel of many rays must hold a whole multiple of what the camera asks for.
        block[axis] *= max(1, int(np.ceil(pixel / block[axis] / finest - 1e-9)))
    steps = (pixel_rad[0] / block[1], pixel_rad[1] / block[0])
    margin = int(np.ceil(_radius(optics, frequency_hz.min()) / min(steps))) if _blurs(optics) else 0
    size = {"rows": rows * block[0] + 2 * margin, "columns": columns * block[1] + 2 * margin}
    return replace(base, **size, block=(block[0], block[1]), margin=margin)


def _blurs(optics: Optics) -> bool:
    return optics.aperture_m is not None or optics.blur_mrad is not None


def _radius(optics: Optics, frequency_hz: float) -> float:
    """Where the kernel ends, in radians."""
    airy = AIRY_RADII * LIGHT_SPEED / frequency_hz / optics.aperture_m if optics.aperture_m else 0.0
    gauss = GAUSSIAN_SIGMAS * _SIGMA_OF_WIDTH * optics.blur_mrad * 1e-3 if optics.blur_mrad else 0.0
    return airy + gauss


def blur(
    optics: Optics, raster: Raster, pixel_rad: Pair, frequency_hz: Array, values: Array
) -> Array:
    """What the pixels record of rays (frequency, row, column): (frequency, y, x)."""
    if not _blurs(optics):
        return _center(raster, values) if not optics.pixel else _block_mean(raster, values)
    out = np.empty((len(values), *raster.pixels))
    for number, (plane, frequency) in enumerate(zip(values, frequency_hz, strict=True)):
        out[number] = _correlate(
            plane, _kernel(optics, raster, pixel_rad, float(frequency)), raster
        )
    return out


def _kernel(optics: Optics, raster: Raster, pixel_rad: Pair, frequency_hz: float) -> Array:
    """Weights (row, column) of the rays around a pixel, of sum 1.

    From `margin` rays before its block to as many after.
    """
    size = [2 * raster.margin + n for n in raster.block]
    steps = (pixel_rad[1] / raster.block[0], pixel_rad[0] / raster.block[1])
    grid = [1 << (2 * n - 1).bit_length() for n in size]
    # The pixel's centre is the middle of the block: between two rays where their number is even.
    shifts = [(n - 1) / 2 for n in size]
    fy, fx = (np.fft.fftfreq(n, step) for n, step in zip(grid, steps, strict=True))
    passed = (
        np.sinc(fy * pixel_rad[1])[:, None] * np.sinc(fx * pixel_rad[0])
        if optics.pixel
        else np.ones((len(fy), len(fx)))
    )
    radius = np.hypot(fy[:, None], fx)
    if optics.aperture_m is not None:
        passed = passed * mtf(radius * LIGHT_SPEED / frequency_hz / optics.aperture_m)
    if optics.blur_mrad is not None:
        passed = passed * np.exp(
            -2 * (np.pi * radius * optics.blur_mrad * 1e-3 * _SIGMA_OF_WIDTH) ** 2
        )
    phase = np.exp(-2j * np.pi * (fy[:, None] * steps[0] * shifts[0] + fx * steps[1] * shifts[1]))
    kernel = np.fft.ifft2(passed * phase).real[: size[0], : size[1]]
    return np.asarray(kernel / kernel.sum())


def mtf(u: Array) -> Array:
    """Diffraction-limited MTF of a circular aperture at u = spatial frequency / (D / lambda)."""
    v = np.minimum(u, 1.0)
    return np.asarray(2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)))


def _correlate(plane: Array, kernel: Array, raster: Raster) -> Array:
    """The kernel laid over each pixel's rays; by FFT, padded so that nothing wraps around."""
    shape = [n + k - 1 for n, k in zip(plane.shape, kernel.shape, strict=True)]
    spectrum = np.fft.rfft2(plane, shape) * np.fft.rfft2(kernel[::-1, ::-1], shape)
    full = np.fft.irfft2(spectrum, shape)
    first = [k - 1 for k in kernel.shape]
    height, width = raster.pixels
    return np.asarray(
        full[first[0] :: raster.block[0], first[1] :: raster.block[1]][:height, :width]
    )


def frame(raster: Raster, values: NDArray[Any]) -> NDArray[Any]:
    """Without the margin."""
    m = raster.margin
    return values[..., m : raster.rows - m, m : raster.columns - m]


def _block_mean(raster: Raster, values: Array) -> Array:
    height, width = raster.pixels
    rows, columns = raster.block
    return np.asarray(
        values.reshape(*values.shape[:-2], height, rows, width, columns).mean(axis=(-3, -1))
    )


def _center(raster: Raster, values: Array) -> Array:
    return values[
        ..., raster.block[0] // 2 :: raster.block[0], raster.block[1] // 2 :: raster.block[1]
    ]
