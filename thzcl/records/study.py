"""What `thzcl fluctuations` does: records read and analysed, and what is written of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from thzcl.errors import RecordError
from thzcl.files import make_folder
from thzcl.records import analysis, record
from thzcl.records.record import Record

if TYPE_CHECKING:
    from thzcl.records.sensor_pairs import Other


@dataclass(frozen=True)
class Asked:
    """What the user says about a record: columns, batches, height, rate, pressure, other sensors.

    `second` are the files of other hygrometers; `separations_m` how far away they stand, and after
    them that of the first file's own column of role h2o_2, if it has one.
    """

    columns: str = ""
    batch_minutes: float | None = None
    height_m: float | None = None
    rate_hz: float | None = None
    pressure_hpa: float | None = None
    second: tuple[Path, ...] = ()
    separations_m: tuple[float, ...] = ()


def study_virtual(
    source: str | Path,
    output: Path | None = None,
    scene: Path | None = None,
    asked: Asked | None = None,
) -> dict[str, Any]:
    """Returns the statistics of a virtual hygrometer's record in a scenario's air, as `study` does.

    Other hygrometers stand across the wind, at the separations that are asked for. The records are
    kept in the folder `output`, if that is given.
    """
    from thzcl.records import virtual

    with TemporaryDirectory() as passing:
        folder = Path(passing) if output is None else output
        make_folder(folder)
        asked = asked or Asked()
        path, *others = virtual.write(source, folder, asked.separations_m)
        asked = replace(asked, second=tuple(others))
        found = study([path], output=output, scene=scene, asked=asked)
    if output is None:
        pairs = found["pairs"] and [p | {"second": Path(p["second"]).name} for p in found["pairs"]]
        return found | {"records": [f"a transect of {source}"], "pairs": pairs}
    return found | {"files": [str(path), *map(str, others), *found["files"]]}


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
    others = _others(own, asked)
    found = analysis.analyse(own, asked.batch_minutes, asked.height_m)
    told: dict[str, Any] = found.as_json() | {"pairs": None, "taylor": None}
    if others:
        from thzcl.records import sensor_pairs

        beside = sensor_pairs.as_json(found, others)
        told |= beside | {"notes": [*told["notes"], *beside["notes"]]}
    files: list[Path] = []
    if output is not None:
        from thzcl.records import figures

        make_folder(output)
        files += figures.write(found, output, told["pairs"], told["taylor"])
    if scene is not None:
        from thzcl.records import scene_file

        files += scene_file.write(found, scene)
    return told | {"files": [str(file) for file in files]}


def _others(own: Record, asked: Asked) -> list[Other]:
    """Returns the other hygrometers. Raises RecordError unless each has its separation."""
    from thzcl.records import sensor_pairs

    files, apart = asked.second, asked.separations_m
    wanted = len(files) + (own.second is not None)
    if wanted != len(apart):
        column = " and one for the column of role h2o_2" if own.second is not None else ""
        raise RecordError(
            f"--separation-m: {len(apart)} given; expected {wanted}: one for each --second{column}"
        )
    others = []
    for path, separation in zip(files, apart, strict=False):
        beside = record.load(
            [path], asked.columns, asked.rate_hz, asked.pressure_hpa, companion=True
        )
        others.append(sensor_pairs.of_record(own, beside, separation))
    if own.second is not None:
        others.append(sensor_pairs.of_column(own, apart[-1]))
    return others
