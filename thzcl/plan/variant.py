"""The graph of one variant, which makes its image and its error budget."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air import layers
from thzcl.air import weather as air_weather
from thzcl.air.expansion import ExpansionSpec, TrimmedSpec, possible
from thzcl.air.layers import Departures
from thzcl.air.mean import NOWHERE, Air, Span
from thzcl.air.radiometry import LIGHT_SPEED
from thzcl.air.weather import Weather
from thzcl.error.budget import ErrorSpec, LatticeErrorSpec, SamplingSpec
from thzcl.error.rays import FineWalkSpec, WalkSpec
from thzcl.errors import FileError, ScenarioError
from thzcl.graph import Spec, Values
from thzcl.plan import materials, numerics, sky, weather
from thzcl.plan.air import STILL, AnyAir, Moving, NonIsothermalAir, Setup, TurbulentAir, UniformAir
from thzcl.plan.compare import Rival, beside, in_planes, rivals
from thzcl.plan.cube import Source, cube_source
from thzcl.plan.numerics import Accuracy, Foreseen
from thzcl.plan.refused import air_refused, files_refused
from thzcl.plan.sampling import Sampling
from thzcl.scenario import sensors
from thzcl.scenario.atmosphere import NO_LOGNORMAL
from thzcl.scenario.document import Scenario, Variant, noise_seed
from thzcl.scenario.scene import Mesh, Scene
from thzcl.sensing import bands, optics
from thzcl.sensing.air_echo import AirEcho
from thzcl.sensing.exposures import Exposure
from thzcl.sensing.image import ComparedSpec, ImageSpec, NoiseKey
from thzcl.sensing.pixels import PixelsSpec, PlacesSpec, Steps, SumSpec
from thzcl.sensing.spectrum import Spectrum, Split, finer, spectrum
from thzcl.sensor import Needs, Optics, View
from thzcl.surfaces import camera, geometry, radiance
from thzcl.surfaces import sky as surfaces_sky
from thzcl.surfaces.camera import Raster
from thzcl.surfaces.estimate import SampledRays, sampled_rays
from thzcl.surfaces.geometry import GROUND, Geometry
from thzcl.surfaces.meshes import Placed, placed
from thzcl.surfaces.sky import Behind
from thzcl.turbulence.cube_file import CubeFile
from thzcl.turbulence.fields import (
    AnyField,
    CubeSpec,
    EvenSpec,
    FieldSpec,
    LargeScalesSpec,
    NotesSpec,
    ProfiledSpec,
    SavedCubeSpec,
)
from thzcl.turbulence.orientation import ROTATIONS

Array = NDArray[np.float64]
SCATTERED_K = 1e-3  # what weather adds to rays is left out where it is less everywhere
SCATTERED_RAYS = 48  # of which that is estimated
EVEN_STEPS = 400  # into which the longest ray is divided where the mean air changes by height
FINEST_STEP_M = 0.01


@dataclass(frozen=True)
class PlannedVariant:
    """The plan of one image. Two plans are equal if the same specs make them.

    `shape` are the rays of the camera and what they can meet, `cube` is the cube that they cross,
    or None. `rivals` are the models to compare with, those included that are valid nowhere.
    `longest_m` is about the length of the longest ray, `visible_m` that of a ray in mean air down
    to the cut-off depth.
    """

    name: str
    image: ImageSpec
    compared: tuple[ComparedSpec, ...]
    expansion: ExpansionSpec | TrimmedSpec
    errors: tuple[Spec, ...]
    notes: NotesSpec | None
    saved: SavedCubeSpec | None
    settled: Accuracy
    air: Air = field(compare=False)
    rivals: tuple[Rival, ...] = field(compare=False)
    scene: Scene = field(compare=False)
    needs: Needs = field(compare=False)
    shape: Geometry = field(compare=False)
    cube: AnyField | None = field(compare=False)
    orientation: str = field(compare=False)
    longest_m: float = field(compare=False)
    visible_m: float = field(compare=False)
    sample: SampledRays = field(compare=False)
    calm: str = field(compare=False)  # why no weather adds light to rays; empty if it does
    falling: tuple[Any, ...] = field(compare=False)  # what falls, as plan.weather.notes takes it
    meshes: dict[str, Placed] = field(compare=False)

    def specs(self) -> tuple[Spec | None, ...]:
        """Returns the specs that a run evaluates, in order, with None for those not needed."""
        every = *self.compared, *self.errors
        return self.notes, self.saved, self.expansion, self.image, *every

    def with_specs(self, specs: Sequence[Any]) -> PlannedVariant:
        """Returns the variant with other specs, in the order of specs()."""
        notes, saved, expansion, image, *others = specs
        made = {"notes": notes, "saved": saved, "expansion": expansion, "image": image}
        count = len(self.compared)
        compared, errors = tuple(others[:count]), tuple(others[count:])
        return replace(self, **made, compared=compared, errors=errors)


def plan_variant(scenario: Scenario, variant: Variant) -> PlannedVariant:
    """Returns the plan of one variant.

    Raises ScenarioError if a file cannot be used or a sensor cannot work with the scene, and
    PluginFailure if a sensor fails.
    """
    return _Planner(scenario, variant).planned()


class _Planner:
    """What is derived from a variant's scene, step by step, until its graph can be made."""

    def __init__(self, scenario: Scenario, variant: Variant) -> None:
        self.scenario, self.variant, self.scene = scenario, variant, variant.scene
        self.pixel_rad = camera.pixel_angles(self.scene.camera)
        plain = camera.raster(self.scene.camera)
        with files_refused(scenario):
            self.shape, self.surfaces = geometry.geometry(
                self.scene, scenario.locate, plain, scenario.targets
            )
            self.meshes = {
                name: placed(one, scenario.locate)
                for name, one in self.scene.targets.items()
                if isinstance(one, Mesh)
            }
            self.air: Air = self.scene.atmosphere.air.located(scenario.locate)
            others = self.scene.atmosphere.compared
            compared = {model: air.located(scenario.locate) for model, air in others.items()}
        self.mirrored_once = materials.follows(self.scene, self.surfaces)
        with air_refused(scenario, self.scene):
            self.air.refuse_beyond(None, NOWHERE, NOWHERE)
            self.needs = self._asked()
            self.spectrum: Spectrum = spectrum(self.needs)
            nodes = self.spectrum.nodes_hz.array
            self.air.refuse_beyond(nodes, NOWHERE, NOWHERE)
            self.air = self.air.without_nothing(nodes)
        self._refuse_above_layers()
        materials.refuse(scenario, self.scene, self.surfaces, self.needs, self.spectrum.nodes_hz)
        self.sources = self._sources(self.air)
        compared = {model: air.without_nothing(nodes) for model, air in compared.items()}
        self.rivals = rivals(compared, self.spectrum)
        asked = {one.air: self.spectrum.only(one.planes) for one in self.rivals if one.planes}
        with files_refused(scenario):
            self.cube_source = self._cube_source(self.air, self.spectrum)
            by_air = {air: self._cube_source(air, spectrum) for air, spectrum in asked.items()}
        self.cube_sources = {self.air: self.cube_source, **by_air}
        # That of the cube that is made, which the main model itself may not need.
        self.source = next((s for s, _ in self.cube_sources.values() if s is not None), None)
        blurred = self.needs.optics is not None and self.needs.optics.aperture_m is not None
        self.split = Split.of(self.spectrum, blurred=blurred)
        if self.needs.optics is not None:
            nodes = self.spectrum.nodes_hz.array
            self._refuse_no_beam(self.needs.optics, float(nodes.min()))
            two_way = self.needs.illumination == "beam"
            rays = optics.sampling(self.needs.optics, plain, self.pixel_rad, nodes, two_way=two_way)
            frame = Values.of(camera.camera_frame(self.scene.camera, rays))
            self.shape = replace(self.shape, raster=rays, frame=frame)
        if isinstance(self.sources, radiance.Emission):
            ceiling_m = self._ceiling_m(self.sources)
            things = replace(self.shape.things, ceiling_m=ceiling_m)
            self.shape = replace(self.shape, things=things)
        self.sample: SampledRays = sampled_rays(self.shape)
        self.targets = Values.of([s.target for s in self.surfaces], np.int32)
        self.foreseen = self._foreseen()
        bearable = self.scene.numerics.tolerance
        self.sampling = Sampling(
            self.needs, self.shape, self.pixel_rad, self.split.parts, self.foreseen, bearable
        )
        self.settled = numerics.settle(self.scene.numerics, self.needs, self.foreseen)

    def _refuse_no_beam(self, blurring: Optics, lowest_hz: float) -> None:
        """Raises ScenarioError for an aperture that is no wider than the longest wavelength."""
        wavelength_m = LIGHT_SPEED / lowest_hz
        if blurring.aperture_m is not None and blurring.aperture_m <= wavelength_m:
            found = (
                f"{blurring.aperture_m:g} m is no wider than the wavelength, {wavelength_m:.3g} m"
            )
            text = f"[sensor] optics.aperture_m: {found}, and makes no beam; widen it"
            raise ScenarioError([f"{self.scenario.name}: {text}"])

    def _ceiling_m(self, sources: radiance.Emission) -> float:
        """Returns the height at which rays that meet nothing leave the scene's air, m."""
        if isinstance(sources.behind, Behind):
            return sources.behind.ceiling_m
        return surfaces_sky.layer_top_m(self.air)

    def _refuse_above_layers(self) -> None:
        """Raises ScenarioError where camera or things stand above the top of a layer of the air."""
        meshes_top_m = max((one.high_m[2] for one in self.meshes.values()), default=-math.inf)
        highest_m = surfaces_sky.highest_m(self.scene, meshes_top_m)
        top_m = surfaces_sky.layer_top_m(self.air)
        if top_m <= highest_m:
            words = f"a layer of the air ends at {top_m:g} m, but the scene reaches {highest_m:g} m"
            remedy = "raise layer_top_m or bring the scene down"
            raise ScenarioError([f"{self.scenario.name}: [atmosphere]: {words}; {remedy}"])

    def _weather(self, air: Air, spectrum: Spectrum) -> Weather | None:
        """Returns what falls in some air, if it adds to what is seen of it."""
        if not isinstance(self.sources, radiance.Emission):
            return None
        if not air_weather.falls(air, spectrum.nodes_hz.array):
            return None
        law = self.surfaces[GROUND].mirror
        above = sky.above(self.scenario, self.scene, air, law)
        return surfaces_sky.weather_of(self.scene, air, above, law)

    def _most_scattered_k(self, air: Air, spectrum: Spectrum, falling: Weather) -> float:
        """Returns about the most that weather adds to any ray, K, in absolute value."""
        hz = spectrum.nodes_hz.array
        added = spectrum.planes(weather.added(falling, air, hz, self._some_rays()))
        unit = spectrum.planes(self.sources.per_unit(hz))
        return float((np.abs(added).max(axis=1) / unit).max())

    def _some_rays(self) -> weather.Rays:
        """Returns some of the camera's rays."""
        start_m = float(self.shape.frame.array[0, 2])
        rays = self.sample
        return weather.Rays.of(rays.direction, rays.length, start_m, SCATTERED_RAYS)

    def _falling(self, setup: Setup) -> tuple[Any, ...]:
        """Returns what falls, as plan.weather.notes takes it; nothing if nothing falls."""
        nodes = self.spectrum.nodes_hz.array
        if not air_weather.falls(self.air, nodes):
            return ()
        followed = setup.weather if setup.scattered else None
        return followed, self.air, nodes, self._some_rays()

    def _asked(self) -> Needs:
        """Returns what the sensor needs."""
        return sensors.ask_needs(sensors.make(self.scene.sensor.model_dump()), self._view())

    def _view(self) -> View:
        """Returns what a sensor may know of the scene."""
        lengths, air = sampled_rays(self.shape).length, self.air
        lines_hz, width_hz = air.lines()
        bearable = self.scene.numerics.tolerance
        return View(
            self.scene.camera.pixels,
            self.pixel_rad,
            air.temperature_k,
            (float(lengths.min()), float(lengths.max())),
            air.absorption,
            lines_hz,
            width_hz,
            lambda name: files.read_table(self.scenario.locate(name)),
            bands.TOLERANCE if bearable is None else numerics.BAND * bearable,
        )

    def _sources(self, air: Air) -> radiance.Sources:
        """Returns what surfaces send to the camera: their emission, or echoes of a transmitter.

        The sky that they and the camera see is made of `air`.
        """
        if self.needs.reflection:
            count = 2 if self.needs.transmitter_m is None else 1
            lambert = self.needs.gain == "lambert"
            return radiance.reflection(self.surfaces, count, lambert=lambert)
        above = sky.above(self.scenario, self.scene, air, self.surfaces[GROUND].mirror)
        through = air if self.mirrored_once else None
        return radiance.emission(self.scene, self.surfaces, above, through)

    def _cube_source(self, air: Air, spectrum: Spectrum) -> tuple[Source | None, str]:
        """Returns what the cube is made from, or None and why an air's rays cross no cube."""
        absorbs = air.varies or bool(air.absorption(spectrum.nodes_hz.array).any())
        emits = self.sources.air_emits
        return cube_source(self.scenario, self.scene, air, absorbs=absorbs, emits=emits)

    def _foreseen(self) -> Foreseen:
        """Returns a forecast of the image, by which numerical settings are chosen."""
        turn = ROTATIONS[self._orientation()]
        source = self.cube_source[0]
        random = None if isinstance(source, CubeFile) else source
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
        """Returns the cube's orientation: the scene's, or else that of the cube's file."""
        flow, source = self.scene.atmosphere.fluctuations, self.source
        if flow is None:
            return "aligned"
        if flow.grid_orientation is None and isinstance(source, CubeFile):
            return source.orientation
        return flow.orientation

    def _field(self) -> AnyField | None:
        """Returns the cube that rays cross, or None."""
        source, precision = self.source, self.settled.precision
        if source is None:
            return None
        most = self.air.most_vapour
        if isinstance(source, CubeFile):
            mean = self.air.absolute_humidity_g_m3, self.air.temperature_k
            return CubeSpec(source, *mean, most, precision)
        # A ceiling out of reach is left out, so that the cubes of two climates can be equal.
        reached = source.humidity_span()[1] > most
        cube = FieldSpec(source, most if reached else math.inf, precision)
        return self._with_large_scales(cube) if source.large_scales else cube

    def _with_large_scales(self, cube: FieldSpec) -> LargeScalesSpec:
        """Returns a cube with the eddies larger than it. Raises ScenarioError if lognormal."""
        if cube.turbulence.lognormal:
            text = f"[atmosphere.fluctuations] large_scales: {NO_LOGNORMAL}"
            raise ScenarioError([f"{self.scenario.name}: {text}"])
        place = ROTATIONS[self._orientation()] @ np.array(self.scene.camera.position_m)
        reach, flow = float(self.sample.length.max()), self.scene.atmosphere.fluctuations
        if self.needs.transmitter_m is not None:
            apart = np.array(self.needs.transmitter_m) - np.array(self.scene.camera.position_m)
            reach = max(reach, float(np.linalg.norm(apart)))
        if flow is not None and self.needs.times_s is not None:
            wind = float(np.linalg.norm(flow.wind_m_s))
            reach += wind * float(np.max(self.needs.times_s))
        x, y, z = place.tolist()
        return LargeScalesSpec(cube, (x, y, z), reach)

    def _layers(self) -> Departures | None:
        """Returns how the mean air changes by height, or None if it does not.

        Raises ScenarioError for a profile that does not reach all rays.
        """
        given, nodes = self.scene.atmosphere.profile, self.spectrum.nodes_hz.array
        absorbs = any(one.planes for one in self.rivals) or self.air.absorption(nodes).any()
        if given is None or not absorbs:
            return None
        with files_refused(self.scenario):
            path = self.scenario.locate(given.file)
            profile = layers.read(path)
            level = self.scene.camera.position_m[2]
            ends = level + self.sample.length * self.sample.direction[:, 2]
            others = [level] if self.needs.transmitter_m is None else [self.needs.transmitter_m[2]]
            lowest, highest = (float(f([*ends, level, *others])) for f in (min, max))
            low, high = profile.span_m
            if lowest < low or highest > high:
                first, last = profile.height_m.array[[0, -1]]
                rows = f"its rows reach from {first:g} to {last:g} m, and rays of the scene"
                text = f"{rows} from {lowest:.4g} to {highest:.4g} m; give rows for all of them"
                raise FileError(f"{path}: {text}")
            grams = self.air.absolute_humidity_g_m3
            if grams == 0:
                text = "its humidity cannot be measured by a scene's of 0; give a humidity above 0"
                raise FileError(f"{path}: {text}")
            return profile.departures(self.air.temperature_k, grams)

    def _crossed(self, cube: AnyField | None) -> AnyField | None:
        """Returns the voxels that rays cross, in which the mean air may change by height."""
        by_height = self._layers()
        if by_height is None:
            return cube
        if isinstance(cube, FieldSpec | CubeSpec):
            return ProfiledSpec(cube, by_height)
        edge = max(float(self.sample.length.max()) / EVEN_STEPS, FINEST_STEP_M)
        return ProfiledSpec(EvenSpec(edge, self.settled.precision), by_height)

    def _setup(self) -> Setup:
        """Returns what all rays of the variant have in common."""
        lambert = self.needs.gain == "lambert"
        return Setup(
            self.air,
            self.split.parts,
            self.sources,
            self.settled,
            self.scene.numerics.moments,
            self.needs.transmitter_m,
            lambert,
            lambert or self.needs.slant,
            self.targets,
            self.scene.camera.polarization_deg,
            *self._in(self.air, self.split.parts),
            self._echo(self.air, self.split.parts),
        )

    def _echo(self, air: Air, spectrum: Spectrum) -> AirEcho | None:
        """Returns what falls in some air and sends light back to the sensor's beam, or None."""
        beam, nodes = self.needs.path_return, spectrum.nodes_hz.array
        if beam is None or not any(np.any(k.backscatter) for k in air_weather.falling(air, nodes)):
            return None
        view = self.scene.camera
        aimed_m = math.dist(view.position_m, view.look_at_m)
        focused = replace(beam, focus_m=beam.focus_m or aimed_m)
        return AirEcho(air, focused, self.needs.gain == "lambert")

    def _echoed(self, setup: Setup, pixels: PixelsSpec) -> PixelsSpec | None:
        """Returns what the air sends back to pixels that see echoes of surfaces, or None.

        It hardly depends on where rays end: of a lattice that samples thin things it needs none.
        """
        if setup.echo is None:
            return None
        main = pixels.parts[0]
        rays = tuple(setup.echoed(one) for one in main.rays)
        return replace(pixels, parts=(replace(main, rays=rays),))

    def _calm(self, setup: Setup) -> str:
        """Returns why no weather adds light to rays, or nothing if it does."""
        if setup.scattered:
            return ""
        if not air_weather.falls(self.air, self.spectrum.nodes_hz.array):
            return "nothing falls through the air"
        if setup.echo is not None:
            return ""
        if setup.weather is None:
            return "active sensor: only echoes are seen"
        most = self._most_scattered_k(self.air, self.split.parts, setup.weather)
        return f"what falls adds at most {most:.1g} K to any ray"

    def _in(self, air: Air, spectrum: Spectrum) -> tuple[Weather | None, bool]:
        """Returns what falls in some air, and whether the light that it adds is followed."""
        falling = self._weather(air, spectrum)
        if falling is None:
            return None, False
        return falling, self._most_scattered_k(air, spectrum, falling) >= SCATTERED_K

    def _visible_m(self) -> float:
        """Returns the length of a ray in mean air down to the cut-off depth, m."""
        thinnest = float(self.foreseen.air.absorption.min())
        return self.settled.cutoff / thinnest if thinnest > 0 else math.inf

    def _air(self, setup: Setup, cube: AnyField | None) -> AnyAir:
        """Returns the kind of air that light goes through; it is asked for nowhere else."""
        flow = self.scene.atmosphere.fluctuations
        source, why = self.cube_sources[setup.air]
        by_height = isinstance(cube, ProfiledSpec)
        if cube is None or (source is None and not by_height):
            return UniformAir(setup, why)
        share = self.foreseen.share_traced(self.settled.stride)
        wind = STILL if flow is None or source is None else flow.wind_m_s
        where = self._orientation(), wind, self.sample, self._visible_m()
        moving = Moving(cube, *where, share)
        return TurbulentAir(setup, moving) if cube.isothermal else NonIsothermalAir(setup, moving)

    def _taken(self, air: AnyAir) -> list[Exposure]:
        """Returns the exposures in which rays cross some air, which the wind moves if uneven."""
        return self.sampling.exposures(STILL if isinstance(air, UniformAir) else air.cube.wind_m_s)

    def _parts(self, air: AnyAir, planes: tuple[int, ...]) -> tuple[SumSpec, ...]:
        """Returns the parts of what pixels see at some planes, the rays of each exposure first."""
        main = _sum(air, in_planes(self._taken(air), planes), self.shape.raster)
        fine, even = self._fine(air.setup, planes), _even(air.setup)
        if fine is None:
            return (main,)
        coarse = _sum(even, in_planes(self.sampling.still(), planes), self.shape.raster)
        return main, fine, _less(coarse)

    def _fine(self, setup: Setup, planes: tuple[int, ...], turn: int = 0) -> SumSpec | None:
        """Returns what pixels see of surfaces that a lattice samples, in even air, or None."""
        taken = in_planes(self.sampling.lattice(turn), planes)
        return _sum(_even(setup), taken, taken[0].geometry.raster) if taken else None

    def _compared(self, setup: Setup, cube: AnyField | None, one: Rival) -> ComparedSpec:
        """Returns what reaches the pixels by a model to compare with, at the planes it holds."""
        split, sources = self.split.only(one.planes), self._sources(one.air)
        falling, scattered = self._in(one.air, split.parts)
        its = replace(
            setup,
            air=one.air,
            spectrum=split.parts,
            sources=sources,
            weather=falling,
            scattered=scattered,
            echo=self._echo(one.air, split.parts),
        )
        air = self._air(its, cube)
        pixels = PixelsSpec(self._parts(air, self.split.parts_of(one.planes)), split, sources)
        spec = ComparedSpec(
            one.model,
            one.planes,
            pixels,
            self._places(setup),
            air.expansion,
            sources,
            split.whole,
            self.pixel_rad,
            self.needs.path_return is not None,
            self._echoed(its, pixels),
        )
        return beside(spec)

    def _places(self, setup: Setup) -> PlacesSpec:
        """Returns what the pixels show."""
        return PlacesSpec(setup.ends(self.shape), setup.out(self.shape), self.targets)

    def _image(self, setup: Setup, parts: tuple[SumSpec, ...]) -> ImageSpec:
        """Returns the image whose pixels see the sum of some parts."""
        passband, pixels = self.needs.passband, PixelsSpec(parts, self.split, self.sources)
        return ImageSpec(
            self.variant.name,
            pixels,
            self._places(setup),
            self.sources,
            self.spectrum,
            self.scene.sensor,
            self.pixel_rad,
            self.needs.integration_time_s,
            None if passband is None else (Values.of(passband[0]), Values.of(passband[1])),
            None if self.needs.bounds_hz is None else Values.of(self.needs.bounds_hz),
            NoiseKey(noise_seed(self.scene), self.variant.key),
            self.needs.noise,
            self.needs.path_return is not None,
            self._echoed(setup, pixels),
        )

    def planned(self) -> PlannedVariant:
        """Returns the plan of the variant."""
        cube, setup = self._field(), self._setup()
        crossed = self._crossed(cube)
        if crossed is not None:
            self._refuse_beyond(*crossed.spans())
            self.rivals = tuple(o.within(self.spectrum, *crossed.spans()) for o in self.rivals)
        air, every = self._air(setup, crossed), tuple(range(self.split.parts.count))
        parts = self._parts(air, every)
        errors = self._errors(air, parts[0])
        other = self._fine(setup, every, turn=1) if errors else None
        if other is not None:
            twin = air.twin(self.spectrum)
            errors = (*errors, LatticeErrorSpec(parts[1], other, twin, self.split))
        return PlannedVariant(
            self.variant.name,
            self._image(setup, parts),
            tuple(self._compared(setup, crossed, one) for one in self.rivals if one.planes),
            air.expansion,
            errors,
            None if cube is None else NotesSpec(cube),
            self._saved(cube),
            self.settled,
            self.air,
            self.rivals,
            self.scene,
            self.needs,
            self.shape,
            cube,
            self._orientation(),
            float(self.sample.length.max()),
            self._visible_m(),
            self.sample,
            self._calm(setup),
            self._falling(setup),
            self.meshes,
        )

    def _refuse_beyond(self, humidity_span: Span, temperature_span: Span) -> None:
        """Raises ScenarioError where a constituent does not hold what the air becomes."""
        spans = possible(self.air, humidity_span), temperature_span
        with air_refused(self.scenario, self.scene, fluctuating=True):
            self.air.refuse_beyond(self.spectrum.nodes_hz.array, *spans)

    def _saved(self, cube: AnyField | None) -> SavedCubeSpec | None:
        """Returns the cube to be stored, or None if there is none or the scene does not ask."""
        if cube is None or not self.scene.output.save_field:
            return None
        return SavedCubeSpec(cube, self.air)

    def _errors(self, air: AnyAir, main: SumSpec) -> tuple[Spec, ...]:
        """Returns the specs of the error budget, or none if the scene does not ask for it."""
        if not self.scene.numerics.error_budget:
            return ()
        setup, light, taken = air.setup, air.twin(self.spectrum), self._taken(air)
        number = _main(taken)
        shape, walked = taken[number].geometry, air.walked(taken[number])
        ends, out = setup.ends(shape), setup.out(shape)
        ways = 1 if out is None else 2
        count = air.budget_rays(ways * float(self.sample.length.mean()))
        segments = air.segments_a_ray(self._longest_way())
        walk = WalkSpec(
            walked, ends, out, self.targets, setup.lambert, count, self.scenario.seed, segments
        )
        resolved = finer(self.needs)
        twin = light if resolved is None else air.twin(resolved)
        error = ErrorSpec(main.rays[number], walk, air.expansion, light, twin, self.split)
        if self.needs.optics is not None:
            return (error,)
        fine = FineWalkSpec(
            walked, ends, setup.transmitter_m, setup.lambert, count, self.scenario.seed
        )
        steps = Steps(shape.raster.block, shape.raster.pixels)
        return error, SamplingSpec(main.rays[number], fine, air.expansion, light, steps)

    def _longest_way(self) -> float:
        """Returns the length of the longest ray or way from a transmitter, m."""
        longest = float(self.sample.length.max())
        if self.needs.transmitter_m is None:
            return longest
        hits = self.shape.frame.array[0] + self.sample.length[:, None] * self.sample.direction
        away = np.linalg.norm(hits - np.array(self.needs.transmitter_m), axis=1)
        return max(longest, float(away.max()))


