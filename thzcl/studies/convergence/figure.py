"""The work-precision picture: error against run time, the Pareto front of each knob as a line."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from thzcl.files import readable
from thzcl.results.layout import LABEL, TITLE, fold, text_width

LOWEST = 1e-16  # errors of nothing are drawn here
SIZE_INCHES = (180 / 25.4, 120 / 25.4)  # two columns of a journal
POWERS = 9.0  # points; their exponents are 0.7 times as large
AWAY = (6, 9, 14, 20, 28, 38, 50, 64)  # points from a mark at which its label is tried
SIDES = ((1, 0), (1, 1), (1, -1), (-1, 0), (-1, 1), (-1, -1), (0, 1), (0, -1))


class Mark(NamedTuple):
    """A setting in the picture: its name, empty if it is not shown, place and colour."""

    setting: str
    x: float
    y: float
    colour: str


def picture(record: dict[str, Any], path: Path) -> None:
    """Writes a PNG with logarithmic axes.

    A line joins the settings of a knob than which none of it is both faster and more exact. A ring
    is drawn around the default. The ends of each knob have labels.
    """
    draw(record).savefig(path, dpi=150, format="png")


def draw(record: dict[str, Any]) -> Any:
    """Returns the matplotlib figure of a study's record."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_INCHES, layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    knobs = list(dict.fromkeys(point["knob"] for point in record["points"]))
    marks: list[Mark] = []
    for number, knob in enumerate(knobs):
        points = sorted(
            (p for p in record["points"] if p["knob"] == knob), key=lambda p: p["seconds"]
        )
        marks += _draw(ax, knob, points, f"C{number % 10}", "os^vD<>pP*"[number % 10])
    ax.plot([], [], "o", ms=11, mfc="none", mec="k", label="default setting")
    ax.plot([], [], "o-", ms=5, lw=0.8, color="gray", label="Pareto front of a knob")
    ax.plot([], [], "o", ms=5, mfc="none", mec="gray", label="off the front")
    if knobs:  # logarithmic axes cannot be empty
        _scale(ax)
    ax.set_xlabel("run time of the stages that the knob touches / s", fontsize=LABEL + 1)
    ax.set_ylabel("rms error / largest contrast in the image", fontsize=LABEL + 1)
    scenario = f"{readable(record['scenario'])}: error against run time"
    made = f"{record['device']}, medians of {record['repeat']}"
    width = 0.75 * SIZE_INCHES[0] * 72
    title = f"{fold(scenario.split(), width, TITLE)}\n{fold(made.split(), width, TITLE)}"
    ax.set_title(title, fontsize=TITLE, parse_math=False)
    ax.grid(which="both", alpha=0.2)
    ax.legend(fontsize=LABEL, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    figure.draw_without_rendering()  # from here on, places in points are known
    _label(figure, ax, marks)
    return figure


def _scale(ax: Any) -> None:
    """Makes both axes logarithmic; the labels of seconds are plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.margins(0.08, 0.1)
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: f"{seconds:g}"))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter(NullFormatter())
    ax.tick_params(axis="x", labelsize=LABEL)
    ax.tick_params(axis="y", labelsize=POWERS)


def _draw(
    ax: Any, knob: str, points: list[dict[str, Any]], colour: str, mark: str
) -> Iterator[Mark]:
    """Draws the settings of a knob, and yields them; those at its ends are named."""
    places = [(point["seconds"], max(point["error_rms"], LOWEST)) for point in points]
    front = [place for place, point in zip(places, points, strict=True) if point["on_front"]]
    ax.plot(*zip(*front, strict=True), "-", color=colour, lw=0.8, alpha=0.6)
    for point, (x, y) in zip(points, places, strict=True):
        ax.plot([x], [y], mark, color=colour, mfc=colour if point["on_front"] else "none", ms=5)
        if point["default"]:
            ax.plot([x], [y], "o", ms=11, mfc="none", mec="k", mew=0.8)
    ax.plot([], [], mark, color=colour, label=knob, ms=5)
    for number, (x, y) in enumerate(places):
        named = number in {0, len(points) - 1}
        yield Mark(points[number]["setting"] if named else "", x, y, colour)


def _label(figure: Any, ax: Any, marks: list[Mark]) -> None:
    """Writes the names of marks beside them, apart from all marks and names, within the axes.

    A name that finds no free place close by is joined to its mark by a line.
    """
    from matplotlib.transforms import Bbox

    pixels, frame = figure.dpi / 72, ax.get_window_extent()
    places = [ax.transData.transform((mark.x, mark.y)) for mark in marks]
    size = 6 * pixels  # of a mark
    taken = [Bbox.from_bounds(x - size / 2, y - size / 2, size, size) for x, y in places]
    for mark, (x, y) in zip(marks, places, strict=True):
        if not mark.setting:
            continue
        wide, tall = text_width(mark.setting, LABEL) * pixels, 1.1 * LABEL * pixels
        for away, (right, up) in itertools.product(AWAY, SIDES):
            left = x + right * away * pixels - wide * (1 - right) / 2
            bottom = y + up * away * pixels - tall * (1 - up) / 2
            box = Bbox.from_bounds(left, bottom, wide, tall)
            inside = all(frame.contains(*corner) for corner in (box.min, box.max))
            if inside and not any(box.overlaps(other) for other in taken):
                break
        taken.append(box)
        line = {"arrowstyle": "-", "lw": 0.4, "color": mark.colour, "shrinkA": 0}
        ax.annotate(
            mark.setting, (mark.x, mark.y), xytext=(right * away, up * away),
            textcoords="offset points", fontsize=LABEL, color=mark.colour, parse_math=False,
            ha=("center", "left", "right")[right], va=("center", "bottom", "top")[up],
            arrowprops=line if away > AWAY[1] else None,
        )  # fmt: skip
