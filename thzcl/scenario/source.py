"""Where scenarios come from: files, results that carry theirs, and the scenes that are shipped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from thzcl.errors import FileError, ScenarioError
from thzcl.files import RESULT, SCENE, open_netcdf, read_text
from thzcl.plugins.names import suggest
from thzcl.scenario.text import dumps, load

SHIPPED = Path(__file__).parents[1] / "scenarios"
if not SHIPPED.is_dir():  # straight from a checkout
    SHIPPED = Path(__file__).parents[2] / "scenarios"


def find(source: str | Path) -> Path:
    """Returns the file that a path or the name of a shipped scene means. Raises ScenarioError.

    A folder of that name does not hide a shipped scene.
    """
    path = Path(source)
    named = SHIPPED / f"{source}.toml"
    is_name = path.name == str(source) and not path.suffix and named.is_file()
    if path.exists() and not (is_name and path.is_dir()):
        return path
    if is_name:
        return named
    names = [p.stem for p in SHIPPED.glob("*.toml")]
    raise ScenarioError([f"{source}: no such file or shipped scene ({suggest(path.stem, names)})"])


def shipped() -> dict[str, str]:
    """Returns the shipped scenes by name, each with the first sentence of its opening comment."""
    scenes = {}
    for path in sorted(SHIPPED.glob("*.toml")):
        comment: list[str] = []
        for line in path.read_text(encoding="utf-8").splitlines():
            if not line.startswith("#"):
                break
            comment.append(line.lstrip("# "))
        scenes[path.stem] = " ".join(comment).split(". ")[0].rstrip(".")
    return scenes


def shipped_text(name: str) -> str:
    """Returns the TOML text of a shipped scene. Raises ScenarioError if there is none."""
    if name not in shipped():
        raise ScenarioError([f"{name}: no such shipped scene ({suggest(name, list(shipped()))})"])
    return (SHIPPED / f"{name}.toml").read_text(encoding="utf-8")


def shipped_files(name: str) -> list[Path]:
    """Returns the pictures and tables that a shipped scene names, which lie beside it."""
    names = _texts(load(shipped_text(name), name))
    return sorted({SHIPPED / text for text in names if (SHIPPED / text).is_file()})


def _texts(value: Any) -> Iterator[str]:
    """Yields the texts among the values of nested tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _texts(one)


@dataclass(frozen=True)
class Scene:
    """A scene that stands in no file: its TOML text, and the folder that its paths start from.

    thzcl.run takes it as it takes a file. Nothing is checked before that. `made` names the variants
    that a result of it has, if they are not all.

    >>> import thzcl
    >>> scene = thzcl.Scene.from_toml('''
    ... atmosphere = { temperature_k = 290, relative_humidity_percent = 60 }
    ... ground = { temperature_k = 285 }
    ... sensor = { kind = "passive-spectral", frequency_ghz = 340 }
    ... [camera]
    ... position_m = [0, 0, 2]
    ... look_at_m = [0, 30, 1]
    ... focal_length_mm = 50
    ... focal_plane_mm = [10, 10]
    ... pixels = [4, 4]
    ... ''')
    >>> thzcl.run(scene).targets
    ('background', 'ground')
    """

    text: str
    folder: Path = Path()
    name: str = "scene"
    made: tuple[str, ...] = ()

    @classmethod
    def from_toml(cls, text: str, *, folder: str | Path = ".", name: str = "scene") -> Scene:
        """Returns the scene of a TOML text."""
        return cls(text, Path(folder), name)

    @classmethod
    def from_dict(
        cls, tables: Mapping[str, Any], *, folder: str | Path = ".", name: str = "scene"
    ) -> Scene:
        """Returns the scene of nested tables; NumPy's numbers and arrays are taken as well.

        Keys whose value is None are left out. Raises ScenarioError for what TOML cannot hold.
        """
        try:
            return cls(dumps(tables), Path(folder), name)
        except ValueError as error:
            raise ScenarioError([f"{name}: {error}"]) from None


class Text(NamedTuple):
    """The text of a scenario, and the folder that its paths start from.

    `made` are the names of the images that a result holds, of all variants or of a choice of them.
    """

    text: str
    folder: Path
    made: tuple[str, ...] = ()


def text_of(path: Path) -> Text:
    """Returns the text of a scenario: a TOML file, or a result (.nc), which carries its scenario.

    Raises ScenarioError.
    """
    try:
        if path.suffix == ".nc":
            return _stored_text(path)
        return Text(read_text(path, SCENE), path.parent)
    except FileError as error:
        raise ScenarioError([str(error)]) from None


def _stored_text(path: Path) -> Text:
    """Returns the scenario that a result carries, and its first folder, if that is still there.

    Raises FileError.
    """
    import h5py

    with open_netcdf(path, RESULT) as file:
        text, folder = file.attrs.get("scenario_toml"), file.attrs.get("scenario_folder")
        names = file.get("variant")
        named = isinstance(names, h5py.Dataset) and h5py.check_string_dtype(names.dtype)
        made = tuple(map(str, names.asstr()[...].ravel())) if named else ()
    if not isinstance(text, str):
        raise FileError(f"{path}: holds no scenario; {RESULT.give}")
    if isinstance(folder, str) and Path(folder).is_dir():
        return Text(text, Path(folder), made)
    return Text(text, path.parent, made)