def _even(setup: Setup) -> UniformAir:
    """Returns mean air, in which a lattice of rays samples surfaces."""
    return UniformAir(setup, "surfaces in mean air")


def _sum(air: AnyAir, taken: list[Exposure], raster: Raster) -> SumSpec:
    """Returns what pixels, which lie in a raster, see of the rays of some exposures."""
    rays = tuple(air.setup.gained(air.rays(one)) for one in taken)
    beams, owns = tuple(one.beam for one in taken), tuple(one.own for one in taken)
    return SumSpec(rays, beams, owns, Steps(raster.block, raster.pixels))


def _less(one: SumSpec) -> SumSpec:
    """Returns a sum whose contrast is subtracted, and whose depth does not count."""
    beams = tuple(replace(beam, scale=-beam.scale) for beam in one.beams)
    return replace(one, beams=beams, owns=tuple(replace(own, scale=0.0) for own in one.owns))


def _main(taken: list[Exposure]) -> int:
    """Returns the number of the exposure whose own rays weigh most in the pixels.

    Exposures that are not lines of a beam all weigh as much, and it is the first.
    """
    middle = len(taken) // 2
    if taken[middle].own.line is None:
        return 0
    return max(range(len(taken)), key=lambda number: float(taken[number].own.weights().sum()))
