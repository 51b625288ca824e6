"""The error budget of a run: some of its rays again, without what makes the run fast.

Each shortcut is blamed for its own part. Rays are drawn from everything that the image shows, in
proportion; root mean squares are over the image's pixels. The specs here are roots of the graph
that made the images, and read its fields, ends and shadings.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, ExpansionSpec, TrimmedSpec
from thzcl.air.mean import Air
from thzcl.device.opencl import Device
from thzcl.error import twin
from thzcl.error.rays import FinePixels, FineWalkSpec, Walked, WalkSpec
from thzcl.error.twin import Absorber, Path
from thzcl.graph import Spec, frozen
from thzcl.sensing.pixels import Pixels, Steps, SumSpec, weigh
from thzcl.sensing.spectrum import Spectrum
from thzcl.sensing.transfer import AnyRays, CarriedSpec, Rays, ShadeSpec
from thzcl.surfaces.radiance import Sources

Array = NDArray[np.float64]


class Part(NamedTuple):
    """The error that one shortcut makes: over the pixels, at most, and over the contrast.

    `rms` and `max` are in kelvins of the air's brightness (of echoes: parts of the power sent),
    `relative` is rms over the largest contrast in the image.
    """

    rms: float
    max: float
    relative: float


def worst(found: Iterable[Mapping[str, Part]]) -> dict[str, Part]:
    """Returns part by part the largest."""
    merged: dict[str, Part] = {}
    for parts in found:
        for name, part in parts.items():
            merged[name] = Part(*map(max, part, merged.get(name, part)))
    return merged


@dataclass(frozen=True)
class Attenuated:
    """What surfaces send, less what the air of all ways takes: Beer and Lambert."""

    trips: int

    def contrast(
        self, absorber: Absorber, frequency_hz: Array, ways: tuple[Path, ...], source: Array
    ) -> Array:
        """Returns what reaches the camera of `source`, both (frequency, ray)."""
        del frequency_hz
        depth = sum(twin.depth(absorber, way) for way in ways)
        return np.asarray(source * np.exp(-self.trips * depth))


@dataclass(frozen=True)
class Emitted:
    """What surfaces send and what air of fluctuating temperature adds."""

    air_k: float

    def contrast(
        self, absorber: Absorber, frequency_hz: Array, ways: tuple[Path, ...], source: Array
    ) -> Array:
        """Returns what reaches the camera, `source` being the surfaces', (frequency, ray)."""
        return twin.emission(absorber, frequency_hz, self.air_k, ways[0], source)


Transfer = Attenuated | Emitted


@frozen
class Light:
    """What reaches the camera along given rays, in float64."""

    air: Air
    sources: Sources
    spectrum: Spectrum
    transfer: Transfer

    def planes(self, absorber: Absorber, walked: Walked, ways: tuple[Path, ...]) -> Array:
        """Returns contrast, (plane, ray)."""
        nodes, surface = self.spectrum.nodes_hz.array, walked.surface
        table = self.sources.table(nodes)
        behind = np.minimum(surface + 1, len(table) - 1)
        blend = walked.blend[:, None]
        source = (table[surface] + blend * (table[behind] - table[surface])).T
        seen = self.transfer.contrast(absorber, nodes, ways, source)
        return np.asarray(self.spectrum.planes(seen) * walked.gain)

    def exact(self, expansion: Expansion) -> Absorber:
        """Returns absorption without a polynomial, over what an expansion covers."""
        spans = expansion.humidity_span, expansion.temperature_span
        return twin.exact(self.air, self.spectrum.nodes_hz.array, *spans)

    def per_unit(self) -> Array:
        """Returns radiance to a kelvin of the air's brightness, (plane, 1)."""
        nodes = self.spectrum.nodes_hz.array
        return np.asarray(self.spectrum.planes(self.sources.per_unit(nodes)))[:, None]

    def part(self, error: Array, weight: Array, contrast: NDArray[np.floating]) -> Part:
        """Returns an error (plane, ray) in numbers: the worst plane's.

        `weight` (ray,) says how much of the image each ray stands for; `contrast` (plane, ...) is
        the image's.
        """
        if not weight.any():
            return Part(0.0, 0.0, 0.0)
        unit = self.per_unit()
        used = np.abs(error[:, weight > 0]) / unit
        rms = np.sqrt(used**2 @ (weight[weight > 0] / weight.sum()))
        largest = np.abs(contrast).reshape(len(error), -1).max(axis=1) / unit[:, 0]
        relative = np.divide(rms, largest, out=np.zeros_like(rms), where=largest > 0)
        return Part(float(rms.max()), float(used.max()), float(relative.max()))


