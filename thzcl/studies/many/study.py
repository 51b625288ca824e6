"""`thzcl study`: many scenes from one, computed here or on many machines, resumed after a crash."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import index
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thzcl.clock import Progress
from thzcl.errors import UsageError
from thzcl.files import make_folder
from thzcl.scenario import document as documents
from thzcl.studies.many import detect
from thzcl.studies.many import grid as grids
from thzcl.studies.many import members as scenes
from thzcl.studies.many.compute import DONE, Record, Task, members
from thzcl.studies.many.members import Study
from thzcl.studies.many.store import Store

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

MOST_UNASKED = 1_000_000  # members that are computed without `--yes`


@dataclass(frozen=True)
class StudyResult:
    """What a study has computed so far: its table, and how many members are in which state.

    `members` is the number of all that it has, `states` counts those that have a file.
    """

    folder: Path
    index: Path
    members: int
    states: Mapping[str, int]
    seed: int

    def records(self) -> Iterator[Record]:
        """Yields what each member's file holds, by number."""
        return Store(self.folder).records()


def study(
    source: documents.Source,
    folder: str | Path,
    *,
    over: Mapping[str, Any] | None = None,
    seeds: int | None = None,
    seed: int | None = None,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | Device | None = None,
    keep: str | None = None,
    shard: tuple[int, int] | None = None,
    dask: str | None = None,
    workers: int | None = None,
    yes: bool = False,
    allow_outside: bool = False,
    progress: Progress | None = None,
    given_by: str = "over",
) -> StudyResult:
    """Computes the members of a study that have no file yet, and writes its table, index.csv.

    `source` and `settings` are those of thzcl.run. `over` maps keys to values, lists or NumPy's
    arrays, `{"targets.box.range_m": [20, 40], "a,b": [(1, 2), (3, 4)]}`, on top of those of the
    scene's [study]; where nothing is varied, each of the scene's variants is a member. Each of
    `seeds` airs has a seed of its own, which follows from `seed`. `keep` is "numbers" or "images".
    `shard` (i, n) computes the i-th of n parts. `dask` is "local" for a cluster of `workers`
    processes here, or the address of a scheduler; `device` is then that of each worker, by name.
    `yes` allows more than a million members. A member that cannot be computed is marked in its
    file, and the study goes on. Raises UsageError and ScenarioError for what cannot be a study,
    OSError if a file cannot be written, DeviceError without a usable device.
    """
    seeds, seed = (None if one is None else index(one) for one in (seeds, seed))
    store = Store(Path(folder))
    make_folder(store.folder)
    known = store.described()
    if seed is None:
        seed = secrets.randbits(32) if known is None else int(known["seed"])
    whole = described(
        source, over, seeds, seed, settings, variants, keep, given_by, allow_outside=allow_outside
    )
    if whole.count > MOST_UNASKED and not yes:
        raise UsageError(f"{whole.count} members; say --yes if that is meant")
    scenes.refuse_unknown(whole, given_by)
    detect.refuse(whole)
    numbers = _part(whole.count, shard)
    store.claim(whole)
    try:
        _compute(whole, store, numbers, device, dask, workers, progress)
        if whole.detect and (shard is None or shard[0] == 1):
            detect.detect(whole, store, _opened(device), progress)
    finally:
        states = store.write_index(whole.keys, detect.names(whole))
    return StudyResult(store.folder, store.index, whole.count, states, seed)


def described(
    source: documents.Source,
    over: Mapping[str, Any] | None,
    seeds: int | None,
    seed: int,
    settings: Mapping[str, Any] | None,
    variants: Sequence[str],
    keep: str | None,
    given_by: str,
    *,
    allow_outside: bool,
) -> Study:
    """Returns the study that a scene and the arguments of `study` describe."""
    document = documents.read(source, settings, seed)
    table = scenes.table_of(document)
    axes = grids.axes(over or {}, given_by)
    if table is not None:
        given = {key for axis in axes for key in axis.keys}
        own = grids.axes(table.over, "[study] over")
        axes = (*(axis for axis in own if not given & {*axis.keys}), *axes)
        seeds, keep = seeds or table.seeds, keep or table.keep
    if not axes and seeds is None:
        picked = documents.chosen(variants)
        if set(picked) - set(documents.names(document)):
            documents.parse(document, picked, allow_outside=allow_outside)  # which refuses them
        axes = grids.of_variants(picked or documents.names(document))
    if not axes and seeds is None:
        text = "nothing is varied; give --over KEY=VALUES, --seeds N, variants or a table [study]"
        raise UsageError(f"{document.label}: {text}")
    if seeds is not None and seeds < 1:
        raise UsageError(f"{seeds} seeds; give at least 1")
    if keep not in (None, "numbers", "images"):
        raise UsageError(f'keep = "{keep}": must be "numbers" or "images"')
    keep_pixels = table is not None and table.keep_pixels
    targets = () if table is None else table.detect
    whole = axes, seeds, seed, keep or "numbers", keep_pixels, allow_outside, targets
    return Study(document, documents.chosen(variants), *whole)


def _part(count: int, shard: tuple[int, int] | None) -> range:
    """Returns the numbers of the members of one part of a study. Raises UsageError."""
    if shard is None:
        return range(count)
    part, of = shard
    if not 1 <= part <= of:
        raise UsageError(f"shard {part}/{of}: write i/n with i from 1 to n")
    return range(count * (part - 1) // of, count * part // of)


def tasks(whole: Study, store: Store, numbers: range) -> Iterator[Task]:
    """Yields the work that is left: members of those numbers that are not done."""
    for group in whole.groups():
        here = range(max(group.start, numbers.start), min(group.stop, numbers.stop))
        left = tuple(n for n in here if store.state(whole.name(whole.member(n))) != DONE)
        if left:
            yield Task(group, left)


def _compute(
    whole: Study,
    store: Store,
    numbers: range,
    device: str | Device | None,
    dask: str | None,
    workers: int | None,
    progress: Progress | None,
) -> None:
    """Computes what is left to do, and writes a file for each member."""
    todo = list(tasks(whole, store, numbers))
    total = sum(len(task.wanted) for task in todo)
    if not total:
        return
    if dask is not None:
        from thzcl.device.opencl import Device
        from thzcl.studies.many.cluster import on_workers

        if isinstance(device, Device):
            raise UsageError("workers open devices of their own: give the device's name")
        found = on_workers(whole, todo, store.members, device, dask, workers)
    else:
        found = _here(whole, todo, store.members, device)
    for count, one in enumerate(found):
        store.write(whole.name(whole.member(one["member"])), one)
        if progress is not None:
            failed = "" if one["state"] == DONE else f" ({one['state']}: {one['message']})"
            progress(f"{count + 1} of {total} members{failed}")


def _opened(device: str | Device | None) -> Device:
    """Returns an open device: the one that is given, or that of a name."""
    from thzcl.device.choose import open_device
    from thzcl.device.opencl import Device

    return device if isinstance(device, Device) else open_device(device)


def _here(
    whole: Study, todo: Iterable[Task], folder: Path, device: str | Device | None
) -> Iterator[Record]:
    """Yields the records of members that are computed in this process."""
    opened = _opened(device)
    for task in todo:
        yield from members(whole, task.group, task.wanted, folder, opened)
