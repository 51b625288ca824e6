"""What works around PoCL 3.0 of 2022, the newest that comes as a wheel.

Each workaround says which version of PoCL ends it; once the wheel is that new, it may go. Two of
them stand in files of their own: linker.py and probe.py, for PoCL takes the whole process down
where it cannot link a kernel. That of 3.1 does too, and no version that ends it is known. The
kernels' part is kernels/device/pocl.cl.
"""

from __future__ import annotations

import ctypes
import os
import re
import struct
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from thzcl.device.memory import available_memory
from thzcl.errors import DeviceError

PLATFORM = "Portable Computing Language"
BUILD_BYTES = 400_000_000  # of memory that its compiler was found to take, and a third more
HEADER = "device/pocl"  # the kernels' part
CPU_INFO = Path("/proc/cpuinfo")
SLOW_GATHERS = Path("/sys/devices/system/cpu/vulnerabilities/gather_data_sampling")
# The version of PoCL whose device structure is known, and where that holds the processor's name.
_BUILD = "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release, RELOC, LLVM 14.0.6, SLEEF, DISTRO, POCL_DEBUG"
_NAME_OFFSET = 640  # bytes to `llvm_cpu` in struct _cl_device_id
_AVX512 = {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}


def version(driver: str) -> tuple[int, ...]:
    """Returns PoCL's version by what its driver is called, (3, 0) for "PoCL 3.0-rc2"."""
    found = re.search(r"PoCL (\d+)\.(\d+)", driver)
    return tuple(map(int, found.groups())) if found else ()


def set_environment() -> None:
    """Tells PoCL not to build each kernel again for its size of group, which is no faster.

    It must be called before the platforms are listed. A setting of the user's own stays. Every
    version so far does the same, but only a first run shows it.
    """
    os.environ.setdefault("POCL_WORK_GROUP_SPECIALIZATION", "0")


def refuse_without_memory() -> None:
    """Raises DeviceError if there is no memory to build kernels: PoCL would end the process.

    No version that ends it is known.
    """
    left = available_memory()
    if left < BUILD_BYTES:
        text = f"may use {left / 1e6:.0f} MB more, and building kernels takes {BUILD_BYTES / 1e6:g}"
        raise DeviceError(
            f"this process {text} MB; raise the limit of its memory (ulimit -v, ulimit -d, or that "
            "of its container)"
        )


def give_name(device: Any) -> None:
    """Tells PoCL which processor it runs on, where its LLVM 14 has never heard of it.

    For processors newer than 2022 PoCL 3.0 asks its compiler for the CPU "generic", which that
    refuses: no kernel builds at all. There is no option for it, so the name is mended in PoCL's
    own device structure, and only if the place where this very build of PoCL keeps it does hold
    "generic". The new name is one whose instructions the processor has. PoCL 3.1 ends it: that
    looks for the nearest processor that it knows, and obeys POCL_LLVM_CPU_NAME.
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
    _, flags = processor()
    if flags >= _AVX512:
        return "skylake-avx512"
    return "haswell" if {"avx2", "fma", "bmi2", "movbe"} <= flags else "x86-64"


def gather_bits() -> int:
    """Returns how many bits the processor gathers at once, or 0 where single loads are no slower.

    PoCL's compiler makes no gathers by itself, and no version that does is known. They were found
    to be faster on processors of Intel's. Others gather no faster than they load, and so do those
    that an update of their microcode guards against the leak of gathered data (CVE-2022-40982),
    which Linux tells. Where the user names the processor that is compiled for, it is not looked
    at: what that can do is not known here.
    """
    maker, flags = processor()
    safe = ""
    with suppress(OSError):
        safe = SLOW_GATHERS.read_text(encoding="ascii").strip()
    if maker != "GenuineIntel" or safe != "Not affected" or "POCL_LLVM_CPU_NAME" in os.environ:
        return 0
    if flags >= _AVX512:
        return 512
    return 256 if "avx2" in flags else 0


@cache
def processor() -> tuple[str, frozenset[str]]:
    """Returns who made the processor, and the names of what it can do."""
    lines = []
    with suppress(OSError):
        lines = CPU_INFO.read_text(encoding="utf-8").splitlines()
    found: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        found.setdefault(name.strip(), value.strip())
    return found.get("vendor_id", ""), frozenset(found.get("flags", "").split())
