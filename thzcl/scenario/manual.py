"""What is told of sensors and scenarios: manual pages, tables of parameters, the JSON Schema."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from thzcl.errors import PluginError
from thzcl.plugins import loader
from thzcl.plugins.guard import call
from thzcl.plugins.loader import Origin
from thzcl.scenario.document import VariantTable
from thzcl.scenario.problems import shown
from thzcl.scenario.scene import Scene
from thzcl.scenario.sensors import HOOK, describe, sensor_class
from thzcl.sensor import Sensor

ANY_SENSOR = "SensorTable"  # in the schema: a table of any kind of sensor


def summary(origin: Origin) -> str:
    """Returns the first paragraph of a sensor's manual page, or what is wrong with the sensor."""
    try:
        sensor = loader.load(HOOK, origin)
    except PluginError as error:
        return f"BROKEN: {error}"
    return inspect.cleandoc(sensor.__doc__ or "").split("\n\n")[0].replace("\n", " ")


def manual(kind: str) -> tuple[str, list[list[str]]]:
    """Returns a sensor's manual page, and a row for each of its parameters.

    A row holds key, unit, default, limits and meaning. Raises PluginError, or PluginFailure.
    """
    sensor = sensor_class(kind)
    page = inspect.cleandoc(sensor.__doc__ or "")
    rows = call(describe(kind), _parameter_rows, sensor.Params, "")
    return f"{kind}\n{'=' * len(kind)}\n\n{page}", rows


def _parameter_rows(table: type[BaseModel], prefix: str) -> list[list[str]]:
    rows = []
    for name, field in table.model_fields.items():
        meaning = field.description or ""
        inner = next(_tables_in(field.annotation), None)
        if inner is not None:
            rows.append([f"{prefix}{name}", "", "left out", "a table", meaning])
            rows += _parameter_rows(inner, f"{prefix}{name}.")
            continue
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        unit = str(extra.get("unit", ""))
        rows.append([f"{prefix}{name}", unit, _default(field), _limits(field), meaning])
    return rows


def _tables_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yields the tables in an annotation such as `Table | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _tables_in(part)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    return "none" if field.default is None else shown(field.default)


def _limits(field: FieldInfo) -> str:
    """Returns the choices of a literal, or the bounds of a number."""
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
    """Returns the JSON Schema of a scenario, the sensors' parameters and [[variants]] included."""
    schema = Scene.model_json_schema()
    definitions = schema["$defs"]
    choices = []
    for origin in loader.origins(HOOK):
        try:
            sensor = loader.load(HOOK, origin)
            owner = loader.describe(HOOK, origin)
            definitions[origin.name] = call(
                owner, _sensor_schema, sensor, origin.name, error=PluginError
            )
        except PluginError:
            continue  # a broken plugin breaks no editor
        choices.append({"$ref": f"#/$defs/{origin.name}"})
    definitions[ANY_SENSOR] = {"oneOf": choices}
    schema["properties"]["sensor"] = {"$ref": f"#/$defs/{ANY_SENSOR}"}
    schema["properties"]["variants"] = {"type": "array", "items": VariantTable.model_json_schema()}
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "thzcl scenario"
    return schema


def _sensor_schema(sensor: type[Sensor], kind: str) -> dict[str, Any]:
    """Returns the JSON Schema of a sensor's table, that of its detector included."""
    template = f"#/$defs/{kind}/$defs/{{model}}"
    schema: dict[str, Any] = sensor.Params.model_json_schema(ref_template=template)
    own: dict[str, Any] = {"kind": {"const": kind}}
    if sensor.wraps:
        own["detector"] = {"$ref": f"#/$defs/{ANY_SENSOR}"}
    schema["properties"] = own | schema.get("properties", {})
    schema["required"] = [*own, *schema.get("required", [])]
    return schema
