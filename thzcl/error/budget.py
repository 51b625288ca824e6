"""The error budget of a run: some of its rays again, without what makes the run fast, and what each shortcut cost.

Rays are drawn from everything that the image shows, in proportion; the root mean square is over the image's pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import radiometry
from thzcl.air.expansion import NOWHERE, Span, possible
from thzcl.air.mean import Air
from thzcl.device.opencl import Device
from thzcl.error import reference
from thzcl.error.reference import Absorber, Path
from thzcl.paths import trace
from thzcl.plan.compute import Capture, Lines
from thzcl.plan.numerics import sources
from thzcl.plan.plan import VariantPlan, normalised, sample_rays
from thzcl.sensing import optics
from thzcl.sensor import Echoes, Radiances
from thzcl.surfaces import geometry
from thzcl.surfaces.geometry import ROTATIONS, Raster
from thzcl.turbulence.cube import Field

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

RAYS = 200  # that are followed again
PIXELS = 32  # whose samples are doubled
WORK = 60_000  # segments, times frequencies where temperature fluctuates, beyond which fewer rays must do
FEWEST = 8


class Part(NamedTuple):
    """The error that one shortcut makes: over the pixels, at most.

    And relative to the largest contrast in the image.
    """

    rms: float
    max: float
    relative: float


@dataclass(frozen=True)
class Rays:
    """Rays that are followed again: their numbers, weights of sum 1, and where they end.

    As the device found it.
    """

    number: Integers
    weight: Array
    surface: NDArray[np.int32]
    blend: Array
    ways: tuple[Path, ...]  # from the camera, and from a transmitter of its own


def measure(
    device: Device,
    cube: Field | None,
    lines: Lines,
    captures: Sequence[Capture],
    sights: Sequence[Radiances | Echoes],
    seed: int,
) -> dict[str, Part]:
    """The errors of variants that share a trace, by part; the worst of them, in K or as a part of the power sent.

    `captures` are those of the first time at which each pixel is taken, `sights` what became of them.
    """
    first = captures[0].variant
    rng = np.random.Generator(np.random.Philox(key=[seed, 1]))
    rays = _drawn(first, cube, lines, rng)
    found = [_Compared(cube, rays, capture).parts() for capture in captures]
    if first.geometry.raster.margin == 0 and first.needs.optics is None:
        fine = _doubled(device, first, cube, captures[0], rng)
        found += [
            _sampling(cube, *fine, capture, sight)
            for capture, sight in zip(captures, sights, strict=True)
        ]
    return worst(found)


def worst(found: Iterable[Mapping[str, Part]]) -> dict[str, Part]:
    """Part by part the largest."""
    merged: dict[str, Part] = {}
    for parts in found:
        for name, part in parts.items():
            merged[name] = Part(*map(max, part, merged.get(name, part)))
    return merged


def _drawn(
    variant: VariantPlan, cube: Field | None, lines: Lines, rng: np.random.Generator
) -> Rays:
    """Rays of the image's frame, from each thing that it shows as many as it has a share in it.

    But some of each.
    """
    raster = variant.geometry.raster
    inside = optics.frame(
        raster, np.arange(raster.rays).reshape(raster.rows, raster.columns)
    ).ravel()
    surface = lines.camera.surface.host()[: raster.rays]
    things = np.array([s.target for s in variant.surfaces])[surface[inside]]
    rows = [
        np.flatnonzero(things == thing) for thing in sorted({s.target for s in variant.surfaces})
    ]
    count = _affordable(variant, cube)
    picks, weights = [], []
    for members in filter(len, rows):
        n = min(len(members), max(count // 8, round(count * len(members) / len(inside)), 2))
        picks.append(inside[rng.choice(members, n, replace=False)])
        weights.append(np.full(n, len(members) / len(inside) / n))
    number = np.concatenate(picks)
    return _followed(variant, cube, lines, number, np.concatenate(weights), number)


def _affordable(variant: VariantPlan, cube: Field | None) -> int:
    """How many rays can be followed again at little cost."""
    if cube is None:
        return RAYS
    each = 1.7 * float(sample_rays(variant.geometry).length.mean()) / cube.voxel_m + 3
    each *= 1 if variant.isothermal else 2 * len(variant.frequency_hz)
    return int(np.clip(WORK / each, FEWEST, RAYS))


def _followed(
    variant: VariantPlan,
    cube: Field | None,
    lines: Lines,
    number: Integers,
    weight: Array,
    slots: Integers,
) -> Rays:
    """Rays by number, walked through the cube.

    `slots` says where among the lines their ends are found.
    """
    shape = lines.camera.geometry
    direction = geometry.directions(
        shape, number // shape.raster.columns, number % shape.raster.columns
    )
    norm = np.linalg.norm(direction, axis=1)
    reach = lines.camera.reach.host()[slots].astype(np.float64)
    here, hit = shape.frame[0], shape.frame[0] + reach[:, None] * direction
    ways = [
        _walk(variant, cube, here, direction / norm[:, None], reach * norm, number, shape.raster)
    ]
    surface = lines.camera.surface.host()[slots]
    if lines.outgoing is not None and variant.needs.transmitter_m is not None:
        surface = np.where(lines.outgoing.surface.host()[slots] > 0, surface, 0)
        start = np.array(variant.needs.transmitter_m)
        away = hit - start
        length = np.linalg.norm(away, axis=1)
        ways.append(
            _walk(variant, cube, start, away / length[:, None], length, number, shape.raster)
        )
    textured = len(lines.camera.blend) > 1
    blend = (
        lines.camera.blend.host()[slots].astype(np.float64) if textured else np.zeros(len(slots))
    )
    return Rays(number, weight, surface, blend, tuple(ways))


def _walk(
    variant: VariantPlan,
    cube: Field | None,
    start: Array,
    direction: Array,
    length: Array,
    number: Integers,
    raster: Raster,
) -> Path:
    if cube is None:
        return Path(length[:, None], np.zeros((len(length), 1)), None, NOWHERE)
    turn = ROTATIONS[variant.orientation].T
    origin = np.broadcast_to(start, direction.shape)
    if variant.times_s is not None:
        row, column = (
            (n - raster.margin) // b
            for n, b in zip(divmod(number, raster.columns), raster.block, strict=True)
        )
        origin = origin - variant.times_s[0, row, column][:, None] * variant.wind_m_s
    placed = np.mod(origin @ turn / cube.voxel_m, cube.grid)
    lengths, voxel = reference.walk(placed, direction @ turn, length, cube.voxel_m, cube.grid)
    delta, offset = (
        None if b is None else b.host().ravel()[voxel].astype(np.float64)
        for b in (cube.delta, cube.offset)
    )
    return Path(
        lengths, np.asarray(delta), offset, possible(variant.surrogate.air, cube.humidity_span)
    )


@dataclass(frozen=True)
class _Air:
    """The air along rays for one set of frequencies."""

    cube: Field | None
    variant: VariantPlan
    frequency_hz: Array

    def exact(self) -> Absorber:
        """Without a surrogate."""
        spans = (
            (NOWHERE, NOWHERE)
            if self.cube is None
            else (self.cube.humidity_span, self.cube.temperature_span)
        )
        return _exact(self.variant.surrogate.air, tuple(self.frequency_hz), *spans)

    def contrast(
        self, absorber: Absorber, rays: Rays, ways: Sequence[Path], surface: NDArray[np.int32]
    ) -> Array:
        """(frequency, ray) of what the camera gets."""
        variant = self.variant
        table = sources(variant.scene, variant.needs, variant.surfaces, self.frequency_hz)
        behind = np.minimum(surface + 1, len(table) - 1)
        source = (table[surface] + rays.blend[:, None] * (table[behind] - table[surface])).T
        if not variant.isothermal and not variant.needs.reflection:
            air_k = variant.scene.atmosphere.temperature_k
            return reference.emission(absorber, self.frequency_hz, air_k, ways[0], source)
        trips = 2 if variant.needs.reflection and len(ways) == 1 else 1
        return np.asarray(
            source * np.exp(-trips * sum(reference.depth(absorber, way) for way in ways))
        )


@lru_cache(maxsize=8)
def _exact(
    air: Air, frequency_hz: tuple[float, ...], humidity_span: Span, temperature_span: Span
) -> Absorber:
    """The same for all variants in one air."""
    return reference.exact(air, np.array(frequency_hz), humidity_span, temperature_span)


@dataclass(frozen=True)
class _Compared:
    """The rays of one variant, as the run had them and without one shortcut after the other."""

    cube: Field | None
    rays: Rays
    capture: Capture

    def parts(self) -> dict[str, Part]:
        """Errors by part."""
        variant, rays, capture = self.capture.variant, self.rays, self.capture
        air = _Air(self.cube, variant, variant.frequency_hz)
        exact = air.exact()
        full = self._bands(air.contrast(exact, rays, rays.ways, rays.surface))
        ran = capture.contrast.reshape(len(capture.contrast), -1)[:, rays.number]
        ways, surface = self._as_cut()
        cut = (
            full
            if surface is rays.surface
            else self._bands(air.contrast(exact, rays, ways, surface))
        )
        fitted = self._bands(
            air.contrast(reference.of_surrogate(capture.surrogate), rays, ways, surface)
        )
        apart = None if capture.between is None else capture.between.ravel()[rays.number]
        errors = {"arithmetic": ran - fitted, "surrogate": fitted - cut, "cut-off": cut - full}
        total = ran - full
        if variant.needs.finer is not None:
            resolved = self._finer(variant)
            errors["band-quadrature"] = full - resolved
            total = ran - resolved
        parts = {name: self._part(error) for name, error in errors.items()}
        if apart is not None:
            parts["ray-stride"] = self._part(errors["arithmetic"], apart)
            parts["arithmetic"] = self._part(errors["arithmetic"], ~apart)
        return parts | {"total": self._part(total)}

    def _as_cut(self) -> tuple[Sequence[Path], NDArray[np.int32]]:
        """The rays as far as the run followed them."""
        number, shown = self.rays.number, self.capture.surface.ravel()
        lengths = (
            self.capture.path_length.ravel()[number],
            self.capture.outgoing_length.ravel()[number],
        )
        ended = (shown[number] == 0) & (self.rays.surface != 0)
        if not ended.any():
            return self.rays.ways, self.rays.surface
        ways = [
            way.cut(length.astype(np.float64))
            for way, length in zip(self.rays.ways, lengths, strict=False)
        ]
        return ways, np.where(ended, np.int32(0), self.rays.surface)

    def _bands(self, contrast: Array) -> Array:
        weights = self.capture.variant.weights
        return contrast if weights is None else np.asarray(weights @ contrast)

    def _finer(self, variant: VariantPlan) -> Array:
        """In bands summed over many more frequencies."""
        assert variant.needs.finer is not None  # noqa: S101 (the caller looked)
        frequency_hz, weights = (
            np.asarray(values, dtype=np.float64) for values in variant.needs.finer
        )
        air = _Air(self.cube, variant, frequency_hz)
        return np.asarray(
            normalised(weights)
            @ air.contrast(air.exact(), self.rays, self.rays.ways, self.rays.surface)
        )

    def _part(self, error: Array, some: NDArray[np.bool_] | None = None) -> Part:
        return part(
            self.capture, error, self.rays.weight if some is None else self.rays.weight * some
        )


def part(capture: Capture, error: Array, weight: Array) -> Part:
    """The error (band, ray) of a variant in numbers: the worst band's."""
    if not weight.any():
        return Part(0.0, 0.0, 0.0)
    scale = _kelvin(capture.variant)[:, None]
    used = np.abs(error[:, weight > 0]) / scale
    rms = np.sqrt(used**2 @ (weight[weight > 0] / weight.sum()))
    contrast = np.abs(capture.contrast).reshape(len(error), -1).max(axis=1) / scale[:, 0]
    relative = np.divide(rms, contrast, out=np.zeros_like(rms), where=contrast > 0)
    return Part(float(rms.max()), float(used.max()), float(relative.max()))


