"""Seconds spent in each stage, and word of it to whoever watches."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

Progress = Callable[[str], None]


@dataclass
class Clock:
    """Adds up wall time by stage; stages do not nest."""

    progress: Progress | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    _prefix: str = ""

    def counted(self, number: int, of: int) -> None:
        """Says how far a long piece of work has come: before every stage.

        `number` of `of` is shown from now on.
        """
        filled = round(20 * number / of)
        self._prefix = f"[{'#' * filled}{'.' * (20 - filled)}] {number} of {of}: "

    @contextmanager
    def stage(self, stage: str) -> Iterator[None]:
        """Times what happens within."""
        if self.progress:
            self.progress(self._prefix + stage)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
