"""The study itself: every setting of every knob, run, timed and held against its reference.

Interrupted, it goes on later.
"""

from __future__ import annotations

import csv
import hashlib
import json
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import thzcl
from thzcl.clock import Clock
from thzcl.files import write_whole
from thzcl.errors import ScenarioError
from thzcl.studies.convergence.knobs import KNOBS, Knob, MeaninglessError, Setting
from thzcl.studies.convergence.subject import Subject, errors

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Point:
    """One setting: the time of the stages that its knob touches, and its error relative to the image's largest contrast.

    `on_front`: no other setting of the knob is as fast and more accurate, or as accurate and faster.
    """

    knob: str
    setting: str
    default: bool
    seconds: float
    error_rms: float
    error_max: float
    on_front: bool = False


def study(
    subject: Subject, folder: Path, names: Sequence[str], repeat: int, progress: Progress
) -> dict[str, Any]:
    """Runs what has not been run before, and writes FOLDER/<scenario>-convergence.json, .csv and .png.

    Returns what the JSON file holds. Raises ScenarioError for a knob that there is not, OSError.
    """
    unknown = [name for name in names if name not in KNOBS]
    if unknown:
        raise ScenarioError(
            [f"--knobs: there is no {', '.join(unknown)}; choose among {', '.join(KNOBS)}"]
        )
    path = folder / f"{subject.plan.scenario.name}-convergence.json"
    record = {
        "scenario": subject.plan.scenario.name,
        "identity": _identity(subject, repeat),
        "device": f"{subject.device.info.name} ({subject.device.info.driver})",
        "machine": platform.machine(),
        "repeat": repeat,
        "thzcl": thzcl.__version__,
    }
    points, left_out = _known(path, record["identity"]), []
    for name in names or KNOBS:
        try:
            knob = KNOBS[name](subject)
        except MeaninglessError as reason:
            left_out.append({"knob": name, "reason": str(reason)})
            continue
        for number, setting in enumerate(knob.settings, 1):
            if not any(p.knob == name and p.setting == setting.name for p in points):
                progress(f"{name} {number} of {len(knob.settings)}: {setting.name}")
                points.append(_measure(knob, setting, repeat))
                _write(path, record | {"points": [asdict(p) for p in points]})
    wanted = [p for p in points if p.knob in (names or KNOBS)]
    found = record | {"points": [asdict(p) for p in front(wanted)], "left_out": left_out}
    found["default_over_front"] = default_over_front(wanted)
    return found | {"files": _outputs(path, found, points)}


def _measure(knob: Knob, setting: Setting, repeat: int) -> Point:
    """The first run warms up, and gives the image."""
    rms, most = errors(setting.run(Clock()), knob.reference())
    times = []
    for _ in range(repeat):
        clock = Clock()
        setting.run(clock)
        times.append(sum(clock.seconds.get(stage, 0.0) for stage in knob.stages))
    return Point(knob.name, setting.name, setting.default, median(times), rms, most)


def front(points: Sequence[Point]) -> list[Point]:
    """The points with those marked that no other of their knob is better than."""

    def beaten(point: Point) -> bool:
        return any(
            other.knob == point.knob
            and other.seconds <= point.seconds
            and other.error_rms <= point.error_rms
            and (other.seconds, other.error_rms) != (point.seconds, point.error_rms)
            for other in points
        )

    return [replace(point, on_front=not beaten(point)) for point in points]


def default_over_front(points: Sequence[Point]) -> dict[str, float]:
    """By knob, the default's time over that of the fastest setting that is as accurate.

    To a tenth or rounding.
    """
    found = {}
    for own in (point for point in points if point.default):
        bearable = max(1.1 * own.error_rms, 2e-7)
        fastest = min(p.seconds for p in points if p.knob == own.knob and p.error_rms <= bearable)
        found[own.knob] = own.seconds / fastest if fastest > 0 else 1.0
    return found


def _identity(subject: Subject, repeat: int) -> str:
    """Equal for studies whose points can stand together."""
    scenario = subject.plan.scenario
    told = [
        scenario.text,
        sorted(subject.settings.items()),
        list(subject.variants),
        subject.device.info.name,
        repeat,
        thzcl.__version__,
    ]
    return hashlib.sha256(json.dumps(told, default=str).encode()).hexdigest()[:16]


def _known(path: Path, identity: Any) -> list[Point]:
    """Points of an earlier study of the same, finished or not."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return (
            [Point(**point) for point in record["points"]] if record["identity"] == identity else []
        )
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _write(path: Path, record: dict[str, Any]) -> None:
    write_whole(
        path, lambda part: part.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    )


def _outputs(path: Path, found: dict[str, Any], points: Sequence[Point]) -> list[str]:
    """Writes all that is to be kept; points of knobs not asked for this time too."""
    from thzcl.studies.convergence.figure import picture

    _write(path, found | {"points": [asdict(point) for point in front(points)]})
    rows = found["points"]

    def write_csv(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else ["knob"])
            writer.writeheader()
            writer.writerows(rows)

    write_whole(path.with_suffix(".csv"), write_csv)
    write_whole(path.with_suffix(".png"), lambda part: picture(found, part))
    return [str(path.with_suffix(suffix)) for suffix in (".json", ".csv", ".png")]
