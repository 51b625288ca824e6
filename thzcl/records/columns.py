"""Which column of a record holds what, and in which unit.

Columns are found by the names of loggers (Campbell's EasyFlux, LI-COR), of networks (ICOS,
FLUXNET, EddyPro) and of the CF conventions, unless the user names them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from thzcl.air.units import listed
from thzcl.errors import RecordError
from thzcl.records import units
from thzcl.records.units import Units, plain, split


class Role(NamedTuple):
    """What a column can hold, by its usual names and units.

    `names` are in lower case, letters and digits alone. `units` maps each unit to the factor and
    offset that turn it into the record's. `assumed` is the unit of a column that names none, or
    empty where its values tell. `kind` is that of humidity.
    """

    names: tuple[str, ...]
    units: Units
    assumed: str
    kind: str = ""


class Column(NamedTuple):
    """A column's place and name, and how its values turn into thzcl's units.

    `kind` says what humidity's values are: density (g/m3), mole or mole-dry (mol/mol), specific or
    ratio (kg/kg), or relative (per cent).
    """

    at: int
    name: str
    factor: float = 1.0
    offset: float = 0.0
    assumed: str = ""  # the unit, where the file names none
    kind: str = ""
    unit: str = ""  # as it was understood


@dataclass
class Columns:
    """The columns of a file by role, and what was noticed while they were looked for.

    `others` are further columns of humidity that would do, `without` those that were left out.
    """

    by_role: dict[str, Column] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    others: tuple[str, ...] = ()
    flags: tuple[Column, ...] = ()
    flagless: bool = False  # the user wants no flags


_TIMES = (
    *("timestamp", "datetime", "time", "tmstamp", "tstamp", "times", "timestampend", "dateandtime"),
    *("timestampstart", "timestamputc", "timeutc", "utctime", "datetimeutc", "epoch", "epochtime"),
    *("timestampmiddle", "timestampmid"),
    *("unixtime", "posixtime", "localtime", "datumzeit", "datumuhrzeit", "zeit", "timestampms"),
    *(
        "datenum",
        "matlabtime",
        "serialdate",
        "date",
        "elapsedtime",
        "seconds",
        "second",
        "sec",
        "t",
    ),
)
_DENSE = (
    *("h2o", "h2odensity", "h2oconc", "water", "watervapor", "watervapour", "vapor", "vapour"),
    *("absolutehumidity", "vapordensity", "vapourdensity", "rhov", "humidity", "ah", "h2od"),
    *("h2omolardensity", "h2oabs", "h2oli", "rhoh2o", "watervapordensity", "watervapourdensity"),
    *("massconcentrationofwatervaporinair", "h2oconcentration", "lih2o", "irgah2o", "h2oirga"),
)
_MOLES = (
    *("h2o", "h2omolefraction", "h2omolfrac", "h2omf", "xh2o", "chih2o", "h2owet", "h2omix"),
    *("molefractionofwatervaporinair", "h2omolarfraction", "h2ofraction", "watervapor", "h2oconc"),
)
_DRY = (
    *("h2odry", "h2omixingratio", "h2omr", "h2odrymolefraction", "mixingratio", "h2omixratio"),
    *("rh2o", "h2odryconc", "h2odrymolfrac", "drymolefractionofwatervapor", "chih2odry"),
)
_SPECIFIC = ("specifichumidity", "q", "hus", "sh", "spechum", "huss", "h2o", "humidity")
_RATIOS = ("humiditymixingratio", "mixingratio", "mr", "mixr", "h2omixingratio", "h2omr", "h2odry")
_RELATIVE = ("rh", "relativehumidity", "relhum", "hur", "rhair", "humidity", "rhpercent", "rf")
_SONIC = (
    *("ts", "tsonic", "tson", "sonictemperature", "sonictemp", "virtualtemperature", "tsonicair"),
    *(
        "tv",
        "tsv",
        "virttemp",
        "sonictair",
        "usonictemp",
        "airtemperaturesonic",
        "tsc",
        "tempsonic",
    ),
)
_AIR = (
    *("airtemperature", "ta", "tair", "airtemp", "airt", "tamb", "ambtmpr", "tambient", "temp"),
    *("temperature", "tempair", "airtc", "tc", "tempc", "t", "tas", "ambtemp", "tout"),
)
_PRESSES = (
    *("press", "pressure", "airpressure", "atmosphericpressure", "pair", "p", "irgapress", "pa"),
    *("ambpress", "airp", "barometricpressure", "baro", "bp", "patm", "pamb", "surfaceairpressure"),
    *("airpress", "stationpressure", "presskpa", "totalpressure", "ps", "luftdruck"),
    *("pressli7500", "ambpressli", "pressli", "pressirga", "ambpressirga", "cellpress"),
)

ROLES = {
    "time": Role(_TIMES, units.TIMES, ""),
    "nanoseconds": Role(("nanoseconds",), units.TIMES, "ns"),
    "h2o": Role(_DENSE, units.DENSITIES, "g/m3", "density"),
    "Ux": Role(
        ("ux", "u", "windx", "uwind", "windu", "eastwardwind", "xwind", "uwindspeed", "wsu",
         "usonic", "uunrot", "ucomponent", "windspeedu"), units.SPEED, "m/s"),
    "Uy": Role(
        ("uy", "v", "windy", "vwind", "windv", "northwardwind", "ywind", "vwindspeed", "wsv",
         "vsonic", "vunrot", "vcomponent", "windspeedv"), units.SPEED, "m/s"),
    "Uz": Role(
        ("uz", "w", "windz", "wwind", "windw", "upwardairvelocity", "wwindspeed", "wsonic",
         "wunrot", "wcomponent", "verticalwind", "windspeedw"), units.SPEED, "m/s"),
    "speed": Role(
        ("windspeed", "ws", "wndspd", "wind", "speed", "horizontalwindspeed", "wspd", "ff",
         "rsltwindspeed", "cupwindspeed", "windgeschwindigkeit", "wsavg"), units.SPEED, "m/s"),
    "Ts": Role(_SONIC, units.DEGREES, ""),
    "SOS": Role(("sos", "speedofsound", "soundspeed", "c", "vsound"), units.SPEED, "m/s"),
    "T": Role(_AIR, units.DEGREES, ""),
    "pressure": Role(_PRESSES, units.PRESSURES, ""),
}  # fmt: skip
# Humidity is looked for in this order: what is measured as a density needs no temperature.
HUMIDITIES = (
    ROLES["h2o"],
    Role(_MOLES, units.FRACTIONS, "", "mole"),
    Role(_DRY, units.FRACTIONS, "", "mole-dry"),
    Role(_RATIOS, units.MASSES, "", "ratio"),
    Role(_SPECIFIC, units.MASSES, "kg/kg", "specific"),
    Role(_RELATIVE, units.SHARES, "%", "relative"),
)
PARTS = {  # of a time that stands in several columns, by the names of each
    "date": ("date", "datum", "day", "yyyymmdd", "dateutc"),
    "clock": ("time", "uhrzeit", "zeit", "timeofday", "clock", "hhmmss", "timeutc", "localtime"),
    "year": ("year", "yyyy", "yr", "jahr", "yearrtm"),
    "month": ("month", "mon", "mo", "monat"),
    "day": ("day", "dayofmonth", "dom", "dd", "tag"),
    "doy": (
        *("doy", "dayofyear", "julianday", "jday", "jd", "yearday", "yday", "julian", "juldy"),
        "dayrtm",
    ),
    "hhmm": ("hhmm", "hourminute", "hrmin", "hourmin", "hourminutertm"),
    "hour": ("hour", "hr", "hh", "hours", "stunde"),
    "minute": ("minute", "minutes", "min", "minuten"),
    "second": ("second", "seconds", "sec", "secs", "ss", "sekunde", "sekunden", "s", "secondsrtm"),
    "millisecond": ("millisecond", "milliseconds", "msec", "ms"),
}
SECOND = "h2o_2"
CHOSEN = (*ROLES, SECOND, "diag")
BY_SIZE = "?"  # a unit that only the size of the values can tell
FLAGGED = re.compile(r"^(diag|flag|irgadiag|sonicdiag|.*diag(nostic(value)?s?|code|type)?\d*)")


def bare_of(name: str) -> str:
    """Returns a bare name as the tables spell it, without a network's position, "_1_1_1"."""
    spelt = re.sub(r"^aux\s*\d*\s*-?\s*", "", name.strip().lower())
    spelt = re.sub(r"(_\d+){2,3}$|_1$", "", spelt)
    return re.sub(r"[^a-z0-9]", "", spelt)


