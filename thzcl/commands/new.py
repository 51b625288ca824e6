"""`thzcl new`: a scene to start from."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from thzcl.errors import UsageError

SCHEMA = "thzcl.schema.json"


def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="the TOML file to write")],
    source: Annotated[
        str, typer.Option("--from", metavar="NAME", help="the shipped scene to start from")
    ] = "quick",
) -> None:
    """Write a commented scene to start from, and its schema for editors."""
    from thzcl.files import write_whole
    from thzcl.scenario.manual import SCHEMA_ID, scenario_schema
    from thzcl.scenario.source import shipped_files, shipped_text

    text = f"#:schema ./{SCHEMA}\n\n{shipped_text(source)}"
    schema = file.with_name(SCHEMA)
    beside = {file.with_name(path.name): path for path in shipped_files(source)}
    for path in (file, *beside):
        if path.exists():
            raise UsageError(f"{path}: exists already; choose another name or folder")
    if schema.exists() and not _ours(schema, SCHEMA_ID):
        raise UsageError(f"{schema}: is not thzcl's; move it, or choose another folder")
    described = json.dumps(scenario_schema(), indent=1)
    write_whole(schema, lambda part: part.write_text(described, encoding="utf-8"))
    for path, shipped in beside.items():
        write_whole(path, partial(shutil.copyfile, shipped))
    write_whole(file, lambda part: part.write_text(text, encoding="utf-8"))
    print(f"wrote {', '.join(map(str, (file, *beside, schema)))}")
    print(f"edit {file}, then: thzcl run {file}")


def _ours(path: Path, identity: str) -> bool:
    """Returns whether a file is a schema of scenarios, which may be written anew."""
    from thzcl.errors import FileError
    from thzcl.files import SCENE, read_text

    try:
        found = json.loads(read_text(path, SCENE))
    except (FileError, ValueError, RecursionError):
        return False
    return isinstance(found, dict) and found.get("$id") == identity
