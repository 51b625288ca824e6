"""What no hygrometer, anemometer or thermometer in air can mean: masked and counted, or refused.

Sign, range, codes of loggers, diagnostic flags, saturation, dryness, and units that were exchanged.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import RecordError
from thzcl.records import moisture, units
from thzcl.records.columns import Column

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_MISSING = 0.2  # of the samples of a column
# Codes of loggers for what could not be measured, as they stand in files.
CODES = np.array(
    [s * c for c in (99.99, 999.0, 999.9, 999.99, 6999.0, 7999.0, 8191.0, 9999.0, 99999.0, 32767.0)
     for s in (1, -1)]
)  # fmt: skip
CODE_SPREADS = 8.0  # from the median, in spreads of the middle 90 %, at least
# What is possible, by role, or by kind of humidity, in thzcl's units; humidity is positive.
POSSIBLE = {
    "density": (0.0, 150.0),
    "mole": (0.0, 0.25),
    "mole-dry": (0.0, 0.3),
    "specific": (0.0, 0.2),
    "ratio": (0.0, 0.25),
    "relative": (0.0, 200.0),
    "Ux": (-75.0, 75.0),
    "Uy": (-75.0, 75.0),
    "Uz": (-40.0, 40.0),
    "speed": (0.0, 75.0),
    "Ts": (180.0, 345.0),
    "T": (180.0, 345.0),
    "SOS": (270.0, 375.0),
    "pressure": (300.0, 1100.0),
}
CSAT3_COUNTER, CSAT3_FLAGS = 64, 4096  # lower six bits; lowest of the four bits that are flags
COUNTING = 0.8  # of the samples, by which a counter is known
STUCK_S, STUCK = 10.0, 100  # seconds and samples of one value
NOTED_RH, WETTEST_RH, DRIEST_RH = 105.0, 120.0, 1.0  # per cent over water, of a batch's mean
DRIEST_G_M3, WETTEST_G_M3 = 0.02, 100.0  # of a mean, where no temperature tells more
ASSUMED_K, ASSUMED_HPA = 288.15, 1013.25  # to guess a unit with, where the record has neither


def mask_flagged(
    values: dict[str, Array], flags: dict[str, Array], place: Callable[[int, str], str]
) -> Iterator[str]:
    """Sets to NaN what diagnostic flags mark, in place, and yields notes.

    A flag counts where it is not 0, or, for LI-COR's, where its upper bits are not set, or, for a
    CSAT3's raw word, where its upper four bits are set (the lower six are a counter; Campbell
    Scientific, CSAT3 instruction manual, diagnostic word). Raises RecordError if a flag marks more
    than a fifth of the samples.
    """
    for name, flag in flags.items():
        bad = _flagged(flag)
        if bad is None:
            usual = f"{_usual(flag):g}"
            yield f"column {name} is {usual} as a rule, and not 0: it is not used as a flag"
            continue
        count = int(bad.sum())
        if count > MOST_MISSING * len(flag):
            first = int(np.argmax(bad))
            raise RecordError(
                f"{place(first, '')}: column {name} is not 0 in {count} of {len(flag)} samples; "
                f"expected {MOST_MISSING:.0%} at most; is the instrument sound? "
                "To use its data all the same: --columns diag=none"
            )
        if count:
            roles = [role for role in _meant(name) if role in values]
            for role in roles:
                values[role][bad] = np.nan
            yield f"column {name} is not 0 in {count} samples: they are gaps in {', '.join(roles)}"


def mask_stuck(values: Array, rate_hz: float, place: Callable[[int, str], str]) -> tuple[int, str]:
    """Sets humidity to NaN, in place, where it is the same for ten seconds and a hundred samples.

    Returns how many samples that are, and a note. A column that never changes is left as it is.
    Raises RecordError if that is more than a fifth of the samples.
    """
    present = np.isfinite(values)
    if not present.any() or np.ptp(values[present]) == 0:
        return 0, ""
    begins = np.flatnonzero(np.diff(values, prepend=np.nan) != 0)  # NaN differs from all
    lengths = np.diff([*begins, len(values)])
    stuck = (lengths >= max(STUCK_S * rate_hz, STUCK)) & present[begins]
    for begin, length in zip(begins[stuck].tolist(), lengths[stuck].tolist(), strict=True):
        values[begin : begin + length] = np.nan
    count = int(lengths[stuck].sum())
    if not count:
        return 0, ""
    first = int(begins[stuck][0])
    told = f"{place(first, 'h2o')}: {count} values in runs of up to {lengths[stuck].max()} samples"
    if count > MOST_MISSING * len(values):
        raise RecordError(
            f"{told} that do not change; expected {MOST_MISSING:.0%} at most: a stuck instrument, "
            "or one of coarse steps?"
        )
    return count, f"{told} that do not change are left out as gaps: a stuck instrument?"


def _usual(flag: Array) -> float:
    """Returns the commonest value of a flag."""
    present = flag[np.isfinite(flag)]
    found, counts = np.unique(present, return_counts=True)
    return float(found[np.argmax(counts)]) if len(found) else 0.0


def _is_counting(flag: Array) -> bool:
    """Returns whether the lower six bits of a flag count from sample to sample, as CSAT3's do."""
    steps = np.diff(flag % CSAT3_COUNTER) % CSAT3_COUNTER
    return bool(np.mean(steps == 1) > COUNTING)


