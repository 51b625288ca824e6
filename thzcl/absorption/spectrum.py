"""Absorption spectra as records, for tables, JSON, CSV and pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from thzcl.absorption import humidity
from thzcl.absorption.mpm93 import attenuation

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


def values(text: str) -> Array:
    """Numbers from "650", "600,650" or "100:1000:1" (start, stop and step; the stop is included). Raises ValueError."""
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
        raise ValueError(f'"{text}" is not a number, a list a,b,c or a range start:stop:step with start <= stop') from None
    if not np.isfinite(numbers).all():
        raise ValueError(f'"{text}" holds a number that is not finite')
    return numbers


def records(
    frequency_ghz: Array, temperature_k: Array, pressure_hpa: float, model: str, given: str, amount: float
) -> list[dict[str, float]]:
    """One record for each temperature and frequency, in the units that its keys name.

    `given` says what `amount` is: "relative_humidity_percent", "absolute_humidity_g_m3" or "vapour_pressure_hpa". Raises
    ValueError for what the model does not cover.
    """
    kelvin, ghz = (grid.ravel() for grid in np.meshgrid(temperature_k, frequency_ghz, indexing="ij"))
    if not (kelvin > 0).all():
        raise ValueError("temperature must be above 0 K")
    if given == "relative_humidity_percent":
        vapour = humidity.vapour_pressure_from_relative(amount, kelvin)
    elif given == "absolute_humidity_g_m3":
        vapour = humidity.vapour_pressure_from_absolute(amount, kelvin)
    else:
        vapour = np.full(kelvin.shape, amount)
    found = attenuation(model, ghz, kelvin, pressure_hpa, vapour)
    columns = (
        ghz,
        kelvin,
        np.full(ghz.shape, pressure_hpa),
        vapour,
        humidity.relative_humidity(vapour, kelvin),
        humidity.absolute_humidity(vapour, kelvin),
        found.dry_db_km,
        found.vapour_db_km,
        found.total_db_km,
        found.total_per_m,
    )
    return [dict(zip(COLUMNS, map(float, row), strict=True)) for row in zip(*columns, strict=True)]


def figure(rows: list[dict[str, float]], path: Path) -> None:
    """Writes a PNG: attenuation against frequency, or against temperature where there is but one frequency."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    frequencies, temperatures = ({row[key] for row in rows} for key in ("frequency_ghz", "temperature_k"))
    along, each = ("temperature_k", "frequency_ghz") if len(frequencies) == 1 < len(temperatures) else COLUMNS[:2]
    labels = {"frequency_ghz": "frequency / GHz", "temperature_k": "temperature / K"}
    picture = Figure(figsize=(8, 5), layout="constrained")
    FigureCanvasAgg(picture)
    axes = picture.subplots()
    for value in sorted({row[each] for row in rows}):
        chosen = [row for row in rows if row[each] == value]
        unit = "GHz" if each == "frequency_ghz" else "K"
        moist = f"{chosen[0]['absolute_humidity_g_m3']:.3g} g/m³"
        for key, name, style in (
            ("total_db_km", f"{value:g} {unit}, {moist}", "-"),
            ("dry_db_km", f"{value:g} {unit}, dry part", "--"),
        ):
            axes.plot([row[along] for row in chosen], [row[key] for row in chosen], style, label=name, linewidth=1.2)
    axes.set(xlabel=labels[along], ylabel="specific attenuation / dB/km", yscale="log")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)
    picture.savefig(path, dpi=150, format="png")
