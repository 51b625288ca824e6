"""Finds sensors, checks that they keep the contract, and explains what is wrong with those that do not.

A sensor's module is imported only when the scene names it. Built-in sensors and third parties' go through the same hook.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any, get_args

import pluggy

from thzcl.plugins import hooks as hookspecs
from thzcl.scenario import Trouble, validate
from thzcl.scenario.document import VariantTable
from thzcl.scenario.problems import models_in, shown, suggest
from thzcl.scenario.scene import Scene
from thzcl.sensor import CONTRACT, Parameters, Sensor

ENTRY_POINTS = "thzcl.sensors"
_BUILT_IN = {
    "passive-spectral": "thzcl.sensors.passive_spectral",
    "passive-broadband": "thzcl.sensors.passive_broadband",
    "active": "thzcl.sensors.active",
    "raster-scan": "thzcl.sensors.raster_scan",
}


class PluginError(Exception):
    """A sensor plugin is missing or breaks the contract; the text says which and why."""


class SensorFailure(Exception):  # noqa: N818 (what happened)
    """A sensor broke while it worked; the text says which and how."""


@dataclass(frozen=True)
class Origin:
    """Where a sensor comes from."""

    name: str
    module: str
    distribution: str


def origins() -> list[Origin]:
    """Every sensor on offer, built-in first; nothing is imported."""
    from importlib.metadata import entry_points

    found = [Origin(name, module, "thzcl") for name, module in _BUILT_IN.items()]
    for point in entry_points(group=ENTRY_POINTS):
        distribution = point.dist.name if point.dist else "an unnamed distribution"
        if distribution != "thzcl":
            found.append(Origin(point.name, point.value, distribution))
    return found


def sensor_class(kind: str) -> type[Sensor]:
    """The sensor of that name, its module imported and checked. Raises PluginError."""
    if kind in _BUILT_IN:
        return load(Origin(kind, _BUILT_IN[kind], "thzcl"))
    known = origins()
    same = [origin for origin in known if origin.name == kind]
    if not same:
        raise PluginError(
            f'no sensor "{kind}" is installed ({suggest(kind, [origin.name for origin in known])})'
        )
    if len(same) > 1:
        owners = " and ".join(sorted(origin.distribution for origin in same))
        raise PluginError(f'"{kind}" is claimed by {owners}; uninstall one of them')
    return load(same[0])


@cache  # variants ask again and again
def load(origin: Origin) -> type[Sensor]:
    """Imports a plugin and returns its sensor. Raises PluginError naming plugin.

    Distribution and reason.
    """
    manager = pluggy.PluginManager("thzcl")
    manager.add_hookspecs(hookspecs)
    try:
        manager.register(import_module(origin.module), origin.name)
        manager.check_pending()
        classes = [sensor for group in manager.hook.register_sensors() for sensor in group]
    except (Exception, SystemExit) as error:  # whatever a stranger's module raises when imported
        raise _broken(origin, f"{type(error).__name__}: {error}") from error
    for sensor in classes:
        if getattr(sensor, "name", None) == origin.name:
            reason = _breach(sensor)
            if reason:
                raise _broken(origin, reason)
            chosen: type[Sensor] = sensor
            return chosen
    raise _broken(origin, f'register_sensors() offers no sensor named "{origin.name}"')


def _broken(origin: Origin, reason: str) -> PluginError:
    return PluginError(
        f'sensor "{origin.name}" of {origin.distribution} ({origin.module}) cannot be used: {reason}'
    )


def _breach(sensor: Any) -> str | None:
    """How a class breaks the contract, if it does."""
    if not (isinstance(sensor, type) and issubclass(sensor, Sensor)):
        return f"{sensor!r} is not a subclass of thzcl.sensor.Sensor"
    version = getattr(sensor, "contract", None)
    if version != CONTRACT:
        return f"it was written for version {version} of the sensor contract, this thzcl has version {CONTRACT}; update it"
    parameters = getattr(sensor, "Params", None)
    if not (isinstance(parameters, type) and issubclass(parameters, Parameters)):
        return "its Params is not a subclass of thzcl.sensor.Parameters"
    missing = sorted(getattr(sensor, "__abstractmethods__", ()))
    return f"it does not define {' and '.join(missing)}()" if missing else None


def describe(kind: str) -> str:
    """A sensor and its distribution, in words."""
    origin = next(
        (origin for origin in origins() if origin.name == kind), Origin(kind, "", "thzcl")
    )
    return f'sensor "{kind}" of {origin.distribution}'


def summary(origin: Origin) -> str:
    """The first sentence of a sensor's manual page, or what is wrong with it."""
    try:
        sensor = load(origin)
    except PluginError as error:
        return f"BROKEN: {error}"
    return inspect.cleandoc(sensor.__doc__ or "").split("\n\n")[0].replace("\n", " ")


