"""The scene under study, with changed settings or graphs, and the reference for its errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.device.opencl import Device
from thzcl.graph import evaluate, rewrite
from thzcl.plan.plan import Plan
from thzcl.sensing.pixels import PixelsSpec
from thzcl.studies.convergence.specs import Change, unchanged

Contrasts = dict[str, NDArray[np.float64]]  # by variant, (plane, y, x)

SEED = 1  # of air that names none: all settings see the same air, and a study can go on
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

    def plan_with(self, changes: Mapping[str, Any]) -> Plan:
        """Returns the plan with some settings of the scene changed, of the main models alone."""
        plan = pipeline.prepare(
            self.source,
            {**self.settings, **changes},
            self.variants,
            allow_outside=self.allow_outside,
            seed=SEED,
        )
        return plan.alone()

    @cached_property
    def plan(self) -> Plan:
        """Returns the plan of the scene as it is."""
        return self.plan_with({})

    @cached_property
    def degree(self) -> int:
        """Returns the highest degree in humidity of the absorption polynomials of a run."""
        fits = tuple(variant.expansion for variant in self.plan.variants)
        (expansions,) = evaluate([fits], self.device)
        return int(max(expansion.moments for expansion in expansions))

    def contrasts(self, plan: Plan, clock: Clock, change: Change = unchanged) -> Contrasts:
        """Returns what the pixels see: radiance above the air's, or the part returned.

        `change` is applied to every spec of the graph; `clock` is told what each stage takes.
        """
        (contrasts,) = self.series(plan, clock, [change])
        return contrasts

    def series(self, plan: Plan, clock: Clock, changes: Iterable[Change]) -> Iterator[Contrasts]:
        """Yields what the pixels see after each of several changes.

        What a change leaves as the change before it had it is computed once for both.
        """
        graphs = (rewrite(pixels(plan), change) for change in changes)
        for values in evaluate(graphs, self.device, clock):
            pairs = zip(plan.variants, values, strict=True)
            yield {v.name: np.asarray(seen.contrast, dtype=np.float64) for v, seen in pairs}

    @cached_property
    def exact(self) -> Contrasts:
        """Returns the reference for all knobs that leave pixels and voxels as they are."""
        return self.contrasts(self.plan_with(EXACT), Clock())


def pixels(plan: Plan) -> tuple[PixelsSpec, ...]:
    """Returns what the pixels of each variant see, as specs."""
    return tuple(variant.image.pixels for variant in plan.variants)


def errors(contrasts: Contrasts, exact: Contrasts) -> tuple[float, float]:
    """Returns the root mean square and the largest error over the pixels.

    Both are relative to the largest contrast, and of the worst plane and variant.
    """
    rms = most = 0.0
    for name, truth in exact.items():
        scale = np.abs(truth).max(axis=(1, 2))
        wrong = np.abs(contrasts[name] - truth)
        scale = np.where(scale > 0, scale, 1.0)
        rms = max(rms, float((np.sqrt((wrong**2).mean(axis=(1, 2))) / scale).max()))
        most = max(most, float((wrong.max(axis=(1, 2)) / scale).max()))
    return rms, most
