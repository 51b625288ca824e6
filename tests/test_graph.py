"""The graph of specs: equality, sharing, what runs, what is held, and the same elsewhere."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import weakref
from collections import Counter
from dataclasses import FrozenInstanceError, fields, is_dataclass
from typing import ClassVar

import numpy as np
import pytest
from conftest import ROOT
from scenes import DRIFTING, PLAIN, scene, write

from thzcl import pipeline
from thzcl.clock import Clock
from thzcl.graph import Held, Memory, Spec, Values, evaluate, everything, frozen, peak, rewrite
from thzcl.plan import memory
from thzcl.sensing.pixels import SumSpec

DEEP = 16  # diamonds on top of each other: 65,536 paths from the top to the bottom


class Bench:
    """A device that has nothing to wait for."""

    def finish(self):
        """Returns at once."""


class Amount:
    """A number that can be watched for being held."""

    def __init__(self, number):
        self.number = number


class Name(str):
    """A string that counts how often its hash is asked for."""

    __slots__ = ()
    counted: ClassVar = Counter()

    def __hash__(self):
        """Returns a string's hash."""
        Name.counted[str(self)] += 1
        return super().__hash__()


class Watch:
    """Knows the amounts that are held, and the most of them at once."""

    def __init__(self):
        self.held = weakref.WeakSet()
        self.most = 0

    def numbers(self):
        """Returns the numbers that are held."""
        return sorted(amount.number for amount in self.held)

    def add(self, number):
        """Returns a new amount that is watched."""
        amount = Amount(number)
        self.held.add(amount)
        self.most = max(self.most, len(self.held))
        return amount


@pytest.fixture
def watch(monkeypatch):
    made = Watch()
    monkeypatch.setattr(sys.modules[__name__], "WATCH", made)
    return made


WATCH = Watch()


@frozen
class Leaf(Spec):
    """A number."""

    number: int
    size: int = 0
    stage = "leaves"

    def run(self, device):
        """Returns the number."""
        del device
        return WATCH.add(self.number)

    def memory(self):
        """Returns what it says."""
        return Memory((self.size,))


@frozen
class Total(Spec):
    """The sum of many numbers, of which it holds two at once."""

    parts: tuple[Spec, ...]
    size: int = 0
    scratch: int = 0
    reads = one_by_one = ("parts",)
    stage = "totals"

    def run(self, device, parts):
        """Returns the sum."""
        del device
        total = 0
        for part in parts:
            total += part.number
        return WATCH.add(total)

    def memory(self):
        """Returns what it says."""
        return Memory((self.size,), (self.scratch,))


@frozen
class Pair(Spec):
    """The sum of two numbers."""

    one: Spec
    other: Spec | None
    size: int = 0
    scratch: int = 0
    reads = ("one", "other")
    stage = "pairs"

    def run(self, device, one, other):
        """Returns the sum."""
        del device
        return WATCH.add(one.number + (0 if other is None else other.number))

    def memory(self):
        """Returns what it says."""
        return Memory((self.size,), (self.scratch,))


def diamonds(depth, bottom):
    """Returns specs each of which reads the one below twice."""
    for _ in range(depth):
        bottom = Pair(bottom, bottom)
    return bottom


def numbers(values):
    return tuple(value.number for value in values)


# --- values and identity ---------------------------------------------------------------------


def test_arrays_are_equal_by_what_they_hold():
    here, same = (Values.of([1.0, 2.0, 3.0]) for _ in range(2))
    assert here == same and hash(here) == hash(same)
    others = [[1.0, 2.0, 4.0], [[1.0, 2.0, 3.0]], [1.0, 2.0]]
    assert all(Values.of(other) != here for other in others)
    assert Values.of([1, 2, 3], np.int32) != Values.of([1, 2, 3], np.float32)
    assert Values.of([0.0]) != Values.of([-0.0])  # they are not the same bits


def test_arrays_are_copied_and_cannot_be_changed():
    source = np.arange(6.0).reshape(2, 3)[:, ::2]
    values = Values.of(source)
    source[0, 0] = 7.0
    assert np.array_equal(values.array, [[0.0, 2.0], [3.0, 5.0]])
    with pytest.raises(ValueError, match="read-only"):
        values.array[0, 0] = 1.0
    assert np.array_equal(pickle.loads(pickle.dumps(values)).array, values.array)


