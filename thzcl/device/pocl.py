"""What works around PoCL 3.0, the newest that comes as a wheel, of 2022."""

from __future__ import annotations

import ctypes
import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

PLATFORM = "Portable Computing Language"
# The version of PoCL whose device structure is known, and where that holds the processor's name.
_BUILD = "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6, SLEEF, DISTRO, POCL_DEBUG"
_NAME_OFFSET = 640  # bytes to `llvm_cpu` in struct _cl_device_id


def set_environment() -> None:
    """Tells PoCL not to build each kernel again for its size of group, which is no faster.

    It must be called before the platforms are listed. A setting of the user's own stays.
    """
    os.environ.setdefault("POCL_WORK_GROUP_SPECIALIZATION", "0")


def lanes(precision: str) -> int:
    """Returns how many rays a work-item takes: vectors of 256 bits.

    PoCL 3.0 may pass a longer vector otherwise than its own library takes it.
    """
    return 4 if precision == "float64" else 8


def give_name(device: Any) -> None:
    """Tells PoCL which processor it runs on, where its LLVM 14 has never heard of it.

    For processors newer than 2022 PoCL 3.0 asks its compiler for the CPU "generic", which that
    refuses: no kernel builds at all. There is no option for it, so the name is mended in PoCL's
    own device structure, and only if the place where this very build of PoCL keeps it does hold
    "generic". The new name is one whose instructions the processor has.
    """
    if not device.version.endswith("-generic") or device.platform.version.strip() != _BUILD:
        return
    with suppress(OSError), Path("/proc/self/mem").open("rb", buffering=0) as memory:
        memory.seek(device.int_ptr + _NAME_OFFSET)
        (pointer,) = struct.unpack("Q", memory.read(8))
        memory.seek(pointer)
        if memory.read(8) != b"generic\0":
            return
        libc = ctypes.CDLL(None)
        libc.strdup.restype = ctypes.c_void_p
        name = libc.strdup(known_name().encode())
        ctypes.c_uint64.from_address(device.int_ptr + _NAME_OFFSET).value = name


def known_name() -> str:
    """Returns a processor that LLVM 14 knows and that is no more able than this one.

    It is as able as the kernel library that PoCL picks.
    """
    flags: set[str] = set()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        flags = set(next((line for line in lines if line.startswith("flags")), "").split())
    if {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= flags:
        return "skylake-avx512"
    return "haswell" if {"avx2", "fma", "bmi2", "movbe"} <= flags else "x86-64"