def find(
    names: Sequence[str],
    unit_row: Sequence[str],
    chosen: str,
    place: str,
    companion: bool = False,
) -> Columns:
    """Returns the columns of a file by role, with all problems of the header at once.

    `unit_row` are the units of the file's own line of units, or empty texts. `chosen` is what the
    user says, "h2o=NAME:UNIT,Ux=NAME"; `place` is the header's file and line, for messages. A
    `companion`'s file need not have them. Raises RecordError if --columns cannot be understood.
    """
    parts = [split(name, unit) for name, unit in zip(names, unit_row, strict=True)]
    found = Columns()
    for role, (name, unit) in _chosen(chosen).items():
        if companion and (role == SECOND or not {name} & {*names, *(part for part, _ in parts)}):
            continue
        _take_chosen(found, role, name, unit, names, parts, place)
    _find_time(found, names, parts)
    if "h2o" not in found.by_role:
        _find_humidity(found, names, parts, place)
    for role, known in ROLES.items():
        if role not in found.by_role and role not in ("time", "nanoseconds", "h2o"):
            at = _usual(known, parts, {c.at for c in found.by_role.values()})
            if at is not None:
                _take(found, role, known, at, names[at], parts[at][1], place)
    found.flags += () if found.flagless else tuple(
        Column(at, name)
        for at, name in enumerate(names)
        if FLAGGED.match(bare_of(parts[at][0])) and not _is_signal(name)
        and at not in {c.at for c in (*found.by_role.values(), *found.flags)}
    )  # fmt: skip
    found.others = tuple(_others(found, names, parts))
    return found


