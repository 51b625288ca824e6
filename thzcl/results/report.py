"""The report of a result file, of a study's folder or of an answer about range."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from thzcl.errors import FileError
from thzcl.files import RECORD, RESULT, open_netcdf, parse_json, read_json, read_text, readable
from thzcl.results import page
from thzcl.results.page import Cell, Section, Series
from thzcl.results.result import Result
from thzcl.results.summary import by_frequency, by_model, two_ways

INDEX, DESCRIPTION = "index.csv", "study.json"
TARGET_COLUMNS = {
    "pixels": "pixels",
    "mean_contrast_k": "contrast to air / K",
    "std_k": "spread / K",
    "optical_depth": "optical depth",
    "transmission": "transmission",
    "snr": "SNR",
    "netd_k": "NETD at target / K",
    "cnr": "CNR",
    "contrast_db": "contrast / dB",
}
SHOWN = ("cnr", "snr", "mean_contrast_k", "contrast_db", "transmission")  # first that has values
BUDGET = (
    "How far each shortcut moved the image. The line model, where there is one, is half the spread "
    "of the targets' contrast over the models compared."
)
LOSSES = {
    "absorption": "without absorption",
    "clutter": "clutter alone",
    "noise": "noise alone",
    "pixels": "with the first range's pixels",
}
# What is raised where a file does not hold what thzcl writes.
_BROKEN = ArithmeticError, AttributeError, LookupError, TypeError, ValueError
MOST_ROWS = 2000  # of a study's table in a page


def report(source: Path) -> str:
    """Returns the page of a result (.nc), or of the folder of a study or of an answer about range.

    Raises FileError for anything else.
    """
    try:
        return _page(source)
    except FileError:
        raise
    except (*_BROKEN, csv.Error) as error:
        text = f"{type(error).__name__}: {error}"
        raise FileError(
            f"{source}: is not as thzcl has written it ({text}); make it again"
        ) from error


def _page(source: Path) -> str:
    """Returns the page of a file or a folder; other errors than FileError are its content's."""
    if source.is_dir():
        if (source / DESCRIPTION).is_file() and (source / INDEX).is_file():
            return _of_study(source)
        answers = sorted(source.glob("*-range.json"))
        if answers:
            return _of_range(answers[0])
        text = "holds neither a study nor an answer of thzcl range; give a result (.nc)"
        raise FileError(f"{source}: {text}")
    if source.name.endswith("-range.json"):
        return _of_range(source)
    return _of_result(source)


def _of_result(path: Path) -> str:
    """Returns the page of a result file. Raises FileError."""
    with open_netcdf(path, RESULT) as file:
        attrs = {name: _text(value) for name, value in file.attrs.items()}
        if "scenario_toml" not in attrs:
            raise FileError(f"{path}: is no result of thzcl; give one that thzcl run has written")
        name = attrs.get("scenario_name", path.stem)
        pictures = list(_of_frames(file) if "time" in file else _pictures(path, name))
    told: dict[str, Any] = {
        name: parse_json(attrs[name], f"{path}: {name}", RESULT) if name in attrs else empty
        for name, empty in (
            ("summary", []), ("error_budget", {}), ("left_out", []), ("warnings", []),
            ("seconds", {}), ("versions", {}),
        )
    }  # fmt: skip
    budget = [
        (part, e["rms"], e["max"], e["unit"], e.get("relative"))
        for part, e in told["error_budget"].items()
    ]
    again = f"thzcl run {shlex.quote(readable(str(path)))}"
    sections = [
        Section("Warnings", texts=told["warnings"], tone="warn"),
        Section("Pictures", pictures=pictures),
        Section("Targets", table=_targets(told["summary"])),
        Section("By absorption model", table=_models(told["summary"])),
        Section("Of the images", table=_facts(told["summary"])),
        Section(
            "Error budget",
            texts=[BUDGET],
            table=page.table(("error of", "rms", "max", "unit", "rms over contrast"), budget),
        ),
        Section(
            "Left out",
            table=page.table(
                ("stage", "why"), [(o["stage"], o["reason"]) for o in told["left_out"]]
            ),
        ),
        Section("Seconds", table=page.table(("stage", "s"), list(told["seconds"].items()))),
        Section("Versions", table=page.table(("what", "version"), list(told["versions"].items()))),
        Section("Make it again", code=again, summary="the command", open=True),
        Section("Scenario", code=attrs["scenario_toml"], summary="the TOML that repeats this run"),
    ]
    return page.render(name, f"{attrs.get('device', '')}, seed {attrs.get('seed', '')}", sections)


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _pictures(path: Path, name: str) -> Iterator[page.Picture]:
    """Yields the picture of a result, unless its sensor failed."""
    result = Result.load(path)
    if all(variant.image for variant in result.variants):
        yield page.png(result.plot(), f"images of {name}")


