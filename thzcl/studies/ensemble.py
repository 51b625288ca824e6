"""Statistics of images over independent realisations of air and noise, which come one by one.

The memory needed does not grow with the number of realisations, but for percentiles: these are
those of every pixel as long as all images of a run fit PERCENTILE_BYTES, else those of each
target's mean alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.results.contents import VariantResult
from thzcl.sensor import Decibels, Echoes, Image, Layer, Radiances

Array = NDArray[Any]
PERCENTILES = (5, 50, 95)
_FLAG = "whether "  # how the quantity of a layer of flags begins


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
        self._signal, self._depth, self._of_air = Running(), Running(), Running()
        self._last: Radiances | Echoes | None = None

    def add(self, sight: Radiances | Echoes) -> None:
        """Adds one realisation."""
        self._signal.add(sight.returned if isinstance(sight, Echoes) else sight.contrast)
        self._depth.add(sight.optical_depth)
        if isinstance(sight, Echoes) and sight.path_return is not None:
            self._of_air.add(sight.path_return)
        self._last = sight

    def mean(self) -> Radiances | Echoes:
        """Returns the mean. It must not be called before a realisation has been added."""
        assert self._last is not None  # noqa: S101 (see above)
        sight, kind = self._last, self._last.optical_depth.dtype
        signal, depth = (plane.mean.astype(kind) for plane in (self._signal, self._depth))
        if isinstance(sight, Echoes):
            of_air = sight.path_return
            if of_air is not None:
                of_air = self._of_air.mean.astype(of_air.dtype)
            return replace(sight, optical_depth=depth, returned=signal, path_return=of_air)
        return replace(sight, optical_depth=depth, contrast=signal)


class Ensemble:
    """The statistics of one variant: of its images, and of what reached the pixels by any model.

    `targets` are the names of what pixels show, by flag. `by_pixel` says whether all images are
    kept, for percentiles of every pixel.
    """

    def __init__(self, targets: Sequence[str] = (), *, by_pixel: bool = True) -> None:
        self._targets = targets
        self._planes: dict[str, Running] = {}
        self._facts: dict[str, Running] = {}
        self._images: list[Array] | None = [] if by_pixel else None
        self._means: list[Array] = []  # of each realisation: the targets' mean images
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
        if image.decibels is None and image.unit == "dB":
            planes["linear"] = _powers(image.values)
        for name, values in planes.items():
            self._planes.setdefault(name, Running()).add(values)
        for name, (value, _) in image.facts.items():
            self._facts.setdefault(name, Running()).add(np.asarray(value))
        if self._images is not None:
            self._images.append(np.asarray(image.values, dtype=np.float32))
        self._means.append(self._by_target(variant.sight, image))
        self._last = variant

    def _by_target(self, sight: Radiances | Echoes, image: Image) -> Array:
        """Returns the mean image of each target, (target,); NaN where no pixel shows it."""
        flags = sight.target.ravel().astype(np.intp)
        values, back = _linear(image)
        pixels = np.bincount(flags, minlength=len(self._targets))
        sums = np.bincount(flags, weights=values.ravel(), minlength=len(self._targets))
        with np.errstate(divide="ignore", invalid="ignore"):
            means = sums / pixels
        return means if back is None else _decibels(means, back)

    def mean(self) -> VariantResult:
        """Returns the variant with the mean of what reached the pixels, and the mean image.

        An image in decibels is that of the mean power. The image has its variance, its spread and
        its percentiles over the realisations as layers. It must not be called before a realisation
        has been added.
        """
        assert self._last is not None  # noqa: S101 (see above)
        assert self._last.image is not None  # noqa: S101 (see above)
        variant, image = self._last, self._last.image
        means = {name: plane.mean for name, plane in self._planes.items()}
        layers = {name: self._layer(name, layer) for name, layer in image.layers.items()}
        values = means["image"]
        if image.decibels is not None:
            values = _decibels(means[f"layer {image.decibels.layer}"], image.decibels.reference)
        elif "linear" in means:
            values = 10 * np.log10(means["linear"])
        mean = replace(
            image,
            values=values,
            layers=layers | self._statistics(image),
            facts=self._mean_facts(image) | self._target_facts(image),
        )
        sight, *others = (running.mean() for running in self._sights)
        pairs = zip(variant.compared, others, strict=True)
        compared = tuple(replace(one, sight=other) for one, other in pairs)
        return replace(variant, sight=sight, image=mean, compared=compared)

    def _layer(self, name: str, layer: Layer) -> Layer:
        """Returns the mean of a layer: of flags, the fraction of realisations that are flagged."""
        plane = self._planes[f"layer {name}"]
        quantity = layer.quantity
        if layer.flags or np.asarray(layer.values).dtype.kind != "f":
            flags = plane.low.min() >= 0 and plane.high.max() <= 1
            what = quantity.removeprefix(_FLAG)
            quantity = f"fraction of realisations: {what}" if flags else f"mean of {what}"
        return replace(layer, values=plane.mean, quantity=quantity, flags=())

    def _mean_facts(self, image: Image) -> dict[str, tuple[float, str]]:
        """Returns the means of the facts that every realisation told."""
        count = len(self._means)
        return {
            name: (float(self._facts[name].mean), unit)
            for name, (_, unit) in image.facts.items()
            if self._facts[name].count == count
        }

    def _target_facts(self, image: Image) -> dict[str, tuple[float, str]]:
        """Returns the percentiles of each target's mean image over the realisations."""
        found = {}
        for name, means in zip(self._targets, np.array(self._means).T, strict=False):
            if np.isfinite(means).all():
                pairs = zip(PERCENTILES, np.percentile(means, PERCENTILES), strict=True)
                for percent, value in pairs:
                    found[f"{name}: percentile {percent} of the mean"] = float(value), image.unit
        return found

    def _statistics(self, image: Image) -> dict[str, Layer]:
        """Returns the image's variance, its largest less its smallest value, and percentiles."""
        plane = self._planes["image"]
        squared = "1" if image.unit == "1" else f"({image.unit})^2"
        layers = {
            "image_variance": Layer(
                plane.variance, squared, f"variance of the {image.quantity} over realisations"
            ),
            "image_spread": Layer(
                plane.high - plane.low, image.unit, f"largest less smallest {image.quantity}"
            ),
        }
        if self._images is None:
            return layers
        planes = np.percentile(np.array(self._images), PERCENTILES, axis=0)
        for percent, values in zip(PERCENTILES, planes, strict=True):
            quantity = f"percentile {percent} of the {image.quantity} over realisations"
            layers[f"image_percentile_{percent}"] = Layer(values, image.unit, quantity)
        return layers


def _linear(image: Image) -> tuple[Array, float | None]:
    """Returns an image as it may be averaged, and what decibels of it are relative to, or None."""
    if image.decibels is not None:
        of: Decibels = image.decibels
        return np.asarray(image.layers[of.layer].values), of.reference
    if image.unit == "dB":
        return _powers(image.values), 0.0
    return np.asarray(image.values), None


def _powers(decibels: Array) -> Array:
    return np.asarray(10 ** (np.asarray(decibels, dtype=np.float64) / 10))


def _decibels(power: Array, reference: float) -> Array:
    """Returns powers in decibels over a reference, at least 0; a reference of 0 is none."""
    if reference == 0:
        return np.asarray(10 * np.log10(power))
    return np.asarray(10 * np.log10(np.maximum(power, reference) / reference))
