"""The kernels' arguments and options for what surfaces send, by surfaces/source.cl."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Device
from thzcl.surfaces.ends import Facing
from thzcl.surfaces.radiance import Table

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SourceKernels(Kernels):
    """Kernels that read surfaces/source.cl, with its options."""

    billboards: bool = False
    cosines: int | None = None
    elevations: int | None = None
    tilts: int | None = None
    scattered: int | None = None
    seen: int | None = None


def options(facing: Facing, table: Table) -> dict[str, Any]:
    """Returns the options of kernels that read surfaces/source.cl."""
    textured, angular = {"billboards": len(facing.blend) > 1}, table.angular
    if angular is None:
        return textured
    return textured | {
        "cosines": angular.reflectivity.shape[2],
        "elevations": angular.elevations,
        "tilts": angular.tilts,
        "scattered": angular.scattered,
        "seen": angular.seen.shape[1],
    }


def arguments(
    device: Device, facing: Facing, table: Table, precision: str, weights: Array | None = None
) -> dict[str, Any]:
    """Returns the arguments of such kernels that say what the ends of rays send.

    With `weights` (band, frequency), what is sent and what is seen are multiplied by them, and have
    the band as first axis.
    """
    angular, weighted = table.angular, 1.0 if weights is None else weights[:, :, None]
    sent = table.sent if weights is None else weights[:, None, :] * table.sent
    of_rays = {
        "emitted": device.put(sent, precision),
        "blend": facing.blend,
        "cosine": facing.cosine,
        "elevation": facing.elevation,
        "upward": facing.upward,
    }
    if angular is None:
        absent = dict.fromkeys(("mirror", "view", "reflectivity", "seen"))
        return of_rays | absent | {"knee": 0.0, "dip": 0.0}
    return of_rays | {
        "mirror": device.put(angular.mirror, np.int32),
        "view": device.put(angular.view, np.int32),
        "reflectivity": device.put(angular.reflectivity, precision),
        "seen": device.put(weighted * angular.seen, precision),
        "knee": angular.knee,
        "dip": angular.dip,
    }
