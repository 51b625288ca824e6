"""From a TOML file to a Scenario: reading, settings from the command line, variants."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from thzcl.air import layers
from thzcl.errors import FileError, ScenarioError
from thzcl.files import inside
from thzcl.plugins.names import suggest
from thzcl.scenario import constituents, sensors
from thzcl.scenario import source as scenes
from thzcl.scenario.atmosphere import Atmosphere
from thzcl.scenario.lines import line_numbers
from thzcl.scenario.problems import Path as KeyPath
from thzcl.scenario.problems import Trouble, shown, validate
from thzcl.scenario.scene import Scene
from thzcl.scenario.table import Table, key
from thzcl.scenario.text import DEEPEST, dumps, load, plain

Source = str | Path | Mapping[str, Any] | scenes.Scene  # of a scenario


@dataclass(frozen=True)
class Variant:
    """One image of a scenario: its name and its scene.

    `key` is the name by which its random numbers are keyed, empty where there is but one image.
    """

    name: str
    scene: Scene
    key: str = ""


@dataclass(frozen=True)
class Scenario:
    """A scenario as it will run: its variants, in order, and the TOML text that repeats it."""

    name: str
    folder: Path  # that relative paths in it start from
    text: str
    variants: tuple[Variant, ...]
    allow_outside: bool = False  # whether its pictures and tables may lie outside the folder
    idle: tuple[str, ...] = ()  # keys that are given and do nothing, a line each

    def locate(self, name: str) -> Path:
        """Returns the path of a picture or table that the scenario names.

        Raises FileError for one outside the folder, unless that is allowed.
        """
        return inside(self.folder, name, allow_outside=self.allow_outside)

    @property
    def targets(self) -> tuple[str, ...]:
        """The names of the targets of all variants, each once, in the order of the file."""
        return tuple(dict.fromkeys(name for v in self.variants for name in v.scene.flagged))

    @property
    def seed(self) -> int:
        """The seed of its random numbers; 0 where no fluctuations name one."""
        fluctuations = self.variants[0].scene.atmosphere.fluctuations
        return (fluctuations.seed or 0) if fluctuations else 0

    @property
    def noise_seed(self) -> int:
        """The seed of its first variant's noise."""
        return noise_seed(self.variants[0].scene)


def noise_seed(scene: Scene) -> int:
    """Returns the seed of a scene's noise: its own, else the air's; 0 where neither is named."""
    own, fluctuations = scene.numerics.noise_seed, scene.atmosphere.fluctuations
    if own is not None:
        return own
    return (fluctuations.seed or 0) if fluctuations else 0


class VariantTable(Table):
    """An entry of [[variants]]."""

    name: str = key(min_length=1, help="name of the variant")
    set: dict[str, Any] = key(
        {}, help='keys to change, as in { "targets.box.temperature_k" = 263 }'
    )


@dataclass(frozen=True)
class Document:
    """The data of a scenario before anything is checked, and where in its text they stand."""

    name: str
    label: str  # what messages call it
    folder: Path
    data: dict[str, Any]
    lines: Mapping[KeyPath, int]
    settings: frozenset[KeyPath]  # keys that came from --set
    made: tuple[str, ...] = ()  # the variants whose images are in the result that it came from

    def problem(self, trouble: Trouble) -> str:
        """Returns a trouble in one line: file, line, table, key, text."""
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
        """Returns troubles in lines, in the order of the file."""
        ordered = sorted(troubles, key=lambda trouble: self._line(trouble.path))
        return [self.problem(trouble) for trouble in ordered]

    def _line(self, path: KeyPath) -> int:
        """Returns the line of a key, or else of the table that lacks it; 0 if it has none."""
        return next(
            (self.lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self.lines), 0
        )


