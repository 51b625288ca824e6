"""`thzcl run`: the images of a scenario."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
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
    from thzcl.clock import Progress
    from thzcl.commands.tables import Table
    from thzcl.results.result import Result


def run(
    scenario: Source,
    output: Folder = Path(),
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    report: Annotated[
        bool, typer.Option("--report", help="write DIR/<scenario>.html as well, one whole page")
    ] = False,
    no_figure: Annotated[bool, typer.Option("--no-figure", help="write no picture")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")] = False,
    how: HowText = TextFormat.text,
) -> None:
    """Compute the images of a scenario: DIR/<scenario>.nc and DIR/<scenario>.png."""
    from thzcl import pipeline
    from thzcl.commands.plan import air_lines, sky_lines
    from thzcl.commands.report import write as write_report
    from thzcl.commands.tables import show, show_json
    from thzcl.commands.terminal import note, progress, wrote
    from thzcl.files import make_folder
    from thzcl.scenario.source import find
    from thzcl.studies.sequence import is_sequence, sequence

    file = output / f"{find(scenario).stem}.nc"
    make_folder(output)
    asked: dict[str, Any] = {
        "settings": changes(settings),
        "variants": variant or (),
        "device": device,
        "figure": not no_figure,
        "allow_outside": allow_outside,
    }
    more: dict[str, Any] = {}
    with progress(quiet=quiet) as tell, _radiances_kept(file):
        if is_sequence(scenario, asked["settings"]):
            taken = sequence(scenario, file, **asked, progress=tell)
            result, files, more = taken.mean, list(taken.files), {"frames": taken.frames}
            if not no_figure:
                files.append(result.figure(file.with_suffix(f".{result.picture_format}")))
        else:
            result = pipeline.run(scenario, **asked, progress=tell, keep=False)
            files = _write(result, file, not no_figure, tell)
    if report:
        files.append(write_report(file))
    found = result.summary() | more | {"files": [str(file) for file in files]}
    if how is TextFormat.json:
        show_json(found)
    elif not quiet:
        show(*tables(found))
        note(f"device: {found['device']}")
        for line in (*air_lines(found["airs"]), *sky_lines(found["sky"])):
            note(line)
        for warning in found["warnings"]:
            note(f"note: {warning}")
        wrote(found["files"])


@contextmanager
def _radiances_kept(file: Path) -> Iterator[None]:
    """Keeps the radiances in a file if a sensor fails."""
    from thzcl.errors import NumbersError

    try:
        yield
    except NumbersError as failure:
        failure.result.save(file)
        kept = f"{failure}; the radiances are kept in {file}"
        raise NumbersError(kept, failure.result) from failure


def _write(result: Result, file: Path, figure: bool, tell: Progress) -> list[Path]:
    """Writes the files of a result, and adds to its seconds how long that took."""
    start = time.perf_counter()
    tell("file")
    files = [result.save(file)]
    result.seconds["file"] = time.perf_counter() - start
    if figure:
        tell("figure")
        files.append(result.figure(file.with_suffix(f".{result.picture_format}")))
        result.seconds["figure"] = time.perf_counter() - start - result.seconds["file"]
    return files


def tables(found: dict[str, Any]) -> list[Table]:
    """Returns the summary of a result as tables."""
    from thzcl.commands.tables import Column, Table

    return [
        _targets(found),
        _models(found["variants"]),
        _facts(found["variants"]),
        Table(
            "", (Column("stage"), Column("seconds", form=".3f")), tuple(found["seconds"].items())
        ),
        Table(
            "",
            (Column("left out"), Column("why")),
            tuple((item["stage"], item["reason"]) for item in found["left_out"]),
        ),
        _budget(found["error_budget"]),
    ]


def _targets(found: dict[str, Any]) -> Table:
    from thzcl.commands.tables import Column, Table
    from thzcl.results.summary import by_frequency, seeds_in_words, two_ways

    columns = (
        Column("variant"),
        Column("frequency", "GHz", "g"),
        Column("target"),
        Column("pixels"),
        Column("contrast to air", "K", "+.5g"),
        Column("spread", "K", ".3g"),
        Column("optical depth", form=".4g"),
        Column("transmission", form=".4g"),
        Column("path of light"),
    )
    keys = ("pixels", "mean_contrast_k", "std_k", "optical_depth", "transmission")
    rows = tuple(
        (variant["name"], ghz, target, *(values[key] for key in keys), two_ways(variant))
        for variant in found["variants"]
        for ghz, targets in by_frequency(variant)
        for target, values in targets.items()
    )
    seeds = seeds_in_words(found["seed"], found["noise_seed"])
    return Table(f"{found['scenario']}, {seeds}", columns, rows, keys=3)


def _models(variants: list[dict[str, Any]]) -> Table:
    from thzcl.commands.tables import Column, Table
    from thzcl.results.summary import by_model, two_ways

    columns = (
        Column("variant"),
        Column("frequency", "GHz", "g"),
        Column("target"),
        Column("by model"),
        Column("contrast to air", "K", "+.5g"),
        Column("optical depth", form=".4g"),
        Column("transmission", form=".4g"),
        Column("path of light"),
    )
    keys = ("mean_contrast_k", "optical_depth", "transmission")
    rows = tuple(
        (variant["name"], ghz, target, model, *(values[key] for key in keys), two_ways(variant))
        for variant in variants
        for ghz, target, model, values in by_model(variant)
    )
    return Table("", columns, rows, keys=4)


def _facts(variants: list[dict[str, Any]]) -> Table:
    from thzcl.commands.tables import Column, Table

    columns = (Column("variant"), Column("of its image"), Column("value", form=".5g"))
    rows = tuple(
        (variant["name"], name, fact["value"], "" if fact["unit"] == "1" else fact["unit"])
        for variant in variants
        for name, fact in variant["facts"].items()
    )
    return Table("", (*columns, Column("unit")), rows, keys=2)


def _budget(errors: dict[str, dict[str, Any]]) -> Table:
    from thzcl.commands.tables import Column, Table

    columns = (
        Column("error of"),
        Column("rms", form=".2g"),
        Column("max", form=".2g"),
        Column("unit"),
        Column("rms over contrast", form=".2g"),
    )
    rows = tuple(
        (part, error["rms"], error["max"], error["unit"], error.get("relative"))
        for part, error in errors.items()
    )
    return Table("", columns, rows)
