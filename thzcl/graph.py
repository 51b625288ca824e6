"""The graph of specs: small frozen pieces of work, equal ones of which are computed once.

A spec says what is to be computed, and nothing of how its inputs came to be. Whatever differs from
a graph (a variant, a realisation of the air, a knob) is another graph, made by `rewrite`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from typing import Any, ClassVar, NamedTuple, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thzcl.clock import Clock

Kind = TypeVar("Kind", bound=type)
_HASH = "_hash"


@dataclass(frozen=True)
class Values:
    """An array that never changes: it compares and hashes by its bytes, and can be pickled."""

    data: bytes
    dtype: str
    shape: tuple[int, ...]

    @classmethod
    def of(cls, array: Any, dtype: DTypeLike = np.float64) -> Values:
        """Returns a copy of an array."""
        array = np.ascontiguousarray(array, dtype)
        return cls(array.tobytes(), array.dtype.str, array.shape)

    @property
    def array(self) -> NDArray[Any]:
        """Returns the array, read-only."""
        return np.frombuffer(self.data, self.dtype).reshape(self.shape)


class LeftOut(NamedTuple):
    """A stage that a spec does not need, and why."""

    reason: str


class Work(NamedTuple):
    """A stage that a spec does: what it makes, to be counted, and more words on it."""

    noun: str
    detail: str = ""


class Memory(NamedTuple):
    """Bytes of arrays: those that make up a spec's value, and those that it needs while it runs."""

    held: tuple[int, ...] = ()
    scratch: tuple[int, ...] = ()


@dataclass_transform(frozen_default=True)
def frozen(kind: Kind) -> Kind:
    """Makes a class a frozen dataclass that computes its hash once, and does not pickle it.

    Without a kept hash, a graph of n diamonds would be hashed 2^n times; strings hash otherwise in
    another process.
    """
    made: Any = dataclass(frozen=True)(kind)
    computed = made.__hash__

    def kept(self: Any) -> int:
        known = self.__dict__.get(_HASH)
        if known is None:
            known = self.__dict__[_HASH] = computed(self)
        return int(known)

    def state(self: Any) -> dict[str, Any]:
        return {name: getattr(self, name) for name in made.__dataclass_fields__}

    made.__hash__, made.__getstate__ = kept, state
    return made


class Spec:
    """One piece of work. Subclasses are made by `frozen` and have a method run(device, **inputs).

    `reads` names the fields that are specs, tuples of specs, or None. run() gets their values by
    the same names: a tuple as an iterator, whose values are computed when they are asked for.
    """

    reads: ClassVar[tuple[str, ...]] = ()
    stage: ClassVar[str]  # to which the time of run() counts
    run: ClassVar[Callable[..., Any]]

    def inputs(self) -> list[Spec]:
        """Returns the specs that this one reads, in the order of `reads`."""
        values = (getattr(self, name) for name in self.reads)
        some = (value if isinstance(value, tuple) else (value,) for value in values)
        return [spec for specs in some for spec in specs if spec is not None]

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns by stage what this spec does, or why it needs none."""
        return {}

    def memory(self) -> Memory:
        """Returns the memory that this spec needs."""
        return Memory()

    def segments(self) -> float:
        """Returns about how many voxels this spec's rays cross over positive length."""
        return 0.0


def everything(
    wanted: Iterable[Spec], known: Iterable[Spec] = (), specs: dict[Spec, None] | None = None
) -> dict[Spec, None]:
    """Returns the distinct specs of a graph, inputs first; nothing below a known one."""
    specs = {} if specs is None else specs
    for spec in wanted:
        if spec not in specs and spec not in known:
            everything(spec.inputs(), known, specs)
            specs[spec] = None
    return specs


def rewrite(wanted: Iterable[Any], change: Callable[[Any], Any]) -> tuple[Any, ...]:
    """Returns a graph with `change` applied to each spec once, inputs first.

    Specs that were equal are one object afterwards, so that comparing and pickling stay cheap.
    """
    wanted, new = tuple(wanted), {None: None}

    def renewed(value: Any) -> Any:
        return tuple(new[one] for one in value) if isinstance(value, tuple) else new[value]

    for spec in everything(wanted):
        renewed_inputs = {name: renewed(getattr(spec, name)) for name in spec.reads}
        new[spec] = change(replace(spec, **renewed_inputs))  # type: ignore[type-var]
    return tuple(new[spec] for spec in wanted)


@dataclass
class _Work:
    """One batch at work. A class, since closures that call each other would keep the memo alive."""

    device: Any
    clock: Clock
    runs: Counter[str]
    memo: dict[Spec, Any]
    later: dict[Spec, None]  # what the next batch reads too
    readers: Counter[Spec] = field(default_factory=Counter)  # of this batch, still to come

    def value(self, spec: Spec) -> Any:
        """Returns a value from the memo, or computes it."""
        if spec not in self.memo:
            inputs = {name: self._read(getattr(spec, name)) for name in spec.reads}
            with self.clock.stage(spec.stage):
                result = spec.run(self.device, **inputs)
                self.device.finish()
            self.runs[type(spec).__name__] += 1
            self.memo[spec] = result
        return self.memo[spec]

    def _read(self, spec: Any) -> Any:
        """Returns an input's value, and drops it from the memo if nobody else will read it."""
        if isinstance(spec, tuple):
            return map(self._read, spec)
        if spec is None:
            return None
        result = self.value(spec)
        self.readers[spec] -= 1
        if not self.readers[spec] and spec not in self.later:
            del self.memo[spec]
        return result


def evaluate(
    batches: Iterable[tuple[Spec, ...]],
    device: Any,
    clock: Clock | None = None,
    runs: Counter[str] | None = None,
) -> Iterator[tuple[Any, ...]]:
    """Yields the values of each batch of specs; equal specs run once.

    A value is dropped once neither its own batch nor the next one has a reader left for it, so
    that batches (realisations, frames, members of a study) can come from a generator, one ahead.
    `clock` is told what each stage takes, `runs` counts the specs of each class that ran.
    """
    memo: dict[Spec, Any] = {}
    clock, runs = clock or Clock(), Counter() if runs is None else runs
    for batch, following in pairwise(chain(batches, [()])):
        work = _Work(device, clock, runs, memo, everything(following))
        for spec in everything(batch, memo):
            work.readers.update(spec.inputs())
        work.readers.update(batch)  # whoever asked for the batch reads what is wanted
        yield tuple(work.value(spec) for spec in batch)
        for spec in memo.keys() - work.later.keys():
            del memo[spec]


def peak(wanted: Iterable[Spec]) -> tuple[int, int]:
    """Returns bytes held at the peak of an evaluation, and those of the largest single array.

    Follows evaluate(): inputs first, in the order of `wanted`, each value until its last reader.
    """
    wanted = tuple(wanted)
    order = list(everything(wanted))
    last = {spec: place for place, reader in enumerate(order) for spec in reader.inputs()}
    last |= dict.fromkeys(wanted, len(order))
    memory = {spec: spec.memory() for spec in order}
    most = now = 0
    for place, spec in enumerate(order):
        held = sum(memory[spec].held)
        most = max(most, now + held + sum(memory[spec].scratch))
        now += held
        now -= sum(sum(memory[one].held) for one in {*spec.inputs()} if last[one] == place)
    arrays = [size for one in memory.values() for size in (*one.held, *one.scratch)]
    return most, max(arrays, default=0)
