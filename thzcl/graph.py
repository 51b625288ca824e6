"""The graph of specs, small frozen descriptions of work: equal specs are computed once.

A spec describes what is computed from its inputs, which are specs too. A variant, a realisation of
the air or another setting is another graph, which `rewrite` makes from a given one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, cast, dataclass_transform
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thzcl.clock import Clock

Kind = TypeVar("Kind", bound=type)
_HASH = "_hash"


@dataclass(frozen=True)
class Values:
    """An array that cannot change; it is compared and hashed by its bytes, and can be pickled."""

    data: bytes
    dtype: str
    shape: tuple[int, ...]

    @classmethod
    def of(cls, array: Any, dtype: DTypeLike = np.float64) -> Values:
        """Returns the values of an array or a sequence, converted to a type."""
        array = np.ascontiguousarray(array, dtype)
        return cls(array.tobytes(), array.dtype.str, array.shape)

    @property
    def array(self) -> NDArray[Any]:
        """Returns the values as an array that is read-only."""
        return np.frombuffer(self.data, self.dtype).reshape(self.shape)


class LeftOut(NamedTuple):
    """A stage of the computation that a spec does not need, and the reason."""

    reason: str


class Work(NamedTuple):
    """A stage of the computation that a spec carries out.

    `noun` names what the spec makes, to be counted in the plan, and is empty if nothing is counted;
    `detail` holds more words.
    """

    noun: str
    detail: str = ""


class Memory(NamedTuple):
    """The bytes of a spec's arrays, one number for each array.

    `held` are the arrays that make up its value, `scratch` those that exist only while it runs.
    """

    held: tuple[int, ...] = ()
    scratch: tuple[int, ...] = ()


@dataclass_transform(frozen_default=True)
def frozen(kind: Kind) -> Kind:
    """Returns a class as a frozen dataclass that computes its hash once, and does not pickle it.

    If the hash were not stored, a graph of n diamonds would be hashed 2^n times. It is not pickled,
    since strings have another hash in another process.
    """
    made: Any = dataclass(frozen=True)(kind)
    computed = made.__hash__

    def stored_hash(self: Any) -> int:
        known = self.__dict__.get(_HASH)
        if known is None:
            known = self.__dict__[_HASH] = computed(self)
        return int(known)

    def state(self: Any) -> dict[str, Any]:
        return {name: getattr(self, name) for name in made.__dataclass_fields__}

    made.__hash__, made.__getstate__ = stored_hash, state
    return cast("Kind", made)


class Spec:
    """One piece of work. Its subclasses are made by `frozen`, and have run(device, **inputs).

    `reads` names the fields that are specs, tuples of specs, or None. Their values are passed to
    run() by the same names. For a tuple of specs run() receives an iterator, which computes each
    value when it is asked for. `one_by_one` names those tuples of which run() holds no value but
    the last one and the one before it.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    one_by_one: ClassVar[tuple[str, ...]] = ()
    stage: ClassVar[str]  # the stage that the time of run() is added to
    run: ClassVar[Callable[..., Any]]

    def inputs(self) -> list[Spec]:
        """Returns the specs that this one reads, in the order of `reads`."""
        values = (getattr(self, name) for name in self.reads)
        some = (value if isinstance(value, tuple) else (value,) for value in values)
        return [spec for specs in some for spec in specs if spec is not None]

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns, by stage, what this spec does there or why it does not need that stage."""
        return {}

    def memory(self) -> Memory:
        """Returns the sizes of the arrays that this spec needs."""
        return Memory()

    def segments(self) -> float:
        """Returns about how many segments of positive length its rays have in voxels."""
        return 0.0


class Finishing(Protocol):
    """A device that can wait for its work; thzcl.device.opencl.Device is one."""

    def finish(self) -> None:
        """Waits until all work has been done."""


def everything(
    wanted: Iterable[Spec], known: Collection[Any] = (), specs: dict[Spec, None] | None = None
) -> dict[Spec, None]:
    """Returns the distinct specs of a graph, inputs first, added to `specs`.

    Specs in `known` are left out, and so is what only they read.
    """
    specs = {} if specs is None else specs
    for spec in wanted:
        if spec not in specs and spec not in known:
            everything(spec.inputs(), known, specs)
            specs[spec] = None
    return specs


def rewrite(
    wanted: Iterable[Any], change: Callable[[Any], Any], same: Iterable[Spec] = ()
) -> tuple[Any, ...]:
    """Returns the wanted specs with `change` applied once to each spec of their graph.

    Inputs are changed before the specs that read them. Specs that were equal are one object
    afterwards, so that comparing and pickling stay cheap. Specs in `same`, which `change` would
    leave as they are with all that they read, are not visited.
    """
    wanted = tuple(wanted)
    new: dict[Spec | None, Any] = {None: None, **{spec: spec for spec in same}}

    def renewed(value: Any) -> Any:
        return tuple(new[one] for one in value) if isinstance(value, tuple) else new[value]

    for spec in everything(wanted, new.keys()):
        renewed_inputs = {name: renewed(getattr(spec, name)) for name in spec.reads}
        new[spec] = change(replace(spec, **renewed_inputs))  # type: ignore[type-var]
    return tuple(new[spec] for spec in wanted)


class Held:
    """Values of specs of some classes that outlive an evaluation, for others to read.

    All that one process holds takes at most `most_bytes`; what was held first gives way.
    """

    everyone: ClassVar[WeakKeyDictionary[Held, None]] = WeakKeyDictionary()  # the oldest first

    def __init__(self, classes: tuple[type[Spec], ...] = ()) -> None:
        self.classes = classes
        self.values: dict[Spec, Any] = {}
        self.sizes: dict[Spec, int] = {}  # bytes of each value; telling them takes time
        self.most_bytes = 0
        self.lost: set[Spec] = set()  # those whose values gave way, or found no room

    @property
    def size(self) -> int:
        """Returns the bytes of the values."""
        return sum(self.sizes.values())

    def make_room(self, wanted: Iterable[Spec], most_bytes: int) -> None:
        """Sets what may be held, and drops what is in the way of the specs of a graph.

        Values that the graph reads stay, but for those that exceed `most_bytes` by themselves.
        """
        self.most_bytes = most_bytes
        self.everyone.setdefault(self)
        specs = [spec for spec in everything(wanted) if isinstance(spec, self.classes)]
        room = most_bytes - sum(map(_size, specs))
        idle = [(one, spec) for one in self.everyone for spec in one.values]
        idle = [(one, spec) for one, spec in idle if one is not self or spec not in specs]
        over = sum(one.sizes[spec] for one, spec in idle) - room
        for one, spec in idle:
            if over <= 0:
                return
            over -= one.sizes.pop(spec)
            del one.values[spec]
            one.lost.add(spec)

    def add(self, spec: Spec, value: Any) -> bool:
        """Returns whether a value is held from now on, which takes a class to hold and room."""
        if not isinstance(spec, self.classes):
            return False
        size = _size(spec)
        if sum(one.size for one in self.everyone) + size > self.most_bytes:
            self.lost.add(spec)
            return False
        self.values[spec], self.sizes[spec] = value, size
        return True


def _size(spec: Spec) -> int:
    return sum(spec.memory().held)


@dataclass
class _Work:
    """The evaluation of one batch.

    It is a class, since closures that call each other would keep the memo alive.
    """

    device: Finishing
    clock: Clock
    runs: Counter[str]
    memo: dict[Spec, Any]
    later: dict[Spec, None]  # specs of the next batch
    held: Held
    readers: Counter[Spec] = field(default_factory=Counter)  # reads of each spec still to come

    def value(self, spec: Spec) -> Any:
        """Returns the value of a spec, which is computed if it is neither held nor in the memo."""
        if spec in self.held.values:
            return self.held.values[spec]
        if spec not in self.memo:
            inputs = {name: self._read(getattr(spec, name)) for name in spec.reads}
            with self.clock.stage(spec.stage):
                result = spec.run(self.device, **inputs)
                self.device.finish()
            self.runs[type(spec).__name__] += 1
            if self.held.add(spec, result):
                return result
            self.memo[spec] = result
        return self.memo[spec]

    def _read(self, spec: Any) -> Any:
        """Returns the value of an input, and drops it from the memo after its last read."""
        if isinstance(spec, tuple):
            return map(self._read, spec)
        if spec is None:
            return None
        result = self.value(spec)
        self.readers[spec] -= 1
        if not self.readers[spec] and spec not in self.later:
            self.memo.pop(spec, None)
        return result


def evaluate(
    batches: Iterable[tuple[Spec, ...]],
    device: Finishing,
    clock: Clock | None = None,
    runs: Counter[str] | None = None,
    held: Held | None = None,
) -> Iterator[tuple[Any, ...]]:
    """Yields the values of each batch of specs; equal specs run once.

    A value is dropped once neither its own batch nor the next one will read it any more. Batches
    (realisations, frames, members of a study) may therefore come from a generator, of which one
    batch is read in advance. `clock` measures the time of each stage, and `runs` counts the specs
    of each class that ran. Values that are `held` are not computed, and those of its classes are
    added to it.
    """
    memo: dict[Spec, Any] = {}
    clock, runs = clock or Clock(), Counter() if runs is None else runs
    held = held or Held()
    for batch, following in pairwise(chain(batches, [()])):
        work = _Work(device, clock, runs, memo, everything(following), held)
        for spec in everything(batch, memo.keys() | held.values.keys()):
            work.readers.update(spec.inputs())
        work.readers.update(batch)  # the caller reads the specs of the batch
        yield tuple(work.value(spec) for spec in batch)
        for spec in memo.keys() - work.later.keys():
            del memo[spec]


def peak(wanted: Iterable[Spec]) -> tuple[int, int]:
    """Returns the bytes held at the peak of an evaluation, and those of the largest single array.

    As in evaluate(), inputs come first, in the order of `wanted`, and each value is held until its
    last reader has run.
    """
    wanted = tuple(wanted)
    order = everything(wanted)
    weight = _Weight({spec: spec.memory() for spec in order})
    for spec in order:
        weight.readers.update(spec.inputs())
    weight.readers.update(wanted)
    for spec in wanted:
        weight.make(spec)
    arrays = [size for one in weight.memory.values() for size in (*one.held, *one.scratch)]
    return weight.most, max(arrays, default=0)


@dataclass
class _Weight:
    """The bytes of an evaluation, followed without computing anything."""

    memory: dict[Spec, Memory]
    readers: Counter[Spec] = field(default_factory=Counter)  # reads of each spec still to come
    memo: set[Spec] = field(default_factory=set)
    holders: Counter[Spec] = field(default_factory=Counter)  # the memo, and specs that run
    now: int = 0
    most: int = 0

    def make(self, spec: Spec) -> None:
        """Follows the computation of a spec's value, if it is not in the memo."""
        if spec in self.memo:
            return
        values = {name: getattr(spec, name) for name in spec.reads}
        passing = [one for name in spec.one_by_one for one in values.pop(name)]
        singles = [v for v in values.values() if v is not None and not isinstance(v, tuple)]
        many = [one for v in values.values() if isinstance(v, tuple) for one in v]
        for one in singles:
            self._read(one)
        own = self.memory[spec]
        self._add(sum(own.held))  # what it makes, while it reads its tuples
        for one in many:
            self._read(one)
        for number, one in enumerate(passing):
            self._read(one)  # while the value before it is still in hand
            if number:
                self._drop(passing[number - 1])
            self._reach(sum(own.scratch))
        self._reach(sum(own.scratch))
        for one in (*singles, *many, *passing[-1:]):
            self._drop(one)
        self._add(-sum(own.held))
        self.memo.add(spec)
        self._hold(spec)

    def _read(self, spec: Spec) -> None:
        """Follows a read of a value, which its reader holds, and the memo only for others."""
        self.make(spec)
        self._hold(spec)
        self.readers[spec] -= 1
        if not self.readers[spec]:
            self.memo.remove(spec)
            self._drop(spec)

    def _hold(self, spec: Spec) -> None:
        """Adds a holder of a value."""
        self.holders[spec] += 1
        if self.holders[spec] == 1:
            self._add(sum(self.memory[spec].held))

    def _drop(self, spec: Spec) -> None:
        """Takes away a holder of a value."""
        self.holders[spec] -= 1
        if not self.holders[spec]:
            self._add(-sum(self.memory[spec].held))

    def _add(self, size: int) -> None:
        """Counts bytes that come, or go if `size` is negative."""
        self.now += size
        self._reach(0)

    def _reach(self, more: int) -> None:
        """Counts bytes that exist for a moment only."""
        self.most = max(self.most, self.now + more)
