"""The OpenCL device: choose it, build kernels, hold buffers, transform.

The only file that imports pyopencl or reikna.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thzcl.device import linker
from thzcl.device import pocl as processor

if not linker.can_cache():
    os.environ.setdefault("PYOPENCL_NO_CACHE", "1")  # where it cannot write, pyopencl breaks down
import pyopencl as cl

KERNELS = Path(__file__).parents[1] / "kernels"
if not KERNELS.is_dir():  # straight from a checkout
    KERNELS = Path(__file__).parents[2] / "kernels"

GROUP = 16  # work-items in a group, always: few enough that little is padded
SCIPY_FROM = 256  # grid from which SciPy's threads make up for the time its import takes
WORTH_HELP = 4  # programs, for which a helper's own start is made up for
PROBE = "__kernel void probe(__global int *a) { a[get_global_id(0)] = 1; }"
_ALIGNMENT = 128  # bytes


class DeviceError(Exception):
    """There is no usable device; the text says what to do about it."""


@dataclass(frozen=True)
class DeviceInfo:
    """A device that OpenCL sees."""

    number: int
    platform: str
    name: str
    kind: str  # CPU, GPU or other
    driver: str
    memory_bytes: int


def devices() -> list[DeviceInfo]:
    """Every device of every platform, in OpenCL's order."""
    return [_info(number, device) for number, device in enumerate(_all())]


class Recipe(NamedTuple):
    """What a program is built from: files in order, behind lanes.cl, and options.

    Names or NAME=value.
    """

    files: tuple[str, ...]
    precision: str
    options: tuple[str, ...] = ()


def open_device(
    choice: str | None = None, recipes: Sequence[Recipe] = (), helper: linker.Helper | None = None
) -> Device:
    """The chosen device, ready for kernels: a number, or part of a name, platform or kind; by default PoCL's CPU.

    `recipes` are programs that will be wanted: where PoCL has many to build, or has never built one here, it does so now, in
    two processes, of which `helper` is one that runs already, for the default device. Raises DeviceError if there is no device,
    if the choice is not clear, or if its driver cannot build kernels.
    """
    found = _all()
    if not found:
        raise DeviceError("OpenCL sees no device; run `thzcl doctor`")
    infos = [_info(number, device) for number, device in enumerate(found)]
    info = _chosen(infos, choice)
    if info.platform != "Portable Computing Language":
        return Device(found[info.number], info)
    processor.give_name(found[info.number])
    missing = linker.prepare()
    if missing:
        raise DeviceError(missing)
    opened = Device(found[info.number], info)
    opened.get_ready(recipes, helper)
    return opened


def _chosen(infos: list[DeviceInfo], choice: str | None) -> DeviceInfo:
    if choice is None:
        return min(
            infos,
            key=lambda info: (info.platform != "Portable Computing Language", info.kind != "CPU"),
        )
    listing = ", ".join(f"{info.number} ({info.name})" for info in infos)
    if choice.isdigit():
        if int(choice) < len(infos):
            return infos[int(choice)]
        raise DeviceError(f"there is no device {choice}; choose among {listing}")
    fitting = [i for i in infos if choice.lower() in f"{i.platform} {i.name} {i.kind}".lower()]
    if len(fitting) != 1:
        found = "no device fits" if not fitting else "several devices fit"
        raise DeviceError(f'{found} "{choice}"; choose among {listing}')
    return fitting[0]


def _all() -> list[Any]:
    # Else PoCL builds each kernel a second time, for our very size of group, which is no faster.
    os.environ.setdefault("POCL_WORK_GROUP_SPECIALIZATION", "0")
    try:
        return [device for platform in cl.get_platforms() for device in platform.get_devices()]
    except cl.Error:  # no platform at all is an error to OpenCL
        return []


def _info(number: int, device: Any) -> DeviceInfo:
    kinds = {cl.device_type.CPU: "CPU", cl.device_type.GPU: "GPU"}
    kind = next((name for flag, name in kinds.items() if device.type & flag), "other")
    platform = device.platform
    driver = " ".join(
        platform.version.partition(",")[0].removesuffix(device.driver_version).split()
    )
    return DeviceInfo(
        number,
        platform.name,
        device.name.strip(),
        kind,
        f"{driver} {device.driver_version}",
        device.global_mem_size,
    )


@dataclass
class Counters:
    """What a device was given to do; no clock is needed to compare it."""

    programs: int = 0  # built, or loaded from an earlier run's binary
    launches: int = 0
    bytes_copied: int = (
        0  # between host and device, both ways; on a CPU, those that would have been
    )


