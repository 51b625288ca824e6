"""The brightness temperature of a band: the temperature whose Planck mean over it is what was seen.

A mean of Planck's law is no Planck's law of a mean frequency: inverted at one frequency, a wall of
77 K reads 75.4 K in a band of 300 to 900 GHz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry

Array = NDArray[np.float64]
POINTS = 2049  # of the look-up from the temperature at one frequency to that of the band
_APART = 1e-6  # of the reference: the least difference of temperature that is looked up
_WIDER = 1.05  # factor by which a span is widened until it holds every value
_COLDEST_K = 1e-3


class Mean:
    """The mean of Planck's law over a band, with `weights` (node,) at frequencies in Hz (node,)."""

    def __init__(self, frequency_hz: Array, weights: Array, reference_k: float) -> None:
        self._nodes = np.asarray(frequency_hz, dtype=np.float64)[:, None]
        self._weights = np.asarray(weights, dtype=np.float64) / np.sum(weights)
        self._reference = reference_k
        self._pivot = float(self._weights @ self._nodes[:, 0])
        # A band's mean radiance differs a little from that at its mean frequency.
        mean = float(self._weights @ radiometry.planck(self._nodes[:, 0], reference_k))
        self._share = float(radiometry.planck(self._pivot, reference_k)) / mean

    def difference(self, kelvin: Array) -> Array:
        """Returns the band's mean radiance at temperatures (n,) less that at the reference."""
        planes = radiometry.planck_difference(self._nodes, kelvin, self._reference)
        return np.asarray(self._weights @ planes)

    def at_one_frequency(self, contrast: Array) -> Array:
        """Returns the temperature above the reference, K, by Planck's law at the mean frequency."""
        share = contrast if self._share == 1 else contrast * self._share
        return radiometry.brightness_temperature_contrast(self._pivot, share, self._reference)

    def look_up(self, contrast: Array) -> tuple[Array, Array]:
        """Returns temperatures at one frequency, ascending, and the factor to the band's at each.

        Both are above the reference. They span those of `contrast`, which holds at least one value.
        """
        least, most = (
            float(self.at_one_frequency(np.asarray(value, np.float64)))
            for value in (contrast.min(), contrast.max())
        )
        low, high = self._reference + least, self._reference + most
        low = min(low, self._reference) / _WIDER
        while low > _COLDEST_K and self._single(low) > least:
            low /= _WIDER
        high = max(high, self._reference) * _WIDER
        while self._single(high) < most:
            high *= _WIDER
        scale = self._reference / 4
        first, last = (float(np.arcsinh((end - self._reference) / scale)) for end in (low, high))
        above = scale * np.sinh(np.linspace(first, last, POINTS))
        near = np.abs(above) < _APART * self._reference
        above[near] = _APART * self._reference
        kelvin = self._reference + above
        single = self.at_one_frequency(self.difference(kelvin))
        return single, (kelvin - self._reference) / single

    def _single(self, kelvin: float) -> float:
        """Returns what a black body's radiance reads above the reference at one frequency, K."""
        return float(self.at_one_frequency(self.difference(np.array([kelvin])))[0])
