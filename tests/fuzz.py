"""Mutated scenes, which thzcl must refuse in words or compute: nothing else.

`python tests/fuzz.py --seed 1 --count 5000` tries as many, in one process, and prints what broke;
`test_fuzz.py` tries a seeded few. A scene is a shipped one, some of whose keys have been taken
away, doubled, renamed, moved, or given values that nobody meant.
"""

from __future__ import annotations

import argparse
import copy
import random
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tomli

from thzcl.clock import Clock
from thzcl.errors import explained
from thzcl.pipeline import compute_images, prepare
from thzcl.plan import report
from thzcl.scenario.manual import scenario_schema
from thzcl.scenario.source import SHIPPED, shipped
from thzcl.scenario.text import dumps

LONGEST_S = 60.0
MOST_STEPS = 1e7  # voxels that rays of a mutant cross at most, if it is run
ODD: tuple[Any, ...] = (
    0, -1, 1, 2, 3, 1e-300, 1e300, -1e300, 1e-12, 1e12, 0.0, -0.0, float("nan"), float("inf"),
    -float("inf"), 2**31, 2**63, -(2**63), 10**30, True, False, "", "x", "é", "\x00", "../x",
    "/dev/zero",
    "a" * 300, "air", "sky", "none", "file", "mpm93", "r24", "box", [], [0], [1.0, 2.0], [0, 0, 1],
    [float("nan")] * 3, [[1]], {}, {"x": 1}, {"kind": "box"}, [{}], ["r24", "r24"], [1e9, 1e9, 1e9],
    300, 650.0, 94, 100, 0.5, 90, 1e5, 4096, 1_000_000,
)  # fmt: skip

Path_ = tuple[Any, ...]


def scenes() -> dict[str, dict[str, Any]]:
    """Returns the shipped scenes, made small."""
    found = {}
    for name in shipped():
        data = tomli.loads((SHIPPED / f"{name}.toml").read_text(encoding="utf-8"))
        data["camera"]["pixels"] = [6, 5]
        air = data["atmosphere"].get("fluctuations")
        if air is not None:
            air["grid"] = 16
        if len(data.get("variants", ())) > 1:
            data["variants"] = data["variants"][:2]
        data.get("output", {}).pop("difference", None)
        found[name] = data
    return found


def known_keys() -> list[Path_]:
    """Returns the dotted keys that scenes may have, of every kind of target and sensor."""
    schema = scenario_schema()
    definitions, found = schema["$defs"], []

    def walk(node: Any, path: Path_, depth: int = 0) -> None:
        if depth > 6 or not isinstance(node, dict):
            return
        if "$ref" in node:
            name = node["$ref"].removeprefix("#/$defs/")
            walk(definitions.get(name, {}), path, depth + 1)
        for key, value in node.get("properties", {}).items():
            found.append((*path, key))
            walk(value, (*path, key), depth + 1)
        if isinstance(node.get("additionalProperties"), dict):
            walk(node["additionalProperties"], (*path, "box"), depth + 1)
        for group in ("anyOf", "oneOf", "allOf"):
            for one in node.get(group, ()):
                walk(one.get("then", one), path, depth + 1)

    walk(schema, ())
    return list(dict.fromkeys(found))


def paths(value: Any, path: Path_ = ()) -> Iterator[Path_]:
    """Yields the place of every value in nested tables and lists, but the whole."""
    pairs: Any = ()
    if isinstance(value, dict):
        pairs = value.items()
    elif isinstance(value, list):
        pairs = enumerate(value)
    for key, inner in pairs:
        yield (*path, key)
        yield from paths(inner, (*path, key))


def at(data: Any, path: Path_) -> Any:
    """Returns the value at a place."""
    for key in path:
        data = data[key]
    return data


def put(data: Any, path: Path_, value: Any) -> None:
    """Sets a value; tables on the way are made where there is none."""
    for key in path[:-1]:
        if isinstance(data, dict):
            data = data.setdefault(key, {})
        elif isinstance(data, list) and isinstance(key, int) and key < len(data):
            data = data[key]
        else:
            return
    last = path[-1]
    named = isinstance(data, dict) and isinstance(last, str)
    if named or (isinstance(data, list) and isinstance(last, int) and last < len(data)):
        data[last] = value


