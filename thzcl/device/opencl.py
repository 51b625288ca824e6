"""An OpenCL device, its buffers and its kernels. No other module imports pyopencl."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thzcl.device import cache, pocl, transform
from thzcl.device.memory import available_memory
from thzcl.errors import DeviceError

if not cache.can_be_written():
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")  # where it cannot write, pyopencl breaks down
import pyopencl as cl

KERNELS = Path(__file__).parents[1] / "kernels"
if not KERNELS.is_dir():  # straight from a checkout
    KERNELS = Path(__file__).parents[2] / "kernels"

GROUP = 16  # work-items in a group, always: few enough that little is padded
_ALIGNMENT = 128  # bytes


@dataclass(frozen=True)
class DeviceInfo:
    """A device that OpenCL sees."""

    number: int
    platform: str
    name: str
    kind: str  # CPU, GPU or other
    driver: str
    memory_bytes: int


def raw_devices() -> list[tuple[Any, DeviceInfo]]:
    """Returns every device of every platform, in OpenCL's order, with what is known of it."""
    pocl.set_environment()
    try:
        found = [device for platform in cl.get_platforms() for device in platform.get_devices()]
    except cl.Error:  # to OpenCL it is an error that there is no platform
        return []
    return [(device, _info(number, device)) for number, device in enumerate(found)]


def _info(number: int, device: Any) -> DeviceInfo:
    kinds = {cl.device_type.CPU: "CPU", cl.device_type.GPU: "GPU"}
    platform, version = device.platform, device.driver_version
    driver = " ".join(platform.version.partition(",")[0].removesuffix(version).split())
    return DeviceInfo(
        number=number,
        platform=platform.name,
        name=device.name.strip(),
        kind=next((name for flag, name in kinds.items() if device.type & flag), "other"),
        driver=f"{driver} {version}",
        memory_bytes=device.global_mem_size,
    )


@dataclass
class Counters:
    """What a device was given to do; it can be compared without a clock."""

    programs: int = 0  # built, or loaded from an earlier run's binary
    launches: int = 0
    segments: int = 0  # voxels that rays crossed over positive length
    bytes_copied: int = 0  # between host and device, both ways; on a CPU, those that would be


class Buffer:
    """An array on the device; on a CPU a NumPy array whose memory the device uses in place."""

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self._device = device
        self._array: NDArray[Any] | None = None
        length = int(np.prod(shape))
        size = max(length, 1) * self.dtype.itemsize
        aligned = None
        flags: Any = cl.mem_flags.READ_WRITE
        if device.in_place:
            raw = np.empty(size + _ALIGNMENT, np.uint8)
            start = -raw.ctypes.data % _ALIGNMENT
            aligned = raw[start : start + size]
            self._array = aligned.view(self.dtype)[:length].reshape(shape)
            flags |= cl.mem_flags.USE_HOST_PTR
        try:
            self.memory = cl.Buffer(device.context, flags, size, hostbuf=aligned)
        except cl.MemoryError as error:
            raise MemoryError(f"{size:,} bytes on {device.info.name}: {error}") from None

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size(self) -> int:
        """The size in bytes."""
        return int(np.prod(self.shape)) * self.dtype.itemsize

    def host(self) -> NDArray[Any]:
        """Returns the values, once every kernel before has ended.

        On a CPU it is no copy: do not write to it.
        """
        self._device.counters.bytes_copied += self.size
        if self._array is None:
            array = np.empty(self.shape, self.dtype)
            cl.enqueue_copy(self._device.queue, array, self.memory)
            return array
        self._device.finish()
        return self._array

    def fill(self, values: NDArray[Any]) -> Buffer:
        """Sets the values, and returns the buffer itself."""
        self._device.counters.bytes_copied += self.size
        if self._array is None:
            contiguous = np.ascontiguousarray(values, self.dtype)
            cl.enqueue_copy(self._device.queue, self.memory, contiguous)
        else:
            self._device.finish()
            self._array[...] = values
        return self


class Program:
    """Built kernels."""

    def __init__(self, device: Device, program: Any) -> None:
        self._device = device
        self._program = program
        self._kernels: dict[str, Any] = {}

    @property
    def binary(self) -> bytes:
        """The program as its device can load it again; PoCL links its kernels for that."""
        return bytes(self._program.get_info(cl.program_info.BINARIES)[0])

    def run(self, name: str, size: int | tuple[int, int, int], *arguments: Any) -> None:
        """Enqueues a kernel over `size` work-items, a multiple of 16.

        With three dimensions it is a multiple of 16 along y. Buffers and NumPy scalars are passed
        as they are, None as a null pointer.
        """
        if name not in self._kernels:
            self._kernels[name] = cl.Kernel(self._program, name)
        kernel = self._kernels[name]
        buffers = [argument for argument in arguments if isinstance(argument, Buffer)]
        for position, argument in enumerate(arguments):
            kernel.set_arg(position, argument.memory if isinstance(argument, Buffer) else argument)
        self._device.in_use.extend(buffers)
        self._device.counters.launches += 1
        extent, group = ((size,), (GROUP,)) if isinstance(size, int) else (size, (1, GROUP, 1))
        cl.enqueue_nd_range_kernel(self._device.queue, kernel, extent, group)


class _Recipe(NamedTuple):
    """What a program is built from."""

    files: tuple[str, ...]
    precision: str
    options: tuple[str, ...]


