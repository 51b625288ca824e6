"""Observers of one known target at one known place: a template, learnt on half of the airs.

The template is made of what is known: the difference that the target makes, without noise, and a
smooth model of what varies without it. It never inverts a covariance of samples, which would claim
several times the truth where there are fewer airs than pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import metrics

Array = NDArray[np.float64]
HOTELLING, NPW, CELLS = "hotelling", "npw", "cells"
CELL_OF_TEMPLATE = 0.5  # of the largest difference: what is less belongs to no cell of the target


@dataclass(frozen=True)
class Observer:
    """A template h (y, x), and what it was made of: t = h . image is large where the target is.

    `signal` is the mean difference that the target makes (y, x), `noise` the detector's variance,
    `clutter` the spectrum of the air's (y, x), as thzcl.metrics has spectra. `sign` is -1 for cells
    that the target darkens.
    """

    kind: str
    template: Array
    signal: Array
    noise: float
    clutter: Array
    sign: float = 1.0

    @property
    def shared(self) -> float:
        """Returns the part of the statistic's variance that is the air's, the same in all draws."""
        air, own = self._variance(self.clutter), self._variance(self._white)
        return air / (air + own) if air + own > 0 else 0.0

    @property
    def _white(self) -> Array:
        return np.full(self.template.shape, self.noise)

    def _variance(self, spectrum: Array) -> float:
        power = np.abs(np.fft.fft2(self.template)) ** 2
        return float((power * spectrum).sum() / self.template.size)

    def d_prime(self, *, noise: bool = True, clutter: bool = True) -> float | None:
        """Returns d' in the detector's noise, the air's clutter or both; None in neither."""
        spectrum = noise * self._white + clutter * self.clutter
        if self._variance(spectrum) <= 0:
            return None
        return abs(metrics.template_d_prime(self.template, self.signal, spectrum))

    def statistic(self, image: Array) -> float:
        """Returns the statistic of an image (y, x)."""
        return float(np.vdot(self.template, image))

    def of(self, signal: Array) -> Observer:
        """Returns this observer made for another signal in the same noise."""
        return made(self.kind, signal, self.noise, self.clutter)


def made(kind: str, signal: Array, noise: float, clutter: Array) -> Observer:
    """Returns an observer of some kind. A matched filter without detector noise is "npw"."""
    sign = 1.0
    if kind == CELLS:
        largest = signal.flat[np.abs(signal).argmax()]
        sign = float(np.sign(largest)) or 1.0
        template = (sign * signal >= CELL_OF_TEMPLATE * abs(largest)).astype(np.float64)
        return Observer(kind, template / template.sum(), signal, noise, clutter, sign)
    if kind == HOTELLING and noise > 0:
        template = metrics.hotelling_template(signal, noise + clutter)
    else:
        kind, template = NPW, signal
    size = float(np.sqrt((template**2).sum()))
    return Observer(kind, template / size if size > 0 else template, signal, noise, clutter)


class Training:
    """What the airs to learn on tell: the signal, the detector's variance, the air's spectrum.

    Two draws of the noise on the same radiances, without the target, tell noise and air apart: half
    of their mean square difference is the detector's variance, and the product of their transforms
    has the air's spectrum as its mean, whatever the noise is.
    """

    def __init__(self) -> None:
        self._airs = 0
        self._signal: Array = np.zeros(())
        self._noise = 0.0
        self._cross: Array = np.zeros(())
        self._one: NDArray[Any] = np.zeros(())
        self._other: NDArray[Any] = np.zeros(())

    ARRAYS = ("airs", "signal", "noise", "cross", "one", "other")

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Returns all that it has learnt, by name."""
        return {name: np.asarray(getattr(self, f"_{name}")) for name in self.ARRAYS}

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> Training:
        """Returns one that has learnt what arrays() told."""
        found = cls()
        found._airs, found._noise = int(arrays["airs"]), float(arrays["noise"])
        found._signal, found._cross = arrays["signal"], arrays["cross"]
        found._one, found._other = arrays["one"], arrays["other"]
        return found

    def add(self, present: Array, absent: Array, again: Array) -> None:
        """Adds an air: images (y, x) with and without the target in the same draw of the noise.

        `again` is that without the target in another draw.
        """
        self._airs += 1
        self._signal = self._signal + (present - absent)
        self._noise += float(((absent - again) ** 2).mean() / 2)
        one, other = np.fft.fft2(absent), np.fft.fft2(again)
        self._cross = self._cross + (one * other.conj()).real
        self._one, self._other = self._one + one, self._other + other

    def observer(self, kind: str, *, random: bool) -> Observer:
        """Returns the observer that was learnt; air that is not `random` has no clutter.

        The air's spectrum is that of what varies from air to air, smoothed over each radius, so
        that horizon and scenery are no clutter.
        """
        n, size = self._airs, self._signal.size
        means = (self._one / n * (self._other / n).conj()).real
        spectrum = (self._cross / n - means) * n / max(n - 1, 1) / size
        clutter = np.maximum(metrics.radial_mean(spectrum), 0.0) * random
        return made(kind, self._signal / n, self._noise / n, clutter)
