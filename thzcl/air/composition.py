"""Constituents of the air: what their hook asks of them, and every call into one, guarded."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air import answers, grid, particles, validity
from thzcl.air.validity import Ranges
from thzcl.constituent import (
    CONTRACT,
    RESERVED_NAMES,
    Constituent,
    File,
    Grid,
    OpticalProperties,
    Parameters,
    Span,
)
from thzcl.errors import FileError, PluginError, RangeError
from thzcl.plugins import guard, loader
from thzcl.plugins.loader import Hook

Array = NDArray[np.float64]


HOOK = Hook(
    group="thzcl.constituents",
    register="register_constituents",
    word="constituent",
    base=Constituent,
    contracts=range(1, CONTRACT + 1),
    members={"Params": (Parameters, "thzcl.constituent.Parameters")},
    built_ins=loader.built_ins("thzcl.air.constituents", "register_constituents"),
    reserved=RESERVED_NAMES,
    also=answers.check_class,
)


@dataclass(frozen=True)
class Part:
    """One constituent of an air by name and parameters; its object is made where it works.

    What is spheres is summed over so many `sizes` of them.
    """

    name: str
    params: Parameters
    sizes: int = field(default_factory=particles.usual_count)

    def files(self) -> dict[str, tuple[File, Grid]]:
        """Returns the files among the parameters by key, and what each of them is to hold."""
        fields = type(self.params).model_fields
        given = {key: getattr(self.params, key) for key in file_keys(type(self.params))}
        return {
            key: (file, fields[key].json_schema_extra)  # type: ignore[misc]
            for key, file in given.items()
            if file is not None
        }

    def with_files(self, change: Callable[[File, Grid], File]) -> Part:
        """Returns the constituent with other files."""
        new = {key: change(file, holds) for key, (file, holds) in self.files().items()}
        return replace(self, params=self.params.model_copy(update=new)) if new else self


@dataclass(frozen=True)
class _Made:
    """A constituent at work; what it says of itself is checked."""

    constituent: Constituent
    owner: str  # the constituent and its distribution, in words
    varies: bool
    valid: tuple[Span, ...]
    limited: frozenset[str]  # the quantities of `valid`


def file_keys(params: type[Parameters]) -> list[str]:
    """Returns the parameters that are files."""
    fields = params.model_fields.items()
    return [key for key, field in fields if isinstance(field.json_schema_extra, Grid)]


def constituent_class(name: str) -> type[Constituent]:
    """Returns the constituent of that name, its module imported and checked. Raises PluginError."""
    return loader.find(HOOK, name)


def describe(name: str) -> str:
    """Returns a constituent that is loaded, and its distribution, in words."""
    return loader.describe(HOOK, loader.origin(HOOK, name))


def part(name: str, table: Mapping[str, Any] | None = None) -> Part:
    """Returns the constituent that a sound table of parameters describes.

    Raises PluginError, or PluginFailure where its parameters cannot be made or compared.
    """
    return _part(name, table) if table else _plain(name, particles.usual_count())


def _part(name: str, table: Mapping[str, Any]) -> Part:
    kind = constituent_class(name)

    def validated() -> Parameters:
        params = kind.Params.model_validate(table)
        hash(params)  # equal work is done once, which must be seen from the parameters
        return params

    return Part(name, guard.call(describe(name), validated))


@cache
def _plain(name: str, sizes: int) -> Part:
    """Returns a constituent without parameters, as most gases are."""
    return replace(_part(name, {}), sizes=sizes)


def located(one: Part, locate: Callable[[str], Path]) -> Part:
    """Returns a constituent whose files have their path and digest, and have been read once.

    Raises FileError for files that cannot be used, and whatever `locate` raises.
    """

    def found(file: File, holds: Grid) -> File:
        path = locate(file.name)
        known = File(file.name, path, files.digest(path, files.GRID))
        grid.read(known, holds)
        return known

    return one.with_files(found)


@lru_cache(maxsize=64)
def made(one: Part) -> _Made:
    """Returns a constituent at work, which reads its files.

    Raises FileError, PluginError, or PluginFailure if its constructor fails.
    """
    kind, owner = constituent_class(one.name), describe(one.name)
    params = one.with_files(grid.read).params

    def working() -> _Made:
        with particles.sizes_of(one.sizes):
            constituent = kind(params)
        varies, valid = answers.claims(constituent)
        limited = frozenset(span.quantity for span in valid)
        return _Made(constituent, owner, varies, valid, limited)

    return guard.call(owner, working, let=(FileError,))


def optical_properties(
    one: Part, frequency_hz: Any, temperature_k: Any, pressure_hpa: Any, vapour_hpa: Any
) -> OpticalProperties:
    """Returns the optics of a constituent as float64 arrays of the arguments' common shape.

    Parts and moments are checked where they are asked for. Raises RangeError where the constituent
    is not valid, PluginFailure for whatever it raises and for an answer that breaks its contract,
    and PluginError for a gas that scatters.
    """
    at_work = made(one)
    state = [_read_only(x) for x in (frequency_hz, temperature_k, pressure_hpa, vapour_hpa)]
    hz, kelvin, hpa, vapour = state
    if hz.size:
        _refuse_zero(hz)
        named = {"temperature_k": kelvin, "pressure_hpa": hpa, "vapour_hpa": vapour}
        refuse(one, validity.ranges(at_work.limited, frequency_ghz=hz / 1e9, **named))
    shape = np.broadcast_shapes(*(x.shape for x in state))

    def answered() -> OpticalProperties:
        return answers.checked(at_work.constituent.optics(*state), shape)

    found = guard.call(at_work.owner, answered)
    if constituent_class(one.name).gas and answers.is_no_gas(found, kelvin):
        text = "a gas neither scatters nor has a temperature of its own"
        raise PluginError(f"{at_work.owner}: {text}; {_instead(one)}")
    return found


@lru_cache(maxsize=64)
def layer_top_m(one: Part) -> float:
    """Returns how far up the sky holds a constituent, m; a gas is there all the way up.

    Raises PluginFailure.
    """
    if constituent_class(one.name).gas:
        return math.inf
    at_work = made(one)
    return guard.call(at_work.owner, answers.layer_top_m, at_work.constituent)


def parts(one: Part, found: OpticalProperties) -> dict[str, Array]:
    """Returns the parts of what a constituent absorbs, by name. Raises PluginFailure."""
    return guard.call(made(one).owner, answers.parts, found)


def moments(one: Part, found: OpticalProperties) -> Array:
    """Returns the moments of a constituent's phase function, (order, *shape).

    Raises PluginFailure.
    """
    return guard.call(made(one).owner, answers.moments, found)


def notes(one: Part, temperature_k: Any, pressure_hpa: Any, vapour_hpa: Any) -> list[str]:
    """Returns what a constituent has to tell of air of some states. Raises PluginFailure."""
    at_work = made(one)
    state = [_read_only(x) for x in (temperature_k, pressure_hpa, vapour_hpa)]

    def told() -> list[str]:
        return [
            f"{one.name}: {text}" for text in answers.sentences(at_work.constituent.notes(*state))
        ]

    return guard.call(at_work.owner, told)


def alternatives(one: Part) -> list[Part]:
    """Returns constituents that might be meant as well, by their author. Raises PluginFailure."""
    at_work, kind = made(one), type(one.params)

    def offered() -> list[Parameters]:
        return answers.others(at_work.constituent.alternatives(), kind)

    return [replace(one, params=params) for params in guard.call(at_work.owner, offered)]


@lru_cache(maxsize=64)  # variants often have their air in common
def lines(
    one: Part, temperature_k: float, pressure_hpa: float, vapour_hpa: float
) -> tuple[Array, float]:
    """Returns where a constituent's lines stand and how wide they are, in Hz.

    Raises PluginFailure.
    """
    at_work = made(one)
    state = temperature_k, pressure_hpa, vapour_hpa
    answer = guard.call(at_work.owner, at_work.constituent.lines, *state)
    return guard.call(at_work.owner, answers.checked_lines, answer)


def lacking(one: Part, asked: Ranges) -> str | None:
    """Returns in words what a constituent is not valid for, or None if it is for all."""
    words = (validity.in_words(one.name, *out) for out in validity.outside(made(one).valid, asked))
    return next(words, None)


def refuse(one: Part, asked: Ranges) -> None:
    """Raises RangeError where a constituent is not valid for all that is asked for."""
    for span, value in validity.outside(made(one).valid, asked):
        text = validity.in_words(one.name, span, value)
        raise RangeError(f"{text}; {_remedy(one, asked)}", span.quantity, value)


def _refuse_zero(frequency_hz: Array) -> None:
    lowest = float(frequency_hz.min()) / 1e9
    if not lowest > 0:
        raise RangeError(f"{lowest:g} GHz: must be above 0", "frequency_ghz", lowest)


def _instead(one: Part) -> str:
    gas = constituent_class(one.name).gas
    return "choose another model" if gas else f"remove [atmosphere.{one.name}]"


def _remedy(one: Part, asked: Ranges) -> str:
    if not constituent_class(one.name).gas:
        return _instead(one)
    others = [f'"{name}"' for name in gases() if name != one.name and _would_do(name, asked)]
    return f"model = {' or '.join(others)} would do"


def _would_do(name: str, asked: Ranges) -> bool:
    """Returns whether a gas is valid for all that is asked for, as far as its class tells."""
    try:
        valid = constituent_class(name).valid
    except PluginError:
        return False
    return isinstance(valid, tuple) and not any(validity.outside(valid, asked))


def gases() -> list[str]:
    """Returns the names of the gases on offer that can be loaded; all are imported."""
    names = []
    for origin in loader.origins(HOOK):
        try:
            if constituent_class(origin.name).gas:
                names.append(origin.name)
        except PluginError:
            continue
    return list(dict.fromkeys(names))


def _read_only(given: Any) -> Array:
    view = np.asarray(given, dtype=np.float64).view()
    view.flags.writeable = False
    return view
