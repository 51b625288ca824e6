"""Speckle of coherent light from rough surfaces, with the grain of the optics that see it.

Sensors use it as `thzcl.sensor.speckle`. A rough surface scatters a field of white, circular,
Gaussian noise; optics of a circular aperture of diameter D pass part of its angular spectrum
(Goodman, Speckle Phenomena in Optics, 2007, chapter 4). If a flood lights the scene, and the
aperture only receives, that part is the pupil itself, and powers an angle a apart correlate as
(2 J1(x) / x)^2, x = pi D a / lambda. If one beam is scanned that both lights and receives, the
field is seen by the square of the beam: the part is the pupil's autocorrelation, the amplitudes
correlate as the transform of its square, and the powers as the square of that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Illumination = Literal["flood", "beam"]

MOST_SAMPLES = 2**25  # of one look; where a pixel needs more it has a gamma law of its own
CELLS = 64  # the fewest resolution cells, each way, in which a look is drawn
APART = 8  # resolution cells between the two ends of an image, which nothing wraps around
_QUADRATURE = 96  # nodes each way of the looks of a pixel


@dataclass(frozen=True)
class Grain:
    """What makes the grain of speckle in an image.

    `aperture` is the diameter of the aperture in wavelengths, `pixel_rad` a pixel's width and
    height. Power is averaged over the area of each pixel if `pixel` is True, and over a Gaussian of
    standard deviation `blur_rad`.
    """

    aperture: float
    pixel_rad: tuple[float, float]
    illumination: Illumination = "flood"
    pixel: bool = True
    blur_rad: float = 0.0

    @property
    def highest(self) -> float:
        """Returns the highest spatial frequency of the power, cycles/rad."""
        return self.aperture if self.illumination == "flood" else 2 * self.aperture

    @property
    def averaged(self) -> bool:
        """Returns whether power is averaged over more than a point."""
        return self.pixel or self.blur_rad > 0

    def looks(self) -> float:
        """Returns how many looks the area of a pixel holds, 1 for a point.

        It is 1 / int (1 - |u|)(1 - |v|) mu(u, v) du dv over a pixel's width u and height v from -1
        to 1, mu being the correlation of power (Goodman 2007, section 4.6).
        """
        if not self.pixel:
            return 1.0
        x, w = np.polynomial.legendre.leggauss(_QUADRATURE)
        u, w = (x + 1) / 2, w * (1 - (x + 1) / 2)  # twice the half from 0 to 1, halved
        across, down = (u * angle * self.aperture for angle in self.pixel_rad)
        apart = np.hypot(across, down[:, None])
        return float(1 / (w @ correlation(apart, self.illumination) @ w))

    def draw(self, shape: tuple[int, int], rng: np.random.Generator) -> Array:
        """Returns the power of one look in pixels (y, x), of an expected mean of 1."""
        steps = [self._samples(angle) for angle in reversed(self.pixel_rad)]
        spacing = [angle / n for angle, n in zip(reversed(self.pixel_rad), steps, strict=True)]
        size = [
            _size(pixels * n, apart * self.highest)
            for pixels, n, apart in zip(shape, steps, spacing, strict=True)
        ]
        if size[0] * size[1] > MOST_SAMPLES:
            looks = self.looks()
            return rng.gamma(looks, 1 / looks, shape)
        power = self._power(size, spacing, rng)
        picked = power[:: steps[0], :: steps[1]][: shape[0], : shape[1]]
        return picked.astype(np.float64)

    def _samples(self, pixel_rad: float) -> int:
        """Returns the samples to a pixel: enough for its power, or for the field at its middle."""
        cycles = self.highest * pixel_rad * (2 if self.averaged else 1)
        return max(1, int(np.ceil(cycles - 1e-9)))

    def _power(self, size: list[int], spacing: list[float], rng: np.random.Generator) -> Array:
        """Returns the power of one look at samples so far apart, (row, column)."""
        from scipy import (
            fft,  # its import takes a tenth of a second, which few scenes need to spend
        )

        fy, fx = (np.fft.fftfreq(n, apart) for n, apart in zip(size, spacing, strict=True))
        passed = self._passed(fy, fx)
        field = np.empty(size, np.complex64)
        for part in (field.real, field.imag):
            part[...] = rng.standard_normal(size, np.float32)
        field *= np.sqrt(passed, dtype=np.float32)
        field = fft.ifft2(field, overwrite_x=True, workers=-1)
        field *= np.float32(size[0] * size[1] / np.sqrt(2 * passed.sum()))
        power = np.square(field.real) + np.square(field.imag)
        if not self.averaged:
            return np.asarray(power)
        spectrum = fft.rfft2(power, workers=-1)
        spectrum *= self._average(fy, np.fft.rfftfreq(size[1], spacing[1])).astype(np.float32)
        # Truncated spectra leave a mean of power no less than 0 but for rounding.
        return np.asarray(np.maximum(fft.irfft2(spectrum, size, workers=-1), 0.0))

    def _passed(self, fy: NDArray[Any], fx: NDArray[Any]) -> Array:
        """Returns the part of the field's power that the optics pass, (row, column)."""
        radius = np.hypot(fy[:, None], fx)
        if self.illumination == "beam":
            return autocorrelation(radius / self.aperture) ** 2
        step = np.sqrt(fy[1] * fx[1])  # an edge as wide as a sample makes the disc a round one
        return np.asarray(np.clip((self.aperture / 2 - radius) / step + 0.5, 0.0, 1.0))

    def _average(self, fy: NDArray[Any], fx: NDArray[Any]) -> Array:
        """Returns the transfer of the average over pixel and blur, (row, column)."""
        passed = np.ones((len(fy), len(fx)))
        if self.pixel:
            width, height = self.pixel_rad
            passed = np.sinc(fy * height)[:, None] * np.sinc(fx * width)
        if self.blur_rad:
            square = fy[:, None] ** 2 + fx**2
            passed = passed * np.exp(-2 * (np.pi * self.blur_rad) ** 2 * square)
        return np.asarray(passed)


