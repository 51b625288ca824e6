"""Traces fewer rays where neighbours share voxels: those of a lattice, and those at edges.

At a distance many rays pass through the same voxels, so that the means of powers of delta along the
path, M_k over its length, vary little from one ray to the next. Between lattice rays that meet the
same target these means are interpolated bilinearly. Each ray keeps its own length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Buffer, Device
from thzcl.paths import trace
from thzcl.paths.trace import Guard, Medium, Paths
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.ends import RayEnds, follow, raster_size

BETWEEN, ALONE = 0, 2  # kinds of rays, as in thinning.cl: interpolated, traced off the lattice


@dataclass(frozen=True)
class ThinningKernels(Kernels):
    """The kernels that choose the rays to trace, and interpolate the others."""

    files: ClassVar = ("paths/thinning",)

    moments: int


def trace_thinned(
    device: Device,
    ends: RayEnds,
    medium: Medium,
    moments: int,
    guard: Guard | None,
    stride: int,
    targets: NDArray[Any],
    crossed: float = 0.0,
) -> Paths:
    """Returns the path moments of every ray, most of them interpolated.

    Every `stride`-th ray of a row and of a column is traced, and all rays near edges. `targets`
    (surface,) holds the flag of the target that each surface belongs to, and `crossed` is about how
    many voxels the traced rays together cross.
    """
    raster, precision = ends.geometry.raster, str(ends.stretch.dtype)
    kind = _sift(device, ends, stride, targets)
    lattice = lattice_rays(raster, stride)
    alone = np.flatnonzero(kind.host()[: raster.rays] == ALONE)
    picked = np.concatenate([lattice, alone])
    followed = follow(device, ends.geometry, picked)
    paths = trace.trace(device, ends, medium, moments, guard, precision, followed, crossed)
    return _spread(device, ends, paths, kind, picked, len(lattice), stride)


def lattice_rays(raster: Raster, stride: int) -> NDArray[np.int64]:
    """Returns the numbers of the rays on the lattice, row by row, (n,)."""
    rows, columns = (
        np.unique([*range(0, n, stride), n - 1]) for n in (raster.rows, raster.columns)
    )
    return np.asarray(rows[:, None] * raster.columns + columns, dtype=np.int64).ravel()


def _sift(device: Device, ends: RayEnds, stride: int, targets: NDArray[Any]) -> Buffer:
    """Returns the kind of each ray, (ray,) on the device: interpolated, lattice or alone."""
    precision = str(ends.stretch.dtype)
    program = device.build(ThinningKernels(1), precision)
    kind = device.empty((ends.rays,), np.int8)
    program.run(
        "sift",
        ends.rays // program.lanes,
        **raster_size(ends.geometry),
        stride=stride,
        surface=ends.surface,
        length=ends.path_length,
        things=device.put(targets, np.int32),
        kind=kind,
    )
    return kind


def _spread(
    device: Device,
    ends: RayEnds,
    paths: Paths,
    kind: Buffer,
    picked: NDArray[Any],
    lattice: int,
    stride: int,
) -> Paths:
    """Returns the moments of every ray, from those `picked`, the first `lattice` on the lattice."""
    traced, precision = paths.moments, str(paths.moments.dtype)
    on_lattice = picked[:lattice]
    length, whole = (one.path_length.host()[on_lattice] for one in (paths, ends))
    # A way has no length if its end is not lit; then nothing of it was cut off.
    followed = np.divide(length, whole, out=np.ones_like(length), where=whole > 0)
    means = traced.host()[:, :lattice] / np.maximum(length, np.finfo(length.dtype).tiny)
    slot = np.zeros(ends.rays, np.int32)
    slot[picked] = np.arange(len(picked))
    moments = device.empty((len(traced), ends.rays), precision)
    program = device.build(ThinningKernels(len(traced)), precision)
    program.run(
        "spread",
        ends.rays // program.lanes,
        **raster_size(ends.geometry),
        stride=stride,
        kind=kind,
        slot=device.put(slot),
        means=device.put(means),
        lattice_width=-(-(ends.geometry.raster.columns - 1) // stride) + 1,
        lattice=lattice,
        kept=device.put(followed),
        traced=traced,
        padded=traced.shape[1],
        path_length=paths.path_length,
        surface=paths.surface,
        moments=moments,
    )
    return replace(paths, moments=moments, interpolated=kind.host() == BETWEEN)
