"""`thzcl range`: up to what range a target is detected, how sure that is, and what is lost.

Half of the airs teach the observer, the other half test it. Each air is seen with and without the
target. The rate of false alarms is that of one test at one known place, not of a whole picture.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thzcl import metrics
from thzcl.air.spectrum import values as numbers
from thzcl.clock import Progress
from thzcl.errors import FileError, ScenarioError, UsageError
from thzcl.files import RECORD, make_folder, read_json, read_text, write_whole
from thzcl.results.versions import versions
from thzcl.scenario import document as documents
from thzcl.scenario.text import dumps
from thzcl.studies.detection import intervals
from thzcl.studies.detection.intervals import FEWEST_AIRS, Detection, Estimate, Reach
from thzcl.studies.detection.observer import CELLS, HOTELLING, NPW, Observer, Training
from thzcl.studies.detection.passes import Key, Pass
from thzcl.studies.detection.scenes import Base, Pair, RangeRefusedError, Scenes, airs, joined

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

Array = NDArray[np.float64]
_SEED = re.compile(r"[0-9]{1,19}")
DEFAULT_RANGES = "10:200:10"
TOGETHER = 5  # ranges that are computed together, for which an air's cube is made once
SAVED_S = 5.0  # between writing what airs have told
CLEAR_DRAWS = 16  # draws of the noise over which the signal in transparent air is averaged
CLEAR = {
    "atmosphere.fluctuations": None,
    "atmosphere.model": "none",
    "atmosphere.compare": None,
    "atmosphere.model_file": None,
    **dict.fromkeys(("atmosphere.rain", "atmosphere.fog", "atmosphere.snow")),
}


@dataclass(frozen=True)
class Question:
    """What is asked: a target, where it stands, and how it is to be detected."""

    base: Base
    range_m: tuple[float, ...]
    frequency_ghz: tuple[float | None, ...]
    probability: float
    false_alarm: float
    airs: int
    seed: int
    observer: str

    @property
    def identity(self) -> str:
        """Returns a hash of all that samples at one range depend on."""
        what = (
            dumps(self.base.document.data), self.base.target, self.frequency_ghz,
            self.false_alarm, self.airs, self.seed, self.observer, versions(),
        )  # fmt: skip
        return hashlib.sha256(json.dumps(what, default=str).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Samples:
    """What was found of one range, frequency and model.

    `null` and `present` are the statistics (air, draw) without and with the target; `pixels` how
    many show the target; `losses` d' by what is left of air and noise.
    """

    frequency_ghz: float
    model: str
    observer: str
    sign: float
    tail: str
    pixels: float
    losses: Mapping[str, float | None]
    null: Array
    present: Array


@dataclass(frozen=True)
class Curve:
    """Detection against range, at one frequency by one model."""

    frequency_ghz: float
    model: str
    range_m: tuple[float, ...]
    found: tuple[Detection, ...]
    samples: tuple[Samples, ...]
    reach: Reach


@dataclass(frozen=True)
class RangeResult:
    """The answer to a question about range."""

    question: Question
    curves: tuple[Curve, ...]
    notes: tuple[str, ...]
    files: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Returns what `thzcl range --format json` prints."""
        asked = self.question
        return {
            "scenario": asked.base.document.name,
            "target": asked.base.target,
            "probability": asked.probability,
            "false_alarm": asked.false_alarm,
            "air": asked.airs,
            "seed": asked.seed,
            "observer": asked.observer,
            "curves": [_curve(one) for one in self.curves],
            "ranges": [
                {
                    "frequency_ghz": one.frequency_ghz,
                    "model": one.model,
                    "probability": asked.probability,
                    **asdict(one.reach),
                }
                for one in self.curves
            ],
            "losses": [_losses(one) for one in self.curves],
            "notes": list(self.notes),
            "files": list(self.files),
        }

    def records(self) -> list[dict[str, Any]]:
        """Returns a row for each frequency, model and range, as the CSV file has it."""
        found = []
        for curve in self.curves:
            lists = _curve(curve) | {k: v for k, v in _losses(curve).items() if k != "range_m"}
            found += [
                {name: v[place] if isinstance(v, list) else v for name, v in lists.items()}
                for place in range(len(curve.range_m))
            ]
        return found


