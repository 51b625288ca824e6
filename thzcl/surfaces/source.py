"""The kernels' arguments and options for what surfaces send, by surfaces/source.cl."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Buffer, Device
from thzcl.surfaces.ends import Facing
from thzcl.surfaces.radiance import Table

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SourceKernels(Kernels):
    """Kernels that read surfaces/source.cl, with its options."""

    blended: bool = False
    cosines: int | None = None
    laws: int | None = None
    elevations: int | None = None
    tilts: int | None = None
    scattered: int | None = None
    seen: int | None = None
    mirrored: int | None = None
    share: int | None = None
    polarized: int | None = None
    lobe: int | None = None
    covered: bool = False
    bounces: bool = False


def options(facing: Facing, table: Table) -> dict[str, Any]:
    """Returns the options of kernels that read surfaces/source.cl."""
    blended, angular = {"blended": len(facing.blend) > 1}, table.angular
    if angular is None:
        return blended
    law = {name: angular.laws.index(name) for name in angular.laws}
    return blended | {
        "cosines": angular.reflectivity.shape[3],
        "laws": len(law),
        "elevations": angular.elevations,
        "tilts": angular.tilts,
        "scattered": angular.scattered,
        "seen": angular.seen.shape[1],
        "mirrored": angular.mirrored,
        "share": law.get("share"),
        "polarized": law.get("polarization"),
        "lobe": law.get("lobe"),
        "covered": angular.covers is not None,
        "bounces": angular.dimming is not None,
    }


def arguments(
    device: Device, facing: Facing, table: Table, precision: str, weights: Array | None = None
) -> dict[str, Any]:
    """Returns the arguments of such kernels that say what the ends of rays send.

    With `weights` (band, frequency), what is sent and what is seen are multiplied by them, and have
    the band as first axis.
    """
    angular, weighted = table.angular, 1.0 if weights is None else weights[:, :, None]
    rows = table.rows
    sent = rows if weights is None else weights[:, None, :] * rows
    of_rays = {
        "emitted": device.put(sent, precision),
        "blend": facing.blend,
        "cosine": facing.cosine,
        "elevation": facing.elevation,
        "upward": facing.upward,
        "across": facing.across,
        "met": facing.met,
        "bounce": facing.bounce,
        "covered": len(table.sent),
    }
    if angular is None:
        absent = ("mirror", "view", "reflectivity", "seen", "cover", "dimming")
        return of_rays | dict.fromkeys(absent) | {"knee": 0.0, "dip": 0.0}

    def real(values: Array | None) -> Buffer | None:
        return None if values is None else device.put(values, precision)

    return of_rays | {
        "mirror": device.put(angular.mirror, np.int32),
        "view": device.put(angular.view, np.int32),
        "reflectivity": real(angular.reflectivity),
        "seen": real(weighted * angular.seen),
        "knee": angular.knee,
        "dip": angular.dip,
        "cover": real(None if angular.covers is None else angular.covers.parts),
        "dimming": real(angular.dimming),
    }
