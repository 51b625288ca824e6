"""How far an image depends on the absorption model: the spread over the models compared."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.results.contents import ModelResult, VariantResult
from thzcl.sensor import Echoes, Radiances

Array = NDArray[np.float64]
DECIBELS = 10 / np.log(10.0)  # for each unit of optical depth


class Spread(NamedTuple):
    """The spread of an image over models, (y, x): its largest less its smallest value."""

    values: Array
    quantity: str
    unit: str


def signal(sight: Radiances | Echoes) -> Array:
    """Returns the contrast in K, or the part of the power that comes back, (frequency, y, x)."""
    if isinstance(sight, Echoes):
        return np.asarray(sight.returned, np.float64)
    return sight.brightness_temperature_contrast


def stacked(planes: int, models: Iterable[tuple[tuple[int, ...], NDArray[Any]]]) -> NDArray[Any]:
    """Returns values by model, (model, frequency, ...), NaN where a model is not valid.

    `models` holds the numbers of a model's frequencies, of `planes` in all, and the values at them.
    """
    rows = []
    for places, values in models:
        row = np.full((planes, *values.shape[1:]), np.nan, values.dtype)
        row[list(places)] = values
        rows.append(row)
    return np.stack(rows)


def image(variant: VariantResult) -> Spread:
    """Returns the spread of what pixels see, the mean over all frequencies.

    It is that of the contrast, or for echoes that of the loss on the way out and back. A frequency
    at which only the image's own model is valid adds 0.
    """
    models, planes = variant.by_model(""), len(variant.sight.frequency_hz)
    active = isinstance(variant.sight, Echoes)
    values = [
        (one.planes, DECIBELS * one.sight.optical_depth if active else signal(one.sight))
        for one in models
    ]
    spread = np.ptp(_filled(stacked(planes, values)), axis=0).mean(axis=0)
    if active:
        return Spread(spread, "largest less smallest loss", "dB")
    return Spread(spread, "largest less smallest contrast", "K")


def _filled(values: NDArray[Any]) -> NDArray[Any]:
    """Returns values by model, those of the first wherever another has none."""
    return np.where(np.isnan(values), values[:1], values)


def budget(variants: Iterable[VariantResult], targets: int) -> dict[str, dict[str, Any]]:
    """Returns the line of the error budget that tells how far the images depend on the model.

    It is half the spread of the mean contrast of each target, of which there are `targets`. The
    root mean square is over the pixels; of several variants and frequencies the largest counts.
    There is no line where no models are compared.
    """
    parts = [_part(variant, targets) for variant in variants if variant.compared]
    if not parts:
        return {}
    rms, most, relative = np.max([part[:3] for part in parts], axis=0).tolist()
    return {"model": {"rms": rms, "max": most, "unit": parts[0][3], "relative": relative}}


def _part(variant: VariantResult, targets: int) -> tuple[float, float, float, str]:
    """Returns the numbers of the budget's line for one variant, and their unit."""
    flags = variant.sight.target.ravel().astype(np.intp)
    pixels = np.bincount(flags, minlength=targets)
    models, planes = variant.by_model(""), len(variant.sight.frequency_hz)
    means = [(one.planes, _means(one, flags, pixels)) for one in models]
    half = np.ptp(_filled(stacked(planes, means)), axis=0)[:, pixels > 0] / 2
    rms = np.sqrt(half**2 @ (pixels[pixels > 0] / len(flags)))
    largest = np.abs(signal(variant.sight)).max(axis=(1, 2))
    relative = np.divide(rms, largest, out=np.zeros_like(rms), where=largest > 0)
    unit = "of the power sent" if isinstance(variant.sight, Echoes) else "K"
    return float(rms.max()), float(half.max()), float(relative.max()), unit


def _means(one: ModelResult, flags: NDArray[np.intp], pixels: NDArray[np.intp]) -> Array:
    """Returns the means of the signal over each target, (frequency, target)."""
    rows = [plane.ravel() for plane in signal(one.sight)]
    sums = [np.bincount(flags, weights=row, minlength=len(pixels)) for row in rows]
    return np.asarray(sums) / np.maximum(pixels, 1)
