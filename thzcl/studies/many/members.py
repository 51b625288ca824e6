"""The members of a study: their numbers, settings and seeds, and the scenes that these make.

Members are counted seed by seed, and within a seed along the grid: the air of one seed serves all
of its members, and more seeds leave the numbers of those before them as they were.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from thzcl.errors import ScenarioError, UsageError
from thzcl.plan import checks
from thzcl.plan.plan import Plan, make_plan
from thzcl.plugins.names import suggest
from thzcl.scenario import document as documents
from thzcl.scenario.document import Document, Scenario
from thzcl.scenario.problems import validate
from thzcl.scenario.scene import StudyTable
from thzcl.scenario.text import dumps
from thzcl.studies.many import grid as grids
from thzcl.studies.many import placing
from thzcl.studies.many.grid import Axis

SEED = "atmosphere.fluctuations.seed"
NOISE_SEED = "numerics.noise_seed"
TOGETHER = 16  # members whose graphs are joined, at most


@dataclass(frozen=True)
class Member:
    """One scene of a study: its number, what is set, and the seed of its air and noise.

    `seed` is None where members have the scene's own.
    """

    number: int
    settings: Mapping[str, Any]
    seed: int | None


@dataclass(frozen=True)
class Study:
    """What a study computes; it can be pickled, and is the same on every machine.

    `document` is the scene as it stands, with the command line's settings; `seed` that of the
    study, from which those of its members follow.
    """

    document: Document
    variants: tuple[str, ...]
    axes: tuple[Axis, ...]
    seeds: int | None
    seed: int
    keep: str = "numbers"
    keep_pixels: bool = False
    allow_outside: bool = False
    detect: tuple[str, ...] = ()
    points: tuple[dict[str, Any], ...] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", tuple(grids.points(self.axes)))

    @property
    def count(self) -> int:
        """Returns the number of members."""
        return len(self.points) * (self.seeds or 1)

    @property
    def keys(self) -> tuple[str, ...]:
        """Returns the keys that are varied."""
        return tuple(key for axis in self.axes for key in axis.keys if key != grids.VARIANT)

    def member(self, number: int) -> Member:
        """Returns a member by its number."""
        air, point = divmod(number, len(self.points))
        seed = None if self.seeds is None else spawned(self.seed, air)
        return Member(number, self.points[point], seed)

    def groups(self) -> Iterator[range]:
        """Yields the numbers of members that are planned together: of one seed, few enough."""
        for air in range(self.seeds or 1):
            first = air * len(self.points)
            for start in range(0, len(self.points), TOGETHER):
                yield range(first + start, first + min(start + TOGETHER, len(self.points)))

    @cached_property
    def identity(self) -> dict[str, Any]:
        """Returns what tells this study from any other; more seeds leave it the same."""
        return {
            "scenario": self.document.name,
            "scenario_toml": dumps(self.document.data),
            "variants": list(self.variants),
            "over": [
                [list(axis.keys), [list(point) for point in axis.points]] for axis in self.axes
            ],
            "seeded": self.seeds is not None,
            "seed": self.seed,
            "keep": self.keep,
            "keep_pixels": self.keep_pixels,
            "detect": list(self.detect),
        }

    def name(self, member: Member) -> str:
        """Returns the name of a member's file: its number, and a hash of all that it depends on."""
        text = json.dumps([dict(member.settings), member.seed], sort_keys=True, default=str)
        whole = hashlib.sha256((self._common + text).encode()).hexdigest()
        return f"{member.number:05d}-{whole[:16]}"

    @cached_property
    def _common(self) -> str:
        """Returns what all members depend on, as text."""
        return json.dumps(
            self.identity | {"over": None, "detect": None}, sort_keys=True, default=str
        )

    def scene(self, member: Member) -> Document:
        """Returns the document of a member. Raises ScenarioError."""
        document = self.set_to(member.settings)
        document.data.pop("study", None)
        moved = self._moved(document, member)
        if "" in moved:
            document = documents.changed(document, moved.pop(""), {})
        return documents.changed(document, {}, moved)

    def set_to(self, settings: Mapping[str, Any]) -> Document:
        """Returns the scene at some settings, but for the places of targets."""
        document = self.document
        if grids.VARIANT in settings:
            document = documents.alone(document, settings[grids.VARIANT])
        keys = [key for key in settings if placing.named(key) is None and key != grids.VARIANT]
        return documents.changed(document, {key: settings[key] for key in keys}, {})

    def _moved(self, document: Document, member: Member) -> dict[str, dict[str, Any]]:
        """Returns the keys that each variant of a member's scene has of its own: place and seed.

        Those of a scene without variants are named "".
        """
        ranges = {placing.named(key): value for key, value in member.settings.items()}
        found: dict[str, dict[str, Any]] = {}
        for variant, data in documents.by_variant(document).items():
            own = found.setdefault(variant, {})
            for name, range_m in ranges.items():
                if name is not None:
                    own |= _placed(data, name, range_m, self.keep_pixels)
            if member.seed is not None:
                own |= seeded(data, member.seed)
        return found

    def plan(self, member: Member) -> Plan:
        """Returns the plan of a member. Raises ScenarioError, or PluginFailure."""
        document = self.scene(member)
        try:
            plan = make_plan(self.parsed(document, member.settings))
            checks.together(document, plan)
        except ScenarioError as error:
            raise ScenarioError([_by_over(line) for line in error.problems]) from None
        return plan

    def parsed(self, document: Document, settings: Mapping[str, Any]) -> Scenario:
        """Returns the scenes of a member's document. Raises ScenarioError."""
        one = settings.get(grids.VARIANT)
        variants = self.variants if one is None else (one,)
        scenario = documents.parse(document, variants, allow_outside=self.allow_outside)
        if any(v.scene.numerics.realizations > 1 for v in scenario.variants):
            text = "realizations is refused in a study: give seeds, each of which is one"
            raise ScenarioError([f"{document.label}: [numerics] {text}"])
        if any(v.scene.sequence is not None for v in scenario.variants):
            raise ScenarioError([f"{document.label}: [sequence] is refused in a study"])
        return scenario


