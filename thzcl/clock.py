"""Seconds spent in each stage, and word of it to whoever watches."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Progress = Callable[[str], None]


@dataclass
class Clock:
    """Adds up wall time by stage; time within a stage that another stage takes is the other's."""

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    _prefix: str = ""
    _spent: float = 0.0  # in all stages that have ended

    def counted(self, number: int, of: int) -> None:
        """Puts a bar with `number` of `of` before every stage that is told from now on."""
        filled = round(20 * number / of)
        self._prefix = f"[{'#' * filled}{'.' * (20 - filled)}] {number} of {of}: "

    @contextmanager
    def stage(self, stage: str) -> Iterator[None]:
        """Times what happens within, less what stages within that take."""
        if self.progress:
            self.progress(self._prefix + stage)
        start, before = time.perf_counter(), self._spent
        try:
            yield
        finally:
            own = time.perf_counter() - start - (self._spent - before)
            self.seconds[stage] = self.seconds.get(stage, 0.0) + own
            self._spent += own
