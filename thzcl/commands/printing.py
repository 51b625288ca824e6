"""What the commands show: tables on stdout, progress on a terminal's stderr."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

PIPE_WIDTH = 240  # columns, where there is no terminal to keep to


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints a table; columns of numbers are aligned to the right."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    drawn = Table(
        title=title or None,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for at, name in enumerate(columns):
        numeric = bool(rows) and all(row[at][:1] in "+-0123456789" for row in rows)
        drawn.add_column(escape(name), justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        drawn.add_row(*map(escape, row))
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    console.print(drawn)


def as_csv(rows: Sequence[dict[str, Any]]) -> None:
    """Prints rows of one kind as CSV, their keys on top."""
    import csv

    writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[str], None]]:
    """Gives a function that shows the stage at work, on a terminal; elsewhere, and if quiet.

    It does nothing.
    """
    if quiet or not sys.stderr.isatty():
        yield _ignore
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield status.update


def _ignore(stage: str) -> None:
    """Shows nothing."""


def summary(found: dict[str, Any]) -> None:
    """Prints what a run found out."""
    rows = [
        [
            variant["name"],
            target,
            str(values["pixels"]),
            _number(values["mean_contrast_k"], "+.5g"),
            _number(values["std_k"], ".3g"),
            f"{values['optical_depth']:.4g}",
            f"{values['transmission']:.4g}",
        ]
        for variant in found["variants"]
        for target, values in variant["targets"].items()
    ]
    columns = [
        "variant",
        "target",
        "pixels",
        "contrast to air / K",
        "spread / K",
        "optical depth",
        "transmission",
    ]
    table(f"{found['scenario']}, seed {found['seed']}", columns, rows)
    facts = [
        [variant["name"], name, f"{fact['value']:.5g}", "" if fact["unit"] == "1" else fact["unit"]]
        for variant in found["variants"]
        for name, fact in variant["facts"].items()
    ]
    if facts:
        table("", ["variant", "of its image", "value", "unit"], facts)
    table(
        "",
        ["stage", "seconds"],
        [[stage, f"{spent:.3f}"] for stage, spent in found["seconds"].items()],
    )
    table("", ["left out", "why"], [[item["stage"], item["reason"]] for item in found["left_out"]])
    budget = [
        [part, f"{e['rms']:.2g}", f"{e['max']:.2g}", e["unit"], _number(e.get("relative"), ".2g")]
        for part, e in found["error_budget"].items()
    ]
    table("", ["error of", "rms", "max", "unit", "rms over contrast"], budget)
    print(f"device: {found['device']}")
    for warning in found["warnings"]:
        print(f"note: {warning}")
    for file in found["files"]:
        print(f"wrote {file}")


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def bench(found: dict[str, Any], rows: Sequence[dict[str, Any]]) -> None:
    """Prints the throughput of stages, and what the device can do at most."""

    def shown(row: dict[str, Any]) -> list[str]:
        rate = f"{_scaled(row['rate'])}{row['unit'].replace('_', ' ')}" if row["unit"] else ""
        share = f"{100 * row['share']:.3g} % of {row['bound']}" if row["bound"] else ""
        return [row["name"], f"{1e3 * row['seconds']:.3g}", rate, share]

    title = f"{found['scenario']}, medians of {found['repeat']}"
    stages = [shown(row) for row in rows[: len(found["stages"])]]
    table(title, ["stage", "time / ms", "throughput", "of what the device can do"], stages)
    roofline = [shown(row)[:3] for row in rows[len(found["stages"]) :]]
    table("what the device can do at most", ["measured by", "time / ms", "throughput"], roofline)
    machine = found["machine"]
    print(f"device: {found['device']}; {machine['cores']} cores of {machine['processor']}")


def _scaled(value: float) -> str:
    """With three digits and an SI prefix, a unit to follow."""
    for prefix, size in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if value >= size:
            return f"{value / size:.3g} {prefix} "
    return f"{value:.3g} "


def plan(found: dict[str, Any]) -> None:
    """Prints what a run would do."""
    rows = [
        [stage["name"], "needed" if stage["needed"] else "left out", stage["reason"]]
        for stage in found["stages"]
    ]
    table(found["scenario"], ["stage", "", "why"], rows)
    settings = found["numerics"]
    same = all({**one, "variant": ""} == {**settings[0], "variant": ""} for one in settings)
    shown = [settings[0] | {"variant": "all"}] if same else settings
    rows = [["" if value is None else str(value) for value in one.values()] for one in shown]
    table("numerics", [name.replace("_", " ") for name in shown[0]], rows)
    frequencies = found["frequencies_ghz"]
    band = ", ".join(f"{f:g}" for f in frequencies[:8]) + (
        f", ... {frequencies[-1]:g}" if len(frequencies) > 8 else ""
    )
    print(f"frequencies: {band} GHz")
    print(f"path moments: {found['moments']}")
    print(
        f"error of the absorption polynomial: at most {found['surrogate_error']:.1e} of the mean air's absorption"
    )
    print(f"voxels crossed: about {found['voxel_segments']:,}")
    print(f"memory at the peak: about {found['memory_bytes'] / 2**20:,.0f} MiB")
    left = found["refraction_left_out"]
    if left is not None:
        noise, tilt = (
            f"{left['scintillation_db']:.2g} dB of scintillation",
            f"{left['tilt_urad']:.2g} microradians of tilt",
        )
        where = f"{left['path_m']:.3g} m, aperture {left['aperture_m']:g} m, C_n^2 {left['structure_constant_n']:.2g} m^-2/3"
        print(f"refraction, left out: {noise}, {tilt} ({where})")
    for warning in found["warnings"]:
        print(f"note: {warning}")


def convergence(found: dict[str, Any]) -> None:
    """Prints a study of error against run time."""
    rows = [
        [
            point["knob"],
            point["setting"] + (" (default)" if point["default"] else ""),
            f"{1e3 * point['seconds']:.3g}",
            f"{point['error_rms']:.2g}",
            f"{point['error_max']:.2g}",
            "front" if point["on_front"] else "",
        ]
        for point in found["points"]
    ]
    columns = ["knob", "setting", "time / ms", "rms error / contrast", "largest / contrast", ""]
    table(f"{found['scenario']}: error against run time", columns, rows)
    shares = [[knob, f"{ratio:.2f}"] for knob, ratio in found["default_over_front"].items()]
    table("", ["knob", "default's time over the front's"], shares)
    table("", ["left out", "why"], [[item["knob"], item["reason"]] for item in found["left_out"]])
    for file in found["files"]:
        print(f"wrote {file}")


def stress(found: list[dict[str, Any]]) -> None:
    """Prints the stiff and extreme cases."""
    rows = [
        [
            case["name"],
            _number(case["measured"], ".6g"),
            _number(case["reference"], ".6g"),
            _number(case["error"], ".1e"),
            _number(case["bound"], ".0e"),
            "passed" if case["passed"] else "FAILED",
        ]
        for case in found
    ]
    table(
        "", ["case: what, arithmetic", "measured", "reference", "relative error", "bound", ""], rows
    )


def fluctuations(found: dict[str, Any]) -> None:
    """Prints what a hygrometer's record tells."""
    low, high = found["inertial_range_cycles_per_m"]
    near, far = found["structure_function_range_m"]
    spikes = ", ".join(
        f"{count} in {name}" for name, count in found["spikes_by_column"].items() if count
    )
    limits = " or ".join(
        f"{t['typical_steps']:g} (median of {t['median_of']})" for t in found["spike_thresholds"]
    )
    rows = [
        [
            "samples",
            f"{found['samples']}",
            f"{found['rate_hz']:g} a second, {found['duration_s']:.6g} s",
        ],
        [
            "gaps",
            f"{found['gaps']}",
            f"{found['repeats']} repeated stamps, {found['out_of_order']} out of order",
        ],
        [
            "spikes",
            f"{found['spikes']}",
            "; ".join(filter(None, [spikes, f"off the running median by {limits} typical steps"])),
        ],
        [
            "mean wind",
            f"{found['wind_speed_m_s']:.4g}",
            f"m/s, a wind run of {found['wind_run_m']:.5g} m",
        ],
        ["mean humidity", f"{found['mean_g_m3']:.5g}", "g/m3"],
        [
            "sigma",
            f"{found['sigma_g_m3']:.4g}",
            f"g/m3, {found['sigma_percent']:.4g} % of the mean; before detrending",
        ],
        ["inertial range", f"{low:.3g} to {high:.3g}", "cycles/m"],
        [
            "slope there",
            f"{found['slope']:.3f}",
            f"+- {found['slope_uncertainty']:.3f}; -1.667 by theory",
        ],
        ["C_q^2", f"{found['structure_constant_q']:.4g}", "g^2 m^-6 m^-2/3, of the spectrum"],
        [
            "C_q^2",
            f"{found['structure_constant_q_from_structure_function']:.4g}",
            f"of the structure function, {near:.3g} to {far:.3g} m: {found['agreement_percent']:+.1f} %",
        ],
        ["integral scale", f"{found['integral_scale_m']:.4g}", "m"],
        ["outer scale", f"{found['outer_scale_m']:.4g}", "m, of a von Karman spectrum"],
    ]
    if found["structure_constant_t"] is not None:
        rows += [
            [
                "C_T^2",
                f"{found['structure_constant_t']:.4g}",
                "K^2 m^-2/3, of sonic temperature corrected for humidity",
            ],
            ["correlation", f"{found['correlation_tq']:.3f}", "of temperature and humidity"],
        ]
    table(", ".join(found["records"]), ["", "value", ""], rows)
    for note in found["notes"]:
        print(f"note: {note}")
    for file in found.get("files", ()):
        print(f"wrote {file}")
