"""The measured tables of tests/bench/README.md, made of the records: nobody types a figure.

    python tests/bench/readme.py

writes the tables anew from record.json and stress.csv. `python tests/bench --readme` does so from
what it has just measured.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from comparison import EXACT, MITSUBA, NUMBA_32, NUMBA_64, NUMPY, PLAIN, THINNED

HERE = Path(__file__).parent
PAGE, RECORD, STRESS = HERE / "README.md", HERE / "record.json", HERE / "stress.csv"
SPEED = "<!-- how fast: written by tests/bench -->\n", "<!-- how fast: end -->\n"
EXTREMES = (
    "<!-- extremes: written by tests/bench/readme.py -->\n",
    "<!-- extremes: end -->\n",
)
ARITHMETIC = ", float32"  # the end of the names of the cases that are shown
Table = dict[str, Any]


def write(found: dict[str, Any]) -> None:
    """Writes the page's tables anew: those of speed from these records."""
    text = replaced(PAGE.read_text(encoding="utf-8"), found, stress_cases())
    PAGE.write_text(text, encoding="utf-8")


def replaced(page: str, found: dict[str, Any], cases: list[dict[str, str]]) -> str:
    """The page with its tables made anew."""
    for (begin, end), text in ((SPEED, section(found)), (EXTREMES, extremes(cases))):
        before, _, rest = page.partition(begin)
        page = before + begin + text + end + rest.partition(end)[2]
    return page


def recorded() -> dict[str, Any]:
    """The records of speed that are kept."""
    return json.loads(RECORD.read_text(encoding="utf-8"))


def stress_cases() -> list[dict[str, str]]:
    """What `thzcl stress --format csv` printed."""
    return list(csv.DictReader(STRESS.read_text(encoding="utf-8").splitlines()))


def extremes(cases: list[dict[str, str]]) -> str:
    """How many of the stiff and extreme cases pass, and those in float32 as they were measured."""
    shown = [case for case in cases if case["name"].endswith(ARITHMETIC)]
    failed = [case["name"] for case in cases if case["passed"] != "True"]
    passed = (
        f"{len(cases) - len(failed)} of {len(cases)} pass" if failed else f"All {len(cases)} pass"
    )
    missed = f"; **these fail: {', '.join(failed)}**" if failed else ""
    table = _table(["case", "measured", "relative error", "bound"], [_case(case) for case in shown])
    summary = f"<details><summary>{len(shown)} lines in float32</summary>"
    return f"\n{passed}{missed}. Those in float32:\n\n{summary}\n\n{table}\n\n</details>\n\n"


def _case(case: dict[str, str]) -> list[str]:
    measured, error, bound = (float(case[key]) for key in ("measured", "error", "bound"))
    name = case["name"].removesuffix(ARITHMETIC)
    return [name, f"{measured:.6g}", f"{error:.1e}", f"{bound:.1e}"]


def section(found: dict[str, Any]) -> str:
    """What stands between the marks: where it was measured, rivals, claims."""
    machine = found["machine"]
    versions = ", ".join(
        f"{name} {version}"
        for name, version in sorted((found["versions"] | found["rivals"]).items())
    )
    where = f"{machine['cores']} cores of {machine['processor']}, {found['device']}"
    commit = found["commit"][:12]
    parts = [
        f"On {where}, commit {commit}; medians of {found['repeat']}, taken in turn. {versions}.",
        _table(
            ["", *(f"{one['voxel_m']:g} m" for one in found["comparison"])],
            _rivals(found["comparison"]),
        ),
        _table(
            ["claim", "measured", "bound", "", "of this"],
            [_claim(record) for record in found["claims"]],
        ),
    ]
    return "\n" + "\n\n".join(parts) + "\n\n"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _rivals(tables: list[Table]) -> list[list[str]]:
    """Ours in milliseconds, the others in how much longer they take."""
    kinds = [{row["name"]: row for row in table["methods"]} for table in tables]

    def row(name: str, shown: Any) -> list[str]:
        return [name, *("not installed" if shown(kind) is None else shown(kind) for kind in kinds)]

    def numba(kind: Table) -> str | None:
        both = [kind[name] for name in (NUMBA_64, NUMBA_32) if name in kind]
        if not both:
            return None
        best = min(both, key=lambda one: one["seconds"])
        return f"{best['times_ours']:.2g} x every ray, {best['times_ours_thinned']:.2g} x thinned"

    def mitsuba(kind: Table) -> str | None:
        return f"{kind[MITSUBA]['times_ours_thinned']:.0e} x thinned" if MITSUBA in kind else None

    def ours(name: str) -> Any:
        return lambda kind: (
            f"{1e3 * kind[name]['seconds']:.3g} ms, rms error {kind[name]['error']:.0e} of contrast"
        )

    return [
        row("every ray", ours(EXACT)),
        row("thinned", ours(THINNED)),
        row("Numba, the same loop on all cores, the better of float32 and float64", numba),
        row(
            "our own kernel, one ray to a work-item",
            lambda kind: f"{kind[PLAIN]['times_ours']:.2g} x every ray",
        ),
        row(
            "NumPy, fixed steps of half a voxel",
            lambda kind: f"{kind[NUMPY]['times_ours']:.2g} x every ray",
        ),
        row("Mitsuba 3, with samples enough for the error of thinned", mitsuba),
    ]


def _claim(record: dict[str, Any]) -> list[str]:
    measured = "" if record["measured"] is None else f"{record['measured']:.3g}"
    side = "at least" if record["at_least"] else "at most"
    bound = f"{side} {record['bound']:g} {record['unit']}".removesuffix(" 1")
    word = {True: "met", False: "**missed**", None: "not measured"}[record["met"]]
    return [record["name"], measured, bound, word, record["note"]]


if __name__ == "__main__":
    write(recorded())