def read(
    source: Source, settings: Mapping[str, Any] | None = None, seed: int | None = None
) -> Document:
    """Reads a scenario: a path to TOML or to a result, the bare name of a shipped scene, or tables.

    `settings` maps dotted keys to values; None removes a key. `seed` is that of fluctuations which
    name none; if it is None too, one is drawn. Raises ScenarioError if there is no
    such file, it is not TOML, or a setting cannot be made.
    """
    _refuse_no_settings(settings)
    tables = isinstance(source, Mapping)
    if isinstance(source, Mapping):
        source = scenes.Scene.from_dict(source)
    if isinstance(source, scenes.Scene):
        label, name, given = (
            source.name,
            source.name,
            scenes.Text(source.text, source.folder, source.made),
        )
    elif not isinstance(source, str | PathLike):
        text = "give a file, the name of a shipped scene, tables, or a thzcl.Scene"
        raise ScenarioError([f"{type(source).__name__} is no scene; {text}"])
    else:
        path = scenes.find(source)
        label, name, given = str(path), path.stem, scenes.text_of(path)
    text, folder, made = given
    data = load(text, label)
    reasons = {name: _change(data, name, value) for name, value in (settings or {}).items()}
    if any(reasons.values()):
        raise ScenarioError([f"--set {name}: {why}" for name, why in reasons.items() if why])
    _fill_seeds(data, secrets.randbits(32) if seed is None else seed)
    changed = frozenset(map(_split, reasons))
    name = name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    lines = {} if tables else line_numbers(text)
    return Document(name, label, folder, data, lines, changed, made)


def name_of(source: Source) -> str:
    """Returns the name that a scenario has, before it is read."""
    if isinstance(source, Mapping):
        return scenes.Scene.name
    return source.name if isinstance(source, scenes.Scene) else Path(source).stem


def chosen(variants: str | Sequence[str]) -> tuple[str, ...]:
    """Returns the names of variants, of which one alone may be given as it is."""
    return (variants,) if isinstance(variants, str) else tuple(variants)


def _refuse_no_settings(settings: Any) -> None:
    """Raises ScenarioError unless settings map dotted keys to values, or are None."""
    if settings is not None and not isinstance(settings, Mapping):
        raise ScenarioError(['settings: must map keys to values, {"sensor.frequency_ghz": 340}'])
    wrong = next((name for name in settings or {} if not isinstance(name, str)), None)
    if wrong is not None:
        raise ScenarioError([f"settings: the key {wrong!r} is no text; write keys in quotes"])


def changed(
    document: Document, settings: Mapping[str, Any], variants: Mapping[str, Mapping[str, Any]]
) -> Document:
    """Returns a document with dotted keys set, in each of the named variants those of its own.

    Raises ScenarioError if a key cannot be set.
    """
    data = deepcopy(document.data)
    reasons = _change_all(data, settings)
    if any(reasons.values()):
        raise ScenarioError([f"--set {name}: {why}" for name, why in reasons.items() if why])
    for entry in data.get("variants", ()):
        entry["set"] = entry.get("set", {}) | variants.get(entry.get("name"), {})
    paths = document.settings | frozenset(map(_split, settings))
    return replace(document, data=data, settings=paths)


def names(document: Document) -> tuple[str, ...]:
    """Returns the names of a document's variants; what is wrong with them is found by parse()."""
    entries, _ = _variant_tables(document.data.get("variants", ()))
    return tuple(entry.name for entry in entries)


def alone(document: Document, variant: str) -> Document:
    """Returns a document with one of its variants alone, if it has that."""
    entries = [one for one in document.data["variants"] if one.get("name") == variant]
    if not entries:
        return document
    data = deepcopy(document.data | {"variants": entries})
    data.get("output", {}).pop("difference", None)
    return replace(document, data=data)


def by_variant(document: Document) -> dict[str, dict[str, Any]]:
    """Returns the data of each variant by name, its keys set; without variants one, named "".

    What is wrong with them is found when they are parsed, and not here.
    """
    base = {name: table for name, table in document.data.items() if name != "variants"}
    found = {}
    for entry in document.data.get("variants", ()) or [{"name": ""}]:
        data = deepcopy(base)
        _change_all(data, deepcopy(entry.get("set", {})))
        found[entry.get("name", "")] = data
    return found


