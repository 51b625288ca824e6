"""The constituents of a scene's air: what is wrong with their tables, and their making."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from thzcl.air.composition import (
    HOOK,
    Part,
    constituent_class,
    describe,
    file_keys,
    gases,
    part,
)
from thzcl.constituent import Constituent
from thzcl.errors import PluginError
from thzcl.plugins import guard, loader
from thzcl.plugins.names import suggest
from thzcl.scenario.problems import Trouble, shown, validate


def parts(model: str, model_file: str | None, tables: Mapping[str, Any]) -> tuple[Part, ...]:
    """Returns the gas and whatever else is in the air, by name, as sound tables describe them.

    `tables` holds the tables of constituents by name. Raises PluginError or PluginFailure.
    """
    gas = part(model, _with_file(constituent_class(model), tables.get(model, {}), model_file))
    others = sorted(name for name in tables if name != model)
    return gas, *(part(name, tables[name]) for name in others)


def gas(model: str) -> Part:
    """Returns a gas without any parameters. Raises PluginError for what is none, or needs some."""
    kind = constituent_class(model)
    if not kind.gas:
        raise PluginError(f'"{model}" is no gas; choose one of {", ".join(gases())}')
    if _checked(model, kind, {}):
        raise PluginError(f'"{model}" needs parameters, which only a scenario gives')
    return part(model)


def troubles(table: Any, model: str, keys: Collection[str]) -> list[Trouble]:
    """Returns what is wrong with the constituents in an [atmosphere] table, paths relative to it.

    `keys` are those of the table itself, `model` the gas where none is chosen. Raises PluginFailure
    if a constituent's own check of its parameters fails.
    """
    if not isinstance(table, Mapping):
        return []  # the scene's own check says so
    tables = {name: value for name, value in table.items() if name not in keys}
    model = table.get("model", model)
    found = [trouble for name in tables for trouble in _other(name, tables, model, keys)]
    return [*_gas(model, table, tables), *found] if isinstance(model, str) else found


def _gas(model: str, table: Mapping[str, Any], tables: Mapping[str, Any]) -> Iterator[Trouble]:
    """Yields what is wrong with the gas: with its name, its file, and its parameters."""
    try:
        kind = constituent_class(model)
    except PluginError as error:
        yield Trouble(("model",), str(error))
        return
    if not kind.gas:
        text = f'"{model}" is no gas, and joins any model by a table [atmosphere.{model}]'
        yield Trouble(("model",), f"{text}; choose another model")
        return
    file, own, keys = table.get("model_file"), tables.get(model, {}), file_keys(kind.Params)
    if file is not None and not keys:
        text = f'is read by a model that is a table, and not by "{model}"'
        yield Trouble(("model_file",), f"{text}; remove it or change model")
    elif file is not None and keys[0] in own:
        yield Trouble(("model_file",), f"give only one of model_file and {model}.{keys[0]}")
    elif isinstance(own, Mapping):
        for trouble in _checked(model, kind, _with_file(kind, own, file)):
            lacking = trouble.path[:1] == tuple(keys[:1]) and keys[0] not in own
            yield Trouble(("model_file",), trouble.text) if lacking else trouble.below(model)


def _other(
    name: str, tables: Mapping[str, Any], model: Any, keys: Collection[str]
) -> Iterator[Trouble]:
    """Yields what is wrong with one more key of [atmosphere]: a constituent's table, or unknown."""
    known = {origin.name for origin in loader.origins(HOOK)}
    if name not in known:
        which = "unknown key"
        if isinstance(tables[name], Mapping):
            which += ", and no constituent of that name is installed"
        yield Trouble((name,), f"{which} ({suggest(name, {*keys, *known})})")
        return
    try:
        kind = constituent_class(name)
    except PluginError as error:
        yield Trouble((name,), str(error))
        return
    if not isinstance(tables[name], Mapping):
        yield Trouble((name,), f"must be a table, not {shown(tables[name])}")
    elif kind.gas and name != model:
        text = f'is the table of a gas that is not in use; remove it, or set model = "{name}"'
        yield Trouble((name,), text)
    elif not kind.gas:
        yield from (trouble.below(name) for trouble in _checked(name, kind, tables[name]))


def _checked(name: str, kind: type[Constituent], table: Mapping[str, Any]) -> list[Trouble]:
    """Returns what is wrong with a constituent's parameters."""
    return guard.call(describe(name), validate, kind.Params, table)[1]


def _with_file(
    kind: type[Constituent], table: Mapping[str, Any], model_file: str | None
) -> Mapping[str, Any]:
    """Returns a gas' parameters with the file that `model_file` names, which it may have."""
    keys = file_keys(kind.Params)
    return table if model_file is None or not keys else {keys[0]: model_file, **table}
