"""The binding to OpenCL, which is told not to keep anything where no cache can be written."""

import os

from thzcl.device import cache

if not cache.can_be_written():
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")  # else its import breaks down
import pyopencl as cl

__all__ = ["cl"]