def _flagged(flag: Array) -> Mask | None:
    """Returns where a flag is raised, or None if its values are not understood."""
    usual = _usual(flag)
    present = np.isfinite(flag)
    if _is_counting(flag):
        return np.asarray(present & (flag >= CSAT3_FLAGS))
    if usual == 0:
        return np.asarray(present & (flag != 0))
    if 240 <= usual <= 255:  # LI-7500: the upper four bits are set where all is well
        whole = np.where(present, flag, usual).astype(np.int64)
        return np.asarray((whole & 0xF0) != 0xF0)
    return None


def _meant(name: str) -> tuple[str, ...]:
    """Returns the roles whose values a flag is of, by its name."""
    word = name.lower()
    if any(part in word for part in ("irga", "gas", "h2o", "li7", "ga_", "co2", "licor", "ec150")):
        return ("h2o", "h2o_2")
    if any(part in word for part in ("sonic", "csat", "sat", "sa_", "anem", "wind", "usa")):
        return ("Ux", "Uy", "Uz", "speed", "Ts", "SOS")
    return ("h2o", "Ux", "Uy", "Uz", "speed", "Ts", "SOS")


def mask_impossible(
    role: str, column: Column, values: Array, place: Callable[[int, str], str]
) -> tuple[int, str]:
    """Sets to NaN what a column cannot mean, in place; returns how many there were, and a note.

    Raises RecordError if they are more than a fifth, with the likely unit.
    """
    low, high = POSSIBLE[column.kind or role]
    with np.errstate(invalid="ignore"):
        wrong = (values < low) | (values > high)
        if column.kind:
            wrong |= values <= 0
    wrong |= _codes(column, values, wrong)
    count, present = int(wrong.sum()), int(np.isfinite(values).sum())
    if not count:
        return 0, ""
    first = int(np.argmax(wrong))
    example = (float(values[first]) - column.offset) / column.factor
    if count > MOST_MISSING * present:
        unit = column.unit or "no unit"
        raise RecordError(
            f"{place(first, role)}: {count} of {present} values cannot be of air in {unit}, such "
            f"as {example:.6g} here: is its unit right?{_likely_of(role, column, values)}"
        )
    values[wrong] = np.nan
    where = place(first, role)
    return count, (
        f"{where}: {count} values that {role} cannot have, {example:.6g} the first of them, are "
        "left out as gaps"
    )


def _codes(column: Column, values: Array, wrong: Mask) -> Mask:
    """Returns where a value is a logger's code: known, repeated, and far from all others."""
    raw = (values - column.offset) / column.factor
    sound = raw[np.isfinite(raw) & ~wrong]
    if not len(sound):
        return np.zeros(len(values), dtype=np.bool_)
    low, middle, high = np.quantile(sound, (0.05, 0.5, 0.95))
    found = np.zeros(len(values), dtype=np.bool_)
    if high <= low:
        return found
    for code in CODES:
        if abs(code - middle) > CODE_SPREADS * (high - low):
            same = np.abs(raw - code) < 1e-6 * abs(code)
            if same.sum() > 1:
                found |= same
    return found


def _likely_of(role: str, column: Column, values: Array) -> str:
    """Returns a hint at the unit that a column of another role than humidity may have."""
    raw = float(np.nanmedian((values - column.offset) / column.factor))
    if column.kind:
        return guess(raw, None, None)
    tables = {"Ts": units.DEGREES, "T": units.DEGREES, "pressure": units.PRESSURES}
    low, high = POSSIBLE[role]
    known = tables.get(role, units.SPEED)
    fitting = [u for u, (factor, offset) in known.items() if low < raw * factor + offset < high]
    return f" Perhaps it is {fitting[0]}" if fitting else ""


