"""Members of a study on the workers of a Dask cluster: a local one, or that of a scheduler.

A worker is sent tasks, each a few members of one group, for about a second of work at once, and
returns rows of numbers. The process that started the study writes their files. A worker that is
lost has its tasks done again by others; what three workers were lost to is done task by task, then
member by member, and a member that three workers were lost to is marked as killed.
"""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
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
AHEAD = 3  # batches of tasks for each worker that wait at the scheduler
BATCH_S = 1.0  # of work that a worker is sent at once
MOST_TASKS = 100  # in a batch
PATIENCE_S = 10.0  # between looks at whether there are workers
ALONE_S = 120.0  # without any, after which nothing is waited for
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
        pending: dict[Any, tuple[Task, ...]] = {}

        def submit(batch: tuple[Task, ...]) -> None:
            if batch:
                future = client.submit(
                    on_worker, study, batch, folder.resolve(), device, pure=False, retries=0
                )
                pending[future] = batch

        size = 1
        for _ in range(AHEAD * count):
            submit(tuple(islice(waiting, size)))
        while pending:
            future = _ended(distributed, client, pending)
            batch = pending[future]
            try:
                found = future.result(timeout=PATIENCE_S)
                took = sum(one["seconds"] for one in found) / len(batch)
                size = int(min(max(BATCH_S / max(took, 1e-3), 1), MOST_TASKS))
            except TimeoutError:
                if future.done():  # it is the task's own
                    raise
                continue  # its worker was lost with the answer; another one does it again
            except distributed.scheduler.KilledWorker:
                smaller = _smaller(batch)
                found = [] if smaller else [_killed(study, batch[0].wanted[0])]
                for one in smaller:
                    submit(one)
            del pending[future]
            future.release()
            submit(tuple(islice(waiting, size)))
            yield from found


def _distributed() -> Any:
    """Returns the library, an extra of thzcl's. Raises UsageError if it is not installed."""
    try:
        import distributed
    except ImportError:
        raise UsageError(f"--dask {_MISSING}") from None
    return distributed


def _ended(distributed: Any, client: Any, pending: Iterable[Any]) -> Any:
    """Returns a task that has ended. Raises UsageError if the workers are gone for good."""
    seen = time.monotonic()
    while time.monotonic() - seen < ALONE_S:
        with suppress(TimeoutError):
            done = distributed.wait(list(pending), PATIENCE_S, "FIRST_COMPLETED").done
            return next(iter(done))
        if client.scheduler_info(n_workers=-1)["workers"]:
            seen = time.monotonic()
    text = f"there has been no worker for {ALONE_S:.0f} s"
    raise UsageError(f"--dask: {text}; what is done is kept: start workers, and the study again")


def _smaller(batch: tuple[Task, ...]) -> list[tuple[Task, ...]]:
    """Returns the parts of what workers were lost to, or none of a single member."""
    parts = list(batch)
    if len(parts) == 1:
        parts = [Task(parts[0].group, (number,)) for number in parts[0].wanted]
    return [(part,) for part in parts] if len(parts) > 1 else []


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
    # Dask's own: glibc then gives back every freed array and asks for its pages anew, which makes
    # members a quarter slower.
    environment.pop("MALLOC_TRIM_THRESHOLD_", None)
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
    study: Study, batch: tuple[Task, ...], folder: Path, device: str | None
) -> list[Record]:
    """Returns the records of the members of some tasks, computed by this process's own device."""
    here = opened(device)
    return [one for task in batch for one in members(study, task.group, task.wanted, folder, here)]


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