def _is_signal(name: str) -> bool:
    """Returns whether a column holds a strength of signal, and no flag."""
    return bool(re.search(r"sig|strgth|strength|agc|rssi", name.lower()))


def _take_chosen(
    found: Columns,
    role: str,
    name: str,
    unit: str,
    names: Sequence[str],
    parts: Sequence[tuple[str, str]],
    place: str,
) -> None:
    """Adds the column that the user names for a role, or a problem."""
    bare = [part for part, _ in parts]
    if role == "diag" and name.lower() == "none":
        found.flagless = True
        return
    if name not in names and name not in bare:
        found.problems.append(
            f"{place}: --columns {role}={name}: no such column; there are "
            f"{', '.join(filter(None, names))}"
        )
        return
    at = names.index(name) if name in names else bare.index(name)
    if role == "diag":
        found.flags += (Column(at, names[at]),)
        return
    humid = role in ("h2o", SECOND)
    candidates = HUMIDITIES if humid else (ROLES[role],)
    spelt = unit or parts[at][1]
    known = next((r for r in candidates if plain(spelt) in r.units), candidates[0])
    if humid:
        known = _by_name(known, parts[at][0], found)
    _take(found, role, known, at, names[at], spelt, place, needed=True)


def _by_name(known: Role, bare: str, found: Columns) -> Role:
    """Returns the kind of humidity that a column's name says, where its unit leaves it open."""
    word = bare_of(bare)
    dry = "dry" in word or "mixing" in word or word in ("mr", "mixr", "rh2o", "h2omr")
    if known.kind in ("mole", "mole-dry"):
        return known._replace(kind="mole-dry" if dry else "mole")
    if known.kind in ("specific", "ratio"):
        if not dry and "spec" not in word and word not in ("q", "hus", "huss", "sh"):
            found.notes.append(
                f"column {bare} does not say whether it is specific humidity or a mixing ratio: "
                "taken as specific humidity (a mixing ratio would be some 1 % lower)"
            )
        return known._replace(kind="ratio" if dry else "specific")
    return known


