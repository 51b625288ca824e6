"""What a variant's files and air cannot be used for, as problems of its scene."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from thzcl.errors import FileError, RangeError, ScenarioError
from thzcl.scenario.document import Scenario
from thzcl.scenario.scene import Scene


@contextmanager
def files_refused(scenario: Scenario) -> Iterator[None]:
    """Turns errors of files, raised within the context, into ScenarioError."""
    try:
        yield
    except FileError as error:
        raise ScenarioError([f"{scenario.name}: {error}"]) from None


@contextmanager
def air_refused(scenario: Scenario, scene: Scene, *, fluctuating: bool = False) -> Iterator[None]:
    """Turns a RangeError, raised within the context, into ScenarioError that names the key.

    `fluctuating` says that it is not the mean air which lies outside.
    """
    try:
        yield
    except RangeError as error:
        key = _frequency_key(scene, error.value) if error.quantity == "frequency_ghz" else ""
        if not key:
            key = "[atmosphere.fluctuations]" if fluctuating else _state_key(scene, error.quantity)
        raise ScenarioError([f"{scenario.name}: {key}: {error}"]) from None


def _state_key(scene: Scene, quantity: str) -> str:
    """Returns the key that says what the mean air is like."""
    if quantity == "frequency_ghz":
        return "[sensor]"
    given = scene.atmosphere.absolute_humidity_g_m3
    moist = "relative_humidity_percent" if given is None else "absolute_humidity_g_m3"
    return f"[atmosphere] {moist if quantity == 'vapour_hpa' else quantity}"


def _frequency_key(scene: Scene, ghz: float) -> str:
    """Returns the key of the sensor whose value is a frequency, or "" if there is none."""
    found = _named(scene.sensor.model_dump(), ghz)
    return f"[sensor] {found}" if found else ""


def _named(table: Mapping[str, Any], ghz: float) -> str:
    for name, value in table.items():
        if isinstance(value, Mapping):
            inner = _named(value, ghz)
            if inner:
                return f"{name}.{inner}"
        values = value if isinstance(value, tuple | list) else (value,)
        numbers = [one for one in values if isinstance(one, int | float)]
        if name.endswith("_ghz") and any(math.isclose(one, ghz) for one in numbers):
            return name
    return ""
