"""The cubes that rays cross, as specs: a realisation of random air, or a cube from a file."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air.layers import Departures
from thzcl.air.mean import Air
from thzcl.device.opencl import Device
from thzcl.graph import LeftOut, Memory, Spec, Work, frozen
from thzcl.turbulence import large_scales
from thzcl.turbulence.cube import Field, Span, generate, load
from thzcl.turbulence.cube_file import CubeFile
from thzcl.turbulence.lattice import Lattice
from thzcl.turbulence.spectra import KOLMOGOROV, Turbulence

SEED_STEP = 0x9E3779B97F4A7C15  # 2^64 over the golden ratio: neighbours share no realisation
EVEN_GRID = 16  # voxels along an edge of a cube of even air
BY_HEIGHT = "mean temperature changes by height"
ONE_TEMPERATURE = LeftOut("air temperature does not fluctuate")
WARM = Work("", "temperature fluctuates too")


@frozen
class FieldSpec(Spec):
    """One realisation of the fluctuations on the periodic cube."""

    turbulence: Turbulence
    ceiling: float  # the largest delta that the pressure admits; infinite where out of reach
    precision: str
    library: str | None = None  # of the Fourier transform; None: the device's usual one
    stage = "humidity-field"

    @property
    def grid(self) -> int:
        """Returns the voxels along an edge."""
        return self.turbulence.grid

    @property
    def voxel_m(self) -> float:
        """Returns the edge of a voxel."""
        return self.turbulence.voxel_m

    @property
    def lattice(self) -> Lattice:
        """Returns the voxels of the cube."""
        return self.turbulence.lattice

    @property
    def isothermal(self) -> bool:
        """Returns whether the cube has one temperature."""
        return not self.turbulence.temperature_fluctuates

    @property
    def random(self) -> Turbulence | None:
        """Returns the statistics of air that is drawn at random."""
        return self.turbulence

    def spans(self) -> tuple[Span, Span]:
        """Returns ranges of delta and of temperature's departure left with probability 1e-6."""
        return self.turbulence.humidity_span(), self.turbulence.temperature_span()

    def realization(self, number: int) -> FieldSpec:
        """Returns the cube of another realisation; number 0 is this one."""
        seed = (self.turbulence.seed + number * SEED_STEP) % 2**63
        return replace(self, turbulence=replace(self.turbulence, seed=seed))

    def run(self, device: Device) -> Field:
        """Returns the cube on the device."""
        return generate(device, self.turbulence, self.precision, self.ceiling, self.library)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that there is a cube, and whether it has a temperature of its own."""
        larger = ", with eddies larger than the cube in closed form"
        cube = (
            Work("cube", larger if self.turbulence.large_scales else ""),
            ONE_TEMPERATURE if self.isothermal else WARM,
        )
        return dict(zip(("humidity-field", "temperature-field"), cube, strict=True))

    def memory(self) -> Memory:
        """Returns the cube's, and that of spectrum and transform while it is made."""
        voxels, real = self.grid**3, np.dtype(self.precision).itemsize
        made = (4 * voxels,) * 3 if self.isothermal else (8 * voxels,) * 2
        return Memory((real * voxels,) * (1 if self.isothermal else 2), made)