def _find_humidity(
    found: Columns, names: Sequence[str], parts: Sequence[tuple[str, str]], place: str
) -> None:
    """Adds the column of humidity, by name and unit, in the order of HUMIDITIES."""
    taken = {column.at for column in found.by_role.values()}
    for known in HUMIDITIES:
        matches = [
            at
            for name in known.names
            for at, (bare, unit) in enumerate(parts)
            if at not in taken
            and bare_of(bare) == name
            and (plain(unit) in known.units if unit or not known.assumed else bool(known.assumed))
        ]
        if matches:
            at = matches[0]
            kind = _by_name(known, parts[at][0], found)
            _take(found, "h2o", kind, at, names[at], parts[at][1], place, needed=True)
            return
    alike = [n for n, (bare, _) in enumerate(parts) if bare_of(bare) in _DENSE + _DRY]
    if alike:
        at = alike[0]
        _take(found, "h2o", ROLES["h2o"], at, names[at], parts[at][1], place, needed=True)
        return
    found.problems.append(
        f"{place}: expected a column of water vapour (h2o) in g/m3 or mmol/m3, as a mole fraction, "
        f"a mixing ratio or relative humidity; there are {', '.join(filter(None, names))[:300]}; "
        f"{perhaps(names, 'h2o')}name it with --columns h2o=NAME or h2o=NAME:UNIT"
    )


def perhaps(names: Sequence[str], role: str) -> str:
    """Returns "perhaps X or Y; " of the columns whose names hold a role's, or no text.

    An instrument's name before or after it, as in LI7500_H2O or UxCSAT, says whose it is, which
    is the user's choice.
    """
    alike = [n for n in names if role.lower() in re.sub(r"[^a-z0-9]", "", n.lower())]
    return f"perhaps {' or '.join(alike[:4])}; " if alike else ""


def _others(
    found: Columns, names: Sequence[str], parts: Sequence[tuple[str, str]]
) -> Iterator[str]:
    """Yields other columns that could hold humidity, such as H2O2 beside H2O."""
    taken = {column.at for column in found.by_role.values()}
    for at, (bare, unit) in enumerate(parts):
        word = bare_of(re.sub(r"[_ ]?\d+$", "", bare))
        spelt = plain(unit)
        for known in HUMIDITIES:
            if at not in taken and word in known.names and (not unit or spelt in known.units):
                if unit or known.kind == "density":
                    yield names[at]
                break


def _usual(role: Role, parts: Sequence[tuple[str, str]], taken: set[int]) -> int | None:
    """Returns the first column with a usual name for a role, or None.

    A column that names no unit, or one that can be used, goes before others.
    """
    bare = [bare_of(name) for name, _ in parts]
    matches = [
        at
        for name in role.names
        for at, word in enumerate(bare)
        if word == name and at not in taken
    ]
    usable = [at for at in matches if not parts[at][1] or plain(parts[at][1]) in role.units]
    return next(iter(usable or matches), None)


def _take(
    found: Columns,
    role: str,
    known: Role,
    at: int,
    name: str,
    unit: str,
    place: str,
    needed: bool | None = None,
) -> None:
    """Adds the column of a role; a unit that is not known is a problem where the role is needed.

    A column that is not needed is left out with a note.
    """
    if not unit and role != "time":
        assumed = known.assumed
        found.by_role[role] = Column(
            at, name, *known.units.get(assumed, (1.0, 0.0)), assumed or BY_SIZE, known.kind, assumed
        )
    elif not unit or plain(unit) in known.units:
        factor = known.units.get(plain(unit), (1.0, 0.0))
        found.by_role[role] = Column(
            at, name, *factor, "", known.kind, plain(unit) if "_" in unit else unit.strip()
        )
    elif needed if needed is not None else role in ("Ux", "Uy", "speed"):
        humid = role in ("h2o", SECOND)
        tables = [r.units for r in HUMIDITIES] if humid else [known.units]
        expected = ", ".join(dict.fromkeys(listed(table) for table in tables))
        found.problems.append(
            f'{place}: column {name}: unknown unit "{unit}"; expected one of {expected}; '
            f"name it with --columns {role}={name}:UNIT"
        )
        found.by_role[role] = Column(at, name, kind=known.kind)
    else:
        found.notes.append(
            f'column {name} is left out: its unit "{unit}" is not known; '
            f"name it with --columns {role}={name}:UNIT"
        )