def _curve(curve: Curve) -> dict[str, Any]:
    """Returns a curve as lists that are alike in length."""
    each: dict[str, list[Any]] = {"range_m": list(curve.range_m)}
    for name, of in (("probability", ""), ("d_prime", "d_prime_"), ("area", "area_")):
        ends: list[Estimate] = [getattr(one, name) for one in curve.found]
        each[name] = [_number(end.value) for end in ends]
        each[f"{of}low"] = [_number(end.low) for end in ends]
        each[f"{of}high"] = [_number(end.high) for end in ends]
    each["tail"] = [one.tail for one in curve.found]
    each["fit"] = [one.fit for one in curve.found]
    each["observer"] = [one.observer for one in curve.samples]
    each["pixels_on_target"] = [one.pixels for one in curve.samples]
    return {"frequency_ghz": curve.frequency_ghz, "model": curve.model, **each}


def _losses(curve: Curve) -> dict[str, Any]:
    """Returns d' by what is left of air and noise, as lists over range."""
    first = curve.samples[0].pixels
    rows = []
    for one in curve.samples:
        whole = one.losses["whole"]
        pixels = None if whole is None or not one.pixels else whole * (first / one.pixels) ** 0.5
        rows.append({**one.losses, "pixels": pixels})
    names = ("absorption", "clutter", "noise", "pixels")
    lists = {name: [row[name] for row in rows] for name in names}
    key = {"frequency_ghz": curve.frequency_ghz, "model": curve.model}
    return {**key, "range_m": list(curve.range_m), **lists}


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def detection_range(
    source: documents.Source,
    target: str,
    *,
    ranges: str | Sequence[float] | None = None,
    frequency_ghz: str | Sequence[float] | None = None,
    probability: float = 0.9,
    false_alarm: float = 0.01,
    air: int = 100,
    seed: int | None = None,
    observer: str = HOTELLING,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | Device | None = None,
    folder: str | Path | None = None,
    allow_outside: bool = False,
    progress: Progress | None = None,
) -> RangeResult:
    """Returns the probability of detecting a target against range, and the range that is asked for.

    `target` names it; `ranges` are slant ranges from the camera to its centre in m ("10:200:10" if
    None), `frequency_ghz` those to which the sensor is set (None: its own). `probability` is that
    of detection at the range wanted, `false_alarm` that of one test at one known place. `air` airs
    are drawn from `seed`, half to learn and half to test; `observer` is "hotelling" or "npw". With
    a `folder` what is done of each range is kept there, and not done again. Raises UsageError and
    ScenarioError for what cannot be asked, DeviceError without a usable device.
    """
    _refuse(probability, false_alarm, air, observer)
    seed = _seed(folder, documents.name_of(source), None if seed is None else index(seed))
    document = documents.read(source, settings, seed)
    base = Base.of(document, documents.chosen(variants), target, allow_outside)
    wanted = _frequencies(base, frequency_ghz)
    by_hand = ranges is not None
    places, notes = _places(
        base,
        _list(DEFAULT_RANGES if ranges is None else ranges, "--ranges"),
        wanted,
        by_hand=by_hand,
    )
    asked = Question(base, places, wanted, probability, false_alarm, air, seed, observer)
    kept = None if folder is None else Path(folder) / f"{document.name}-range"
    if kept is not None:
        make_folder(kept)
        write_whole(kept / "seed", lambda part: part.write_text(f"{seed}\n", encoding="utf-8"))
    found = _computed(asked, kept, device, progress)
    curves = _curves(asked, found)
    return RangeResult(asked, curves, (*notes, *_notes(asked, curves)))


def _seed(folder: str | Path | None, name: str, seed: int | None) -> int:
    """Returns the seed that is given, or that of what the folder holds, or a new one."""
    if seed is not None:
        return seed
    if folder is not None:
        path = Path(folder) / f"{name}-range" / "seed"
        if path.is_file() and _SEED.fullmatch(text := read_text(path, RECORD).strip()):
            return int(text)
    return secrets.randbits(32)


