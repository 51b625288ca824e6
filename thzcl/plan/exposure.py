"""One exposure of every camera of a plan: fields, rays and what becomes of them.

Shared as the plan says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from thzcl.clock import Clock
from thzcl.device.opencl import Device
from thzcl.plan.compute import Capture, Lines, Tracer
from thzcl.plan import compute
from thzcl.plan.plan import Plan, VariantPlan, by_key
from thzcl.sensing.develop import develop
from thzcl.sensor import Echoes, Radiances
from thzcl.turbulence.cube import Field

Known = dict[object, Lines]
FieldMaker = Callable[[Device, VariantPlan, Clock], Field | None]


@dataclass(frozen=True)
class Exposed:
    """What the variants that share a trace saw: by variant.

    Its captures at one time after the other, and its sight.
    """

    captures: list[tuple[Capture, ...]]
    sights: list[Radiances | Echoes]
    cube: Field | None
    lines: Lines


def expose(
    plan: Plan,
    device: Device,
    clock: Clock,
    known: Known,
    make: FieldMaker = compute.make_field,
    tracer: Tracer | None = None,
) -> Iterator[Exposed]:
    """Group by group what the cameras see. Where rays end is kept in `known`, for a further exposure of the same scenes.

    `make` and `tracer` stand in for the plan's own fields and traces.
    """
    for sharing in by_key(
        plan.groups, lambda group: (group.first.field, group.first.precision)
    ).values():
        cube = make(device, sharing[0].first, clock)
        for group in sharing:
            key = group.first.rays_key
            if key not in known:
                known[key] = compute.find_lines(device, group.first, clock)
            captures = list(
                zip(*compute.captures(device, group, cube, known[key], clock, tracer), strict=True)
            )
            sights = [develop(of_one, clock) for of_one in captures]
            yield Exposed(captures, sights, cube, known[key])
