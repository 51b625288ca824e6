"""Which column of a record holds what, and in which unit.

Columns are found by their usual names, unless the user names them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from thzcl.air.units import UNITS, listed, plain
from thzcl.errors import RecordError

BY_SIZE = "?"  # a unit that only the size of the values can tell


class Role(NamedTuple):
    """What a column can hold, by its usual names and units.

    `names` are in lower case, letters and digits alone. `units` maps each unit to the factor and
    offset that turn it into the record's. `assumed` is the unit of a column that names none, or
    empty where none can be assumed.
    """

    names: tuple[str, ...]
    units: dict[str, tuple[float, float]]
    assumed: str


class Column(NamedTuple):
    """A column's place and name, and how its values turn into g/m3, m/s, K, hPa or s."""

    at: int
    name: str
    factor: float = 1.0
    offset: float = 0.0
    assumed: str = ""  # the unit, or BY_SIZE, where the file names none


_SPEED, _DEGREES, _GRAMS, _HECTOPASCALS, _SECONDS = (
    {name.lower(): worth for name, worth in UNITS[unit].items()}
    for unit in ("m/s", "K", "g/m3", "hPa", "s")
)

ROLES = {
    "time": Role(
        ("timestamp", "time", "datetime", "tmstamp", "t", "times", "seconds", "unixtime"),
        _SECONDS,
        "s",
    ),
    "nanoseconds": Role(("nanoseconds",), _SECONDS, "ns"),
    "h2o": Role(
        ("h2o", "h2odensity", "h2oconc", "water", "watervapor", "watervapour",
         "absolutehumidity", "vapordensity", "vapourdensity", "rhov", "humidity"),
        _GRAMS,
        "g/m3",
    ),
    "Ux": Role(("ux", "u", "windx", "uwind"), _SPEED, "m/s"),
    "Uy": Role(("uy", "v", "windy", "vwind"), _SPEED, "m/s"),
    "Uz": Role(("uz", "w", "windz", "wwind"), _SPEED, "m/s"),
    "speed": Role(
        ("windspeed", "ws", "wndspd", "wind", "speed", "horizontalwindspeed"), _SPEED, "m/s"
    ),
    "Ts": Role(
        ("ts", "tsonic", "tson", "sonictemperature", "sonictemp", "virtualtemperature"),
        _DEGREES,
        "",
    ),
    "pressure": Role(
        ("press", "pressure", "airpressure", "atmosphericpressure", "pair", "p", "irgapress"),
        _HECTOPASCALS,
        "",
    ),
}  # fmt: skip
NEEDED = ("time", "h2o")


def find(names: Sequence[str], units: Sequence[str], chosen: str, place: str) -> dict[str, Column]:
    """Returns the columns of a file by role.

    `units` are those of the file's own line of units, or empty texts. `chosen` is what the user
    says, "h2o=NAME:UNIT,Ux=NAME"; `place` is the header's file and line, for messages. Raises
    RecordError if a column is missing, or if a unit is not known.
    """
    split = [_split(name, unit) for name, unit in zip(names, units, strict=True)]
    found: dict[str, Column] = {}
    for role, (name, unit) in _chosen(chosen).items():
        if name not in names and name not in [bare for bare, _ in split]:
            raise RecordError(
                f"{place}: --columns {role}={name}: no such column; there are {', '.join(names)}"
            )
        named = names.index(name) if name in names else [bare for bare, _ in split].index(name)
        found[role] = _column(role, named, names[named], unit or split[named][1], place)
    seconds = [at for at, name in enumerate(names) if name.lower() == "seconds"]
    for role in ROLES:
        at = None if role in found else _usual(role, split)
        if (
            role == "time" and at is not None and seconds and "Nanoseconds" in names
        ):  # LI-COR's Time is text of its own
            at = seconds[0]
        if at is not None:
            found[role] = _column(role, at, names[at], split[at][1], place)
    _complete(found, names, place)
    return found


def _complete(found: dict[str, Column], names: Sequence[str], place: str) -> None:
    """Raises RecordError if a column of time, humidity or wind is missing."""
    told = f"; there are {', '.join(names)[:300]}; name it with --columns"
    for role in NEEDED:
        if role not in found:
            meant = (
                "of water vapour (h2o) in g/m3 or mmol/m3" if role == "h2o" else "of time stamps"
            )
            raise RecordError(f"{place}: expected a column {meant}{told} {role}=NAME")
    if not ({"Ux", "Uy"} <= found.keys() or "speed" in found):
        raise RecordError(
            f"{place}: expected columns of wind, Ux, Uy and Uz, or a wind speed, in m/s{told} "
            "Ux=NAME,Uy=NAME"
        )


def _chosen(text: str) -> dict[str, tuple[str, str]]:
    """Returns name and unit of each role in --columns; the unit is empty if none is given."""
    found = {}
    known = {role.lower(): role for role in ROLES}
    for item in filter(None, (part.strip() for part in text.split(","))):
        role, equals, column = (part.strip() for part in item.partition("="))
        if not equals or not column or role.lower() not in known:
            roles = ", ".join(ROLES)
            raise RecordError(
                f"--columns {item}: write ROLE=NAME or ROLE=NAME:UNIT, with a role of {roles}"
            )
        name, _, unit = column.partition(":")
        found[known[role.lower()]] = (name.strip(), unit.strip())
    return found


def _usual(role: str, split: Sequence[tuple[str, str]]) -> int | None:
    """Returns the first column with a usual name for a role, or None.

    A column that names no unit, or one that can be used, goes before others.
    """
    plain = [
        re.sub(r"[^a-z0-9]", "", re.sub(r"^aux\s*\d*\s*-?\s*", "", name.lower()))
        for name, _ in split
    ]
    matches = [at for name in ROLES[role].names for at, bare in enumerate(plain) if bare == name]
    usable = [at for at in matches if not split[at][1] or _unit(split[at][1]) in ROLES[role].units]
    return next(iter(usable or matches), None)


def _column(role: str, at: int, name: str, unit: str, place: str) -> Column:
    """Returns the column of a role. Raises RecordError for a unit that is not known."""
    known = ROLES[role].units
    if role == "time" and not unit:
        return Column(at, name)
    if not unit:
        assumed = ROLES[role].assumed
        return Column(at, name, *known.get(assumed, (1.0, 0.0)), assumed=assumed or BY_SIZE)
    if _unit(unit) not in known:
        raise RecordError(
            f'{place}: column {name}: unknown unit "{unit}"; expected one of {listed(known)}'
        )
    return Column(at, name, *known[_unit(unit)])


def _unit(text: str) -> str:
    """Returns a unit as ROLES spells it, in lower case; g_m_3 and g/m3 are the same."""
    short = plain(text).lower()
    if short == "ms" and "_" in text:
        return "m/s"
    return re.sub(r"^(m?g|kg|m?mol)m3$", r"\1/m3", short)


_BRACKETS = re.compile(r"^(.*?)[\s_]*[(\[]([^)\]]*)[)\]]\s*$")
_ENDING = re.compile(r"^(.*?)_((?:m?g|kg|m?mol)_m3|m_s|degc|deg_c|[ck]|[hk]?pa|s)$", re.IGNORECASE)


def _split(name: str, unit: str) -> tuple[str, str]:
    """Returns a column's bare name and its unit.

    The unit is that of the line of units, or stands in the name, in brackets or as an ending such
    as _g_m3.
    """
    if unit.strip():
        return name.strip(), unit.strip()
    found = _BRACKETS.match(name) or _ENDING.match(name)
    return (found[1].strip(), found[2].strip()) if found and found[1] else (name.strip(), "")
