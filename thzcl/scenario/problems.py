"""What is wrong with a scenario, in words a person can act on: file, line, table, key, value.

Remedy.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

Path = tuple[str | int, ...]  # keys and list positions from the top of the document


@dataclass(frozen=True)
class Trouble:
    """One thing wrong at one place: `path` from the top (or from the table that found it).

    And what to do about it.
    """

    path: Path
    text: str

    def below(self, *parents: str | int) -> Trouble:
        """The same, seen from further up."""
        return Trouble((*parents, *self.path), self.text)


class ScenarioError(Exception):
    """The scenario cannot be used; `problems` holds one line each.

    Complete with place and remedy.
    """

    def __init__(self, problems: Sequence[str]) -> None:
        self.problems = tuple(dict.fromkeys(problems))
        super().__init__("\n".join(self.problems))


Model = TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], data: Any) -> tuple[Model | None, list[Trouble]]:
    """The validated model, or None, and everything found wrong with it, all at once."""
    troubles = _presence(model, data)
    try:
        table = model.model_validate(data)
    except ValidationError as error:
        return None, troubles + _translate(error, model, data) + _of_sound_parts(model, data)
    return table, troubles or _together(table)


def _presence(model: type[BaseModel], data: Mapping[str, Any]) -> list[Trouble]:
    """Groups of keys of which one must, or no more than one may, be given.

    Here and in the tables within.
    """
    found = []
    groups = [(group, True) for group in getattr(model, "exactly_one", ())]
    groups += [(group, False) for group in getattr(model, "at_most_one", ())]
    for group, required in groups:
        given = [name for name in group if name in data]
        if required and not given:
            found.append(Trouble((), f"needs one of {listed(group)}"))
        elif len(given) > 1:
            found.append(Trouble((given[-1],), f"give only one of {listed(group)}"))
    for path, inner, part in _tables_within(model, data):
        found += [trouble.below(*path) for trouble in _presence(inner, part)]
    return found


def _together(table: BaseModel) -> list[Trouble]:
    """What the tables themselves find wrong with their values taken together."""
    found: list[Trouble] = getattr(table, "troubles", list)()
    for name in type(table).model_fields:
        value = getattr(table, name)
        for path, inner in (
            [((name, key), part) for key, part in value.items()]
            if isinstance(value, dict)
            else [((name,), value)]
        ):
            if isinstance(inner, BaseModel):
                found += [trouble.below(*path) for trouble in _together(inner)]
    return found


def _of_sound_parts(model: type[BaseModel], data: Any) -> list[Trouble]:
    """What the tables within find, where one of them failed and the whole cannot be asked."""
    found = []
    for path, inner, part in _tables_within(model, data):
        try:
            table = inner.model_validate(part)
        except ValidationError:
            found += [trouble.below(*path) for trouble in _of_sound_parts(inner, part)]
        else:
            found += [trouble.below(*path) for trouble in _together(table)]
    return found


def _tables_within(
    model: type[BaseModel], data: Any
) -> Iterator[tuple[Path, type[BaseModel], Mapping[str, Any]]]:
    """Path, model and data of each table directly within another.

    And of each named one in a table of tables.
    """
    for name, field in model.model_fields.items() if isinstance(data, Mapping) else ():
        value = data.get(name)
        parts: list[tuple[Path, Any]] = [((name,), value)]
        if get_origin(field.annotation) is dict and isinstance(value, Mapping):
            parts = [((name, key), part) for key, part in value.items()]
        for path, part in parts:
            inner = _model_for(field.annotation, part)
            if inner is not None and isinstance(part, Mapping):
                yield path, inner, part


def _model_for(annotation: Any, data: Any) -> type[BaseModel] | None:
    """The table that an annotation such as `Table | None` means for some data: of several.

    That of the data's kind.
    """
    models = list(models_in(annotation))
    if len(models) < 2:
        return models[0] if models else None
    kind = data.get("kind") if isinstance(data, Mapping) else None
    return next((m for m in models if kind in get_args(m.model_fields["kind"].annotation)), None)


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The tables in an annotation such as `Table | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models_in(part)


def _translate(error: ValidationError, model: type[BaseModel], data: Any) -> list[Trouble]:
    """Pydantic's errors as troubles; the several errors of one union become one."""
    by_path: dict[Path, list[Any]] = {}
    for item in error.errors(include_url=False):
        by_path.setdefault(_real_path(item["loc"], data), []).append(item)
    troubles = []
    for path, items in by_path.items():
        # A value of the right kind is told its limits, not what else it might have been.
        telling = [item for item in items if item["type"] not in _KINDS] or items
        texts = dict.fromkeys(_sentence(item, model, path, data) for item in telling)
        troubles.append(Trouble(path, _joined(list(texts))))
    return troubles