def _fill_seeds(data: dict[str, Any], seed: int) -> None:
    """Gives air and noise without a seed one, so that every run can be repeated from its record.

    Noise without a seed of its own follows that of the air, where the scene names one.
    Variants that bring fluctuations of their own without a seed get the same one, as a key that
    they set: images of one scene show one realisation of the air.
    """
    named = _at(data, ("atmosphere", "fluctuations", "seed")) is not None
    numerics = data.setdefault("numerics", {})
    if isinstance(numerics, dict) and not named:
        numerics.setdefault("noise_seed", seed)
    if _lacks_seed(data):
        data["atmosphere"]["fluctuations"]["seed"] = seed
    entries = data.get("variants", ())
    for entry in entries if isinstance(entries, list | tuple) else ():
        changes = entry.get("set") if isinstance(entry, dict) else None
        if isinstance(changes, dict):
            air = {"atmosphere": deepcopy(data.get("atmosphere", {}))}
            _change_all(air, deepcopy(changes))
            if _lacks_seed(air):
                changes["atmosphere.fluctuations.seed"] = seed


def _lacks_seed(data: Any) -> bool:
    """Returns whether a scene has fluctuations that are drawn at random, but without a seed."""
    fluctuations = _at(data, ("atmosphere", "fluctuations"))
    return (
        isinstance(fluctuations, dict)
        and "seed" not in fluctuations
        and fluctuations.get("spectrum") != "file"
    )


def parse(
    document: Document, names: Sequence[str] = (), *, allow_outside: bool = False
) -> Scenario:
    """Returns the scenario with its variants applied: all of them, or those of the given names.

    Without names, the scenario of a result has the variants whose images the result holds.
    Raises ScenarioError with every problem at once.
    """
    base = {name: table for name, table in document.data.items() if name != "variants"}
    entries, troubles = _variant_tables(document.data.get("variants", ()))
    known = [entry.name for entry in entries]
    names = names or [name for name in document.made if name in known]
    unknown = [
        f"--variant {name}: no such variant "
        f"({suggest(name, known) if known else 'the scene has none; leave it out'})"
        for name in names
        if name not in known
    ]
    chosen = [(at, entry) for at, entry in enumerate(entries) if not names or entry.name in names]
    variants = []
    locate = partial(inside, document.folder, allow_outside=allow_outside)
    for at, entry in chosen or [(0, VariantTable(name=document.name))]:
        scene, found = _scene(base, entry, at, locate)
        troubles += found
        if scene is not None:
            variants.append(Variant(entry.name, scene, entry.name if entries else ""))
    troubles += _of_difference(base, known)
    if troubles or unknown:
        raise ScenarioError([*unknown, *document.problems(troubles)])
    # Of a choice of variants, those left out may use a key.
    idle = () if names else tuple(document.problems(_unused(variants)))
    text = dumps(document.data)
    return Scenario(document.name, document.folder, text, tuple(variants), allow_outside, idle)


def _unused(variants: Sequence[Variant]) -> list[Trouble]:
    """Returns the keys that are given and do nothing in any variant."""
    each = []
    for variant in variants:
        sensor = sensors.unused(frozen(variant.scene.sensor.model_dump()))
        found = variant.scene.unused() + [trouble.below("sensor") for trouble in sensor]
        each.append({trouble.path: trouble for trouble in found})
    return [one for path, one in each[0].items() if all(path in found for found in each)]


def _of_difference(base: Mapping[str, Any], known: Sequence[str]) -> list[Trouble]:
    """Returns the variants that a difference is asked of, but that there are not."""
    names = _at(base, ("output", "difference"))
    return [
        Trouble(("output", "difference"), f'no variant "{name}" ({suggest(name, known)})')
        for name in (names if isinstance(names, list | tuple) else ())
        if isinstance(name, str) and name not in known
    ]


def _scene(
    base: Mapping[str, Any], entry: VariantTable, at: int, locate: Callable[[str], Path]
) -> tuple[Scene | None, list[Trouble]]:
    """Returns the scene of the variant at a place in the list, and what is wrong with it."""
    data = dict(deepcopy(base))
    reasons = _change_all(data, entry.set)
    troubles = [Trouble(("variants", at, "set", name), why) for name, why in reasons.items() if why]
    data, lacking = _of_profile(frozen(data), locate)
    scene, found = validate(Scene, data)
    found += lacking
    found += [trouble.below("sensor") for trouble in sensors.troubles(data.get("sensor"))]
    keys = Atmosphere.model_fields
    in_air = constituents.troubles(data.get("atmosphere"), keys["model"].default, keys)
    found += [trouble.below("atmosphere") for trouble in in_air]
    changed = {_split(name): name for name in entry.set}
    return scene, troubles + [_in_variant(trouble, changed, at) for trouble in found]