@frozen
class ErrorSpec(Spec):
    """What each shortcut of a shading cost: the rays as the run had them, and without it."""

    rays: ShadeSpec | CarriedSpec
    walk: WalkSpec
    expansion: ExpansionSpec | TrimmedSpec
    light: Light
    resolved: Light  # a band summed far more finely; the same light where there is no band
    reads = ("rays", "walk", "expansion")
    stage = "error-budget"

    def run(
        self, device: Device, rays: Rays, walk: Walked, expansion: Expansion
    ) -> dict[str, Part]:
        """Returns errors by part."""
        del device
        light, span = self.light, expansion.humidity_span
        exact = light.exact(expansion)
        full = light.planes(exact, walk, walk.paths(span))
        cut, ways = _as_cut(rays, walk, walk.paths(span))
        ended = full if cut is walk else light.planes(exact, cut, ways)
        fitted = light.planes(twin.of_surrogate(expansion), cut, ways)
        ran = rays.contrast.reshape(len(rays.contrast), -1)[:, walk.number]
        errors = {"arithmetic": ran - fitted, "surrogate": fitted - ended, "cut-off": ended - full}
        true = full
        if self.resolved != light:
            finer = self.resolved
            true = finer.planes(finer.exact(expansion), walk, walk.paths(span))
            errors["band-quadrature"] = full - true
        errors["total"] = ran - true
        parts = {name: light.part(e, walk.weight, rays.contrast) for name, e in errors.items()}
        return parts | self._thinned(errors["arithmetic"], rays, walk)

    def _thinned(self, error: Array, rays: Rays, walk: Walked) -> dict[str, Part]:
        """Returns the error of interpolated rays, and the arithmetic's of the others."""
        apart = rays.interpolated.ravel()[walk.number]
        if not rays.interpolated.any():
            return {}
        kinds = {"ray-stride": apart, "arithmetic": ~apart}
        return {
            name: self.light.part(error, walk.weight * some, rays.contrast)
            for name, some in kinds.items()
        }


def _as_cut(rays: Rays, walk: Walked, ways: tuple[Path, ...]) -> tuple[Walked, tuple[Path, ...]]:
    """Returns walked rays, and their ways, as far as the run followed them."""
    ended = (rays.shown.ravel()[walk.number] == 0) & (walk.surface != 0)
    if not ended.any():
        return walk, ways
    reached = [way.ravel()[walk.number].astype(np.float64) for way in rays.reached]
    cut = tuple(way.cut(length) for way, length in zip(ways, reached, strict=True))
    return walk.ended(ended), cut


@frozen
class SamplingSpec(Spec):
    """What doubling a pixel's samples each way changes."""

    rays: AnyRays
    fine: FineWalkSpec
    expansion: ExpansionSpec | TrimmedSpec
    light: Light
    steps: Steps
    reads = ("rays", "fine", "expansion")
    stage = "error-budget"

    def run(
        self, device: Device, rays: Rays, fine: FinePixels, expansion: Expansion
    ) -> dict[str, Part]:
        """Returns the error as "pixel-sampling"."""
        del device
        walked = fine.walked
        ways = walked.paths(expansion.humidity_span)
        contrast = self.light.planes(self.light.exact(expansion), walked, ways)
        finely = contrast.reshape(len(contrast), len(fine.pixel), -1).mean(axis=2)
        mean = np.full((1, *self.steps.block), 1 / np.prod(self.steps.block))
        had = weigh(rays.contrast, mean, self.steps)
        error = had.reshape(len(had), -1)[:, fine.pixel] - finely
        return {"pixel-sampling": self.light.part(error, fine.weight, rays.contrast)}


@frozen
class LatticeErrorSpec(Spec):
    """What another lattice of rays, as fine, changes where optics blur what surfaces show.

    Pixels are weighed by the contrast that they show: thin things are seen by a few pixels, and
    what is dark shows no error.
    """

    lattice: SumSpec
    other: SumSpec
    light: Light
    reads = ("lattice", "other")
    stage = "error-budget"

    def run(self, device: Device, lattice: Pixels, other: Pixels) -> dict[str, Part]:
        """Returns the error as "pixel-sampling": of two alike, that of one."""
        del device
        planes = len(lattice.contrast)
        error = ((lattice.contrast - other.contrast) / np.sqrt(2)).reshape(planes, -1)
        weight = np.abs(lattice.contrast).reshape(planes, -1).mean(axis=0)
        return {"pixel-sampling": self.light.part(error, weight, lattice.contrast)}


def merged(found: Iterator[Mapping[str, Part]]) -> dict[str, Part]:
    """Returns the parts of one image, from all the specs that look at it."""
    return {name: part for parts in found for name, part in parts.items()}
