"""The plan of a run: the graph of all variants, in which alike paths are joined."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from thzcl.graph import Spec, everything, rewrite
from thzcl.paths.specs import EmissionSpec, TraceSpec, joined
from thzcl.plan.variant import PlannedVariant, plan_variant
from thzcl.scenario.document import Scenario
from thzcl.sensing.image import ImageSpec
from thzcl.turbulence.fields import FieldSpec


@dataclass(frozen=True)
class Plan:
    """The work of a run. Two plans are equal if the same specs make their images."""

    scenario: Scenario = field(compare=False)
    variants: tuple[PlannedVariant, ...]

    @property
    def realizations(self) -> int:
        """Returns the number of independent realisations of the air that images are means of."""
        return self.variants[0].scene.numerics.realizations

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Returns the frequencies of all variants, ascending, each once, (n,) in Hz."""
        nodes = [variant.image.spectrum.nodes_hz.array for variant in self.variants]
        return np.array(sorted({*np.concatenate(nodes)}))

    def specs(self) -> dict[Spec, None]:
        """Returns every spec of the graph, inputs first."""
        return everything(spec for variant in self.variants for spec in wanted(variant))

    def batch(self, number: int = 0) -> tuple[Spec, ...]:
        """Returns the specs that a run evaluates for one realisation of the air.

        For realisation 0 they are all that is wanted of each variant, for others the images and
        what is compared with them.
        """
        if number == 0:
            return tuple(spec for variant in self.variants for spec in wanted(variant))
        images = (spec for variant in self.variants for spec in (variant.image, *variant.compared))
        return rewrite(images, lambda spec: _realization(spec, number))

    @property
    def frames(self) -> int:
        """Returns the number of frames of a sequence, or 0 where the scene is none."""
        sequence = self.variants[0].scene.sequence
        return 0 if sequence is None else sequence.count

    def frame(self, number: int) -> tuple[Spec, ...]:
        """Returns the specs that a sequence evaluates for one frame.

        For frame 0 they are all that is wanted of each variant, for others the images and what is
        compared with them, in air that the wind has moved, and with other noise.
        """
        if number == 0:
            return self.batch()
        return tuple(
            spec
            for variant in self.variants
            for spec in rewrite(
                (variant.image, *variant.compared), partial(_frame, variant, number)
            )
        )

    def alone(self) -> Plan:
        """Returns the plan without the models to compare with."""

        def bare(spec: Spec) -> Spec:
            return replace(spec, also=()) if isinstance(spec, TraceSpec) else spec

        alone = [replace(variant, compared=(), rivals=()) for variant in self.variants]
        bared = [one.with_specs(_all(one, rewrite(wanted(one), bare))) for one in alone]
        crossed = [one.cube if one.cube in everything([one.image]) else None for one in bared]
        pairs = zip(bared, crossed, strict=True)
        return replace(self, variants=tuple(replace(one, cube=cube) for one, cube in pairs))


def wanted(variant: PlannedVariant) -> list[Spec]:
    """Returns the specs of a variant, without None, in the order in which they are evaluated."""
    return [spec for spec in variant.specs() if spec is not None]


def _realization(spec: Spec, number: int) -> Spec:
    """Returns a spec as it is in another realisation, with other random air and other noise."""
    if isinstance(spec, FieldSpec):
        return spec.realization(number)
    if isinstance(spec, ImageSpec):
        return replace(spec, noise=replace(spec.noise, realization=number))
    return spec


def _frame(variant: PlannedVariant, number: int, spec: Spec) -> Spec:
    """Returns a spec of a variant as it is in a frame of a sequence."""
    sequence, flow = variant.scene.sequence, variant.scene.atmosphere.fluctuations
    if isinstance(spec, ImageSpec):
        return replace(spec, noise=replace(spec.noise, frame=number))
    if not isinstance(spec, TraceSpec | EmissionSpec) or sequence is None or flow is None:
        return spec
    x, y, z = (-speed * number / sequence.rate_hz for speed in flow.wind_m_s)
    return replace(spec, motion=replace(spec.motion, moved_m=(x, y, z)))


def make_plan(scenario: Scenario) -> Plan:
    """Returns the plan of a scenario.

    Raises ScenarioError if a file cannot be used or a sensor cannot work with the scene, and
    PluginFailure if a sensor fails.
    """
    variants = tuple(plan_variant(scenario, variant) for variant in scenario.variants)
    return join([Plan(scenario, variants)])[0]


def join(plans: Iterable[Plan]) -> list[Plan]:
    """Returns plans in whose graphs paths that are alike are one path, as in `joined`."""
    plans = list(plans)
    variants = (variant for plan in plans for variant in plan.variants)
    together = iter(joined(spec for variant in variants for spec in wanted(variant)))
    return [
        replace(
            plan,
            variants=tuple(one.with_specs(_all(one, together)) for one in plan.variants),
        )
        for plan in plans
    ]


def _all(variant: PlannedVariant, new: Iterable[Spec]) -> list[Spec | None]:
    """Returns the specs of a variant, None included, in place of those wanted the next `new`."""
    following = iter(new)
    return [None if spec is None else next(following) for spec in variant.specs()]
