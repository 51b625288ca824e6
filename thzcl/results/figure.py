"""The picture of a result: variants side by side, those of one quantity in the same colours."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from thzcl.errors import FileError, UsageError
from thzcl.files import readable
from thzcl.results import spread
from thzcl.results.contents import Array, Contents, VariantResult
from thzcl.results.layout import (
    HEADING,
    LABEL,
    MARGIN,
    SPACING,
    TICK,
    TITLE,
    Box,
    Extent,
    Layout,
    Words,
    lay_out,
)
from thzcl.sensor import Image, Radiances

FORMATS = ("png", "pdf", "svg")
WIDTHS_MM = (88, 180)  # one and two columns of a journal
SCREEN_DOTS, PRINT_DOTS = 150, 300  # per inch
DIVERGING = "coolwarm"  # of differences, zero in the middle (Moreland 2009, even in CIELAB)
SPREAD = "magma"  # of standard deviations and spreads
VARIANCE = "image_variance"  # an ensemble's layer
MOST_FREQUENCIES = 6  # of one image that have panels of their own
STRETCH_PERCENT = (0.1, 99.9)  # percentiles of the pixels at the ends of the colours


class Panel(NamedTuple):
    """One panel of a picture: its title, values (y, x) and where they lie, quantity and unit.

    `kind` is "image", "difference" or "spread"; `band` the frequency in words.
    """

    title: Sequence[Sequence[str]]
    values: Array
    quantity: str
    unit: str
    kind: str
    band: str
    extent: Extent


def picture_format(path: Path) -> str:
    """Returns the format that a picture's name ends in. Raises FileError for any other ending."""
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMATS:
        raise FileError(f"{path}: pictures are written as .png, .pdf or .svg; choose such a name")
    return form


def draw(result: Contents, path: Path | BinaryIO, form: str, width_mm: int | None) -> None:
    """Writes a picture with one panel for each variant, and one for a difference if asked for."""
    import matplotlib as mpl

    with warnings.catch_warnings(), mpl.rc_context({"pdf.fonttype": 42}):
        # letters are TrueType, which journals ask for
        warnings.filterwarnings("ignore", "Glyph")  # a name in letters that the font lacks
        picture(result, width_mm).savefig(path, format=form)


def checked_width(width_mm: float | None) -> int | None:
    """Returns the width of a picture for print. Raises UsageError for another than a journal's."""
    if width_mm is not None and width_mm not in WIDTHS_MM:
        text = "pictures for print are 88 or 180 mm wide, one or two columns"
        raise UsageError(f"width_mm = {width_mm:g}: {text}; leave it out for the screen")
    return None if width_mm is None else int(width_mm)


