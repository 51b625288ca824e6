"""The picture of a result: variants side by side, each stretched to its own contrast, as in the paper."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from thzcl.result import Result

PANEL_INCHES = 3.2
DOTS_PER_INCH = 150
STRETCH_PERCENT = (0.1, 99.9)  # of the pixels, between black and white


def picture(result: Result, path: Path) -> None:
    """Writes a PNG with one panel for each variant."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    images = [(v.name, v.image, words) for v, words in zip(result.variants, result.conditions, strict=True) if v.image]
    columns = math.ceil(math.sqrt(len(images)))
    rows = math.ceil(len(images) / columns)
    height, width = images[0][1].values.shape
    tall = PANEL_INCHES * min(max(height / width, 0.3), 3.0) + 0.6
    figure = Figure(figsize=(columns * (PANEL_INCHES + 1.0), rows * tall + 0.4), layout="constrained")
    FigureCanvasAgg(figure)
    same = len({words for _, _, words in images}) == 1
    figure.suptitle(f"{result.scenario}: {images[0][2]}" if same else result.scenario, fontsize=11)
    axes = figure.subplots(rows, columns, squeeze=False)
    for (name, image, words), ax in zip(images, axes.flat, strict=False):
        _panel(figure, ax, result, image)
        ax.set_title(name if same else f"{name}\n{words}", fontsize=9)
    for ax in axes.flat[len(images) :]:
        ax.set_axis_off()
    figure.savefig(path, dpi=DOTS_PER_INCH, format="png")


def _panel(figure: Any, ax: Any, result: Result, image: Any) -> None:
    x, y = result.pixel_angles_mrad
    low, high = np.percentile(image.values, STRETCH_PERCENT)
    if low == high:
        low, high = low - 0.5, high + 0.5
    half_x, half_y = _half_step(x), _half_step(y)
    extent = (x[0] - half_x, x[-1] + half_x, y[-1] - half_y, y[0] + half_y)
    shown = ax.imshow(image.values, cmap="gray", vmin=low, vmax=high, extent=extent, interpolation="nearest")
    ax.tick_params(labelsize=7)
    ax.set_xlabel("mrad", fontsize=7)
    bar = figure.colorbar(shown, ax=ax, shrink=0.85)
    bar.ax.tick_params(labelsize=7)
    bar.set_label(f"{image.quantity} / {image.unit}" if image.unit != "1" else image.quantity, fontsize=7)


def _half_step(angles: Any) -> float:
    return float(abs(angles[1] - angles[0]) / 2) if len(angles) > 1 else 0.5