def _of_profile(
    data: dict[str, Any], locate: Callable[[str], Path]
) -> tuple[dict[str, Any], list[Trouble]]:
    """Returns data whose mean air, where it is left out, is a profile's at the camera."""
    air, camera = data.get("atmosphere"), data.get("camera")
    profile = air.get("profile") if isinstance(air, dict) else None
    if not isinstance(air, dict) or not isinstance(profile, dict) or not isinstance(camera, dict):
        return data, []
    file, place = profile.get("file"), camera.get("position_m")
    dry = not {"relative_humidity_percent", "absolute_humidity_g_m3"} & air.keys()
    lacks = dry or "temperature_k" not in air
    height_m = place[2] if isinstance(place, tuple) and len(place) == 3 else None
    if not isinstance(file, str) or not isinstance(height_m, int | float) or not lacks:
        return data, []
    try:
        kelvin, grams = layers.read(locate(file)).at(float(height_m))
    except FileError as error:
        return data, [Trouble(("atmosphere", "profile", "file"), str(error))]
    mean: dict[str, Any] = {} if "temperature_k" in air else {"temperature_k": kelvin}
    mean |= {"absolute_humidity_g_m3": grams} if dry else {}
    return data | {"atmosphere": air | mean}, []


def _variant_tables(data: Any) -> tuple[list[VariantTable], list[Trouble]]:
    if not isinstance(data, list | tuple):
        text = f"must be a list of tables [[variants]], not {shown(data)}"
        return [], [Trouble(("variants",), text)]
    tables: list[VariantTable] = []
    troubles: list[Trouble] = []
    for at, entry in enumerate(data):
        table, found = validate(VariantTable, frozen(entry))
        troubles += [trouble.below("variants", at) for trouble in found]
        if table is not None:
            if table.name in [other.name for other in tables]:
                text = f'"{table.name}" is taken; choose another name'
                troubles.append(Trouble(("variants", at, "name"), text))
            tables.append(table)
    return tables, troubles


def _in_variant(trouble: Trouble, changed: Mapping[KeyPath, str], at: int) -> Trouble:
    """Returns a trouble with a key that a variant set at the place where the variant set it."""
    for path, name in changed.items():
        if trouble.path[: len(path)] == path:
            return Trouble(("variants", at, "set", name), trouble.text)
    return trouble


def _split(name: str) -> KeyPath:
    return tuple(name.split("."))


def _change(data: dict[str, Any], name: str, value: Any) -> str | None:
    """Sets a dotted key in nested tables, or removes it if the value is None.

    Returns what hinders it, if anything does.
    """
    *tables, last = name.split(".")
    if not all([*tables, last]):
        return "not a key; write table.key"
    if len(tables) >= DEEPEST:
        return f"a key of {len(tables) + 1} parts; no key has more than {DEEPEST}"
    try:
        value = None if value is None else plain(value)
    except ValueError as error:
        return str(error)
    node: Any = data
    for part in tables:
        node = node.setdefault(part, {}) if value is not None else node.get(part, {})
        if not isinstance(node, dict):
            return f"{part} is not a table"
    if value is None:
        node.pop(last, None)
    else:
        node[last] = value
    return None


def _change_all(data: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, str | None]:
    """Sets the keys of a variant, tables before keys within them: TOML keeps no order of keys.

    Returns what hinders each of them, or None where nothing does.
    """
    names = sorted(changes, key=lambda name: len(_split(name)))
    return {name: _change(data, name, changes[name]) for name in names}


def _at(data: Any, path: KeyPath) -> Any:
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def frozen(data: Any) -> Any:
    """Returns data with tuples in place of lists throughout: what is read does not change."""
    if isinstance(data, dict):
        return {name: frozen(value) for name, value in data.items()}
    return tuple(frozen(value) for value in data) if isinstance(data, list | tuple) else data
