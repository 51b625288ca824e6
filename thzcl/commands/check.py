"""`thzcl check`: every problem of a scenario at once."""

from __future__ import annotations

from thzcl.commands.options import AllowOutside, Settings, Source, Variants, changes


def check(
    scenario: Source,
    settings: Settings = None,
    variant: Variants = None,
    allow_outside: AllowOutside = False,
) -> None:
    """Validate a scenario, and report every problem at once."""
    from thzcl import pipeline

    plan = pipeline.prepare(scenario, changes(settings), variant or (), allow_outside=allow_outside)
    images = len(plan.variants)
    for line in plan.scenario.idle:
        print(f"note: {line}")
    print(f"{plan.scenario.name}: sound, {images} image{'s' * (images > 1)}")
