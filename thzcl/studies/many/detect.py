"""How well targets are detected at each point of a study's grid, over the airs of its seeds.

The airs are those of the members, each seen with and without the target, half to learn and half to
test, as `thzcl range` does it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from typing import Any

from thzcl.clock import Progress
from thzcl.device.opencl import Device
from thzcl.errors import DeviceError, ThzclError, UsageError
from thzcl.scenario import document as documents
from thzcl.studies.detection import intervals
from thzcl.studies.detection.observer import HOTELLING
from thzcl.studies.detection.ranges import Question, computed_together
from thzcl.studies.detection.scenes import Base
from thzcl.studies.many.members import Member, Study
from thzcl.studies.many.store import Store

FALSE_ALARM = 0.01  # for the tail alone; d' and area do not depend on it


def refuse(study: Study) -> None:
    """Raises UsageError if targets cannot be detected over a study's seeds."""
    if not study.detect:
        return
    if (study.seeds or 0) < intervals.FEWEST_AIRS:
        text = f"needs at least {intervals.FEWEST_AIRS} seeds: half of the airs learn, half test"
        raise UsageError(f"[study] detect: {text}")
    scenes = documents.by_variant(study.document).values()
    known = {target for data in scenes for target in data.get("targets", {})}
    unknown = next((name for name in study.detect if name not in known), None)
    if unknown is not None:
        raise UsageError(f"[study] detect: {unknown}: no such target ({', '.join(sorted(known))})")


def detect(study: Study, store: Store, device: Device, progress: Progress | None) -> None:
    """Writes a file of d' and area for each point of the grid that has none. Raises OSError."""
    for number, settings in enumerate(study.points if study.detect else ()):
        name = _name(study, number)
        if store.detected(name) is not None:
            continue
        if progress is not None:
            progress(f"detection at {number + 1} of {len(study.points)} points")
        member = Member(number, settings, None)
        found: dict[str, Any] = {"point": number, "state": "done", "message": "", "rows": []}
        try:
            found["rows"] = list(_rows(study, member, device))
        except (ThzclError, ValueError, MemoryError) as error:
            if isinstance(error, DeviceError):
                raise
            found |= {"state": "failed", "message": str(error)}
        store.write_detection(name, found)


def _name(study: Study, number: int) -> str:
    what = json.dumps([study.name(Member(number, study.points[number], None)), study.seeds])
    return f"{number:05d}-{hashlib.sha256(what.encode()).hexdigest()[:16]}"


def names(study: Study) -> list[str]:
    """Returns the names of the files by the number of the grid's point."""
    return [_name(study, number) for number in range(len(study.points))] if study.detect else []


def _rows(study: Study, member: Member, device: Device) -> Iterator[dict[str, Any]]:
    """Yields d' and area, with their intervals, by variant, target and model."""
    document = study.scene(member)
    for variant, data in documents.by_variant(document).items():
        if study.variants and variant not in study.variants:
            continue
        for target in study.detect:
            if target not in data.get("targets", {}):
                continue
            chosen = (variant,) if variant else ()
            base = Base.of(document, chosen, target, study.allow_outside, moves=False)
            airs = study.seeds or 0
            asked = Question(base, (0.0,), (None,), 0.5, FALSE_ALARM, airs, study.seed, HOTELLING)
            often = intervals.counts(airs - airs // 2, study.seed)
            ((_, samples),) = computed_together(asked, [0.0], device)
            for one in samples:
                found = intervals.detect(
                    one.null, one.present, FALSE_ALARM, one.tail, often, one.sign
                )
                yield {
                    "variant": variant or document.name,
                    "target": target,
                    "model": one.model,
                    "d_prime": found.d_prime.value,
                    "d_prime_low": found.d_prime.low,
                    "d_prime_high": found.d_prime.high,
                    "area": found.area.value,
                    "area_low": found.area.low,
                    "area_high": found.area.high,
                }
