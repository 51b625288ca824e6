"""Absorption spectra as records, for tables, JSON, CSV and pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thzcl.air import humidity
from thzcl.air.mpm93 import attenuation

Array = NDArray[np.float64]

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
    model: str,
    given: str,
    amount: float,
) -> list[dict[str, float]]:
    """Returns one record for each temperature and frequency, in the units that its keys name.

    `given` is the name of the quantity that `amount` measures: "relative_humidity_percent",
    "absolute_humidity_g_m3" or "vapour_pressure_hpa". Raises ValueError for what the model does not
    cover.
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
    of_air = attenuation(model, ghz, kelvin, pressure_hpa, vapour)
    columns = (
        ghz,
        kelvin,
        np.full(ghz.shape, pressure_hpa),
        vapour,
        humidity.relative_humidity(vapour, kelvin),
        humidity.absolute_humidity(vapour, kelvin),
        of_air.dry_db_km,
        of_air.vapour_db_km,
        of_air.total_db_km,
        of_air.total_per_m,
    )
    return [dict(zip(COLUMNS, map(float, row), strict=True)) for row in zip(*columns, strict=True)]


def figure(rows: list[dict[str, float]], path: Path) -> None:
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


def _moisture(rows: list[dict[str, float]]) -> str:
    """Returns the humidity, in the first form that is the same in all rows, with its unit."""
    units = {
        "relative_humidity_percent": "% RH",
        "absolute_humidity_g_m3": "g/m³",
        "vapour_pressure_hpa": "hPa of vapour",
    }
    spreads = {key: np.ptp([row[key] for row in rows]) / max(rows[0][key], 1e-30) for key in units}
    key = min(spreads, key=lambda key: float(spreads[key]) > 1e-9)
    return f"{rows[0][key]:.3g} {units[key]}"