def picture(result: Contents, width_mm: int | None = None) -> Any:
    """Returns the matplotlib figure of a result, as wide as a journal's column or a screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels, beside, conditions = _panels(result)
    columns = result.figure_columns or _columns(len(panels), len(result.variants), beside)
    beside = max(beside, 1)
    columns = math.ceil(columns / beside) * beside  # each image beside its spreads
    groups = _groups(panels, result.limits)
    words = [
        Words(panel.title, panel.extent, ends, _label(panel), group)
        for panel, group, ends in zip(
            panels, groups, _limits(panels, groups, result.limits), strict=True
        )
    ]
    heading = _heading(readable(result.scenario), conditions)
    layout = lay_out(heading, words, columns, beside, width_mm)
    dots = SCREEN_DOTS if width_mm is None else PRINT_DOTS
    figure = Figure(figsize=(layout.width / 72, layout.height / 72), dpi=dots)
    FigureCanvasAgg(figure)
    _name(figure, layout)
    colours = {"image": result.color_map, "difference": DIVERGING, "spread": SPREAD}
    shown = [
        _draw_panel(figure, layout, number, panel, one.limits, colours[panel.kind])
        for number, (panel, one) in enumerate(zip(panels, words, strict=True))
    ]
    for bar in layout.bars:
        ax = figure.add_axes(_share(layout, bar.box))
        drawn = figure.colorbar(shown[bar.panel], cax=ax)
        drawn.set_ticks(bar.ticks.values, labels=bar.ticks.labels, parse_math=False)
        drawn.minorticks_off()
        ax.tick_params(labelsize=LABEL, length=TICK, pad=TICK)
        middle = (bar.box.bottom + bar.box.height / 2) / layout.height
        figure.text(
            bar.label_x / layout.width, middle, bar.label, rotation=90, fontsize=LABEL,
            va="center", ha="left", multialignment="center", linespacing=SPACING, parse_math=False,
        )  # fmt: skip
    return figure


def _columns(panels: int, variants: int, beside: int) -> int:
    """Returns how many panels stand in a row: about as many as there are rows.

    Where panels stand by frequency, variants fill whole rows.
    """
    about = math.sqrt(panels)
    if beside or variants == 1:
        return math.ceil(about)
    whole = (n for n in range(1, variants + 1) if variants % n == 0)
    return min(whole, key=lambda n: abs(n - about))


def _share(layout: Layout, box: Box) -> tuple[float, float, float, float]:
    """Returns a place as parts of the figure."""
    wide, tall = layout.width, layout.height
    return box.left / wide, box.bottom / tall, box.width / wide, box.height / tall


def _name(figure: Any, layout: Layout) -> None:
    """Writes the heading and the names of the axes."""
    wide, tall = layout.width, layout.height
    x, y = layout.middle
    figure.suptitle(
        layout.heading, x=0.5, y=1 - MARGIN / tall, va="top", fontsize=HEADING,
        linespacing=SPACING, parse_math=False,
    )  # fmt: skip
    figure.supxlabel("x angle / mrad", x=x / wide, y=MARGIN / tall, va="bottom", fontsize=LABEL)
    left = min(one.image.left - one.y_ticks.width for one in layout.panels) - 3 * TICK
    figure.supylabel(
        "y angle / mrad", x=left / wide, y=y / tall, ha="right", va="center", fontsize=LABEL
    )


def _label(panel: Panel) -> list[str]:
    """Returns the label of a colour bar in pieces, the last with the unit."""
    *words, last = panel.quantity.split() or [""]
    return [*words, last if panel.unit == "1" else f"{last} / {panel.unit}"]


def _groups(panels: Sequence[Panel], asked: str | tuple[float, float]) -> list[object]:
    """Returns of each panel what those have in common that show the same colours."""
    if asked == "panel":
        return list(range(len(panels)))
    given = not isinstance(asked, str)
    return [
        _alike(one._replace(band="") if given and one.kind == "image" else one) for one in panels
    ]


def _alike(panel: Panel) -> tuple[str, str, str, str]:
    """Returns what those panels have in common whose values are of one kind."""
    return panel.kind, panel.quantity, panel.unit, panel.band


def _limits(
    panels: Sequence[Panel], groups: Sequence[object], asked: str | tuple[float, float]
) -> list[tuple[float, float]]:
    """Returns the values at the ends of the colours in each panel.

    Images have what is `asked` for; differences and spreads, and images where nothing is given,
    have percentiles of all panels of their group.
    """
    values: dict[object, list[Array]] = {}
    for panel, group in zip(panels, groups, strict=True):
        values.setdefault(group, []).append(panel.values.ravel())
    own = {group: _stretch(np.concatenate(arrays)) for group, arrays in values.items()}
    found = []
    for panel, group in zip(panels, groups, strict=True):
        low, high = own[group]
        if panel.kind == "difference":
            low, high = -max(-low, high), max(-low, high)
        elif panel.kind == "image" and isinstance(asked, tuple):
            low, high = asked
        found.append((low, high if low < high else low + 1.0))
    return found


def _stretch(values: Array) -> tuple[float, float]:
    """Returns the percentiles of an image that are shown black and white."""
    low, high = np.percentile(values, STRETCH_PERCENT)
    return float(low), float(high)


def _panels(result: Contents) -> tuple[list[Panel], int, list[str]]:
    """Returns the panels, how many each image has, and the conditions that all of them share.

    Images at several frequencies stand by frequency, not by variant, and the number is 0.
    Conditions are for the heading; those in which the variants differ are in the panels' titles,
    but for what all variants say in their names.
    """
    each = zip(result.variants, result.conditions, result.pixel_angles_mrad, strict=True)
    shown = [
        (variant, variant.image, words, outer_edges(*angles))
        for variant, words, angles in each
        if variant.image
    ]
    columns = zip(*(words for _, _, words, _ in shown), strict=True)
    seen = [list(_frequencies(variant, image, words[0])) for variant, image, words, _ in shown]
    names = [variant.name.split(", ") for variant, *_ in shown]
    named = {word for column in columns if _each_in(column, names) for word in column}
    pieces = [
        _pieces(words if len(planes) == 1 else words[1:])
        for (_, _, words, _), planes in zip(shown, seen, strict=True)
    ]
    shared = [piece for piece in pieces[0] if all(piece in others for others in pieces)]
    found: list[Panel] = []
    for (variant, image, words, extent), planes, all_own in zip(shown, seen, pieces, strict=True):
        known = {*shared, *named}
        own = [one for one in all_own if one not in known and not _amount_in(variant.name, one)]
        name = "" if variant.name == result.scenario else variant.name
        kept = (image.quantity, image.unit, "image")
        found += (
            Panel(_title(name, [*own, *at]), values, *kept, band, extent)
            for values, at, band in planes
        )
        found += _spreads(result, variant, image, words[0], extent)
    beside = len(found) // len(shown)
    if any(len(planes) > 1 for planes in seen):
        alike = list(dict.fromkeys(_alike(panel) for panel in found))
        found.sort(key=lambda panel: alike.index(_alike(panel)))
        beside = 0
    difference = result.image_difference()
    if difference is not None and result.difference is not None:
        title = _title(" less ".join(result.difference), [])
        quantity = f"difference of {found[0].quantity}"
        lies = next(extent for v, *_, extent in shown if v.name == result.difference[0])
        unit = found[0].unit
        found.append(Panel(title, difference, quantity, unit, "difference", "", lies))
    return found, beside, shared


def _frequencies(
    variant: VariantResult, image: Image, band: str
) -> Iterator[tuple[Array, list[str], str]]:
    """Yields what panels show of an image: values, its frequency if told apart, and the band.

    An image that is the mean over a few frequencies is shown at each of them.
    """
    mean, sight = _mean(image, variant), variant.sight
    if not mean or len(sight.frequency_hz) > MOST_FREQUENCIES or not isinstance(sight, Radiances):
        yield image.values, mean, band
        return
    for hz, values in zip(sight.frequency_hz, sight.brightness_temperature, strict=True):
        at = f"{hz / 1e9:.6g} GHz"
        yield values, [at], at


def _mean(image: Image, variant: VariantResult) -> list[str]:
    """Returns in words of how many frequencies an image is the mean, if of several."""
    if not image.mean_over_frequencies or len(variant.sight.frequency_hz) == 1:
        return []
    return [f"mean of {len(variant.sight.frequency_hz)} frequencies"]


def _each_in(words: Sequence[str], names: Sequence[Sequence[str]]) -> bool:
    """Returns whether each variant's word is a part of its name."""
    return all(word in name for word, name in zip(words, names, strict=True))


