"""Absorption spectra as records, for tables, JSON, CSV and pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, humidity, validity
from thzcl.air.composition import Part
from thzcl.constituent import DB_KM_PER_INVERSE_METRE, OpticalProperties

Array = NDArray[np.float64]
Record = dict[str, Any]  # a number, or None, by the names of COLUMNS and of what else there is

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
        parts = [float(part) for part in text.split(":" if ":" in text else ",")]
        if ":" in text:
            start, stop, step = parts
            count = (stop - start) / step
            if count < 0:
                raise ValueError
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f'"{text}" is not a number, a list a,b,c or a range start:stop:step with start <= stop'
        ) from None
    if not np.isfinite(parts).all():
        raise ValueError(f'"{text}" holds a number that is not finite')
    if ":" not in text:
        return np.array(parts)
    if not count < MOST_VALUES:
        raise ValueError(f'"{text}" holds more than {MOST_VALUES:,} numbers; make the step larger')
    # The stop is met even if the step does not divide the range exactly in binary.
    return start + step * np.arange(int(count * (1 + 1e-12) + 1e-9) + 1, dtype=np.float64)


@dataclass(frozen=True)
class States:
    """States of the air at each of which absorption is wanted at each frequency, flat.

    `frequency_ghz`, `temperature_k` and `vapour_hpa` have one value for each row of a spectrum.
    """

    frequency_ghz: Array
    temperature_k: Array
    pressure_hpa: float
    vapour_hpa: Array

    def optics(self, part: Part) -> OpticalProperties:
        """Returns all optics of a constituent, (row,)."""
        air = self.temperature_k, self.pressure_hpa, self.vapour_hpa
        return composition.optical_properties(part, self.frequency_ghz * 1e9, *air)

    def where(self, rows: NDArray[np.bool_]) -> States:
        """Returns some of the rows."""
        flat = (self.frequency_ghz[rows], self.temperature_k[rows], self.vapour_hpa[rows])
        frequency, temperature, vapour = flat
        return replace(self, frequency_ghz=frequency, temperature_k=temperature, vapour_hpa=vapour)

    def at(self, frequency_ghz: float) -> States:
        """Returns the rows of one frequency."""
        return self.where(self.frequency_ghz == frequency_ghz)

    def lacking(self, gas: Part) -> str | None:
        """Returns in words what a gas is not valid for, or None if it is for all rows."""
        return composition.lacking(gas, self._asked(gas))

    def notes(self, part: Part) -> list[str]:
        """Returns what to tell of a constituent that extrapolates, or hardly occurs in such air."""
        told = validity.notes(part.name, composition.made(part).valid, self._asked(part))
        air = self.temperature_k, self.pressure_hpa, self.vapour_hpa
        return told + composition.notes(part, *air)

    def _asked(self, part: Part) -> Any:
        """Returns over what ranges a constituent is asked."""
        return validity.ranges(
            composition.made(part).limited,
            frequency_ghz=self.frequency_ghz,
            temperature_k=self.temperature_k,
            pressure_hpa=self.pressure_hpa,
            vapour_hpa=self.vapour_hpa,
        )


def states(
    frequency_ghz: Array, temperature_k: Array, pressure_hpa: float, given: str, amount: float
) -> States:
    """Returns each frequency at each temperature, of air of one humidity.

    `given` is the name of the quantity that `amount` measures: "relative_humidity_percent",
    "absolute_humidity_g_m3" or "vapour_pressure_hpa". Raises ValueError for air that cannot be.
    """
    if len(temperature_k) * len(frequency_ghz) > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES:,} rows; give fewer frequencies or temperatures")
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
        total = f"the total of {pressure_hpa:g} hPa"
        raise ValueError(f"vapour pressure must lie between 0 and {total}, not {vapour.max():.6g}")
    return States(ghz, kelvin, pressure_hpa, vapour)


def records(of: States, gas: Part, weather: Sequence[Part] = ()) -> list[Record]:
    """Returns one record for each row, in the units that its keys name.

    The attenuation of dry air and of vapour are None for a model that does not tell them apart.
    What else is in the air has columns of its own, and is part of the total. Raises RangeError
    where a constituent is not valid.
    """
    of_air = of.optics(gas)
    parts = composition.parts(gas, of_air)
    with_weather = [_weather(of, part) for part in weather]
    per_m = _extinction(of_air, of) + sum(extinction for extinction, _ in with_weather)
    columns = (
        of.frequency_ghz,
        of.temperature_k,
        np.full(of.frequency_ghz.shape, of.pressure_hpa),
        of.vapour_hpa,
        humidity.relative_humidity(of.vapour_hpa, of.temperature_k),
        humidity.absolute_humidity(of.vapour_hpa, of.temperature_k),
        *(_db_km(parts[name], per_m) if name in parts else None for name in PARTS),
        per_m * DB_KM_PER_INVERSE_METRE,
        per_m,
    )
    named = dict(zip(COLUMNS, columns, strict=True))
    for _, more in with_weather:
        named |= more
    size = of.frequency_ghz.size
    listed = [[None] * size if column is None else column.tolist() for column in named.values()]
    return [dict(zip(named, row, strict=True)) for row in zip(*listed, strict=True)]


def _weather(of: States, part: Part) -> tuple[Array, dict[str, NDArray[Any]]]:
    """Returns what a constituent extinguishes in 1/m, and the columns that tell of it.

    Albedo and asymmetry are None where it extinguishes or scatters nothing. The least and the most
    are over what might be meant as well, such as other laws of drop sizes.
    """
    found = of.optics(part)
    scattering, extinction = _scattering(found, of), _extinction(found, of)
    asymmetry = composition.moments(part, found)[1] if scattering.any() else scattering
    columns: dict[str, NDArray[Any]] = {
        "db_km": extinction * DB_KM_PER_INVERSE_METRE,
        "albedo": _known(scattering, extinction),
        "asymmetry": _known(asymmetry * scattering, scattering),
        "backscatter_per_m_sr": np.broadcast_to(found.backscatter, extinction.shape),
    }
    others = [_extinction(of.optics(other), of) for other in composition.alternatives(part)]
    if others:
        spread = np.array([extinction, *others]) * DB_KM_PER_INVERSE_METRE
        columns |= {"least_db_km": spread.min(axis=0), "most_db_km": spread.max(axis=0)}
    return extinction, {f"{part.name}_{name}": values for name, values in columns.items()}


def _db_km(per_m: Array, like: Array) -> Array:
    """Returns a part of the absorption, which may be one number, in dB/km."""
    return np.broadcast_to(per_m * DB_KM_PER_INVERSE_METRE, like.shape)


def _scattering(optics: OpticalProperties, of: States) -> Array:
    return np.broadcast_to(np.asarray(optics.scattering), of.frequency_ghz.shape)


def _extinction(optics: OpticalProperties, of: States) -> Array:
    return np.asarray(np.asarray(optics.absorption) + _scattering(optics, of))


def _known(part: Array, whole: Array) -> NDArray[Any]:
    """Returns a ratio as objects, None where there is nothing of which it could be one."""
    ratio = np.divide(part, whole, out=np.zeros_like(whole), where=whole > 0).astype(object)
    ratio[whole == 0] = None
    return ratio


def by_model(
    of: States, gases: Sequence[Part], weather: Sequence[Part] = ()
) -> tuple[list[Record], list[str]]:
    """Returns the records of several gases, each with its name as `model`, and notes.

    The first must be valid everywhere. Others are left out where they are not, with a note. What
    else is in the air is there with each of them. Raises what `records` raises.
    """
    rows: list[Record] = []
    told: list[str] = []
    for number, gas in enumerate(gases):
        held = of
        if number > 0:
            each = [of.at(hz) for hz in dict.fromkeys(of.frequency_ghz.tolist())]
            whys = [one.lacking(gas) for one in each]
            told += left_out(f'"{gas.name}" is', [why for why in whys if why], len(whys))
            lacked = [one.frequency_ghz[0] for one, why in zip(each, whys, strict=True) if why]
            held = of.where(~np.isin(of.frequency_ghz, lacked))
        if held.frequency_ghz.size:
            rows += [{"model": gas.name, **row} for row in records(held, gas, weather)]
            told += held.notes(gas)
    return rows, told + notes(of, weather)


def left_out(what: str, whys: Sequence[str], count: int) -> list[str]:
    """Returns a note on what is left out at as many of `count` frequencies as there are reasons."""
    if not whys:
        return []
    where = "" if len(whys) == count else f" at {len(whys)} of {count} frequencies"
    return [f"{what} left out{where}: {whys[0]}"]


def notes(of: States, parts: Iterable[Part]) -> list[str]:
    """Returns what to tell of constituents that extrapolate, or hardly occur in such air."""
    return [note for part in parts for note in of.notes(part)]