class Mutator:
    """Changes scenes at random."""

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)  # noqa: S311 (no secret)
        self._scenes, self._keys = scenes(), known_keys()
        self._ways = (self._odd, self._odd, self._known, self._known, self._lost, self._scaled)
        self._ways += (self._foreign, self._copied, self._renamed)

    def mutant(self) -> tuple[dict[str, Any], str]:
        """Returns a scene with one to four changes, and the name of the shipped one."""
        name = self._rng.choice(list(self._scenes))
        data = copy.deepcopy(self._scenes[name])
        for _ in range(self._rng.choice((1, 1, 1, 2, 3, 4))):
            places = list(paths(data))
            if places:
                self._rng.choice(self._ways)(data, self._rng.choice(places))
        return data, name

    def _odd(self, data: Any, place: Path_) -> None:
        put(data, place, copy.deepcopy(self._rng.choice(ODD)))

    def _known(self, data: Any, place: Path_) -> None:
        del place
        put(data, self._rng.choice(self._keys), copy.deepcopy(self._rng.choice(ODD)))

    def _lost(self, data: Any, place: Path_) -> None:
        holder = at(data, place[:-1])
        if isinstance(holder, dict):
            del holder[place[-1]]
        elif holder:
            holder.pop()

    def _scaled(self, data: Any, place: Path_) -> None:
        if isinstance(at(data, place), int | float):
            put(data, place, at(data, place) * self._rng.choice((-1, 0.1, 10, 1e3, 1e6, 1e-3)))

    def _foreign(self, data: Any, place: Path_) -> None:
        del place
        other = self._scenes[self._rng.choice(list(self._scenes))]
        taken = self._rng.choice(list(paths(other)))
        put(data, taken, copy.deepcopy(at(other, taken)))

    def _copied(self, data: Any, place: Path_) -> None:
        put(data, place, copy.deepcopy(at(data, self._rng.choice(list(paths(data))))))

    def _renamed(self, data: Any, place: Path_) -> None:
        if isinstance(place[-1], str):
            wrong = place[-1] + self._rng.choice(("x", "_k", " ", "é"))
            put(data, (*place[:-1], wrong), at(data, place))


def tried(file: Path, device: Any) -> str:
    """Returns how a scene ended: "refused", "planned" or "ran". Raises what nobody foresaw."""
    try:
        plan = prepare(file, allow_outside=True)
        report.stages(plan, figure=True)
        report.warnings(plan, report.planned_errors(plan))
        steps = sum(spec.segments() for spec in plan.specs()) * plan.realizations
        if device is None or not steps < MOST_STEPS or plan.realizations > 20:
            return "planned"
        result = compute_images(plan, device, Clock(), figure=True)
        result.save(file.with_suffix(".nc"))
        result.summary()
    except Exception as error:
        if explained(error) is None:
            raise
        return f"refused {explained(error)[0]}"
    return "ran"


def search(
    seed: int, count: int, device: Any, seconds: float = 1e9
) -> tuple[Counter[str], list[str]]:
    """Returns how many of `count` mutants ended how, and a report of each that broke."""
    mutator = Mutator(seed)
    ends: Counter[str] = Counter()
    broken: list[str] = []
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for path in SHIPPED.iterdir():
            if path.suffix in (".png", ".npy", ".nc"):
                (Path(folder) / path.name).write_bytes(path.read_bytes())
        for number in range(count):
            if time.monotonic() - begun > seconds:
                break
            data, name = mutator.mutant()
            file = Path(folder) / "mutant.toml"
            try:
                text = dumps(data)
                tomli.loads(text)
            except Exception:  # noqa: BLE001 (not TOML: another test's business)
                ends["no TOML"] += 1
                continue
            file.write_text(text, encoding="utf-8")
            start = time.monotonic()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    ends[tried(file, device)] += 1
            except Exception:  # noqa: BLE001 (what is looked for)
                last = traceback.format_exc().strip().splitlines()
                broken.append(f"--- {number} of {name}\n{text}\n" + "\n".join(last[-9:]))
            if time.monotonic() - start > LONGEST_S:
                broken.append(
                    f"--- {number} of {name} took {time.monotonic() - start:.0f} s\n{text}"
                )
    return ends, broken


def main() -> None:
    """Tries mutants, and prints what broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--plan-only", action="store_true")
    asked = parser.parse_args()
    from thzcl import open_device

    device = None if asked.plan_only else open_device()
    ends, broken = search(asked.seed, asked.count, device)
    print("\n".join(broken))
    print(dict(ends), f"{len(broken)} broken")
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
