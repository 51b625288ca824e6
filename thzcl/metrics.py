"""How well a target can be seen: contrast, noise, resolution and detection, as functions.

Each function is one formula of the literature over plain numbers and arrays. Detection is that of
one test at one known place, not of a search over a picture. Spectra of noise are unnormalised: the
expected square of the absolute value of a picture's discrete Fourier transform, over the number of
pixels, so that white noise of variance s^2 has the spectrum s^2 everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.radiometry import LIGHT_SPEED
from thzcl.sensing import optics, speckle
from thzcl.sensor import Image, Optics, Radiances

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ROUNDING = 1e-9  # relative to a mean: what varies less does not vary
FIRST_TARGET = 2  # the flag of the first target in what pixels show


def linear(image: Image) -> tuple[Array, str]:
    """Returns an image as a linear quantity (y, x), and its unit: never decibels.

    That is the layer `received_power` where the sensor has one, the layer that decibels are made
    of, or the power ratio of other decibels, and else the image itself.
    """
    name = "received_power" if "received_power" in image.layers else None
    if name is None and image.decibels is not None:
        name = image.decibels.layer
    if name is not None:
        layer = image.layers[name]
        return np.asarray(layer.values, np.float64), layer.unit
    values = np.asarray(image.values, np.float64)
    return (10 ** (values / 10), "1") if image.unit == "dB" else (values, image.unit)


def surroundings(target: NDArray[Any], path_length: NDArray[Any], flag: int) -> Mask:
    """Returns the pixels around a target, as many as it has, (y, x).

    They are the nearest to it in pixels. `target` (y, x) says what each pixel shows, `path_length`
    (y, x) how far away that is in m; other targets that stand nearer than the farthest pixel of
    this one are occluders, and left out. There are fewer pixels if the picture has no more, and
    none if it shows no such target.
    """
    from scipy.ndimage import distance_transform_edt

    own = target == flag
    if not own.any():
        return np.zeros(own.shape, bool)
    occluders = (target >= FIRST_TARGET) & ~own & (path_length < path_length[own].max())
    apart = distance_transform_edt(~own)
    apart[own | occluders] = np.inf
    order = np.argsort(apart, axis=None, kind="stable")[: int(own.sum())]
    ring = np.zeros(own.size, bool)
    ring[order] = np.isfinite(apart.ravel()[order])
    return ring.reshape(own.shape)


def cell_means(values: Array, inside: Mask, cell: tuple[int, int]) -> Array:
    """Returns the means of values (y, x) over the resolution cells that lie inside a mask, (n,).

    Cells are blocks of `cell` (rows, columns) pixels, counted from the mask's first row and column.
    If no whole cell lies inside, the one mean over the mask is returned.
    """
    if cell == (1, 1):
        return np.asarray(values[inside])
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    if not len(rows):
        return np.zeros(0)
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    within, shown = inside[window], np.where(inside[window], values[window], 0.0)
    high, wide = (max(n // c, 1) for n, c in zip(within.shape, cell, strict=True))

    def sums(plane: Array) -> Array:
        cut = plane[: high * cell[0], : wide * cell[1]]
        padded = np.zeros((high * cell[0], wide * cell[1]))
        padded[: cut.shape[0], : cut.shape[1]] = cut
        return np.asarray(padded.reshape(high, cell[0], wide, cell[1]).sum((1, 3)))

    whole = sums(within.astype(np.float64)) == cell[0] * cell[1]
    if not whole.any():
        return np.array([values[inside].mean()])
    return np.asarray(sums(shown)[whole] / (cell[0] * cell[1]))


def cnr(on_target: Array, around: Array) -> float | None:
    """Returns the ratio of contrast to noise, |m1 - m0| / sqrt((s1^2 + s0^2) / 2).

    (Barrett and Myers, Foundations of Image Science, 2004.) The values (n,) are those of resolution
    cells: one cell has this ratio, and n independent ones together sqrt(n) times as much. Returns
    None without values, or where nothing varies beyond rounding.
    """
    if not len(on_target) or not len(around):
        return None
    variance = (np.var(on_target) + np.var(around)) / 2
    if variance <= (ROUNDING * max(abs(on_target.mean()), abs(around.mean()))) ** 2:
        return None
    return float(abs(on_target.mean() - around.mean()) / np.sqrt(variance))


def contrast_db(on_target: Array, around: Array) -> float | None:
    """Returns the ratio of two mean powers, 10 log10(I1 / I0), dB; None where one of them is 0."""
    if not len(on_target) or not len(around):
        return None
    one, other = float(on_target.mean()), float(around.mean())
    return float(10 * np.log10(one / other)) if one > 0 and other > 0 else None


def of_target(
    image: Image, sight: Any, flag: int, cell: tuple[int, int] = (1, 1)
) -> Mapping[str, float | None]:
    """Returns `cnr` of a target in an image, and `contrast_db` if the sensor is active.

    `sight` is the Radiances or Echoes that the image is made of, `cell` the size of a resolution
    cell in pixels (rows, columns). Background and ground have no surroundings: both are None.
    """
    if flag < FIRST_TARGET:
        return {"cnr": None, "contrast_db": None}
    own = sight.target == flag
    ring = surroundings(sight.target, sight.path_length, flag)
    values, _ = linear(image)
    on_target, around = values[own], values[ring]
    cells = (cell_means(values, part, cell) for part in (own, ring))
    active = not isinstance(sight, Radiances)
    ratio = contrast_db(on_target, around) if active else None
    return {"cnr": cnr(*cells), "contrast_db": ratio}


def resolution_cell(
    blur: Optics | None, frequency_hz: float, pixel_rad: tuple[float, float]
) -> tuple[int, int]:
    """Returns the size of a resolution cell in pixels (rows, columns), at least one each way.

    It is lambda / D of the aperture, or the width of the Gaussian blur if that is larger.
    `pixel_rad` is a pixel's width and height.
    """
    if blur is None:
        return 1, 1
    airy = LIGHT_SPEED / frequency_hz / blur.aperture_m if blur.aperture_m else 0.0
    width = max(airy, (blur.blur_mrad or 0.0) * 1e-3)
    rows, columns = (max(1, round(width / angle)) for angle in reversed(pixel_rad))
    return rows, columns


def mtf(
    cycles_per_rad: Array,
    blur: Optics | None,
    frequency_hz: float,
    pixel_rad: float,
    *,
    two_way: bool = False,
) -> Array:
    """Returns the modulation transfer of optics and pixel at spatial frequencies, same shape.

    It is the product of the circular aperture's (Goodman, Introduction to Fourier Optics, 2005,
    eq. 6-31), the pixel's sinc and the Gaussian blur's; `pixel_rad` is the pixel's size along the
    frequency's direction. `two_way` is that of one beam that both lights and receives, for power
    averaged over speckle. Air has none, since rays are straight.
    """
    cycles = np.asarray(cycles_per_rad, np.float64)
    passed = np.sinc(cycles * pixel_rad) if blur is None or blur.pixel else np.ones_like(cycles)
    if blur is not None and blur.aperture_m is not None:
        transfer = speckle.two_way_transfer if two_way else optics.mtf
        cutoff = blur.aperture_m * frequency_hz / LIGHT_SPEED
        passed = passed * transfer(np.abs(cycles) / cutoff)
    if blur is not None:
        passed = passed * np.exp(-2 * (np.pi * cycles * optics.blur_sigma_rad(blur)) ** 2)
    return np.asarray(passed)


def netd_k(noise: float, slope: float) -> float:
    """Returns the noise-equivalent temperature difference, sigma_P / (dP / dT), K."""
    return noise / slope


def radial_mean(spectrum: Array) -> Array:
    """Returns a spectrum (y, x) with each value in place of the mean over its radius.

    Frequencies are in cycles per pixel both ways, in rings one bin of the longer side wide. The
    zero frequency, which a picture's mean alone fills, has a ring of its own.
    """
    height, width = spectrum.shape
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    ring = np.ceil(radius * max(height, width) - 0.5).astype(int).ravel()
    counts = np.maximum(np.bincount(ring), 1)
    means = np.bincount(ring, weights=spectrum.ravel()) / counts
    return np.asarray(means[ring].reshape(spectrum.shape))


def hotelling_template(signal: Array, noise: Array) -> Array:
    """Returns the matched filter K^-1 s of a known signal in stationary noise, (y, x).

    `noise` (y, x) is the noise's spectrum, above 0 everywhere (Barrett, Abbey and Clarkson 1998,
    J. Opt. Soc. Am. A 15, 1520).
    """
    return np.asarray(np.fft.ifft2(np.fft.fft2(signal) / noise).real)


def template_d_prime(template: Array, signal: Array, noise: Array) -> float:
    """Returns d' of a linear observer, h.s / sqrt(h^T K h); infinite if the noise is 0.

    `noise` (y, x) is the spectrum of stationary noise. With the template K^-1 s that is the
    Hotelling observer's, sqrt(s^T K^-1 s); with s itself the non-prewhitening one's (Burgess 1994,
    J. Opt. Soc. Am. A 11, 1237).
    """
    power = np.abs(np.fft.fft2(template)) ** 2
    variance = float((power * noise).sum() / template.size)
    strength = float((template * signal).sum())
    if variance <= 0:
        return float(np.copysign(np.inf, strength)) if strength else 0.0
    return strength / float(np.sqrt(variance))


def sample_d_prime(null: Array, present: Array) -> float:
    """Returns d' of samples of a statistic, (m1 - m0) / sqrt((s1^2 + s0^2) / 2); 0 over 0 is 0."""
    change = float(np.mean(present) - np.mean(null))
    variance = (np.var(null, ddof=1) + np.var(present, ddof=1)) / 2
    if variance <= 0:
        return float(np.copysign(np.inf, change)) if change else 0.0
    return change / float(np.sqrt(variance))