def test_a_spec_cannot_be_changed_and_computes_its_hash_once():
    leaf = Leaf(Name("once"))
    assert len({hash(Pair(leaf, leaf)) for _ in range(3)}) == 1
    assert Name.counted["once"] == 1
    with pytest.raises(FrozenInstanceError):
        leaf.number = 2


def test_a_hash_is_not_pickled():
    leaf = Leaf("a")
    hash(leaf)
    there = pickle.loads(pickle.dumps(leaf))
    assert there == leaf
    assert leaf.__dict__.keys() - there.__dict__.keys() == {"_hash"}


def test_diamonds_are_hashed_listed_rewritten_and_run_once():
    top = diamonds(DEEP, Leaf(Name("deep")))
    assert len(everything([top])) == DEEP + 1
    assert Name.counted["deep"] == 1
    changed, runs = [], Counter()

    def change(spec):
        changed.append(spec)
        return Leaf(2) if isinstance(spec, Leaf) else spec

    (other,) = rewrite([top], change)
    assert len(changed) == len(everything([other])) == DEEP + 1
    ((value,),) = evaluate([(other,)], Bench(), runs=runs)
    assert value.number == 2 * 2**DEEP
    assert runs == {"Leaf": 1, "Pair": DEEP}
    assert len(everything([pickle.loads(pickle.dumps(other))])) == DEEP + 1


# --- listing and rewriting -------------------------------------------------------------------


def test_everything_lists_inputs_first_and_nothing_below_what_is_known():
    low, high = Leaf(1), Leaf(2)
    middle = Pair(low, None)
    top = Total((middle, high, Pair(Leaf(1), None)))  # of two equal ones, one is listed
    assert list(everything([top])) == [low, middle, high, top]
    assert list(everything([top], known=[middle])) == [high, top]
    assert top.inputs() == [middle, high, middle]


def test_a_change_reaches_all_that_reads_it_and_nothing_else():
    low, high = Leaf(1), Leaf(2)
    seen = []

    def change(spec):
        seen.append(spec)
        return Leaf(5) if spec == low else spec

    changed, kept = rewrite((Total((Pair(low, high), low)), Pair(high, None)), change)
    assert changed == Total((Pair(Leaf(5), high), Leaf(5)))
    assert kept == Pair(high, None)
    assert len(seen) == len(set(seen)) == 5


def test_equal_specs_are_one_object_once_they_are_rewritten():
    one, other = rewrite((Pair(Leaf(1), None), Total((Leaf(1),))), lambda spec: spec)
    assert one.one is other.parts[0]


# --- running ---------------------------------------------------------------------------------


def test_equal_specs_run_once_however_they_are_built():
    runs = Counter()
    ((one, other),) = evaluate(
        [(Pair(Leaf(1), Leaf(2)), Pair(Leaf(1), Leaf(3)))], Bench(), runs=runs
    )
    assert (one.number, other.number) == (3, 4)
    assert runs == {"Leaf": 3, "Pair": 2}


def test_a_value_is_dropped_after_its_last_reader(watch):
    """Of a chain two values are held at most, of a sum its parts one at a time."""
    chain = Leaf(1)
    for _ in range(10):
        chain = Pair(chain, None)
    assert numbers(next(evaluate([(chain,)], Bench()))) == (1,)
    assert watch.most == 2
    watch.most = 0
    assert numbers(next(evaluate([(Total(tuple(map(Leaf, range(10)))),)], Bench()))) == (45,)
    assert watch.most == 2  # of the parts, the one before and the new one


def test_what_is_wanted_stays_until_it_is_handed_over():
    """It is not run again after a reader in its own batch, whatever comes first."""
    leaf = Leaf(1)
    for batch in ((leaf, Pair(leaf, None)), (Pair(leaf, None), leaf), (leaf, leaf)):
        runs = Counter()
        list(evaluate([batch], Bench(), runs=runs))
        assert runs["Leaf"] == 1


def test_batches_come_one_ahead_and_share_what_the_next_one_reads(watch):
    drawn = []

    def batches():
        for number in range(5):
            drawn.append(number)
            yield (Pair(Leaf(100), Leaf(number)), Pair(Leaf(number), Leaf(number + 1)))

    runs, found = Counter(), []
    for values in evaluate(batches(), Bench(), runs=runs):
        found.append(numbers(values))
        assert len(drawn) == min(len(found) + 1, 5)
        # What was wanted, and the leaves that the next batch reads too; of the last one none.
        shared = [100, len(found)] if len(found) < 5 else []
        assert watch.numbers() == sorted([*found[-1], *shared])
        del values
    assert found == [(100 + n, 2 * n + 1) for n in range(5)]
    assert runs == {"Leaf": 1 + 6, "Pair": 10}
    assert watch.numbers() == []


