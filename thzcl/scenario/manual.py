"""What is told of plugins and scenarios: manual pages, tables of parameters, the JSON Schema."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from thzcl.air.composition import HOOK as CONSTITUENTS
from thzcl.air.composition import file_keys, gases
from thzcl.constituent import Constituent
from thzcl.errors import PluginError
from thzcl.plugins import loader
from thzcl.plugins.guard import call
from thzcl.plugins.loader import Hook, Origin
from thzcl.scenario.document import VariantTable
from thzcl.scenario.problems import shown
from thzcl.scenario.scene import Scene
from thzcl.scenario.sensors import HOOK as SENSORS
from thzcl.sensor import Sensor

SCHEMA_ID = "urn:thzcl:scenario"
ANY_SENSOR = "SensorTable"  # in the schema: a table of any kind of sensor
IN_AIR = "atmosphere."  # before the names of constituents' tables there


def summary(hook: Hook, origin: Origin) -> str:
    """Returns the first paragraph of a plugin's manual page, or what is wrong with the plugin."""
    try:
        plugin = loader.load(hook, origin)
    except PluginError as error:
        return f"BROKEN: {error}"
    return inspect.cleandoc(plugin.__doc__ or "").split("\n\n")[0].replace("\n", " ")


def manual(hook: Hook, name: str) -> tuple[str, list[list[str]]]:
    """Returns a plugin's manual page, and a row for each of its parameters.

    A row holds key, unit, default, limits and meaning. Raises PluginError, or PluginFailure.
    """
    plugin: Any = loader.find(hook, name)
    page = inspect.cleandoc(plugin.__doc__ or "")
    owner = loader.describe(hook, loader.origin(hook, name))
    rows = call(owner, _parameter_rows, plugin.Params, "")
    return f"{name}\n{'=' * len(name)}\n\n{page}", rows


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
    """Returns the JSON Schema of a scenario, the plugins' parameters and [[variants]] included."""
    schema = Scene.model_json_schema()
    definitions = schema["$defs"]
    sensors = _plugin_schemas(SENSORS, _sensor_schema)
    definitions |= sensors
    definitions[ANY_SENSOR] = _by_kind({name: f"#/$defs/{name}" for name in sensors})
    kinds = schema["properties"]["targets"]["additionalProperties"]["discriminator"]["mapping"]
    schema["properties"]["targets"]["additionalProperties"] = _by_kind(kinds)
    schema["properties"]["sensor"] = {"$ref": f"#/$defs/{ANY_SENSOR}"}
    in_air = _plugin_schemas(CONSTITUENTS, _constituent_schema)
    definitions |= in_air
    atmosphere = definitions["Atmosphere"]
    tables = {name.removeprefix(IN_AIR): {"$ref": f"#/$defs/{name}"} for name in in_air}
    atmosphere["properties"] |= tables
    atmosphere["properties"]["model"]["enum"] = gases()
    atmosphere["additionalProperties"] = False
    schema["properties"]["variants"] = {"type": "array", "items": VariantTable.model_json_schema()}
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["$id"] = SCHEMA_ID
    schema["title"] = "thzcl scenario"
    return schema


def _by_kind(references: dict[str, str]) -> dict[str, Any]:
    """Returns the schema of a table whose `kind` says which schema it has to obey.

    Editors name the key that is wrong; of alternatives they would only say that none fits.
    """
    return {
        "type": "object",
        "required": ["kind"],
        "properties": {"kind": {"enum": list(references)}},
        "allOf": [
            {
                "if": {"required": ["kind"], "properties": {"kind": {"const": kind}}},
                "then": {"$ref": reference},
            }
            for kind, reference in references.items()
        ],
    }


def _plugin_schemas(
    hook: Hook, schema_of: Callable[[Any, str], tuple[str, dict[str, Any]]]
) -> dict[str, Any]:
    """Returns the JSON Schemas of plugins' tables by their names among the definitions."""
    found = {}
    for origin in loader.origins(hook):
        try:
            plugin = loader.load(hook, origin)
            owner = loader.describe(hook, origin)
            name, schema = call(owner, schema_of, plugin, origin.name, error=PluginError)
        except PluginError:
            continue  # a broken plugin breaks no editor
        found[name] = schema
    return found


def _sensor_schema(sensor: type[Sensor], kind: str) -> tuple[str, dict[str, Any]]:
    """Returns the JSON Schema of a sensor's table, that of its detector included."""
    schema = _table_schema(sensor.Params, kind)
    own: dict[str, Any] = {"kind": {"const": kind}}
    if sensor.wraps:
        own["detector"] = {"$ref": f"#/$defs/{ANY_SENSOR}"}
    schema["properties"] = own | schema.get("properties", {})
    schema["required"] = [*own, *schema.get("required", [])]
    return kind, schema


def _constituent_schema(constituent: type[Constituent], name: str) -> tuple[str, dict[str, Any]]:
    """Returns the JSON Schema of a constituent's table; model_file may stand for a gas' file."""
    schema = _table_schema(constituent.Params, IN_AIR + name)
    by_model_file = file_keys(constituent.Params)[:1] if constituent.gas else []
    required = [key for key in schema.get("required", []) if key not in by_model_file]
    return IN_AIR + name, schema | {"required": required}


def _table_schema(table: type[BaseModel], name: str) -> dict[str, Any]:
    """Returns the JSON Schema of a table that stands among the definitions under a name."""
    return table.model_json_schema(ref_template=f"#/$defs/{name}/$defs/{{model}}")
