"""Sensors: what their hook asks of them, and every call into one, guarded."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from copy import copy
from typing import Any, TypeVar

import numpy as np

from thzcl.errors import PluginError, PluginFailure, RangeError, ScenarioError
from thzcl.plugins import guard, loader
from thzcl.plugins.loader import Hook
from thzcl.scenario import answers
from thzcl.scenario.problems import Trouble, validate
from thzcl.sensor import CONTRACT, Echoes, Image, Needs, Parameters, Radiances, Sensor, View

HOOK = Hook(
    group="thzcl.sensors",
    register="register_sensors",
    word="sensor",
    base=Sensor,
    contracts=range(1, CONTRACT + 1),
    members={"Params": (Parameters, "thzcl.sensor.Parameters")},
    built_ins=loader.built_ins("thzcl.sensors", "register_sensors"),
)
Input = TypeVar("Input")  # Radiances, Echoes or a View


def sensor_class(kind: str) -> type[Sensor]:
    """Returns the sensor of that name, its module imported and checked. Raises PluginError."""
    return loader.find(HOOK, kind)


def describe(kind: str) -> str:
    """Returns a sensor that is loaded, and its distribution, in words."""
    return loader.describe(HOOK, loader.origin(HOOK, kind))


def troubles(table: Any) -> list[Trouble]:
    """Returns what is wrong with a [sensor] table, paths relative to it.

    Raises PluginFailure if the sensor's own check of its parameters fails.
    """
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(kind, str):
        return []  # the scene's own check says so
    try:
        sensor = sensor_class(kind)
    except PluginError as error:
        return [Trouble(("kind",), str(error))]
    found = guard.call(describe(kind), validate, sensor.Params, _parameters(table, sensor))[1]
    if not sensor.wraps:
        return found
    inner = table.get("detector")
    if not isinstance(inner, Mapping) or not isinstance(inner.get("kind"), str):
        text = "needs a table [sensor.detector] with the kind of sensor that is wrapped"
        return [*found, Trouble(("detector",), text)]
    return found + [trouble.below("detector") for trouble in troubles(inner)]


def unused(table: Mapping[str, Any]) -> list[Trouble]:
    """Returns the keys of a sound [sensor] table that do nothing, paths relative to it."""
    sensor = sensor_class(table["kind"])
    params = sensor.Params.model_validate(_parameters(table, sensor))
    found = guard.call(describe(table["kind"]), params.unused)
    if not sensor.wraps:
        return found
    return found + [trouble.below("detector") for trouble in unused(table["detector"])]


def make(table: Mapping[str, Any]) -> Sensor:
    """Returns the sensor that a sound [sensor] table describes, with the one that it wraps.

    Raises PluginError, or PluginFailure if its constructor fails.
    """
    kind = table["kind"]
    sensor = sensor_class(kind)
    detector = make(table["detector"]) if sensor.wraps else None

    def made() -> Sensor:
        return sensor(sensor.Params.model_validate(_parameters(table, sensor)), detector)

    return guard.call(describe(kind), made)


def ask_needs(sensor: Sensor, view: View) -> Needs:
    """Returns what a sensor asks for, checked, with float64 arrays of its own.

    Raises ScenarioError for a ValueError of the sensor's: its parameters and the view do not fit.
    Raises PluginFailure for whatever else it raises, and for needs that make no sense. What the
    air's constituents raise, RangeError among it, comes through as it is.
    """
    let = ValueError, PluginError, PluginFailure
    try:
        needs = guard.call(_owner(sensor), sensor.needs, _read_only(view), let=let)
    except RangeError:
        raise
    except ValueError as error:
        raise ScenarioError([f"[sensor] {error}"]) from error
    return guard.call(_owner(sensor), answers.needs, needs, view.pixels)


def observe(
    sensor: Sensor,
    sight: Radiances | Echoes,
    rng: np.random.Generator,
    stored: np.dtype[Any],
    taken: Collection[str],
) -> Image:
    """Returns a sensor's image, whose real numbers are finite in the type in which it is `stored`.

    The sensor sees read-only arrays. `taken` holds the names of the file's own variables, which
    no layer may have. Raises PluginFailure.
    """
    shown = _read_only(sight)
    image = guard.call(_owner(sensor), sensor.observe, shown, rng)
    _keep_computed(sight, shown)
    return guard.call(_owner(sensor), answers.image, image, sight.target.shape, stored, taken)


def _owner(sensor: Sensor) -> str:
    """Returns a sensor and its distribution in words, with those of the sensor that it wraps."""
    owner, wrapped = describe(type(sensor).name), getattr(sensor, "_detector", None)
    return f"{owner}, around {_owner(wrapped)}" if isinstance(wrapped, Sensor) else owner


def _parameters(table: Mapping[str, Any], sensor: type[Sensor]) -> dict[str, Any]:
    others = {"kind", "detector"} if sensor.wraps else {"kind"}
    return {name: value for name, value in table.items() if name not in others}


def _read_only(given: Input) -> Input:
    """Returns a twin whose arrays are views that cannot be written through."""
    twin = copy(given)
    arrays = {name: value for name, value in vars(given).items() if isinstance(value, np.ndarray)}
    for name, array in arrays.items():
        view = array.view()
        view.flags.writeable = False
        vars(twin)[name] = view
    return twin


def _keep_computed(sight: Radiances | Echoes, shown: Radiances | Echoes) -> None:
    """Keeps what a sensor had computed from its input and cannot have changed, for the file."""
    for name, value in vars(shown).items():
        if isinstance(value, np.ndarray) and not value.flags.writeable:
            vars(sight).setdefault(name, value)