def _find_time(found: Columns, names: Sequence[str], parts: Sequence[tuple[str, str]]) -> None:
    """Adds the columns of time: one, or the parts of one (PARTS), as "time:date" and so on."""
    if "time" in found.by_role:
        return
    bare = [re.sub(r"[^a-z0-9]", "", name.lower()) for name, _ in parts]
    if "seconds" in bare and "nanoseconds" in bare:  # LI-COR's own; its Time is text beside them
        for role, word in (("time", "seconds"), ("nanoseconds", "nanoseconds")):
            there, factor = bare.index(word), 1.0 if role == "time" else 1e-9
            found.by_role[role] = Column(
                there, names[there], factor, unit="s" if role == "time" else "ns"
            )
        return
    split_up = {
        part: next((bare.index(word) for word in words if word in bare), None)
        for part, words in PARTS.items()
    }
    used = _parts_used(split_up)
    if used:
        for part in used:
            place = split_up[part]
            assert place is not None  # noqa: S101 (as _parts_used has it)
            found.by_role[f"time:{part}"] = Column(place, names[place])
        return
    at: int | None = _usual(ROLES["time"], parts, set())
    if at is None or (bare[at] == "t" and plain(parts[at][1]) in units.DEGREES):
        at = next((n for n, name in enumerate(names) if not name.strip()), None)
    if at is not None:
        unit = plain(parts[at][1])
        factor, _ = units.TIMES.get(unit, (1.0, 0.0))
        known = unit if unit in units.TIMES else ""
        found.by_role["time"] = Column(at, names[at], factor, unit=known)
    elif (at := split_up["doy"]) is not None:
        found.by_role["time"] = Column(at, names[at], 86400.0, unit="d")


def _parts_used(split_up: dict[str, int | None]) -> tuple[str, ...]:
    """Returns the parts of time that a file has in columns of their own, or none."""

    def there(*wanted: str) -> bool:
        return all(split_up[part] is not None for part in wanted)

    clocks = [part for part in ("hhmm", "hour", "minute", "second", "millisecond") if there(part)]
    clocks = [part for part in clocks if part != "hour" or "hhmm" not in clocks]
    if there("date", "clock") and split_up["date"] != split_up["clock"]:
        return ("date", "clock")
    if there("year", "doy"):
        return ("year", "doy", *clocks)
    if there("year", "month", "day"):
        return ("year", "month", "day", *(clocks or (("clock",) if there("clock") else ())))
    if there("doy") and clocks:
        return ("doy", *clocks)
    if there("date") and {"hour", "hhmm"} & set(clocks):
        return ("date", *clocks)
    return ()


def _chosen(text: str) -> dict[str, tuple[str, str]]:
    """Returns name and unit of each role in --columns; the unit is empty if none is given."""
    found = {}
    known = {role.lower(): role for role in CHOSEN}
    for item in filter(None, (part.strip() for part in text.split(","))):
        role, equals, column = (part.strip() for part in item.partition("="))
        if not equals or not column or role.lower() not in known:
            roles = ", ".join(CHOSEN)
            raise RecordError(
                f"--columns {item}: write ROLE=NAME or ROLE=NAME:UNIT, with a role of {roles}"
            )
        name, _, unit = column.partition(":")
        found[known[role.lower()]] = (name.strip(), unit.strip())
    return found
