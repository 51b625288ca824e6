"""The picture of a result: variants side by side, each stretched to its own contrast."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from thzcl.errors import FileError
from thzcl.results import spread
from thzcl.results.contents import Array, Contents, VariantResult, readable
from thzcl.sensor import Image

FORMATS = ("png", "pdf", "svg")
PANEL_INCHES = 3.2
PITCH_INCHES = PANEL_INCHES + 1.0  # from panel to panel, with the colour bar
DOTS_PER_INCH = 150
IMAGE = "gray"  # colours of images
DIVERGING = "RdBu_r"  # colours of differences, zero in the middle
SPREAD = "magma"  # colours of standard deviations
VARIANCE = "image_variance"  # an ensemble's layer
STRETCH_PERCENT = (0.1, 99.9)  # percentiles of the pixels that are shown black and white
HEADING, TITLE, LABEL = 11, 9, 7  # sizes of letters, points
LINE = 1.25 / 72  # inches from line to line, for each point of the letters' size

Extent = tuple[float, float, float, float]  # left, right, bottom, top, mrad


class Panel(NamedTuple):
    """One panel of a picture: its title, values (y, x) and where they lie, quantity and unit."""

    title: str
    values: Array
    quantity: str
    unit: str
    colours: str
    extent: Extent


def picture_format(path: Path) -> str:
    """Returns the format that a picture's name ends in. Raises FileError for any other ending."""
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMATS:
        raise FileError(f"{path}: pictures are written as .png, .pdf or .svg; choose such a name")
    return form


def draw(result: Contents, path: Path | BinaryIO, form: str) -> None:
    """Writes a picture with one panel for each variant, and one for a difference if asked for."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a name in letters that the font lacks
        picture(result).savefig(path, dpi=DOTS_PER_INCH, format=form)


def picture(result: Contents) -> Any:
    """Returns the matplotlib figure of a result."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels, beside, conditions = _panels(result)
    columns = result.figure_columns or math.ceil(math.sqrt(len(panels)))
    columns = math.ceil(columns / beside) * beside  # each image beside its spreads
    rows = math.ceil(len(panels) / columns)
    tallest = max(_height_over_width(panel.extent) for panel in panels)
    tall = PANEL_INCHES * min(max(tallest, 0.3), 3.0)
    lines = max(panel.title.count("\n") + 1 for panel in panels)
    row = tall + 0.3 + lines * TITLE * LINE
    heading = _heading(readable(result.scenario), conditions, columns * PITCH_INCHES - 0.3)
    above = 0.2 + (heading.count("\n") + 1) * HEADING * LINE
    size = (columns * PITCH_INCHES, rows * row + above)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(heading, fontsize=HEADING, parse_math=False)
    axes = figure.subplots(rows, columns, squeeze=False)
    black_and_white = _limits(panels, result.limits)
    for panel, ends, ax in zip(panels, black_and_white, axes.flat, strict=False):
        _draw_panel(figure, ax, panel, ends, 0.85 * tall)
    for ax in axes.flat[len(panels) :]:
        ax.set_axis_off()
    return figure


def _limits(panels: Sequence[Panel], asked: str | tuple[float, float]) -> list[tuple[float, float]]:
    """Returns the values that are black and white in each panel.

    Differences and spreads always have their own; images have what is `asked` for.
    """
    images = [panel.values.ravel() for panel in panels if panel.colours == IMAGE]
    shared = asked if isinstance(asked, tuple) else _stretch(np.concatenate(images))
    found = []
    for panel in panels:
        low, high = _stretch(panel.values)
        if panel.colours == DIVERGING:
            low, high = -max(-low, high), max(-low, high)
        elif panel.colours == IMAGE and asked != "panel":
            low, high = shared
        found.append((low, high if low < high else low + 1.0))
    return found


def _stretch(values: Array) -> tuple[float, float]:
    """Returns the percentiles of an image that are shown black and white."""
    low, high = np.percentile(values, STRETCH_PERCENT)
    return float(low), float(high)


def _panels(result: Contents) -> tuple[list[Panel], int, list[str]]:
    """Returns the panels, how many each image has, and the conditions that all of them share.

    Conditions are for the heading; those in which the variants differ are in the panels' titles.
    """
    each = zip(result.variants, result.conditions, result.pixel_angles_mrad, strict=True)
    shown = [
        (variant, variant.image, words, _extent(*angles))
        for variant, words, angles in each
        if variant.image
    ]
    columns = zip(*(words for _, _, words, _ in shown), strict=True)
    shared = [len(set(column)) == 1 for column in columns]
    found = []
    for variant, image, words, extent in shown:
        own = [word for word, same in zip(words, shared, strict=True) if not same]
        title = _title(variant.name, own)
        found.append(Panel(title, image.values, image.quantity, image.unit, IMAGE, extent))
        found += _spreads(result, variant, image, extent)
    beside = len(found) // len(shown)
    difference = result.image_difference()
    if difference is not None and result.difference is not None:
        title = _title(" less ".join(result.difference), [])
        quantity = f"difference of {found[0].quantity}"
        lies = next(extent for v, *_, extent in shown if v.name == result.difference[0])
        found.append(Panel(title, difference, quantity, found[0].unit, DIVERGING, lies))
    return found, beside, [word for word, same in zip(shown[0][2], shared, strict=True) if same]


