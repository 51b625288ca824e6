"""Scenarios: TOML in, checked and immutable scenes out, and every problem in words."""

from thzcl.scenario.document import SHIPPED, Document, Scenario, Variant, find, parse, read, shipped
from thzcl.scenario.problems import ScenarioError, Trouble, validate
from thzcl.scenario.scene import Box, Camera, Scene
from thzcl.scenario.table import Table, key

__all__ = [
    "SHIPPED",
    "Box",
    "Camera",
    "Document",
    "Scenario",
    "ScenarioError",
    "Scene",
    "Table",
    "Trouble",
    "Variant",
    "find",
    "key",
    "parse",
    "read",
    "shipped",
    "validate",
]