def _of_frames(file: Any) -> Iterator[page.Picture]:
    """Yields a picture of the mean of each variant's frames, with scale and colour bar."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from thzcl.results.figure import outer_edges

    images = file["image_mean"]
    unit, quantity = (_text(images.attrs.get(key, "")) for key in ("units", "long_name"))
    names = [_text(one) for one in file["variant"][...]]
    for number, variant in enumerate(names):
        values = np.asarray(images[number], np.float64)
        columns, rows = (
            np.asarray(file[axis][number] if file[axis].ndim > 1 else file[axis][...])
            for axis in ("x_angle", "y_angle")
        )
        figure = Figure(figsize=(6.0, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.subplots()
        low, high = np.percentile(values, (0.1, 99.9))
        high = high if high > low else low + 1.0
        shown = ax.imshow(
            values, cmap="gray", interpolation="nearest", vmin=low, vmax=high,
            extent=outer_edges(columns, rows),
        )  # fmt: skip
        ax.set_xlabel("x angle / mrad")
        ax.set_ylabel("y angle / mrad")
        bar = figure.colorbar(shown, ax=ax)
        bar.set_label(quantity if unit == "1" else f"{quantity} / {unit}", parse_math=False)
        yield page.png(figure, f"{variant}: {quantity}")


def _targets(variants: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Returns the table of targets and metrics, without columns that hold nothing."""
    rows = [
        (
            variant["name"],
            ghz,
            name,
            *(values.get(key) for key in TARGET_COLUMNS),
            two_ways(variant),
        )
        for variant in variants
        for ghz, targets in by_frequency(variant)
        for name, values in targets.items()
    ]
    columns = ("variant", "frequency / GHz", "target", *TARGET_COLUMNS.values(), "path of light")
    return _full_columns(columns, rows)