def _by_over(line: str) -> str:
    return "--over" + line.removeprefix("--set") if line.startswith("--set") else line


def spawned(seed: int, number: int) -> int:
    """Returns the seed of one air of many: it depends on the number alone, and not on how many."""
    child = np.random.SeedSequence(seed, spawn_key=(number,))
    return int(child.generate_state(1, np.uint64)[0] >> np.uint64(1))


def seeded(data: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Returns the keys that give a scene's air and noise a seed."""
    found = {NOISE_SEED: seed}
    flow = data.get("atmosphere", {}).get("fluctuations")
    if isinstance(flow, Mapping) and flow.get("spectrum") != "file":
        found[SEED] = seed
    return found


def _placed(data: Mapping[str, Any], name: str, range_m: Any, keep: bool) -> dict[str, Any]:
    """Returns the keys that put a target at a range. Raises ScenarioError if that cannot be."""
    place = f"--over targets.{name}.range_m"
    targets = data.get("targets", {})
    if name not in targets:
        raise ScenarioError([f"{place}: no such target ({suggest(name, targets)})"])
    if isinstance(range_m, bool) or not isinstance(range_m, int | float):
        raise ScenarioError([f"{place}: must be a number of metres, not {range_m!r}"])
    try:
        return placing.at_range(data["camera"], targets[name], name, float(range_m), keep)
    except ValueError as error:
        raise ScenarioError([f"{place}: {error}"]) from None


def refuse_unknown(study: Study, given_by: str) -> None:
    """Raises an error for a key that no scene has, and for a scene of which no member can be made.

    A member that cannot be made is another matter: it is marked, and the study goes on.
    """
    known = _problems(study, {}) if study.keys else ()
    for key in study.keys:
        name = placing.named(key)
        if name is not None:
            variants = documents.by_variant(study.document).values()
            targets = {target for data in variants for target in data.get("targets", {})}
            if name not in targets:
                text = f"no such target ({suggest(name, targets)})"
                raise UsageError(f"{given_by} {key}: {text}")
            continue
        first = next(point[key] for point in study.points)
        unknown = [
            line
            for line in _problems(study, {key: first})
            if line not in known and "unknown key" in line
        ]
        if unknown:
            raise UsageError(unknown[0].replace("--set", given_by, 1))
    if known or not study.keys:
        first_problems = _problems(study, study.member(0).settings)
        if first_problems:
            raise ScenarioError(first_problems)


def _problems(study: Study, settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Returns what is wrong with the scene at some settings."""
    try:
        study.parsed(study.set_to(settings), settings)
    except ScenarioError as error:
        return error.problems
    return ()


def table_of(document: Document) -> StudyTable | None:
    """Returns the [study] table of a scene, or None. Raises ScenarioError if it is not sound."""
    data = document.data.get("study")
    if data is None:
        return None
    table, troubles = validate(StudyTable, documents.frozen(data))
    if troubles:
        raise ScenarioError(document.problems([one.below("study") for one in troubles]))
    return table
