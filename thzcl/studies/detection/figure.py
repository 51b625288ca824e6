"""The picture of `thzcl range`: probability of detection against range, with its intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from thzcl.results.contents import readable
from thzcl.studies.detection.ranges import RangeResult

SIZE_INCHES = (7.0, 4.4)
DOTS_PER_INCH = 150


def draw(found: RangeResult, path: Path) -> None:
    """Writes the picture of an answer as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    _draw(figure.subplots(), found)
    figure.savefig(path, dpi=DOTS_PER_INCH, format="png")


def _draw(ax: Any, found: RangeResult) -> None:
    asked = found.question
    models = {curve.model for curve in found.curves}
    for curve in found.curves:
        name = f"{curve.frequency_ghz:g} GHz" + (f", {curve.model}" if len(models) > 1 else "")
        each = [one.probability for one in curve.found]
        (line,) = ax.plot(curve.range_m, [e.value for e in each], "o-", ms=3, label=name)
        ends = [e.low for e in each], [e.high for e in each]
        ax.fill_between(curve.range_m, *ends, color=line.get_color(), alpha=0.2, lw=0)
        reach = curve.reach
        if reach.range_m is not None:
            ax.axvline(reach.range_m, color=line.get_color(), lw=0.8, ls=":")
    ax.axhline(asked.probability, color="0.4", lw=0.8, ls="--")
    ax.set_ylim(-0.02, 1.02)
    ax.set_xlabel("range / m")
    ax.set_ylabel("probability of detection")
    ax.legend(frameon=False)
    ax.grid(visible=True, color="0.9")
    scenario, target = readable(asked.base.document.name), readable(asked.base.target)
    ax.set_title(
        f"{scenario}: {target}, {asked.false_alarm:g} false alarms a test, {asked.airs} airs; "
        "bands: 95 %",
        fontsize=9,
        parse_math=False,
    )