def _refuse(probability: float, false_alarm: float, air: int, observer: str) -> None:
    """Raises UsageError for a question that makes no sense."""
    if not 0 < probability < 1:
        raise UsageError(f"--probability {probability:g}: must lie between 0 and 1")
    if not 0 < false_alarm < 0.5:
        raise UsageError(f"--false-alarm {false_alarm:g}: must lie between 0 and 0.5")
    if air < FEWEST_AIRS:
        text = "half of them learn and half test, which takes at least"
        raise UsageError(f"--air {air}: {text} {FEWEST_AIRS}")
    if observer not in (HOTELLING, NPW):
        raise UsageError(f"--observer {observer}: must be {HOTELLING} or {NPW}")


def _list(values: str | Sequence[float], option: str) -> tuple[float, ...]:
    """Returns values above 0, ascending, each once. Raises UsageError."""
    try:
        given = numbers(values) if isinstance(values, str) else np.asarray(values, np.float64)
        found = np.atleast_1d(given)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{option}: {error}") from None
    if not found.size or not np.isfinite(found).all() or found.min() <= 0:
        raise UsageError(f"{option}: give values above 0")
    return tuple(sorted({float(value) for value in found}))


def _frequencies(base: Base, given: str | Sequence[float] | None) -> tuple[float | None, ...]:
    """Returns the frequencies to ask at, GHz; None is the sensor's own. Raises UsageError."""
    if given is None:
        return (None,)
    if base.key is None:
        kind = base.document.data["sensor"]["kind"]
        text = f"the sensor {kind} has neither frequency_ghz nor center_ghz; leave it out"
        raise UsageError(f"--frequency-ghz: {text}")
    return _list(given, "--frequency-ghz")


def _places(
    base: Base, wanted: tuple[float, ...], ghz: tuple[float | None, ...], *, by_hand: bool
) -> tuple[tuple[float, ...], list[str]]:
    """Returns the ranges at which the target can stand, and notes on those left out.

    Raises UsageError for a range that is given by hand and cannot be.
    """
    found, notes = [], []
    for range_m in wanted:
        try:
            base.at(range_m, {} if ghz[0] is None or base.key is None else {base.key: ghz[0]})
        except RangeRefusedError as error:
            if by_hand:
                raise UsageError(f"--ranges: {error}") from None
            notes.append(f"{range_m:g} m is left out: {error}")
        else:
            found.append(range_m)
    if not found:
        raise UsageError(f"--ranges: none is left; {notes[-1]}")
    return tuple(found), notes


def _computed(
    asked: Question, kept: Path | None, device: str | Device | None, progress: Progress | None
) -> dict[float, list[Samples]]:
    """Returns the samples by range; those that the folder holds are read."""
    found: dict[float, list[Samples]] = {}
    missing = []
    for range_m in asked.range_m:
        known = None if kept is None else _read(_file(kept, asked, range_m))
        if known is None:
            missing.append(range_m)
        else:
            found[range_m] = known
    if missing:
        from thzcl.device.choose import open_device
        from thzcl.device.opencl import Device

        opened = device if isinstance(device, Device) else open_device(device)
        for first in range(0, len(missing), TOGETHER):
            some = missing[first : first + TOGETHER]
            done = f"{len(found)} of {len(asked.range_m)} ranges; at {some[0]:g} to {some[-1]:g} m"

            def tell(air: int, done: str = done) -> None:
                if progress is not None:
                    progress(f"{done}, air {air + 1} of {asked.airs}")

            path = None if kept is None else _part(kept, asked, some)
            for range_m, samples in computed_together(asked, some, opened, path, tell):
                found[range_m] = samples
                if kept is not None:
                    _write(_file(kept, asked, range_m), samples)
            if path is not None:
                path.unlink(missing_ok=True)
    return dict(sorted(found.items()))


