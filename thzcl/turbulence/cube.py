"""Makes cubes of random humidity, and of temperature where it fluctuates; or loads one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air.layers import Departures
from thzcl.device.kernels import Kernels
from thzcl.device.opencl import Buffer, Device, Program
from thzcl.errors import FileError
from thzcl.turbulence import cube_file
from thzcl.turbulence.cube_file import CubeFile
from thzcl.turbulence.large_scales import Waves
from thzcl.turbulence.lattice import Lattice
from thzcl.turbulence.spectra import Turbulence, spectral_amplitude

Array = NDArray[np.float64]
Span = tuple[float, float]


@dataclass(frozen=True)
class FieldKernels(Kernels):
    """The kernels that make random cubes; `two_fields` if one transform makes two of them."""

    files: ClassVar = ("turbulence/field",)

    two_fields: bool


@dataclass(frozen=True)
class Field:
    """Fluctuations on the device, voxel [iz, iy, ix], x fastest.

    `delta` is rho / rho_mean - 1; `offset` the temperature's departure from the mean in K, or None
    in isothermal air. The spans are what the cube really reaches; `notes` tell of values that had
    to be limited.
    """

    lattice: Lattice
    delta: Buffer
    offset: Buffer | None
    humidity_span: Span
    temperature_span: Span
    notes: tuple[str, ...]
    strength: float = 0.0  # what multiplied a Gaussian of C^2 = 1 to make the humidity
    waves: Waves | None = None  # eddies larger than the cube, which add to delta
    layers: Departures | None = None  # the mean air by height

    @property
    def grid(self) -> int:
        """Returns the voxels along an edge of a cube whose edges are alike."""
        return self.lattice.shape[0]

    @property
    def voxel_m(self) -> float:
        """Returns the edge of a voxel of a cube whose edges are alike, m."""
        return self.lattice.voxel_m[0]


class Statistics(NamedTuple):
    """Standard deviation of a cube, and its smallest and largest value."""

    sigma: float
    span: Span


def generate(
    device: Device,
    turbulence: Turbulence,
    precision: str,
    ceiling: float = math.inf,
    library: str | None = None,
) -> Field:
    """Returns a realisation of the fluctuations, with `delta` limited to `ceiling`.

    Each Gaussian starts with C^2 = 1. A given sigma then rescales this realisation to it exactly, a
    given structure constant scales by what is expected of the ensemble. `library` is as in
    Device.inverse_transform.
    """
    full = turbulence.temperature_fluctuates or library == "reikna" or not device.in_place
    program = device.build(FieldKernels(full), "float32")
    humidity, second = _gaussians(device, program, turbulence, full, library)
    offset, temperature_span = None, (0.0, 0.0)
    if turbulence.temperature_fluctuates:
        temperature_span = _warm(device, program, turbulence, humidity, second)
        offset = _as_precise(device, second, precision)

    expected = math.sqrt(turbulence.unit_variance)
    own = statistics(device, program, humidity).sigma if turbulence.exact else expected
    s = math.sqrt(math.log1p(turbulence.sigma**2)) if turbulence.lognormal else turbulence.sigma
    shift = s * s / 2 if turbulence.lognormal else 0.0
    items = turbulence.grid**3 // program.lanes
    program.run("humidity", items, field=humidity, scale=s / own, shift=shift)
    span = statistics(device, program, humidity).span
    notes, span = _limit(humidity, span, ceiling)
    delta = _as_precise(device, humidity, precision)
    spans = span, temperature_span
    return Field(turbulence.lattice, delta, offset, *spans, notes, strength=s / own)


def _warm(
    device: Device, program: Program, turbulence: Turbulence, humidity: Buffer, second: Buffer
) -> Span:
    """Makes departures of temperature in K of a second Gaussian, in place; returns their span.

    They are correlated with the first Gaussian, `humidity`, as the scene says.
    """
    items = turbulence.grid**3 // program.lanes
    both = {"field": second, "other": humidity}
    along, across = turbulence.correlation, math.sqrt(1 - turbulence.correlation**2)
    program.run("combine", items, **both, along=along, across=across)
    own = math.sqrt(turbulence.unit_variance)
    if turbulence.temperature_exact:
        own = statistics(device, program, second).sigma
    kelvin = turbulence.temperature_sigma_k / own
    program.run("combine", items, **both, along=0, across=kelvin)
    return statistics(device, program, second).span


def _gaussians(
    device: Device, program: Program, t: Turbulence, full: bool, library: str | None
) -> tuple[Buffer, Buffer]:
    """Returns two independent cubes from a full transform, or one, twice, from a half one."""
    n = t.grid
    amplitude = device.put(
        spectral_amplitude(n, t.voxel_m, t.outer_scale_m, t.table) * n**3, np.float32
    )
    seed = np.array((t.seed & 0xFFFFFFFF, t.seed >> 32), dtype=np.uint32)
    spectrum = device.empty((n, n, n if full else n // 2 + 1), np.complex64)
    packets = n // 2 // program.lanes + 1
    size = packets, n, n
    program.run("spectrum", size, out=spectrum, amplitude=amplitude, n=n, seed=seed, stream=0)
    cube = device.inverse_transform(spectrum, n, library)
    if not full:
        return cube, cube
    one, other = device.empty((n, n, n), np.float32), device.empty((n, n, n), np.float32)
    program.run("parts", n**3, both=cube, one=one, other=other)
    return one, other


def statistics(device: Device, program: Program, cube: Buffer) -> Statistics:
    """Returns standard deviation and span of a float32 cube.

    Sums are taken in runs of fixed length and then in float64.
    """
    voxels, run = math.prod(cube.shape), 16 * cube.shape[0]
    sums = device.empty((voxels // run, 4), np.float32)
    program.run("statistics", voxels // run, run, field=cube, run=run, out=sums)
    total, square, low, high = sums.host().astype(np.float64).T
    mean = total.sum() / voxels
    return Statistics(
        math.sqrt(max(square.sum() / voxels - mean**2, 0.0)), (float(low.min()), float(high.max()))
    )


def _as_precise(device: Device, cube: Buffer, precision: str) -> Buffer:
    return cube if precision == "float32" else device.put(cube.host(), precision)


def _limit(delta: Buffer, span: Span, ceiling: float) -> tuple[tuple[str, ...], Span]:
    """Limits voxels whose vapour alone would exceed the total pressure, in place.

    Returns notes that count them and the voxels clipped at dry air, and the span that is left.
    """
    notes = []
    if span[0] <= -1:
        dry = int(np.count_nonzero(delta.host() <= -1))
        notes.append(f"{dry} of {delta.host().size} voxels were clipped at dry air")
    if span[1] > ceiling:
        values = delta.host()
        wet = int(np.count_nonzero(values > ceiling))
        notes.append(f"{wet} of {values.size} voxels were limited to vapour at the total pressure")
        delta.fill(np.minimum(values, np.float32(ceiling)))
        span = (span[0], ceiling)
    return tuple(notes), span


def load(
    device: Device, cube: CubeFile, mean_g_m3: float, mean_k: float, precision: str, ceiling: float
) -> Field:
    """Returns a user's cube on the device, as departures from the scene's mean air."""
    if files.digest(cube.path, files.CUBE) != cube.digest:
        raise FileError(f"{cube.path}: has changed since the run was planned; run it again")
    humidity, temperature = cube_file.read(cube.path, cube.asked)
    relative, notes = _as_written(humidity.astype(np.float64) / mean_g_m3 - 1, 1.0), []
    if relative.max() > ceiling:
        wet = np.count_nonzero(relative > ceiling)
        notes.append(f"{wet} voxels were limited to vapour at the total pressure")
        np.minimum(relative, ceiling, out=relative)
    delta, span = _padded(device, relative, cube.lattice, precision)
    offset, temperature_span = None, (0.0, 0.0)
    if temperature is not None:
        warmth = _as_written(temperature.astype(np.float64) - mean_k, mean_k)
        offset, temperature_span = _padded(device, warmth, cube.lattice, precision)
    told = (*cube.notes, *notes)
    return Field(cube.lattice, delta, offset, span, temperature_span, told)


def _as_written(departure: Array, mean: float) -> Array:
    """Returns departures from a mean, those that are float32 but for rounding as that float32.

    A saved cube holds mean * (1 + delta), or mean + t, of float32 numbers in float64, so that these
    numbers come back to the bit.
    """
    single = departure.astype(np.float32).astype(np.float64)
    rounding = 4 * np.finfo(np.float64).eps * (mean + np.abs(departure))
    return np.where(np.abs(departure - single) <= rounding, single, departure)


def _padded(
    device: Device, departure: Array, lattice: Lattice, precision: str
) -> tuple[Buffer, Span]:
    """Returns departures on the device, padded to the lattice, and their span.

    The span of a bounded lattice includes 0, which is the air around it.
    """
    x, y, z = lattice.shape
    whole = departure
    if departure.shape != (z, y, x):
        whole = np.zeros((z, y, x))
        whole[lattice.held] = departure
    buffer = device.put(whole, precision)
    low, high = float(departure.min()), float(departure.max())
    return buffer, (min(low, 0.0), max(high, 0.0)) if lattice.bounded else (low, high)
