"""Blur by diffraction, pixels and all else, as one kernel of unit sum over the rays about a pixel.

The incoherent MTF of a circular aperture is (2/pi) (acos u - u sqrt(1 - u^2)), u = frequency over
the cut-off D / lambda (Goodman, "Introduction to Fourier Optics"); a pixel's is the sinc of its
width. The kernel ends 16 lambda / D from its centre, where 1.3 % of a point's light would still lie
farther out, and its sum is 1: a uniform scene stays as it is, up to its edges, and nothing wraps
around. For a coherent transmitter this holds once speckle is averaged. A scanned beam that both
lights and receives (`two_way`) sees a point by the fourth power of its amplitude.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thzcl.air.radiometry import LIGHT_SPEED
from thzcl.sensing import speckle
from thzcl.sensor import Optics
from thzcl.surfaces.camera import Raster

Array = NDArray[np.float64]
Pair = tuple[float, float]

AIRY_RADII = 16.0  # of lambda / D, where the kernel of diffraction ends
TWO_WAY_RADII = 5.0  # where that of a scanned beam ends, but for 2e-5 of a point's light
GAUSSIAN_SIGMAS = 5.0  # where that of the blur ends
_SIGMA_OF_WIDTH = 1 / np.sqrt(8 * np.log(2))


def sampling(
    optics: Optics,
    base: Raster,
    pixel_rad: Pair,
    frequency_hz: Array,
    *,
    two_way: bool = False,
) -> Raster:
    """Returns the rays that the optics need: enough a pixel, and a margin around the frame.

    There are enough for the finest detail that passes. `pixel_rad` is a pixel's width and height,
    `base` the raster without optics.
    """
    rows, columns = base.pixels
    block = [base.block[0], base.block[1]]
    detail = finest_rad(optics, frequency_hz, two_way=two_way)
    for axis, pixel in enumerate(reversed(pixel_rad)):
        # A pixel of many rays must hold a whole multiple of what the camera asks for.
        block[axis] *= max(1, int(np.ceil(pixel / block[axis] / detail - 1e-9)))
    steps = (pixel_rad[0] / block[1], pixel_rad[1] / block[0])
    reach = _radius(optics, float(frequency_hz.min()), two_way=two_way)
    margin = int(np.ceil(reach / min(steps))) if blurs(optics) else 0
    size = {"rows": rows * block[0] + 2 * margin, "columns": columns * block[1] + 2 * margin}
    return replace(base, **size, block=(block[0], block[1]), margin=margin)


def finest_rad(optics: Optics, frequency_hz: Array, *, two_way: bool = False) -> float:
    """Returns half the finest detail that the optics pass, rad; inf if they blur nothing."""
    finest = np.inf
    if optics.aperture_m is not None:
        finest = LIGHT_SPEED / frequency_hz.max() / optics.aperture_m / (4 if two_way else 2)
    if optics.blur_mrad is not None:
        finest = min(finest, optics.blur_mrad * 1e-3 / 2)
    return float(finest)


def blurs(optics: Optics) -> bool:
    """Returns whether a pixel sees more than its own area."""
    return optics.aperture_m is not None or optics.blur_mrad is not None


def _radius(optics: Optics, frequency_hz: float, *, two_way: bool) -> float:
    """Returns where the kernel ends, in radians."""
    radii = TWO_WAY_RADII if two_way else AIRY_RADII
    airy = radii * LIGHT_SPEED / frequency_hz / optics.aperture_m if optics.aperture_m else 0.0
    return airy + GAUSSIAN_SIGMAS * blur_sigma_rad(optics)


def pixel_mean(rays: Raster) -> Array:
    """Returns weights of the mean over a pixel's own rays, (1, row, column), in its margin."""
    m = rays.margin
    return np.pad(np.full((1, *rays.block), 1 / np.prod(rays.block)), ((0, 0), (m, m), (m, m)))


