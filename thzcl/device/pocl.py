"""The processor, as PoCL's compiler should know it."""

from __future__ import annotations

import ctypes
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any


def give_name(device: Any) -> None:
    """Tells PoCL which processor it runs on, where its LLVM 14 has never heard of it.

    For processors newer than 2022 PoCL 3.0 asks its compiler for the CPU "generic", which that
    refuses: no kernel builds at all. There is no option for it, so the name is mended in PoCL's own
    device structure, and only if the place where this very build of PoCL keeps it does hold
    "generic". The new name is one whose instructions the processor has.
    """
    known_build = (
        "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6, SLEEF, DISTRO, POCL_DEBUG"
    )
    offset = 640  # of `llvm_cpu` in struct _cl_device_id
    if not device.version.endswith("-generic") or device.platform.version.strip() != known_build:
        return
    with suppress(OSError), Path("/proc/self/mem").open("rb", buffering=0) as memory:
        memory.seek(device.int_ptr + offset)
        (pointer,) = struct.unpack("Q", memory.read(8))
        memory.seek(pointer)
        if memory.read(8) != b"generic\0":
            return
        libc = ctypes.CDLL(None)
        libc.strdup.restype = ctypes.c_void_p
        ctypes.c_uint64.from_address(device.int_ptr + offset).value = libc.strdup(
            known_name().encode()
        )


def known_name() -> str:
    """A processor that LLVM 14 knows, no more able than this one.

    And as able as the kernel library that PoCL picks.
    """
    flags: set[str] = set()
    with suppress(OSError):
        line = next(
            (
                line
                for line in Path("/proc/cpuinfo").read_text().splitlines()
                if line.startswith("flags")
            ),
            "",
        )
        flags = set(line.split())
    if {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"} <= flags:
        return "skylake-avx512"
    return "haswell" if {"avx2", "fma", "bmi2", "movbe"} <= flags else "x86-64"