def _kelvin(variant: VariantPlan) -> Array:
    """Radiance to a kelvin of the air's brightness, by band; 1 for echoes.

    Which are parts of the power sent.
    """
    if variant.needs.reflection:
        return np.ones(
            len(variant.frequency_hz) if variant.weights is None else len(variant.weights)
        )
    slope = radiometry.planck_slope(variant.frequency_hz, variant.scene.atmosphere.temperature_k)
    return slope if variant.weights is None else np.asarray(variant.weights @ slope)


def _doubled(
    device: Device,
    variant: VariantPlan,
    cube: Field | None,
    capture: Capture,
    rng: np.random.Generator,
) -> tuple[Rays, Integers, Array]:
    """Pixels with twice as many samples each way: their rays, the pixels' numbers, and weights of sum 1.

    Half of them lie where a pixel's neighbours show something else.
    """
    raster = variant.geometry.raster
    rows, columns = raster.block
    shown = capture.surface[rows // 2 :: rows, columns // 2 :: columns]
    edge = np.zeros(shown.shape, dtype=bool)
    for axis in (0, 1):
        change = np.diff(shown, axis=axis) != 0
        ahead, behind = ((slice(1, None), slice(None)), (slice(None, -1), slice(None)))
        edge[ahead if axis == 0 else ahead[::-1]] |= change
        edge[behind if axis == 0 else behind[::-1]] |= change
    most = max(2, min(PIXELS, _affordable(variant, cube) // (4 * rows * columns)))
    pixels, weights = [], []
    for members in (np.flatnonzero(edge), np.flatnonzero(~edge)):
        n = min(len(members), most // 2)
        pixels.append(rng.choice(members, n, replace=False))
        weights.append(np.full(n, len(members) / edge.size / max(n, 1)))
    pixel = np.concatenate(pixels)
    fine = replace(
        raster, rows=2 * raster.rows, columns=2 * raster.columns, block=(2 * rows, 2 * columns)
    )
    shape = replace(
        variant.geometry, raster=fine, frame=geometry.camera_frame(variant.scene.camera, fine)
    )
    row, column = (n[:, None, None] for n in divmod(pixel, shown.shape[1]))
    within = np.arange(2 * rows)[None, :, None], np.arange(2 * columns)[None, None, :]
    number = (
        (row * 2 * rows + within[0]) * fine.columns + column * 2 * columns + within[1]
    ).ravel()
    ends = trace.find_ends(device, shape, variant.precision, cosine=False, picked=number)
    out = variant.needs.transmitter_m
    lines = Lines(
        ends, None if out is None else trace.outgoing_ends(device, ends, out, variant.precision)
    )
    rays = _followed(variant, cube, lines, number, np.ones(len(number)), np.arange(len(number)))
    return rays, pixel, np.concatenate(weights)


def _sampling(
    cube: Field | None,
    rays: Rays,
    pixel: Integers,
    weight: Array,
    capture: Capture,
    sight: Radiances | Echoes,
) -> dict[str, Part]:
    """What doubling a pixel's samples each way changes."""
    variant = capture.variant
    air = _Air(cube, variant, variant.frequency_hz)
    contrast = air.contrast(air.exact(), rays, rays.ways, rays.surface)
    if variant.weights is not None:
        contrast = variant.weights @ contrast
    fine = contrast.reshape(len(contrast), len(pixel), -1).mean(axis=2)
    had = sight.returned if isinstance(sight, Echoes) else sight.contrast
    return {"pixel-sampling": part(capture, had.reshape(len(had), -1)[:, pixel] - fine, weight)}
