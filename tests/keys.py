"""Makes scenarios/KEYS.md: every key of a scenario, with unit, default and limits.

    python tests/keys.py

Everything on the page comes from the models that read a scenario, and from the parameters of
sensors and constituents.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, not an installed thzcl

from thzcl.air.composition import HOOK as CONSTITUENTS
from thzcl.air.composition import constituent_class
from thzcl.scenario.document import VariantTable
from thzcl.scenario.problems import shown
from thzcl.scenario.scene import Scene, SensorChoice
from thzcl.scenario.sensors import HOOK, sensor_class
from thzcl.scenario.table import Table

PAGE = Path(__file__).parents[1] / "scenarios" / "KEYS.md"
HEAD = ("key", "unit", "default", "limits", "meaning")
INTRODUCTION = """# Every key of a scenario

A scenario is a TOML file. Each table of this page is a table of that file. A key that is `required`
must stand there wherever its table stands; `none` means that the key may be left out, and has no
value then. A key that is not on this page is an error, and the message suggests the nearest.

`--set table.key=value` changes any key for one run, and `[[variants]]` changes some for one image.
`thzcl schema` prints the same as a JSON Schema for editors. This page is made from the models that
read a scenario, by `python tests/keys.py`.
"""
Section = tuple[str, str, type[Table]]  # heading, what the table is, its model


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION]
    told: set[tuple[str, type[Table]]] = set()
    for heading, text, table in sections():
        if (heading, table) not in told:  # optics, which several sensors have
            told.add((heading, table))
            parts.append(section(heading, text, table))
    return "\n".join(parts)


def sections() -> Iterator[Section]:
    """Every table, in the order of a scene."""
    yield "Tables", inspect.cleandoc(Scene.__doc__ or ""), Scene
    for name, field in Scene.model_fields.items():
        if name == "sensor":
            yield from _sensors()
        elif name == "targets":
            for table in tables_in(field.annotation):
                kind = get_args(table.model_fields["kind"].annotation)[0]
                yield from _nested("targets.NAME", f'[targets.NAME] kind = "{kind}"', table)
        else:
            for table in tables_in(field.annotation):
                yield from _nested(name, f"[{name}]", table)
            if name == "atmosphere":
                yield from _constituents()
    yield from _nested("variants", "[[variants]]", VariantTable)


def _sensors() -> Iterator[Section]:
    """Each sensor's table, and those in it."""
    yield "[sensor]", inspect.cleandoc(SensorChoice.__doc__ or ""), SensorChoice
    for kind in HOOK.built_ins:
        sensor = sensor_class(kind)
        first = inspect.cleandoc(sensor.__doc__ or "").split("\n\n")[0]
        text = f"{first} `thzcl sensors {kind}` shows its manual page."
        if sensor.wraps:
            text += (
                "\n\nThe key `detector` is required: a table of that sensor, with its own `kind`."
            )
        yield f'[sensor] kind = "{kind}"', text, sensor.Params
        for name, field in sensor.Params.model_fields.items():
            for table in tables_in(field.annotation):
                yield from _nested(f"sensor.{name}", f"[sensor.{name}]", table)


def _constituents() -> Iterator[Section]:
    """The table of each constituent that joins any gas."""
    for name in CONSTITUENTS.built_ins:
        kind = constituent_class(name)
        if not kind.gas:
            first = inspect.cleandoc(kind.__doc__ or "").split("\n\n")[0]
            text = f"{first} `thzcl constituents {name}` shows its manual page."
            yield f"[atmosphere.{name}]", text, kind.Params


def _nested(path: str, heading: str, table: type[Table]) -> Iterator[Section]:
    """A table, and the tables in it."""
    yield heading, inspect.cleandoc(table.__doc__ or ""), table
    for name, field in table.model_fields.items():
        for inner in tables_in(field.annotation):
            yield from _nested(f"{path}.{name}", f"[{path}.{name}]", inner)


def tables_in(annotation: object) -> Iterator[type[Table]]:
    """The tables in an annotation such as `dict[str, Box | Billboard]`, each once."""
    found: list[type[Table]] = []

    def search(part: object) -> None:
        if isinstance(part, type) and issubclass(part, Table):
            found.append(part)
        for inner in get_args(part):
            search(inner)

    search(annotation)
    return iter(dict.fromkeys(found))


def section(heading: str, text: str, table: type[Table]) -> str:
    """A heading, what the table is, which keys exclude each other, and a row for each key."""
    parts = [f"## {heading}\n", f"{text}\n"]
    parts += [f"Give exactly one of {_code(group)}.\n" for group in table.exactly_one]
    parts += [f"Give at most one of {_code(group)}.\n" for group in table.at_most_one]
    rows = [HEAD, ("---",) * len(HEAD), *rows_of(table)]
    parts += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    return "\n".join(parts) + "\n"


def _code(names: tuple[str, ...]) -> str:
    return " and ".join(f"`{name}`" for name in names)


def rows_of(table: type[Table]) -> Iterator[tuple[str, ...]]:
    """A row for each key of a table: key, unit, default, limits and meaning."""
    schema = table.model_json_schema()
    for name, node in schema["properties"].items():
        field = table.model_fields[name]
        is_table = any(tables_in(field.annotation))
        if field.is_required():
            default = "required"
        elif is_table or field.default in (None, {}):
            default = "none"
        else:
            default = f"`{shown(field.default)}`"
        limits = "a table" if is_table else limits_of(node)
        yield f"`{name}`", node.get("unit", ""), default, limits, field.description or ""


def limits_of(node: dict) -> str:
    """What a value may be, in words, by its JSON Schema."""
    if "anyOf" in node:
        choices = [limits_of(part) for part in node["anyOf"] if part.get("type") != "null"]
        return "; or ".join(dict.fromkeys(filter(None, choices)))
    if "enum" in node or "const" in node:
        return ", ".join(f"`{shown(value)}`" for value in node.get("enum", [node.get("const")]))
    kind = node.get("type")
    if kind == "array":
        return _array(node)
    words = {"integer": "whole", "boolean": "`true`, `false`", "object": "a table"}
    bounds = _bounds(node)
    if kind in ("number", "string"):
        return bounds or {"number": "a number", "string": "text"}[kind]
    return ", ".join(filter(None, (words[kind], bounds)))


def _array(node: dict) -> str:
    """A list: how many values, and what each may be."""
    fixed = node.get("prefixItems")
    each = dict.fromkeys(limits_of(part) for part in fixed or [node["items"]])
    count = f"{len(fixed)} values" if fixed else "list"
    return f"{count}, each: {'; '.join(each)}"


def _bounds(node: dict) -> str:
    """The bounds of a number, or of a text's length."""
    if "minimum" in node and "maximum" in node:
        return f"{_number(node['minimum'])} to {_number(node['maximum'])}"
    words = {
        "exclusiveMinimum": "above",
        "minimum": "at least",
        "exclusiveMaximum": "below",
        "maximum": "at most",
    }
    bounds = [f"{word} {_number(node[name])}" for name, word in words.items() if name in node]
    return ", ".join(bounds) or ("text, not empty" if node.get("minLength") else "")


def _number(value: float) -> str:
    """A number in few letters: 16384, 0.0001, 1e9, 2^63."""
    if value == 2**63:
        return "2^63"
    if abs(value) < 1e6:
        return f"{value:.10g}"
    return f"{value:g}".replace("e+0", "e").replace("e+", "e")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
