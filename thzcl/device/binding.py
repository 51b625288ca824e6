"""The binding to OpenCL: told to keep nothing in a cache of its own, and of forks."""

from __future__ import annotations

import ctypes
import os
from typing import Any
from weakref import WeakSet

from thzcl.errors import DeviceError

# Its cache saves no time, and breaks down where it cannot be written. A setting of the user's own
# stays.
os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
import pyopencl as cl

__all__ = ["cl", "held", "start"]

held: WeakSet[Any] = (
    WeakSet()
)  # what holds objects of OpenCL, which a forked child must not release
_started = _forked = False


def start() -> None:
    """Notes that OpenCL is in use from now on. Raises DeviceError in a process forked after that.

    A fork copies OpenCL's locks, but none of its threads: the first call would wait for ever.
    """
    global _started  # noqa: PLW0603 (as OpenCL itself, one for the process)
    if _forked:
        text = "this process was forked after OpenCL had started, which it does not survive"
        way = (
            'start workers with multiprocessing.get_context("spawn"), or fork before the first run'
        )
        raise DeviceError(f"{text}; {way}")
    _started = True


def _after_fork() -> None:
    """Has a child of a process that uses OpenCL refuse it, and never release what it inherited."""
    global _forked  # noqa: PLW0603 (as above)
    _forked = _started
    for one in tuple(held):
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(one))


os.register_at_fork(after_in_child=_after_fork)
