"""A scene in the air of a record: the small scene that `thzcl new` writes, in measured air."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np

from thzcl.errors import RecordError
from thzcl.files import readable, write_whole
from thzcl.records.analysis import Analysis
from thzcl.records.record import Record
from thzcl.scenario.source import SHIPPED

MODEL, MODEL_K = "quick", 290.0  # the scene, and its air's temperature
STANDARD_K, STANDARD_HPA = 288.15, 1013.25  # where the record has no temperature or no pressure
GRID, VOXEL_M = 128, 0.5
LOWEST_HEIGHTS, MOST_HEIGHTS = 0.4, 3.0  # outer scales near the ground


def write(analysis: Analysis, path: Path) -> list[Path]:
    """Writes a scene, and the spectrum beside it as NAME-spectrum.csv; returns both paths.

    Raises RecordError if one of the files exists, or if there is no inertial range.
    """
    if analysis.inertial.structure_constant is None:
        raise RecordError(
            f"{path}: no scene without a structure constant: {analysis.inertial.reason}"
        )
    table = path.with_name(f"{path.stem}-spectrum.csv")
    for file in (path, table):
        if file.exists():
            raise RecordError(f"{file}: exists already; choose another name for --scene")
    texts = {table: spectrum_csv(analysis), path: scene(analysis, table.name)}
    for file, text in texts.items():
        write_whole(file, partial(Path.write_text, data=text, encoding="utf-8"))
    return [path, table]


def spectrum_csv(analysis: Analysis) -> str:
    """Returns the spectrum in bins as CSV, spatial frequency and density.

    It ends where the inertial range does; `spectrum = "table"` reads it.
    """
    spectrum = analysis.spectrum.part(0.0, analysis.inertial.limits[1])
    rows = [
        f"{xi:.6g},{density:.6g}"
        for xi, density in zip(spectrum.frequency, spectrum.density, strict=True)
    ]
    head = (
        "# One-sided power spectrum of absolute humidity along the wind, averaged in bins "
        "up to the inertial range's end."
    )
    return "\n".join([head, "spatial_frequency_cycles_per_m,density_g2_per_m5", *rows, ""])


def scene(analysis: Analysis, table: str) -> str:
    """Returns the TOML of a scene ready to run; `table` is the name of the spectrum's file."""
    text = (SHIPPED / f"{MODEL}.toml").read_text(encoding="utf-8")
    camera, ground = text.index("[camera]"), text.index("[ground]")
    air = text.index("[atmosphere]")
    warmer = _kelvin(analysis.record) - MODEL_K
    lines = [
        *_provenance(analysis),
        "",
        text[camera:air].rstrip(),
        "",
        *_atmosphere(analysis),
        "",
        *_turbulence(analysis, table),
    ]
    return "\n".join(lines) + "\n\n" + _warmed(text[ground:], warmer)


def _warmed(text: str, by_k: float) -> str:
    """Returns a scene's TOML with every temperature changed by as much as the air's."""
    lines = []
    for line in text.splitlines():
        name, equals, value = line.partition("temperature_k = ")
        lines.append(f"{name}{equals}{float(value) + by_k:.1f}" if equals and not name else line)
    return "\n".join(lines) + "\n"


