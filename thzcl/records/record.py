"""From rows to a record: in even steps of time, in thzcl's units, without what cannot be air.

Gaps, repeated stamps, spikes and impossible values are found and counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import moisture, plausible, spikes, units
from thzcl.records.columns import BY_SIZE, SECOND, Column
from thzcl.records.joining import Joined, join
from thzcl.records.reading import Rows, read

Array = NDArray[np.float64]

MOST_MISSING = plausible.MOST_MISSING
SLOWEST_M_S = 0.1  # mean wind: below, there is no wind run
MANY_SPIKES = 0.01  # of the samples
KINDS = {
    "mole": "mole fraction",
    "mole-dry": "dry mole ratio",
    "specific": "specific humidity",
    "ratio": "mixing ratio",
    "relative": "relative humidity",
}
CHECKED_S = 3600.0  # over which relative humidity is taken
STANDARD_HPA = 1013.25
MEASURED = ("h2o", SECOND, "Ts", "SOS", "T", "Ux", "Uy", "Uz", "speed")  # searched for spikes
WIND = ("Ux", "Uy", "Uz")
TEMPERATURES = ("Ts", "SOS", "T")


@dataclass(frozen=True)
class Record:
    """A hygrometer's record in even steps of time, NaN where nothing or a spike was measured.

    `humidity` (n,) is in g/m3; `wind` (component, n) in m/s, with one component where only a speed
    was measured; `temperature` (n,) in K, of air, or None; `sonic` (n,) in K is the sonic's own, or
    None; `pressure_hpa` is its mean, or None; `second` (n,) in g/m3 is another hygrometer's of the
    same file, or None. The counts are of what was found in the files. `columns` says how each
    column was understood, `others` what other columns of humidity there are.
    """

    files: tuple[str, ...]
    station: str
    start: float  # seconds from 1970, or of the file's own clock
    dated: bool
    rate_hz: float
    humidity: Array
    wind: Array
    temperature: Array | None
    pressure_hpa: float | None
    gaps: int  # samples without humidity, in all
    repeats: int
    out_of_order: int
    spikes: dict[str, int]  # by column
    notes: tuple[str, ...]
    sonic: Array | None = None
    second: Array | None = None
    masked: dict[str, int] = field(default_factory=dict)  # impossible values by column
    columns: tuple[dict[str, Any], ...] = ()
    others: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """Returns the number of samples, missing ones included."""
        return len(self.humidity)

    @property
    def wind_speed_m_s(self) -> float:
        """Returns the magnitude of the mean wind vector, or the mean of a speed."""
        return float(np.linalg.norm(np.nanmean(self.wind, axis=1)))


@dataclass
class _Draft:
    """A record while it is made: values by role, and what was noticed."""

    joined: Joined
    first: Rows
    columns: dict[str, Column]
    values: dict[str, Array]
    notes: list[str]
    masked: dict[str, int] = field(default_factory=dict)

    def place(self, sample: int, role: str) -> str:
        """Returns file, line and column of a sample."""
        return self.joined.place(sample, role)

    def begin(self, role: str) -> str:
        """Returns file, first line and column of a role."""
        return self.first.place(0, role)

    def drop(self, role: str, reason: str) -> None:
        """Leaves a column out, with a note."""
        del self.values[role]
        self.notes.append(f"column {self.columns[role].name} is left out: {reason}")


def load(
    paths: Sequence[Path],
    columns: str = "",
    rate_hz: float | None = None,
    pressure_hpa: float | None = None,
    companion: bool = False,
) -> Record:
    """Returns the record in one file, or in several files of one station.

    `columns` is as in columns.find; `rate_hz` are samples a second where the files have no time, or
    stamps of whole seconds; `pressure_hpa` takes the place of the record's own. A `companion`, the
    record of another hygrometer beside the first, needs no wind. Raises RecordError if the files
    hold no record; the message says file, line, column and what was expected.
    """
    draft = _draft(join(_all_read(paths, columns, rate_hz, companion), rate_hz))
    _mask(draft)
    _check(draft)
    gaps = int(np.isnan(draft.values["h2o"]).sum())
    told = {
        draft.columns[role].name: spikes.remove(draft.values[role], draft.joined.rate_hz)
        for role in MEASURED
        if role in draft.values
    }
    draft.notes += _many(told, draft.joined.samples)
    return _finished(draft, gaps, told, pressure_hpa)


def _all_read(
    paths: Sequence[Path], columns: str, rate_hz: float | None, companion: bool
) -> list[Rows]:
    """Returns the rows of all files. Raises RecordError with the problems of all of them."""
    found, problems = [], []
    for path in paths:
        try:
            found.append(read(path, columns, rate_hz, companion))
        except RecordError as error:
            problems += str(error).splitlines()
    if problems:
        raise RecordError("\n".join(dict.fromkeys(problems)))
    return found


def _draft(joined: Joined) -> _Draft:
    """Returns the columns of all files in even steps of time, flagged samples masked."""
    first, parts = joined.parts[0], joined.parts
    values = {role: joined.even([p.values.pop(role) for p in parts]) for role in [*first.values]}
    names = [name for name in first.flags if all(name in part.flags for part in parts)]
    flags = {name: joined.even([part.flags[name] for part in parts]) for name in names}
    notes = list(dict.fromkeys(note for part in parts for note in part.notes))
    draft = _Draft(joined, first, dict(first.columns), values, [*notes, *joined.notes])
    draft.notes += plausible.mask_flagged(values, flags, draft.place)
    return draft


def _mask(draft: _Draft) -> None:
    """Masks what no column can mean; columns that are not needed are left out where unsound."""
    for role in [*draft.values]:
        column = draft.columns[role]
        if column.assumed == BY_SIZE and role not in ("h2o", SECOND):
            _infer(draft, role)
            column = draft.columns[role]
        try:
            count, note = plausible.mask_impossible(role, column, draft.values[role], draft.place)
        except RecordError as error:
            if role in ("h2o", "Ux", "Uy", "speed"):
                raise
            draft.drop(role, str(error).partition(": ")[2])
            continue
        if count:
            draft.masked[column.name] = count
            draft.notes.append(note)
    stuck, note = plausible.mask_stuck(draft.values["h2o"], draft.joined.rate_hz, draft.place)
    if stuck:
        name = draft.columns["h2o"].name
        draft.masked[name] = draft.masked.get(name, 0) + stuck
        draft.notes.append(note)


def _infer(draft: _Draft, role: str) -> None:
    """Turns a column without a unit into K or hPa, and says so.

    Its size leaves no doubt whether it is in degrees or kelvin, or in Pa, hPa or kPa.
    """
    values = draft.values[role]
    typical = float(np.nanmedian(values)) if np.isfinite(values).any() else 0.0
    if role in ("Ts", "T"):
        unit, table = ("degC" if typical < 150 else "K"), units.DEGREES
    else:
        unit = "Pa" if typical > 2000 else "kPa" if typical < 200 else "hPa"
        table = units.PRESSURES
    factor, offset = table[unit.lower()]
    draft.values[role] = values * factor + offset
    draft.columns[role] = draft.columns[role]._replace(
        factor=factor, offset=offset, assumed=BY_SIZE, unit=unit
    )


def _check(draft: _Draft) -> None:
    """Raises RecordError if a needed column has too many gaps or is constant.

    Other columns are left out then.
    """
    horizontal = {"Ux", "Uy"} <= draft.values.keys()
    needed = ("h2o", "Ux", "Uy") if horizontal else ("h2o", "speed")
    for role in ("speed",) if horizontal else ("Ux", "Uy"):  # components say more than a speed
        draft.values.pop(role, None)
    for role, found in [*draft.values.items()]:
        missing = float(np.isnan(found).mean())
        told = ""
        if missing > MOST_MISSING:
            told = (
                f"{100 * missing:.3g} % of its values are missing; "
                f"expected {MOST_MISSING:.0%} at most"
            )
        elif role in ("h2o", SECOND, *TEMPERATURES) and np.nanmax(found) - np.nanmin(
            found
        ) < 1e-9 * np.nanmax(np.abs(found)):
            value = (float(np.nanmean(found)) - draft.columns[role].offset) / draft.columns[
                role
            ].factor
            told = f"holds {value:.6g} throughout; expected a signal that fluctuates"
        if told and role in needed:
            raise RecordError(f"{draft.begin(role)}: {told}")
        if told:
            draft.drop(role, told)


def _many(told: dict[str, int], samples: int) -> Iterator[str]:
    """Yields notes on columns with many spikes."""
    for name, count in told.items():
        if count > MANY_SPIKES * samples:
            yield f"{100 * count / samples:.2g} % of column {name} are spikes and left out"


def _finished(draft: _Draft, gaps: int, told: dict[str, int], pressure_hpa: float | None) -> Record:
    """Returns the record of a draft: humidity as density, temperature of air, mean wind."""
    values, joined = draft.values, draft.joined
    pressure = _pressure(draft, pressure_hpa)
    humidity, temperature, sonic = _air(draft, "h2o", pressure)
    second = _air(draft, SECOND, pressure)[0] if SECOND in values else None
    length = max(int(CHECKED_S * joined.rate_hz), 1)
    known = None if pressure is None else float(np.nanmean(pressure))
    thermometer = values.get("T", temperature)
    _, notes = plausible.check_saturation(
        draft.columns["h2o"], humidity, thermometer, known, length, draft.begin("h2o")
    )
    components = [role for role in (*WIND, "speed") if role in values]
    wind = np.array([values[role] for role in components])
    if components:  # another hygrometer's file may have no wind
        _check_wind(draft, wind, components)
    return Record(
        files=tuple(str(part.layout.path) for part in joined.parts),
        station=draft.first.layout.station,
        start=joined.start,
        dated=draft.first.dated,
        rate_hz=joined.rate_hz,
        humidity=humidity,
        wind=wind,
        temperature=temperature,
        pressure_hpa=known,
        gaps=gaps,
        repeats=joined.repeats,
        out_of_order=joined.out_of_order,
        spikes=told,
        notes=tuple(dict.fromkeys([*draft.notes, *notes, *_taken(draft, pressure)])),
        sonic=sonic,
        second=second,
        masked=draft.masked,
        columns=tuple(_understood(draft)),
        others=draft.first.others,
    )


def _pressure(draft: _Draft, given: float | None) -> Array | float | None:
    """Returns the pressure in hPa: given, the record's (gaps filled with its mean), or None."""
    if given is not None:
        return given
    own = draft.values.get("pressure")
    if own is None:
        return None
    return np.where(np.isfinite(own), own, np.nanmean(own))


