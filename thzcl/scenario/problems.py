"""What is wrong with a scene, in words a person can act on: key, value, remedy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from thzcl.air.units import KELVIN
from thzcl.plugins.names import suggest

Path = tuple[str | int, ...]  # keys and list positions from the top of the document


@dataclass(frozen=True)
class Trouble:
    """One thing wrong at one place, and what to do about it.

    `path` leads there from the top of the document, or from the table that found it.
    """

    path: Path
    text: str

    def below(self, *parents: str | int) -> Trouble:
        """Returns this trouble with a path that starts further up."""
        return Trouble((*parents, *self.path), self.text)


Model = TypeVar("Model", bound=BaseModel)
_IN_WORDS = "thzcl"  # pydantic's type of an error that a table has put into words already
_TABLE = -1  # stands in pydantic's locations before the path within the table that found an error


def validate(model: type[Model], data: Any) -> tuple[Model | None, list[Trouble]]:
    """Returns the table that some data describe, or None, and everything that is wrong with it.

    `model` is a Table: it puts all its errors into words.
    """
    try:
        return model.model_validate(data), []
    except ValidationError as error:
        items = error.errors(include_url=False)
        return None, [Trouble(item["loc"][1:], item["msg"]) for item in items]


def refusal(title: str, troubles: Sequence[Trouble]) -> ValidationError:
    """Returns the error by which a table tells pydantic what is wrong with it."""
    return ValidationError.from_exception_data(
        title,
        [
            {
                "type": PydanticCustomError(_IN_WORDS, trouble.text),
                "loc": (_TABLE, *trouble.path),
                "input": None,
            }
            for trouble in troubles
        ],
    )


def translate(error: ValidationError, fields: Mapping[str, FieldInfo], data: Any) -> list[Trouble]:
    """Returns what is wrong with a table of these fields, from pydantic's error about some data.

    What the tables within it found is in words already; the errors of one value become a sentence.
    """
    troubles = []
    by_path: dict[Path, list[Any]] = {}
    for item in error.errors(include_url=False):
        location = item["loc"]
        if item["type"] == _IN_WORDS:
            at = location.index(_TABLE)
            path = _real_path(location[:at], data)
            troubles.append(Trouble((*path, *location[at + 1 :]), item["msg"]))
        elif item["type"] == "missing":
            by_path[*_real_path(location[:-1], data), location[-1]] = [item]
        else:
            by_path.setdefault(_real_path(location, data), []).append(item)
    for path, items in by_path.items():
        # A value of one of the right kinds is told its limits, not which kinds there are.
        limits = [item for item in items if item["type"] not in (*_KINDS, "literal_error")]
        telling = [item for item in items if not limits or item["type"] not in _KINDS]
        texts = dict.fromkeys(_sentence(item, path, fields) for item in telling)
        troubles.append(Trouble(path, _joined(list(texts))))
    return troubles


def _real_path(location: Iterable[str | int], data: Any) -> Path:
    """Returns a location without the names that pydantic adds for the branches of a union."""
    path: list[str | int] = []
    node = data
    for part in location:
        if isinstance(node, Mapping) and part in node:
            node = node[part]
            path.append(part)
        elif isinstance(node, list | tuple) and isinstance(part, int):
            node = node[part] if part < len(node) else None
            path.append(part)
    return tuple(path)


def _joined(texts: list[str]) -> str:
    """Returns the alternatives of a union in one sentence: "must be a or b, not 3"."""
    head, tail = "must be ", ", not "
    if len(texts) > 1 and all(text.startswith(head) and tail in text for text in texts):
        choices = [text.removeprefix(head).rpartition(tail)[0] for text in texts]
        return head + " or ".join(choices) + tail + texts[-1].rpartition(tail)[2]
    return texts[0]


def _sentence(item: Any, path: Path, fields: Mapping[str, FieldInfo]) -> str:
    """Returns what one of pydantic's errors means, for a value at a path within a table."""
    kind, context = item["type"], item.get("ctx", {})
    whole = all(isinstance(part, int) for part in path[1:])  # the field's value, or a part of it
    field = fields.get(str(path[0])) if path and whole else None
    if kind == "missing":
        return f"missing: {field.description}" if field and field.description else "missing"
    if kind == "extra_forbidden":
        return f"unknown key ({suggest(str(path[-1]), fields if len(path) == 1 else ())})"
    if kind == "union_tag_not_found":
        return "missing: kind, which says what it is; known are in `thzcl schema`"
    if kind in ("too_short", "too_long"):
        wanted = context.get("min_length", context.get("max_length"))
        return f"must hold {wanted} values, not {context.get('actual_length')}"
    if kind in ("value_error", "assertion_error"):  # of a validator that a plugin brings along
        return str(context["error"])
    return f"{_due(item, context, field)}, not {shown(_given(item))}{_celsius(item, field)}"


def _celsius(item: Any, field: FieldInfo | None) -> str:
    """Returns a remedy for a temperature that is too low in kelvin, and may be in another unit."""
    if _unit(field) != "K" or item["type"] != "greater_than_equal":
        return ""
    given = float(item["input"])
    kelvin = given + KELVIN
    return f"; {given:g} degrees Celsius are {kelvin:.6g} K" if kelvin >= item["ctx"]["ge"] else ""


def _unit(field: FieldInfo | None) -> str | None:
    """Returns the unit of a key, or None."""
    extra = field.json_schema_extra if field else None
    unit = extra.get("unit") if isinstance(extra, dict) else None
    return unit if isinstance(unit, str) else None


def _given(item: Any) -> Any:
    """Returns the value that an error is about: of a table of no known kind, its kind."""
    return item["input"].get("kind") if item["type"] == "union_tag_invalid" else item["input"]


def _due(item: Any, context: Mapping[str, Any], field: FieldInfo | None) -> str:
    """Returns what a value should be."""
    kind = item["type"]
    if kind == "union_tag_invalid":
        return f"kind must be {context['expected_tags'].replace(', ', ' or ')}"
    if kind == "literal_error":
        return f"must be {context['expected']}"
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}"
    if kind in _LIMITS:
        word, limit = _LIMITS[kind]
        unit = _unit(field)
        return f"must be {word} {context[limit]:g}{f' {unit}' if unit else ''}"
    message = str(item["msg"])
    return message[:1].lower() + message[1:]


_LIMITS = {
    "greater_than": ("above", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("below", "lt"),
    "less_than_equal": ("at most", "le"),
}
_KINDS = {
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": 'text in "quotes"',
    "tuple_type": "a list in [brackets]",
    "list_type": "a list in [brackets]",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "finite_number": "a finite number",
}


def shown(value: Any) -> str:
    """Returns a value as it stands in TOML, cut short."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, Mapping):
        text = "a table"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(shown(part) for part in value) + "]"
    else:
        text = str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def listed(names: Sequence[str]) -> str:
    """Returns names as "a, b or c"."""
    return ", ".join(names[:-1]) + " or " + names[-1]
