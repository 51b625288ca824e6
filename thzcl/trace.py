"""From geometry and field to what reaches the camera: surfaces, path moments, shading; and emission along the path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import radiometry
from thzcl.absorption import Surrogate
from thzcl.device import GROUP, Buffer, Device
from thzcl.geometry import Geometry
from thzcl.plan import DEPTH_CHECKED_EVERY, EMISSION_AT_ONCE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Medium:
    """The cube that rays cross: fluctuations on the device, and the camera's frame in its voxels.

    `delta` is rho / rho_mean - 1, `offset` the temperature's departure from the mean in K (None in isothermal air), within
    `temperature_span`; `frame` is as Geometry.frame, in voxels, its origin within the cube of `grid` voxels.
    """

    delta: Buffer
    offset: Buffer | None
    temperature_span: tuple[float, float]
    frame: Array
    grid: int


@dataclass(frozen=True)
class Ends:
    """Where the rays end, on the device; arrays are padded to whole groups of packets.

    `reach` is in the ray's parameter, `stretch` metres per unit of it, `path_length` in metres, `surface` a number.
    """

    geometry: Geometry
    reach: Buffer
    stretch: Buffer
    path_length: Buffer
    surface: Buffer

    @property
    def rays(self) -> int:
        """With the padding."""
        return self.reach.shape[0]


@dataclass(frozen=True)
class Paths:
    """What the rays went through: `moments` (k, ray) in metres, k = 1 and up; none in uniform air.

    `path_length` and `surface` are those of the ends, but for rays that the cut-off ended sooner.
    """

    geometry: Geometry
    path_length: Buffer
    surface: Buffer
    moments: Buffer | None
    segments: int  # voxels crossed over positive length


@dataclass(frozen=True)
class Guard:
    """When a ray ends: the smallest depth over the frequencies, as coefficients of the moments in 1/m, and its limit."""

    coefficients: tuple[float, ...]
    depth: float


@dataclass(frozen=True)
class Shaded:
    """On the host, padding removed: (frequency, row, column) of the raster of rays, or (row, column)."""

    optical_depth: NDArray[Any]
    contrast: NDArray[Any]  # W m-2 sr-1 Hz-1 above the mean air's radiance
    path_length: NDArray[Any]  # m
    surface: NDArray[Any]


def find_ends(device: Device, geometry: Geometry, precision: str) -> Ends:
    """Where every ray ends: the nearest surface, or max_range_m."""
    packet = device.lanes(precision) * GROUP
    padded = -(-geometry.raster.rays // packet) * packet
    options = [name for name, needed in (("GROUND", geometry.ground), ("BOXES", len(geometry.boxes))) if needed]
    program = device.build(("camera", "surfaces"), precision, options)
    ends = Ends(
        geometry,
        device.empty((padded,), device.wide),
        device.empty((padded,), precision),
        device.empty((padded,), precision),
        device.empty((padded,), np.int32),
    )
    boxes = device.put(geometry.boxes if len(geometry.boxes) else np.zeros((1, 8)), device.wide)
    stripes = device.put(geometry.stripes if len(geometry.boxes) else np.zeros((6, 2)), np.int32)
    program.run(
        "surfaces",
        padded,
        device.put(geometry.frame, device.wide),
        *_size(geometry),
        device.wide.type(geometry.max_range_m),
        boxes,
        stripes,
        np.int32(len(geometry.boxes)),
        ends.reach,
        ends.stretch,
        ends.path_length,
        ends.surface,
    )
    return ends


def trace(device: Device, ends: Ends, medium: Medium, moments: int, guard: Guard | None, precision: str) -> Paths:
    """The path moments of every ray; a guarded ray stops past its depth, keeps its path so far, and meets nothing."""
    path_length, surface = _own_ends(device, ends, guard)
    program = device.build(("camera", "march", "trace"), precision, _options(guard, MOMENTS=moments))
    out = device.empty((moments, ends.rays), precision)
    segments = device.empty((ends.rays // device.lanes(precision),), np.int32)
    limit = guard or Guard((0.0,) * (moments + 1), np.inf)
    program.run(
        "trace",
        len(segments),
        medium.delta,
        *_placed(device, ends, medium),
        path_length,
        surface,
        out,
        segments,
        device.put(np.array(limit.coefficients), precision),
        np.dtype(precision).type(limit.depth),
    )
    return Paths(ends.geometry, path_length, surface, out, int(segments.host().sum(dtype=np.int64)))


def straight(ends: Ends) -> Paths:
    """Paths through uniform air: their length is all that counts."""
    return Paths(ends.geometry, ends.path_length, ends.surface, None, 0)


def shade(device: Device, paths: Paths, surrogate: Surrogate, emitted: Array, precision: str) -> Shaded:
    """Optical depth and contrast of isothermal air; `emitted` (surface, frequency) is L_surface - B_air."""
    moments, rays = paths.moments, len(paths.path_length)
    program = device.build(("shade",), precision, (f"MOMENTS={0 if moments is None else len(moments)}",))
    count = len(surrogate.frequency_hz)
    depth, contrast = (device.empty((count, rays), precision) for _ in range(2))
    program.run(
        "shade",
        rays // device.lanes(precision),
        paths.path_length,
        paths.path_length if moments is None else moments,
        paths.surface,
        device.put(surrogate.coefficients[:, :, 0], precision),
        device.put(emitted, precision),
        np.int32(count),
        depth,
        contrast,
    )
    return _shaded(paths.geometry, [depth], [contrast], paths.path_length, paths.surface)


def trace_emission(
    device: Device,
    ends: Ends,
    medium: Medium,
    surrogate: Surrogate,
    emitted: Array,
    cutoff: float | None,
    precision: str,
) -> tuple[Shaded, int]:
    """Optical depth and contrast where temperature fluctuates, and the voxels crossed; the path's own emission included."""
    depths, contrasts, crossed = [], [], 0
    path_length, surface = _own_ends(device, ends, cutoff)
    planck = _planck_powers(surrogate, medium.temperature_span)
    for first in range(0, len(surrogate.frequency_hz), EMISSION_AT_ONCE):
        some = slice(first, first + EMISSION_AT_ONCE)
        tables = surrogate.coefficients[some], planck[some], emitted[:, some]
        depth, contrast, segments = _emission_pass(device, ends, medium, tables, cutoff, path_length, surface, precision)
        depths.append(depth)
        contrasts.append(contrast)
        crossed += int(segments.host().sum(dtype=np.int64))
    return _shaded(ends.geometry, depths, contrasts, path_length, surface), crossed


