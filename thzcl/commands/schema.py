"""`thzcl schema`: the JSON Schema of scenarios."""

from __future__ import annotations


def schema() -> None:
    """Print the JSON Schema of scenarios, for editors."""
    from thzcl.commands.tables import show_json
    from thzcl.scenario.manual import scenario_schema

    show_json(scenario_schema())
