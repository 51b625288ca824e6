"""The plan of a run: the graph of all variants, whose paths are joined, and its realisations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.graph import Spec, everything, rewrite
from thzcl.paths.specs import joined
from thzcl.plan.variant import PlannedVariant, plan_variant
from thzcl.scenario.document import Scenario
from thzcl.sensing.image import ImageSpec
from thzcl.turbulence.fields import FieldSpec


@dataclass(frozen=True)
class Plan:
    """Everything that a run will do. Two plans are equal if the same specs make their images."""

    scenario: Scenario = field(compare=False)
    variants: tuple[PlannedVariant, ...]

    @property
    def realizations(self) -> int:
        """Returns how many independent realisations of the air the mean image is of."""
        return self.variants[0].scene.numerics.realizations

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Returns every frequency of every variant."""
        nodes = [variant.image.spectrum.nodes_hz.array for variant in self.variants]
        return np.array(sorted({*np.concatenate(nodes)}))

    def specs(self) -> dict[Spec, None]:
        """Returns every spec of the graph, inputs first."""
        return everything(spec for variant in self.variants for spec in wanted(variant))

    def batch(self, number: int = 0) -> tuple[Spec, ...]:
        """Returns what is wanted of one realisation: of the first all, of others the images."""
        if number == 0:
            return tuple(spec for variant in self.variants for spec in wanted(variant))
        images = tuple(variant.image for variant in self.variants)
        return rewrite(images, lambda spec: _realization(spec, number))


def wanted(variant: PlannedVariant) -> list[Spec]:
    """Returns the specs of a variant that there are, in the order in which they are made."""
    return [spec for spec in variant.specs() if spec is not None]


def _realization(spec: Any, number: int) -> Any:
    """Returns a spec of the same image through other air, with other noise."""
    if isinstance(spec, FieldSpec):
        return spec.realization(number)
    if isinstance(spec, ImageSpec):
        return replace(spec, noise=replace(spec.noise, realization=number))
    return spec


def make_plan(scenario: Scenario) -> Plan:
    """Returns the plan of a scenario.

    Raises ScenarioError for files that cannot be used and for what a sensor cannot work with,
    PluginFailure where a sensor breaks.
    """
    apart = [plan_variant(scenario, variant) for variant in scenario.variants]
    rows = [variant.specs() for variant in apart]
    together = iter(joined(spec for row in rows for spec in row if spec is not None))
    specs = [tuple(None if spec is None else next(together) for spec in row) for row in rows]
    pairs = zip(apart, specs, strict=True)
    return Plan(scenario, tuple(variant.with_specs(own) for variant, own in pairs))