def _amount_in(name: str, condition: str) -> bool:
    """Returns whether a name says how much there is of something, as "(b) 2 mm/h" does of rain."""
    what, *amount = condition.split()
    return len(amount) == 2 and what.isalpha() and " ".join(amount) in name


def _pieces(conditions: Sequence[str]) -> list[str]:
    """Returns conditions one by one: a sensor's caption may hold several."""
    return [piece for one in conditions for piece in one.split(", ") if piece]


def _spreads(
    result: Contents, variant: VariantResult, image: Image, band: str, extent: Extent
) -> Iterator[Panel]:
    """Yields the panels beside an image: its spread over realisations, and that over models."""
    if VARIANCE in image.layers:
        deviation = np.sqrt(image.layers[VARIANCE].values)
        title = _title(variant.name, ["spread over realisations", *_mean(image, variant)])
        quantity = f"standard deviation of {image.quantity}"
        yield Panel(title, deviation, quantity, image.unit, "spread", band, extent)
    if result.spread_shown and result.models:
        values, quantity, unit = spread.image(variant)
        main, *others = (one.name for one in variant.by_model(result.models[0]))
        title = _title(variant.name, [f"spread over {main}", *others, *_mean(image, variant)])
        yield Panel(title, values, quantity, unit, "spread", band, extent)


def _title(name: str, conditions: Sequence[str]) -> list[list[str]]:
    """Returns a panel's title: its name, and below the conditions of its own, in pieces."""
    return [
        part
        for part in (_listed([" ".join(name.split())] if name else []), _listed(conditions))
        if part
    ]


def _heading(scenario: str, conditions: Sequence[str]) -> list[str]:
    """Returns the scenario and the conditions that all panels share, in pieces."""
    name = f"{scenario}:" if conditions else scenario
    return [*name.split(), *_listed(conditions)]


def _listed(conditions: Sequence[str]) -> list[str]:
    """Returns conditions with a comma after all but the last, as pieces that are not broken."""
    pieces = _pieces(conditions)
    return [*(f"{piece}," for piece in pieces[:-1]), *pieces[-1:]]


def _draw_panel(
    figure: Any, layout: Layout, number: int, panel: Panel, ends: tuple[float, float], colours: str
) -> Any:
    """Draws a panel in its place, and returns what its colour bar is made of."""
    placed = layout.panels[number]
    ax = figure.add_axes(_share(layout, placed.image))
    shown = ax.imshow(
        panel.values, cmap=colours, vmin=ends[0], vmax=ends[1], extent=panel.extent,
        aspect="auto", interpolation="antialiased",
    )  # fmt: skip
    ax.set_title(
        placed.title, fontsize=TITLE, pad=1.5 * TICK, y=1.0, linespacing=SPACING, parse_math=False
    )
    for axis, own, labelled in (
        (ax.xaxis, placed.x_ticks, placed.x_labelled),
        (ax.yaxis, placed.y_ticks, placed.y_labelled),
    ):
        axis.set_ticks(own.values, labels=own.labels if labelled else [""] * len(own.values))
    ax.tick_params(labelsize=LABEL, length=TICK, pad=TICK)
    return shown


def outer_edges(columns: Array, rows: Array) -> Extent:
    """Returns the outer edges of the pixels whose middles lie at given angles, mrad."""
    half_x, half_y = _half_step(columns), _half_step(rows)
    return (columns[0] - half_x, columns[-1] + half_x, rows[-1] - half_y, rows[0] + half_y)


def _half_step(angles: Array) -> float:
    """Returns half the angle between neighbouring pixels, mrad, or 0.5 for a single pixel."""
    return float(abs(angles[1] - angles[0]) / 2) if len(angles) > 1 else 0.5
