"""A package with a plugin of one's own, to start from: `templates/` holds its files, by kind."""

from __future__ import annotations

import re
from pathlib import Path
from string import Template

from thzcl.errors import PluginError
from thzcl.plugins.loader import Hook, origins

TEMPLATES = Path(__file__).with_name("templates")


def write_package(hook: Hook, name: str, where: Path) -> Path:
    """Writes a package with a plugin into a new folder of the plugin's name, and returns it.

    In a template's text $name, $module, $title and $contract are replaced, in its file's name
    MODULE; the suffix .in is dropped. Raises PluginError for a name that cannot be used, or
    OSError.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise PluginError(
            f'"{name}" cannot name a {hook.word}; '
            f"use small letters, digits and single hyphens, as in my-{hook.word}"
        )
    if name in hook.reserved:
        raise PluginError(f'"{name}" is a name that thzcl keeps for itself; choose another name')
    taken = [origin for origin in origins(hook) if origin.name == name]
    if taken:
        owner = taken[0].distribution
        raise PluginError(f'"{name}" is a {hook.word} of {owner}; choose another name')
    folder = where / name
    if folder.exists():
        raise PluginError(f"{folder}: exists already; choose another name")
    module = "thzcl_" + name.replace("-", "_")
    words = {
        "name": name,
        "module": module,
        "title": _class_name(name, hook.word.title()),
        "contract": hook.contracts[-1],
    }
    folder.mkdir()
    for template in sorted((TEMPLATES / hook.word).glob("*.in")):
        text = Template(template.read_text(encoding="utf-8")).substitute(words)
        file = folder / template.name.replace("MODULE", module).removesuffix(".in")
        file.write_text(text, encoding="utf-8")
    return folder


def _class_name(name: str, kind: str) -> str:
    """Returns a name for the class that no keyword and nothing it imports has: MyCameraSensor."""
    title = name.title().replace("-", "")
    return title if title.endswith(kind) and title != kind else title + kind
