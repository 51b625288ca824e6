"""Ratios that continuous integration watches.

Bounds so generous that only a real loss of speed passes them, not noise.
"""

from __future__ import annotations

import claims
import setting
from timing import Record, alternate

from thzcl.device.opencl import Device

COARSE = {"atmosphere.fluctuations.voxel_m": 0.5}


def trace(device: Device, repeat: int) -> list[Record]:
    """Packets against single rays, and every ray against every fourth both ways."""
    every = setting.make(device, COARSE)
    fewer = setting.make(device, COARSE | {"numerics.ray_stride": 4})
    single = setting.make(setting.OneLane(device.context.devices[0], device.info), COARSE)
    calls = {"every": every, "fewer": fewer, "single": single}
    seconds = alternate(
        {name: lambda one=one: claims.void(one.trace()) for name, one in calls.items()}, repeat
    )
    return [
        Record(
            "single rays against packets",
            seconds["single"] / seconds["every"],
            1.3,
            "times slower",
            at_least=True,
        ),
        Record(
            "every ray against a sixteenth",
            seconds["every"] / seconds["fewer"],
            2.0,
            "times slower",
            at_least=True,
        ),
    ]


def shared(device: Device, repeat: int) -> list[Record]:
    """What more frequencies cost, and a field beside its two costly parts."""
    (_, band), (warm,), (field, _) = (
        claim(device, repeat)
        for claim in (claims.many_frequencies, claims.fluctuating_temperature, claims.field)
    )
    return [record._replace(bound=2 * record.bound) for record in (band, warm, field)]


def twice(device: Device, repeat: int) -> list[Record]:
    """All of them; where one is not met, a second look decides."""
    found = []
    for guard in (trace, shared):
        records = guard(device, repeat)
        found += records if all(record.met for record in records) else guard(device, 2 * repeat)
    return found
