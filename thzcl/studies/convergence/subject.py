"""The scene under study: exposures with changed settings.

And the reference that they are held against.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.device.opencl import Device
from thzcl.plan.compute import Tracer
from thzcl.plan.exposure import FieldMaker, expose
from thzcl.plan import compute
from thzcl.plan.plan import Plan
from thzcl.sensor import Echoes

Contrasts = dict[str, NDArray[np.float64]]  # by variant, (band, y, x)

# Everything in float64, and nothing worth a billionth of the contrast left out.
EXACT: Mapping[str, Any] = {
    "numerics.precision": "float64",
    "numerics.tolerance": 1e-9,
    "numerics.ray_stride": 1,
}


@dataclass(frozen=True)
class Subject:
    """A scene, and the device that it is studied on."""

    source: str | Path
    settings: Mapping[str, Any]
    variants: Sequence[str]
    device: Device
    allow_outside: bool = False

    def planned(self, **changes: Any) -> Plan:
        """The plan with some settings changed; dots in their names are double underscores."""
        renamed = {name.replace("__", "."): value for name, value in changes.items()}
        return self.plan_with(renamed)

    def plan_with(self, changes: Mapping[str, Any]) -> Plan:
        """The plan with some settings changed."""
        return pipeline.prepare(
            self.source,
            {**self.settings, **changes},
            self.variants,
            allow_outside=self.allow_outside,
        )

    @cached_property
    def plan(self) -> Plan:
        """As the scene has it."""
        return self.plan_with({})

    def contrasts(
        self,
        plan: Plan,
        clock: Clock,
        make: FieldMaker = compute.make_field,
        tracer: Tracer | None = None,
    ) -> Contrasts:
        """What the pixels see: radiance above the air's, or the part returned."""
        found: Contrasts = {}
        for exposed in expose(plan, self.device, clock, {}, make, tracer):
            for of_one, sight in zip(exposed.captures, exposed.sights, strict=True):
                seen = sight.returned if isinstance(sight, Echoes) else sight.contrast
                found[of_one[0].variant.name] = np.asarray(seen, dtype=np.float64)
        return found

    @cached_property
    def exact(self) -> Contrasts:
        """The reference for all that leaves pixels and voxels as they are."""
        return self.contrasts(self.plan_with(EXACT), Clock())


def errors(found: Contrasts, exact: Contrasts) -> tuple[float, float]:
    """Root mean square and largest error over the pixels, relative to the largest contrast.

    Of the worst band and variant.
    """
    rms = most = 0.0
    for name, truth in exact.items():
        scale = np.abs(truth).max(axis=(1, 2))
        wrong = np.abs(found[name] - truth)
        scale = np.where(scale > 0, scale, 1.0)
        rms = max(rms, float((np.sqrt((wrong**2).mean(axis=(1, 2))) / scale).max()))
        most = max(most, float((wrong.max(axis=(1, 2)) / scale).max()))
    return rms, most