class Buffer:
    """An array on the device.

    On a CPU it is a NumPy array whose memory the device uses in place.
    """

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self._device = device
        self._array: NDArray[Any] | None = None
        size = max(int(np.prod(shape)) * self.dtype.itemsize, 1)
        flags = cl.mem_flags.READ_WRITE
        if device.in_place:
            raw = np.empty(size + _ALIGNMENT, np.uint8)
            start = -raw.ctypes.data % _ALIGNMENT
            self._array = (
                raw[start : start + size].view(self.dtype)[: int(np.prod(shape))].reshape(shape)
            )
            self.memory = cl.Buffer(
                device.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=raw[start : start + size]
            )
        else:
            self.memory = cl.Buffer(device.context, flags, size)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size(self) -> int:
        """In bytes."""
        return int(np.prod(self.shape)) * self.dtype.itemsize

    def host(self) -> NDArray[Any]:
        """The values, once every kernel before has ended; on a CPU not a copy.

        Do not write to it.
        """
        self._device.counters.bytes_copied += self.size
        if self._array is None:
            array = np.empty(self.shape, self.dtype)
            cl.enqueue_copy(self._device.queue, array, self.memory)
            return array
        self._device.finish()
        return self._array

    def fill(self, values: NDArray[Any]) -> Buffer:
        """Sets the values; returns the buffer itself."""
        self._device.counters.bytes_copied += self.size
        if self._array is None:
            cl.enqueue_copy(
                self._device.queue, self.memory, np.ascontiguousarray(values, self.dtype)
            )
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

    def run(self, name: str, size: int | tuple[int, int, int], *arguments: Any) -> None:
        """Enqueues a kernel over `size` work-items, a multiple of 16 (along y, where there are three dimensions).

        Buffers and NumPy scalars are passed as they are, None as a null pointer.
        """
        if name not in self._kernels:
            self._kernels[name] = cl.Kernel(self._program, name)
        kernel = self._kernels[name]
        for position, argument in enumerate(arguments):
            kernel.set_arg(position, argument.memory if isinstance(argument, Buffer) else argument)
        self._device.in_use.extend(
            argument for argument in arguments if isinstance(argument, Buffer)
        )
        self._device.counters.launches += 1
        extent, group = ((size,), (GROUP,)) if isinstance(size, int) else (size, (1, GROUP, 1))
        cl.enqueue_nd_range_kernel(self._device.queue, kernel, extent, group)


