"""The commands; nothing but parsing and printing. What they need is imported when they run."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer

from thzcl.commands.options import (
    AllowOutside,
    DeviceChoice,
    Format,
    HowToPrint,
    HowToTabulate,
    HowToTell,
    RecordFormat,
    Settings,
    Source,
    TableFormat,
    UsageError,
    Variants,
    changes,
    complain,
)

if TYPE_CHECKING:
    from thzcl.clock import Progress
    from thzcl.results.result import Result

app = typer.Typer(
    help="What will this terahertz imager see, through this air?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def _commands() -> None:
    # Typer makes a group of what has a callback, be there one command or many.
    pass


@app.command()
def run(
    scenario: Source,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="folder for the files")
    ] = Path(),
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    no_figure: Annotated[bool, typer.Option("--no-figure", help="write no picture")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")] = False,
    how: HowToPrint = Format.text,
) -> None:
    """Compute the images of a scenario: DIR/<scenario>.nc and DIR/<scenario>.png."""
    from thzcl.device import linker

    with linker.head_start(wanted=device is None) as helper:  # before the imports that take long
        from thzcl import pipeline
        from thzcl.commands import printing
        from thzcl.files import make_folder
        from thzcl.scenario import find

        file = output / f"{find(scenario).stem}.nc"
        make_folder(output)
        with printing.progress(quiet) as progress, _kept(file):
            result = pipeline.run(
                scenario,
                settings=changes(settings),
                variants=variant or (),
                device=device,
                figure=not no_figure,
                allow_outside=allow_outside,
                progress=progress,
                helper=helper,
            )
            files = _write(result, file, not no_figure, progress)
    if quiet and how is Format.text:
        return
    found = result.summary() | {"files": [str(file) for file in files]}
    if how is Format.json:
        print(json.dumps(found, indent=2))
    else:
        printing.summary(found)


@contextmanager
def _kept(file: Path) -> Iterator[None]:
    """Keeps the radiances in a file where a sensor fails."""
    from thzcl.plan.checks import NumbersError

    try:
        yield
    except NumbersError as failure:
        failure.result.save(file)
        raise NumbersError(
            f"{failure}; the radiances are kept in {file}", failure.result
        ) from failure


def _write(result: Result, file: Path, figure: bool, progress: Progress) -> list[Path]:
    """The files of a result, and how long they took."""
    start = time.perf_counter()
    progress("file")
    files = [result.save(file)]
    result.seconds["file"] = time.perf_counter() - start
    if figure:
        progress("figure")
        files.append(result.figure(file.with_suffix(".png")))
        result.seconds["figure"] = time.perf_counter() - start - result.seconds["file"]
    return files


@app.command()
def check(
    scenario: Source,
    settings: Settings = None,
    variant: Variants = None,
    allow_outside: AllowOutside = False,
) -> None:
    """Validate a scenario, and report every problem at once."""
    from thzcl import pipeline

    found = pipeline.prepare(
        scenario, changes(settings), variant or (), allow_outside=allow_outside
    )
    print(
        f"{found.scenario.name}: sound, {len(found.variants)} image{'s' * (len(found.variants) > 1)}"
    )


@app.command()
def plan(
    scenario: Source,
    settings: Settings = None,
    variant: Variants = None,
    allow_outside: AllowOutside = False,
    how: HowToPrint = Format.text,
) -> None:
    """Show which stages a scenario needs, which are left out and why, memory and work.

    Compute nothing.
    """
    from thzcl import pipeline
    from thzcl.commands import printing
    from thzcl.plan import report as overview

    found = overview.as_json(
        pipeline.prepare(scenario, changes(settings), variant or (), allow_outside=allow_outside)
    )
    if how is Format.json:
        print(json.dumps(found, indent=2))
    else:
        printing.plan(found)


@app.command()
def bench(
    scenario: Annotated[str, typer.Argument(metavar="[SCENARIO]", help="as for run")] = "slide",
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    repeat: Annotated[int, typer.Option(metavar="N", min=1, help="runs to take the median of")] = 7,
    how: HowToTabulate = TableFormat.table,
) -> None:
    """Measure the throughput of every stage on this device, and how much of the possible it is."""
    from thzcl.commands import printing
    from thzcl.studies import bench as benchmark

    with printing.progress(quiet=False) as progress:
        found = benchmark.bench(
            scenario,
            settings=changes(settings),
            variants=variant or (),
            device=device,
            allow_outside=allow_outside,
            repeat=repeat,
            progress=progress,
        )
    if how is TableFormat.json:
        print(json.dumps(found, indent=2))
    elif how is TableFormat.csv:
        printing.as_csv(benchmark.flat(found))
    else:
        printing.bench(found, benchmark.flat(found))


@app.command()
def absorption(
    frequency_ghz: Annotated[
        str, typer.Option(metavar="F", help="GHz: a value, a list a,b,c or a range start:stop:step")
    ],
    temperature_k: Annotated[
        str, typer.Option(metavar="T", help="K: a value, a list or a range")
    ] = "288.15",
    pressure_hpa: Annotated[float, typer.Option(metavar="P", help="total pressure, hPa")] = 1013.25,
    relative_humidity_percent: Annotated[
        Optional[float], typer.Option(metavar="U", help="% of saturation over water")
    ] = None,
    absolute_humidity_g_m3: Annotated[
        Optional[float], typer.Option(metavar="RHO", help="g/m3")
    ] = None,
    vapour_pressure_hpa: Annotated[
        Optional[float], typer.Option(metavar="E", help="hPa; dry if no humidity is given")
    ] = None,
    model: Annotated[str, typer.Option(help="mpm93, mpm93-corrected or none")] = "mpm93",
    how: HowToTabulate = TableFormat.table,
    figure: Annotated[
        Optional[Path], typer.Option(metavar="FILE", help="write a picture (PNG) as well")
    ] = None,
) -> None:
    """Print the absorption of moist air."""
    from thzcl.air import spectrum
    from thzcl.files import write_whole

    given = {
        "relative_humidity_percent": relative_humidity_percent,
        "absolute_humidity_g_m3": absolute_humidity_g_m3,
        "vapour_pressure_hpa": vapour_pressure_hpa,
    }
    humidities = {name: amount for name, amount in given.items() if amount is not None} or {
        "vapour_pressure_hpa": 0.0
    }
    if len(humidities) > 1:
        raise UsageError(
            "give only one humidity: "
            + " or ".join(f"--{name.replace('_', '-')}" for name in humidities)
        )
    try:
        frequencies, temperatures = spectrum.values(frequency_ghz), spectrum.values(temperature_k)
        rows = spectrum.records(
            frequencies, temperatures, pressure_hpa, model, *next(iter(humidities.items()))
        )
    except ValueError as error:
        raise UsageError(str(error)) from None
    if figure is not None:
        write_whole(figure, lambda part: spectrum.figure(rows, part))
    _print_records(rows, how)
    if frequencies.max() > 1000:
        print(
            "note: MPM93 is stated to 1000 GHz; beyond, absorption is an extrapolation",
            file=sys.stderr,
        )


def _print_records(rows: list[dict[str, float]], how: TableFormat) -> None:
    from thzcl.commands import printing

    if how is TableFormat.json:
        print(json.dumps({"records": rows}, indent=1))
    elif how is TableFormat.csv:
        printing.as_csv(rows)
    else:
        printing.table(
            "", list(rows[0]), [[f"{value:.6g}" for value in row.values()] for row in rows]
        )


@app.command()
def convergence(
    scenario: Source,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="folder for the files")
    ] = Path(),
    knobs: Annotated[
        str,
        typer.Option(
            metavar="A,B,...", help="only these knobs; all that make a difference if absent"
        ),
    ] = "",
    repeat: Annotated[
        int,
        typer.Option(
            min=1, metavar="N", help="timed runs of each setting, of which the median counts"
        ),
    ] = 5,
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    how: HowToTabulate = TableFormat.table,
) -> None:
    """Error against run time for every knob: DIR/<scenario>-convergence.png, .csv and .json.

    Interrupted, it goes on later.
    """
    from thzcl.commands import printing
    from thzcl.device.opencl import open_device
    from thzcl.files import make_folder
    from thzcl.studies.convergence import study
    from thzcl.studies.convergence.subject import Subject

    subject = Subject(
        scenario, changes(settings), variant or (), open_device(device), allow_outside
    )
    wanted = [name.strip() for name in knobs.split(",") if name.strip()]
    make_folder(output)
    with printing.progress(quiet=False) as progress:
        found = study(subject, output, wanted, repeat, progress)
    if how is TableFormat.json:
        print(json.dumps(found, indent=2))
    elif how is TableFormat.csv:
        print(Path(found["files"][1]).read_text(encoding="utf-8"), end="")
    else:
        printing.convergence(found)


@app.command()
def stress(device: DeviceChoice = None, how: HowToTabulate = TableFormat.table) -> int:
    """Run the stiff and extreme cases, each against its reference."""
    from thzcl.commands import printing
    from thzcl.studies.stress import cases, examine

    with printing.progress(quiet=False) as progress:
        found = [outcome.record() for outcome in examine(cases(), device, progress)]
    failed = [case["name"] for case in found if not case["passed"]]
    if how is TableFormat.json:
        print(json.dumps({"cases": found}, indent=1))
    elif how is TableFormat.csv:
        printing.as_csv(found)
    else:
        printing.stress(found)
    return (
        complain([f"{len(failed)} of {len(found)} cases failed: {', '.join(failed)}"], 4)
        if failed
        else 0
    )


@app.command()
def fluctuations(
    files: Annotated[
        Optional[list[Path]],
        typer.Argument(metavar="FILE...", help="TOA5, CSV or GHG; several join where contiguous"),
    ] = None,
    columns: Annotated[
        str,
        typer.Option(metavar="ROLE=NAME:UNIT,...", help="columns, where their names do not tell"),
    ] = "",
    output: Annotated[
        Optional[Path], typer.Option("-o", "--output", metavar="DIR", help="draw figures there")
    ] = None,
    scene: Annotated[
        Optional[Path],
        typer.Option(metavar="OUT.toml", help="write a scene in this air, ready to run"),
    ] = None,
    virtual: Annotated[
        str,
        typer.Option(
            metavar="SCENARIO", help="a record made in this scene's air, in place of files"
        ),
    ] = "",
    how: HowToTell = RecordFormat.table,
) -> None:
    """Tell how humidity fluctuates in a hygrometer's record: spectrum, structure constants.

    Scales.
    """
    from thzcl.commands import printing
    from thzcl.records.study import study, study_virtual

    if bool(files) == bool(virtual):
        raise UsageError("give a hygrometer's FILE, or --virtual and a scenario")
    found = (
        study_virtual(virtual, output, scene)
        if virtual
        else study(files or [], columns, output, scene)
    )
    if how is RecordFormat.json:
        print(json.dumps(found, indent=2))
    else:
        printing.fluctuations(found)


@app.command()
def sensors(
    name: Annotated[
        Optional[str], typer.Argument(metavar="[NAME]", help="a sensor, for its manual page")
    ] = None,
) -> None:
    """List the sensors, or show one's manual page and parameters."""
    from thzcl.commands import printing
    from thzcl.plugins import loader as plugins

    if name is not None:
        page, rows = plugins.manual(name)
        print(page)
        printing.table(
            f'[sensor] kind = "{name}"', ["key", "unit", "default", "limits", "meaning"], rows
        )
        return
    rows = [
        [origin.name, origin.distribution, plugins.summary(origin)] for origin in plugins.origins()
    ]
    printing.table("", ["sensor", "from", ""], rows)


