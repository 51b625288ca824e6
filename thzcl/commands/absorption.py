"""`thzcl absorption`: absorption spectra of moist air."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thzcl.commands.options import HowTable, TableFormat
from thzcl.errors import UsageError

if TYPE_CHECKING:
    from thzcl.air.spectrum import Record


def absorption(
    frequency_ghz: Annotated[
        str | None,
        typer.Option(metavar="F", help="GHz: a value, a list a,b,c or a range start:stop:step"),
    ] = None,
    temperature_k: Annotated[
        str, typer.Option(metavar="T", help="K: a value, a list or a range")
    ] = "288.15",
    pressure_hpa: Annotated[float, typer.Option(metavar="P", help="total pressure, hPa")] = 1013.25,
    relative_humidity_percent: Annotated[
        float | None, typer.Option(metavar="U", help="% of saturation over water")
    ] = None,
    absolute_humidity_g_m3: Annotated[
        float | None, typer.Option(metavar="RHO", help="g/m3")
    ] = None,
    vapour_pressure_hpa: Annotated[
        float | None, typer.Option(metavar="E", help="hPa; dry if no humidity is given")
    ] = None,
    model: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="a gas, as `thzcl constituents` lists them; may be repeated; by default mpm93",
        ),
    ] = None,
    validation: Annotated[
        bool,
        typer.Option("--validation", help="all models in four climates, and what was measured"),
    ] = False,
    how: HowTable = TableFormat.table,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="write a picture (PNG) as well")
    ] = None,
) -> None:
    """Print the absorption of moist air, by one model or several."""
    from thzcl.commands.terminal import complain

    humidities = {
        "relative_humidity_percent": relative_humidity_percent,
        "absolute_humidity_g_m3": absolute_humidity_g_m3,
        "vapour_pressure_hpa": vapour_pressure_hpa,
    }
    if figure is not None and figure.suffix.lower() != ".png":
        raise UsageError(f"--figure {figure}: the picture is a PNG; let its name end in .png")
    if validation:
        if frequency_ghz is not None or model or any(v is not None for v in humidities.values()):
            text = "--validation has models, frequencies and air of its own; give no others"
            raise UsageError(text)
        _validation(how, figure)
        return
    if frequency_ghz is None:
        raise UsageError("give --frequency-ghz F, or --validation")
    rows, notes = _spectra(
        (frequency_ghz, temperature_k), pressure_hpa, model or ["mpm93"], _humidity(**humidities)
    )
    _show(rows, how, figure)
    complain([f"note: {note}" for note in notes])


def _spectra(
    given: tuple[str, str], pressure_hpa: float, models: list[str], moist: tuple[str, float]
) -> tuple[list[Record], list[str]]:
    """Returns the records of one model or several, and notes on them.

    `given` are frequencies in GHz and temperatures in K.
    """
    from thzcl.air import spectrum
    from thzcl.scenario.constituents import gas

    twice = next((name for name in models if models.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--model {twice}: is there already; name each model once")
    try:
        ghz, kelvin = (spectrum.values(text) for text in given)
        gases = [gas(name) for name in models]
        if len(gases) > 1:
            return spectrum.by_model(ghz, kelvin, pressure_hpa, gases, *moist)
        rows = spectrum.records(ghz, kelvin, pressure_hpa, gases[0], *moist)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return rows, spectrum.notes(ghz, kelvin, pressure_hpa, gases[0])


def _show(rows: list[Record], how: TableFormat, figure: Path | None) -> None:
    """Prints records, and draws them if asked to."""
    from thzcl.air import spectrum_figure
    from thzcl.commands.tables import as_csv, as_records, from_records, show, show_json
    from thzcl.files import write_whole

    if figure is not None:
        write_whole(figure, lambda part: spectrum_figure.draw(rows, part))
    table = from_records(rows, form=".6g", keys=3 if "model" in rows[0] else 2)
    if how is TableFormat.json:
        show_json({"records": as_records(table)})
    elif how is TableFormat.csv:
        print(as_csv(table), end="")
    else:
        show(table)


def _validation(how: TableFormat, figure: Path | None) -> None:
    """Prints what is known of which model is true; CSV holds the models in the windows alone."""
    from thzcl.air import spectrum_figure, validation
    from thzcl.commands.tables import Column, Table, as_csv, from_records, show, show_json
    from thzcl.files import write_whole

    if figure is not None:
        panels = list(validation.spectra().items())
        write_whole(figure, lambda part: spectrum_figure.climates(panels, part))
    windows, continua = validation.windows(), validation.continua()
    table = from_records(windows, form=".4g", keys=2)
    if how is TableFormat.csv:
        print(as_csv(table), end="")
        return
    if how is TableFormat.json:
        measured = [one._asdict() for one in validation.MEASURED]
        found = {"windows": windows, "continua": continua, "measured": measured}
        show_json(found | {"missing": list(validation.MISSING)})
        return
    words = (Column("published"), Column("found"), Column("says of the models"))
    missing = tuple((what,) for what in validation.MISSING)
    show(
        replace(table, title="attenuation, dB/km"),
        replace(from_records(continua, form=".4g"), title=validation.CONTINUUM),
        Table("what was measured", words, tuple(validation.MEASURED)),
        Table("", (Column("could not be had"),), missing),
    )


def _humidity(**given: float | None) -> tuple[str, float]:
    """Returns the one humidity that is given, by name; without one, air is dry."""
    humidities = {name: amount for name, amount in given.items() if amount is not None}
    if len(humidities) > 1:
        names = " or ".join(f"--{name.replace('_', '-')}" for name in humidities)
        raise UsageError(f"give only one humidity: {names}")
    return next(iter(humidities.items()), ("vapour_pressure_hpa", 0.0))
