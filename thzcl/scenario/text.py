"""TOML text to data and back, and what a program may hand over in place of TOML's values."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date, datetime, time
from pathlib import PurePath
from typing import Any

import numpy as np
import tomli
import tomli_w

from thzcl.errors import ScenarioError

DEEPEST = 16  # tables and lists within each other; scenes have four
_TOO_DEEP = f"tables and lists stand more than {DEEPEST} deep in each other; no key needs that"
_TOO_LONG = "a whole number has more than 64 bits; write it as in 1e99, or shorten it"


def load(text: str, label: str) -> dict[str, Any]:
    """Returns the data of a TOML text, which messages call `label`. Raises ScenarioError."""
    try:
        data: dict[str, Any] = plain(_parsed(text, label))
    except ValueError as error:
        raise ScenarioError([f"{label}: {error}"]) from None
    return data


def _parsed(text: str, label: str) -> dict[str, Any]:
    try:
        return tomli.loads(text)
    except tomli.TOMLDecodeError as error:
        reason = error.msg[:1].lower() + error.msg[1:]
        place = f"{label}:{error.lineno}: not valid TOML in column {error.colno}"
        raise ScenarioError([f"{place}: {reason}; mend it there"]) from None
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except ValueError:  # Python's own limit to the digits of a whole number
        raise ValueError(_TOO_LONG) from None


def dumps(data: Mapping[str, Any]) -> str:
    """Returns the TOML text of nested tables; keys whose value is None are left out.

    Raises ValueError for what TOML cannot hold.
    """
    return tomli_w.dumps(plain(data))


def plain(value: Any, deepest: int = DEEPEST) -> Any:
    """Returns a value in TOML's own types, into which NumPy's, tuples, ranges and paths are turned.

    Keys of a table whose value is None are left out. Raises ValueError for what TOML cannot hold.
    """
    if deepest < 0:
        raise ValueError(_TOO_DEEP)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, PurePath):
        value = str(value)
    if isinstance(value, Mapping):
        table = {name: part for name, part in value.items() if part is not None}
        if not all(isinstance(name, str) for name in table):
            raise ValueError("a key is no text; write keys in quotes")
        return {name: plain(part, deepest - 1) for name, part in table.items()}
    if isinstance(value, list | tuple | range):
        return [plain(part, deepest - 1) for part in value]
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError(_TOO_LONG)
    if not isinstance(value, str | int | float | datetime | date | time):
        kind = type(value).__name__
        raise ValueError(f"{kind} is no value of TOML; give a number, text or a list")  # noqa: TRY004
    return value
