"""Studies on the workers of a Dask cluster: the same numbers, whoever is killed meanwhile."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from scenes import scene, write
from test_study import HUMID, numbers

import thzcl
from thzcl.errors import UsageError
from thzcl.studies.many import cluster
from thzcl.studies.many.compute import KILLED

SMALL = {"camera__pixels": [48, 36], "numerics": {"error_budget": False}}
pytestmark = pytest.mark.filterwarnings("ignore")  # of distributed and what it is built on


def children():
    """The processes that this one has, by number, with those of its children."""
    pairs, found = [], {os.getpid()}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = path.read_text(encoding="utf-8").rpartition(")")[2].split()[1]
            pairs.append((int(path.parent.name), int(parent)))
    for _ in range(4):
        found |= {own for own, parent in pairs if parent in found}
    return found - {os.getpid()}


def is_worker(number):
    with suppress(OSError):
        return b"POCL_MAX_PTHREAD_COUNT" in Path(f"/proc/{number}/environ").read_bytes()
    return False


ON_WORKER = cluster.on_worker


@pytest.mark.slow
def test_two_workers_give_the_numbers_of_one_process_and_survive_a_kill(tmp_path, device):
    source = write(tmp_path, scene(**SMALL))
    asked = {"over": {HUMID: [20.0, 40.0, 60.0, -1.0]}, "seeds": 10, "seed": 4}
    thzcl.study(source, tmp_path / "one", device=device, **asked)
    killed = []

    def shoot(text):
        if not killed and int(text.split()[0]) >= 5:
            worker = next(number for number in sorted(children()) if is_worker(number))
            os.kill(worker, signal.SIGKILL)
            killed.append(worker)

    found = thzcl.study(source, tmp_path / "two", dask="local", workers=2, progress=shoot, **asked)
    assert killed and found.states == {"done": 30, "failed": 10}
    assert numbers(tmp_path / "two") == numbers(tmp_path / "one")


@pytest.mark.slow
def test_a_member_that_kills_its_workers_is_marked_and_others_go_on(tmp_path, monkeypatch):
    source = write(tmp_path, scene(**SMALL))
    monkeypatch.setattr(cluster, "on_worker", dies_at_60_percent)
    found = thzcl.study(
        source, tmp_path / "out", over={HUMID: [20.0, 60.0]}, dask="local", workers=1
    )
    assert found.states == {"done": 1, "killed": 1}
    states = {one["settings"][HUMID]: one for one in found.records()}
    assert states[60.0]["state"] == KILLED and "want of memory" in states[60.0]["message"]


def dies_at_60_percent(study, batch, folder, device):
    members = (study.member(number) for task in batch for number in task.wanted)
    if any(member.settings[HUMID] == 60.0 for member in members):
        os.kill(os.getpid(), signal.SIGKILL)
    return ON_WORKER(study, batch, folder, device)


@pytest.mark.slow
def test_without_workers_nothing_is_waited_for_forever(tmp_path, monkeypatch):
    source = write(tmp_path, scene(**SMALL))
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    monkeypatch.setattr(cluster, "ALONE_S", 3.0)
    monkeypatch.setattr(cluster, "on_worker", leaves)
    with pytest.raises(UsageError, match="no worker for 3 s; what is done is kept"):
        thzcl.study(source, tmp_path / "out", over={HUMID: [20.0, 60.0]}, dask="local", workers=1)


def leaves(*_):
    """Closes the worker for good, as a batch system does at the end of its time."""
    from distributed import get_worker

    worker = get_worker()
    worker.loop.add_callback(worker.close, nanny=True)
    time.sleep(60)


def test_a_cluster_that_is_not_there_is_refused(tmp_path, monkeypatch, device):
    source = write(tmp_path, scene(**SMALL))
    asked = {"over": {HUMID: [20.0, 60.0]}}
    with pytest.raises(UsageError, match="workers is for a local cluster"):
        thzcl.study(source, tmp_path / "a", dask="tcp://127.0.0.1:1", workers=2, **asked)
    with pytest.raises(UsageError, match="open devices of their own"):
        thzcl.study(source, tmp_path / "a", dask="local", device=device, **asked)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install 'thzcl\[dask\]'"):
        thzcl.study(source, tmp_path / "b", dask="local", **asked)


@pytest.mark.long
def test_memory_stays_flat_over_500_members(tmp_path, device):
    source = write(tmp_path, scene(**SMALL))
    levels = []

    def weigh(text):
        assert text.endswith("members")
        levels.append(int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1]))

    thzcl.study(
        source, tmp_path / "a", over={HUMID: "20:60:10"}, seeds=100, device=device, progress=weigh
    )
    assert len(levels) == 500
    assert levels[-1] < 1.05 * levels[150]