def area(d_prime: Any) -> Array:
    """Returns the area under the ROC of a Gaussian statistic, Phi(d' / sqrt 2) (Green 1966)."""
    from scipy.special import ndtr

    return np.asarray(ndtr(np.asarray(d_prime) / np.sqrt(2)))


def detection_probability(d_prime: Any, false_alarm: float) -> Array:
    """Returns the probability of detection by a Gaussian statistic, Phi(d' - Phi^-1(1 - Pfa)).

    (Kay, Fundamentals of Statistical Signal Processing II, 1998, eq. 4.14.)
    """
    from scipy.special import ndtr, ndtri

    return np.asarray(ndtr(np.asarray(d_prime) + ndtri(false_alarm)))


def speckle_detection(ratio: Any, looks: float, false_alarm: float) -> Array:
    """Returns the probability of detecting by their mean power that cells are `ratio` times bright.

    The mean of fully developed speckle over `looks` independent looks and cells, N L in all, has a
    gamma law of that shape: Pd = Q(N L, Q^-1(N L, Pfa) / ratio) (Goodman, Speckle Phenomena in
    Optics, 2007, section 4.2). A ratio below 1 is detected as darkness.
    """
    from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv

    ratio = np.asarray(ratio, np.float64)
    brighter = gammaincc(looks, gammainccinv(looks, false_alarm) / np.maximum(ratio, 1.0))
    darker = gammainc(looks, gammaincinv(looks, false_alarm) / np.minimum(ratio, 1.0))
    return np.asarray(np.where(ratio >= 1, brighter, darker))


def speckle_area(ratio: Any, looks: float) -> Array:
    """Returns the area under the ROC of that mean power, F_{2NL,2NL}(ratio), from 0 to 1.

    A ratio of two gamma laws of one shape has Fisher's law (Goodman 2007, section 4.2).
    """
    from scipy.special import fdtr

    return np.asarray(fdtr(2 * looks, 2 * looks, np.asarray(ratio, np.float64)))


def speckle_cnr(ratio: Any, looks: float) -> Array:
    """Returns the ratio of contrast to noise of that mean power, |q - 1| / sqrt((1 + q^2) / 2NL).

    The noise is the mean of both variances, as in `cnr`.
    """
    ratio = np.asarray(ratio, np.float64)
    return np.asarray(np.abs(ratio - 1) / np.sqrt((1 + ratio**2) / (2 * looks)))
