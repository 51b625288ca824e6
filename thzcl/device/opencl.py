"""An OpenCL device, its buffers and its kernels."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from thzcl.device import cache, pocl, signature, transform
from thzcl.device.binding import cl, held
from thzcl.device.binding import start as use_opencl
from thzcl.device.info import DeviceInfo
from thzcl.device.kernels import Kernels, text_of
from thzcl.device.memory import available_memory
from thzcl.errors import DeviceError

# Work-items in a group: on a processor few enough that little is padded, on a GPU as many as its
# units take at once.
GROUP, GPU_GROUP = 16, 64
VECTOR_BITS = 256  # of a packet on a processor
_ALIGNMENT = 128  # bytes
# A kernel of more steps of rays or voxels than a slow processor takes in some tenths of a second is
# cut into pieces.
AT_ONCE, PIECE_S, MOST_GROWTH = 1e8, 0.5, 4.0


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
        use_opencl()
        held.add(self)
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
    """Built kernels, each of whose work-items takes `lanes` rays."""

    def __init__(
        self,
        device: Device,
        program: Any,
        parameters: Mapping[str, tuple[signature.Parameter, ...]],
        types: Mapping[str, np.dtype[Any]],
        lanes: int = 1,
    ) -> None:
        self.lanes = lanes
        self._device = device
        self._program = program
        self._parameters = parameters
        self._types = types
        self._kernels: dict[str, Any] = {}

    @property
    def binary(self) -> bytes:
        """The program as its device can load it again; PoCL links its kernels for that."""
        return bytes(self._program.get_info(cl.program_info.BINARIES)[0])

    def run(
        self, kernel: str, size: int | tuple[int, int, int], steps: float = 1.0, /, **arguments: Any
    ) -> None:
        """Enqueues a kernel over `size` work-items, with arguments by the names in its source.

        Of three sizes the first may be padded: the kernel must do nothing past it.
        A pointer takes a buffer, or None for a null pointer; any other parameter takes a number,
        which is converted to its type. A parameter `items` takes the first size. Raises TypeError
        if a name is missing or unknown, or a buffer holds numbers of another type.

        `steps` says about how many steps a ray or voxel takes. A kernel of many is cut along its
        last size into pieces of about half a second, each waited for: an interrupt must not wait
        for all of it.
        """
        parameters = self._parameters[kernel]
        sizes = (size,) if isinstance(size, int) else size
        if any(parameter.name == "items" for parameter in parameters):
            arguments["items"] = sizes[0]
        signature.check(kernel, parameters, arguments)
        if kernel not in self._kernels:
            self._kernels[kernel] = cl.Kernel(self._program, kernel)
        built = self._kernels[kernel]
        built.set_args(*(self._raw(kernel, one, arguments[one.name]) for one in parameters))
        self._device.counters.launches += 1
        extent, group = self._device.grouped(sizes)
        used = [one for one in arguments.values() if isinstance(one, Buffer)]
        work = math.prod(sizes) * self.lanes * steps
        if work > AT_ONCE:
            self._in_pieces(built, extent, group, AT_ONCE / work, used)
        else:
            self._device.in_use += used
            cl.enqueue_nd_range_kernel(self._device.queue, built, extent, group)

    def _in_pieces(
        self,
        built: Any,
        extent: tuple[int, ...],
        group: tuple[int, ...],
        part: float,
        used: list[Buffer],
    ) -> None:
        """Runs a kernel in pieces along its last dimension, of which the first is a `part`."""
        done, queue = 0, self._device.queue
        piece = part * extent[-1]
        while done < extent[-1]:
            count, width = self._device.cut(piece, extent[-1] - done, group[-1])
            begun = time.perf_counter()
            offset = (*(0 for _ in extent[1:]), done)
            self._device.in_use += used
            cl.enqueue_nd_range_kernel(
                queue, built, (*extent[:-1], count), (*group[:-1], width), offset
            )
            self._device.finish()
            done += count
            took_s = max(time.perf_counter() - begun, 1e-9)
            piece = count * min(PIECE_S / took_s, MOST_GROWTH)

    def _raw(self, kernel: str, parameter: signature.Parameter, value: Any) -> Any:
        """Returns an argument as OpenCL takes it."""
        dtype = self._types.get(parameter.type)
        if not parameter.pointer:
            return value if dtype is None else dtype.type(value)
        if value is None:
            return None
        if dtype is not None and value.dtype != dtype:
            raise TypeError(f"{parameter.name} of the kernel {kernel}: {value.dtype}, not {dtype}")
        return value.memory


class _Recipe(NamedTuple):
    """What a program is built from."""

    kernels: Kernels
    precision: str


class Device:
    """One OpenCL device with its queue; `note` is what users should know of how it is used."""

    def __init__(self, device: Any, info: DeviceInfo, note: str = "") -> None:
        held.add(self)
        self.info = info
        self.note = note
        self.context = cl.Context([device])
        self.queue = cl.CommandQueue(self.context)
        self.in_place = info.kind == "CPU" and bool(device.host_unified_memory)
        self.pocl = info.platform == pocl.PLATFORM
        self.float64 = bool(device.double_fp_config)
        self.group = GPU_GROUP if info.kind == "GPU" else GROUP
        self.units = int(device.max_compute_units)
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
            f"{'+'.join(recipe.kernels.files)}: {' '.join(self._options(recipe))}"
            for recipe in self._programs
        ]

    @property
    def wide(self) -> np.dtype[Any]:
        """The type in which rays start."""
        return np.dtype(np.float64 if self.float64 else np.float32)

    def lanes(self, precision: str, *, gathers: bool = False) -> int:
        """Returns how many rays a work-item takes: more of those that mostly gather, at times."""
        if self.info.kind != "CPU":
            return 1
        wider = gathers and self.pocl and precision == "float32"
        bits = max(VECTOR_BITS, pocl.gather_bits()) if wider else VECTOR_BITS
        return bits // _bits(precision)

    def padded(self, rays: int, precision: str) -> int:
        """Returns how many places rays take in whole groups of the longest packets."""
        packets = self.lanes(precision, gathers=True) * self.group
        return -(-rays // packets) * packets

    def grouped(self, size: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Returns how many work-items there are along each dimension, and how many in a group.

        Of three dimensions, a group lies along the first on a GPU, where neighbours are to write
        beside each other, and elsewhere along the second, since the first is short in packets.
        """
        if len(size) == 1:
            return size, (math.gcd(size[0], self.group),)
        if self.info.kind == "GPU":
            groups = -(-size[0] // self.group)
            return (groups * self.group, *size[1:]), (self.group, 1, 1)
        return size, (1, math.gcd(size[1], self.group), 1)

    def cut(self, piece: float, left: int, group: int) -> tuple[int, int]:
        """Returns how many work-items a piece has along its last dimension, and a group of them.

        The piece should have about `piece` of the `left`, in whole groups; where that is less than
        the device takes at once, each work-item is a group of its own, and there is one for each of
        its units.
        """
        whole = int(min(piece, left)) // group * group
        if whole < group * self.units:
            return min(max(int(piece), self.units), left), 1
        return whole, group

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

    @property
    def headers(self) -> tuple[str, ...]:
        """The kernel files that every program begins with."""
        return ("device/lanes", *((pocl.HEADER,) if self.pocl else ()))

    def build(self, kernels: Kernels, precision: str) -> Program:
        """Returns a family of kernels, with reals of "float32" or "float64".

        A program that was built before, here or in an earlier run, is not built again. Raises
        DeviceError if the device has no float64 where that is asked for.
        """
        use_opencl()
        if precision == "float64" and not self.float64:
            raise DeviceError(
                f"{self.info.name} cannot compute in float64; "
                'set numerics.precision = "float32", or choose another device'
            )
        recipe = _Recipe(kernels, precision)
        if recipe not in self._programs:
            self.counters.programs += 1
            self._programs[recipe] = self._load_or_compile(recipe)
        return self._programs[recipe]

    def compile(self, source: str, arguments: list[str]) -> Program:
        """Returns the kernels of a source text, compiled with these arguments.

        Raises DeviceError if the device's compiler refuses them.
        """
        types = {"int": np.dtype(np.int32)}
        return Program(self, self._compiled(source, arguments), signature.signatures(source), types)

    def _compiled(self, source: str, arguments: list[str]) -> Any:
        """Returns an OpenCL program. Raises DeviceError if it cannot be built."""
        if self.pocl:
            pocl.refuse_without_memory()
        try:
            return _built(cl.Program(self.context, source), arguments)
        except cl.Error as error:
            reason = str(error).strip().partition("\n")[0]
            raise DeviceError(
                f"{self.info.name} cannot build kernels: {reason}; run `thzcl doctor`"
            ) from error

    def _options(self, recipe: _Recipe) -> list[str]:
        """Returns the options that every program has, and the program's own."""
        lanes = self.lanes(recipe.precision, gathers=recipe.kernels.gathers)
        wide = ["WIDE"] if self.float64 else []
        gathers = ["GATHERS"] if self.pocl and pocl.gather_bits() else []
        always = [f"LANES={lanes}", f"PRECISION={_bits(recipe.precision)}", *wide, *gathers]
        return [*always, *recipe.kernels.options()]

    def _load_or_compile(self, recipe: _Recipe) -> Program:
        """Returns a program from an earlier run's binary, or else from its source.

        A binary is a hundred times faster to load. One without the program's kernels, as some
        drivers make them, is passed over.
        """
        source = "".join(map(text_of, (*self.headers, *recipe.kernels.files)))
        arguments = [f"-D{option}" for option in self._options(recipe)]
        parameters = signature.signatures(source)
        info, name = self.info, pocl.known_name()
        version = self.context.devices[0].platform.version
        identity = [source, *arguments, info.platform, version, info.driver, info.name, name]
        path = cache.entry("programs", identity)
        built = self._loaded(cache.load(path))
        names = set() if built is None else set(built.kernel_names.split(";"))
        fresh = built is None or not names or not names <= parameters.keys()
        if fresh:
            built = self._compiled(source, arguments)
        lanes = self.lanes(recipe.precision, gathers=recipe.kernels.gathers)
        program = Program(self, built, parameters, self._types(recipe.precision), lanes)
        if fresh:
            cache.keep(path, program.binary)
        return program

    def _loaded(self, binary: bytes | None) -> Any:
        """Returns the program of an earlier run's binary; None without one that can be built."""
        if binary is None:
            return None
        with suppress(cl.Error):
            return _built(cl.Program(self.context, self.context.devices, [binary]), [])
        return None

    def _types(self, precision: str) -> dict[str, np.dtype[Any]]:
        """Returns the types of numbers, by their names in kernels."""
        plain = {"char": "int8", "int": "int32", "uint": "uint32", "float": "float32"}
        named = plain | {"float2": "complex64", "real": precision, "wide": str(self.wide)}
        return {name: np.dtype(dtype) for name, dtype in named.items()}

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


def _bits(precision: str) -> int:
    """Returns the bits of a number of a precision."""
    return int(precision.removeprefix("float"))


def _built(program: Any, arguments: list[str]) -> Any:
    """Builds a program without its compiler's or driver's remarks; errors are raised."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return program.build(arguments, cache_dir=False)  # ours is checked, and does for all