def _file(kept: Path, asked: Question, range_m: float) -> Path:
    return kept / f"{range_m:g}m-{asked.identity}.json"


def _part(kept: Path, asked: Question, some: list[float]) -> Path:
    """Returns the file of what airs have told of some ranges, until all have."""
    places = hashlib.sha256(repr(some).encode()).hexdigest()[:8]
    return kept / f"airs-{asked.identity}-{places}.npz"


def _write(path: Path, samples: list[Samples]) -> None:
    """Writes the samples of a range, whole or not at all."""
    lists = [asdict(one) | {"null": one.null.tolist(), "present": one.present.tolist()}
             for one in samples]  # fmt: skip
    text = json.dumps(lists)
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def _read(path: Path) -> list[Samples] | None:
    """Returns the samples of a range, or None if there is no such file."""
    if not path.is_file():
        return None
    arrays = ("null", "present")
    try:
        found = read_json(path, RECORD)
        return [Samples(**(one | {name: np.array(one[name]) for name in arrays})) for one in found]
    except (FileError, TypeError, KeyError):  # it is computed anew
        return None


def computed_together(
    asked: Question,
    some: list[float],
    device: Device,
    part: Path | None = None,
    tell: Callable[[int], None] = lambda _: None,
) -> Iterator[tuple[float, list[Samples]]]:
    """Yields some ranges with the samples of each, for which the airs' cubes are shared.

    What airs have told is kept in the file `part`, if there is one, and gone on from there. `tell`
    is told the number of each air.
    """
    pairs = joined(
        [Pair.of(asked.base, range_m, ghz, {}) for range_m in some for ghz in asked.frequency_ghz]
    )
    known, saved = Pass() if part is None else Pass.read(part), time.monotonic()
    told = _Told(asked, pairs, known)
    for air, number, scenes in airs(pairs, range(known.airs, asked.airs), asked.seed, device):
        if number == 0:
            tell(air)
        told.take(air, number, scenes)
        if number == len(pairs) - 1:
            known.airs = air + 1
            if part is not None and time.monotonic() - saved > SAVED_S:
                known.write(part)
                saved = time.monotonic()
    found: dict[float, list[Samples]] = {range_m: [] for range_m in some}
    for key, observer in told.observers.items():
        pair, arrays = pairs[key[0]], (np.array(known.null[key]), np.array(known.present[key]))
        lost = _lost(asked, pair, observer, arrays, device)
        samples = Samples(
            pair.frequency_ghz, key[1], observer.kind, observer.sign, told.draws[key][1],
            known.pixels[key[0]], lost, *arrays,
        )  # fmt: skip
        found[pair.range_m].append(samples)
    yield from found.items()


class _Told:
    """Takes what airs tell: the first half is learnt from, the rest tests what was learnt."""

    def __init__(self, asked: Question, pairs: list[Pair], known: Pass) -> None:
        self.observers: dict[Key, Observer] = {}
        self.draws: dict[Key, tuple[int, str]] = {}  # of the noise; what the threshold comes from
        self._asked, self._pairs, self._known = asked, pairs, known
        for key in known.null:
            self._make(key)

    def _make(self, key: Key) -> None:
        pair = self._pairs[key[0]]
        self.observers[key] = _observer(self._asked, pair, self._known.training[key])
        self.draws[key] = _draws(self._asked, pair, self.observers[key])

    def take(self, air: int, number: int, scenes: list[Scenes]) -> None:
        """Takes the scenes of one air and pair by each model."""
        asked, pair, known = self._asked, self._pairs[number], self._known
        if number not in known.pixels:
            wanted = _flags(pair, asked.base.target)
            known.pixels[number] = float(np.isin(scenes[0].present.target, wanted).sum())
            _refuse_unseen(asked, pair, known.pixels[number])
        for one in scenes:
            key = number, one.model
            if air < asked.airs // 2:
                _learn(known.training.setdefault(key, Training()), one)
            else:
                self._test(key, one)

    def _test(self, key: Key, one: Scenes) -> None:
        if key not in self.observers:
            self._make(key)
        count, see = range(self.draws[key][0]), self.observers[key].statistic
        null = [see(one.image(one.absent, 2 * draw)) for draw in count]
        present = [see(one.image(one.present, 2 * draw + 1)) for draw in count]
        self._known.null.setdefault(key, []).append(null)
        self._known.present.setdefault(key, []).append(present)