@app.command(name="new-sensor")
def new_sensor(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="name of the sensor, as [sensor] kind")
    ],
) -> None:
    """Write a package with a sensor of your own to start from: it installs and runs as it is."""
    from thzcl.plugins import newsensor

    folder = newsensor.write(name, Path())
    print(f"wrote {folder}; next: pip install ./{folder} && thzcl run {folder}/scene.toml")


@app.command()
def scenarios() -> None:
    """List the shipped scenes."""
    from thzcl.commands import printing
    from thzcl.scenario import shipped

    printing.table("", ["scene", ""], [[name, about] for name, about in shipped().items()])


@app.command()
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="the TOML file to write")],
) -> None:
    """Write a commented scene to start from."""
    from thzcl.files import write_whole
    from thzcl.scenario import SHIPPED

    if file.exists():
        raise UsageError(f"{file}: exists already; choose another name")
    text = (SHIPPED / "quick.toml").read_text(encoding="utf-8")
    write_whole(file, lambda part: part.write_text(text, encoding="utf-8"))
    print(f"wrote {file}; edit it, then: thzcl run {file}")


@app.command()
def schema() -> None:
    """Print the JSON Schema of scenarios, for editors."""
    from thzcl.plugins import loader as plugins

    print(json.dumps(plugins.scenario_schema(), indent=2))


@app.command()
def devices(how: HowToPrint = Format.text) -> None:
    """List the devices that OpenCL sees."""
    from thzcl.commands import doctor, printing

    found = doctor.devices()
    if how is Format.json:
        print(json.dumps({"devices": found}, indent=2))
        return
    rows = [
        [
            str(d["number"]),
            d["kind"],
            d["name"],
            d["platform"],
            d["driver"],
            f"{d['memory_bytes'] / 2**30:.1f}",
        ]
        for d in found
    ]
    printing.table("", ["device", "kind", "name", "platform", "driver", "memory / GiB"], rows)


@app.command(name="doctor")
def diagnose() -> int:
    """Look for what is missing on this machine, and name the command that mends it."""
    from thzcl.commands import doctor, printing

    findings = doctor.examine()
    rows = [
        [finding.subject, "fine" if finding.fine else "AMISS", finding.text] for finding in findings
    ]
    printing.table("", ["", "", ""], rows)
    return 0 if all(finding.fine for finding in findings) else 3
