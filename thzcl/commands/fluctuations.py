"""`thzcl fluctuations`: how humidity fluctuates in a hygrometer's record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from thzcl.commands.options import HowRecord, RecordFormat
from thzcl.errors import UsageError

if TYPE_CHECKING:
    from thzcl.commands.tables import Table


def fluctuations(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FILE...", help="TOA5, CSV or GHG; several join where contiguous"),
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
    how: HowRecord = RecordFormat.table,
) -> None:
    """Tell how humidity fluctuates in a hygrometer's record: spectrum, constants and scales."""
    from thzcl.commands.tables import show, show_json
    from thzcl.commands.terminal import note, wrote
    from thzcl.records.study import study, study_virtual

    if bool(files) == bool(virtual):
        raise UsageError("give a hygrometer's FILE, or --virtual and a scenario")
    found = (
        study_virtual(virtual, output, scene)
        if virtual
        else study(files or [], columns, output, scene)
    )
    if how is RecordFormat.json:
        show_json(found)
        return
    show(table(found))
    for text in found["notes"]:
        note(f"note: {text}")
    wrote(found.get("files", ()))


def table(found: dict[str, Any]) -> Table:
    """Returns what a hygrometer's record tells as a table."""
    from thzcl.commands.tables import Column, Table

    rows = (*_record(found), *_humidity(found), *_temperature(found))
    columns = (Column(""), Column("value", right=True), Column(""))
    return Table(", ".join(found["records"]), columns, rows)


def _record(found: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Returns rows that tell what a record is like."""
    rate = f"{found['rate_hz']:g} a second, {found['duration_s']:.6g} s"
    order = f"{found['repeats']} repeated stamps, {found['out_of_order']} out of order"
    by_column = ", ".join(
        f"{count} in {name}" for name, count in found["spikes_by_column"].items() if count
    )
    limits = " or ".join(
        f"{t['typical_steps']:g} (median of {t['median_of']})" for t in found["spike_thresholds"]
    )
    off = f"off the running median by {limits} typical steps"
    run = f"m/s, a wind run of {found['wind_run_m']:.5g} m"
    return [
        ("samples", f"{found['samples']}", rate),
        ("gaps", f"{found['gaps']}", order),
        ("spikes", f"{found['spikes']}", "; ".join(filter(None, [by_column, off]))),
        ("mean wind", f"{found['wind_speed_m_s']:.4g}", run),
    ]


def _humidity(found: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Returns rows that tell how humidity fluctuates."""
    low, high = found["inertial_range_cycles_per_m"]
    near, far = found["structure_function_range_m"]
    spread = f"g/m3, {found['sigma_percent']:.4g} % of the mean; before detrending"
    from_function = found["structure_constant_q_from_structure_function"]
    difference = (
        f"of the structure function, {near:.3g} to {far:.3g} m: {found['agreement_percent']:+.1f} %"
    )
    return [
        ("mean humidity", f"{found['mean_g_m3']:.5g}", "g/m3"),
        ("sigma", f"{found['sigma_g_m3']:.4g}", spread),
        ("inertial range", f"{low:.3g} to {high:.3g}", "cycles/m"),
        (
            "slope there",
            f"{found['slope']:.3f}",
            f"+- {found['slope_uncertainty']:.3f}; -1.667 by theory",
        ),
        ("C_q^2", f"{found['structure_constant_q']:.4g}", "g^2 m^-6 m^-2/3, of the spectrum"),
        ("C_q^2", f"{from_function:.4g}", difference),
        ("integral scale", f"{found['integral_scale_m']:.4g}", "m"),
        ("outer scale", f"{found['outer_scale_m']:.4g}", "m, of a von Karman spectrum"),
    ]


def _temperature(found: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Returns rows that tell how temperature fluctuates, if the record has it."""
    if found["structure_constant_t"] is None:
        return []
    sonic = "K^2 m^-2/3, of sonic temperature corrected for humidity"
    return [
        ("C_T^2", f"{found['structure_constant_t']:.4g}", sonic),
        ("correlation", f"{found['correlation_tq']:.3f}", "of temperature and humidity"),
    ]
