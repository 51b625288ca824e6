"""Units of a record's columns, as loggers write them: in names, in brackets, in any case.

Their worth stands in `thzcl.air.units`: g/m3, mol/mol, kg/kg and per cent for humidity, m/s, K, hPa
and s are computed with.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping

from thzcl.air.units import UNITS, Worth

Units = Mapping[str, Worth]  # factor and offset by the unit's plain spelling

_POWER = re.compile(r"([a-z]+?)_?(m|s|mol|kg|h|g)-([123])")


def _folded(text: str) -> str:
    """Returns a unit in lower case, without blanks and signs, its power as a division."""
    whole = unicodedata.normalize("NFKC", text.strip().strip("[]()")).lower()
    whole = whole.translate(_SIGNS).replace("+1", "")
    spelt = re.sub(r"[\s.]", "", whole)
    if power := _POWER.fullmatch(spelt):
        return f"{power[1]}/{power[2]}{'' if power[3] == '1' else power[3]}"
    return spelt


_SIGNS = str.maketrans("\u03bc\u2212", "u-", "^*\u00b7\u00b0\ufffd")
SPEED, DEGREES, DENSITIES, FRACTIONS, MASSES, SHARES, PRESSURES, TIMES = (
    {_folded(name): worth for name, worth in UNITS[unit].items()}
    for unit in ("m/s", "K", "g/m3", "mol/mol", "kg/kg", "%", "hPa", "s")
)
EVERY: Units = {
    name: worth
    for table in (SPEED, DEGREES, DENSITIES, FRACTIONS, MASSES, SHARES, PRESSURES, TIMES)
    for name, worth in table.items()
}
# Units that a logger writes and that thzcl has no use for; they are units all the same.
FOREIGN = frozenset(
    ("mv", "v", "uv", "ma", "ohm", "count", "counts", "db", "hz", "deg", "degrees", "w/m2", "rad",
     "umol/m3", "unitless", "none", "-", "volt", "volts", "index", "bit", "bits", "adc", "raw"),
)  # fmt: skip
_WORDS = {
    "gm3": "g/m3", "mmolm3": "mmol/m3", "mgm3": "mg/m3", "kgm3": "kg/m3", "molm3": "mol/m3",
    "meters/second": "m/s", "meter/second": "m/s", "metres/second": "m/s",
}  # fmt: skip


def plain(text: str) -> str:
    """Returns a unit as the tables spell it; "g m^-3", "g/m³" and "gm-3" are all "g/m3"."""
    spelt = _folded(text)
    if "_" in spelt:
        ends = spelt.split("_")
        over = "/".join(ends)
        spelt = over if len(ends) == 2 and over in EVERY else "".join(ends)
    return _WORDS.get(spelt, spelt)


def is_unit(text: str) -> bool:
    """Returns whether the text in a name's brackets is a unit, and not an instrument or a number.

    A unit unknown as such is taken for none, but for those that loggers write for other things.
    """
    return plain(text) in EVERY or plain(text) in FOREIGN


_BRACKETS = re.compile(r"^(.*?)[\s_]*[(\[]([^)\]]*)[)\]]\s*$")
_ENDING = re.compile(
    r"^(.*?)_((?:m?g|kg|[mu]?mol)_?/?_?m\^?-?3|m[_/]s|ms-1|degc|deg_c|[ck]|[hk]?pa|m?s|"
    r"(?:[mu]?mol)[_/]mol|g[_/]kg|ppt|ppm|%|percent)$",
    re.IGNORECASE,
)


def split(name: str, unit: str) -> tuple[str, str]:
    """Returns a column's bare name and its unit.

    The unit is that of the line of units, or stands in the name, in brackets or as an ending such
    as _g_m3. Brackets that hold an instrument or a number are left out of the bare name.
    """
    bare, inner = name.strip(), ""
    found = _BRACKETS.match(bare)
    if found and found[1]:
        bare = found[1].strip(" _-,")
        inner = found[2].strip() if is_unit(found[2]) else ""
    if not inner and (ending := _ENDING.match(bare)) and ending[1]:
        bare, inner = ending[1], ending[2]
    spelt = unit.strip()
    if spelt.startswith(("[", "(")):
        spelt = spelt.strip("[]()")
    return bare, spelt or inner
