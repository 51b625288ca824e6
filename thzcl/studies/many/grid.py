"""The grid of a study: which keys are varied, over which values, two together where they pair."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np
import tomli

from thzcl.air.spectrum import values as numbers
from thzcl.errors import UsageError
from thzcl.scenario.text import plain

RANGE = "range_m"  # the key of a target that only studies know
VARIANT = "variant"  # as if it were a key: which variant of the scene a member is


@dataclass(frozen=True)
class Axis:
    """Keys that change together: at each point of the axis each key has one value."""

    keys: tuple[str, ...]
    points: tuple[tuple[Any, ...], ...]

    def settings(self) -> Iterator[dict[str, Any]]:
        """Yields the settings of each point."""
        for point in self.points:
            yield dict(zip(self.keys, point, strict=True))


def axes(over: Mapping[str, Any], given_by: str) -> tuple[Axis, ...]:
    """Returns the axes of a grid; `over` maps keys, "a,b" for pairs, to texts or lists of values.

    `given_by` says in messages who asks for them: "--over" or "[study] over". Raises UsageError for
    an axis without values, for pairs that do not fit, and for a key that is varied twice.
    """
    found = tuple(_axis(name, values, f"{given_by} {name}") for name, values in over.items())
    every = [key for axis in found for key in axis.keys]
    twice = next((key for key in every if every.count(key) > 1), None)
    if twice is not None:
        raise UsageError(f"{given_by} {twice}: is varied twice; give each key one axis")
    return found


def of_variants(names: Sequence[str]) -> tuple[Axis, ...]:
    """Returns the axis along which each of several variants is a member, or none."""
    return (Axis((VARIANT,), tuple((name,) for name in names)),) if len(names) > 1 else ()


def from_options(options: Iterable[str]) -> dict[str, str]:
    """Returns `--over KEY=VALUES` options by key. Raises UsageError for one that is not that."""
    found: dict[str, str] = {}
    for option in options:
        name, equals, values = option.partition("=")
        name = ",".join(part.strip() for part in name.split(","))
        if not equals or not name.replace(",", ""):
            text = "write key=values, as in --over atmosphere.relative_humidity_percent=20:80:20"
            raise UsageError(f"--over {option}: {text}")
        if name in found:
            raise UsageError(f"--over {name}: is there already; give all its values once")
        found[name] = values
    return found


def size(grid: Sequence[Axis]) -> int:
    """Returns the number of points of a grid."""
    return prod(len(axis.points) for axis in grid)


def points(grid: Sequence[Axis]) -> Iterator[dict[str, Any]]:
    """Yields the settings of each point of a grid, the last axis fastest."""
    for parts in product(*(tuple(axis.settings()) for axis in grid)):
        yield {name: value for part in parts for name, value in part.items()}


def _axis(name: str, values: Any, place: str) -> Axis:
    """Returns one axis; `values` is a text of the command line, or a list."""
    keys = tuple(part.strip() for part in name.split(","))
    if not all(keys):
        raise UsageError(f"{place}: an empty key; write a,b=1:2,3:4 for two keys that pair")
    if isinstance(values, str):
        found = _from_text(values, len(keys), place)
    elif _is_list(values) or isinstance(values, np.ndarray | range):
        found = [
            tuple(value) if len(keys) > 1 and _is_list(value) else (value,)
            for value in _plain(values, place)
        ]
    else:
        raise UsageError(f'{place}: must be a list of values, or "start:stop:step"')
    if not found:
        raise UsageError(f"{place}: no values; give at least one")
    wrong = next((point for point in found if len(point) != len(keys)), None)
    if wrong is not None:
        text = f"{len(wrong)} of {len(keys)} values in {':'.join(map(str, wrong))}"
        raise UsageError(f"{place}: {text}; write a,b=1:2,3:4 for two keys that pair")
    return Axis(keys, tuple(found))


def _plain(values: Any, place: str) -> Any:
    """Returns values in TOML's own types, those of NumPy among them. Raises UsageError."""
    try:
        found = plain(values)
    except ValueError as error:
        raise UsageError(f"{place}: {error}") from None
    return found if isinstance(found, list) else [found]


def _is_list(value: Any) -> bool:
    return isinstance(value, list | tuple)


def _from_text(text: str, keys: int, place: str) -> list[tuple[Any, ...]]:
    """Returns the points of an axis in text: a list a,b,c, start:stop:step, or pairs 1:2,3:4."""
    if not text.strip():
        return []
    if keys == 1 and text.count(":") == 2 and not _split(text, ",")[1:]:
        try:
            return [(value,) for value in _whole(numbers(text).tolist(), text)]
        except ValueError as error:
            raise UsageError(f"{place}: {error}") from None
    parts = _split(text, ",")
    if not all(part.strip() for part in parts):
        raise UsageError(f"{place}: an empty value; write a,b,c")
    if keys == 1:
        return [(_value(part),) for part in parts]
    return [tuple(map(_value, _split(part, ":"))) for part in parts]


def _whole(found: list[float], text: str) -> list[float]:
    """Returns numbers as whole ones if the text has no fractions: pixels and seeds are whole."""
    if any(mark in text for mark in ".eE"):
        return found
    return [int(value) for value in found]


def _value(text: str) -> Any:
    """Returns a value of TOML; what is not TOML is text."""
    try:
        return tomli.loads(f"value = {text.strip()}")["value"]
    except (ValueError, RecursionError):
        return text.strip()


def _split(text: str, mark: str) -> list[str]:
    """Returns the parts of a text between marks that stand in no brackets, braces or quotes."""
    parts, depth, quoted = [""], 0, False
    for letter in text:
        quoted ^= letter == '"'
        if not quoted:
            depth += (letter in "[{") - (letter in "]}")
        if letter == mark and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += letter
    return parts
