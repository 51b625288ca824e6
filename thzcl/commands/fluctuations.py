"""`thzcl fluctuations`: how humidity fluctuates in a hygrometer's record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thzcl.commands.options import HowRecord, RecordFormat
from thzcl.errors import UsageError

if TYPE_CHECKING:
    from thzcl.commands.tables import Table

Row = tuple[str, str, str]


def fluctuations(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="FILE...", help="TOA5, CSV, text or GHG, zipped or not; several join"
        ),
    ] = None,
    columns: Annotated[
        str,
        typer.Option(metavar="ROLE=NAME:UNIT,...", help="columns, where their names do not tell"),
    ] = "",
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="draw figures there")
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(metavar="OUT.toml", help="write a scene in this air, ready to run"),
    ] = None,
    virtual: Annotated[
        str,
        typer.Option(
            metavar="SCENARIO", help="a record made in this scene's air, in place of files"
        ),
    ] = "",
    batch_minutes: Annotated[
        float | None, typer.Option(metavar="M", help="length of a batch; 60 if not given")
    ] = None,
    height_m: Annotated[
        float | None, typer.Option(metavar="Z", help="the sensor's height above ground")
    ] = None,
    rate_hz: Annotated[
        float | None,
        typer.Option(metavar="R", help="samples a second, where there are no fine stamps"),
    ] = None,
    pressure_hpa: Annotated[
        float | None, typer.Option(metavar="P", help="air pressure, where the record has none")
    ] = None,
    second: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="another hygrometer's file; may be given several times"),
    ] = None,
    separation_m: Annotated[
        list[str] | None,
        typer.Option(
            metavar="D,...",
            help="how far away each --second, then h2o_2, or each virtual sensor stands",
        ),
    ] = None,
    how: HowRecord = RecordFormat.table,
) -> None:
    """Tell how humidity fluctuates in a hygrometer's record: spectrum, constants and scales."""
    from thzcl.commands.tables import show, show_json
    from thzcl.commands.terminal import note, wrote
    from thzcl.records import study

    if bool(files) == bool(virtual):
        raise UsageError("give a hygrometer's FILE, or --virtual and a scenario")
    _check_positive(
        batch_minutes=batch_minutes, height_m=height_m, rate_hz=rate_hz, pressure_hpa=pressure_hpa
    )
    apart = _separations(separation_m or [])
    asked = study.Asked(
        columns, batch_minutes, height_m, rate_hz, pressure_hpa, tuple(second or ()), apart
    )
    if virtual and second:
        raise UsageError("--second: virtual sensors are made by --separation-m alone")
    if virtual:
        found = study.study_virtual(virtual, output, scene, asked)
    else:
        record = study.read(files or [], asked)
        if how is not RecordFormat.json:
            show(understood(record.columns))
        found = study.analysed(record, output, scene, asked)
    if how is RecordFormat.json:
        show_json(found)
        return
    show(*tables(found))
    for text in found["notes"]:
        note(f"note: {text}")
    wrote(found.get("files", ()))


def _check_positive(**numbers: float | None) -> None:
    """Raises UsageError if an option is given that is no positive number."""
    for name, value in numbers.items():
        if value is not None and not 0 < value < 1e9:
            option = name.replace("_", "-")
            raise UsageError(f"--{option} {value:g}: expected a positive number")


def _separations(texts: list[str]) -> tuple[float, ...]:
    """Returns separations in m. Raises UsageError if one is no positive number."""
    found = []
    for text in ",".join(texts).split(",") if texts else ():
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0 < value < 1e6:
            raise UsageError(f'--separation-m "{text}": expected a positive number of metres')
        found.append(value)
    return tuple(found)


def understood(columns: tuple[dict[str, Any], ...]) -> Table:
    """Returns what was found in a file, and how each column was understood."""
    from thzcl.commands.tables import Column, Table

    rows = tuple(
        (
            column["column"],
            column["role"],
            column["unit"] + (" (assumed)" if column["assumed"] else ""),
            "left out" if column["present"] is None and "time" not in column["role"]
            else "" if column["present"] is None else f"{column['present']}",
            "" if column["mean"] is None else f"{column['mean']:.5g}",
        )
        for column in columns
    )  # fmt: skip
    heads = (Column("column"), Column("taken as"), Column("in"), Column("values", right=True))
    return Table("columns found", (*heads, Column("mean, SI or g/m3", right=True)), rows)


