"""From rays to pixels: one weighted sum over the rays of one or more exposures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Memory, Spec, Values, Work, frozen
from thzcl.sensing import optics
from thzcl.sensing.exposures import Beam
from thzcl.sensing.spectrum import Split
from thzcl.sensing.transfer import Rays, on_raster
from thzcl.sensing.weather import AnyRays
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.ends import EndsSpec, OutgoingSpec, RayEnds
from thzcl.surfaces.radiance import Sources

Array = NDArray[Any]
FEW = 16  # weights, beyond which a sum over a kernel goes by FFT


@dataclass(frozen=True)
class Places:
    """What the middle of each pixel shows, and its rays' means, (y, x)."""

    path_length: Array  # m
    outgoing_length: Array  # m, from the transmitter; the path's where there is none
    target: NDArray[np.int32]  # flag of `target` in the result
    cosine: Array | None  # of the angle between ray and normal, where it was asked for


@frozen
class PlacesSpec(Spec):
    """What pixels show, whether or not the air lets it be seen."""

    ends: EndsSpec
    out: OutgoingSpec | None
    targets: Values  # (surface,): flags of what each surface belongs to
    reads = ("ends", "out")
    stage = "shading"

    def run(self, device: Device, ends: RayEnds, out: RayEnds | None) -> Places:
        """Returns lengths, targets and cosines by pixel."""
        del device
        raster = self.ends.geometry.raster
        mean = optics.pixel_mean(raster)

        def pixels(values: Any) -> Array:
            rays: Array = on_raster(raster, values.host())
            planes: Array = weigh(rays, mean, Steps(raster.block, raster.pixels))
            return np.asarray(planes[0])

        length = pixels(ends.path_length)
        flags = self.targets.array[middles(raster, on_raster(raster, ends.surface.host()))]
        cosine = pixels(ends.facing.cosine) if self.ends.asked.cosine else None
        outgoing = length if out is None else pixels(out.path_length)
        return Places(length, outgoing, flags, cosine)

    def memory(self) -> Memory:
        """Returns the sizes of two lengths and a flag, and of the cosine where it is asked for."""
        rows, columns = self.ends.geometry.raster.pixels
        pixels = rows * columns
        return Memory((8 * pixels,) * (2 + self.ends.asked.cosine) + (4 * pixels,))


class Steps(NamedTuple):
    """How pixels lie among the rays of one exposure."""

    block: tuple[int, int]  # rays between pixels, down and across
    pixels: tuple[int, int]  # height, width


