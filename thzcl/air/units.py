"""Units of what files from outside hold, in all the ways in which they are spelled."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping

Worth = tuple[float, float]  # factor and offset to the unit in which values are computed with

GRAMS_PER_MILLIMOLE = 0.01801528  # of water, CODATA
KELVIN = 273.15
_AMOUNTS = (
    (("g", "gram", "grams"), 1.0),
    (("kg",), 1e3),
    (("mg",), 1e-3),
    (("ug", "\N{GREEK SMALL LETTER MU}g"), 1e-6),
    (("mmol",), GRAMS_PER_MILLIMOLE),
    (("mol",), 1e3 * GRAMS_PER_MILLIMOLE),
)


def _spelled(*many: tuple[Iterable[str], float, float]) -> dict[str, Worth]:
    """Returns units by their spellings, each with its worth."""
    return {name: (factor, offset) for names, factor, offset in many for name in names}


# By the unit in which values are computed with; the first spelling of each is what messages say.
# Spellings are without blanks, dots, degree signs and signs of powers, as `plain` makes them.
UNITS: Mapping[str, Mapping[str, Worth]] = {
    "GHz": _spelled(
        (("GHz",), 1.0, 0), (("Hz",), 1e-9, 0), (("MHz",), 1e-3, 0), (("THz",), 1e3, 0)
    ),
    "K": _spelled(
        (("K", "kelvin", "Kelvin", "kelvins", "degK", "degreeK"), 1.0, 0.0),
        (
            (
                *("degC", "degc", "C", "oC", "degreeC", "degreesC", "degreec", "degreesc"),
                *("celsius", "Celsius", "degreeCelsius", "degreesCelsius"),
                *("degreecelsius", "degreescelsius"),
            ),
            1.0,
            KELVIN,
        ),
    ),
    "hPa": _spelled(
        (("hPa", "mbar", "millibar", "mb"), 1.0, 0.0),
        (("Pa",), 1e-2, 0.0),
        (("kPa",), 10.0, 0.0),
        (("mmHg", "torr", "Torr"), 1013.25 / 760, 0.0),
        (("bar",), 1e3, 0.0),
        (("atm",), 1013.25, 0.0),
    ),
    "1/m": _spelled(
        (("1/m", "m-1"), 1.0, 0.0),
        (("1/km", "km-1"), 1e-3, 0.0),
        (("1/cm", "cm-1"), 100.0, 0.0),
        (("dB/km", "dBkm-1"), math.log(10.0) / 1e4, 0.0),
    ),
    "g/m3": {
        amount + volume: (factor, 0.0)
        for amounts, factor in _AMOUNTS
        for amount in amounts
        for volume in ("/m3", "m-3")
    },
    "m": _spelled(
        (("m", "metre", "metres", "meter", "meters"), 1.0, 0.0),
        (("km", "kilometre", "kilometres", "kilometer", "kilometers"), 1e3, 0.0),
    ),
    "mm": _spelled(
        (("mm", "millimetre", "millimetres", "millimeter", "millimeters"), 1.0, 0.0),
        (("um", "micrometre", "micrometres", "micrometer", "micrometers"), 1e-3, 0.0),
        (("cm",), 10.0, 0.0),
        (("m", "metre", "metres", "meter", "meters"), 1e3, 0.0),
    ),
    "1/m3/mm": _spelled(
        (("1/m3/mm", "m-3mm-1", "mm-1m-3", "1/(m3mm)"), 1.0, 0.0), (("1/m4", "m-4"), 1e-3, 0.0)
    ),
    "mol/mol": _spelled(
        (("mmol/mol", "mmolmol-1", "ppt", "ppth", "permil"), 1e-3, 0.0),
        (("umol/mol", "umolmol-1", "\N{GREEK SMALL LETTER MU}mol/mol", "ppm", "ppmv"), 1e-6, 0.0),
        (("mol/mol", "molmol-1"), 1.0, 0.0),
        (("nmol/mol", "nmolmol-1", "ppb", "ppbv"), 1e-9, 0.0),
    ),
    "kg/kg": _spelled(
        (("g/kg", "gkg-1"), 1e-3, 0.0),
        (("kg/kg", "kgkg-1", "g/g"), 1.0, 0.0),
        (("mg/kg", "mgkg-1"), 1e-6, 0.0),
    ),
    "%": _spelled((("%", "percent", "pct", "%RH"), 1.0, 0.0)),
    "m/s": _spelled(
        (("m/s", "ms-1", "m/sec", "mps"), 1.0, 0.0),
        (("cm/s", "cms-1"), 0.01, 0.0),
        (("mm/s", "mms-1"), 1e-3, 0.0),
        (("km/h", "kmh-1", "kmh", "kph"), 1 / 3.6, 0.0),
        (("kn", "knots", "kt"), 1852 / 3600, 0.0),
        (("mph",), 0.44704, 0.0),
    ),
    "s": _spelled(
        (("s", "sec", "secs", "second", "seconds", "ts"), 1.0, 0.0),
        (("ms", "msec", "millisecond", "milliseconds"), 1e-3, 0.0),
        (("us", "microseconds"), 1e-6, 0.0),
        (("ns", "nanoseconds"), 1e-9, 0.0),
        (("min", "minute", "minutes"), 60.0, 0.0),
        (("h", "hour", "hours", "hr"), 3600.0, 0.0),
        (("d", "day", "days"), 86400.0, 0.0),
    ),
}


def plain(text: str) -> str:
    """Returns a unit as UNITS spells it: "g m^-3", "g·m⁻³" and "g m-3" are all "gm-3"."""
    whole = unicodedata.normalize("NFKC", text).replace("\N{MINUS SIGN}", "-")
    return re.sub("[\\s.*^·_°\N{REPLACEMENT CHARACTER}]", "", whole)


def listed(units: Mapping[str, Worth]) -> str:
    """Returns units of different worth, each by its first spelling, for messages."""
    names: dict[Worth, str] = {}
    for name, worth in units.items():
        names.setdefault(worth, name)
    return ", ".join(names.values())
