"""Where constituents are valid, and what is said of air that lies outside."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

from thzcl.constituent import Span

UNITS = {
    "frequency_ghz": "GHz",
    "temperature_k": "K",
    "pressure_hpa": "hPa",
    "vapour_hpa": "hPa of vapour",
}
ROUNDING = 1e-9  # relative: a value that misses an end by so little counts as inside
Ranges = Mapping[str, tuple[float, float]]  # quantity -> the lowest and the highest asked for


def ranges(wanted: Collection[str], **values: ArrayLike) -> Ranges:
    """Returns the lowest and the highest value of each quantity that is wanted."""
    found = {name: np.asarray(given) for name, given in values.items() if name in wanted}
    return {name: (float(array.min()), float(array.max())) for name, array in found.items()}


def outside(spans: Iterable[Span], asked: Ranges) -> Iterator[tuple[Span, float]]:
    """Yields the spans that do not hold what is asked for, each with a value that it lacks."""
    for span in spans:
        value = _beyond(span.least, span.most, asked.get(span.quantity))
        if value is not None:
            yield span, value


def notes(name: str, spans: Iterable[Span], asked: Ranges) -> list[str]:
    """Returns what to tell of values for which a constituent extrapolates."""
    found = []
    for span in spans:
        least, most = span.warn or (span.least, span.most)
        value = _beyond(least, most, asked.get(span.quantity))
        if value is not None:
            unit = UNITS[span.quantity]
            stated = f"from {least:g}" if value < least else f"to {most:g}"
            text = f'{value:g} {unit}: "{name}" is stated {stated} {unit}'
            found.append(f"{text}; beyond, {span.beyond or 'absorption is an extrapolation'}")
    return found


def in_words(name: str, span: Span, value: float) -> str:
    """Returns a value, and the range of a constituent that does not hold it."""
    unit = UNITS[span.quantity]
    parts = [f"from {span.least:g}"] if 0 < span.least < np.inf else []
    parts += [f"up to {span.most:g}"] if span.most < np.inf else []
    words = f" ({span.words})" if span.words else ""
    return f'{value:g} {unit}: "{name}" holds {" ".join(parts)} {unit}{words}'


def _beyond(least: float, most: float, asked: tuple[float, float] | None) -> float | None:
    """Returns the value farthest out, or None if all that is asked for lies within."""
    if asked is None:
        return None
    low, high = asked
    if not high <= most + ROUNDING * abs(most):
        return high
    return None if low >= least - ROUNDING * abs(least) else low