def tables(found: dict[str, Any]) -> list[Table]:
    """Returns what a hygrometer's record tells as tables: all of it, and by batch."""
    by_batch = [_batches(found)] if len(found["batch_statistics"]) > 1 else []
    return [table(found), *by_batch, *([_pairs(found)] if found["pairs"] else [])]


def table(found: dict[str, Any]) -> Table:
    """Returns what a hygrometer's record tells as a table."""
    from thzcl.commands.tables import Column, Table

    rows = (*_record(found), *_humidity(found), *_temperature(found), *_surface(found))
    columns = (Column(""), Column("value", right=True), Column(""))
    return Table(", ".join(found["records"]), columns, rows)


def _batches(found: dict[str, Any]) -> Table:
    """Returns a row for each batch."""
    from thzcl.commands.tables import Column, Table

    columns = (
        Column("start"), Column("duration", "s", ".6g"), Column("mean", "g/m3", ".4g"),
        Column("sigma", "g/m3", ".3g"), Column("C_q^2", "", ".3g"), Column("+-", "", ".2g"),
        Column("slope", "", ".3f"), Column("wind", "m/s", ".3g"), Column("T", "K", ".2f"),
        Column("gaps"),
    )  # fmt: skip
    keys = ("start", "duration_s", "mean_g_m3", "sigma_g_m3", "structure_constant_q",
            "structure_constant_q_uncertainty", "slope", "wind_speed_m_s", "mean_temperature_k",
            "gaps")  # fmt: skip
    rows = tuple(tuple(batch[key] for key in keys) for batch in found["batch_statistics"])
    return Table("by batch, C_q^2 in (g/m3)^2 m^-2/3", columns, rows)


def _pairs(found: dict[str, Any]) -> Table:
    """Returns a row for each other sensor, with Taylor's curve of the first beside it."""
    from thzcl.commands.tables import Column, Table

    columns = (
        Column("second sensor"), Column("away", "m", "g"), Column("wind"),
        Column("covariance", "", ".3g"), Column("+-", "", ".2g"),
        Column("covariance by Taylor", "", ".3g"), Column("correlation", "", ".3f"),
        Column("D(r)", "", ".3g"), Column("+-", "", ".2g"), Column("D(r) by Taylor", "", ".3g"),
        Column("C_q^2", "", ".3g"),
    )  # fmt: skip
    rows = tuple(
        (
            Path(pair["second"]).name, pair["separation_m"], pair["direction"],
            pair["covariance_g2_m6"], pair["uncertainty"].get("covariance_g2_m6"),
            pair["taylor_covariance_g2_m6"], pair["correlation"],
            pair["structure_function_g2_m6"], pair["uncertainty"].get("structure_function_g2_m6"),
            pair["taylor_structure_function_g2_m6"], pair["structure_constant_q"],
        )
        for pair in found["pairs"]
    )  # fmt: skip
    return Table("two sensors, (g/m3)^2, C_q^2 in (g/m3)^2 m^-2/3; noise taken off", columns, rows)


def _record(found: dict[str, Any]) -> list[Row]:
    """Returns rows that tell what a record is like."""
    rate = f"{found['rate_hz']:g} a second, {found['duration_s']:.6g} s"
    order = f"{found['repeats']} repeated stamps, {found['out_of_order']} out of order"
    by_column = ", ".join(
        f"{count} in {name}" for name, count in found["spikes_by_column"].items() if count
    )
    limits = " or ".join(
        f"{t['typical_steps']:g} (of {t['samples']})" for t in found["spike_thresholds"]
    )
    off = f"off their neighbours by {limits} typical steps of their minute"
    run = f"m/s, a wind run of {found['wind_run_m']:.5g} m"
    return [
        ("samples", f"{found['samples']}", rate),
        ("gaps", f"{found['gaps']}", order),
        ("spikes", f"{found['spikes']}", "; ".join(filter(None, [by_column, off]))),
        ("mean wind", f"{found['wind_speed_m_s']:.4g}", run),
        ("sweeping speed", f"{found['sweeping_speed_m_s']:.4g}", "m/s, <|u|^(2/3)>^(3/2)"),
    ]