def _emission_pass(
    device: Device,
    ends: Ends,
    medium: Medium,
    tables: tuple[Array, Array, Array],
    cutoff: float | None,
    path_length: Buffer,
    surface: Buffer,
    precision: str,
) -> tuple[Buffer, Buffer, Buffer]:
    """One pass through the cube; `tables` are absorption and Planck coefficients, and what the surfaces emit."""
    (count, powers_d, powers_t), powers_b = tables[0].shape, tables[1].shape[1]
    options = _options(cutoff, FREQUENCIES=count, HUMIDITY_POWERS=powers_d, TEMPERATURE_POWERS=powers_t, PLANCK_POWERS=powers_b)
    program = device.build(("camera", "march", "emission"), precision, options)
    depth, contrast = (device.empty((count, ends.rays), precision) for _ in range(2))
    segments = device.empty((ends.rays // device.lanes(precision),), np.int32)
    program.run(
        "emission",
        len(segments),
        medium.delta,
        medium.offset,
        *_placed(device, ends, medium),
        path_length,
        surface,
        *(device.put(table, precision) for table in tables),
        np.dtype(precision).type(cutoff or np.inf),
        segments,
        depth,
        contrast,
    )
    return depth, contrast, segments


def _planck_powers(surrogate: Surrogate, span: tuple[float, float]) -> Array:
    """B(T_mean + t) - B(T_mean) in powers of t over a span, (frequency, power), to 1e-8 of its largest value or better."""
    low, high = min(span[0], 0.0), max(span[1], 0.0)
    largest = max(-low, high)
    t = (low + high) / 2 + (high - low) / 2 * np.cos((np.arange(12) + 0.5) * np.pi / 12)
    mean_k = surrogate.air.temperature_k
    values = radiometry.planck_difference(surrogate.frequency_hz[:, None], mean_k + t, mean_k) / t
    # The slope is fitted, and multiplied by t: the difference is exactly 0 at t = 0.
    fits = [np.polynomial.Polynomial.fit(t / largest, v, 6, domain=[-1, 1], window=[-1, 1]).coef for v in values]
    return np.array([[0.0, *(np.asarray(c, dtype=np.float64) / largest ** np.arange(7))] for c in fits])


def _options(guarded: object, **numbers: int) -> list[str]:
    return [f"{name}={value}" for name, value in numbers.items()] + ([f"CUTOFF={DEPTH_CHECKED_EVERY}"] if guarded else [])


def _size(geometry: Geometry) -> tuple[np.int32, np.int32]:
    return np.int32(geometry.raster.columns), np.int32(geometry.raster.rows)


def _placed(device: Device, ends: Ends, medium: Medium) -> tuple[object, ...]:
    """The kernel arguments that place the rays in the cube and say how far they reach."""
    frame, log2n = device.put(medium.frame, device.wide), np.int32(medium.grid.bit_length() - 1)
    return frame, *_size(ends.geometry), log2n, ends.reach, ends.stretch


def _own_ends(device: Device, ends: Ends, cut: object) -> tuple[Buffer, Buffer]:
    """Path lengths and surfaces that a trace may change, where the cut-off can end its rays."""
    if not cut:
        return ends.path_length, ends.surface
    return device.put(ends.path_length.host()), device.put(ends.surface.host())


def _shaded(geometry: Geometry, depths: list[Buffer], contrasts: list[Buffer], path_length: Buffer, surface: Buffer) -> Shaded:
    shape = (geometry.raster.rows, geometry.raster.columns)

    def image(parts: list[Buffer]) -> NDArray[Any]:
        arrays = [part.host()[..., : geometry.raster.rays] for part in parts]
        joined = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
        return joined.reshape(*joined.shape[:-1], *shape)

    return Shaded(image(depths), image(contrasts), image([path_length]), image([surface]))