class Device:
    """One OpenCL device with its queue."""

    def __init__(self, device: Any, info: DeviceInfo) -> None:
        self.info = info
        self.context = cl.Context([device])
        self.queue = cl.CommandQueue(self.context)
        self.in_place = info.kind == "CPU" and bool(device.host_unified_memory)
        self.float64 = bool(device.double_fp_config)
        self.largest_buffer = int(device.max_mem_alloc_size)
        # Kernels that are not known to have ended use these: their memory must outlast them.
        self.in_use: list[Buffer] = []
        self.counters = Counters()
        self._programs: dict[_Recipe, Program] = {}
        self._transforms: transform.OnDevice | None = None

    @property
    def memory_bytes(self) -> int:
        """Memory for buffers: the device's, or what this process may use if that is the same."""
        return available_memory() if self.in_place else self.info.memory_bytes

    @property
    def build_options(self) -> list[str]:
        """Every program built so far, with its options."""
        return [
            f"{'+'.join(recipe.files)}: {' '.join(self._options(recipe))}"
            for recipe in self._programs
        ]

    @property
    def wide(self) -> np.dtype[Any]:
        """The type in which rays start."""
        return np.dtype(np.float64 if self.float64 else np.float32)

    def lanes(self, precision: str) -> int:
        """Returns how many rays a work-item takes."""
        return pocl.lanes(precision) if self.info.kind == "CPU" else 1

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> Buffer:
        """Returns memory that holds nothing in particular."""
        return Buffer(self, shape, dtype)

    def put(self, values: NDArray[Any], dtype: DTypeLike | None = None) -> Buffer:
        """Returns a copy of an array on the device."""
        return Buffer(self, values.shape, dtype or values.dtype).fill(values)

    def finish(self) -> None:
        """Waits for every kernel."""
        self.queue.finish()
        self.in_use.clear()

    def build(self, files: Sequence[str], precision: str, options: Sequence[str] = ()) -> Program:
        """Returns the kernels of some files behind device/lanes.cl, in that order.

        `precision` is "float32" or "float64"; an option is a name or NAME=value. A program that
        was built before, here or in an earlier run, is not built again.
        """
        recipe = _Recipe(tuple(files), precision, tuple(options))
        if recipe not in self._programs:
            self.counters.programs += 1
            source = "".join(map(_text_of, ("device/lanes", *recipe.files)))
            arguments = [f"-D{option}" for option in self._options(recipe)]
            self._programs[recipe] = self._load_or_compile(source, arguments)
        return self._programs[recipe]

    def compile(self, source: str, arguments: list[str]) -> Program:
        """Returns the kernels of a source text, compiled with these arguments.

        Raises DeviceError if the device's compiler refuses them.
        """
        try:
            return Program(self, _built(cl.Program(self.context, source), arguments))
        except cl.Error as error:
            reason = str(error).strip().partition("\n")[0]
            raise DeviceError(
                f"{self.info.name} cannot build kernels: {reason}; run `thzcl doctor`"
            ) from error

    def _options(self, recipe: _Recipe) -> list[str]:
        """Returns the options that every program has, and the program's own."""
        lanes, bits = self.lanes(recipe.precision), recipe.precision.removeprefix("float")
        wide = ["WIDE"] if self.float64 else []
        return [f"LANES={lanes}", f"PRECISION={bits}", *wide, *recipe.options]

    def _load_or_compile(self, source: str, arguments: list[str]) -> Program:
        """Returns a program from an earlier run's binary, or else from its source.

        A binary is a hundred times faster to load.
        """
        info, name = self.info, pocl.known_name()
        version = self.context.devices[0].platform.version
        identity = [source, *arguments, info.platform, version, info.driver, info.name, name]
        path = cache.entry("programs", identity)
        binary = cache.load(path)
        if binary is not None:
            with suppress(cl.Error):
                loaded = cl.Program(self.context, self.context.devices, [binary])
                return Program(self, _built(loaded, []))
        compiled = self.compile(source, arguments)
        cache.keep(path, compiled.binary)
        return compiled

    @property
    def usual_library(self) -> str:
        """The library that transforms cubes: "scipy" on a CPU, "reikna" elsewhere."""
        return "scipy" if self.in_place else "reikna"

    def inverse_transform(self, spectrum: Buffer, grid: int, library: str | None = None) -> Buffer:
        """Returns the inverse Fourier transform of a cube, divided by grid^3.

        A half spectrum (grid, grid, grid/2 + 1) gives a real cube; a full one gives a complex
        cube, in place. `library` is "scipy" or "reikna" (full spectra only); without one the
        usual library is taken.
        """
        if (library or self.usual_library) == "reikna":
            self._transforms = self._transforms or transform.OnDevice(self.queue)
            self._transforms.run(spectrum.memory, spectrum.shape, spectrum.dtype)
            self.finish()
            return spectrum
        result = transform.on_host(spectrum.host(), grid)
        return spectrum.fill(result) if spectrum.shape[2] == grid else self.put(result)


def _text_of(name: str) -> str:
    """Returns the text of a kernel file, under a line that names it in compilers' messages."""
    text = (KERNELS / f"{name}.cl").read_text(encoding="utf-8")
    return f'#line 1 "{name}.cl"\n{text}\n'


def _built(program: Any, arguments: list[str]) -> Any:
    """Builds a program without its compiler's or driver's remarks; errors are raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return program.build(arguments)