def _with(found: dict[str, Any], key: str) -> str:
    """Returns the uncertainty of a key as text, or none."""
    own = found["uncertainty"].get(key)
    return "" if own is None else f"+- {own:.2g}; "


def _humidity(found: dict[str, Any]) -> list[Row]:
    """Returns rows that tell how humidity fluctuates."""
    spread = (
        f"{_with(found, 'sigma_g_m3')}g/m3, {found['sigma_percent']:.4g} % of the mean; before "
        f"detrending; {found['sigma_within_g_m3']:.4g} within batches"
    )
    steady = "% by Foken and Wichura 1996; up to 30 % is steady"
    return [
        ("mean humidity", f"{found['mean_g_m3']:.5g}", f"{_with(found, 'mean_g_m3')}g/m3"),
        ("sigma", f"{found['sigma_g_m3']:.4g}", spread),
        *_constants(found),
        ("integral scale", f"{found['integral_scale_m']:.4g}", "m"),
        *(
            [("outer scale", f"{found['outer_scale_m']:.4g}", "m, of a von Karman spectrum")]
            if found["outer_scale_m"] is not None
            else []
        ),
        ("unsteadiness", f"{found['stationarity_percent']:.3g}", steady),
    ]


def _constants(found: dict[str, Any]) -> list[Row]:
    """Returns rows of slope and structure constants."""
    slope = ("slope", f"{found['slope']:.3f}",
             f"+- {found['slope_uncertainty']:.3f}; -1.667 by theory")  # fmt: skip
    if found["structure_constant_q"] is None:
        return [("inertial range", "none", "see the notes"), slope]
    low, high = found["inertial_range_cycles_per_m"]
    unit = "g^2 m^-6 m^-2/3, of the spectrum"
    thirds = ", ".join(
        "-" if t is None else f"{t:.3g}" for t in found["structure_constant_q_thirds"]
    )
    rows = [
        ("inertial range", f"{low:.3g} to {high:.3g}", "cycles/m"),
        slope,
        ("C_q^2", f"{found['structure_constant_q']:.4g}",
         f"{_with(found, 'structure_constant_q')}{unit}"),
        ("of thirds", thirds, ""),
    ]  # fmt: skip
    from_function = found["structure_constant_q_from_structure_function"]
    if from_function is not None:
        near, far = found["structure_function_range_m"]
        own = _with(found, "structure_constant_q_from_structure_function")
        told = f"{own}of the structure function, {near:.3g} to {far:.3g} m: "
        told += f"{found['agreement_percent']:+.1f} %"
        rows.append(("C_q^2", f"{from_function:.4g}", told))
    return rows


def _temperature(found: dict[str, Any]) -> list[Row]:
    """Returns rows that tell how temperature fluctuates, if the record has it."""
    rows = []
    if found["structure_constant_t"] is not None:
        told = f"{_with(found, 'structure_constant_t')}K^2 m^-2/3, of air temperature"
        rows.append(("C_T^2", f"{found['structure_constant_t']:.4g}", told))
    if found["c_tq"] is not None:
        told = f"{_with(found, 'c_tq')}K g/m3 m^-2/3"
        rows.append(("C_Tq", f"{found['c_tq']:.4g}", told))
    if found["correlation_tq"] is not None:
        told = "of temperature and humidity, all scales"
        rows.append(("correlation", f"{found['correlation_tq']:.3f}", told))
    if found["correlation_tq_inertial"] is not None:
        told = f"{_with(found, 'correlation_tq_inertial')}in the inertial range"
        rows.append(("", f"{found['correlation_tq_inertial']:.3f}", told))
    return rows


def _surface(found: dict[str, Any]) -> list[Row]:
    """Returns rows of friction velocity and Obukhov length, if the record has them."""
    if found["obukhov_length_m"] is None:
        return []
    over = "" if found["z_over_l"] is None else f"; z/L = {found['z_over_l']:.3g}"
    return [
        ("friction velocity", f"{found['friction_velocity_m_s']:.3g}", "m/s"),
        ("Obukhov length", f"{found['obukhov_length_m']:.4g}", f"m{over}"),
    ]
