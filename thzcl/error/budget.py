"""The error budget of a run: some rays are computed again, without the shortcuts of a run.

Each shortcut is given its own part of the error. Rays are drawn from everything that the image
shows, in proportion, and root mean squares are over the image's pixels. The specs of the budget are
roots of the graph that makes the images; they read its cubes, ends and radiances.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air.expansion import Expansion, ExpansionSpec, TrimmedSpec
from thzcl.air.mean import Air
from thzcl.air.scattering import mean_transmission
from thzcl.air.weather import Weather
from thzcl.device.opencl import Device
from thzcl.error import twin
from thzcl.error.rays import FinePixels, FineWalkSpec, Walked, WalkSpec
from thzcl.error.twin import Absorber, Path
from thzcl.graph import Spec, Values, frozen
from thzcl.sensing.air_echo import AirEcho, Line
from thzcl.sensing.pixels import Pixels, Steps, SumSpec, weigh
from thzcl.sensing.spectrum import Spectrum, Split
from thzcl.sensing.transfer import Rays
from thzcl.sensing.weather import AnyRays
from thzcl.surfaces.radiance import Sources

Array = NDArray[np.float64]


class Part(NamedTuple):
    """The error of one shortcut: its root mean square over the pixels, and its maximum.

    `rms` and `max` are in kelvins of brightness temperature near the air's; for echoes they are
    parts of the power sent. `relative` is `rms` divided by the largest contrast in the image.
    """

    rms: float
    max: float
    relative: float


def worst(found: Iterable[Mapping[str, Part]]) -> dict[str, Part]:
    """Returns, for each part, the largest errors of several images."""
    largest: dict[str, Part] = {}
    for parts in found:
        for name, part in parts.items():
            largest[name] = Part(*map(max, part, largest.get(name, part)))
    return largest


@dataclass(frozen=True)
class Attenuated:
    """Light that the air of all ways attenuates, by the law of Beer and Lambert."""

    trips: int

    def contrast(
        self, absorber: Absorber, frequency_hz: Array, ways: tuple[Path, ...], source: Array
    ) -> Array:
        """Returns the contrast that reaches the camera from `source`, both (frequency, ray)."""
        del frequency_hz
        depth = sum(absorber.depth(way) for way in ways)
        return np.asarray(source * np.exp(-self.trips * depth))


@dataclass(frozen=True)
class Emitted:
    """Light that air of fluctuating temperature attenuates, and to which its emission adds.

    `veil` (frequency,) is the part of absorption, 1/m, that takes light and emits nothing here.
    """

    air_k: float
    veil: Values | None = None

    def contrast(
        self, absorber: Absorber, frequency_hz: Array, ways: tuple[Path, ...], source: Array
    ) -> Array:
        """Returns the contrast that reaches the camera from air and `source`, (frequency, ray)."""
        veil = np.zeros(len(frequency_hz)) if self.veil is None else self.veil.array
        return twin.emission(absorber, frequency_hz, self.air_k, ways[0], source, veil)


Transfer = Attenuated | Emitted


@frozen
class Light:
    """The float64 twin of what reaches the camera along given rays."""

    air: Air
    sources: Sources
    spectrum: Spectrum
    transfer: Transfer
    weather: Weather | None = None
    echo: AirEcho | None = None

    def planes(self, absorber: Absorber, walked: Walked, ways: tuple[Path, ...]) -> Array:
        """Returns the contrast that rays bring to the camera, (plane, ray)."""
        nodes = self.spectrum.nodes_hz.array
        source = self.sources.sent(nodes, walked.surface, walked.blend, walked.angles)
        contrast = self.transfer.contrast(absorber, nodes, ways, source)
        if self.weather is not None:
            contrast = contrast + self._scattered(self.weather, absorber, walked, ways[0])
        return np.asarray(self.spectrum.planes(contrast) * walked.gain)

    def _scattered(self, weather: Weather, absorber: Absorber, walked: Walked, way: Path) -> Array:
        """Returns what weather adds to rays, (frequency, ray), as a run has it but look-ups."""
        length = way.length.sum(axis=1)
        height = walked.start_m + walked.sine * length / 2
        source = weather.source(self.spectrum.nodes_hz.array, walked.sine, height)
        return np.asarray(source * length * mean_transmission(absorber.depth(way)))

    def scattering_error(self, absorber: Absorber, walked: Walked, way: Path) -> Array:
        """Returns the error of what weather adds to rays or sends back, (plane, ray).

        It is that of taking light as it comes in at a ray's mean height, and transmission as it is
        in even air, against a sum over the segments of each ray.
        """
        if self.weather is None:
            return self._echo_error(absorber, walked, way)
        nodes = self.spectrum.nodes_hz.array
        middle = np.cumsum(way.length, axis=1) - way.length / 2
        sine = np.broadcast_to(walked.sine[:, None], middle.shape)
        height = walked.start_m + sine * middle
        source = self.weather.source(nodes, sine.ravel(), height.ravel())
        source = source.reshape(len(nodes), *middle.shape)
        found = np.zeros((len(nodes), len(middle)))
        for number, per_m in enumerate(absorber.along(way)):
            tau = per_m * way.length
            through = np.exp(tau - np.cumsum(tau, axis=-1))
            found[number] = (through * source[number] * way.length * mean_transmission(tau)).sum(-1)
        error = self._scattered(self.weather, absorber, walked, way) - found
        return np.asarray(self.spectrum.planes(error) * walked.gain)

    def _echo_error(self, absorber: Absorber, walked: Walked, way: Path) -> Array:
        """Returns the error of what the air sends back, (plane, ray).

        It is that of attenuating light evenly along each ray, against a sum over its segments.
        """
        assert self.echo is not None  # noqa: S101 (asked only where something falls)
        nodes, ends = self.spectrum.nodes_hz.array, np.cumsum(way.length, axis=1)
        line = Line(ends[:, -1], walked.surface > 0, walked.sine, walked.start_m)
        near, far = self.echo.received(line)
        parts = np.maximum(near[:, None], ends - way.length), np.minimum(far[:, None], ends)
        error = np.zeros((len(nodes), len(ends)))
        for number, per_m in enumerate(absorber.along(way)):
            tau = per_m * way.length
            before = np.cumsum(tau, axis=1) - tau - per_m * (ends - way.length)
            back = self.echo.returned(number, nodes, per_m, line, parts)
            with np.errstate(over="ignore"):  # where nothing comes back
                true = np.where(back > 0, back * np.exp(-2 * before), 0.0).sum(axis=1)
            mean = np.divide(
                tau.sum(1), ends[:, -1], out=np.zeros(len(ends)), where=ends[:, -1] > 0
            )
            error[number] = self.echo.returned(number, nodes, mean, line, (near, far)) - true
        return np.asarray(self.spectrum.planes(error))

    def exact(self, expansion: Expansion) -> Absorber:
        """Returns the absorption of the air's own model, over the spans of an expansion."""
        spans = expansion.humidity_span, expansion.temperature_span
        return twin.exact(self.air, self.spectrum.nodes_hz.array, *spans)

    def per_unit(self) -> Array:
        """Returns the change of radiance for one kelvin near the air's temperature, (plane, 1)."""
        nodes = self.spectrum.nodes_hz.array
        return np.asarray(self.spectrum.planes(self.sources.per_unit(nodes)))[:, None]

    def part(self, error: Array, weight: Array, contrast: NDArray[np.floating]) -> Part:
        """Returns the numbers of an error (plane, ray), which are those of the worst plane.

        `weight` (ray,) is the part of the image that each ray stands for, and `contrast`
        (plane, ...) is the contrast of the image.
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
    """The errors of the shortcuts: some rays of the run are compared with their float64 twins."""

    rays: AnyRays
    walk: WalkSpec
    expansion: ExpansionSpec | TrimmedSpec
    light: Light
    resolved: Light  # with a band summed far more finely; equal to `light` without a band
    split: Split
    reads = ("rays", "walk", "expansion")
    stage = "error-budget"

    def run(
        self, device: Device, rays: Rays, walk: Walked, expansion: Expansion
    ) -> dict[str, Part]:
        """Returns the errors by part: arithmetic, surrogate, cut-off, band and so on."""
        del device
        light, span = self.light, expansion.humidity_span
        exact = light.exact(expansion)
        full = light.planes(exact, walk, walk.paths(span))
        cut, ways = _as_cut(rays, walk, walk.paths(span))
        ended = full if cut is walk else light.planes(exact, cut, ways)
        surrogate = twin.of_surrogate(expansion)
        fitted = light.planes(surrogate, cut, ways)
        evened, even = walk.evened(), fitted
        if evened is not None:
            even_cut, even_ways = _as_cut(rays, evened, evened.paths(span))
            even = light.planes(surrogate, even_cut, even_ways)
        contrast = self.split.contrast(rays.contrast)
        ran = contrast.reshape(len(contrast), -1)[:, walk.number]
        errors = {"arithmetic": ran - even, "surrogate": fitted - ended, "cut-off": ended - full}
        if evened is not None:
            errors["large-scales"] = even - fitted
        true = full
        if self.resolved != light:
            finer = self.resolved
            true = finer.planes(finer.exact(expansion), walk, walk.paths(span))
            errors["band-quadrature"] = full - true
        errors["total"] = ran - true
        if (
            light.weather is not None or light.echo is not None
        ):  # it comes on top: no setting mends it
            errors["scattering"] = light.scattering_error(exact, walk, walk.paths(span)[0])
        parts = {name: light.part(e, walk.weight, contrast) for name, e in errors.items()}
        if not rays.interpolated.any():
            return parts
        return parts | self._thinned(errors["arithmetic"], rays, walk)

    def _thinned(self, error: Array, rays: Rays, walk: Walked) -> dict[str, Part]:
        """Returns the error of interpolated rays, and that of the arithmetic for the others."""
        interpolated = rays.interpolated.ravel()[walk.number]
        contrast = self.split.contrast(rays.contrast)
        kinds = {"ray-stride": interpolated, "arithmetic": ~interpolated}
        return {
            name: self.light.part(error, walk.weight * some, contrast)
            for name, some in kinds.items()
        }


def _as_cut(rays: Rays, walk: Walked, ways: tuple[Path, ...]) -> tuple[Walked, tuple[Path, ...]]:
    """Returns walked rays, and their ways, cut off where the run ended them."""
    ended = (rays.shown.ravel()[walk.number] == 0) & (walk.surface != 0)
    if not ended.any():
        return walk, ways
    reached = [way.ravel()[walk.number].astype(np.float64) for way in rays.reached]
    cut = tuple(way.cut(length) for way, length in zip(ways, reached, strict=True))
    return walk.ended(ended), cut


@frozen
class SamplingSpec(Spec):
    """The error of sampling pixels: the change if their samples are doubled each way."""

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
        """Returns the error, by the name "pixel-sampling"."""
        del device
        walked = fine.walked
        ways = walked.paths(expansion.humidity_span)
        contrast = self.light.planes(self.light.exact(expansion), walked, ways)
        finely = contrast.reshape(len(contrast), len(fine.pixel), -1).mean(axis=2)
        mean = np.full((1, *self.steps.block), 1 / np.prod(self.steps.block))
        coarse = weigh(rays.contrast, mean, self.steps)
        error = coarse.reshape(len(coarse), -1)[:, fine.pixel] - finely
        return {"pixel-sampling": self.light.part(error, fine.weight, rays.contrast)}


@frozen
class LatticeErrorSpec(Spec):
    """The error of a lattice of rays under optics: the change with another lattice as fine.

    Pixels are weighted by their contrast, since thin things are seen by only a few of them, and
    pixels without contrast show no error.
    """

    lattice: SumSpec
    other: SumSpec
    light: Light
    split: Split
    reads = ("lattice", "other")
    stage = "error-budget"

    def run(self, device: Device, lattice: Pixels, other: Pixels) -> dict[str, Part]:
        """Returns the error, by the name "pixel-sampling".

        It is the difference over the square root of 2, since the errors of the two lattices are
        independent and equal on average.
        """
        del device
        one, another = (self.split.contrast(pixels.contrast) for pixels in (lattice, other))
        error = ((one - another) / np.sqrt(2)).reshape(len(one), -1)
        weight = np.abs(one).reshape(len(one), -1).mean(axis=0)
        return {"pixel-sampling": self.light.part(error, weight, one)}