def _learn(training: Training, one: Scenes) -> None:
    """Shows an air to what learns."""
    present, absent, again = (
        one.image(sight, draw)
        for sight, draw in ((one.present, 0), (one.absent, 0), (one.absent, 1))
    )
    training.add(present, absent, again)


def _flags(pair: Pair, target: str) -> list[int]:
    """Returns the numbers by which pixels say that they show the target, or a part of it."""
    names = pair.present.scenario.targets
    return [
        metrics.FIRST_TARGET + number
        for number, name in enumerate(names)
        if name == target or name.startswith(f"{target}.")
    ]


def _refuse_unseen(asked: Question, pair: Pair, pixels: float) -> None:
    """Raises ScenarioError where no pixel shows the target."""
    if not pixels:
        where = f"at {pair.range_m:g} m no pixel shows {asked.base.target}"
        text = "something hides it, or it is too small; shorten --ranges, or give more pixels"
        raise ScenarioError([f"{asked.base.document.label}: {where}: {text}"])


def _observer(asked: Question, pair: Pair, training: Training) -> Observer:
    """Returns the observer of a range. Raises ScenarioError where nothing varies."""
    kind = CELLS if pair.active and pair.noisy else asked.observer
    found = training.observer(kind, random=pair.random)
    if found.noise == 0 and not found.clutter.any():
        text = (
            "the sensor has no noise and the air does not vary, so that any target is detected; "
            "give the sensor noise, or add [atmosphere.fluctuations]"
        )
        raise ScenarioError([f"{asked.base.document.label}: {text}"])
    return found


def _draws(asked: Question, pair: Pair, observer: Observer) -> tuple[int, str]:
    """Returns the draws of noise in each test air, and what the threshold comes from."""
    tests = asked.airs - asked.airs // 2
    if pair.noisy:
        needed = intervals.draws_needed(tests, asked.false_alarm, observer.shared)
        if needed is not None:
            return needed, intervals.EMPIRICAL
    elif tests * asked.false_alarm >= intervals.NULLS:
        return 1, intervals.EMPIRICAL
    law = intervals.GAMMA if observer.kind == CELLS else intervals.NORMAL
    return (4 if pair.noisy else 1), law


def _lost(
    asked: Question, pair: Pair, one: Observer, samples: tuple[Array, Array], device: Device
) -> dict[str, float | None]:
    """Returns d' with everything, without absorption, in clutter alone and in noise alone.

    They are those of the test airs: what varies from air to air is clutter, what varies between
    draws in one air is noise. Without absorption, d' is as much more as the template's own is.
    """
    null, present = samples
    change = abs(float(present.mean() - null.mean()))
    within = float(null.var(axis=1, ddof=1).mean()) if null.shape[1] > 1 else 0.0
    between = float(null.mean(axis=1).var(ddof=1)) - within / null.shape[1] if pair.random else 0.0
    whole = abs(metrics.sample_d_prime(null.ravel(), present.ravel()))
    found: dict[str, float | None] = {
        "whole": whole,
        "clutter": _over(change, between),
        "noise": _over(change, within),
        "absorption": None,
    }
    clear = _in_clear_air(asked, pair, device)
    own = one.d_prime()
    if clear is None or not own:
        return found
    return found | {"absorption": whole * (one.of(clear).d_prime() or 0.0) / own}


def _over(change: float, variance: float) -> float | None:
    """Returns d' of a change in noise of a variance, or None where there is none."""
    return change / float(np.sqrt(variance)) if variance > 0 else None