def middles(raster: Raster, values: Array) -> Array:
    """Returns the values (..., row, column) in the middle of each pixel, (..., y, x)."""
    m, (rows, columns) = raster.margin, raster.block
    inner = values[..., m : raster.rows - m, m : raster.columns - m]
    return inner[..., rows // 2 :: rows, columns // 2 :: columns]


def weigh(rays: Array, kernels: Array, steps: Steps) -> Array:
    """Returns the sum of rays (..., row, column) by a kernel about each pixel, (plane, y, x).

    `kernels` (plane or 1, row, column). Few weights are summed as they are, many by FFT, padded so
    that nothing wraps around.
    """
    rays = rays.reshape(-1, *rays.shape[-2:])
    if kernels.size == 1 and kernels.item() == 1:
        return rays
    places = np.argwhere(kernels.any(axis=0))
    if len(places) > FEW:
        pairs = zip(rays, np.broadcast_to(kernels, (len(rays), *kernels.shape[1:])), strict=True)
        return np.array([_correlate(plane, kernel, steps) for plane, kernel in pairs])
    return sum(
        (kernels[:, r, c, None, None] * _picked(rays, (r, c), steps) for r, c in places),
        start=np.zeros(()),
    )


def _picked(rays: Array, place: Any, steps: Steps) -> Array:
    """Returns the ray at one place of each pixel's kernel, (plane, y, x)."""
    (row, column), (down, across), (height, width) = place, *steps
    return rays[..., row::down, column::across][..., :height, :width]


def _correlate(plane: Array, kernel: Array, steps: Steps) -> Array:
    """Returns the sum of one plane (row, column) by a kernel about each pixel, (y, x)."""
    from scipy import fft  # its import takes a tenth of a second, which few scenes need to spend

    if not kernel.any():  # of a line or part of a beam that this wavelength does not reach
        return np.zeros(steps.pixels)
    plane, kernel = _trimmed(plane, kernel, steps)
    whole = [n + k - 1 for n, k in zip(plane.shape, kernel.shape, strict=True)]
    shape = [fft.next_fast_len(n, real=True) for n in whole]
    spectrum = fft.rfft2(plane.astype(np.float64, copy=False), shape, workers=-1)
    spectrum *= fft.rfft2(kernel[::-1, ::-1], shape, workers=-1)
    full = fft.irfft2(spectrum, shape, workers=-1)
    first, (height, width) = [k - 1 for k in kernel.shape], steps.pixels
    return np.asarray(full[first[0] :: steps.block[0], first[1] :: steps.block[1]][:height, :width])


def _trimmed(plane: Array, kernel: Array, steps: Steps) -> tuple[Array, Array]:
    """Returns a kernel without rows and columns of zeros at its edges, and the rays it meets."""
    for axis, (block, pixels) in enumerate(zip(*steps, strict=True)):
        used = np.flatnonzero(kernel.any(axis=1 - axis))
        first, last = int(used[0]), int(used[-1]) + 1
        kernel = kernel.take(np.arange(first, last), axis)
        plane = plane.take(np.arange(first, last + (pixels - 1) * block), axis)
    return plane, kernel


@dataclass(frozen=True)
class Pixels:
    """What pixels see: optical depth and contrast, (plane, y, x)."""

    depth: Array
    contrast: Array


@frozen
class SumSpec(Spec):
    """A weighted sum over the rays of some exposures."""

    rays: tuple[AnyRays, ...]
    beams: tuple[Beam, ...]  # weights of radiance
    owns: tuple[Beam, ...]  # weights of depth
    steps: Steps
    reads = one_by_one = ("rays",)

    @property
    def stage(self) -> str:  # type: ignore[override]
        """Returns the stage that takes time: optics, where there are any."""
        return "optics" if self.blurred else "shading"

    @property
    def blurred(self) -> bool:
        """Returns whether a pixel sees more than its own rays."""
        return self.beams != self.owns

    def run(self, device: Device, rays: Iterator[Rays]) -> Pixels:
        """Returns depth and contrast; 0 where nothing weighs anything."""
        del device
        depth: Any = np.zeros(())
        contrast: Any = np.zeros(())
        for one, beam, own in zip(rays, self.beams, self.owns, strict=True):
            contrast = _added(contrast, one.contrast, beam, self.steps)
            depth = _added(depth, one.depth, own, self.steps)
        return Pixels(depth, contrast)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns how many rays a pixel takes."""
        if not self.blurred:
            return {"optics": LeftOut("no [sensor.optics]")}
        rays = sum(one.ends.geometry.raster.rays for one in self.rays)
        each = rays / (self.steps.pixels[0] * self.steps.pixels[1])
        exposures = f", {len(self.rays)} exposures" if len(self.rays) > 1 else ""
        return {"optics": Work("", f"{each:.3g} rays a pixel, the margin included{exposures}")}

    def memory(self) -> Memory:
        """Returns two planes an image, and what a transform of one plane of rays needs."""
        pixels = 8 * self.steps.pixels[0] * self.steps.pixels[1] * self.rays[0].planes
        rays = max(one.ends.geometry.raster.rays for one in self.rays)
        return Memory((pixels, pixels), (48 * rays,) if self.blurred else ())


def _added(total: Any, values: Array, beam: Beam, steps: Steps) -> Any:
    """Returns a sum with what some rays add to it, where they weigh anything.

    A kernel of one line belongs to rays of which the pixels are one apart that way.
    """
    weights = beam.weights() if beam.scale else np.zeros((1, 1, 1))
    if not weights.any():
        return total
    down, across = (1 if n == 1 else b for n, b in zip(weights.shape[1:], steps.block, strict=True))
    part = weigh(values, weights, steps._replace(block=(down, across)))
    return part if total.ndim == 0 else total + part


@frozen
class PixelsSpec(Spec):
    """What pixels see: the sum of some weighted sums, of bands whose parts are put together."""

    parts: tuple[SumSpec, ...]
    split: Split
    sources: Sources
    reads = ("parts",)
    stage = "shading"

    @property
    def steps(self) -> Steps:
        """Returns how pixels lie among rays."""
        return self.parts[0].steps

    def run(self, device: Device, parts: Iterator[Pixels]) -> Pixels:
        """Returns depth and contrast."""
        del device
        first, *others = parts
        contrast = sum((other.contrast for other in others), start=first.contrast)
        return Pixels(self.split.depth(first.depth, self.sources), self.split.contrast(contrast))
