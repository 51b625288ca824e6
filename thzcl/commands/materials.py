"""`thzcl materials`: what things can be made of, or one material by frequency."""

from __future__ import annotations

from typing import Annotated

import typer

TOLD_GHZ = (94.0, 140.0, 220.0, 340.0, 410.0, 650.0, 850.0)
TOLD_K = 293.15
TOLD_DEG = (0.0, 45.0, 75.0)


def materials(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="a material, for what it reflects")
    ] = None,
) -> None:
    """List the materials that come with thzcl, or show one's source, range and reflectivity."""
    from thzcl.commands.tables import Column, Table, show
    from thzcl.scenario.materials import library

    if name is not None:
        _one(name)
        return
    rows = [
        (one.name, " and ".join(map(_span, one.rows)), one.about, one.source)
        for one in library().values()
    ]
    columns = (Column("material"), Column("known at", "GHz"), Column("what"), Column("source"))
    show(Table("", columns, tuple(rows)))


def _span(row: object) -> str:
    """Returns the frequencies at which a row is known."""
    span = getattr(row, "range_ghz", None)
    return "all" if span is None else f"{span[0]:g}-{span[1]:g}"


def _one(name: str) -> None:
    """Prints what is known of a material, and what it reflects."""
    import numpy as np

    from thzcl.commands.tables import Column, Table, show
    from thzcl.commands.terminal import page
    from thzcl.errors import ScenarioError
    from thzcl.plugins.names import suggest
    from thzcl.scenario.materials import library
    from thzcl.surfaces.fresnel import fresnel
    from thzcl.surfaces.materials import Substance

    known = library().get(name)
    if known is None:
        raise ScenarioError([f"no material {name} ({suggest(name, library())})"])
    substance = Substance(name, known.rows)
    lines = [
        f"{name}\n{'=' * len(name)}\n\n{known.about[:1].upper()}{known.about[1:]}.\n",
        *(f"Known at {_span(row)} GHz: {_keys(row)}." for row in known.rows),
        f"Uncertainty: {known.uncertainty}.",
        f"Source: {known.source}.\n",
        f'Use it by material = "{name}", or as model = "{name}" with a roughness_mm of your own.',
    ]
    page("\n".join(lines))
    print()
    rows = []
    for ghz in TOLD_GHZ:
        hz = np.array([ghz * 1e9])
        refused, told = substance.beyond(hz)
        if refused is not None:
            rows.append((ghz, None, None, *(None,) * (2 * len(TOLD_DEG) - 1), "not known"))
            continue
        eps = substance.permittivity(hz, TOLD_K)
        parts = [fresnel(eps, np.cos(np.radians(deg))) for deg in TOLD_DEG]
        upright, *slanted = [tuple(float(part[0]) for part in pair) for pair in parts]
        values = upright[0], *(part for pair in slanted for part in pair)
        words = "" if told is None else "extrapolated"
        rows.append((ghz, float(eps[0].real), float(eps[0].imag), *values, words))
    slant = [
        Column(f"{word} at {deg:g} deg", "", ".5f")
        for deg in TOLD_DEG[1:]
        for word in ("R_s", "R_p")
    ]
    columns = (
        Column("frequency", "GHz", "g"),
        Column("eps'", "", ".5g"),
        Column("eps''", "", ".4g"),
        Column("R at 0 deg", "", ".5f"),
        *slant,
        Column(""),
    )
    show(Table(f"reflectivity of a smooth face at {TOLD_K:g} K", columns, tuple(rows)))


def _keys(row: object) -> str:
    """Returns the keys of a row of the library as they stand in a scenario."""
    given = row.model_dump(exclude_none=True)  # type: ignore[attr-defined]
    given.pop("range_ghz", None)
    return ", ".join(f"{name} = {value}" for name, value in given.items())
