"""Fewer rays where neighbours share voxels: a lattice of rays and the edges of things are traced, the rest is interpolated.

At a distance many rays pass through the same voxels, so that the means of powers of delta along the path, M_k over its length,
vary little from one to the next. They are interpolated bilinearly within one thing seen; every ray keeps its own length.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import Device
from thzcl.paths import trace
from thzcl.paths.trace import Ends, Guard, Medium, Paths
from thzcl.surfaces.geometry import Raster

BETWEEN, LATTICE, ALONE = 0, 1, 2  # as in thinning.cl


def trace_thinned(
    device: Device,
    ends: Ends,
    medium: Medium,
    moments: int,
    guard: Guard | None,
    stride: int,
    things: NDArray[Any],
) -> Paths:
    """As trace.trace, every `stride`-th ray both ways.

    `things` (surface,) tells which surfaces are one thing.
    """
    raster, precision = ends.geometry.raster, str(ends.stretch.dtype)
    kind = _sift(device, ends, stride, things)
    lattice = lattice_rays(raster, stride)
    picked = np.concatenate([lattice, np.flatnonzero(kind.host()[: raster.rays] == ALONE)])
    followed = trace.follow(device, ends.geometry, picked)
    paths = trace.trace(device, ends, medium, moments, guard, precision, followed)
    return _spread(device, ends, paths, kind, picked, len(lattice), stride)


def lattice_rays(raster: Raster, stride: int) -> NDArray[np.int64]:
    """Numbers of the rays on the lattice, row by row."""
    rows, columns = (
        np.unique([*range(0, n, stride), n - 1]) for n in (raster.rows, raster.columns)
    )
    return np.asarray(rows[:, None] * raster.columns + columns, dtype=np.int64).ravel()


def _sift(device: Device, ends: Ends, stride: int, things: NDArray[Any]) -> Any:
    """Which rays are traced, on the device: kinds by ray."""
    raster, precision = ends.geometry.raster, str(ends.stretch.dtype)
    program = device.build(("paths/thinning",), precision, ["MOMENTS=1"])
    kind = device.empty((ends.rays,), np.int8)
    size = (np.int32(raster.columns), np.int32(raster.rows), np.int32(stride))
    program.run(
        "sift",
        ends.rays // device.lanes(precision),
        *size,
        ends.surface,
        ends.path_length,
        device.put(things, np.int32),
        kind,
    )
    return kind


def _spread(
    device: Device,
    ends: Ends,
    paths: Paths,
    kind: Any,
    picked: NDArray[Any],
    lattice: int,
    stride: int,
) -> Paths:
    """The moments of every ray."""
    raster, traced = ends.geometry.raster, paths.moments
    if traced is None:
        return paths
    precision, count = str(traced.dtype), len(traced)
    on_lattice = picked[:lattice]
    length = paths.path_length.host()[on_lattice]
    kept = length / ends.path_length.host()[on_lattice]
    means = traced.host()[:, :lattice] / np.maximum(length, np.finfo(length.dtype).tiny)
    slot = np.zeros(ends.rays, np.int32)
    slot[picked] = np.arange(len(picked))
    moments = device.empty((count, ends.rays), precision)
    program = device.build(("paths/thinning",), precision, [f"MOMENTS={count}"])
    program.run(
        "spread",
        ends.rays // device.lanes(precision),
        np.int32(raster.columns),
        np.int32(raster.rows),
        np.int32(stride),
        kind,
        device.put(slot),
        device.put(means),
        np.int32(-(-(raster.columns - 1) // stride) + 1),
        np.int32(lattice),
        device.put(kept),
        traced,
        np.int32(traced.shape[1]),
        paths.path_length,
        paths.surface,
        moments,
    )
    return replace(paths, moments=moments, between=kind.host() == BETWEEN)
