"""How much memory a plan takes: while it is evaluated, and while its results are written."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from thzcl.graph import peak
from thzcl.plan.plan import Plan
from thzcl.plan.variant import PlannedVariant
from thzcl.sensing.image import ComparedSpec, ImageSpec

PERCENTILE_BYTES = 2**28  # of the images, in float32, whose percentiles are taken pixel by pixel
# Of each triangle: while a mesh is read and its tree is made, and afterwards on the host.
MADE_BYTES, PLANNED_BYTES = 400, 100
DRAWN_BYTES = 40_000_000  # by the library that draws, with one panel


def needed(plan: Plan) -> tuple[int, int]:
    """Returns the bytes that are needed at the peak, and those of the largest single array."""
    total, largest = peak(plan.batch())
    files = [_stored(one) for one in plan.variants]
    kept = sum(sum(spec.memory().held) for one in plan.variants for spec in _images(one))
    written = kept + max(sum(files), sum(map(_drawn, plan.variants)) + DRAWN_BYTES)
    triangles = max(map(_triangles, plan.variants))
    computing = total + _statistics(plan)
    peaks = max(computing, written) + PLANNED_BYTES * triangles, MADE_BYTES * triangles
    return max(peaks), max(largest, *files)


def by_pixel(realizations: int, images: int, pixels: int) -> bool:
    """Returns whether percentiles are those of every pixel of all images of a run."""
    return 4 * realizations * images * pixels <= PERCENTILE_BYTES


def _images(variant: PlannedVariant) -> Iterator[ImageSpec | ComparedSpec]:
    """Yields the images of a variant, which are kept until its files are written."""
    yield variant.image
    yield from variant.compared


def _pixels(variant: PlannedVariant) -> int:
    height, width = variant.image.pixels.steps.pixels
    return height * width


def _triangles(variant: PlannedVariant) -> int:
    return int(variant.image.places.ends.geometry.things.meshes.corners.shape[0])


def _stored(variant: PlannedVariant) -> int:
    """Returns the bytes of what a variant has in a file of results, cubes aside."""
    planes, real = variant.image.spectrum.count, np.dtype(variant.image.precision).itemsize
    models = 1 + len(variant.compared)
    return real * _pixels(variant) * (planes * (2 + 2 * models) + 1)


def _drawn(variant: PlannedVariant) -> int:
    """Returns the bytes of the values of a variant's panels in a picture, masks included."""
    return 9 * _pixels(variant) * variant.image.spectrum.count


def _statistics(plan: Plan) -> int:
    """Returns the bytes of the statistics over many realisations, or frames."""
    count = max(plan.realizations, plan.frames)
    if count == 1 or not count:
        return 0
    pixels = sum(map(_pixels, plan.variants))
    planes = sum(
        _pixels(one) * one.image.spectrum.count * (1 + len(one.compared)) for one in plan.variants
    )
    running = 8 * (4 * 2 * planes + 4 * pixels) + 8 * (2 * planes + pixels)  # with what is added
    first = plan.variants[0]
    if plan.realizations > 1 and by_pixel(count, len(plan.variants), _pixels(first)):
        return running + 2 * 4 * count * pixels  # and sorted
    return running