@frozen
class CubeSpec(Spec):
    """A cube from a file, as departures from the scene's mean air."""

    cube: CubeFile
    mean_g_m3: float
    mean_k: float
    ceiling: float  # the largest delta that the pressure admits
    precision: str
    stage = "humidity-field"

    @property
    def lattice(self) -> Lattice:
        """Returns the voxels of the cube."""
        return self.cube.lattice

    @property
    def isothermal(self) -> bool:
        """Returns whether the cube has one temperature."""
        return self.cube.temperature_span_k is None

    @property
    def random(self) -> Turbulence | None:
        """Returns None: nothing is drawn at random."""
        return None

    def spans(self) -> tuple[Span, Span]:
        """Returns ranges of delta and of temperature's departure from the mean, K."""
        low, high = (value / self.mean_g_m3 - 1 for value in self.cube.humidity_span_g_m3)
        coldest, warmest = self.cube.temperature_span_k or (self.mean_k, self.mean_k)
        cold, warm = coldest - self.mean_k, warmest - self.mean_k
        if not self.lattice.bounded:
            return (low, high), (cold, warm)
        return (min(low, 0.0), max(high, 0.0)), (min(cold, 0.0), max(warm, 0.0))

    def realization(self, number: int) -> CubeSpec:
        """Returns this cube: there is no other."""
        del number
        return self

    def run(self, device: Device) -> Field:
        """Returns the cube on the device."""
        mean = self.mean_g_m3, self.mean_k
        return load(device, self.cube, *mean, self.precision, self.ceiling)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that there is a cube, and whether it has a temperature of its own."""
        cube = Work("cube"), ONE_TEMPERATURE if self.isothermal else WARM
        return dict(zip(("humidity-field", "temperature-field"), cube, strict=True))

    def memory(self) -> Memory:
        """Returns the cube's, and that of the file's numbers in float64."""
        voxels, real = self.lattice.voxels, np.dtype(self.precision).itemsize
        count = 1 if self.isothermal else 2
        return Memory((real * voxels,) * count, (8 * voxels,) * count)


@frozen
class LargeScalesSpec(Spec):
    """A random cube with the eddies that are larger than it, as rays near a place see them.

    `place_m` is along the cube's axes. In air without an outer scale, where only differences are
    defined, the eddies are 0 there. Rays go no farther from it than `reach_m`.
    """

    cube: FieldSpec
    place_m: tuple[float, float, float]
    reach_m: float
    reads = ("cube",)
    stage = "humidity-field"

    @property
    def precision(self) -> str:
        """Returns the arithmetic of the cube."""
        return self.cube.precision

    @property
    def lattice(self) -> Lattice:
        """Returns the voxels of the cube."""
        return self.cube.lattice

    @property
    def isothermal(self) -> bool:
        """Returns true: large eddies have no temperature."""
        return True

    @property
    def random(self) -> Turbulence | None:
        """Returns the statistics of the air."""
        return self.cube.random

    def spans(self) -> tuple[Span, Span]:
        """Returns ranges of delta and of temperature's departure left with probability 1e-6."""
        air = self.cube.turbulence
        reach = None if air.outer_scale_m is not None else self.reach_m
        large = air.sigma * math.sqrt(air.large_variance(reach) / air.unit_variance)
        return air.humidity_span(large), air.temperature_span()

    def run(self, device: Device, cube: Field) -> Field:
        """Returns the cube with its waves, its span widened by theirs."""
        del device
        air, place = self.cube.turbulence, np.array(self.place_m)
        strength = KOLMOGOROV * cube.strength**2
        waves = large_scales.drawn(air.period_m, air.outer_scale_m, strength, air.seed)
        if air.outer_scale_m is None:
            waves = waves.less(place)
        low, high = waves.span(place, self.reach_m)
        span = cube.humidity_span[0] + low, cube.humidity_span[1] + high
        notes = cube.notes
        if span[0] < -1:
            dry = float(np.mean(cube.delta.host() < -1 - low))
            part = f"with large_scales up to {100 * dry:.2g} % of the voxels hold less than no"
            remedy = "lower sigma_percent or structure_constant_q"
            notes = *notes, f"{part} vapour where the air is driest; {remedy}"
        return replace(cube, waves=waves, humidity_span=span, notes=notes)


@frozen
class EvenSpec(Spec):
    """Voxels of mean air, through which rays go where only the mean air changes, by height."""

    edge_m: float
    precision: str
    stage = "temperature-field"

    @property
    def lattice(self) -> Lattice:
        """Returns the voxels."""
        return Lattice.cubic(EVEN_GRID, self.edge_m)

    @property
    def random(self) -> None:
        """Returns None: nothing is drawn at random."""
        return

    def spans(self) -> tuple[Span, Span]:
        """Returns that nothing departs from the mean."""
        return (0.0, 0.0), (0.0, 0.0)

    def run(self, device: Device) -> Field:
        """Returns the voxels on the device."""
        delta = device.put(np.zeros(self.lattice.shape), self.precision)
        return Field(self.lattice, delta, None, (0.0, 0.0), (0.0, 0.0), ())

    def memory(self) -> Memory:
        """Returns the size of the voxels."""
        return Memory((np.dtype(self.precision).itemsize * self.lattice.voxels,))


