"""`python tests/bench` times thzcl against its alternatives, and checks every claim of its speed.

Alternatives are what a user would write or take instead. Numba and Mitsuba come with
`pip install '.[bench]'`; if one is not installed, its rows are left out, and the table says so.
"""

from __future__ import annotations

import argparse
import json
import os
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# As in thzcl's own command: else NumPy's threads spin beside everything.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import claims
import comparison
import guards
import readme

from thzcl.commands.tables import Column, Table, show
from thzcl.device.choose import open_device
from thzcl.studies.bench import surroundings


def main() -> None:
    """Measures, prints tables, and writes the records where they are wanted."""
    parser = argparse.ArgumentParser(
        prog="tests/bench", description="Measure thzcl against others, and its claims."
    )
    parser.add_argument("--repeat", type=int, default=7, help="runs to take the median of")
    parser.add_argument("--output", type=Path, metavar="FILE.json", help="write the records there")
    parser.add_argument(
        "--readme",
        action="store_true",
        help="write the tables of README beside this file; of everything, not --only some",
    )
    parser.add_argument(
        "--guard",
        action="store_true",
        help="only ratios with generous bounds; fails where one is passed",
    )
    parser.add_argument(
        "--only",
        default="",
        metavar="NAME",
        help="comparison, or the claims whose function's name holds this",
    )
    given = parser.parse_args()
    device = open_device()
    if given.guard:
        records = guards.twice(device, given.repeat)
        _show_claims([record.as_json() for record in records])
        raise SystemExit(not all(record.met for record in records))
    rivals = {name: version(name) for name in ("numba", "mitsuba") if find_spec(name)}
    found: dict[str, Any] = surroundings() | {
        "device": device.info.name,
        "repeat": given.repeat,
        "rivals": rivals,
    }
    if given.only in ("", "comparison"):
        found["comparison"] = comparison.compare(device, given.repeat)
        for one in found["comparison"]:
            _show(one)
    records = comparison.claims(found.get("comparison", []))
    if given.only != "comparison":
        records += claims.measure(device, given.repeat, given.only)
    found["claims"] = [record.as_json() for record in records]
    _show_claims(found["claims"])
    machine = found["machine"]
    cores = f"{machine['cores']} cores of {machine['processor']}"
    print(f"{device.info.name}; {cores}; commit {found['commit']}")
    if given.output:
        given.output.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if given.readme and not given.only:
        readme.write(found)


def _show(one: dict[str, Any]) -> None:
    columns = (
        Column(""),
        Column("time", "ms", ".4g"),
        Column("G segments/s", form=".3g"),
        Column("rms error of contrast", form=".1e"),
        Column("x every ray", form=".3g"),
        Column("x thinned", form=".3g"),
        Column(""),
    )
    rows = [
        (
            row["name"],
            1e3 * row["seconds"],
            None if row["segments_per_second"] is None else row["segments_per_second"] / 1e9,
            *(row[key] for key in ("error", "times_ours", "times_ours_thinned", "note")),
        )
        for row in one["methods"]
    ]
    rows += [(name, *[None] * 5, "not installed") for name in one["not_installed"]]
    title = (
        f"slide in voxels of {one['voxel_m']} m: {one['rays']} rays, {one['segments']:,} segments"
    )
    show(Table(title, columns, tuple(rows)))


def _show_claims(records: list[dict[str, Any]]) -> None:
    words = {True: "met", False: "MISSED", None: "not measured"}
    columns = (
        Column(""),
        Column("measured", form=".3g"),
        Column("bound"),
        *map(Column, ("unit", "", "")),
    )
    rows = tuple(
        (
            record["name"],
            record["measured"],
            f"{'at least' if record['at_least'] else 'at most'} {record['bound']:g}",
            record["unit"],
            words[record["met"]],
            record["note"],
        )
        for record in records
    )
    show(Table("claims", columns, rows))


if __name__ == "__main__":
    main()
