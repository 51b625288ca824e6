"""Where panels, colour bars and words of a picture stand, in points (1/72 inch).

Every size is known before anything is drawn: text is measured by the font's own metrics, and ticks
are chosen so that their labels stay apart. Places count from the lower left corner.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

POINTS_PER_MM = 72 / 25.4
HEADING, TITLE, LABEL = 9.0, 8.0, 7.0  # sizes of letters
LINE = 1.25  # what a line takes, times the size of its letters
SPACING = 1.1  # from line to line as it is drawn; ascents and descents differ by font and version
MARGIN, GAP = 5.0, 7.0  # around everything, and between parts
TICK = 2.0  # length of a tick, and from it to its label
BAR = 7.0  # width of a colour bar
PANEL = 230.0  # width of a panel where the picture may be as wide as it needs
LEAST_PANEL = 17 * POINTS_PER_MM  # narrower ones are told apart badly
TALLEST = 240 * POINTS_PER_MM  # a page of a journal
HINTED = 1.04  # letters in whole pixels are that much wider at most
SHAPES = (0.3, 3.0)  # least and largest height of a panel's place over its width

Extent = tuple[float, float, float, float]  # left, right, bottom, top


class Box(NamedTuple):
    """A rectangle."""

    left: float
    bottom: float
    width: float
    height: float


class Ticks(NamedTuple):
    """Values with their labels; `scale` says what labels are to be multiplied by and added to."""

    values: list[float]
    labels: list[str]
    scale: str = ""

    @property
    def width(self) -> float:
        """Returns the width of the widest label."""
        return max((text_width(label, LABEL) for label in self.labels), default=0.0)


class Bar(NamedTuple):
    """A colour bar right of panels that stand in neighbouring columns, and maybe in rows below."""

    panels: tuple[int, ...]
    rows: tuple[int, int]  # first and last
    column: int  # right of which it stands


class Words(NamedTuple):
    """What a panel says and shows: its title in pieces that are not broken, extent, colours."""

    title: Sequence[Sequence[str]]  # pieces of each of its paragraphs
    extent: Extent
    limits: tuple[float, float]
    label: Sequence[str]  # of its colour bar, in pieces that are not broken
    group: object  # panels of one group share their colours


class Placed(NamedTuple):
    """A panel in its place: image, folded title, and ticks, None where a neighbour has them."""

    image: Box
    title: str
    x_ticks: Ticks
    y_ticks: Ticks
    x_labelled: bool
    y_labelled: bool


class PlacedBar(NamedTuple):
    """A colour bar in its place: of which panel, its ticks and its folded label."""

    box: Box
    panel: int
    ticks: Ticks
    label: str
    label_x: float  # left end of the label


class Layout(NamedTuple):
    """A whole picture."""

    width: float
    height: float
    heading: str
    panels: list[Placed]
    bars: list[PlacedBar]
    middle: tuple[float, float]  # of all panels: where the axes' names stand


def lay_out(
    heading: Sequence[str],
    panels: Sequence[Words],
    columns: int,
    beside: int,
    width_mm: float | None,
) -> Layout:
    """Returns the places of panels in rows of so many `columns`.

    Rows may be shorter where panels would be too narrow for a picture of `width_mm`; `beside`
    panels are never parted. Without `width_mm` each column is as wide as suits a screen.
    """
    if width_mm is None:
        return _Grid(panels, columns, None).layout(heading)
    width = width_mm * POINTS_PER_MM
    shorter = [n for n in range(columns, 0, -1) if columns % n == 0 and n % beside == 0]
    grids = [_Grid(panels, n, width) for n in shorter or [columns]]
    best = grids[0]
    if best.panel < LEAST_PANEL:
        best = max(grids, key=lambda grid: (grid.on_a_page, grid.panel))
    return best.layout(heading)


class _Grid:
    """Panels in rows and columns."""

    def __init__(self, panels: Sequence[Words], columns: int, width: float | None) -> None:
        self.panels, self.columns = panels, min(columns, len(panels))
        self.rows = -(-len(panels) // self.columns)
        self.bars = bars([one.group for one in panels], self.columns)
        tallest = max(_shape(one.extent) for one in panels)
        self.shape = min(max(tallest, SHAPES[0]), SHAPES[1])
        self.panel = PANEL if width is None else max(0.75 * width / self.columns - 2 * GAP, 10.0)
        self._measure(self.panel)
        if width is not None:
            for _ in range(2):  # how words are folded depends on the width that they leave
                self.panel = max((width - self._beside_panels()) / self.columns, 10.0)
                self._measure(self.panel)
            self.panel = max((width - self._beside_panels()) / self.columns, 10.0)
        self._fold(self.panel)
        self.on_a_page = True
        if width is not None:
            spare = TALLEST - self._above_panels() - 2 * HEADING * LINE
            widest = spare / self.rows / self.shape  # of panels that leave the picture on a page
            least = min(self.panel, LEAST_PANEL)
            self.on_a_page = widest >= least
            if widest < self.panel:
                self.panel = max(widest, least)
                self._fold(self.panel)
        self.width = width or self.columns * self.panel + self._beside_panels()

    def _measure(self, guess: float) -> None:
        """Chooses ticks for panels of about such a width, and measures what stands beside them."""
        high = guess * self.shape
        self.y_ticks = [
            ticks(*one.extent[2:], _count(_image(one.extent, guess, high)[1], 2.0))
            for one in self.panels
        ]
        self.before = [0.0] * self.columns  # of each column, for labels of its y axis
        for number, own in enumerate(self.y_ticks):
            if self.y_labelled(number):
                column = number % self.columns
                self.before[column] = max(self.before[column], own.width + 2 * TICK)
        self.before[0] += LABEL * LINE + TICK  # the axis' name
        self.after = [0.0] * self.columns  # of each column, for colour bars
        self.bar_ticks: list[Ticks] = []
        self.bar_labels: list[str] = []
        for bar in self.bars:
            first = self.panels[bar.panels[0]]
            lines = bar.rows[1] - bar.rows[0] + 1
            tall = lines * high + (lines - 1) * TITLE * LINE
            own = ticks(*first.limits, max(_count(tall, 2.4, most=8), 2))
            folded = fold([*first.label, own.scale] if own.scale else first.label, tall, LABEL)
            self.bar_ticks.append(own)
            self.bar_labels.append(folded)
            wide = BAR + 4 * TICK + own.width + _height(folded, LABEL)
            self.after[bar.column] = max(self.after[bar.column], wide + TICK)

    def _fold(self, panel: float) -> None:
        """Folds the titles for panels of such a width, and measures what stands above them."""
        self.titles = [
            "\n".join(fold(part, panel + GAP - TICK, TITLE) for part in one.title)
            for one in self.panels
        ]
        self.above = [0.0] * self.rows
        self.below = [0.0] * self.rows
        for number, title in enumerate(self.titles):
            row = number // self.columns
            self.above[row] = max(self.above[row], _height(title, TITLE) + 1.5 * TICK)
            if self.x_labelled(number):
                self.below[row] = 2 * TICK + LABEL * LINE

    def _beside_panels(self) -> float:
        return 2 * MARGIN + sum(self.before) + sum(self.after) + (self.columns - 1) * GAP

    def _above_panels(self) -> float:
        between = (self.rows - 1) * GAP
        return 2 * MARGIN + LABEL * LINE + TICK + sum(self.above) + sum(self.below) + between

    def x_labelled(self, number: int) -> bool:
        """Returns whether no panel right below has the same axis."""
        below = number + self.columns
        if below >= len(self.panels):
            return True
        return self.panels[number].extent[:2] != self.panels[below].extent[:2]

    def y_labelled(self, number: int) -> bool:
        """Returns whether no panel left of it, with nothing between them, has the same axis."""
        if number % self.columns == 0:
            return True
        return self.panels[number].extent[2:] != self.panels[number - 1].extent[2:]

    def layout(self, heading: Sequence[str]) -> Layout:
        """Returns all places."""
        folded = fold(heading, self.width - 2 * MARGIN, HEADING)
        high = self.panel * self.shape
        top = _height(folded, HEADING) + GAP
        height = top + self._above_panels() + self.rows * high
        spare = self.width - self.columns * self.panel - self._beside_panels()
        lefts, x = [], MARGIN + max(spare, 0.0) / 2
        for column in range(self.columns):
            x += self.before[column]
            lefts.append(x)
            x += self.panel + self.after[column] + GAP
        bottoms, y = [], height - MARGIN - top
        for row in range(self.rows):
            y -= self.above[row] + high
            bottoms.append(y)
            y -= self.below[row] + GAP
        placed = []
        for number, one in enumerate(self.panels):
            row, column = divmod(number, self.columns)
            wide, tall = _image(one.extent, self.panel, high)
            left = lefts[column] + (self.panel - wide) / 2
            image = Box(left, bottoms[row] + (high - tall) / 2, wide, tall)
            across = _apart(one.extent[:2], wide)
            labelled = self.x_labelled(number), self.y_labelled(number)
            title = self.titles[number]
            placed.append(Placed(image, title, across, self.y_ticks[number], *labelled))
        drawn = []
        for bar, own, label in zip(self.bars, self.bar_ticks, self.bar_labels, strict=True):
            first, last = bar.rows
            left = lefts[bar.column] + self.panel + 2 * TICK
            box = Box(left, bottoms[last], BAR, bottoms[first] + high - bottoms[last])
            label_x = left + BAR + 4 * TICK + own.width
            drawn.append(PlacedBar(box, bar.panels[0], own, label, label_x))
        right = lefts[-1] + self.panel
        middle = (lefts[0] + right) / 2, (bottoms[0] + high + bottoms[-1]) / 2
        return Layout(self.width, height, folded, placed, drawn, middle)


def bars(groups: Sequence[object], columns: int) -> list[Bar]:
    """Returns the colour bars of panels in rows of so many columns.

    Neighbours in a row that are of one group share a bar, and so do whole rows of one group.
    """
    found: list[Bar] = []
    for start in range(0, len(groups), columns):
        row, numbers = start // columns, range(start, min(start + columns, len(groups)))
        runs: list[list[int]] = []
        for number in numbers:
            if runs and groups[runs[-1][-1]] == groups[number]:
                runs[-1].append(number)
            else:
                runs.append([number])
        last = found[-1] if found else None
        whole = len(runs) == 1 and last is not None and last.panels[0] % columns == 0
        if whole and last is not None and groups[last.panels[0]] == groups[start]:
            found[-1] = Bar((*last.panels, *runs[0]), (last.rows[0], row), last.column)
            continue
        found += [Bar(tuple(run), (row, row), run[-1] % columns) for run in runs]
    return found


def ticks(low: float, high: float, most: int) -> Ticks:
    """Returns at most so many round values between two, with labels in which they differ.

    Labels of values that differ by little beside their size, or are far from 1, are scaled.
    """
    step = _step(low, high, most)
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    values = [n * step for n in range(first, last + 1)]
    largest = max(abs(low), abs(high))
    power = math.floor(math.log10(largest)) if largest else 0
    digits = math.floor(math.log10(step) + 1e-9)
    if digits >= -4 and power < 6 and power - digits < 6:
        return Ticks(values, [_minus(f"{value:.{max(0, -digits)}f}") for value in values])
    base = 0.0
    if power - digits >= 6:
        base = first * step
        values = [base + n * step for n in range(last - first + 1)]
    labels = [_minus(f"{(value - base) / 10.0**digits:.0f}") for value in values]
    added = f"{base:+.{min(power - digits, 15)}e}" if base else ""
    return Ticks(values, labels, _minus(f"(times 1e{digits}{added})"))


def _step(low: float, high: float, most: int) -> float:
    """Returns the least of 1, 2, 5, ... with at most so many multiples between two, but some."""
    span = (high - low) / most
    power = 10.0 ** math.floor(math.log10(span))
    steps = [factor * power for factor in (1, 2, 5, 10, 20)]
    counts = [math.floor(high / s + 1e-6) - math.ceil(low / s - 1e-6) + 1 for s in steps]
    place = next((n for n, count in enumerate(counts) if count <= most), len(steps) - 1)
    return steps[place] if counts[place] > 0 else steps[max(place - 1, 0)]


def _apart(ends: tuple[float, float], width: float) -> Ticks:
    """Returns the ticks of an axis that goes to the right, whose labels stand apart."""
    low, high = ends
    for most in (7, 5, 4, 3, 2, 1):
        found = ticks(low, high, most)
        pitch = width / (high - low)
        widths = [text_width(label, LABEL) for label in found.labels]
        clear = all(
            (found.values[n + 1] - found.values[n]) * pitch
            >= (widths[n] + widths[n + 1]) / 2 + 0.5 * LABEL
            for n in range(len(widths) - 1)
        )
        if clear:
            break
    over = [  # a label may stand out by less than half of the gap between columns
        max(own / 2 - (value - low) * pitch, own / 2 - (high - value) * pitch)
        for value, own in zip(found.values, widths, strict=True)
    ]
    kept = [n for n, out in enumerate(over) if out <= GAP / 2 - 1]
    return Ticks([found.values[n] for n in kept], [found.labels[n] for n in kept], found.scale)


def _count(length: float, letters: float, most: int = 7) -> int:
    """Returns for how many labels a length suffices, one every so many letters."""
    return min(max(int(length / (letters * LABEL)), 1), most)


def _shape(extent: Extent) -> float:
    left, right, bottom, top = extent
    return (top - bottom) / (right - left)


def _image(extent: Extent, width: float, height: float) -> tuple[float, float]:
    """Returns the largest width and height of an image that fits a place."""
    shape = _shape(extent)
    return min(width, height / shape), min(height, width * shape)


def _height(text: str, size: float) -> float:
    return (text.count("\n") + 1) * size * LINE if text else 0.0


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")


def text_width(text: str, size: float) -> float:
    """Returns the width of a line in letters of such a size."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    font = FontProperties(size=size)
    width = float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])
    return HINTED * width


def fold(pieces: Iterable[str], width: float, size: float) -> str:
    """Returns pieces of text as lines of at most such a width, in letters of such a size.

    A piece is broken only where it alone is wider.
    """

    def wide(text: str) -> bool:
        return text_width(text, size) > width

    lines: list[str] = []
    for piece in pieces:
        if lines and not wide(f"{lines[-1]} {piece}"):
            lines[-1] += f" {piece}"
            continue
        rest = piece
        while wide(rest) and len(rest) > 1:
            rest = _broken(rest, wide, lines)
        lines.append(rest)
    return "\n".join(lines)


def _broken(piece: str, wide: Callable[[str], bool], lines: list[str]) -> str:
    """Adds as much of a piece as fits to the lines, at a space if it can be; returns the rest."""
    fits = max((n for n in range(1, len(piece)) if not wide(piece[:n])), default=1)
    space = piece.rfind(" ", 1, fits + 1)
    cut = space if space > 0 else fits
    lines.append(piece[:cut].rstrip())
    return piece[cut:].lstrip()