def guess(raw: float, temperature_k: float | None, pressure_hpa: float | None) -> str:
    """Returns a hint at the units in which a mean humidity would be that of air, or no text."""
    kelvin = temperature_k or ASSUMED_K
    fitting = []
    for name, (factor, _) in units.DENSITIES.items():
        if 5 < float(moisture.relative(raw * factor, kelvin)) < 102:
            fitting.append(name)
    for name in ("mmol/mol", "umol/mol", "g/kg", "kg/kg"):
        kind, table = ("mole", units.FRACTIONS) if "mol" in name else ("specific", units.MASSES)
        share = moisture.vapour_share(np.float64(raw * table[name][0]), kind)  # type: ignore[arg-type]
        grams = moisture.density(share, kelvin, pressure_hpa or ASSUMED_HPA)
        if 5 < float(moisture.relative(grams, kelvin)) < 102:
            fitting.append(name)
    return f" In {' or '.join(fitting[:3])} it would be that of air" if fitting else ""


def check_saturation(
    column: Column,
    humidity: Array,
    temperature_k: Array | None,
    pressure_hpa: float | None,
    length: int,
    place: str,
) -> tuple[int, list[str]]:
    """Masks batches of `length` samples that are too wet or too dry to be air; returns notes.

    Relative humidity over water, of a batch's mean: a note from 105 %, gaps from 120 % on and below
    1 %. Raises RecordError if no batch is left. Without a temperature the mean density is judged.
    """
    mean = float(np.nanmean(humidity))
    factor = column.factor if column.kind == "density" else 1.0
    kelvin = None if temperature_k is None else float(np.nanmean(temperature_k))
    hint = guess(mean / factor, kelvin, pressure_hpa) if column.kind == "density" else ""
    name, unit = column.name, column.unit
    if temperature_k is None:
        if DRIEST_G_M3 <= mean <= WETTEST_G_M3:
            return 0, []
        raise RecordError(
            f"{place}: a mean of {mean:.4g} g/m3, read as {unit}; expected {DRIEST_G_M3:g} to "
            f"{WETTEST_G_M3:g} g/m3: is its unit right?{hint}"
        )
    shares = []
    edges = np.append(np.arange(0, max(len(humidity) - length // 2, 1), length), len(humidity))
    for start, stop in itertools.pairwise(edges):
        there = np.isfinite(humidity[start:stop]) & np.isfinite(temperature_k[start:stop])
        if there.any():
            grams = humidity[start:stop][there].mean()
            percent = float(moisture.relative(grams, temperature_k[start:stop][there].mean()))
            shares.append((int(start), int(stop), percent))
    wrong = [s for s in shares if not DRIEST_RH <= s[2] <= WETTEST_RH]
    if wrong and len(wrong) == len(shares):
        percent = float(np.mean([share for _, _, share in shares]))
        what = "above saturation" if percent > 100 else "drier than air is"
        raise RecordError(
            f"{place}: a mean of {mean:.4g} g/m3, read as {unit}, at {kelvin:.2f} K is "
            f"{percent:.3g} % relative humidity, {what}: is its unit right?{hint}; "
            f"name it with --columns h2o={name}:UNIT"
        )
    for start, stop, _ in wrong:
        humidity[start:stop] = np.nan
    return len(wrong), list(_told(shares, wrong))


def _told(
    shares: list[tuple[int, int, float]], wrong: list[tuple[int, int, float]]
) -> Iterator[str]:
    """Yields notes on batches near or beyond saturation."""
    if wrong:
        extreme = max((share for _, _, share in wrong), key=lambda s: abs(np.log(max(s, 1e-9))))
        yield (
            f"{len(wrong)} of {len(shares)} batches are left out: their mean relative humidity of "
            f"{extreme:.3g} % is beyond saturation or drier than air is (fog, dew or drift?)"
        )
    near = [share for _, _, share in shares if NOTED_RH <= share <= WETTEST_RH]
    if near:
        yield (
            f"the mean relative humidity of {len(near)} of {len(shares)} batches is up to "
            f"{max(near):.4g} %, above saturation: fog, dew or drift?"
        )
