"""What `thzcl fluctuations` does: records read and analysed, and what is written of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from thzcl.files import make_folder
from thzcl.records import analysis, record
from thzcl.records.record import Record


@dataclass(frozen=True)
class Asked:
    """What the user says about a record: columns, batches, height, rate and pressure."""

    columns: str = ""
    batch_minutes: float | None = None
    height_m: float | None = None
    rate_hz: float | None = None
    pressure_hpa: float | None = None


def study_virtual(
    source: str | Path,
    output: Path | None = None,
    scene: Path | None = None,
    asked: Asked | None = None,
) -> dict[str, Any]:
    """Returns the statistics of a virtual hygrometer's record in a scenario's air, as `study` does.

    The record is kept in the folder `output`, if that is given.
    """
    from thzcl.records import virtual

    with TemporaryDirectory() as passing:
        folder = Path(passing) if output is None else output
        make_folder(folder)
        path = virtual.write(source, folder)
        found = study([path], output=output, scene=scene, asked=asked)
    if output is None:
        return found | {"records": [f"a transect of {source}"]}
    return found | {"files": [str(path), *found["files"]]}


def study(
    paths: Sequence[Path],
    columns: str = "",
    output: Path | None = None,
    scene: Path | None = None,
    asked: Asked | None = None,
) -> dict[str, Any]:
    """Returns the statistics of a record in one file or several, and the files that were written.

    `columns` is as in columns.find; `output` is the folder for figures, `scene` the TOML file to
    write. Raises RecordError if the files hold no usable record, OSError if a file cannot be
    written.
    """
    return analysed(read(paths, asked or Asked(columns)), output, scene, asked or Asked())


def read(paths: Sequence[Path], asked: Asked) -> Record:
    """Returns the record in one file or several."""
    return record.load(paths, asked.columns, asked.rate_hz, asked.pressure_hpa)


def analysed(own: Record, output: Path | None, scene: Path | None, asked: Asked) -> dict[str, Any]:
    """Returns the statistics of a record, and the files that were written of them."""
    found = analysis.analyse(own, asked.batch_minutes, asked.height_m)
    files: list[Path] = []
    if output is not None:
        from thzcl.records import figures

        make_folder(output)
        files += figures.write(found, output)
    if scene is not None:
        from thzcl.records import scene_file

        files += scene_file.write(found, scene)
    return found.as_json() | {"files": [str(file) for file in files]}
