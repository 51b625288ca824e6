"""From a TOML file to a Scenario: reading, settings from the command line, variants.

And the line where a key stands.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli

from thzcl.files import inside
from thzcl.scenario import toml
from thzcl.scenario.problems import Path as KeyPath
from thzcl.scenario.problems import ScenarioError, Trouble, shown, suggest, validate
from thzcl.scenario.scene import Scene
from thzcl.scenario.table import Table, key

SHIPPED = Path(__file__).parents[1] / "scenarios"
if not SHIPPED.is_dir():  # straight from a checkout
    SHIPPED = Path(__file__).parents[2] / "scenarios"
LARGEST_FILE = 4_000_000  # bytes

SensorTroubles = Callable[[Mapping[str, Any]], list[Trouble]]


@dataclass(frozen=True)
class Variant:
    """One image of a scenario: its name and its scene."""

    name: str
    scene: Scene


@dataclass(frozen=True)
class Scenario:
    """A scenario as it will run: its variants, in order, and the TOML text that repeats it."""

    name: str
    folder: Path  # that relative paths in it start from
    text: str
    variants: tuple[Variant, ...]
    allow_outside: bool = False  # whether its pictures and tables may lie outside the folder

    def locate(self, name: str) -> Path:
        """The picture or table of that name. Raises ValueError for one outside the folder.

        Unless allowed.
        """
        return inside(self.folder, name, allow_outside=self.allow_outside)

    @property
    def seed(self) -> int:
        """The seed of its random numbers; 0 where no fluctuations name one."""
        fluctuations = self.variants[0].scene.atmosphere.fluctuations
        return (fluctuations.seed or 0) if fluctuations else 0


class VariantTable(Table):
    """An entry of [[variants]]."""

    name: str = key(min_length=1, help="name of the variant")
    set: dict[str, Any] = key(
        {}, help='keys to change, as in { "targets.box.temperature_k" = 263 }'
    )


@dataclass(frozen=True)
class Document:
    """The text of a scenario with its data, before anything is checked."""

    name: str
    label: str  # what messages call it
    folder: Path
    data: dict[str, Any]
    lines: Mapping[KeyPath, int]
    settings: frozenset[KeyPath]  # keys that came from --set

    def problem(self, trouble: Trouble) -> str:
        """A trouble in one line: file, line, table, key, text."""
        path = trouble.path
        # A key belongs to the innermost table named in the file; the rest of the path is the key.
        tables = [
            path[:n] for n in range(len(path) + 1) if isinstance(_at(self.data, path[:n]), Mapping)
        ]
        table = max(tables, key=len, default=())
        if table == path and path and not trouble.text.startswith(("needs", "missing")):
            table = path[:-1]
        place = self.label
        if any(path[: len(setting)] == setting for setting in self.settings):
            place = "--set"
        elif line := self._line(path):
            place += f":{line}"
        parts = [place + ":"]
        if table:
            parts.append(f"[{'.'.join(map(str, table))}]")
        name = ".".join(map(str, path[len(table) :]))
        return " ".join([*parts, *([name + ":"] if name else []), trouble.text])

    def problems(self, troubles: Iterable[Trouble]) -> list[str]:
        """Troubles in lines, in the order of the file."""
        return [
            self.problem(trouble)
            for trouble in sorted(troubles, key=lambda trouble: self._line(trouble.path))
        ]

    def _line(self, path: KeyPath) -> int:
        """Where a key, or else the table that lacks it, stands; 0 if nowhere."""
        return next(
            (self.lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.lines), 0
        )


def read(source: str | Path, settings: Mapping[str, Any] | None = None) -> Document:
    """Reads a scenario: a path to TOML or to a result, or the bare name of a shipped scene.

    `settings` maps dotted keys to values. Raises ScenarioError if there is no such file or it is
    not TOML.
    """
    path = find(source)
    text, folder = _text(path)
    try:
        data = tomli.loads(text)
    except tomli.TOMLDecodeError as error:
        place = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        where = f"{path}:{place[1]}" if place else str(path)
        reason = re.sub(r" \(at .*\)$", "", str(error))
        hint = f" in column {place[2]}" if place else ""
        raise ScenarioError([f"{where}: not valid TOML{hint}: {reason}; mend it there"]) from None
    troubles = [
        f"--set {name}: {problem}"
        for name, value in (settings or {}).items()
        if (problem := _set(data, name, value))
    ]
    if troubles:
        raise ScenarioError(troubles)
    changed = frozenset(_split(name) for name in settings or {})
    _draw_seed(data)
    return Document(path.stem, str(path), folder, data, toml.line_numbers(text), changed)


def _draw_seed(data: dict[str, Any]) -> None:
    """A seed for fluctuations that give none, so that every run can be repeated from its record."""
    fluctuations = _at(data, ("atmosphere", "fluctuations"))
    if (
        isinstance(fluctuations, dict)
        and "seed" not in fluctuations
        and fluctuations.get("spectrum") != "file"
    ):
        fluctuations["seed"] = secrets.randbits(32)


def find(source: str | Path) -> Path:
    """The file that a path or the name of a shipped scene means."""
    path = Path(source)
    if path.exists():
        return path
    shipped = SHIPPED / f"{source}.toml"
    if path.name == str(source) and not path.suffix and shipped.is_file():
        return shipped
    names = [p.stem for p in SHIPPED.glob("*.toml")]
    raise ScenarioError([f"{source}: no such file or shipped scene ({suggest(path.stem, names)})"])


def shipped() -> dict[str, str]:
    """The shipped scenes by name, each with the first sentence of its opening comment."""
    found = {}
    for path in sorted(SHIPPED.glob("*.toml")):
        comment: list[str] = []
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line.startswith("#"):
                break
            comment.append(line.lstrip("# "))
        found[path.stem] = " ".join(comment).split(". ")[0].rstrip(".")
    return found


def _text(path: Path) -> tuple[str, Path]:
    """The text of a scenario and the folder that its paths start from."""
    try:
        if path.suffix == ".nc":
            return _stored_text(path)
        if path.stat().st_size > LARGEST_FILE:
            raise ScenarioError(
                [f"{path}: larger than {LARGEST_FILE / 1e6:g} MB; a scenario is a short TOML file"]
            )
        return path.read_text(encoding="utf-8"), path.parent
    except UnicodeDecodeError as error:
        raise ScenarioError(
            [f"{path}: not UTF-8 text (byte {error.start}); save it as UTF-8"]
        ) from None
    except OSError as error:
        raise ScenarioError(
            [f"{path}: cannot be read: {error.strerror or error}; give a TOML file"]
        ) from None


def _stored_text(path: Path) -> tuple[str, Path]:
    """The scenario that a result file carries, and its first folder, if that is still there."""
    import h5netcdf

    try:
        with h5netcdf.File(path, "r") as file:
            text, folder = (
                str(file.attrs["scenario_toml"]),
                Path(str(file.attrs.get("scenario_folder", path.parent))),
            )
    except KeyError:
        raise ScenarioError(
            [f"{path}: holds no scenario; give a result written by `thzcl run`"]
        ) from None
    return text, folder if folder.is_dir() else path.parent


def parse(
    document: Document,
    check_sensor: SensorTroubles,
    names: Sequence[str] = (),
    *,
    allow_outside: bool = False,
) -> Scenario:
    """The scenario, its variants applied; all of them, or those of the given names.

    `check_sensor` says what is wrong with a [sensor] table. Raises ScenarioError with every problem
    at once.
    """
    base = {name: table for name, table in document.data.items() if name != "variants"}
    entries, troubles = _variant_tables(document.data.get("variants", ()))
    known = [entry.name for entry in entries]
    unknown = [
        f"--variant {name}: no such variant ({suggest(name, known)})"
        for name in names
        if name not in known
    ]
    chosen = [(at, entry) for at, entry in enumerate(entries) if not names or entry.name in names]

    variants = []
    for at, entry in chosen or [(0, VariantTable(name=document.name))]:
        data = deepcopy(base)
        wrong = [
            (name, text) for name, value in entry.set.items() if (text := _set(data, name, value))
        ]
        troubles += [Trouble(("variants", at, "set", name), text) for name, text in wrong]
        data = frozen(data)
        scene, found = validate(Scene, data)
        found += [trouble.below("sensor") for trouble in check_sensor(data.get("sensor", {}))]
        changed = {_split(name): name for name in entry.set}
        troubles += [_in_variant(trouble, changed, at) for trouble in found]
        if scene is not None:
            variants.append(Variant(entry.name, scene))
    if troubles or unknown:
        raise ScenarioError([*unknown, *document.problems(troubles)])
    return Scenario(
        document.name, document.folder, toml.dumps(document.data), tuple(variants), allow_outside
    )


def _variant_tables(data: Any) -> tuple[list[VariantTable], list[Trouble]]:
    if not isinstance(data, list):
        return [], [
            Trouble(("variants",), f"must be a list of tables [[variants]], not {shown(data)}")
        ] if data else []
    tables: list[VariantTable] = []
    troubles: list[Trouble] = []
    for at, entry in enumerate(data):
        table, found = validate(VariantTable, frozen(entry))
        troubles += [trouble.below("variants", at) for trouble in found]
        if table is not None:
            if table.name in [other.name for other in tables]:
                troubles.append(
                    Trouble(
                        ("variants", at, "name"), f'"{table.name}" is taken; choose another name'
                    )
                )
            tables.append(table)
    return tables, troubles


def _in_variant(trouble: Trouble, changed: Mapping[KeyPath, str], at: int) -> Trouble:
    """A trouble with a key that a variant set, at the place where the variant set it."""
    for path, name in changed.items():
        if trouble.path[: len(path)] == path:
            return Trouble(("variants", at, "set", name), trouble.text)
    return trouble


def _split(name: str) -> KeyPath:
    return tuple(name.split("."))


def _set(data: dict[str, Any], name: str, value: Any) -> str | None:
    """Sets a dotted key in nested tables; what hinders it, if anything does."""
    *tables, last = name.split(".")
    if not all([*tables, last]):
        return "not a key; write table.key"
    node: Any = data
    for part in tables:
        node = node.setdefault(part, {})
        if not isinstance(node, dict):
            return f"{part} is not a table"
    node[last] = value
    return None


def _at(data: Any, path: KeyPath) -> Any:
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def frozen(data: Any) -> Any:
    """Lists as tuples, throughout: what is read does not change."""
    if isinstance(data, dict):
        return {name: frozen(value) for name, value in data.items()}
    return tuple(frozen(value) for value in data) if isinstance(data, list | tuple) else data