def _air(
    draft: _Draft, role: str, pressure: Array | float | None
) -> tuple[Array, Array | None, Array | None]:
    """Returns humidity in g/m3, and air and sonic temperature in K, or None where there is none.

    Raises RecordError if humidity's kind needs a temperature or a pressure that is not there.
    """
    values, kind = draft.values[role], draft.columns[role].kind
    sonic = draft.values.get("Ts")
    if sonic is None and "SOS" in draft.values:
        sonic = draft.values["SOS"] ** 2 / moisture.SOUND
    air = draft.values.get("T")
    wanting = [
        what
        for what, missing in (
            (
                "a pressure (or --pressure-hpa)",
                kind in moisture.NEEDS_PRESSURE and pressure is None,
            ),
            ("a temperature (Ts, T or SOS)", kind != "density" and sonic is None and air is None),
        )
        if missing
    ]
    if wanting:
        name, unit = draft.columns[role].name, draft.columns[role].unit
        raise RecordError(
            f"{draft.begin(role)}: {name} in {unit} becomes g/m3 with {' and '.join(wanting)}; "
            "the record has none"
        )
    hectopascals = STANDARD_HPA if pressure is None else pressure
    if kind == "density":
        if sonic is not None:
            air = moisture.true_temperature(sonic, values, hectopascals)
        return values, air, sonic
    if kind == "relative":
        if sonic is not None:
            air = moisture.dry_by_relative(sonic, values, hectopascals)
        assert air is not None  # noqa: S101 (else it was wanting)
        return moisture.from_relative(values, air), air, sonic
    share = moisture.vapour_share(values, kind)
    if sonic is not None:
        air = moisture.dry_by_share(sonic, share)
    assert air is not None  # noqa: S101 (else it was wanting)
    return moisture.density(share, air, hectopascals), air, sonic