def test_a_value_that_only_a_later_batch_reads_is_not_held(watch):
    """One batch ahead, no more: what the next batch does not read is made again."""
    runs = Counter()
    reads = Pair(Leaf(1), Leaf(10))
    values = evaluate([(reads,), (Leaf(2),), (reads,)], Bench(), runs=runs)
    next(values)
    assert watch.numbers() == [11]  # what was wanted, until the next batch is asked for
    assert [numbers(batch) for batch in values] == [(2,), (11,)]
    assert runs == {"Leaf": 5, "Pair": 2}


def test_the_clock_is_told_the_stages():
    clock = Clock()
    list(evaluate([(Pair(Leaf(1), Leaf(2)),)], Bench(), clock))
    assert set(clock.seconds) == {"leaves", "pairs"}


# --- memory ----------------------------------------------------------------------------------


def test_the_peak_of_a_chain_and_of_a_diamond():
    chain = Pair(Pair(Leaf(1, 10), None, 20, 5), None, 7, 1)
    assert peak([chain]) == (10 + 20 + 5, 20)
    leaf = Leaf(1, 10)
    diamond = Pair(Pair(leaf, None, 20), Pair(leaf, Leaf(2), 30), 40, 100)
    assert peak([diamond]) == (20 + 30 + 40 + 100, 100)
    assert peak([diamond, leaf]) == (10 + 20 + 30 + 40 + 100, 100)  # the leaf is wanted too


def test_the_peak_of_many_inputs_that_are_taken_one_by_one():
    """Of many exposures two are held at once, beside what is made of them."""
    leaves = tuple(Leaf(n, 10 + n) for n in range(50))
    assert peak([Total(leaves, 1000, 3)]) == (1000 + 58 + 59, 1000)
    assert peak([Total(leaves, 1000, 99)]) == (1000 + 59 + 99, 1000)
    shared = Pair(Total(leaves, 1000), leaves[0], 1)
    assert peak([shared]) == (1000 + 10 + 58 + 59, 1000)
    deep = tuple(Pair(Leaf(n, 500), None, 10) for n in range(50))
    assert peak([Total(deep, 1000)]) == (1000 + 10 + 500 + 10, 1000)


def test_a_scan_holds_two_exposures_and_not_all(tmp_path):
    """Its peak does not grow with the instants that it averages."""
    peaks = []
    for samples in (2, 40):
        timed = {"timing": "focal-plane", "integration_time_s": 1.0, "samples": samples}
        sensor = {"kind": "raster-scan", "detector": PLAIN["sensor"]} | timed
        data = scene(sensor=sensor, atmosphere=DRIFTING, camera__pixels=[200, 200])
        peaks.append(memory.needed(pipeline.prepare(write(tmp_path, data)))[0])
    assert peaks[0] == pytest.approx(peaks[1], rel=0.01)


@pytest.mark.parametrize("seed", range(20))
def test_the_peak_is_what_an_evaluation_holds(monkeypatch, seed):
    """Of graphs at random, bytes by bytes: nothing is held longer than the plan says."""
    rng = np.random.default_rng(seed)
    specs = [Leaf(n, int(rng.integers(1, 100))) for n in range(4)]
    for size in rng.integers(1, 100, 12).tolist():
        one, other = rng.choice(len(specs), 2).tolist()
        specs.append(Pair(specs[one], specs[other], size))
        if size % 3 == 0:  # what it makes exists once it has run, and has no size before
            specs.append(Total((*specs[-4:], specs[one])))
    wanted = tuple(specs[n] for n in rng.choice(len(specs), 3, replace=False).tolist())
    held, most = weakref.WeakKeyDictionary(), []

    def weighed(healthy):
        def run(spec, device, **inputs):
            amount = healthy(spec, device, **inputs)
            held[amount] = spec.size
            most.append(sum(held.values()))
            return amount

        return run

    for kind in (Leaf, Pair, Total):
        monkeypatch.setattr(kind, "run", weighed(kind.run))
    values = next(evaluate([wanted], Bench()))
    assert max(most) == peak(wanted)[0]
    assert len(values) == 3


