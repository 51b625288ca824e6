"""From what rays capture to what pixels see: times averaged, optics applied, samples gathered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.clock import Clock
from thzcl.plan.compute import Capture
from thzcl.plan.plan import VariantPlan
from thzcl.sensing import optics
from thzcl.sensor import Echoes, Radiances
from thzcl.surfaces.geometry import Raster

Array = NDArray[np.float64]


def develop(captures: Sequence[Capture], clock: Clock) -> Radiances | Echoes:
    """What a variant's pixels see, of one capture or the mean of several."""
    first = captures[0]
    variant, raster = first.variant, first.variant.geometry.raster
    frequency_hz = _bands(variant, variant.frequency_hz)
    contrast = _seen(variant, frequency_hz, _mean([c.contrast for c in captures]), clock)
    depth = _pixels(raster, _mean([c.optical_depth for c in captures]))
    length = _pixels(raster, _mean([c.path_length for c in captures]))
    cosine = None if first.cosine is None else _pixels(raster, first.cosine)
    weights = (
        None
        if variant.needs.weights is None
        else np.atleast_2d(np.asarray(variant.needs.weights, dtype=np.float64))
    )
    common = (
        frequency_hz,
        depth,
        length,
        _targets(variant, first),
        cosine,
        math.prod(variant.pixel_rad),
        variant.frequency_hz,
        weights,
    )
    if variant.needs.reflection:
        return Echoes(*common, contrast, _pixels(raster, first.outgoing_length))
    air_k = variant.scene.atmosphere.temperature_k
    return Radiances(
        *common, contrast, _bands(variant, radiometry.planck(variant.frequency_hz, air_k)), air_k
    )


def _mean(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    return arrays[0] if len(arrays) == 1 else np.mean(arrays, axis=0)


def _bands(variant: VariantPlan, spectrum: Array) -> Array:
    return spectrum if variant.weights is None else np.asarray(variant.weights @ spectrum)


def _seen(
    variant: VariantPlan, frequency_hz: Array, contrast: NDArray[Any], clock: Clock
) -> NDArray[Any]:
    """The contrast as the pixels see it, through the optics if there are any."""
    raster = variant.geometry.raster
    if variant.needs.optics is None:
        with clock.stage("shading"):
            return _pixels(raster, contrast)
    with clock.stage("optics"):
        return optics.blur(variant.needs.optics, raster, variant.pixel_rad, frequency_hz, contrast)


def _targets(variant: VariantPlan, capture: Capture) -> NDArray[np.int32]:
    """What the middle of each pixel shows."""
    raster = variant.geometry.raster
    flags = np.array([surface.target for surface in variant.surfaces], dtype=np.int32)
    rows, columns = raster.block
    return np.asarray(
        flags[optics.frame(raster, capture.surface)[rows // 2 :: rows, columns // 2 :: columns]]
    )


def _pixels(raster: Raster, values: NDArray[Any]) -> NDArray[Any]:
    """The mean over the rays of each pixel, the margin left out."""
    inner = optics.frame(raster, values)
    rows, columns = raster.block
    if rows == columns == 1:
        return inner
    height, width = raster.pixels
    return np.asarray(
        inner.reshape(*inner.shape[:-2], height, rows, width, columns).mean(axis=(-3, -1))
    )
