"""A child process that builds and runs a first kernel before this process does.

PoCL aborts the whole process where `ld` or libgcc is missing. A child goes first, once for each
driver and linker, and a mark in the cache says that it came back.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np

from thzcl.device import cache, info, linker, opencl, pocl
from thzcl.errors import DeviceError

PROVED = "a first kernel was built and run"
KERNEL = "__kernel void probe(__global int *a) { a[get_global_id(0)] = 1; }"


def prove(device: info.DeviceInfo) -> None:
    """Has a child build and run a first kernel, if none did with this driver and linker.

    Raises DeviceError if the child cannot, for PoCL would take this process down too.
    """
    driver = f"{device.platform} {device.driver} {device.name}"
    mark = cache.entry("probed", (driver, linker.identity(), sys.prefix))
    with suppress(OSError):
        if mark.exists():
            return
    pocl.refuse_without_memory()
    said = [line.strip() for line in _child(device.number).splitlines() if line.strip()]
    if PROVED not in said:
        last = f" (it said: {said[-1][:200]})" if said else ""
        raise DeviceError(
            f"a first kernel could not be built and run with {driver}, most often for want of a "
            f"linker; {linker.REMEDY}{last}"
        )
    with suppress(OSError):  # without a mark the next run tries again
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()


def _child(number: int) -> str:
    """Returns what a child process says when it builds and runs a kernel on a device."""
    root, own = str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")
    done = subprocess.run(  # noqa: S603 (no word of it is a user's)
        # -P leaves out the current folder, where a user may have a signal.py.
        [sys.executable, "-P", "-m", "thzcl.device.probe", str(number)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (root, own)))},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    return done.stdout


def _build_and_run(number: int) -> None:
    """Builds and runs the kernel on the device of that number; PoCL may end the process."""
    raw, known = info.raw_devices()[number]
    pocl.give_name(raw)
    device = opencl.Device(raw, known)
    answer = device.put(np.zeros(opencl.GROUP, np.int32))
    device.compile(KERNEL, []).run("probe", opencl.GROUP, a=answer)
    if not answer.host().all():
        raise SystemExit("a kernel ran, but what it computed is wrong")
    print(PROVED, flush=True)


if __name__ == "__main__":
    _build_and_run(int(sys.argv[1]))
