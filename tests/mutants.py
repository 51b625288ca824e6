"""Mutants: runs with a remedy taken out, and what the stress cases must then show."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest

from thzcl.air import expansion
from thzcl.studies.stress import judges
from thzcl.studies.stress.cases import EVERYTHING, FLUCTUATIONS, ROUNDED, WALL, WARM, cases
from thzcl.studies.stress.trial import SINGLE, Case, examine
from thzcl.surfaces import sky

CASES = {case.name: case for case in cases()}

# Nothing is extreme here: a naive form does as well as the remedy, or it is more than naive.
# Between them these scenes run all that mutants touch.
QUIET_BAND = {
    "sensor": {"kind": "passive-broadband", "center_ghz": 680.0, "bandwidth_ghz": 10.0},
    f"{FLUCTUATIONS}.sigma_percent": 0.0,
}
ECHOES = {
    "sensor": {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 60.0},
    "targets.wall": WALL | {"reflectivity": 1.0},
}
ORDINARY = [
    Case("ordinary air", {"background.temperature_k": 350.0}, EVERYTHING),
    Case("ordinary air of two temperatures", {f"{FLUCTUATIONS}.temperature_sigma_k": 1.0}, WARM),
    Case(
        "ordinary band",
        QUIET_BAND,
        {
            "transmission": (judges.band_transmission, {SINGLE: 1e-5}),
            "contrast": (judges.band_contrast, {SINGLE: 1e-5}),
            "depth": (judges.band_depth, ROUNDED),
        },
    ),
    Case("ordinary echoes", ECHOES, {"decibels": (judges.decibels, ROUNDED)}),
]
NOT_FINITE = (math.inf, math.inf)


def bounded(case, precision, *wanted):
    """Returns a case in one precision, for the judges wanted or for all.

    No error budget is made, which may stumble over what a mutant does before a judge sees it.
    """
    kept = {
        name: (judge, {precision: bounds[precision]})
        for name, (judge, bounds) in case.judges.items()
        if precision in bounds and (not wanted or name in wanted)
    }
    assert kept, f"{case.name} has no bound for {wanted} in {precision}"
    return replace(case, changes={**case.changes, "numerics.error_budget": False}, judges=kept)


@dataclass(frozen=True)
class Shows:
    """Cases that a judge finds wrong, by an error within `span`."""

    judge: str
    span: tuple[float, float]
    cases: list[str]
    precision: str = SINGLE

    def check(self):
        """Asserts that each case is wrong by what it should be wrong by."""
        least, most = self.span
        chosen = [bounded(CASES[name], self.precision, self.judge) for name in self.cases]
        for outcome in examine(chosen):
            assert not outcome.passed, f"{outcome.name} passes without its remedy"
            assert least <= outcome.error <= most, f"{outcome.name}: off by {outcome.error:.1e}"


@dataclass(frozen=True)
class Raises:
    """Cases whose run ends in an error of some kind and words, in float32."""

    error: type[Exception]
    words: str
    cases: list[str]

    def check(self):
        """Asserts that each case ends in the error."""
        for name in self.cases:
            with pytest.raises(self.error, match=self.words):
                list(examine([bounded(CASES[name], SINGLE)]))


@dataclass(frozen=True)
class Remedy:
    """How to run without a remedy, and all that then goes wrong."""

    without: Callable[[], AbstractContextManager[None]]
    failures: list[Shows | Raises]

    def check(self):
        """Asserts that ordinary scenes do without the remedy, and that its cases do not."""
        with self.without():
            for outcome in examine(bounded(case, SINGLE) for case in ORDINARY):
                told = f"{outcome.name}: off by {outcome.error:.1e}"
                assert outcome.passed, f"{told}; the mutant is broken, not naive"
            for failure in self.failures:
                failure.check()


@contextmanager
def _kernels(file, *replaced):
    """Runs with kernels whose source has naive forms in place of remedies; blanks do not count."""
    read = Path.read_text

    def mutilated(path, *arguments, **options):
        text = read(path, *arguments, **options)
        for remedy, naive in replaced if path.name == file else ():
            pattern = r"\s*".join(map(re.escape, remedy.split()))
            text, count = re.subn(pattern, lambda _, naive=naive: naive, text)
            assert count, f"{file} no longer holds {remedy}"
        return text

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "read_text", mutilated)
        yield


@contextmanager
def _python(module, name, naive):
    """Runs with something naive in a module's place; what is kept does not serve both sides."""
    expansion._fitted.cache_clear()  # noqa: SLF001 (nobody else has a reason to)
    sky._around.cache_clear()  # noqa: SLF001 (the same)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, name, naive)
        yield
    sky._around.cache_clear()  # noqa: SLF001 (the same)
    expansion._fitted.cache_clear()  # noqa: SLF001


def kernels(file, *replaced):
    return partial(_kernels, file, *replaced)


def python(module, name, naive):
    return partial(_python, module, name, naive)
