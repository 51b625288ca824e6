"""`thzcl plan`: what a run would do, and what it would leave out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from thzcl.commands.options import (
    AllowOutside,
    HowText,
    Settings,
    Source,
    TextFormat,
    Variants,
    changes,
)

if TYPE_CHECKING:
    from thzcl.commands.tables import Table

MOST_FREQUENCIES = 8  # that are listed


def plan(
    scenario: Source,
    settings: Settings = None,
    variant: Variants = None,
    allow_outside: AllowOutside = False,
    how: HowText = TextFormat.text,
) -> None:
    """Show which stages a scenario needs, which are left out and why, memory and work.

    Nothing is computed.
    """
    from thzcl import pipeline
    from thzcl.commands.tables import show, show_json
    from thzcl.commands.terminal import note
    from thzcl.plan import report

    found = report.as_json(
        pipeline.prepare(scenario, changes(settings), variant or (), allow_outside=allow_outside)
    )
    if how is TextFormat.json:
        show_json(found)
        return
    show(*tables(found))
    for line in _notes(found):
        note(line)


def tables(found: dict[str, Any]) -> list[Table]:
    """Returns a plan's stages and numerics as tables."""
    from thzcl.commands.tables import Column, Table, from_records

    stages = tuple(
        (stage["name"], "needed" if stage["needed"] else "left out", stage["reason"])
        for stage in found["stages"]
    )
    columns = (Column("stage"), Column(""), Column("why"))
    settings = found["numerics"]
    same = all({**one, "variant": ""} == {**settings[0], "variant": ""} for one in settings)
    shown = [settings[0] | {"variant": "all"}] if same else settings
    spelled = [{name.replace("_", " "): value for name, value in one.items()} for one in shown]
    numerics = from_records(spelled)
    return [
        Table(found["scenario"], columns, stages),
        Table("numerics", numerics.columns, numerics.rows),
    ]


def _notes(found: dict[str, Any]) -> list[str]:
    """Returns the rest of a plan, in lines."""
    frequencies = found["frequencies_ghz"]
    band = ", ".join(f"{f:g}" for f in frequencies[:MOST_FREQUENCIES])
    rest = f", ... {frequencies[-1]:g}" if len(frequencies) > MOST_FREQUENCIES else ""
    error = f"at most {found['surrogate_error']:.1e} of the mean air's absorption"
    return [
        f"frequencies: {band}{rest} GHz",
        f"path moments: {found['moments']}",
        f"error of the absorption polynomial: {error}",
        f"voxels crossed: about {found['voxel_segments']:,}",
        f"memory at the peak: about {found['memory_bytes'] / 2**20:,.0f} MiB",
        *_refraction(found["refraction_left_out"]),
        *(f"note: {warning}" for warning in found["warnings"]),
    ]


def _refraction(left: dict[str, Any] | None) -> list[str]:
    if left is None:
        return []
    noise = f"{left['scintillation_db']:.2g} dB of scintillation"
    tilt = f"{left['tilt_urad']:.2g} microradians of tilt"
    path = f"{left['path_m']:.3g} m, aperture {left['aperture_m']:g} m"
    turbulence = f"C_n^2 {left['structure_constant_n']:.2g} m^-2/3"
    return [f"refraction, left out: {noise}, {tilt} ({path}, {turbulence})"]
