"""The work-precision picture: error against run time, a line for each knob."""

from __future__ import annotations

from pathlib import Path
from typing import Any

LOWEST = 1e-16  # errors of nothing are drawn here


def picture(record: dict[str, Any], path: Path) -> None:
    """Writes a PNG with logarithmic axes.

    Marks on a knob's Pareto front are filled, and a ring is drawn around the default.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    knobs = list(dict.fromkeys(point["knob"] for point in record["points"]))
    for number, knob in enumerate(knobs):
        points = sorted(
            (p for p in record["points"] if p["knob"] == knob), key=lambda p: p["seconds"]
        )
        _draw(ax, knob, points, f"C{number % 10}", "os^vD<>pP*"[number % 10])
    ax.plot([], [], "o", ms=13, mfc="none", mec="k", label="default setting")
    ax.plot([], [], "o", ms=7, mfc="gray", mec="gray", label="on the knob's Pareto front")
    if knobs:  # logarithmic axes cannot be empty
        ax.set_xscale("log")
        ax.set_yscale("log")
    ax.set_xlabel("run time of the stages that the knob touches / s")
    ax.set_ylabel("rms error / largest contrast in the image")
    made = f"{record['device']}, medians of {record['repeat']}"
    ax.set_title(f"{record['scenario']}: error against run time\n{made}", fontsize=10)
    ax.grid(which="both", alpha=0.2)
    ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=130, format="png")


def _draw(ax: Any, knob: str, points: list[dict[str, Any]], colour: str, mark: str) -> None:
    seconds = [point["seconds"] for point in points]
    error = [max(point["error_rms"], LOWEST) for point in points]
    ax.plot(seconds, error, "-", color=colour, lw=0.8, alpha=0.5)
    for point, x, y in zip(points, seconds, error, strict=True):
        ax.plot([x], [y], mark, color=colour, mfc=colour if point["on_front"] else "none", ms=7)
        if point["default"]:
            ax.plot([x], [y], "o", ms=13, mfc="none", mec="k")
    ax.plot([], [], mark, color=colour, label=knob)
    for point, x, y in ((points[0], seconds[0], error[0]), (points[-1], seconds[-1], error[-1])):
        ax.annotate(
            point["setting"],
            (x, y),
            textcoords="offset points",
            xytext=(6, 4),
            fontsize=6,
            color=colour,
        )
