"""A report: one HTML file of sections, without requests, from a template that escapes all text."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

Cell = str | float | int | None
COLOURS = ("#2b7bba", "#d1701f", "#3a9a4d", "#b8405e", "#7a5ab5", "#8a7a1f", "#2a9a9a", "#777777")
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 720, 360, 70, 20, 30, 50
_TEMPLATE = "page.html"


class Picture(NamedTuple):
    """A picture in the page: its PNG in base64, and what it shows."""

    data: str
    alt: str


@dataclass(frozen=True)
class Section:
    """A part of a page, of which what is empty is left out."""

    title: str
    texts: Sequence[str] = ()
    tone: str = ""  # "warn" for what a reader must not miss
    pictures: Sequence[Picture] = ()
    chart: dict[str, Any] | None = None
    heat: dict[str, Any] | None = None
    table: dict[str, Any] | None = None
    code: str = ""
    summary: str = ""
    open: bool = False


class Series(NamedTuple):
    """A line of a chart: its name, points (x, y), and the ends of an interval at each."""

    name: str
    points: list[tuple[float, float]]
    band: Sequence[tuple[float, float]] = ()


def render(title: str, subtitle: str, sections: Iterable[Section]) -> str:
    """Returns the HTML of a page. Every text in it is escaped."""
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    text = Path(__file__).with_name(_TEMPLATE).read_text(encoding="utf-8")
    shown = [one for one in sections if _holds(one)]
    return environment.from_string(text).render(title=title, subtitle=subtitle, sections=shown)


def _holds(one: Section) -> bool:
    return bool(one.texts or one.pictures or one.chart or one.heat or one.table or one.code)


def table(
    columns: Sequence[str], rows: Sequence[Sequence[Cell]], *, sorts: bool = False
) -> dict[str, Any] | None:
    """Returns a table for a section, or None if it has no rows."""
    if not rows:
        return None
    numeric = [
        any(row[n] is not None for row in rows) and not any(isinstance(row[n], str) for row in rows)
        for n in range(len(columns))
    ]
    written = [[number(cell) for cell in row] for row in rows]
    return {"columns": list(columns), "rows": written, "numeric": numeric, "sorts": sorts}


def number(value: Cell) -> str:
    """Returns a cell as text: numbers to five digits, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    return f"{value:.5g}"


def png(figure: Any, alt: str) -> Picture:
    """Returns a matplotlib figure as a picture."""
    stored = io.BytesIO()
    figure.savefig(stored, format="png", dpi=110)
    return Picture(base64.b64encode(stored.getvalue()).decode("ascii"), alt)


def chart(
    series: Sequence[Series], x_label: str, y_label: str, limits: tuple[float, float] | None = None
) -> dict[str, Any] | None:
    """Returns a chart of lines for a section, or None if there are no two points to join.

    `limits` are those of the y axis, by default such as to hold all points.
    """
    points = [point for one in series for point in one.points]
    if len({x for x, _ in points}) < 2:
        return None
    ends = [y for one in series for pair in one.band for y in pair]
    x_span = _span([x for x, _ in points])
    y_span = limits or _span([*(y for _, y in points), *ends])
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def across(x: float) -> float:
        return round(_LEFT + (x - x_span[0]) / (x_span[1] - x_span[0]) * (right - _LEFT), 1)

    def down(y: float) -> float:
        return round(bottom - (y - y_span[0]) / (y_span[1] - y_span[0]) * (bottom - _TOP), 1)

    lines = []
    for place, one in enumerate(series):
        dots = [(across(x), down(y)) for x, y in one.points]
        xs = [x for x, _ in one.points]
        lows = [(across(x), down(low)) for x, (low, _) in zip(xs, one.band, strict=False)]
        highs = [(across(x), down(high)) for x, (_, high) in zip(xs, one.band, strict=False)]
        lines.append(
            {
                "name": one.name,
                "colour": COLOURS[place % len(COLOURS)],
                "points": _joined(dots),
                "dots": dots,
                "band": _joined([*lows, *reversed(highs)]),
            }
        )
    return {
        "width": _WIDTH, "height": _HEIGHT, "left": _LEFT, "right": right, "top": _TOP,
        "bottom": bottom, "x_label": x_label, "y_label": y_label,
        "label": f"{y_label} against {x_label}", "series": lines,
        "x_ticks": [{"at": across(x), "text": f"{x:g}"} for x in ticks(*x_span)],
        "y_ticks": [{"at": down(y), "text": f"{y:g}"} for y in ticks(*y_span)],
    }  # fmt: skip


def _joined(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{x},{y}" for x, y in points)


def _span(values: list[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    return (
        (low, high) if high > low else (low - 0.5 * (abs(low) or 1), high + 0.5 * (abs(low) or 1))
    )


def ticks(low: float, high: float, most: int = 7) -> list[float]:
    """Returns round numbers from low to high, at most so many."""
    step = 10.0 ** math.floor(math.log10((high - low) / most))
    step *= next(k for k in (1, 2, 5, 10, 20) if (high - low) / (k * step) <= most)
    first = math.ceil(low / step - 1e-9)
    return [round(n * step, 12) for n in range(first, math.floor(high / step + 1e-9) + 1)]


def heat(
    caption: str, corner: str, columns: Sequence[Cell], rows: dict[Cell, list[float | None]]
) -> dict[str, Any] | None:
    """Returns a heat map for a section: values by column under the names of rows."""
    known = [value for row in rows.values() for value in row if value is not None]
    if not known:
        return None
    low, high = min(known), max(known)
    scale = 0.75 / (high - low) if high > low else 0.0
    shown = [
        {
            "name": number(name),
            "cells": [
                {"text": number(v), "share": 0.0 if v is None else round((v - low) * scale, 3)}
                for v in row
            ],
        }
        for name, row in rows.items()
    ]
    return {"caption": caption, "corner": corner, "columns": [*map(number, columns)], "rows": shown}
