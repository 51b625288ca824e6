"""Runs functions of the kernels' files, one at a time, over arrays that a test makes."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache

import numpy as np
import pyopencl as cl
from conftest import ROOT

TYPES = {"float32": "float", "float64": "double", "int32": "int", "int64": "long", "uint32": "uint"}


@dataclass(frozen=True)
class Setting:
    """How a program is built: type of `real`, rays to a work-item, whether `wide` is float64."""

    precision: str = "float32"
    lanes: int = 1
    float64: bool = True

    def __str__(self):
        return f"{self.precision}-{self.lanes}-{self.wide}"

    @property
    def wide(self):
        """The type in which rays start."""
        return np.dtype("float64" if self.float64 else "float32")

    @property
    def whole(self):
        """The type of voxel numbers, as wide as `real`."""
        return np.dtype("int64" if self.precision == "float64" else "int32")

    @property
    def eps(self):
        """The distance from 1 to the next number of type `real`."""
        return float(np.finfo(self.precision).eps)

    @property
    def wide_eps(self):
        """The distance from 1 to the next number of type `wide`."""
        return float(np.finfo(self.wide).eps)


# As thzcl builds on a CPU, and with one ray to a work-item as on a GPU.
PACKETS = [
    Setting("float32", 8),
    Setting("float32", 16),
    Setting("float32"),
    Setting("float64", 4),
    Setting("float64"),
]
# What one ray does alone, on devices with float64 and without.
STARTS = [Setting(), Setting(float64=False)]


def evaluate(device, files, body, arrays, count, setting, options=()):
    """Runs `body` over `count` rays, behind the named files; it writes to `arrays` in place.

    `first` is the number of a work-item's first ray. An array is a __global pointer of its own name
    and type, unless its key is a declaration ("__constant box *boxes").
    """
    declared = [
        name if " " in name else f"__global {TYPES[str(array.dtype)]} *{name}"
        for name, array in arrays.items()
    ]
    paths = [ROOT / "kernels" / f"{name}.cl" for name in (*device.headers, *files)]
    source = "".join(
        f'#line 1 "{path.name}"\n{path.read_text(encoding="utf-8")}\n' for path in paths
    )
    source += (
        f'#line 1 "test"\n__kernel void test({", ".join(declared)})\n'
        f"{{\n    const int first = get_global_id(0) * LANES;\n{body}\n}}\n"
    )
    defined = [f"LANES={setting.lanes}", f"PRECISION={setting.precision.removeprefix('float')}"]
    defined += ["GATHERS", *(["WIDE"] if setting.float64 else [])]
    kernel = cl.Kernel(_built(device.context, source, (*defined, *options)), "test")
    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(device.context, flags, hostbuf=array) for array in arrays.values()]
    assert count % setting.lanes == 0
    kernel(device.queue, (count // setting.lanes,), None, *buffers)
    for array, buffer in zip(arrays.values(), buffers, strict=True):
        cl.enqueue_copy(device.queue, array, buffer)


@cache
def _built(context, source, options):
    """Returns a program, built once; the compiler's remarks on unused functions are not shown."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return cl.Program(context, source).build([f"-D{option}" for option in options])
