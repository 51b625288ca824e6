"""Pictures of absorption spectra: of moist and dry air, and of several models with their ratio."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thzcl.air.spectrum import Record

LABELS = {"frequency_ghz": "frequency / GHz", "temperature_k": "temperature / K"}
STYLES = ("-", "--", ":", "-.")  # of several models
MOST_NAMED = 12  # lines in a legend
DOTS = (
    (0, (1, 1)),
    (0, (6, 2, 1, 2)),
    (0, (6, 2, 1, 2, 1, 2, 1, 2)),
)  # of what falls, one kind each
Curve = tuple[str, Any, str, list[Record]]  # label, colour, style, records


def draw(rows: list[Record], path: Path, form: str = "png") -> None:
    """Writes a picture of the attenuation; the abscissa has more values of two quantities.

    They are frequency and temperature. What falls is dotted, each kind in dots of its own, with the
    range of what might be meant as well. Where rows have a `model`, curves are by model, what falls
    included, and their ratio to the first stands below. Figure 5 of O'Brien and Tofsted shows 100
    to 1000 GHz at 288.15 K and 50 % relative humidity.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    compared = "model" in rows[0]
    figure = Figure(figsize=(8, 7 if compared else 5), layout="constrained")
    FigureCanvasAgg(figure)
    if compared:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        models(above, below, rows)
        above.legend(fontsize=8)
    else:
        _moist_and_dry(figure.subplots(), rows)
    each, pressure = _axes(rows)[1], f"{rows[0]['pressure_hpa']:g} hPa"
    (first, *_), *others = _curves(rows, each)
    title = f"{first}, {pressure}" if compared and not others else pressure
    figure.axes[0].set_title(title, fontsize=10)
    figure.savefig(path, dpi=150, format=form)


def climates(panels: Sequence[tuple[str, list[Record]]], path: Path, form: str) -> None:
    """Writes a picture of all models in several climates, their ratio to the first below each."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    FigureCanvasAgg(figure)
    columns = 2
    lines = -(-len(panels) // columns)
    axes = figure.subplots(2 * lines, columns, sharex=True, height_ratios=(2, 1) * lines)
    for number, (title, rows) in enumerate(panels):
        line, column = divmod(number, columns)
        above, below = axes[2 * line, column], axes[2 * line + 1, column]
        models(above, below, rows)
        above.set_title(title, fontsize=10)
        if line < lines - 1:
            below.set_xlabel("")
    axes[0, 0].legend(fontsize=8)
    figure.savefig(path, dpi=150, format=form)


def models(above: Any, below: Any, rows: list[Record]) -> None:
    """Draws the attenuation by several models, and below it their ratio to the first."""
    along, each = _axes(rows)
    names = list(dict.fromkeys(row["model"] for row in rows))
    several = len({row[each] for row in rows}) > 1
    first = {(row[along], row[each]): row["total_db_km"] for row in _of(rows, names[0])}
    for number, name in enumerate(names):
        for label, colour, _, chosen in _curves(_of(rows, name), each):
            x = [row[along] for row in chosen]
            total = np.array([row["total_db_km"] for row in chosen])
            due = np.array([first[row[along], row[each]] for row in chosen])
            look = {"color": colour if several else f"C{number}", "linewidth": 1.2}
            look["linestyle"] = STYLES[number % len(STYLES)] if several else "-"
            named = f"{name}, {label}" if several and label else name
            above.plot(x, total, label=named if label else None, **look)
            ratio = np.divide(total, due, out=np.full_like(total, np.nan), where=due > 0)
            below.plot(x, ratio, **look)
    above.set(ylabel="attenuation / dB/km", yscale="log")
    below.set(xlabel=LABELS[along], ylabel=f"over {names[0]}")
    for axes in (above, below):
        axes.grid(alpha=0.3, which="both")


def _of(rows: list[Record], model: str) -> list[Record]:
    return [row for row in rows if row["model"] == model]


def _axes(rows: list[Record]) -> tuple[str, str]:
    """Returns the quantity along the abscissa, and the one of which each value has a curve."""
    frequencies, temperatures = ({row[key] for row in rows} for key in LABELS)
    along, each = LABELS if len(frequencies) >= len(temperatures) else reversed(LABELS)
    return along, each


def _curves(rows: list[Record], each: str) -> Iterator[Curve]:
    """Yields the curves of one model; those beyond what a legend holds have no label."""
    for number, value in enumerate(sorted({row[each] for row in rows})):
        chosen = [row for row in rows if row[each] == value]
        label = f"{value:g} {'K' if each == 'temperature_k' else 'GHz'}, {_moisture(chosen)}"
        yield label if number < MOST_NAMED else "", f"C{number % 10}", "-", chosen


def _moist_and_dry(axes: Any, rows: list[Record]) -> None:
    """Draws the attenuation of moist air, and that of its dry part."""
    along, each = _axes(rows)
    curves = list(_curves(rows, each))
    for label, colour, style, chosen in curves:
        x, moist, dry = (
            [row[key] for row in chosen] for key in (along, "total_db_km", "dry_db_km")
        )
        look = {"color": colour, "linewidth": 1.2}
        axes.plot(x, moist, style, label=label or None, **look)
        if None not in dry:
            last = chosen is curves[-1][-1]
            axes.plot(x, dry, "--", label="dry part" if last else None, **look)
        _weather(axes, chosen, along, colour, named=chosen is curves[-1][-1])
    axes.set(xlabel=LABELS[along], ylabel="specific attenuation / dB/km", yscale="log")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)


def _weather(axes: Any, rows: list[Record], along: str, colour: str, *, named: bool) -> None:
    """Draws what falls: its extinction, and between what bounds it may lie."""
    x, ends = [row[along] for row in rows], "_albedo"
    kinds = [key.removesuffix(ends) for key in rows[0] if key.endswith(ends)]
    for kind, dots in zip(kinds, DOTS * len(kinds), strict=False):
        y = [row[f"{kind}_db_km"] for row in rows]
        if not any(y):
            continue
        label = kind if named else None
        axes.plot(x, y, linestyle=dots, color=colour, label=label, linewidth=1.2)
        if f"{kind}_least_db_km" in rows[0]:
            bounds = ([row[f"{kind}_{end}_db_km"] for row in rows] for end in ("least", "most"))
            axes.fill_between(x, *bounds, color=colour, alpha=0.12, linewidth=0)


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
