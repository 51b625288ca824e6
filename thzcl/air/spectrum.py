"""Absorption spectra as records, for tables, JSON, CSV and pictures."""

from __future__ import annotations

from pathlib import Path
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
LABELS = {"frequency_ghz": "frequency / GHz", "temperature_k": "temperature / K"}
MOST_NAMED = 12  # lines in a legend


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


def figure(rows: list[Record], path: Path) -> None:
    """Writes a PNG of the attenuation of moist and dry air.

    Its abscissa is frequency or temperature, whichever has more values. Figure 5 of O'Brien and
    Tofsted shows 100 to 1000 GHz at 288.15 K and 50 % relative humidity.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    frequencies, temperatures = ({row[key] for row in rows} for key in COLUMNS[:2])
    along, each = COLUMNS[:2] if len(frequencies) >= len(temperatures) else COLUMNS[1::-1]
    picture = Figure(figsize=(8, 5), layout="constrained")
    FigureCanvasAgg(picture)
    axes = picture.subplots()
    lines = sorted({row[each] for row in rows})
    for number, value in enumerate(lines):
        chosen = [row for row in rows if row[each] == value]
        colour, label = (
            f"C{number % 10}",
            f"{value:g} {'K' if each == 'temperature_k' else 'GHz'}, {_moisture(chosen)}",
        )
        x, moist, dry = (
            [row[key] for row in chosen] for key in (along, "total_db_km", "dry_db_km")
        )
        axes.plot(
            x, moist, color=colour, label=label if number < MOST_NAMED else None, linewidth=1.2
        )
        if None not in dry:
            axes.plot(
                x,
                dry,
                "--",
                color=colour,
                label="dry part" if number == len(lines) - 1 else None,
                linewidth=1.2,
            )
    axes.set(xlabel=LABELS[along], ylabel="specific attenuation / dB/km", yscale="log")
    axes.set_title(f"{rows[0]['pressure_hpa']:g} hPa", fontsize=10)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    picture.savefig(path, dpi=150, format="png")


def _moisture(rows: list[Record]) -> str:
    """Returns the humidity, in the first form that is the same in all rows, with its unit."""
    units = {
        "relative_humidity_percent": "% RH",
        "absolute_humidity_g_m3": "g/m³",
        "vapour_pressure_hpa": "hPa of vapour",
    }
    spreads = {key: np.ptp([row[key] for row in rows]) / max(rows[0][key], 1e-30) for key in units}
    key = min(spreads, key=lambda key: float(spreads[key]) > 1e-9)
    return f"{rows[0][key]:.3g} {units[key]}"
