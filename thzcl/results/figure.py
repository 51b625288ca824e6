"""The picture of a result: variants side by side, each stretched to its own contrast.

As in the paper.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from thzcl.results.result import Result

PANEL_INCHES = 3.2
DOTS_PER_INCH = 150
DIVERGING = "RdBu_r"  # of differences, zero in the middle
VARIANCE = "image_variance"  # an ensemble's layer
STRETCH_PERCENT = (0.1, 99.9)  # of the pixels, between black and white


class Panel(NamedTuple):
    """One picture among the others."""

    title: str
    values: Any
    quantity: str
    unit: str
    colours: str


def picture(result: Result, path: Path) -> None:
    """Writes a PNG with one panel for each variant.

    And one for their difference where asked for.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels, heading = _panels(result)
    columns = result.figure_columns or math.ceil(math.sqrt(len(panels)))
    if any(panel.colours == "magma" for panel in panels):
        columns += columns % 2  # each mean beside its spread
    rows = math.ceil(len(panels) / columns)
    height, width = panels[0].values.shape
    tall = PANEL_INCHES * min(max(height / width, 0.3), 3.0) + 0.6
    figure = Figure(
        figsize=(columns * (PANEL_INCHES + 1.0), rows * tall + 0.4), layout="constrained"
    )
    FigureCanvasAgg(figure)
    figure.suptitle(heading, fontsize=11)
    axes = figure.subplots(rows, columns, squeeze=False)
    for panel, ax in zip(panels, axes.flat, strict=False):
        _draw(figure, ax, result.pixel_angles_mrad, panel)
    for ax in axes.flat[len(panels) :]:
        ax.set_axis_off()
    figure.savefig(path, dpi=DOTS_PER_INCH, format="png")


def _panels(result: Result) -> tuple[list[Panel], str]:
    """The panels, and the heading above them all: conditions that all share stand there.

    The others over each.
    """
    shown = [
        (v.name, v.image, words)
        for v, words in zip(result.variants, result.conditions, strict=True)
        if v.image
    ]
    shared = [len(set(parts)) == 1 for parts in zip(*(words for _, _, words in shown), strict=True)]
    found = []
    for name, image, words in shown:
        own = [word for word, same in zip(words, shared, strict=True) if not same]
        title = "\n".join([name, *([", ".join(own)] if own else [])])
        found.append(Panel(title, image.values, image.quantity, image.unit, "gray"))
        if VARIANCE in image.layers:
            spread, title = (
                np.sqrt(image.layers[VARIANCE].values),
                f"{name}\nspread over realisations",
            )
            found.append(
                Panel(title, spread, f"standard deviation of {image.quantity}", image.unit, "magma")
            )
    difference = result.image_difference()
    if difference is not None and result.difference is not None:
        title = " less ".join(result.difference)
        found.append(
            Panel(title, difference, f"difference of {found[0].quantity}", found[0].unit, DIVERGING)
        )
    common = [word for word, same in zip(shown[0][2], shared, strict=True) if same]
    return found, ": ".join([result.scenario, *([", ".join(common)] if common else [])])


def _draw(figure: Any, ax: Any, angles_mrad: tuple[Any, Any], panel: Panel) -> None:
    x, y = angles_mrad
    low, high = np.percentile(panel.values, STRETCH_PERCENT)
    if panel.colours == DIVERGING:
        low, high = -max(-low, high), max(-low, high)
    if low == high:
        high = low + 1.0
    half_x, half_y = _half_step(x), _half_step(y)
    extent = (x[0] - half_x, x[-1] + half_x, y[-1] - half_y, y[0] + half_y)
    shown = ax.imshow(
        panel.values,
        cmap=panel.colours,
        vmin=low,
        vmax=high,
        extent=extent,
        interpolation="nearest",
    )
    ax.set_title(panel.title, fontsize=9)
    ax.tick_params(labelsize=7)
    ax.set_xlabel("mrad", fontsize=7)
    bar = figure.colorbar(shown, ax=ax, shrink=0.85)
    bar.ax.tick_params(labelsize=7)
    bar.set_label(
        panel.quantity if panel.unit == "1" else f"{panel.quantity} / {panel.unit}", fontsize=7
    )


def _half_step(angles: Any) -> float:
    return float(abs(angles[1] - angles[0]) / 2) if len(angles) > 1 else 0.5
