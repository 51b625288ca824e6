"""The study itself: every setting of every knob is run, timed and held against its reference.

A study that was interrupted goes on where it ended.
"""

from __future__ import annotations

import csv
import hashlib
import json
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from thzcl.clock import Clock
from thzcl.errors import FileError, ScenarioError
from thzcl.files import CUBE, Kind, digest, read_text, write_whole
from thzcl.results.versions import VERSION
from thzcl.scenario.document import Scenario
from thzcl.scenario.text import load
from thzcl.studies.convergence.knobs import KNOBS, Knob, MeaninglessError, Setting
from thzcl.studies.convergence.subject import Subject, errors

Progress = Callable[[str], None]
_NAMED = CUBE  # files that scenarios name are no larger
_EARLIER = Kind(64_000_000, "give another folder")  # a study of the same name


@dataclass(frozen=True)
class Point:
    """One setting: the time of the stages that its knob touches, and its error.

    Errors are relative to the image's largest contrast. `on_front` says that no other setting of
    the knob is as fast and more accurate, or as accurate and faster.
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
    """Runs what has not been run before; writes FOLDER/<scenario>-convergence.json, .csv and .png.

    Returns what the JSON file holds. Raises ScenarioError for a knob that there is not, OSError for
    files that cannot be written.
    """
    unknown = [name for name in names if name not in KNOBS]
    if unknown:
        raise ScenarioError(
            [f"--knobs: there is no {', '.join(unknown)}; choose among {', '.join(KNOBS)}"]
        )
    path = folder / f"{subject.plan.scenario.name}-convergence.json"
    record: dict[str, Any] = {
        "scenario": subject.plan.scenario.name,
        "identity": _identity(subject, repeat),
        "device": subject.device.info.description,
        "machine": platform.machine(),
        "seed": subject.plan.scenario.seed,
        "repeat": repeat,
        "thzcl": VERSION,
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
    record |= {"points": [asdict(p) for p in front(wanted)], "left_out": left_out}
    record["default_over_front"] = default_over_front(wanted)
    return record | {"files": _outputs(path, record, points)}


def _measure(knob: Knob, setting: Setting, repeat: int) -> Point:
    """Returns a setting's error by a first run, which warms up, and its time by more of them."""
    rms, most = errors(setting.run(Clock()), knob.reference())
    times = []
    for _ in range(repeat):
        clock = Clock()
        setting.run(clock)
        times.append(sum(clock.seconds.get(stage, 0.0) for stage in knob.stages))
    return Point(knob.name, setting.name, setting.default, median(times), rms, most)


def front(points: Sequence[Point]) -> list[Point]:
    """Returns the points, with those marked that no other of their knob is better than."""

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
    """Returns by knob the default's time over that of the fastest setting that is as accurate.

    Errors are alike if they differ by a tenth at most, or are within float32's rounding.
    """
    ratios = {}
    for own in (point for point in points if point.default):
        bearable = max(1.1 * own.error_rms, 2e-7)
        fastest = min(p.seconds for p in points if p.knob == own.knob and p.error_rms <= bearable)
        ratios[own.knob] = own.seconds / fastest if fastest > 0 else 1.0
    return ratios


def _identity(subject: Subject, repeat: int) -> str:
    """Returns a key that is equal for studies whose points can stand together."""
    scenario = subject.plan.scenario
    parts = [
        scenario.text,
        [digest(path, _NAMED) for path in _files(load(scenario.text, scenario.name), scenario)],
        sorted(subject.settings.items()),
        list(subject.variants),
        subject.device.info.description,
        repeat,
        VERSION,
    ]
    return hashlib.sha256(json.dumps(parts, default=str).encode()).hexdigest()[:16]


def _files(value: Any, scenario: Scenario) -> Iterator[Path]:
    """Yields the files that a scenario's data name, in the order of the data."""
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _files(part, scenario)
    elif isinstance(value, str):
        with suppress(OSError, ValueError):  # a text that is no name of a file
            path = scenario.folder / value
            if path.is_file():
                yield path


def _known(path: Path, identity: Any) -> list[Point]:
    """Returns the points of an earlier study of the same, finished or not."""
    try:
        record = json.loads(read_text(path, _EARLIER))
        same = record["identity"] == identity
        return [Point(**point) for point in record["points"]] if same else []
    except (FileError, ValueError, KeyError, TypeError, RecursionError):
        return []


def _write(path: Path, record: dict[str, Any]) -> None:
    write_whole(
        path, lambda part: part.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    )


def _outputs(path: Path, record: dict[str, Any], points: Sequence[Point]) -> list[str]:
    """Writes all points, those of knobs not asked for this time too; returns the files' names."""
    from thzcl.studies.convergence.figure import picture

    _write(path, record | {"points": [asdict(point) for point in front(points)]})
    rows = record["points"]

    def write_csv(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]) if rows else ["knob"])
            writer.writeheader()
            writer.writerows(rows)

    write_whole(path.with_suffix(".csv"), write_csv)
    write_whole(path.with_suffix(".png"), lambda part: picture(record, part))
    return [str(path.with_suffix(suffix)) for suffix in (".json", ".csv", ".png")]
