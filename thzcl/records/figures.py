"""Pictures of a record, like figures 2 to 4 of O'Brien and Tofsted.

They show humidity and wind against time, humidity against wind run, and the spectrum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.files import readable, write_whole
from thzcl.records.analysis import Analysis
from thzcl.records.record import Record

Array = NDArray[np.float64]

DOTS_PER_INCH = 130
MOST_POINTS = 40_000  # of a line; beyond, means of several samples are drawn
LOWEST = 1e-5  # of the line's end; a spectrum that breaks off has nothing to show below


Pairs = Sequence[Mapping[str, Any]]


def write(
    analysis: Analysis,
    folder: Path,
    pairs: Pairs | None = None,
    taylor: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Writes NAME-time.png, NAME-wind-run.png and NAME-spectrum.png; returns their paths.

    With `pairs` of sensors and Taylor's curve (sensor_pairs.as_json) NAME-pairs.png too. NAME is
    that of the record's first file. Raises OSError if a file cannot be written.
    """
    stem = Path(analysis.record.files[0]).stem
    pictures: dict[str, Callable[[Analysis, Any], None]] = {
        "time": _against_time, "wind-run": _against_wind_run, "spectrum": _spectra,
    }  # fmt: skip
    if pairs and taylor:
        pictures["pairs"] = partial(_pairs, pairs, taylor)
    files = []
    for name, draw in pictures.items():
        files.append(folder / f"{stem}-{name}.png")
        write_whole(files[-1], partial(_save, analysis, draw))
    return files


def _save(analysis: Analysis, draw: Callable[[Analysis, Any], None], path: Path) -> None:
    """Draws a figure and saves it."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    draw(analysis, figure)
    for ax in figure.axes:
        ax.grid(alpha=0.25, which="both")
        ax.tick_params(labelsize=8)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(fontsize=8)
    figure.savefig(path, dpi=DOTS_PER_INCH, format="png")


def _thin(values: Array) -> tuple[Array, int]:
    """Returns values and 1, or, if there are too many to draw, means of n values each and n."""
    run = -(-len(values) // MOST_POINTS)
    return values[: len(values) // run * run].reshape(-1, run).mean(axis=1), run


def _against_time(analysis: Analysis, figure: Any) -> None:
    """Draws humidity and wind speed against time, as in the paper's figure 2."""
    record = analysis.record
    top, bottom = figure.subplots(2, 1, sharex=True)
    speed = np.sqrt((record.wind**2).sum(axis=0))
    for ax, values, colour, label in (
        (top, record.humidity, "C0", "water vapour / g/m³"),
        (bottom, speed, "C2", "wind speed / m/s"),
    ):
        drawn, run = _thin(values)
        seconds = (np.arange(len(drawn)) + 0.5) * run / record.rate_hz
        ax.plot(seconds, drawn, color=colour, lw=0.6)
        ax.set_ylabel(label)
    bottom.axhline(
        record.wind_speed_m_s, color="k", lw=1, ls="--", label="magnitude of the mean vector"
    )
    bottom.set_xlabel("time / s")
    percent = 100 * np.nanstd(record.humidity) / np.nanmean(record.humidity)
    top.set_title(
        f"{_named(record)}: {record.rate_hz:g} Hz, sigma {percent:.3g} % of the mean",
        fontsize=10,
        parse_math=False,
    )


def _named(record: Record) -> str:
    """Returns the name of a record's first file, for a picture."""
    return readable(Path(record.files[0]).name)


def _against_wind_run(analysis: Analysis, figure: Any) -> None:
    """Draws humidity along the wind by Taylor's hypothesis, as in the paper's figure 3."""
    record = analysis.record
    ax = figure.subplots()
    (drawn, run), speed, mean = (
        _thin(record.humidity),
        record.wind_speed_m_s,
        np.nanmean(record.humidity),
    )
    metres = (np.arange(len(drawn)) + 0.5) * run / record.rate_hz * speed
    ax.plot(metres, drawn, color="C0", lw=0.6)
    ax.axhline(mean, color="k", lw=1, ls="--", label=f"mean {mean:.4g} g/m³")
    ax.set(xlabel="wind run / m", ylabel="absolute humidity / g/m³")
    ax.set_title(
        f"frozen air at {speed:.3g} m/s, integral scale {analysis.integral_scale_m:.3g} m",
        fontsize=10,
    )


