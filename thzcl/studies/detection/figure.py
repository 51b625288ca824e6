"""The picture of `thzcl range`: probability of detection against range, with its intervals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from thzcl.files import readable
from thzcl.studies.detection.ranges import RangeResult

SIZE_INCHES = (7.0, 4.4)
DOTS_PER_INCH = 150
SMOOTH = 400  # points of a curve, joined on the probit scale as the range at a probability is


def draw(found: RangeResult, path: Path) -> None:
    """Writes the picture of an answer as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_INCHES, layout="constrained")
    FigureCanvasAgg(figure)
    _draw(figure.subplots(), found)
    figure.savefig(path, dpi=DOTS_PER_INCH, format="png")


def _draw(ax: Any, found: RangeResult) -> None:
    from scipy.special import ndtr

    asked = found.question
    models = {curve.model for curve in found.curves}
    for curve in found.curves:
        name = f"{curve.frequency_ghz:g} GHz" + (f", {curve.model}" if len(models) > 1 else "")
        between = np.geomspace(curve.range_m[0], curve.range_m[-1], SMOOTH)
        probits = [one.probit for one in curve.found]
        fitted = ndtr(np.interp(np.log(between), np.log(curve.range_m), probits))
        (line,) = ax.plot(between, fitted, label=name)
        each = np.array([one.probability for one in curve.found])  # value, low, high
        ends = np.maximum(np.abs(each[:, 1:] - each[:, :1]).T, 0.0)
        colour = line.get_color()
        ax.errorbar(curve.range_m, each[:, 0], ends, fmt="o", ms=4, capsize=3, color=colour, lw=1)
        reach = curve.reach
        if reach.range_m is not None:
            ax.axvline(reach.range_m, color=colour, lw=0.8, ls=":")
    ax.axhline(asked.probability, color="0.4", lw=0.8, ls="--")
    ax.set_ylim(-0.02, 1.02)
    ax.set_xlabel("range / m")
    ax.set_ylabel("probability of detection")
    ax.legend(frameon=False)
    ax.grid(visible=True, color="0.9")
    scenario, target = readable(asked.base.document.name), readable(asked.base.target)
    ax.set_title(
        f"{scenario}: {target}, {asked.false_alarm:g} false alarms a test, {asked.airs} airs; "
        "bars: 95 %",
        fontsize=9,
        parse_math=False,
    )
