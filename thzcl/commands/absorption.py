"""`thzcl absorption`: absorption spectra of moist air."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from thzcl.commands.options import HowTable, TableFormat
from thzcl.errors import UsageError


def absorption(
    frequency_ghz: Annotated[
        str, typer.Option(metavar="F", help="GHz: a value, a list a,b,c or a range start:stop:step")
    ],
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
    model: Annotated[str, typer.Option(help="a gas, as `thzcl constituents` lists them")] = "mpm93",
    how: HowTable = TableFormat.table,
    figure: Annotated[
        Path | None, typer.Option(metavar="FILE", help="write a picture (PNG) as well")
    ] = None,
) -> None:
    """Print the absorption of moist air."""
    from thzcl.air import spectrum
    from thzcl.commands.tables import as_csv, as_records, from_records, show, show_json
    from thzcl.commands.terminal import complain
    from thzcl.files import write_whole
    from thzcl.scenario.constituents import gas

    humidity = _humidity(
        relative_humidity_percent=relative_humidity_percent,
        absolute_humidity_g_m3=absolute_humidity_g_m3,
        vapour_pressure_hpa=vapour_pressure_hpa,
    )
    try:
        frequencies, temperatures = spectrum.values(frequency_ghz), spectrum.values(temperature_k)
        rows = spectrum.records(frequencies, temperatures, pressure_hpa, gas(model), *humidity)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if figure is not None:
        if figure.suffix.lower() != ".png":
            raise UsageError(f"--figure {figure}: the picture is a PNG; let its name end in .png")
        write_whole(figure, lambda part: spectrum.figure(rows, part))
    table = from_records(rows, form=".6g", keys=2)
    if how is TableFormat.json:
        show_json({"records": as_records(table)})
    elif how is TableFormat.csv:
        print(as_csv(table), end="")
    else:
        show(table)
    notes = spectrum.notes(frequencies, temperatures, pressure_hpa, gas(model))
    complain([f"note: {note}" for note in notes])


def _humidity(**given: float | None) -> tuple[str, float]:
    """Returns the one humidity that is given, by name; without one, air is dry."""
    humidities = {name: amount for name, amount in given.items() if amount is not None}
    if len(humidities) > 1:
        names = " or ".join(f"--{name.replace('_', '-')}" for name in humidities)
        raise UsageError(f"give only one humidity: {names}")
    return next(iter(humidities.items()), ("vapour_pressure_hpa", 0.0))
