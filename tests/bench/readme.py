"""README's tables of speed, made of the records: nobody types a figure."""

from __future__ import annotations

from typing import Any

from comparison import EXACT, MITSUBA, NUMBA_32, NUMBA_64, NUMPY, PLAIN, THINNED

BEGIN, END = "<!-- how fast: written by tests/bench -->\n", "<!-- how fast: end -->\n"
Table = dict[str, Any]


def replaced(readme: str, found: dict[str, Any]) -> str:
    """README with its tables made anew."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    return before + BEGIN + section(found) + END + after


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