def _spreads(
    result: Contents, variant: VariantResult, image: Image, extent: Extent
) -> Iterator[Panel]:
    """Yields the panels beside an image: its spread over realisations, and that over models."""
    if VARIANCE in image.layers:
        deviation = np.sqrt(image.layers[VARIANCE].values)
        title = _title(variant.name, ["spread over realisations"])
        quantity = f"standard deviation of {image.quantity}"
        yield Panel(title, deviation, quantity, image.unit, SPREAD, extent)
    if result.spread_shown and result.models:
        values, quantity, unit = spread.image(variant)
        main, *others = (one.name for one in variant.by_model(result.models[0]))
        title = _title(variant.name, [f"spread over {main}", *others])
        yield Panel(title, values, quantity, unit, SPREAD, extent)


def _title(name: str, conditions: Sequence[str]) -> str:
    """Returns a panel's title, folded: its name, and below it the conditions that are its own."""
    width = PANEL_INCHES - 0.3
    lines = [_folded(name.split(), width, TITLE)]
    if conditions:
        lines.append(_folded(_listed(conditions), width, TITLE))
    return "\n".join(lines)


def _heading(scenario: str, conditions: Sequence[str], width: float) -> str:
    """Returns the scenario and the conditions that all panels share, folded to a width."""
    name = f"{scenario}:" if conditions else scenario
    return _folded([*name.split(), *_listed(conditions)], width, HEADING)


def _listed(conditions: Sequence[str]) -> list[str]:
    """Returns conditions with a comma after all but the last, as pieces that are not broken."""
    pieces = ", ".join(conditions).split(", ")  # a condition may be several
    return [*(f"{piece}," for piece in pieces[:-1]), *pieces[-1:]]


def _folded(pieces: Iterable[str], width: float, points: float) -> str:
    """Returns pieces of text as lines of at most `width` inches, in letters of `points`."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=points)

    def inches(text: str) -> float:
        extent = text_to_path.get_text_width_height_descent(text, font, ismath=False)
        return float(extent[0]) / 72

    lines: list[str] = []
    for piece in pieces:
        longer = f"{lines[-1]} {piece}" if lines else piece
        if lines and inches(longer) <= width:
            lines[-1] = longer
            continue
        rest = piece
        while inches(rest) > width:  # a word longer than a line
            fitting = max((n for n in range(1, len(rest)) if inches(rest[:n]) <= width), default=1)
            lines.append(rest[:fitting])
            rest = rest[fitting:]
        lines.append(rest)
    return "\n".join(lines)


def _draw_panel(
    figure: Any, ax: Any, panel: Panel, ends: tuple[float, float], bar_inches: float
) -> None:
    """Draws a panel on its axes, with a colour bar whose label is at most `bar_inches` long."""
    shown = ax.imshow(
        panel.values,
        cmap=panel.colours,
        vmin=ends[0],
        vmax=ends[1],
        extent=panel.extent,
        interpolation="nearest",
    )
    ax.set_title(panel.title, fontsize=TITLE, parse_math=False)
    ax.tick_params(labelsize=LABEL)
    ax.set_xlabel("mrad", fontsize=LABEL)
    bar = figure.colorbar(shown, ax=ax, shrink=0.85, panchor=False)
    bar.ax.tick_params(labelsize=LABEL)
    label = panel.quantity if panel.unit == "1" else f"{panel.quantity} / {panel.unit}"
    bar.set_label(_folded(label.split(), bar_inches, LABEL), fontsize=LABEL, parse_math=False)


def _extent(columns: Array, rows: Array) -> Extent:
    """Returns the outer edges of the pixels whose middles lie at given angles, mrad."""
    half_x, half_y = _half_step(columns), _half_step(rows)
    return (columns[0] - half_x, columns[-1] + half_x, rows[-1] - half_y, rows[0] + half_y)


def _half_step(angles: Array) -> float:
    """Returns half the angle between neighbouring pixels, mrad, or 0.5 for a single pixel."""
    return float(abs(angles[1] - angles[0]) / 2) if len(angles) > 1 else 0.5


def _height_over_width(extent: Extent) -> float:
    """Returns the height of a panel relative to its width."""
    left, right, bottom, top = extent
    return (top - bottom) / (right - left)
