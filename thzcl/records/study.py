"""What `thzcl fluctuations` does: records read and analysed, and what is written of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from thzcl.files import make_folder
from thzcl.records import analysis, record


def study_virtual(
    source: str | Path, output: Path | None = None, scene: Path | None = None
) -> dict[str, Any]:
    """Returns the statistics of a virtual hygrometer's record in a scenario's air, as `study` does.

    The record is kept in the folder `output`, if that is given.
    """
    from thzcl.records import virtual

    with TemporaryDirectory() as passing:
        folder = Path(passing) if output is None else output
        make_folder(folder)
        path = virtual.write(source, folder)
        found = study([path], output=output, scene=scene)
    if output is None:
        return found | {"records": [f"a transect of {source}"]}
    return found | {"files": [str(path), *found["files"]]}


def study(
    paths: Sequence[Path], columns: str = "", output: Path | None = None, scene: Path | None = None
) -> dict[str, Any]:
    """Returns the statistics of a record in one file or several, and the files that were written.

    `columns` is as in columns.find; `output` is the folder for figures, `scene` the TOML file to
    write. Raises RecordError if the files hold no usable record, OSError if a file cannot be
    written.
    """
    found = analysis.analyse(record.load(paths, columns))
    files: list[Path] = []
    if output is not None:
        from thzcl.records import figures

        make_folder(output)
        files += figures.write(found, output)
    if scene is not None:
        from thzcl.records import scene_file

        files += scene_file.write(found, scene)
    return found.as_json() | {"files": [str(file) for file in files]}
