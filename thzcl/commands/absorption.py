"""`thzcl absorption`: spectra of what moist air, rain, fog and snow absorb and scatter."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thzcl.commands.options import HowTable, TableFormat
from thzcl.errors import UsageError

if TYPE_CHECKING:
    from thzcl.air.composition import Part
    from thzcl.air.spectrum import Array, Record, States

# What falls: the option that says how much, and the key of which constituent it is.
WEATHER = {
    "--rain-mm-h": ("rain", "rate_mm_h"),
    "--fog-g-m3": ("fog", "liquid_water_g_m3"),
    "--fog-visibility-m": ("fog", "visibility_m"),
    "--snow-mm-h": ("snow", "rate_mm_h"),
}
DROP_SIZES = "--drop-sizes"


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
    rain_mm_h: Annotated[float | None, typer.Option(metavar="R", help="rain rate, mm/h")] = None,
    drop_sizes: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="law of drop sizes, as `constituents rain` has"),
    ] = None,
    fog_g_m3: Annotated[
        float | None, typer.Option(metavar="W", help="liquid water of fog, g/m3")
    ] = None,
    fog_visibility_m: Annotated[
        float | None, typer.Option(metavar="V", help="how far one sees in fog, m")
    ] = None,
    snow_mm_h: Annotated[
        float | None, typer.Option(metavar="S", help="snow rate as melted water, mm/h")
    ] = None,
    how: HowTable = TableFormat.table,
    figure: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="write a picture as well: .png, .pdf or .svg"),
    ] = None,
) -> None:
    """Print what moist air absorbs, by one model or several, and what rain, fog and snow add."""
    from thzcl.commands.terminal import complain

    humidities = {
        "relative_humidity_percent": relative_humidity_percent,
        "absolute_humidity_g_m3": absolute_humidity_g_m3,
        "vapour_pressure_hpa": vapour_pressure_hpa,
    }
    if figure is not None:
        from thzcl.results.figure import picture_format

        picture_format(figure)  # before anything is computed
    amounts = dict(zip(WEATHER, (rain_mm_h, fog_g_m3, fog_visibility_m, snow_mm_h), strict=True))
    if validation:
        others = (frequency_ghz, model, drop_sizes, *humidities.values(), *amounts.values())
        if any(value is not None for value in others):
            text = "--validation has models, frequencies and air of its own; give no others"
            raise UsageError(text)
        _validation(how, figure)
        return
    if frequency_ghz is None:
        raise UsageError("give --frequency-ghz F, or --validation")
    weather = _weather(amounts, drop_sizes)
    given = {"--frequency-ghz": frequency_ghz, "--temperature-k": temperature_k}
    states = _states(given, pressure_hpa, _humidity(**humidities))
    rows, notes = _spectra(states, model or ["mpm93"], weather)
    _show(rows, how, figure)
    complain([f"note: {note}" for note in notes])


def _states(given: dict[str, str], pressure_hpa: float, moist: tuple[str, float]) -> States:
    """Returns the states of the air; `given` are frequencies in GHz and temperatures in K."""
    from thzcl.air import spectrum

    ghz, kelvin = (_numbers(option, text) for option, text in given.items())
    for end in (float(kelvin.min()), float(kelvin.max())):
        _held_to_the_limits_of_scenes(end, pressure_hpa, *moist)
    try:
        return spectrum.states(ghz, kelvin, pressure_hpa, *moist)
    except ValueError as error:
        raise UsageError(str(error)) from None


def _numbers(option: str, text: str) -> Array:
    """Returns what an option's text holds."""
    from thzcl.air import spectrum

    try:
        return spectrum.values(text)
    except ValueError as error:
        raise UsageError(f"{option}: {error}") from None


def _held_to_the_limits_of_scenes(
    temperature_k: float, pressure_hpa: float, humidity: str, amount: float
) -> None:
    """Raises UsageError for air that a scene's [atmosphere] could not have.

    A vapour pressure, for which scenes have no key, is held to the total by what computes with it.
    """
    from thzcl.scenario.atmosphere import Atmosphere
    from thzcl.scenario.problems import validate

    air = {"temperature_k": temperature_k, "pressure_hpa": pressure_hpa}
    known = humidity in Atmosphere.model_fields
    air |= {humidity: amount} if known else {"relative_humidity_percent": 0.0}
    _, troubles = validate(Atmosphere, air)
    if troubles:
        options = ((str(one.path[0]).replace("_", "-"), one.text) for one in troubles)
        raise UsageError("; ".join(f"--{option}: {text}" for option, text in options))


def _spectra(
    states: States, models: list[str], weather: list[Part]
) -> tuple[list[Record], list[str]]:
    """Returns the records of one model or several, and notes on them."""
    from thzcl.air import spectrum
    from thzcl.scenario.constituents import gas

    twice = next((name for name in models if models.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--model {twice}: is there already; name each model once")
    try:
        gases = [gas(name) for name in models]
        if len(gases) > 1:
            return spectrum.by_model(states, gases, weather)
        rows = spectrum.records(states, gases[0], weather)
    except ValueError as error:
        raise UsageError(str(error)) from None
    return rows, spectrum.notes(states, [*gases, *weather])


def _show(rows: list[Record], how: TableFormat, figure: Path | None) -> None:
    """Prints records, and draws them if asked to."""
    from thzcl.air import spectrum_figure
    from thzcl.commands.tables import as_csv, as_records, from_records, show, show_json
    from thzcl.files import write_whole
    from thzcl.results.figure import picture_format

    if figure is not None:
        form = picture_format(figure)
        write_whole(figure, lambda part: spectrum_figure.draw(rows, part, form))
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
    from thzcl.results.figure import picture_format

    if figure is not None:
        panels = list(validation.spectra().items())
        form = picture_format(figure)
        write_whole(figure, lambda part: spectrum_figure.climates(panels, part, form))
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


def _weather(amounts: dict[str, float | None], drop_sizes: str | None) -> list[Part]:
    """Returns what falls, by the options that are given."""
    from thzcl.scenario.constituents import other

    given = {option: amount for option, amount in amounts.items() if amount is not None}
    tables: dict[str, dict[str, Any]] = {}
    for option, amount in given.items():
        name, key = WEATHER[option]
        if name in tables:
            raise UsageError("give only one of --fog-g-m3 and --fog-visibility-m")
        tables[name] = {key: amount}
    options = {WEATHER[option]: option for option in given}
    if drop_sizes is not None:
        if "rain" not in tables:
            raise UsageError(f"{DROP_SIZES} {drop_sizes}: whose? give --rain-mm-h too")
        if drop_sizes == "file":
            raise UsageError(f"{DROP_SIZES} file: a file is named in a scenario; give a law's name")
        tables["rain"]["drop_sizes"] = drop_sizes
        options["rain", "drop_sizes"] = DROP_SIZES
    found = []
    for name, table in tables.items():
        made = other(name, table)
        if isinstance(made, list):
            keys = [(name, str(trouble.path[0])) for trouble in made]
            texts = [trouble.text for trouble in made]
            raise UsageError(
                "; ".join(f"{options[key]}: {text}" for key, text in zip(keys, texts, strict=True))
            )
        found.append(made)
    return found