def _provenance(analysis: Analysis) -> Iterator[str]:
    """Yields comments that say where the air comes from, and its statistics."""
    record, found = analysis.record, analysis.as_json()
    names = ", ".join(readable(Path(name).name) for name in record.files)
    command = f"thzcl fluctuations {names.replace(',', '')} --scene"
    yield f"# A warm box 30 m away, in air as measured: written by `{command}`."
    begin = (
        f"from {datetime.fromtimestamp(record.start, UTC):%Y-%m-%d %H:%M:%S}, "
        if record.dated
        else ""
    )
    station = f" of station {record.station}" if record.station else ""
    yield f"# Record {names}{station}:"
    flaws = f"{found['gaps']} gaps, {found['spikes']} spikes"
    yield f"# {begin}{found['duration_s']:g} s at {record.rate_hz:g} Hz, {flaws};"
    low, high = analysis.inertial.limits
    slope = f"{analysis.inertial.slope:.3f} +- {analysis.inertial.slope_uncertainty:.3f}"
    sigma = f"sigma {found['sigma_percent']:.3g} % of the mean"
    yield f"# spectral slope {slope} from {low:.3g} to {high:.3g} cycles/m; {sigma};"
    own = found["uncertainty"].get("structure_constant_q")
    yield f"# C_q^2 {found['structure_constant_q']:.4g}" + (f" +- {own:.2g};" if own else ";")
    if analysis.fitted.constant is not None:
        constant = f"{analysis.fitted.constant:.4g} ({found['agreement_percent']:+.1f} %)"
        yield f"# C_q^2 by the structure function {constant};"
    yield f"# integral scale {analysis.integral_scale_m:.3g} m."
    yield from (f"# Note: {note}." for note in found["notes"])


def _kelvin(record: Record) -> float:
    """Returns the air's mean temperature in K, or the standard's where it was not measured."""
    return STANDARD_K if record.temperature is None else float(np.nanmean(record.temperature))


def _atmosphere(analysis: Analysis) -> Iterator[str]:
    """Yields the table [atmosphere]."""
    record = analysis.record
    unknown = "  # not in the record"
    yield "[atmosphere]"
    yield f"temperature_k = {_kelvin(record):.2f}{unknown if record.temperature is None else ''}"
    pressure_hpa = record.pressure_hpa or STANDARD_HPA
    yield f"pressure_hpa = {pressure_hpa:.1f}{'' if record.pressure_hpa else unknown}"
    yield f"absolute_humidity_g_m3 = {float(np.nanmean(record.humidity)):.4g}"


def _outer_scale(analysis: Analysis) -> str:
    """Returns the line of the outer scale: as measured, but of 0.4 to 3 heights where known."""
    measured, height = analysis.outer_scale_m, analysis.height_m
    assert measured is not None  # noqa: S101 (as write has it)
    if height is None or LOWEST_HEIGHTS * height <= measured <= MOST_HEIGHTS * height:
        return f"outer_scale_m = {measured:.4g}"
    low, high = LOWEST_HEIGHTS * height, MOST_HEIGHTS * height
    told = f"measured {measured:.4g}; limited to {LOWEST_HEIGHTS:g} to {MOST_HEIGHTS:g} heights"
    return f"outer_scale_m = {min(max(measured, low), high):.4g}  # {told}"


def _turbulence(analysis: Analysis, table: str) -> Iterator[str]:
    """Yields the table [atmosphere.fluctuations]; `table` is the name of the spectrum's file."""
    yield "[atmosphere.fluctuations]"
    yield 'spectrum = "von-karman"'
    yield _outer_scale(analysis)
    yield f"structure_constant_q = {analysis.inertial.structure_constant:.4g}"
    both = analysis.together
    if analysis.structure_constant_t is not None and both:
        yield f"structure_constant_t = {analysis.structure_constant_t:.4g}"
        yield f"correlation_tq = {both.correlation:.3f}  # in the inertial range"
    wind = f"wind_m_s = [0, {analysis.record.wind_speed_m_s:.4g}, 0]"
    yield f"{wind}  # its speed as measured, across the line of sight"
    yield f"voxel_m = {VOXEL_M:g}"
    yield f"grid = {GRID}"
    yield "seed = 1"
    size = f"{VOXEL_M * GRID:g} m"
    yield f"# A cube of {size} holds the smaller eddies, with less than the record's sigma."
    if analysis.structure_constant_t is None or not both:
        yield "# large_scales = true  # adds the larger ones"
    yield (
        "# The measured spectrum as it is, instead of a power law: "
        "put these two lines in the place of the first three."
    )
    yield '# spectrum = "table"'
    yield f'# file = "{table}"'