def _in_clear_air(asked: Question, pair: Pair, device: Device) -> Array | None:
    """Returns the difference that the target makes without a gas, (y, x).

    Returns None for a scene that cannot be without its gas.
    """
    ghz = None if asked.frequency_ghz[0] is None else pair.frequency_ghz
    try:
        clear = Pair.of(asked.base, pair.range_m, ghz, CLEAR)
    except ScenarioError:
        return None
    _, _, scenes = next(airs([clear], range(1), asked.seed, device))
    differences = [
        scenes[0].image(scenes[0].present, draw) - scenes[0].image(scenes[0].absent, draw)
        for draw in range(CLEAR_DRAWS if clear.noisy else 1)
    ]
    return np.asarray(np.mean(differences, axis=0))


def _curves(asked: Question, found: Mapping[float, list[Samples]]) -> tuple[Curve, ...]:
    """Returns a curve for each frequency and model."""
    by_key: dict[tuple[float, str], list[tuple[float, Samples]]] = {}
    for range_m, some in found.items():
        for one in some:
            by_key.setdefault((one.frequency_ghz, one.model), []).append((range_m, one))
    tests = asked.airs - asked.airs // 2
    often = intervals.counts(tests, asked.seed)
    curves = []
    for (ghz, model), rows in by_key.items():
        places = tuple(range_m for range_m, _ in rows)
        its = tuple(samples for _, samples in rows)
        each = tuple(
            intervals.detect(one.null, one.present, asked.false_alarm, one.tail, often, one.sign)
            for one in its
        )
        reach = intervals.reach(np.array(places), list(each), asked.probability)
        curves.append(Curve(ghz, model, places, each, its, reach))
    return tuple(curves)


def _notes(asked: Question, curves: tuple[Curve, ...]) -> list[str]:
    """Returns what must be known to read the answer."""
    notes = [
        f"false alarms: {asked.false_alarm:g} of tests at one known place, not of pictures",
    ]
    if any(one.observer == NPW for curve in curves for one in curve.samples) and (
        asked.observer == HOTELLING
    ):
        notes.append(
            "the sensor has no noise: the air's clutter alone limits it, and the observer is npw"
        )
    for curve in curves:
        name = f"{curve.frequency_ghz:g} GHz, {curve.model}"
        told = (*_beyond(asked, curve), *_of_tails(asked, curve), *_rises(curve))
        notes += [f"{name}: {text}" for text in told]
    return notes


def _beyond(asked: Question, curve: Curve) -> Iterator[str]:
    """Yields what is known where the range that is asked for lies beyond all ranges."""
    last = curve.found[-1].probability
    if curve.reach.note != intervals.FARTHER:
        return
    yield f"farther than {curve.range_m[-1]:g} m, the longest of the ranges; give longer ones"
    if last.low < asked.probability:
        yield (
            f"at {curve.range_m[-1]:g} m the interval begins at {last.low:.3g}, so that "
            f"{asked.probability:g} is not established there; give more airs"
        )


def _of_tails(asked: Question, curve: Curve) -> Iterator[str]:
    """Yields what the thresholds come from, where it is not from samples."""
    laws = [one for one in curve.found if one.tail != intervals.EMPIRICAL]
    if not laws:
        return
    nulls = round(intervals.NULLS / asked.false_alarm)
    worst = min((one.fit for one in laws if one.fit is not None), default=None)
    told = "" if worst is None else f", whose fit to the nulls has p = {worst:.2g} at worst"
    tests = asked.airs - asked.airs // 2
    yield (
        f"{tests} test airs are fewer than the {nulls} null samples that "
        f"{asked.false_alarm:g} takes: thresholds are those of a {laws[0].tail} law{told}, at "
        f"{len(laws)} of {len(curve.found)} ranges"
    )


def _rises(curve: Curve) -> Iterator[str]:
    """Yields that a target is detected better farther away, beyond what intervals allow."""
    for far in range(len(curve.found)):
        for near in range(far):
            if curve.found[far].probability.low > curve.found[near].probability.high:
                yield (
                    f"better detected at {curve.range_m[far]:g} m than at "
                    f"{curve.range_m[near]:g} m: the air in front of the target, or what stands "
                    "behind it, makes contrast"
                )
                return
