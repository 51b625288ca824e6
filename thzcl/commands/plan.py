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
        *_skies(found["sky"]),
        *_materials(found["materials"]),
        *_meshes(found["meshes"]),
    ]


def _meshes(rows: list[dict[str, Any]]) -> list[Table]:
    """Returns the meshes and the boxes around them in the world, alike ones in one row."""
    from thzcl.commands.tables import Column, Table

    def corner(point: list[float]) -> str:
        return ", ".join(f"{one:.4g}" for one in point)

    lines = {
        (
            row["target"],
            row["file"],
            row["triangles"],
            ", ".join(filter(None, row["parts"])),
            corner(row["low_m"]),
            corner(row["high_m"]),
        ): None
        for row in rows
    }
    names = "mesh", "file", "triangles", "parts"
    columns = *map(Column, names), Column("lowest x, y, z", "m"), Column("highest x, y, z", "m")
    return [Table("meshes in the world", columns, tuple(lines))] if lines else []


def _materials(rows: list[dict[str, Any]]) -> list[Table]:
    """Returns what things are made of, alike materials of variants in one row."""
    from thzcl.commands.tables import Column, Table

    if not rows:
        return []
    lines = {
        (row["material"], row["of"], row["roughness_mm"], ghz, part, share): None
        for row in rows
        for ghz, part, share in zip(
            row["frequency_ghz"], row["reflectivity"], row["mirrored_share"], strict=True
        )
    }
    columns = (
        Column("material"),
        Column("from"),
        Column("roughness", "mm", "g"),
        Column("frequency", "GHz", "g"),
        Column("reflectivity", "", ".4f"),
        Column("mirrored share", "", ".4f"),
    )
    return [Table("materials, at normal incidence", columns, tuple(lines))]


def _skies(skies: list[dict[str, Any]]) -> list[Table]:
    """Returns the sky by elevation of the variants that see one, alike ones in one table."""
    from thzcl.commands.tables import Column, Table

    alike: dict[str, list[str]] = {}
    for sky in skies:
        alike.setdefault(repr({**sky, "variant": ""}), []).append(sky["variant"])
    found = []
    for names in alike.values():
        sky = next(sky for sky in skies if sky["variant"] == names[0])
        which = "" if len(alike) == 1 else f" of {', '.join(names)}"
        title = f"sky{which}: {sky['profile']}, as seen from {sky['seen_from_m']:g} m"
        ghz = [Column(f"{frequency:g} GHz", "K", ".2f") for frequency in sky["frequency_ghz"]]
        kelvins = zip(*sky["brightness_temperature_k"], strict=True)
        rows = [
            (f"{degrees:g} deg", *row)
            for degrees, row in zip(sky["elevation_deg"], kelvins, strict=True)
        ]
        found.append(Table(title, (Column("elevation"), *ghz), tuple(rows)))
    return found


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
        *air_lines(found["airs"]),
        *sky_lines(found["sky"]),
        *_refraction(found["refraction_left_out"]),
        *(f"note: {warning}" for warning in found["warnings"]),
    ]


def air_lines(airs: list[dict[str, Any]]) -> list[str]:
    """Returns how humidity fluctuates in the variants' air, alike ones in one line."""
    alike: dict[str, list[str]] = {}
    for air in airs:
        constant, sigma = air["structure_constant_q"], air["sigma_percent"]
        if constant is None or sigma is None or not sigma:
            continue
        text = f"C_q^2 {constant:.4g} (g/m3)^2 m^-2/3, sigma {sigma:.4g} %"
        if air["outer_scale_m"] is not None:
            text += f", for an outer scale of {air['outer_scale_m']:.3g} m"
        alike.setdefault(text, []).append(air["variant"])
    every = len(alike) == 1 and len(airs) == len(next(iter(alike.values())))
    return [
        f"humidity fluctuates{'' if every else ' in ' + ', '.join(names)}: {text}"
        for text, names in alike.items()
    ]


def sky_lines(skies: list[dict[str, Any]]) -> list[str]:
    """Returns how the scene's air departs from the sky's profile, and where rays leave it."""
    alike: dict[str, float] = {}
    for sky in skies:
        air = f"{sky['departure_k']:+.3g} K, vapour times {sky['vapour_ratio']:.3g}"
        text = f"sky: the scene's air is blended into {sky['profile']} over 1 km ({air})"
        text += f"; it is even up to {sky['even_air_to_m']:g} m, which changes it"
        alike[text] = max(sky["even_air_k"], alike.get(text, 0.0))
    return [f"{text} by up to {kelvin:.2g} K from 3 degrees on" for text, kelvin in alike.items()]


def _refraction(left: dict[str, Any] | None) -> list[str]:
    if left is None:
        return []
    noise = f"{left['scintillation_db']:.2g} dB of scintillation"
    tilt = f"{left['tilt_urad']:.2g} microradians of tilt"
    path = f"{left['path_m']:.3g} m, aperture {left['aperture_m']:g} m"
    turbulence = f"C_n^2 {left['structure_constant_n']:.2g} m^-2/3"
    return [f"refraction, left out: {noise}, {tilt} ({path}, {turbulence})"]
