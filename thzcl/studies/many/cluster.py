"""Members of a study on the workers of a Dask cluster: a local one, or that of a scheduler.

A worker computes a task, which is a few members of one group, and returns rows of numbers. The
process that started the study writes their files. A worker that is lost has its task done again by
others; a task that three workers were lost to is done member by member, and a member that three
workers were lost to is marked as killed.
"""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thzcl.errors import UsageError
from thzcl.studies.many.compute import KILLED, Record, Task, members, record
from thzcl.studies.many.members import Study

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

LOCAL = "local"
ALLOWED_FAILURES = 2  # workers lost to one task before it counts as killed: the third is
AHEAD = 3  # tasks for each worker that wait at the scheduler
_MISSING = "needs dask.distributed; install it: pip install 'thzcl[dask]'"


def on_workers(
    study: Study,
    todo: Sequence[Task],
    folder: Path,
    device: str | None,
    address: str,
    workers: int | None,
) -> Iterator[Record]:
    """Yields the records of members as workers finish their tasks, in any order.

    `address` is "local" for a cluster of `workers` processes (one a core if None), or that of a
    scheduler. `folder` is that for images, which workers must see by the same path. Raises
    UsageError without dask, or if no scheduler answers.
    """
    distributed = _distributed()
    if address != LOCAL and workers is not None:
        raise UsageError("--workers is for a local cluster; a scheduler has workers of its own")
    with ExitStack() as stack:
        client = stack.enter_context(_client(distributed, address, workers, stack))
        count = max(len(client.scheduler_info(n_workers=-1)["workers"]), 1)
        waiting = iter(todo)
        running = distributed.as_completed()
        pending: dict[Any, Task] = {}

        def submit(task: Task) -> None:
            future = client.submit(
                on_worker, study, task.group, task.wanted, folder.resolve(), device,
                pure=False, retries=0,
            )  # fmt: skip
            pending[future] = task
            running.add(future)

        for task in islice(waiting, AHEAD * count):
            submit(task)
        while pending:
            future = next(running)
            task = pending.pop(future)
            try:
                found = future.result()
            except distributed.scheduler.KilledWorker:
                found = []
                if len(task.wanted) == 1:
                    found = [_killed(study, task.wanted[0])]
                else:
                    for number in task.wanted:
                        submit(type(task)(task.group, (number,)))
            future.release()
            for following in islice(waiting, 1):
                submit(following)
            yield from found


def _distributed() -> Any:
    """Returns the library, an extra of thzcl's. Raises UsageError if it is not installed."""
    try:
        import distributed
    except ImportError:
        raise UsageError(f"--dask {_MISSING}") from None
    return distributed


def _killed(study: Study, number: int) -> Record:
    """Returns the record of a member that workers were lost to."""
    text = "its workers were lost three times, most likely for want of memory"
    remedy = "give fewer workers, or lower pixels, samples_per_pixel or grid"
    return record(study.member(number), KILLED, f"{text}; {remedy}", 0.0)


def _client(distributed: Any, address: str, workers: int | None, stack: ExitStack) -> Any:
    """Returns a client of a cluster: of one that is started here, or of a scheduler's."""
    import dask

    stack.enter_context(
        dask.config.set({"distributed.scheduler.allowed-failures": ALLOWED_FAILURES})
    )
    if address != LOCAL:
        try:
            return distributed.Client(address, timeout="10s")
        except (OSError, ValueError, TimeoutError) as error:
            text = f"no scheduler answers ({error}); start one, or check the address"
            raise UsageError(f"--dask {address}: {text}") from None
    cores = len(os.sched_getaffinity(0))
    count = cores if workers is None else workers
    before = dask.config.get("distributed.nanny.pre-spawn-environ", {}) or {}
    environment = before | surroundings(max(1, cores // count))
    stack.enter_context(dask.config.set({"distributed.nanny.pre-spawn-environ": environment}))
    cluster = distributed.LocalCluster(
        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=None
    )
    return distributed.Client(stack.enter_context(cluster))


def surroundings(threads: int) -> dict[str, str]:
    """Returns the environment that a worker of so many threads must start with.

    PoCL reads its own when it loads, OpenBLAS when NumPy does: later is too late.
    """
    return {
        "POCL_MAX_PTHREAD_COUNT": str(threads),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
    }


def on_worker(
    study: Study, group: range, wanted: tuple[int, ...], folder: Path, device: str | None
) -> list[Record]:
    """Returns the records of some members of a group, computed by this process's own device."""
    return list(members(study, group, wanted, folder, opened(device)))


@cache
def opened(choice: str | None) -> Device:
    """Returns the device of this worker, opened once.

    What is kept of built kernels lies on this machine's own disk, apart for each kind of processor:
    PoCL's cache is not proof against network file systems, and code for another processor ends the
    process.
    """
    from thzcl.device.choose import open_device

    kind = hashlib.sha256((platform.processor() + _flags()).encode()).hexdigest()[:12]
    scratch = Path(tempfile.gettempdir()) / f"thzcl-{os.getuid()}-{kind}"
    os.environ.setdefault("POCL_CACHE_DIR", str(scratch / "pocl"))
    os.environ.setdefault("XDG_CACHE_HOME", str(scratch))
    Path(os.environ["POCL_CACHE_DIR"]).mkdir(parents=True, exist_ok=True)
    return open_device(choice)


def _flags() -> str:
    """Returns what the processor can do, as Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith("flags")), "")
