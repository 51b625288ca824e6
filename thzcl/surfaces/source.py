"""The kernels' arguments and options for what surfaces send, by surfaces/source.cl."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import Device
from thzcl.surfaces.ends import Facing
from thzcl.surfaces.radiance import Table

Array = NDArray[np.float64]


def options(facing: Facing, table: Table) -> dict[str, Any]:
    """Returns the options of kernels that read surfaces/source.cl."""
    angular = table.angular
    return {
        "billboards": len(facing.blend) > 1,
        "cosines": None if angular is None else angular.reflectivity.shape[2],
        "elevations": None if angular is None else angular.seen.shape[1],
    }


def arguments(
    device: Device, facing: Facing, table: Table, precision: str, weights: Array | None = None
) -> dict[str, Any]:
    """Returns the arguments of such kernels that say what the ends of rays send.

    With `weights` (band, frequency), what is sent and what is seen are multiplied by them, and have
    the band as first axis.
    """
    angular = table.angular
    sent, seen = table.sent, None if angular is None else angular.seen
    if weights is not None:
        sent = weights[:, None, :] * sent
        seen = None if seen is None else weights[:, :, None] * seen
    return {
        "emitted": device.put(sent, precision),
        "blend": facing.blend,
        "cosine": facing.cosine,
        "elevation": facing.elevation,
        "mirror": None if angular is None else device.put(angular.mirror, np.int32),
        "reflectivity": None if angular is None else device.put(angular.reflectivity, precision),
        "seen": None if seen is None else device.put(seen, precision),
    }
