"""Absorption spectra as records, for tables, JSON, CSV and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, humidity, validity
from thzcl.air.composition import Part
from thzcl.constituent import DB_KM_PER_INVERSE_METRE

Array = NDArray[np.float64]
Record = dict[str, Any]  # a number, or None, by the names of COLUMNS

MOST_VALUES = 1_000_000
COLUMNS = (
    "frequency_ghz",
    "temperature_k",
    "pressure_hpa",
    "vapour_pressure_hpa",
    "relative_humidity_percent",
    "absolute_humidity_g_m3",
    "dry_db_km",
    "vapour_db_km",
    "total_db_km",
    "total_per_m",
)
PARTS = ("dry", "vapour")  # of the absorption, where the model tells them apart


def values(text: str) -> Array:
    """Returns the numbers of "650", "600,650" or "100:1000:1" (start:stop:step, stop included).

    Raises ValueError for any other text, and for numbers that are not finite.
    """
    try:
        if ":" not in text:
            numbers = np.array([float(part) for part in text.split(",")])
        else:
            start, stop, step = (float(part) for part in text.split(":"))
            count = (stop - start) / step
            if not 0 <= count < MOST_VALUES:
                raise ValueError
            # The stop is met even if the step does not divide the range exactly in binary.
            numbers = start + step * np.arange(int(count * (1 + 1e-12) + 1e-9) + 1)
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f'"{text}" is not a number, a list a,b,c or a range start:stop:step with start <= stop'
        ) from None
    if not np.isfinite(numbers).all():
        raise ValueError(f'"{text}" holds a number that is not finite')
    return numbers


def records(
    frequency_ghz: Array,
    temperature_k: Array,
    pressure_hpa: float,
    gas: Part,
    given: str,
    amount: float,
) -> list[Record]:
    """Returns one record for each temperature and frequency, in the units that its keys name.

    `given` is the name of the quantity that `amount` measures: "relative_humidity_percent",
    "absolute_humidity_g_m3" or "vapour_pressure_hpa". The attenuation of dry air and of vapour are
    None for a model that does not tell them apart. Raises ValueError for air that cannot be, and
    RangeError where the model is not valid.
    """
    kelvin, ghz = (
        grid.ravel() for grid in np.meshgrid(temperature_k, frequency_ghz, indexing="ij")
    )
    if not (kelvin > 0).all():
        raise ValueError("temperature must be above 0 K")
    if given == "relative_humidity_percent":
        vapour = humidity.vapour_pressure_from_relative(amount, kelvin)
    elif given == "absolute_humidity_g_m3":
        vapour = humidity.vapour_pressure_from_absolute(amount, kelvin)
    else:
        vapour = np.full(kelvin.shape, amount)
    if not ((vapour >= 0) & (vapour <= pressure_hpa)).all():
        raise ValueError("vapour pressure must lie between 0 and the total pressure")
    of_air = composition.optical_properties(gas, ghz * 1e9, kelvin, pressure_hpa, vapour)
    per_m = np.asarray(of_air.absorption)
    parts = composition.parts(gas, of_air)
    columns = (
        ghz,
        kelvin,
        np.full(ghz.shape, pressure_hpa),
        vapour,
        humidity.relative_humidity(vapour, kelvin),
        humidity.absolute_humidity(vapour, kelvin),
        *(parts[name] * DB_KM_PER_INVERSE_METRE if name in parts else None for name in PARTS),
        per_m * DB_KM_PER_INVERSE_METRE,
        per_m,
    )
    listed = [[None] * ghz.size if column is None else column.tolist() for column in columns]
    return [dict(zip(COLUMNS, row, strict=True)) for row in zip(*listed, strict=True)]


def by_model(
    frequency_ghz: Array,
    temperature_k: Array,
    pressure_hpa: float,
    gases: Sequence[Part],
    given: str,
    amount: float,
) -> tuple[list[Record], list[str]]:
    """Returns the records of several gases, each with its name as `model`, and notes.

    The first must be valid everywhere. Others are left out where they are not, with a note. Raises
    what `records` raises.
    """
    air = temperature_k, pressure_hpa
    rows: list[Record] = []
    told: list[str] = []
    for number, gas in enumerate(gases):
        ghz = frequency_ghz
        if number > 0:
            vapour = np.array([row["vapour_pressure_hpa"] for row in rows])
            whys = [_lacking(gas, one, *air, vapour) for one in frequency_ghz]
            ghz = frequency_ghz[[why is None for why in whys]]
            told += left_out(f'"{gas.name}" is', [why for why in whys if why], len(whys))
        if len(ghz):
            found = records(ghz, *air, gas, given, amount)
            rows += [{"model": gas.name, **row} for row in found]
            told += notes(ghz, *air, gas)
    return rows, told


def _lacking(
    gas: Part, frequency_ghz: float, temperature_k: Array, pressure_hpa: float, vapour_hpa: Array
) -> str | None:
    """Returns in words what a gas is not valid for, or None if it is for all."""
    limited = composition.made(gas).limited
    asked = validity.ranges(
        limited,
        frequency_ghz=frequency_ghz,
        temperature_k=temperature_k,
        pressure_hpa=pressure_hpa,
        vapour_hpa=vapour_hpa,
    )
    return composition.lacking(gas, asked)


def left_out(what: str, whys: Sequence[str], count: int) -> list[str]:
    """Returns a note on what is left out at as many of `count` frequencies as there are reasons."""
    if not whys:
        return []
    where = "" if len(whys) == count else f" at {len(whys)} of {count} frequencies"
    return [f"{what} left out{where}: {whys[0]}"]


def notes(frequency_ghz: Array, temperature_k: Array, pressure_hpa: float, gas: Part) -> list[str]:
    """Returns what to tell of frequencies and states for which a gas extrapolates."""
    made = composition.made(gas)
    asked = validity.ranges(
        made.limited,
        frequency_ghz=frequency_ghz,
        temperature_k=temperature_k,
        pressure_hpa=pressure_hpa,
    )
    return validity.notes(gas.name, made.valid, asked)
