"""Rows of one file or several in order of time, set in even steps.

Repeated stamps, disorder and coarse stamps are found and counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records.reading import Rows
from thzcl.records.stamps import FASTEST_HZ, SLOWEST_HZ

Array = NDArray[np.float64]

SHORTEST = 1024  # samples: three decades of frequency, of which the inertial range takes one
MOST_MISSING = 0.2  # of the samples
MOST_DISORDER = 0.01  # of the stamps may go backwards
COARSE = 0.4  # of the stamps repeat those before: they are of whole seconds, or minutes


@dataclass(frozen=True)
class Joined:
    """Rows of all files, one after the other, in order of time, each on an even step.

    `index` (row,) is the time step of each row; `row` its place in the files together; `notes`
    what was noticed on the way.
    """

    parts: Sequence[Rows]
    start: float
    rate_hz: float
    index: NDArray[np.int64]
    row: NDArray[np.int64]
    samples: int
    repeats: int
    out_of_order: int
    notes: tuple[str, ...]

    def even(self, columns: Sequence[Array]) -> Array:
        """Returns a column, given by file, in even steps of time, NaN where there is no row."""
        values = np.concatenate(columns)[self.row]
        even = np.full(self.samples, np.nan)
        # Of two rows at one step of time the later in the file is written over by the earlier.
        even[self.index[::-1]] = values[::-1]
        return even

    def place(self, sample: int, role: str) -> str:
        """Returns file, line and column of a sample, for messages."""
        at = int(np.searchsorted(self.index, sample))
        row = int(self.row[min(at, len(self.row) - 1)])
        for part in self.parts:
            if row < len(part.lines):
                return part.place(row, role)
            row -= len(part.lines)
        return str(self.parts[-1].layout.path)


def join(parts: Sequence[Rows], rate_hz: float | None) -> Joined:
    """Returns the rows of all files in order of time, each stamp once.

    Raises RecordError if the files do not belong together, or have not one rate throughout.
    """
    notes: list[str] = []
    timed = []
    for part in parts:
        fine, told = _timed(part, rate_hz)
        timed.append(fine)
        notes += told
    timed.sort(key=lambda part: float(part.time_s[0]))  # type: ignore[index]
    if any(part.time_s is None for part in parts):
        timed = _after_each_other(timed, rate_hz or 1.0)
    for before, after in pairwise(timed):
        _check_station(before, after)
    times = [part.time_s for part in timed if part.time_s is not None]
    out_of_order = sum(int((np.diff(time) < 0).sum()) for time in times)
    time = np.concatenate(times)
    row = np.argsort(time, kind="stable") if np.any(np.diff(time) < 0) else np.arange(len(time))
    time = time[row]
    fresh = np.concatenate([[True], np.diff(time) > 0])
    repeats = int((~fresh).sum())
    if repeats > MOST_MISSING * len(fresh):
        place = timed[-1].place(0)
        raise RecordError(f"{place}: {repeats} time stamps repeat those before; is a file twice?")
    bare = Joined(timed, float(time[0]), 0.0, row[fresh], row[fresh], 0, repeats, out_of_order,
                  tuple(notes))  # fmt: skip
    return _on_clock(bare, time[fresh], rate_hz)


def _timed(part: Rows, rate_hz: float | None) -> tuple[Rows, list[str]]:
    """Returns rows with a time of their own in seconds, and notes. Raises RecordError."""
    if part.time_s is None:
        assert rate_hz is not None  # noqa: S101 (as reading has it)
        return replace(part, time_s=np.arange(len(part.lines)) / rate_hz), [
            f"no time in the file: {rate_hz:g} samples a second, as given"
        ]
    backwards = np.flatnonzero(np.diff(part.time_s) < 0)
    if backwards.size > max(MOST_DISORDER * len(part.time_s), 1):
        raise RecordError(
            f"{part.place(int(backwards[0]) + 1)}: time goes backwards here and in "
            f"{backwards.size - 1} other rows; expected ascending time stamps"
        )
    steps = np.diff(part.time_s)
    repeated = float((steps == 0).mean()) if len(steps) else 0.0
    if repeated > COARSE:
        return _spread(part, rate_hz)
    told = []
    if rate_hz is not None and len(steps):
        own = 1 / float(np.median(steps[steps > 0]))
        if abs(own / rate_hz - 1) > 0.01:
            told = [f"stamps say {own:.6g} samples a second, and not {rate_hz:g}: taken as stamped"]
    return part, told


def _spread(part: Rows, rate_hz: float | None) -> tuple[Rows, list[str]]:
    """Returns rows whose stamps are coarse, of whole seconds, spread evenly within each stamp."""
    time = part.time_s
    assert time is not None  # noqa: S101 (as _timed has it)
    starts = np.flatnonzero(np.diff(time, prepend=time[0] - 1) != 0)
    counts = np.diff([*starts, len(time)])
    step = float(np.median(np.diff(time[starts]))) if len(starts) > 2 else 1.0
    usual = float(np.median(counts[1:-1])) if len(counts) > 2 else float(counts.max())
    rate = rate_hz if rate_hz is not None else usual / step
    within = np.arange(len(time)) - np.repeat(starts, counts)
    # The first stamp may begin late: its samples are the last of its second.
    within[: counts[0]] += max(round(rate * step) - int(counts[0]), 0)
    return replace(part, time_s=time + within / rate), [
        f"stamps are of whole steps of {step:g} s: {rate:g} samples to a second, spread evenly"
    ]


def _after_each_other(parts: Sequence[Rows], rate_hz: float) -> list[Rows]:
    """Returns files without time one after the other, in the order given."""
    start, moved = 0, []
    for part in parts:
        moved.append(replace(part, time_s=(start + np.arange(len(part.lines))) / rate_hz))
        start += len(part.lines)
    return moved


def _check_station(before: Rows, after: Rows) -> None:
    """Raises RecordError if two files are not of one station with the same columns."""
    if (
        before.layout.station != after.layout.station
        or _assumed(before) != _assumed(after)
        or before.dated != after.dated
    ):
        text = f"of another station, or with other columns, than {before.layout.path}"
        raise RecordError(f"{after.place(0)}: {text}; analyse them apart")


def _assumed(part: Rows) -> dict[str, str]:
    """Returns the units that are assumed, by role, for the columns that hold values."""
    return {role: part.columns[role].assumed for role in part.values}


def _on_clock(bare: Joined, time: Array, rate_hz: float | None) -> Joined:
    """Returns rows on even steps of time. Raises RecordError if there is not one rate."""
    steps = np.diff(time)
    place = _Places(bare)
    typical = float(np.median(steps)) if len(steps) else 0.0
    if typical:
        counted = bare.parts[0].time_told.startswith("number")
        _check_rate(1 / typical, place(0), rate_hz, counted)
    if len(steps) < SHORTEST - 1:
        text = f"ends after {len(steps) + 1} samples; the spectrum needs at least {SHORTEST}"
        raise RecordError(f"{place(len(steps))}: {text}")
    _check_one_rate(steps, typical, place)
    counts = np.rint(steps / typical)
    step = float(steps.sum() / max(counts.sum(), 1))  # stamps may be rounded
    uneven = np.abs(steps / step - counts) > 0.4
    uneven &= steps < 20 * step  # after a pause the clock may have drifted
    if not 0.8 < step / typical < 1.25 or uneven.mean() > MOST_DISORDER:
        text = f"steps of time are no multiples of {typical:.6g} s; expected one rate throughout"
        raise RecordError(f"{place(int(np.argmax(uneven)) + 1)}: {text}")
    index = np.rint((time - time[0]) / step).astype(np.int64)
    samples = int(index[-1]) + 1
    if samples > len(index) / (1 - MOST_MISSING):
        at = int(np.argmax(steps))
        raise RecordError(
            f"{place(at + 1)}: {samples - len(index)} of {samples} samples are "
            f"missing, {steps[at]:.6g} s of them before here; "
            f"expected {100 * (1 - MOST_MISSING):g} % of them; analyse the parts apart"
        )
    lost = int((np.diff(index) == 0).sum())  # index ascends
    return replace(
        bare, rate_hz=round(1 / step, 6), index=index, samples=samples, repeats=bare.repeats + lost
    )


class _Places:
    """File, line and column of a time stamp, for messages."""

    def __init__(self, joined: Joined) -> None:
        self._joined = joined

    def __call__(self, at: int) -> str:
        """Returns the place of the stamp number `at` in order of time."""
        row = int(self._joined.row[at])
        for part in self._joined.parts:
            if row < len(part.lines):
                return part.place(row)
            row -= len(part.lines)
        return ""


def _check_rate(rate: float, place: str, rate_hz: float | None, counted: bool) -> None:
    """Raises RecordError if a rate is not that of a fast hygrometer, with the likely cause.

    Only stamps that are `counted`, and no dates, may be in another unit.
    """
    if rate * 1.001 >= SLOWEST_HZ and rate <= FASTEST_HZ * 1.001:
        return
    guesses = (("ms", 1e3), ("days", 1 / 86400), ("us", 1e6), ("hours", 1 / 3600))
    likely = [name for name, scale in guesses if SLOWEST_HZ <= rate * scale <= FASTEST_HZ]
    told = []
    if rate_hz is not None:
        told = ["is --rate-hz right?"]
    elif counted:
        told = [f"is its time in {likely[0]}?" if likely else "is the unit of its time right?"]
    if rate < SLOWEST_HZ and rate_hz is None:
        told.append("Means over minutes hold no turbulence; the fast data are needed")
    raise RecordError(
        f"{place}: {rate:.6g} samples a second; expected {SLOWEST_HZ:g} to {FASTEST_HZ:g}: "
        f"{'. '.join(told) or 'are its stamps right?'}"
    )


def _check_one_rate(steps: Array, typical: float, place: _Places) -> None:
    """Raises RecordError if the steps of a tenth of the record are not those of the whole."""
    edges = np.linspace(0, len(steps), 11).astype(int)
    for start, stop in pairwise(edges):
        own = float(np.median(steps[start:stop]))
        if not 0.8 < own / typical < 1.25:
            usual = (steps[start:stop] > 0.8 * typical) & (steps[start:stop] < 1.25 * typical)
            wrong = start + int(np.argmax(~usual))
            raise RecordError(
                f"{place(wrong + 1)}: steps of {own:.6g} s from here on, "
                f"{typical:.6g} s elsewhere; expected one rate throughout"
            )
