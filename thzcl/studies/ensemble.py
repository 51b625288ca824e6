"""Statistics of images over independent realisations of the air, which come one by one.

The memory needed does not grow with the number of realisations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.sensor import Echoes, Image, Layer, Radiances

Array = NDArray[Any]


class Running:
    """Running mean, variance, minimum and maximum over arrays of one shape.

    The variance is updated by the method of Welford (1962), Technometrics 4, 419.
    """

    def __init__(self) -> None:
        self.count = 0
        self.mean: Array = np.zeros(())
        self._squares: Array = np.zeros(())
        self.low: Array = np.zeros(())
        self.high: Array = np.zeros(())

    def add(self, values: Array) -> None:
        """Adds one array to the statistics."""
        values = np.asarray(values, dtype=np.float64)
        self.count += 1
        if self.count == 1:
            self.mean, self._squares = values.copy(), np.zeros_like(values)
            self.low, self.high = values.copy(), values.copy()
            return
        change = values - self.mean
        self.mean += change / self.count
        self._squares += change * (values - self.mean)
        np.minimum(self.low, values, out=self.low)
        np.maximum(self.high, values, out=self.high)

    @property
    def variance(self) -> Array:
        """Returns the unbiased estimate of the variance, which is 0 for a single array."""
        return np.asarray(self._squares / max(self.count - 1, 1))


class Ensemble:
    """The statistics of the images of one variant, and of what reached its pixels."""

    def __init__(self) -> None:
        self._planes: dict[str, Running] = {}
        self._last: tuple[Radiances | Echoes, Image] | None = None

    def add(self, sight: Radiances | Echoes, image: Image) -> None:
        """Adds one realisation to the statistics."""
        signal = sight.returned if isinstance(sight, Echoes) else sight.contrast
        planes = {"signal": signal, "depth": sight.optical_depth, "image": image.values}
        planes |= {f"layer {name}": layer.values for name, layer in image.layers.items()}
        for name, values in planes.items():
            self._planes.setdefault(name, Running()).add(values)
        self._last = sight, image

    def mean(self) -> tuple[Radiances | Echoes, Image]:
        """Returns the mean of what reached the pixels, and the mean image.

        The image has its variance and its spread over the realisations as layers. It must not be
        called before a realisation has been added.
        """
        assert self._last is not None  # noqa: S101 (see above)
        sight, image = self._last
        kind = sight.optical_depth.dtype
        means = {name: plane.mean for name, plane in self._planes.items()}
        signal, depth = (means[name].astype(kind) for name in ("signal", "depth"))
        if isinstance(sight, Echoes):
            average: Radiances | Echoes = replace(sight, optical_depth=depth, returned=signal)
        else:
            average = replace(sight, optical_depth=depth, contrast=signal)
        layers = {
            name: replace(layer, values=means[f"layer {name}"])
            for name, layer in image.layers.items()
        }
        return average, replace(
            image, values=means["image"], layers=layers | self._statistics(image), facts={}
        )

    def _statistics(self, image: Image) -> dict[str, Layer]:
        """Returns the variance of the image, and its largest less its smallest value, as layers."""
        plane = self._planes["image"]
        squared = "1" if image.unit == "1" else f"({image.unit})^2"
        return {
            "image_variance": Layer(
                plane.variance, squared, f"variance of the {image.quantity} over realisations"
            ),
            "image_spread": Layer(
                plane.high - plane.low, image.unit, f"largest less smallest {image.quantity}"
            ),
        }
