"""Statistics of images over independent realisations of the air, which come one by one.

The memory needed does not grow with the number of realisations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.results.contents import VariantResult
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


class MeanSight:
    """The mean of what reached the pixels."""

    def __init__(self) -> None:
        self._signal, self._depth = Running(), Running()
        self._last: Radiances | Echoes | None = None

    def add(self, sight: Radiances | Echoes) -> None:
        """Adds one realisation."""
        self._signal.add(sight.returned if isinstance(sight, Echoes) else sight.contrast)
        self._depth.add(sight.optical_depth)
        self._last = sight

    def mean(self) -> Radiances | Echoes:
        """Returns the mean. It must not be called before a realisation has been added."""
        assert self._last is not None  # noqa: S101 (see above)
        sight, kind = self._last, self._last.optical_depth.dtype
        signal, depth = (plane.mean.astype(kind) for plane in (self._signal, self._depth))
        if isinstance(sight, Echoes):
            return replace(sight, optical_depth=depth, returned=signal)
        return replace(sight, optical_depth=depth, contrast=signal)


class Ensemble:
    """The statistics of one variant: of its images, and of what reached the pixels by any model."""

    def __init__(self) -> None:
        self._planes: dict[str, Running] = {}
        self._sights: list[MeanSight] = []
        self._last: VariantResult | None = None

    def add(self, variant: VariantResult) -> None:
        """Adds one realisation to the statistics; its image must be there."""
        image, compared = variant.image, (one.sight for one in variant.compared)
        assert image is not None  # noqa: S101 (see above)
        self._sights = self._sights or [MeanSight() for _ in range(1 + len(variant.compared))]
        for running, sight in zip(self._sights, (variant.sight, *compared), strict=True):
            running.add(sight)
        planes = {"image": image.values}
        planes |= {f"layer {name}": layer.values for name, layer in image.layers.items()}
        for name, values in planes.items():
            self._planes.setdefault(name, Running()).add(values)
        self._last = variant

    def mean(self) -> VariantResult:
        """Returns the variant with the mean of what reached the pixels, and the mean image.

        The image has its variance and its spread over the realisations as layers. It must not be
        called before a realisation has been added.
        """
        assert self._last is not None  # noqa: S101 (see above)
        assert self._last.image is not None  # noqa: S101 (see above)
        variant, image = self._last, self._last.image
        means = {name: plane.mean for name, plane in self._planes.items()}
        layers = {
            name: replace(layer, values=means[f"layer {name}"])
            for name, layer in image.layers.items()
        }
        layers |= self._statistics(image)
        sight, *others = (running.mean() for running in self._sights)
        pairs = zip(variant.compared, others, strict=True)
        compared = tuple(replace(one, sight=other) for one, other in pairs)
        mean = replace(image, values=means["image"], layers=layers, facts={})
        return replace(variant, sight=sight, image=mean, compared=compared)

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