# --- elsewhere -------------------------------------------------------------------------------

SMALL = {
    "camera.pixels": [12, 9],
    "atmosphere.fluctuations.grid": 32,
    "atmosphere.fluctuations.seed": 3,
    "numerics.error_budget": True,
}
PLANS = {
    "figure7": SMALL,
    "raster": SMALL | {"sensor.detector.optics": {"blur_mrad": 8.0}},
}
ELSEWHERE = """
import pickle, sys
from thzcl import pipeline
from thzcl.device.choose import open_device
from thzcl.graph import evaluate
name, settings, plan, specs = pickle.load(sys.stdin.buffer)
own = pipeline.prepare(name, settings)
same = plan == own, hash(plan) == hash(own), specs == set(own.specs())
(values,) = evaluate([plan.batch(0)], open_device())
pickle.dump((same, hash(own), own, values), sys.stdout.buffer)
"""


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_is_the_same_in_another_process(device, name):
    """It is equal to the one made there, and gives the same images to the bit."""
    plan = pipeline.prepare(name, PLANS[name])
    exposures = [len(spec.rays) for spec in plan.specs() if isinstance(spec, SumSpec)]
    assert (max(exposures) > 10) == (name == "raster")  # of a beam's lines, times groups
    sent = pickle.dumps((name, PLANS[name], plan, set(plan.specs())))
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "1"}
    command = [sys.executable, "-c", ELSEWHERE]
    done = subprocess.run(command, input=sent, capture_output=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr.decode()
    same, there_hash, there, values = pickle.loads(done.stdout)
    assert same == (True, True, True)
    assert there == plan and hash(there) == hash(plan) != there_hash  # strings hash otherwise
    assert set(there.specs()) == set(plan.specs())
    (here,) = evaluate([plan.batch(0)], device)
    assert bits(here) == bits(values)


def bits(value):
    """Returns a value in which arrays have become their type, shape and bytes."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if is_dataclass(value):
        return [bits(getattr(value, one.name)) for one in fields(value)]
    if isinstance(value, dict):
        return {name: bits(one) for name, one in value.items()}
    return [bits(one) for one in value] if isinstance(value, tuple) else value


@frozen
class Heavy(Spec):
    """A value of so many bytes."""

    name: str
    size: int
    stage = "trace"

    def run(self, device):
        """Returns its name."""
        del device
        return self.name

    def memory(self):
        """Returns its bytes."""
        return Memory((self.size,))


def test_what_is_held_serves_and_the_oldest_gives_way_to_what_is_read():
    """Values that a graph reads stay; those of other holders go first, in the order of holding."""
    Held.everyone.clear()
    old, new = Held((Heavy,)), Held((Heavy,))
    a, b, c, d = (Heavy(name, 4) for name in "abcd")

    def evaluated(held, *specs, most):
        runs = Counter()
        held.make_room(specs, most)
        (values,) = evaluate([specs], Bench(), runs=runs, held=held)
        assert values == tuple(spec.name for spec in specs)
        return runs["Heavy"]

    assert evaluated(old, a, b, most=12) == 2 and set(old.values) == {a, b}
    assert evaluated(old, a, b, most=12) == 0
    assert evaluated(new, c, most=12) == 1 and set(old.values) == {a, b}
    assert evaluated(new, c, d, most=12) == 1
    assert (set(old.values), set(new.values)) == ({b}, {c, d}) and old.lost == {a}
    assert evaluated(old, b, Heavy("large", 9), most=12) == 1  # what is in the way goes in vain
    assert set(old.values) == {b} and old.lost >= {Heavy("large", 9)}
    assert old.size + new.size <= 12


def test_what_is_held_is_measured_once():
    """Telling the bytes of a value takes time, and a scan has hundreds of them."""
    Held.everyone.clear()
    asked = Counter()

    class Asked(Heavy):
        def memory(self):
            asked[self.name] += 1
            return super().memory()

    held, specs = Held((Heavy,)), [Asked(str(number), 4) for number in range(20)]
    held.make_room([], 1000)
    asked.clear()
    assert all(held.add(spec, None) for spec in specs) and held.size == 80
    held.make_room([], 0)
    assert held.size == 0 and set(asked.values()) == {1}
