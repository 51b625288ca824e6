"""`thzcl study`: many scenes from one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from thzcl.commands.options import (
    AllowOutside,
    DeviceChoice,
    HowText,
    Settings,
    Source,
    TextFormat,
    Variants,
    changes,
)
from thzcl.errors import UsageError

if TYPE_CHECKING:
    from thzcl.studies.many.study import StudyResult


def study(
    scenario: Source,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="folder of the study")
    ],
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUES",
            help="a,b,c or start:stop:step; A,B=1:2,3:4 pairs keys; targets.NAME.range_m too",
        ),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="airs, and noise, of each setting")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="S", help="that the members' seeds follow from")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="[ADDRESS]",
            help="on a local cluster, or that of a scheduler",
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="processes of the local cluster")
    ] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="the i-th of n parts, for array jobs")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="also more than a million members")] = False,
    settings: Settings = None,
    variant: Variants = None,
    device: DeviceChoice = None,
    allow_outside: AllowOutside = False,
    how: HowText = TextFormat.text,
) -> None:
    """Compute many scenes from one: DIR/index.csv, and a file for each in DIR/members.

    Interrupted, it goes on later.
    """
    from thzcl.commands.tables import show_json
    from thzcl.commands.terminal import note, progress, wrote
    from thzcl.studies.many import study as studies
    from thzcl.studies.many.grid import from_options

    with progress() as tell:
        found = studies.study(
            scenario,
            output,
            over=from_options(over or ()),
            seeds=seeds,
            seed=seed,
            settings=changes(settings),
            variants=variant or (),
            device=device,
            shard=_parts(shard),
            dask=dask,
            workers=workers,
            yes=yes,
            allow_outside=allow_outside,
            progress=tell,
            given_by="--over",
        )
    if how is TextFormat.json:
        show_json(as_json(found))
        return
    told = ", ".join(f"{count} {state}" for state, count in sorted(found.states.items()))
    note(f"{found.members} members, seed {found.seed}: {told or 'none computed'}")
    for line in _messages(found):
        note(line)
    wrote([str(found.index)])


def as_json(found: StudyResult) -> dict[str, object]:
    """Returns what `thzcl study --format json` prints."""
    return {
        "folder": str(found.folder),
        "index": str(found.index),
        "members": found.members,
        "seed": found.seed,
        "states": dict(found.states),
    }


def _messages(found: StudyResult) -> list[str]:
    """Returns why members failed: each reason once, with the first member that has it."""
    why: dict[str, int] = {}
    for one in found.records():
        if one["message"]:
            why.setdefault(one["message"], one["member"])
    return [f"member {number}: {text}" for text, number in why.items()]


def _parts(shard: str | None) -> tuple[int, int] | None:
    """Returns i and n of "i/n". Raises UsageError."""
    if shard is None:
        return None
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", shard)
    if found is None:
        raise UsageError(f"--shard {shard:.40}: write i/n with i from 1 to n, as in 1/8")
    return int(found[1]), int(found[2])