def _full_columns(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> dict[str, Any] | None:
    kept = [n for n in range(len(columns)) if any(row[n] is not None for row in rows)]
    return page.table([columns[n] for n in kept], [[row[n] for n in kept] for row in rows])


def _models(variants: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    keys = ("mean_contrast_k", "optical_depth", "transmission")
    rows = [
        (variant["name"], ghz, target, model, *(values.get(key) for key in keys), two_ways(variant))
        for variant in variants
        for ghz, target, model, values in by_model(variant)
    ]
    told_of = (TARGET_COLUMNS[key] for key in keys)
    names = ("variant", "frequency / GHz", "target", "model", *told_of, "path of light")
    return _full_columns(names, rows)


def _facts(variants: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    rows = [
        (variant["name"], name, fact["value"], "" if fact["unit"] == "1" else fact["unit"])
        for variant in variants
        for name, fact in variant["facts"].items()
    ]
    return page.table(("variant", "of its image", "value", "unit"), rows)


def _of_study(folder: Path) -> str:
    """Returns the page of a study's folder."""
    about = read_json(folder / DESCRIPTION, RECORD)
    rows = list(csv.DictReader(io.StringIO(read_text(folder / INDEX, RECORD))))
    keys = [key for names, _ in about["over"] for key in names]
    states: dict[str, set[str]] = {}
    for row in rows:
        states.setdefault(row["state"], set()).add(row["member"])
    failed = {r["member"]: r for r in rows if r["state"] != "done"}
    done = [row for row in rows if row["state"] == "done"]
    metric = next((name for name in SHOWN if any(row[name] for row in done)), None)
    numeric = [key for key in keys if done and all(_is_number(row[key]) for row in done)]
    varied = [key for key in numeric if len({row[key] for row in done}) > 1]
    told = ", ".join(f"{len(members)} {state}" for state, members in sorted(states.items()))
    columns = list(rows[0]) if rows else []
    shown = [[_cell(row[name]) for name in columns] for row in rows[:MOST_ROWS]]
    cut = [f"The first {MOST_ROWS} of {len(rows)} rows."] if len(rows) > MOST_ROWS else []
    again = f"thzcl study SCENARIO -o {shlex.quote(readable(str(folder)))} (with its own options)"
    sections = [
        Section(
            "Failed members",
            tone="warn",
            table=page.table(
                ("member", *keys, "state", "why"),
                [(_cell(m), *(_cell(r[k]) for k in keys), r["state"], r["message"])
                 for m, r in failed.items()],
            ),
        ),
        Section("Curve", chart=_curve(done, varied[0], metric) if varied and metric else None),
        Section("Heat map", heat=_heat(done, varied, metric) if metric else None),
        Section(
            "Members",
            texts=cut,
            table=page.table(columns, shown, sorts=True),
        ),
        Section("Make it again", code=again, summary="the command", open=True),
        Section("Scenario", code=about["scenario_toml"], summary="the scene that was varied"),
    ]  # fmt: skip
    title = f"{about['scenario']}: study"
    return page.render(title, f"{told or 'no members'}; seed {about['seed']}", sections)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _cell(text: str) -> Cell:
    if not _is_number(text):
        return text
    return int(text) if text.lstrip("-").isdecimal() else float(text)


def _label(metric: str) -> str:
    return TARGET_COLUMNS[metric]


def _curve(rows: Sequence[Mapping[str, str]], key: str, metric: str) -> dict[str, Any] | None:
    """Returns the mean of a metric against a key, for each target, frequency and model.

    The band reaches from the smallest to the largest value.
    """
    grouped: dict[str, dict[float, list[float]]] = {}
    for row in rows:
        if _is_number(row[metric]):
            name = (
                f"{row['target']}, {page.number(_cell(row['frequency_ghz']))} GHz, {row['model']}"
            )
            grouped.setdefault(name, {}).setdefault(float(row[key]), []).append(float(row[metric]))
    series = []
    for name, points in grouped.items():
        places = sorted(points)
        means = [(x, float(np.mean(points[x]))) for x in places]
        series.append(Series(name, means, [(min(points[x]), max(points[x])) for x in places]))
    return page.chart(series[: len(page.COLOURS)], key, f"{_label(metric)}, mean and extremes")


def _heat(
    rows: Sequence[Mapping[str, str]], varied: Sequence[str], metric: str
) -> dict[str, Any] | None:
    """Returns the mean of a metric over two keys, of the first target that has it."""
    if len(varied) < 2:
        return None
    one, other = varied[:2]
    known = [row for row in rows if _is_number(row[metric]) and row["target"] != "ground"]
    known = known or [row for row in rows if _is_number(row[metric])]
    if not known:
        return None
    first = known[0]
    same = ("target", "frequency_ghz", "model", "variant")
    cells: dict[tuple[float, float], list[float]] = {}
    for row in known:
        if all(row[name] == first[name] for name in same):
            place = float(row[one]), float(row[other])
            cells.setdefault(place, []).append(float(row[metric]))
    columns = sorted({x for x, _ in cells})
    lines: dict[Cell, list[float | None]] = {
        y: [float(np.mean(cells[x, y])) if (x, y) in cells else None for x in columns]
        for y in sorted({y for _, y in cells})
    }
    what = ", ".join(first[name] for name in same)
    caption = f"{_label(metric)} of {what}: mean"
    return page.heat(caption, f"{other} (down), {one} (across)", columns, lines)


def _of_range(path: Path) -> str:
    """Returns the page of an answer about range."""
    told = read_json(path, RECORD)
    curves, ranges, losses = (told[name] for name in ("curves", "ranges", "losses"))
    series = [
        Series(
            f"{one['frequency_ghz']:g} GHz, {one['model']}",
            list(zip(one["range_m"], one["probability"], strict=True)),
            list(zip(one["low"], one["high"], strict=True)),
        )
        for one in curves
    ]
    ends = [min(one["range_m"][0] for one in curves), max(one["range_m"][-1] for one in curves)]
    wanted = [(end, told["probability"]) for end in ends]
    series.append(Series(f"{100 * told['probability']:g} %, as asked", wanted))
    names = list(ranges[0])
    lists = [
        {key: v[n] if isinstance(v, list) else v for key, v in one.items()}
        for one in curves
        for n in range(len(one["range_m"]))
    ]
    lost = [
        {LOSSES.get(key, key): v[n] if isinstance(v, list) else v for key, v in one.items()}
        for one in losses
        for n in range(len(one["range_m"]))
    ]
    percent = 100 * told["probability"]
    label = "probability of detection, with its 95 % interval"
    sections = [
        Section(
            f"Range at {percent:g} %",
            table=page.table(names, [[one[name] for name in names] for one in ranges]),
        ),
        Section("Curve", chart=page.chart(series, "range / m", label, (0.0, 1.0))),
        Section("To be read with it", texts=told["notes"]),
        Section("Detection", table=_records(lists)),
        Section("d' with part of what hinders it", table=_records(lost)),
    ]
    title = f"{told['scenario']}: at what range {told['target']} is detected"
    asked = f"{told['false_alarm']:g} false alarms a test, {told['air']} airs, seed {told['seed']}"
    return page.render(title, asked, sections)


def _records(records: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    if not records:
        return None
    columns = list(records[0])
    return page.table(columns, [[one[name] for name in columns] for one in records], sorts=True)
