"""Finds plugins, imports the one that is asked for, and says what is wrong with it, if anything is.

A hook says what a kind of plugin must keep; built-ins and third parties' go the same way.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pluggy

from thzcl.errors import PluginError
from thzcl.plugins import hooks
from thzcl.plugins.guard import Breach, call
from thzcl.plugins.names import suggest

OWN = "thzcl"  # the distribution of the built-ins


@dataclass(frozen=True, eq=False)
class Hook:
    """A kind of plugin: where it is announced, and what it must keep."""

    group: str  # of entry points
    register: str  # the function of hooks.py that returns a module's classes
    word: str  # what messages call it
    base: type
    contracts: range  # the versions that are accepted; the last is today's
    members: Mapping[str, tuple[type, str]]  # attribute -> class that it derives from, its name
    built_ins: Mapping[str, str]  # name -> module
    reserved: frozenset[str] = frozenset()  # names that no third party's plugin may have
    also: Callable[[type], None] | None = None  # raises Breach for what else a class must keep


@dataclass(frozen=True)
class Origin:
    """Where a plugin comes from."""

    name: str
    module: str
    distribution: str


def built_ins(package: str, register: str) -> dict[str, str]:
    """Returns the plugins in a package of thzcl's own: name to module, as the modules' texts say.

    A plugin is one file with a function `register`; no list of them is kept, and none is imported.
    """
    spec = find_spec(package)
    folders = (spec.submodule_search_locations if spec else None) or []
    found: dict[str, str] = {}
    for path in sorted(path for folder in folders for path in Path(folder).glob("*.py")):
        text = path.read_text(encoding="utf-8")
        if re.search(rf"^def {register}\(", text, re.MULTILINE):
            names = re.findall(r'^    name = "([^"]+)"$', text, re.MULTILINE)
            found |= dict.fromkeys(names, f"{package}.{path.stem}")
    return found


def origins(hook: Hook) -> list[Origin]:
    """Returns every plugin on offer, built-ins first; nothing is imported."""
    from importlib.metadata import entry_points

    known = [Origin(name, module, OWN) for name, module in hook.built_ins.items()]
    for point in entry_points(group=hook.group):
        distribution = point.dist.name if point.dist else None
        if distribution != OWN:
            known.append(Origin(point.name, point.value, distribution or "an unnamed distribution"))
    return known


def find(hook: Hook, name: str) -> type:
    """Returns the plugin of that name, its module imported and checked. Raises PluginError."""
    return load(hook, origin(hook, name))


@cache  # variants ask again and again, and looking through what is installed takes milliseconds
def origin(hook: Hook, name: str) -> Origin:
    """Returns where the plugin of that name comes from. Raises PluginError for none, or several.

    A name of a built-in means the built-in, whoever else claims it.
    """
    if name in hook.built_ins:
        return Origin(name, hook.built_ins[name], OWN)
    known = origins(hook)
    same = [one for one in known if one.name == name]
    if not same:
        near = suggest(name, [one.name for one in known])
        raise PluginError(f'no {hook.word} "{name}" is installed ({near})')
    if len(same) > 1:
        owners = " and ".join(sorted(one.distribution for one in same))
        raise PluginError(f'"{name}" is claimed by {owners}; uninstall one of them')
    return same[0]


@cache
def load(hook: Hook, source: Origin) -> type:
    """Imports a plugin and returns its class.

    Raises PluginError naming plugin, distribution and reason.
    """
    owner = f"{describe(hook, source)} ({source.module}) cannot be used"
    return call(owner, _imported, hook, source, error=PluginError)


def describe(hook: Hook, source: Origin) -> str:
    """Returns a plugin and its distribution in words."""
    return f'{hook.word} "{source.name}" of {source.distribution}'


def _imported(hook: Hook, source: Origin) -> type:
    """Imports a plugin's module and returns the class of the plugin's name, once it is checked."""
    if source.name in hook.reserved and source.distribution != OWN:
        raise Breach(f'"{source.name}" is a name that thzcl keeps for itself; choose another')
    manager = pluggy.PluginManager("thzcl")
    manager.add_hookspecs(hooks)
    manager.register(import_module(source.module), source.name)
    manager.check_pending()
    groups = getattr(manager.hook, hook.register)()
    for offered in (plugin for group in groups for plugin in group):
        if getattr(offered, "name", None) == source.name:
            _check(hook, offered)
            chosen: type = offered
            return chosen
    raise Breach(f'{hook.register}() offers no {hook.word} named "{source.name}"')


def _check(hook: Hook, offered: Any) -> None:
    """Raises Breach if a class does not keep the contract."""
    if not (isinstance(offered, type) and issubclass(offered, hook.base)):
        called = f"{hook.base.__module__}.{hook.base.__qualname__}"
        raise Breach(f"{offered!r} is not a subclass of {called}")
    version = getattr(offered, "contract", None)
    if version not in hook.contracts:
        raise Breach(
            f"it was written for version {version} of the {hook.word} contract, "
            f"this thzcl has version {hook.contracts[-1]}; update it"
        )
    for name, (base, called) in hook.members.items():
        member = getattr(offered, name, None)
        if not (isinstance(member, type) and issubclass(member, base)):
            raise Breach(f"its {name} is not a subclass of {called}")
    missing = sorted(getattr(offered, "__abstractmethods__", ()))
    if missing:
        raise Breach(f"it does not define {' and '.join(missing)}()")
    if hook.also is not None:
        hook.also(offered)