def _spectra(analysis: Analysis, figure: Any) -> None:
    """Draws spectrum and structure function with their lines, as in the paper's figure 4."""
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    found, batch = analysis.inertial, analysis.batches[0]
    left.loglog(batch.frequency, batch.density, color="0.8", lw=0.5, label="five sine tapers")
    left.loglog(*batch.smoothed, color="C0", lw=0.7, label="moving average of 5 points")
    left.loglog(
        analysis.spectrum.frequency,
        analysis.spectrum.density,
        "o",
        ms=4,
        color="k",
        label="means in bins",
    )
    fitted = np.geomspace(*found.fitted, 200)
    if found.structure_constant is None:
        told = f"no inertial range, slope {found.slope:.3f} ± {found.slope_uncertainty:.3f}"
        left.loglog(fitted, found.fixed.density(fitted), color="C3", lw=1.5, ls=":", label=told)
    else:
        _inertial(analysis, left, fitted)
    low = float(found.fixed.density(fitted).min()) * LOWEST
    left.set_ylim(max(batch.smoothed[1].min() / 10, low), batch.density.max() * 3)
    left.set(xlabel="spatial frequency / cycles/m", ylabel="one-sided density / (g/m³)² m")
    left.set_title("power spectrum", fontsize=10)

    separation, structure = analysis.by_separation
    right.loglog(separation, structure, "o-", ms=3, lw=0.7, color="C0", label="measured")
    if analysis.fitted.constant is not None and analysis.fitted.limits is not None:
        ends = np.array(analysis.fitted.limits)
        own = analysis.fitted.constant
        told = f"C_q² r²ᐟ³, C_q² = {own:.3g}\n(bend, noise and lag taken off)"
        right.loglog(ends, own * ends ** (2 / 3), color="C3", lw=2, label=told)
    right.set(xlabel="separation / m", ylabel="structure function / (g/m³)²")
    right.set_title("structure function", fontsize=10)


def _inertial(analysis: Analysis, ax: Any, fitted: Array) -> None:
    """Draws the inertial range, its line, and what was fitted with it."""
    found, ends = analysis.inertial, np.array(analysis.inertial.limits)
    own = analysis.uncertainty.get("structure_constant_q")
    told = f"-5/3, C_q² = {found.structure_constant:.3g}" + (f" ± {own:.1g}" if own else "")
    ax.loglog(ends, found.line(ends), color="C3", lw=2, label=f"{told} g² m⁻⁶ m⁻²ᐟ³")
    parts = (("floor", found.fixed.floor), ("bend", found.bend), ("roll-off", found.roll_m))
    names = ", ".join(name for name, there in parts if there)
    if names:
        label = f"with {names}"
        ax.loglog(fitted, found.fixed.density(fitted), color="C1", lw=1.2, ls="--", label=label)
    slope = f"inertial range, slope {found.slope:.3f} ± {found.slope_uncertainty:.3f}"
    ax.axvspan(*found.limits, color="C3", alpha=0.07, lw=0, label=slope)


def _pairs(pairs: Pairs, taylor: Mapping[str, Any], analysis: Analysis, figure: Any) -> None:
    """Draws covariance and structure function of sensors apart, beside Taylor's curve."""
    first = _named(analysis.record)
    for ax, key, name in zip(
        figure.subplots(1, 2),
        ("covariance_g2_m6", "structure_function_g2_m6"),
        ("covariance", "structure function"),
        strict=True,
    ):
        label = f"{first} along the wind (Taylor)"
        ax.plot(taylor["separation_m"], taylor[key], color="C0", lw=1, label=label)
        for direction, mark in (
            ("along", ">"),
            ("across", "^"),
            ("oblique", "D"),
            ("unknown", "o"),
        ):
            own = [pair for pair in pairs if pair["direction"] == direction]
            if own:
                ax.errorbar(
                    [pair["separation_m"] for pair in own],
                    [pair[key] for pair in own],
                    [pair["uncertainty"].get(key, 0.0) for pair in own],
                    fmt=mark, color="C3", ms=5, capsize=2,
                    label=f"two sensors, {direction} the wind"
                    if direction != "unknown" else "two sensors",
                )  # fmt: skip
        ax.set(xscale="log", xlabel="separation / m", ylabel=f"{name} / (g/m³)²")
    figure.axes[1].set_yscale("log")
    figure.suptitle("two hygrometers, noise taken off", fontsize=10)
