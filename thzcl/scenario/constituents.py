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
from thzcl.scenario.problems import Path, Trouble, shown, validate


def parts(model: str, model_file: str | None, tables: Mapping[str, Any]) -> tuple[Part, ...]:
    """Returns the gas and whatever else is in the air, by name, as sound tables describe them.

    `tables` holds the tables of constituents by name. Raises PluginError or PluginFailure.
    """
    gas = part(model, _with_file(constituent_class(model), tables.get(model, {}), model_file))
    others = sorted(name for name in tables if not constituent_class(name).gas)
    return gas, *(part(name, tables[name]) for name in others)


def gas(model: str) -> Part:
    """Returns a gas without any parameters. Raises PluginError for what is none, or needs some."""
    kind = constituent_class(model)
    if not kind.gas:
        raise PluginError(f'"{model}" is no gas; choose one of {", ".join(gases())}')
    if _checked(model, kind, {}):
        raise PluginError(f'"{model}" needs parameters, which only a scenario gives')
    return part(model)


def other(name: str, table: Mapping[str, Any]) -> Part | list[Trouble]:
    """Returns what is no gas, with some parameters, or what is wrong with them."""
    return _checked(name, constituent_class(name), table) or part(name, table)


def troubles(table: Any, model: str, keys: Collection[str]) -> list[Trouble]:
    """Returns what is wrong with the constituents in an [atmosphere] table, paths relative to it.

    `keys` are those of the table itself, `model` the gas where none is chosen. Raises PluginFailure
    if a constituent's own check of its parameters fails.
    """
    if not isinstance(table, Mapping):
        return []  # the scene's own check says so
    tables = {name: value for name, value in table.items() if name not in keys}
    used = _used(table, model)
    found = [trouble for name in tables for trouble in _other(name, tables, used, keys)]
    gases: dict[str, type[Constituent]] = {}
    for path, name in used.items():
        wrong = _misnamed(name, gases)
        if wrong is None:
            gases[name] = constituent_class(name)
            found += _gas(name, table.get("model_file"), tables)
        else:
            found.append(Trouble(path, wrong))
    if table.get("model_file") is not None and gases and len(gases) == len(used):
        found += _unread(gases, model=table.get("model", model))
    return found


def _used(table: Mapping[str, Any], model: str) -> dict[Path, str]:
    """Returns the names of the gases in use, the main one first, by where they stand."""
    compared = table.get("compare", ())
    used: dict[Path, Any] = {("model",): table.get("model", model)}
    if isinstance(compared, list | tuple):
        used |= {("compare", place): name for place, name in enumerate(compared)}
    return {path: name for path, name in used.items() if isinstance(name, str)}


def _misnamed(name: str, among: Collection[str]) -> str | None:
    """Returns why there is no gas of a name to be used beside others, or None if there is one."""
    try:
        kind = constituent_class(name)
    except PluginError as error:
        return str(error)
    if not kind.gas:
        text = f'"{name}" is no gas, and joins any model by a table [atmosphere.{name}]'
        return f"{text}; choose another model"
    return f'"{name}" is there already; name each model once' if name in among else None


def _unread(gases: Mapping[str, type[Constituent]], model: str) -> Iterator[Trouble]:
    """Yields that none of the gases reads model_file, if so."""
    if not any(file_keys(kind.Params) for kind in gases.values()):
        text = f'is read by a model that is a table, and not by "{model}"'
        yield Trouble(("model_file",), f"{text}; remove it or change model")


def _gas(model: str, file: Any, tables: Mapping[str, Any]) -> Iterator[Trouble]:
    """Yields what is wrong with a gas' parameters, of which model_file may give one."""
    kind, own = constituent_class(model), tables.get(model, {})
    keys = file_keys(kind.Params)
    if file is not None and keys and keys[0] in own:
        yield Trouble(("model_file",), f"give only one of model_file and {model}.{keys[0]}")
    elif isinstance(own, Mapping):
        for trouble in _checked(model, kind, _with_file(kind, own, file)):
            lacking = trouble.path[:1] == tuple(keys[:1]) and keys[0] not in own
            yield Trouble(("model_file",), trouble.text) if lacking else trouble.below(model)


def _other(
    name: str, tables: Mapping[str, Any], used: Mapping[Any, str], keys: Collection[str]
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
    elif kind.gas and name not in used.values():
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