def _check_wind(draft: _Draft, wind: Array, components: Sequence[str]) -> None:
    """Raises RecordError if there is no wind run to speak of."""
    speed = float(np.linalg.norm(np.nanmean(wind, axis=1)))
    if not speed >= SLOWEST_M_S:
        names = ", ".join(draft.columns[role].name for role in components)
        layout = draft.first.layout
        raise RecordError(
            f"{layout.path}:{layout.first_line}: column {names}: mean wind of {speed:.3g} m/s; "
            f"expected at least {SLOWEST_M_S:g} m/s, for time to become distance"
        )


def _taken(draft: _Draft, pressure: Array | float | None) -> Iterator[str]:
    """Yields what was taken for granted."""
    for role in draft.values:
        column = draft.columns[role]
        if column.assumed == BY_SIZE:
            say = f"if it is another, name it with --columns {role}={column.name}:UNIT"
            yield f"column {column.name} names no unit: taken as {column.unit} by its size; {say}"
        elif column.assumed and role in ("h2o", SECOND):
            say = f"if it is mmol/m3, mmol/mol or another, name it with --columns {role}="
            yield (
                f"column {column.name} names no unit: taken as {column.assumed}; "
                f"{say}{column.name}:UNIT"
            )
        elif column.assumed:
            yield f"column {column.name} names no unit: taken as {column.assumed}"
    if "speed" in draft.values:
        yield (
            "wind is a speed without direction: its mean exceeds the mean vector, "
            "and so does the wind run"
        )
    sonic = "Ts" in draft.values or "SOS" in draft.values
    if "Ts" not in draft.values and "SOS" in draft.values:
        name = draft.columns["SOS"].name
        yield f"sonic temperature is taken from {name}, the speed of sound: its square over 402.7"
    if not sonic and "T" in draft.values:
        yield f"temperature is {draft.columns['T'].name}, taken as it is, and not sonic"
    if sonic and pressure is None:
        yield "no pressure: 1013.25 hPa taken to correct sonic temperature for humidity"
    kind = draft.columns["h2o"].kind
    if kind != "density" and not sonic:
        yield "humidity is converted with a thermometer: if slow, its density lacks fast changes"


def _understood(draft: _Draft) -> Iterator[dict[str, Any]]:
    """Yields how each column was understood."""
    for role, column in draft.first.columns.items():
        own = draft.columns[role]
        what = KINDS.get(column.kind, "")
        timed = role.partition(":")[0] == "time"
        unit = draft.first.time_told or own.unit if timed else own.unit
        found = draft.values.get(role)
        yield {
            "column": column.name or "(without a name)",
            "role": role,
            "unit": " ".join(filter(None, [what, unit])),
            "assumed": bool(own.assumed),
            "present": None if found is None else int(np.isfinite(found).sum()),
            "mean": None if found is None or not np.isfinite(found).any()
            else float(np.nanmean(found)),
        }  # fmt: skip
