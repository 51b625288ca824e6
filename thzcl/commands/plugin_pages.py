"""What the commands of every kind of plugin share: lists, manual pages and new packages."""

from __future__ import annotations

from pathlib import Path

from thzcl.plugins.loader import Hook, origins
from thzcl.plugins.template import write_package


def show_all(hook: Hook) -> None:
    """Prints the plugins of a kind: name, distribution and what they are."""
    from thzcl.commands.tables import Column, Table, show
    from thzcl.scenario.manual import summary

    rows = [(origin.name, origin.distribution, summary(hook, origin)) for origin in origins(hook)]
    show(Table("", (Column(hook.word), Column("from"), Column("")), tuple(rows)))


def show_one(hook: Hook, name: str, where: str) -> None:
    """Prints a plugin's manual page, and its parameters, which stand at a place of a scenario."""
    from thzcl.commands.tables import Column, Table, show
    from thzcl.commands.terminal import page
    from thzcl.scenario.manual import manual

    text, rows = manual(hook, name)
    page(text)
    print()
    columns = tuple(map(Column, ("key", "unit", "default", "limits", "meaning")))
    show(Table(where, columns, tuple(map(tuple, rows))))


def write_new(hook: Hook, name: str) -> None:
    """Writes a package with a plugin of one's own, and prints what to do next."""
    folder = write_package(hook, name, Path())
    print(f"wrote {folder}; next: pip install ./{folder} && thzcl run {folder}/scene.toml")