@frozen
class ProfiledSpec(Spec):
    """Air whose mean changes by height, with the fluctuations of a cube or even voxels in it.

    Humidity departs by (1 + delta)(1 + D) - 1, D being the profile's departure, and temperature by
    the sum of the two.
    """

    cube: FieldSpec | CubeSpec | EvenSpec
    layers: Departures
    reads = ("cube",)
    stage = "temperature-field"

    @property
    def precision(self) -> str:
        """Returns the arithmetic of the cube."""
        return self.cube.precision

    @property
    def lattice(self) -> Lattice:
        """Returns the voxels of the cube."""
        return self.cube.lattice

    @property
    def isothermal(self) -> bool:
        """Returns false: temperature changes by height."""
        return False

    @property
    def random(self) -> Turbulence | None:
        """Returns the statistics of air that is drawn at random."""
        return self.cube.random

    def spans(self) -> tuple[Span, Span]:
        """Returns ranges of delta and of temperature's departure from the mean, K."""
        return _widened(*self.cube.spans(), self.layers)

    def run(self, device: Device, cube: Field) -> Field:
        """Returns the cube with the profile, and its spans widened by that."""
        del device
        moist, warm = _widened(cube.humidity_span, cube.temperature_span, self.layers)
        return replace(cube, layers=self.layers, humidity_span=moist, temperature_span=warm)

    def describe(self) -> dict[str, Work | LeftOut]:
        """Returns that the mean air changes by height."""
        found: dict[str, Work | LeftOut] = {"temperature-field": Work("", BY_HEIGHT)}
        if isinstance(self.cube, EvenSpec):
            found["humidity-field"] = LeftOut("no [atmosphere.fluctuations]: no field, no FFT")
        return found


def _widened(humidity: Span, temperature: Span, layers: Departures) -> tuple[Span, Span]:
    """Returns spans with the departures of a profile."""
    moister, warmer = layers.spans
    products = [(1 + a) * (1 + b) - 1 for a in humidity for b in moister]
    cold, warm = temperature[0] + warmer[0], temperature[1] + warmer[1]
    return (min(products), max(products)), (cold, warm)


AnyField = FieldSpec | CubeSpec | LargeScalesSpec | ProfiledSpec


@frozen
class NotesSpec(Spec):
    """What is to be told of a cube that was made."""

    field: AnyField
    reads = ("field",)
    stage = "humidity-field"

    def run(self, device: Device, field: Field) -> tuple[str, ...]:
        """Returns notes on values that had to be limited."""
        del device
        return field.notes


class SavedCube(NamedTuple):
    """A cube to be stored, (z, y, x): absolute humidity in g/m3, temperature in K or None.

    They are in float64, from which the departures on the device come back to the bit.
    """

    humidity: NDArray[np.float64]
    temperature: NDArray[np.float64] | None
    lattice: Lattice


@frozen
class SavedCubeSpec(Spec):
    """A cube in the units of one mean air."""

    field: AnyField
    air: Air
    reads = ("field",)
    stage = "humidity-field"

    def run(self, device: Device, field: Field) -> SavedCube:
        """Returns the cube on the host."""
        del device
        held = field.lattice.held
        relative = 1 + field.delta.host()[held].astype(np.float64)
        humidity = self.air.absolute_humidity_g_m3 * relative
        if field.offset is None:
            return SavedCube(humidity, None, field.lattice)
        warmth = self.air.temperature_k + field.offset.host()[held].astype(np.float64)
        return SavedCube(humidity, warmth, field.lattice)
