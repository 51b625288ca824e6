"""Computes members of a study on one device: those of a group share what their specs share."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.errors import DeviceError, ThzclError
from thzcl.graph import evaluate
from thzcl.plan import checks
from thzcl.plan.plan import Plan, join
from thzcl.results.result import Result
from thzcl.results.rows import rows
from thzcl.studies.many.members import Member, Study
from thzcl.studies.many.placing import named

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

DONE, BAD, KILLED = "done", "failed", "killed"
Record = dict[str, Any]


@dataclass(frozen=True)
class Task:
    """Members of one group that are computed by one process, one after the other."""

    group: range
    wanted: tuple[int, ...]


def members(
    study: Study, group: Iterable[int], wanted: Iterable[int], folder: Path, device: Device
) -> Iterator[Record]:
    """Yields the record of each wanted member of a group, as it is computed.

    All members of the group are planned and joined, whichever are wanted, so that numbers do not
    depend on what had been computed before. A member that cannot be made has the state "failed" and
    a message. Images are written to the folder if the study keeps them. Raises DeviceError and
    OSError, after which nothing more can be computed.
    """
    plans: dict[int, Plan] = {}
    failures: dict[int, str] = {}
    spent: dict[int, float] = {}
    chosen = {number: study.member(number) for number in group}
    for number, member in chosen.items():
        start = time.perf_counter()
        try:
            plans[number] = study.plan(member)
            checks.memory(plans[number], device)
        except (ThzclError, MemoryError) as error:
            _stop(error)
            plans.pop(number, None)
            failures[number] = str(error)
        spent[number] = time.perf_counter() - start
    plans = dict(zip(plans, join(plans.values()), strict=True))
    wanted = set(wanted)
    for number in sorted(wanted & failures.keys()):
        yield record(chosen[number], BAD, failures[number], spent[number])
    left = {number: plan for number, plan in plans.items() if number in wanted}
    while left:  # again after each failure, which ends an evaluation
        for found in _evaluated(study, chosen, left, folder, device):
            found["seconds"] += spent[found["member"]]
            del left[found["member"]]
            yield found


def _evaluated(
    study: Study, chosen: dict[int, Member], plans: dict[int, Plan], folder: Path, device: Device
) -> Iterator[Record]:
    """Yields the records of planned members, up to the first that fails, and its own."""
    batches = evaluate((plan.batch() for plan in tuple(plans.values())), device)
    for number, plan in list(plans.items()):
        start = time.perf_counter()
        try:
            result = pipeline.images_of(plan, batches, device, Clock())
            found = _shown(chosen[number], plan, result)
        except (ThzclError, MemoryError) as error:
            _stop(error)
            yield record(chosen[number], BAD, str(error), time.perf_counter() - start)
            return
        if study.keep == "images" and found["state"] == DONE:
            result.save(folder / f"{study.name(chosen[number])}.nc")
        found["seconds"] = time.perf_counter() - start
        yield found


def _stop(error: BaseException) -> None:
    """Raises an error again after which no other member can be computed either."""
    if isinstance(error, DeviceError):
        raise error


def _shown(member: Member, plan: Plan, result: Result) -> Record:
    """Returns the record of a member that was computed; a target that was placed must show."""
    found = rows(result, plan.variants[0].scene.atmosphere.model)
    for key in member.settings:
        target = named(key)
        for variant in result.variants if target else ():
            if not any(row["target"] == target and row["variant"] == variant.name for row in found):
                text = f"{target} is not in the picture: something hides it, or it is too small"
                remedy = "move what stands before it, or raise camera.samples_per_pixel"
                return record(member, BAD, f"--over {key}: {text}; {remedy}", 0.0)
    kept = [{name: _finite(value) for name, value in row.items()} for row in found]
    return record(member, DONE, "", 0.0) | {"rows": kept, "warnings": list(result.warnings)}


def record(member: Member, state: str, message: str, seconds: float) -> Record:
    """Returns what is stored of a member, without rows of numbers."""
    return {
        "member": member.number,
        "settings": dict(member.settings),
        "seed": member.seed,
        "state": state,
        "seconds": seconds,
        "message": message,
        "rows": [],
        "warnings": [],
    }


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