class Device:
    """One OpenCL device with its queue."""

    def __init__(self, device: Any, info: DeviceInfo) -> None:
        self.info = info
        self.context = cl.Context([device])
        self.queue = cl.CommandQueue(self.context)
        self.in_place = info.kind == "CPU" and bool(device.host_unified_memory)
        self.float64 = bool(device.double_fp_config)
        self.largest_buffer = int(device.max_mem_alloc_size)
        self.in_use: list[
            Buffer
        ] = []  # by kernels not known to have ended: their memory must outlast them
        self.counters = Counters()
        self._programs: dict[Recipe, Program] = {}
        self._ready: dict[Recipe, Any] = {}  # built beforehand

    @property
    def memory_bytes(self) -> int:
        """Memory for buffers: the device's, or the machine's where the device works in it."""
        if self.in_place:
            return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        return self.info.memory_bytes

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
        """Rays to a work-item. Past 256 bits.

        PoCL 3.0 may pass a vector otherwise than its own library takes it.
        """
        if self.info.kind != "CPU":
            return 1
        return 4 if precision == "float64" else 8

    def empty(self, shape: tuple[int, ...], dtype: DTypeLike) -> Buffer:
        """Memory that holds nothing in particular."""
        return Buffer(self, shape, dtype)

    def put(self, values: NDArray[Any], dtype: DTypeLike | None = None) -> Buffer:
        """A copy of an array on the device."""
        return Buffer(self, values.shape, dtype or values.dtype).fill(values)

    def finish(self) -> None:
        """Waits for every kernel."""
        self.queue.finish()
        self.in_use.clear()

    def get_ready(self, recipes: Sequence[Recipe], helper: linker.Helper | None = None) -> None:
        """Builds with PoCL what is not in the cache, with a child's help: where there is much, or where nothing is proved yet.

        Raises DeviceError if the child cannot build a kernel, for PoCL would take this process down too.
        """
        driver = f"{self.info.platform} {self.info.driver} {self.info.name}"
        proved = linker.is_proved(driver)
        wanted = [recipe for recipe in recipes if not self._cached(*self._source(recipe)).exists()]
        if proved and len(wanted) < WORTH_HELP:
            return
        theirs = wanted[
            ::WORTH_HELP
        ]  # fewer than half: a helper has its own start and a first kernel to see to
        helper = helper or linker.Helper(self.info.number)
        try:
            helper.send(json.dumps(theirs))
            own = [
                (recipe, self._compiled(*self._source(recipe)))
                for recipe in wanted
                if recipe not in theirs
            ]
            trouble = None if proved else helper.trouble(driver)
            if trouble:
                raise DeviceError(trouble)
            for recipe, program in own:  # nothing is linked before
                self._keep(self._cached(*self._source(recipe)), program)
                self._ready[recipe] = program
            helper.wait()
        finally:
            helper.stop()

    def build(self, files: Sequence[str], precision: str, options: Sequence[str] = ()) -> Program:
        """The kernels of a recipe."""
        recipe = Recipe(tuple(files), precision, tuple(options))
        if recipe not in self._programs:
            self.counters.programs += 1
            self._programs[recipe] = Program(
                self, self._ready.get(recipe) or self._built(*self._source(recipe))
            )
        return self._programs[recipe]

    def _source(self, recipe: Recipe) -> tuple[str, list[str]]:
        """The text of a recipe, and the compiler's options."""
        files = [
            (name, (KERNELS / f"{name}.cl").read_text(encoding="utf-8"))
            for name in ("device/lanes", *recipe.files)
        ]
        source = "".join(f'#line 1 "{name}.cl"\n{text}\n' for name, text in files)
        return source, [f"-D{option}" for option in self._options(recipe)]

    def _options(self, recipe: Recipe) -> list[str]:
        """Those that every program has, and its own."""
        common = [
            f"LANES={self.lanes(recipe.precision)}",
            f"PRECISION={recipe.precision.removeprefix('float')}",
        ]
        return [*common, *(["WIDE"] if self.float64 else []), *recipe.options]

    def _built(self, source: str, options: list[str]) -> Any:
        """A program from its binary of an earlier run, a hundred times faster to load.

        Or else from its source.
        """
        cached = self._cached(source, options)
        with suppress(OSError, cl.Error):
            digest, binary = cached.read_bytes()[:32], cached.read_bytes()[32:]
            if hashlib.sha256(binary).digest() == digest:
                return cl.Program(self.context, self.context.devices, [binary]).build()
        program = self._compiled(source, options)
        self._keep(cached, program)
        return program

    def _compiled(self, source: str, options: list[str]) -> Any:
        """A program from its source; on PoCL nothing is linked yet."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the compiler's remarks; its errors are raised
            return cl.Program(self.context, source).build(options)

    def _keep(self, cached: Path, program: Any) -> None:
        """Writes a program's binary, linked, for later runs.

        A cache that cannot be written is done without.
        """
        binary = program.get_info(cl.program_info.BINARIES)[0]
        with suppress(OSError):
            cached.parent.mkdir(parents=True, exist_ok=True)
            part = cached.with_suffix(f".{os.getpid()}")
            part.write_bytes(hashlib.sha256(binary).digest() + binary)
            part.replace(cached)

    def _cached(self, source: str, options: list[str]) -> Path:
        """Where the binary of a program is kept: by all that it depends on."""
        platform = self.context.devices[0].platform.version
        info, name = self.info, processor.known_name()
        identity = "\0".join(
            [source, *options, info.platform, platform, info.driver, info.name, name]
        )
        return linker.cache_folder() / "programs" / hashlib.sha256(identity.encode()).hexdigest()

    def usual_library(self, grid: int) -> str:
        """The fastest for one cube: reikna on anything but a CPU, there NumPy.

        And from 256 cubed on SciPy with all cores.
        """
        return "reikna" if not self.in_place else "scipy" if grid >= SCIPY_FROM else "numpy"

    def inverse_transform(self, spectrum: Buffer, grid: int, library: str | None = None) -> Buffer:
        """Inverse Fourier transform of a cube, normalised by 1 / grid^3.

        A half spectrum (grid, grid, grid/2 + 1) gives a real cube; a full one gives a complex cube,
        in place. `library` is "numpy", "scipy" or "reikna" (full spectra only); by default the
        usual one.
        """
        library = library or self.usual_library(grid)
        if library == "reikna":
            from reikna.cluda import ocl_api
            from reikna.fft import FFT

            thread = ocl_api().Thread(self.queue)
            cube = thread.array(spectrum.shape, spectrum.dtype, base=spectrum.memory)
            FFT(cube).compile(thread)(cube, cube, inverse=1)
            self.finish()
            return spectrum
        values, axes = spectrum.host(), (0, 1, 2)
        half = values.shape[2] != grid
        if library == "scipy":
            import scipy.fft

            transform = scipy.fft.irfftn if half else scipy.fft.ifftn
            result = transform(values, (grid,) * 3, axes, overwrite_x=True, workers=-1)
        else:
            result = (
                np.fft.irfftn(values, (grid,) * 3, axes)
                if half
                else np.fft.ifftn(values, axes=axes)
            )
        return self.put(result) if half else spectrum.fill(result)


def _help(number: str | None = None) -> None:
    """What a helper does, a child process: it builds and runs a first kernel, which may end it.

    And then more programs.
    """
    found = _all()
    info = _chosen([_info(place, raw) for place, raw in enumerate(found)], number)
    processor.give_name(found[info.number])
    device = Device(found[info.number], info)
    answer = device.put(np.zeros(GROUP, np.int32))
    Program(device, cl.Program(device.context, PROBE).build()).run("probe", GROUP, answer)
    if not answer.host().all():
        raise SystemExit("a kernel ran, but what it computed is wrong")
    print(linker.PROVED, flush=True)
    for files, precision, options in json.loads(sys.stdin.read() or "[]"):
        device.build(files, precision, options)


if __name__ == "__main__":
    _help(*sys.argv[1:])