def _size(samples: int, cells: float) -> int:
    """Returns how many samples, each of so many resolution cells, are drawn for an image's."""
    from scipy import fft

    least = max(samples + np.ceil(APART / cells), np.ceil(CELLS / cells))
    return int(fft.next_fast_len(int(least)))


def autocorrelation(u: Array) -> Array:
    """Returns the autocorrelation of a circular pupil at u = spatial frequency / (D / lambda).

    It is the MTF of incoherent optics (Goodman, Introduction to Fourier Optics, equation 6-31).
    """
    v = np.minimum(u, 1.0)
    return np.asarray(2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)))


def correlation(apart: Array, illumination: Illumination) -> Array:
    """Returns the correlation of power at angles `apart`, in units of lambda / D."""
    from scipy import special

    if illumination == "flood":
        x = np.maximum(np.pi * np.asarray(apart, dtype=np.float64), 1e-9)
        return np.asarray((2 * special.j1(x) / x) ** 2)
    places, amplitude = _beam_amplitude()
    return np.asarray(np.interp(apart, places, amplitude, right=0.0) ** 2)


@lru_cache(maxsize=1)
def _beam_amplitude() -> tuple[Array, Array]:
    """Returns angles in lambda / D, and the correlation of a scanned beam's amplitude at each."""
    from scipy import special

    x, w = np.polynomial.legendre.leggauss(256)
    u = (x + 1) / 2
    places = np.linspace(0.0, 16.0, 4097)
    weight = w * u * autocorrelation(u) ** 2
    return places, special.j0(2 * np.pi * places[:, None] * u) @ weight / weight.sum()


@lru_cache(maxsize=1)
def _two_way() -> tuple[Array, Array]:
    """Returns spatial frequencies over D / lambda, and the transfer of the fourth power of h."""
    from scipy import special

    x, w = np.polynomial.legendre.leggauss(1500)
    place = (x + 1) * 15  # to 30 lambda / D, beyond which 1e-8 of the power lies
    h = 2 * special.j1(np.pi * place) / (np.pi * place)
    weight = w * place * h**4
    u = np.linspace(0.0, 2.0, 1025)
    return u, special.j0(2 * np.pi * u[:, None] * place) @ weight / weight.sum()


def two_way_transfer(u: Array) -> Array:
    """Returns the transfer of mean power by a scanned beam at u = frequency / (D / lambda).

    A point is seen by |h|^4, h being the amplitude of the beam: an image 0.74 lambda / D wide.
    """
    frequency, transfer = _two_way()
    return np.asarray(np.interp(u, frequency, transfer, right=0.0))