def manual(kind: str) -> tuple[str, list[list[str]]]:
    """A sensor's manual page, and a row for each of its parameters: key, unit, default, limits, meaning.

    Raises PluginError.
    """
    sensor = sensor_class(kind)
    page = inspect.cleandoc(sensor.__doc__ or "")
    return f"{kind}\n{'=' * len(kind)}\n\n{page}", _parameter_rows(sensor.Params, "")


def _parameter_rows(table: type[Parameters], prefix: str) -> list[list[str]]:
    rows = []
    for name, field in table.model_fields.items():
        inner = next(models_in(field.annotation), None)
        if inner is not None:
            rows.append([f"{prefix}{name}", "", "left out", "a table", field.description or ""])
            rows += _parameter_rows(inner, f"{prefix}{name}.")  # type: ignore[arg-type]
            continue
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        default = (
            "required"
            if field.is_required()
            else "none"
            if field.default is None
            else shown(field.default)
        )
        rows.append(
            [
                f"{prefix}{name}",
                str(extra.get("unit", "")),
                default,
                _limits(field),
                field.description or "",
            ]
        )
    return rows


def _limits(field: Any) -> str:
    """Choices of a literal, or bounds of a number."""
    choices = [shown(choice) for choice in get_args(field.annotation) if isinstance(choice, str)]
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    bounds = [
        f"{word} {getattr(limit, name):g}"
        for limit in field.metadata
        for name, word in words.items()
        if getattr(limit, name, None) is not None
    ]
    return " | ".join(choices) or ", ".join(bounds)


def scenario_schema() -> dict[str, Any]:
    """JSON Schema of a scenario, the sensors' parameters and [[variants]] included."""
    found = Scene.model_json_schema()
    definitions = found["$defs"]
    choices = []
    for origin in origins():
        try:
            parameters = load(origin).Params.model_json_schema(
                ref_template=f"#/$defs/{origin.name}/$defs/{{model}}"
            )
        except PluginError:
            continue  # a broken plugin breaks no editor
        parameters["properties"] = {"kind": {"const": origin.name}} | parameters.get(
            "properties", {}
        )
        parameters["required"] = ["kind", *parameters.get("required", [])]
        definitions[origin.name] = parameters
        choices.append({"$ref": f"#/$defs/{origin.name}"})
    found["properties"]["sensor"] = {"oneOf": choices}
    found["properties"]["variants"] = {"type": "array", "items": VariantTable.model_json_schema()}
    found["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    found["title"] = "thzcl scenario"
    return found


def troubles(table: Any) -> list[Trouble]:
    """What is wrong with a [sensor] table, paths relative to it."""
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(kind, str):
        return []  # the scene's own check says so
    try:
        sensor = sensor_class(kind)
    except PluginError as error:
        return [Trouble(("kind",), str(error))]
    found = validate(sensor.Params, _parameters(table, sensor))[1]
    if sensor.wraps:
        inner = table.get("detector")
        if not isinstance(inner, Mapping) or not isinstance(inner.get("kind"), str):
            return [
                *found,
                Trouble(
                    ("detector",),
                    "needs a table [sensor.detector] with the kind of sensor that is wrapped",
                ),
            ]
        found += [trouble.below("detector") for trouble in troubles(inner)]
    return found


def make(table: Mapping[str, Any]) -> Sensor:
    """The sensor that a valid [sensor] table describes, with the one that it wraps."""
    sensor = sensor_class(table["kind"])
    detector = make(table["detector"]) if sensor.wraps else None
    return sensor(sensor.Params.model_validate(_parameters(table, sensor)), detector)


def _parameters(table: Mapping[str, Any], sensor: type[Sensor]) -> dict[str, Any]:
    others = {"kind", "detector"} if sensor.wraps else {"kind"}
    return {name: value for name, value in table.items() if name not in others}