def _joined(texts: list[str]) -> str:
    """Alternatives of a union in one sentence: "must be a or b, not 3"."""
    head, tail = "must be ", ", not "
    if len(texts) > 1 and all(text.startswith(head) and tail in text for text in texts):
        last = texts[-1].rpartition(tail)[2]
        return (
            head
            + " or ".join(text.removeprefix(head).rpartition(tail)[0] for text in texts)
            + tail
            + last
        )
    return texts[0]


def _real_path(location: Iterable[str | int], data: Any) -> Path:
    """A location without the names that pydantic adds for the branches of a union."""
    path: list[str | int] = []
    node = data
    parts = list(location)
    for position, part in enumerate(parts):
        if isinstance(node, Mapping):
            if part in node:
                node = node[part]
                path.append(part)
            elif position == len(parts) - 1:
                path.append(part)
        elif isinstance(node, Sequence) and not isinstance(node, str) and isinstance(part, int):
            path.append(part)
            node = node[part] if part < len(node) else None
    return tuple(path)


def _sentence(item: Any, model: type[BaseModel], path: Path, data: Any) -> str:  # noqa: PLR0911 (one for each kind)
    kind, value, context = item["type"], item["input"], item.get("ctx", {})
    name = str(path[-1]) if path else ""
    if kind == "missing":
        return "missing" + _meaning(model, path, data)
    if kind == "extra_forbidden":
        return f"unknown key ({suggest(name, _known_keys(model, path[:-1], data))})"
    if kind == "union_tag_not_found":
        return "missing: kind, which says what it is; known are in `thzcl schema`"
    if kind == "union_tag_invalid":
        return f"kind must be {context['expected_tags'].replace(', ', ' or ')}, not {shown(value.get('kind'))}"
    if kind == "literal_error":
        return f"must be {context.get('expected')}, not {shown(value)}"
    if kind in _LIMITS:
        limit = next(v for k, v in context.items() if k in ("gt", "ge", "lt", "le"))
        return f"must be {_LIMITS[kind]} {limit:g}{_unit(model, path, data)}, not {shown(value)}"
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}, not {shown(value)}"
    if kind in ("too_short", "too_long"):
        wanted = context.get("min_length", context.get("max_length"))
        return f"must hold {wanted} values, not {context.get('actual_length')}"
    message = str(item["msg"])
    return f"{message[:1].lower()}{message[1:]}, not {shown(value)}"


_LIMITS = {
    "greater_than": "above",
    "greater_than_equal": "at least",
    "less_than": "below",
    "less_than_equal": "at most",
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
    """A value as it stands in TOML, cut short."""
    text = f'"{value}"' if isinstance(value, str) else str(value)
    if isinstance(value, bool):
        text = text.lower()
    elif isinstance(value, Mapping):
        text = "a table"
    elif isinstance(value, Sequence) and not isinstance(value, str):
        text = "[" + ", ".join(shown(part) for part in value) + "]"
    return text if len(text) <= 60 else text[:57] + "..."


def suggest(name: str, known: Iterable[str]) -> str:
    """The nearest known name as a question, or all there are."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if near:
        return f"did you mean {near[0]}?"
    return f"known: {', '.join(names)}" if names else "nothing is known here"


def _field(model: type[BaseModel], path: Path, data: Any) -> Any:
    """The field that a path leads to, through nested tables; None where it leads nowhere."""
    field = None
    table: type[BaseModel] | None = model
    names = [part for part in path if not isinstance(part, int)]
    while names:
        name = str(names.pop(0))
        field = table.model_fields.get(name) if table else None
        data = data.get(name) if isinstance(data, Mapping) else None
        if field and get_origin(field.annotation) is dict and names:
            data = data.get(names.pop(0)) if isinstance(data, Mapping) else None
        table = _model_for(field.annotation, data) if field else None
    return field


def _known_keys(model: type[BaseModel], path: Path, data: Any) -> Iterable[str]:
    inner: Any = data
    for part in path:
        inner = inner.get(part) if isinstance(inner, Mapping) else None
    field = _field(model, path, data)
    table = _model_for(field.annotation, inner) if field else model if not path else None
    return table.model_fields if table else ()


def _meaning(model: type[BaseModel], path: Path, data: Any) -> str:
    description = getattr(_field(model, path, data), "description", None)
    return f": {description}" if description else ""


def _unit(model: type[BaseModel], path: Path, data: Any) -> str:
    extra = getattr(_field(model, path, data), "json_schema_extra", None) or {}
    return f" {extra['unit']}" if extra.get("unit") else ""


def listed(names: Sequence[str]) -> str:
    """Names as a, b or c."""
    return ", ".join(names[:-1]) + " or " + names[-1]
