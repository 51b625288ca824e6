"""Medians of things timed in turn, so that a machine that slows down slows all of them."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

from thzcl.clock import Clock
from thzcl.pipeline import compute_images


class Record(NamedTuple):
    """One claim: what was measured, and what it must not pass.

    `at_least` where it must reach the bound instead.
    """

    name: str
    measured: float | None  # None where it could not be measured; `note` says why
    bound: float
    unit: str
    at_least: bool = False
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the claim holds; None where that is not known."""
        if self.measured is None:
            return None
        return self.measured >= self.bound if self.at_least else self.measured <= self.bound

    def as_json(self) -> dict:
        """As written to the records."""
        return self._asdict() | {"met": self.met}


def alternate(calls: Mapping[str, Callable[[], float | None]], repeat: int) -> dict[str, float]:
    """Median seconds of each call, in turn, after a turn to warm up.

    What a call returns counts in place of its wall time.
    """
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeat + 1):
        for name, call in calls.items():
            start = time.perf_counter()
            own = call()
            seconds = time.perf_counter() - start if own is None else own
            if turn:
                taken[name].append(seconds)
    return {name: statistics.median(times) for name, times in taken.items()}


def stages(plan, device, *names: str) -> Callable[[], float]:
    """A call that runs a plan and gives the seconds of some of its stages.

    Or of the whole if none are named.
    """

    def call() -> float:
        clock, start = Clock(), time.perf_counter()
        compute_images(plan, device, clock)
        whole = time.perf_counter() - start
        return sum(clock.seconds.get(name, 0.0) for name in names) if names else whole

    return call


def tell(text: str) -> None:
    """Progress, on a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr)
