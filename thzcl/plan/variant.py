"""The graph of one variant: its image, and what is to be known of its errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air.expansion import ExpansionSpec, TrimmedSpec
from thzcl.air.mean import Air
from thzcl.air.mpm93 import REFUSED_ABOVE_GHZ, line_centers_ghz, line_width_ghz
from thzcl.error.budget import ErrorSpec, LatticeErrorSpec, SamplingSpec
from thzcl.error.rays import FineWalkSpec, WalkSpec
from thzcl.errors import FileError, ScenarioError
from thzcl.graph import Spec, Values
from thzcl.plan import numerics
from thzcl.plan.light import AnyAir, EvenAir, Moving, Setup, TurbulentAir, WarmAir
from thzcl.plan.numerics import Accuracy, Foreseen
from thzcl.scenario import sensors
from thzcl.scenario.document import Scenario, Variant
from thzcl.scenario.scene import Scene
from thzcl.sensing import bands, exposures, optics
from thzcl.sensing.exposures import Blur, Exposure
from thzcl.sensing.image import ImageSpec, NoiseKey
from thzcl.sensing.pixels import PixelsSpec, PlacesSpec, Steps, SumSpec
from thzcl.sensing.spectrum import Spectrum, finer, spectrum
from thzcl.sensor import Needs, View
from thzcl.surfaces import camera, geometry, radiance
from thzcl.surfaces.estimate import SampledRays, sampled_rays
from thzcl.surfaces.geometry import Geometry
from thzcl.turbulence import cube_file, spectrum_table
from thzcl.turbulence.fields import AnyField, CubeSpec, FieldSpec, NotesSpec, SavedCubeSpec
from thzcl.turbulence.orientation import ROTATIONS
from thzcl.turbulence.spectra import turbulence

Array = NDArray[np.float64]
FINER = 22  # lattice points to half of the finest detail that optics pass, each way
FEWEST_POINTS = 17  # of a lattice, in a cell
MOST_LATTICE_RAYS = 4_000_000
BEARABLE_DRIFT_K = 0.0075  # bound on what a scan's fast axis adds, where no tolerance is given
BEARABLE_DRIFT = 1e-3  # as a part of the largest echo


@dataclass(frozen=True)
class PlannedVariant:
    """One image, planned. Two are equal if the same specs make them.

    `longest_m` is about the longest ray's length, `visible_m` how far rays reach in mean air before
    the cut-off.
    """

    name: str
    image: ImageSpec
    expansion: ExpansionSpec | TrimmedSpec
    errors: tuple[Spec, ...]
    notes: NotesSpec | None
    saved: SavedCubeSpec | None
    settled: Accuracy
    scene: Scene = field(compare=False)
    needs: Needs = field(compare=False)
    shape: Geometry = field(compare=False)
    cube: AnyField | None = field(compare=False)
    orientation: str = field(compare=False)
    longest_m: float = field(compare=False)
    visible_m: float = field(compare=False)

    def specs(self) -> tuple[Spec | None, ...]:
        """Returns what a run wants of this variant, in the order in which it should be made."""
        return self.notes, self.saved, self.expansion, self.image, *self.errors

    def with_specs(self, specs: tuple[Any, ...]) -> PlannedVariant:
        """Returns the variant with other specs, in the same order."""
        notes, saved, expansion, image, *errors = specs
        made = {"notes": notes, "saved": saved, "expansion": expansion, "image": image}
        return replace(self, **made, errors=tuple(errors))


def plan_variant(scenario: Scenario, variant: Variant) -> PlannedVariant:
    """Returns the graph of one variant.

    Raises ScenarioError for files that cannot be used and for what a sensor cannot work with,
    PluginFailure where a sensor breaks.
    """
    return _Planner(scenario, variant).planned()


class _Planner:
    """One variant on its way from a scene to a graph."""

    def __init__(self, scenario: Scenario, variant: Variant) -> None:
        self.scenario, self.variant, self.scene = scenario, variant, variant.scene
        self.air: Air = self.scene.atmosphere.air
        self.pixel_rad = camera.pixel_angles(self.scene.camera)
        plain = camera.raster(self.scene.camera)
        try:
            self.shape, self.surfaces = geometry.geometry(self.scene, scenario.locate, plain)
            self.cube_source = self._cube_source()
        except (FileError, ValueError) as error:
            raise ScenarioError([f"{scenario.name}: {error}"]) from None
        self.needs = self._asked()
        self.spectrum: Spectrum = spectrum(self.needs)
        if self.needs.optics is not None:
            nodes = self.spectrum.nodes_hz.array
            rays = optics.sampling(self.needs.optics, plain, self.pixel_rad, nodes)
            frame = Values.of(camera.camera_frame(self.scene.camera, rays))
            self.shape = replace(self.shape, raster=rays, frame=frame)
        self.sample: SampledRays = sampled_rays(self.shape)
        self.sources = self._sources()
        self.targets = Values.of([s.target for s in self.surfaces], np.int32)
        self.foreseen = self._foreseen()
        self.settled = numerics.settle(self.scene.numerics, self.needs, self.foreseen)

    def _asked(self) -> Needs:
        """Returns what the sensor needs, once it has seen the view."""
        sensor = sensors.make(self.scene.sensor.model_dump())
        needs = sensors.ask_needs(sensor, self._view())
        highest = float(np.max(np.asarray(needs.frequency_hz))) / 1e9
        if highest > REFUSED_ABOVE_GHZ:
            text = f"asks for {highest:g} GHz; MPM93 ends at {REFUSED_ABOVE_GHZ:g} GHz"
            raise ScenarioError([f"{self.scenario.name}: [sensor] {text}"])
        return needs

    def _view(self) -> View:
        """Returns what a sensor may know of the scene."""
        lengths, air = sampled_rays(self.shape).length, self.air
        bearable = self.scene.numerics.tolerance
        return View(
            self.scene.camera.pixels,
            self.pixel_rad,
            air.temperature_k,
            (float(lengths.min()), float(lengths.max())),
            air.absorption,
            line_centers_ghz() * 1e9,
            line_width_ghz(air.pressure_hpa) * 1e9,
            lambda name: files.read_table(self.scenario.locate(name)),
            bands.TOLERANCE if bearable is None else numerics.BAND * bearable,
        )

    def _sources(self) -> radiance.Sources:
        if not self.needs.reflection:
            return radiance.emission(self.scene, self.surfaces)
        return radiance.reflection(self.surfaces, 2 if self.needs.transmitter_m is None else 1)

    def _cube_source(self) -> tuple[Any, str]:
        """Returns what makes the cube, or None and why there is none."""
        flow, air = self.scene.atmosphere.fluctuations, self.air
        if air.model == "none":
            return None, "air absorbs nothing: no field, no FFT"
        if flow is None:
            return None, "no [atmosphere.fluctuations]: no field, no FFT"
        if flow.spectrum == "file":
            cube = cube_file.inspect(self.scenario.folder / flow.file, flow.voxel_m)
            cube_file.refuse_zero_mean(cube, air.absolute_humidity_g_m3)
            return cube, ""
        table = None
        if flow.file is not None:
            table = spectrum_table.read(self.scenario.locate(flow.file))
        drawn = turbulence(self.scene.atmosphere, table)
        moist = drawn.sigma > 0 and air.absolute_humidity_g_m3 > 0
        if not (drawn.temperature_fluctuates or moist):
            return None, "fluctuations of size 0, or dry air: no field, no FFT"
        return drawn, ""

    def _foreseen(self) -> Foreseen:
        turn = ROTATIONS[self._orientation()]
        drawn = self.cube_source[0]
        random = None if isinstance(drawn, cube_file.CubeFile) else drawn
        block = reversed(self.shape.raster.block)
        apart = max(angle / n for angle, n in zip(self.pixel_rad, block, strict=True))
        return Foreseen(
            self.sources,
            self.spectrum,
            self.sample,
            numerics.air_along(self.air, self.spectrum, random, turn),
            self.shape.raster,
            apart,
            self.targets.array,
        )

    def _orientation(self) -> str:
        """Returns how the cube lies: as the scene says, or else as a file of its own does."""
        flow, source = self.scene.atmosphere.fluctuations, self.cube_source[0]
        if flow is None:
            return "aligned"
        if flow.grid_orientation is None and isinstance(source, cube_file.CubeFile):
            return source.orientation
        return flow.orientation

    def _field(self) -> AnyField | None:
        """Returns the cube that rays cross."""
        source, precision = self.cube_source[0], self.settled.precision
        if source is None:
            return None
        most = self.air.most_vapour
        if isinstance(source, cube_file.CubeFile):
            mean = self.air.absolute_humidity_g_m3, self.air.temperature_k
            return CubeSpec(source, *mean, most, precision)
        # Only where the ceiling is within reach does it tell apart the cubes of two climates.
        bites = source.humidity_span()[1] > most
        return FieldSpec(source, most if bites else math.inf, precision)

    def _setup(self) -> Setup:
        lambert = self.needs.gain == "lambert"
        return Setup(
            self.air,
            self.spectrum,
            self.sources,
            self.settled,
            self.scene.numerics.moments,
            self.needs.transmitter_m,
            lambert,
            lambert or self.needs.slant,
            self.targets,
        )

    def _visible_m(self) -> float:
        """Returns how far rays reach in mean air before the cut-off depth."""
        thinnest = float(self.foreseen.air.absorption.min())
        return self.settled.cutoff / thinnest if thinnest > 0 else math.inf

    def _air(self, setup: Setup, cube: AnyField | None) -> AnyAir:
        """Returns the air that light goes through: the one place where that is asked."""
        flow = self.scene.atmosphere.fluctuations
        if cube is None or flow is None:
            return EvenAir(setup, self.cube_source[1])
        share = self.foreseen.share_traced(self.settled.stride)
        wind = flow.wind_m_s
        where = self._orientation(), wind, self.sample, self._visible_m()
        moving = Moving(cube, *where, share)
        return TurbulentAir(setup, moving) if cube.isothermal else WarmAir(setup, moving)

    def _blur(self) -> Blur:
        plane_hz = Values.of(self.spectrum.planes(self.spectrum.nodes_hz.array))
        return Blur(self.needs.optics, self.pixel_rad, plane_hz)

    def _exposures(self, blur: Blur, cube: AnyField | None) -> list[Exposure]:
        """Returns the exposures that trace the air."""
        flow = self.scene.atmosphere.fluctuations
        moves = flow is not None and cube is not None and any(flow.wind_m_s)
        if self.needs.times_s is None or not moves:
            return exposures.still(blur, self.shape)
        times = np.asarray(self.needs.times_s, dtype=np.float64)
        groups = self._groups(blur, times, math.hypot(*flow.wind_m_s))
        return exposures.timed(blur, self.shape, times, groups)

    def _groups(self, blur: Blur, times_s: Array, wind_m_s: float) -> int:
        """Returns into how many parts a beam is cut along a scan's fast axis.

        There are as few as keep what the air drifts, while the scan crosses one, from mattering.
        """
        rays = self.shape.raster
        sample = np.broadcast_to(times_s[0], rays.pixels)
        if rays.margin == 0 or np.ptp(sample) == 0:
            return 1
        slow = exposures.slow_axis(sample)
        weights = exposures.profile(blur.beam(rays), slow)
        apart = np.abs(np.diff(sample, axis=1 - slow))
        dwell = float(np.median(apart)) if apart.size else 0.0
        drift_m = wind_m_s * dwell / rays.block[1 - slow]  # while the scan crosses one ray
        lost = [
            self.foreseen.drift_error_k(drift_m * n)
            for n in range(min(len(weights), rays.pixels[1 - slow] * rays.block[1 - slow]) + 1)
        ]
        for groups in range(1, len(weights), 2):
            if exposures.fast_axis_error(weights, groups, lost) <= self._bearable_drift():
                return groups
        return len(weights)

    def _bearable_drift(self) -> float:
        """Returns the bearable error of a scan's fast axis, in K or as a part of the power."""
        unit = self.spectrum.planes(self.sources.per_unit(self.spectrum.nodes_hz.array))
        largest = float((self.foreseen.contrast() / unit).max())
        tolerance = self.scene.numerics.tolerance
        if tolerance is not None:
            return tolerance * largest
        return BEARABLE_DRIFT_K if self.sources.air_emits else BEARABLE_DRIFT * largest

    def _lattice(self) -> tuple[int, int]:
        """Returns how surfaces are sampled under optics: rays to a cell each way, and points in it.

        There are no points where nothing is blurred.
        """
        blurring, rays = self.needs.optics, self.shape.raster
        if blurring is None or not optics.blurs(blurring) or not self.shape.things.kinds:
            return 1, 0
        detail = optics.finest_rad(blurring, self.spectrum.nodes_hz.array) / FINER
        density = math.prod(self.pixel_rad) / math.prod(rays.block) / detail**2  # points to a ray
        density = min(density, MOST_LATTICE_RAYS / rays.rays)
        common = math.gcd(*rays.block)
        cells = [n for n in range(1, common + 1) if common % n == 0]
        cell = next((n for n in cells if density * n**2 >= FEWEST_POINTS), common)
        wanted = density * cell**2
        points = min((n for n in exposures.PRIMES if n >= wanted), default=exposures.PRIMES[-1])
        return cell, points

    def planned(self) -> PlannedVariant:
        """Returns the variant's graph."""
        cube, blur = self._field(), self._blur()
        setup = self._setup()
        air, even = self._air(setup, cube), EvenAir(setup, "surfaces in mean air")
        steps = Steps(self.shape.raster.block, self.shape.raster.pixels)
        taken = self._exposures(blur, cube)
        main = _sum(setup, air, taken, steps)
        cell, points = self._lattice()
        parts, lattice = [main], None
        if points:
            fine = exposures.lattice(blur, self.shape, cell, points)
            lattice = _sum(setup, even, fine, Steps(fine[0].geometry.raster.block, steps.pixels))
            parts += [lattice, _less(_sum(setup, even, exposures.still(blur, self.shape), steps))]
        places = PlacesSpec(setup.ends(self.shape), setup.out(self.shape), self.targets)
        image = ImageSpec(
            self.variant.name,
            PixelsSpec(tuple(parts)),
            places,
            self.sources,
            self.spectrum,
            self.scene.sensor,
            math.prod(self.pixel_rad),
            NoiseKey(self.scenario.seed, self.variant.key),
            self.needs.noise,
        )
        errors = self._errors(air, taken, main)
        if lattice is not None and errors:
            again = exposures.lattice(blur, self.shape, cell, points, turn=1)
            other = _sum(setup, even, again, lattice.steps)
            light = air.twin(self.spectrum)
            errors = (*errors, LatticeErrorSpec(lattice, other, light))
        return PlannedVariant(
            self.variant.name,
            image,
            air.expansion,
            errors,
            None if cube is None else NotesSpec(cube),
            self._saved(cube),
            self.settled,
            self.scene,
            self.needs,
            self.shape,
            cube,
            self._orientation(),
            float(self.sample.length.max()),
            self._visible_m(),
        )

    def _saved(self, cube: AnyField | None) -> SavedCubeSpec | None:
        wanted = self.scene.output.save_field and cube is not None
        return SavedCubeSpec(cube, self.air) if wanted else None

    def _errors(self, air: AnyAir, taken: list[Exposure], main: SumSpec) -> tuple[Spec, ...]:
        """Returns the specs of the error budget, where it is wanted."""
        if not self.scene.numerics.error_budget:
            return ()
        setup, light = air.setup, air.twin(self.spectrum)
        number = _main(taken)
        shape, walked = taken[number].geometry, air.walked(taken[number])
        ends, out = setup.ends(shape), setup.out(shape)
        ways = 1 if out is None else 2
        count = air.budget_rays(ways * float(self.sample.length.mean()))
        segments = air.segments_a_ray(self._longest_way())
        walk = WalkSpec(walked, ends, out, self.targets, count, self.scenario.seed, segments)
        resolved = finer(self.needs)
        twin = light if resolved is None else air.twin(resolved)
        found: list[Spec] = [ErrorSpec(air.rays(taken[number]), walk, air.expansion, light, twin)]
        if self.needs.optics is None:
            fine = FineWalkSpec(walked, ends, out, setup.lambert, count, self.scenario.seed)
            steps = Steps(shape.raster.block, shape.raster.pixels)
            rays = main.rays[number]
            found.append(SamplingSpec(rays, fine, air.expansion, light, steps))
        return tuple(found)

    def _longest_way(self) -> float:
        """Returns the length of the longest ray, or of the longest way from a transmitter, m."""
        longest = float(self.sample.length.max())
        if self.needs.transmitter_m is None:
            return longest
        hits = self.shape.frame.array[0] + self.sample.length[:, None] * self.sample.direction
        away = np.linalg.norm(hits - np.array(self.needs.transmitter_m), axis=1)
        return max(longest, float(away.max()))


def _sum(setup: Setup, air: AnyAir, taken: list[Exposure], steps: Steps) -> SumSpec:
    """Returns what pixels see of some exposures."""
    rays = tuple(setup.gained(air.rays(one)) for one in taken)
    beams, owns = tuple(one.beam for one in taken), tuple(one.own for one in taken)
    return SumSpec(rays, beams, owns, steps)


def _less(one: SumSpec) -> SumSpec:
    """Returns the contrast that is to be taken off."""
    beams = tuple(replace(beam, scale=-beam.scale) for beam in one.beams)
    return replace(one, beams=beams, owns=tuple(replace(own, scale=0.0) for own in one.owns))


def _main(taken: list[Exposure]) -> int:
    """Returns the number of the exposure whose own rays weigh most, of lines the middle one."""
    middle = len(taken) // 2
    if taken[middle].own.line is None:
        return 0
    return max(range(len(taken)), key=lambda number: float(taken[number].own.weights().sum()))
