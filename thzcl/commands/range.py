"""`thzcl range`: up to what range a target is detected."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thzcl.commands.options import (
    AllowOutside,
    DeviceChoice,
    Folder,
    HowText,
    Settings,
    Source,
    TextFormat,
    Variants,
    changes,
)

if TYPE_CHECKING:
    from thzcl.commands.tables import Table
    from thzcl.studies.detection.ranges import RangeResult


def range(  # noqa: A001 (the command's name)
    scenario: Source,
    target: Annotated[str, typer.Option(metavar="NAME", help="the target to detect")],
    output: Folder = Path(),
    ranges: Annotated[
        str | None,
        typer.Option(
            metavar="R", help="m from camera to target: a,b,c or start:stop:step; 10:200:10 if none"
        ),
    ] = None,
    frequency_ghz: Annotated[
        str | None,
        typer.Option(metavar="F", help="GHz to set the sensor or its detector to: a list or range"),
    ] = None,
    probability: Annotated[
        float, typer.Option(metavar="P", help="of detection, at the range that is looked for")
    ] = 0.9,
    false_alarm: Annotated[
        float, typer.Option(metavar="PFA", help="of one test at one known place, not of a picture")
    ] = 0.01,
    air: Annotated[
        int, typer.Option(metavar="N", help="airs: half to learn from, half to test on")
    ] = 100,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="S", help="that the airs' seeds follow from")
    ] = None,
    observer: Annotated[
        str, typer.Option(metavar="NAME", help="hotelling, or npw (nearest to people)")
    ] = "hotelling",
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    how: HowText = TextFormat.text,
) -> None:
    """Probability of detection against range: DIR/<scenario>-range.json, .csv and .png.

    Interrupted, it goes on later.
    """
    from thzcl.commands.tables import show, show_json
    from thzcl.commands.terminal import note, progress, wrote
    from thzcl.files import make_folder
    from thzcl.studies.detection.ranges import detection_range

    make_folder(output)
    with progress() as tell:
        found = detection_range(
            scenario,
            target,
            ranges=ranges,
            frequency_ghz=frequency_ghz,
            probability=probability,
            false_alarm=false_alarm,
            air=air,
            seed=seed,
            observer=observer,
            settings=changes(settings),
            variants=variant or (),
            device=device,
            folder=output,
            allow_outside=allow_outside,
            progress=tell,
        )
        found = _written(found, output)
    if how is TextFormat.json:
        show_json(found.as_json())
        return
    show(*tables(found))
    for line in found.notes:
        note(f"note: {line}")
    wrote(found.files)


def _written(found: RangeResult, output: Path) -> RangeResult:
    """Writes JSON, CSV and picture, and returns the answer with the names of its files."""
    from thzcl.commands.tables import as_csv, from_records
    from thzcl.files import write_whole
    from thzcl.studies.detection.figure import draw

    base = output / f"{found.question.base.document.name}-range"
    files = [base.with_name(f"{base.name}.{kind}") for kind in ("json", "csv", "png")]
    found = replace(found, files=tuple(map(str, files)))
    texts = json.dumps(found.as_json(), indent=2), as_csv(from_records(found.records()))
    for file, text in zip(files, texts, strict=False):
        write_whole(file, partial(Path.write_text, data=text, encoding="utf-8"))
    write_whole(files[2], lambda part: draw(found, part))
    return found


def tables(found: RangeResult) -> list[Table]:
    """Returns an answer as tables."""
    from thzcl.commands.tables import Column, Table

    asked, records = found.question, found.records()
    names = ("frequency_ghz", "model", "range_m")
    keys = Column("frequency", "GHz", "g"), Column("model"), Column("range", "m", "g")
    curve = Table(
        f"{asked.base.document.name}: {asked.base.target}, seed {asked.seed}, {asked.airs} airs",
        (
            *keys,
            Column("probability", form=".3f"),
            Column("low", form=".3f"),
            Column("high", form=".3f"),
            Column("d'", form=".3g"),
            Column("area", form=".4f"),
            Column("threshold by"),
            Column("pixels", form="g"),
        ),
        _rows(records, (*names, "probability", "low", "high", "d_prime", "area", "tail",
                        "pixels_on_target")),
        keys=3,
    )  # fmt: skip
    losses = Table(
        "d' with part of what hinders it",
        (
            *keys,
            Column("in all", form=".3g"),
            Column("without absorption", form=".3g"),
            Column("clutter alone", form=".3g"),
            Column("noise alone", form=".3g"),
            Column("with the first range's pixels", form=".3g"),
        ),
        _rows(records, (*names, "d_prime", "absorption", "clutter", "noise", "pixels")),
        keys=3,
    )
    reached = Table(
        f"range at a probability of {100 * asked.probability:g} %",
        (
            *keys[:2],
            Column("range", "m", ".4g"),
            Column("low", "m", ".4g"),
            Column("high", "m", ".4g"),
            Column(""),
        ),
        tuple(
            (c.frequency_ghz, c.model, c.reach.range_m, c.reach.low, c.reach.high, c.reach.note)
            for c in found.curves
        ),
        keys=2,
    )
    return [curve, losses, reached]


def _rows(records: list[dict[str, Any]], names: tuple[str, ...]) -> tuple[tuple[Any, ...], ...]:
    """Returns some columns of records."""
    return tuple(tuple(record[name] for name in names) for record in records)