def kernels(
    optics: Optics | None,
    rays: Raster,
    pixel_rad: Pair,
    frequency_hz: Array,
    shift: Pair = (0.0, 0.0),
    *,
    two_way: bool = False,
) -> Array:
    """Returns weights of the rays about a pixel, (frequency or 1, row, column), each of sum 1.

    They reach from `margin` rays before the pixel's block to as many after. `shift` says how far
    down and right of their places the rays lie, in rays.
    """
    if optics is not None and blurs(optics):
        each = (_kernel(optics, rays, pixel_rad, float(f), shift, two_way) for f in frequency_hz)
        return np.array(list(each))
    if optics is None or optics.pixel:
        return pixel_mean(rays)
    center = np.zeros((1, *rays.block))
    center[0, rays.block[0] // 2, rays.block[1] // 2] = 1.0
    return center


@lru_cache(maxsize=16)  # the lines of a scan have it in common
def _kernel(
    optics: Optics, rays: Raster, pixel_rad: Pair, frequency_hz: float, shift: Pair, two_way: bool
) -> Array:
    """Returns the weights at one frequency, (row, column).

    The margin serves the longest wavelength; a shorter one's weights end before, in zeros.
    """
    from scipy import fft  # its import takes a tenth of a second, which few scenes need to spend

    steps = (pixel_rad[1] / rays.block[0], pixel_rad[0] / rays.block[1])
    reach = _radius(optics, frequency_hz, two_way=two_way)
    own = replace(rays, margin=min(rays.margin, int(np.ceil(reach / min(steps)))))
    size = [2 * own.margin + n for n in own.block]
    passed, (fy, fx) = _transfer(optics, own, pixel_rad, frequency_hz, two_way)
    # The pixel's centre is the middle of the block: between two rays where their number is even.
    down, right = ((n - 1) / 2 - s for n, s in zip(size, shift, strict=True))
    turned = np.exp(-2j * np.pi * fy * steps[0] * down)[:, None] * passed
    turned *= np.exp(-2j * np.pi * fx * steps[1] * right)
    kernel = fft.irfft2(turned, workers=-1)[: size[0], : size[1]]
    return np.pad(kernel / kernel.sum(), rays.margin - own.margin)


@lru_cache(maxsize=16)  # the points of a lattice have it in common
def _transfer(
    optics: Optics, rays: Raster, pixel_rad: Pair, frequency_hz: float, two_way: bool
) -> tuple[Array, tuple[Array, Array]]:
    """Returns what passes, and its frequencies down and across in cycles/rad; half a spectrum."""
    from scipy import fft

    size = [2 * rays.margin + n for n in rays.block]
    steps = (pixel_rad[1] / rays.block[0], pixel_rad[0] / rays.block[1])
    grid = [fft.next_fast_len(2 * n - 1, real=True) for n in size]
    grid = [n + n % 2 for n in grid]  # even, so that half a spectrum tells the length
    fy = np.asarray(np.fft.fftfreq(grid[0], steps[0]), np.float64)
    fx = np.asarray(np.fft.rfftfreq(grid[1], steps[1]), np.float64)
    passed = np.ones((len(fy), len(fx)))
    if optics.pixel:
        passed = np.sinc(fy * pixel_rad[1])[:, None] * np.sinc(fx * pixel_rad[0])
    radius = np.hypot(fy[:, None], fx)
    if optics.aperture_m is not None:
        transfer = speckle.two_way_transfer if two_way else mtf
        passed = passed * transfer(radius * LIGHT_SPEED / frequency_hz / optics.aperture_m)
    if optics.blur_mrad is not None:
        sigma = blur_sigma_rad(optics)
        passed = passed * np.exp(-2 * (np.pi * radius * sigma) ** 2)
    return passed, (fy, fx)


def mtf(u: Array) -> Array:
    """Returns the MTF of a circular aperture at u = spatial frequency / (D / lambda)."""
    return speckle.autocorrelation(u)


def blur_sigma_rad(optics: Optics) -> float:
    """Returns the standard deviation of the Gaussian blur, rad, or 0 if there is none."""
    return optics.blur_mrad * 1e-3 * _SIGMA_OF_WIDTH if optics.blur_mrad else 0.0
