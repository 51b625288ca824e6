"""Reports a plan in words and numbers: its stages, memory, voxel segments and warnings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from thzcl.air.expansion import Expansion, ExpansionSpec, TrimmedSpec, possible
from thzcl.air.mean import NOWHERE
from thzcl.air.refraction import Refraction, estimate, structure_constant_n
from thzcl.air.weather import falling
from thzcl.graph import LeftOut, Work, everything
from thzcl.paths.specs import TraceSpec
from thzcl.plan import materials, memory, sky, weather
from thzcl.plan.plan import Plan
from thzcl.plan.variant import PlannedVariant
from thzcl.surfaces.geometry import FIRST_TARGET, GROUND, KINDS
from thzcl.turbulence import cube_file
from thzcl.turbulence.fields import AnyField, CubeSpec, LargeScalesSpec
from thzcl.turbulence.spectra import beyond_table

STAGES = (
    "surrogate",
    "humidity-field",
    "temperature-field",
    "trace",
    "path-emission",
    *KINDS,
    "sky",
    "scattering",
    "outgoing-path",
    "optics",
    "noise",
)
ALL_HELD = 0.999  # of the rays' length: a cube that holds more needs no note
_FLUCTUATIONS = ("structure_constant_q", "sigma_percent", "outer_scale_m")


BEARABLE_FIT = 1e-4  # error of the absorption polynomial, beyond which there is a warning
MANY = 10  # realisations from which it counts that each is rescaled


@dataclass(frozen=True)
class Stage:
    """One stage of the computation: whether it is needed, and why or why not."""

    name: str
    needed: bool
    reason: str


def stages(plan: Plan, figure: bool = True) -> list[Stage]:
    """Returns every stage in order, with the reason why it is needed or left out."""
    found: dict[str, list[Work | LeftOut]] = {name: [] for name in STAGES}
    for spec in plan.specs():
        for name, words in spec.describe().items():
            found[name].append(words)
    found["scattering"] += [LeftOut(one.calm) for one in plan.variants if one.calm]
    drawn = Work("", "a picture of every variant") if figure else LeftOut("not asked for")
    found["figure"] = [drawn]
    return [_stage(plan, name, words) for name, words in found.items()]


def _stage(plan: Plan, name: str, words: list[Work | LeftOut]) -> Stage:
    """Returns one stage, made from the `words` of all specs that describe it."""
    done = [one for one in words if isinstance(one, Work)]
    if not done:
        return Stage(name, False, words[0].reason if isinstance(words[0], LeftOut) else "")
    if name == "surrogate":
        return Stage(name, True, _expansion(plan))
    if not done[0].noun:
        return Stage(name, True, done[0].detail)
    many = "" if plan.realizations == 1 else f", {plan.realizations} times"
    images = _count(len(plan.variants), "image")
    of = f" of {_count(moments(plan), 'moment')}" if name == "trace" else ""
    reason = f"{_count(len(done), done[0].noun)}{of} for {images}{done[0].detail}"
    return Stage(name, True, reason + (many if name == "humidity-field" else ""))


def _expansion(plan: Plan) -> str:
    """Returns the degree and the error of the expansion of absorption, in words."""
    airs = [spec.planned().air for spec in _expansions(plan)]
    names = ", ".join(dict.fromkeys(air.names for air in airs))
    fitted = f"{names} as polynomial of degree {moments(plan)} in humidity"
    return f"{fitted}, error at most {expansion_error(plan):.1e} of the mean absorption"


def _count(number: int, noun: str) -> str:
    """Returns a number with a noun, in the plural unless the number is 1."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def moments(plan: Plan) -> int:
    """Returns an upper bound of the number of path moments, before the cubes are made."""
    return max(spec.planned().moments for spec in _expansions(plan))


def expansion_error(plan: Plan) -> float:
    """Returns an upper bound of the expansions' error, relative to the mean air's absorption."""
    return max(spec.planned().error for spec in _expansions(plan))


def _expansions(plan: Plan) -> list[ExpansionSpec | TrimmedSpec]:
    """Returns the expansions of absorption of all variants, and of the models compared."""
    made = [(one.expansion, *(c.expansion for c in one.compared)) for one in plan.variants]
    return [expansion for row in made for expansion in row]


def _planned(variant: PlannedVariant) -> Expansion:
    """Returns a variant's expansion of absorption as far as it is known before the cube is made."""
    return variant.expansion.planned()


def voxel_segments(plan: Plan) -> int:
    """Returns about how many segments of positive length all rays have in voxels."""
    return round(sum(spec.segments() for spec in plan.specs()) * plan.realizations)


def warnings(plan: Plan, errors: Iterable[float]) -> list[str]:
    """Returns warnings about a plan's images.

    `errors` are those of the expansions, relative to the mean air's absorption: of each variant,
    its own and then those of the models to compare with.
    """
    found = list(plan.scenario.idle)
    found += [note for variant in plan.variants for note in _extrapolations(variant)]
    found += [note for variant in plan.variants for note in _left_out(variant)]
    found += [note for variant in plan.variants for note in variant.needs.notes]
    found += [*_periods(plan), *_continued(plan), *_idle_wind(plan)]
    found += [*_rescaled(plan), *_saved_without(plan)]
    found += [note for variant in plan.variants for note in _of_sky(variant)]
    found += weather.notes([(one.name, *one.falling) for one in plan.variants if one.falling])
    found += [note for variant in plan.variants for note in _of_materials(variant)]
    found += [note for variant in plan.variants for note in _unheard(variant)]
    meshes = [pair for variant in plan.variants for pair in variant.meshes.items()]
    found += [note for name, mesh in meshes for note in mesh.notes(name)]
    following = iter(errors)
    for variant in plan.variants:
        humidity = variant.scene.atmosphere.air.relative_humidity_percent
        if humidity > 100.5:
            of = f"mean humidity is {humidity:.4g} % of saturation"
            found.append(f"{variant.name}: {of}; clouds are not modelled")
        for model in ("", *(f' of "{one.model}"' for one in variant.compared)):
            error = next(following)
            if error > BEARABLE_FIT:
                by = f"the absorption polynomial{model} errs by up to {error:.1e}"
                found.append(f"{variant.name}: {by}; set a higher moments")
    return list(dict.fromkeys(found))


def _extrapolations(variant: PlannedVariant) -> list[str]:
    """Returns warnings of constituents that are asked for more than they are stated for."""
    humid, warm = (NOWHERE, NOWHERE) if variant.cube is None else variant.cube.spans()
    asked = [(variant.air, variant.image.spectrum)]
    airs = {rival.model: rival.air for rival in variant.rivals}
    asked += [(airs[one.model], one.spectrum) for one in variant.compared]
    notes = [
        air.notes(spectrum.nodes_hz.array, possible(air, humid), warm) for air, spectrum in asked
    ]
    return [note for some in notes for note in some]


def _left_out(variant: PlannedVariant) -> list[str]:
    """Returns what is told of models to compare with that are not valid for a variant."""
    notes = [rival.note(variant.image.spectrum.count) for rival in variant.rivals]
    return [f"{variant.name}: {note}" for note in notes if note is not None]


def _of_sky(variant: PlannedVariant) -> list[str]:
    """Returns notes on a sky that is given, or a warning where it lacks."""
    sources, nodes = variant.image.sources, variant.image.spectrum.nodes_hz.array
    lacking = sky.lacking(variant.scene, variant.air, sources, variant.sample, nodes)
    return sky.notes(variant.scene, sources, nodes) + lacking


def _of_materials(variant: PlannedVariant) -> list[str]:
    """Returns notes on what things are made of."""
    nodes = variant.image.spectrum.nodes_hz.array
    return materials.notes(variant.scene, variant.image.sources, nodes)


def made_of(plan: Plan) -> list[dict[str, object]]:
    """Returns the materials of each variant."""
    return [
        {"variant": variant.name, **row}
        for variant in plan.variants
        for row in materials.table(
            variant.scene, variant.image.sources, variant.image.spectrum.nodes_hz.array
        )
    ]


def _unheard(variant: PlannedVariant) -> list[str]:
    """Returns a note on what falls and would send light back, but is not asked to."""
    needs, nodes = variant.needs, variant.image.spectrum.nodes_hz.array
    if not needs.reflection or needs.path_return is not None:
        return []
    if not any(np.any(kind.backscatter) for kind in falling(variant.air, nodes)):
        return []
    lacks = "the echo of rain, fog and snow is not in the image, only what they take from it"
    return [f'{variant.name}: {lacks}; an active sensor with illumination = "beam" has it']


def mesh_tables(plan: Plan) -> list[dict[str, object]]:
    """Returns the meshes of each variant, with the box around each in the world, m."""
    return [
        {"variant": variant.name, "target": name, **mesh.table()}
        for variant in plan.variants
        for name, mesh in variant.meshes.items()
    ]


def skies(plan: Plan) -> list[dict[str, object]]:
    """Returns the sky by elevation of each variant that sees one."""
    found = []
    for variant in plan.variants:
        table = sky.table(variant.image.sources, variant.image.spectrum.nodes_hz.array)
        if table is not None:
            found.append({"variant": variant.name, **table})
    return found


def planned_errors(plan: Plan) -> list[float]:
    """Returns upper bounds of the errors of the expansions, as `warnings` takes them."""
    return [spec.planned().error for spec in _expansions(plan)]


def _periods(plan: Plan) -> list[str]:
    """Returns warnings of paths longer than a period of the cube, and notes on cubes' means."""
    longest: dict[AnyField, float] = {}
    notes = []
    for variant in plan.variants:
        if variant.cube is None:
            continue
        length = min(variant.longest_m, variant.visible_m)
        longest[variant.cube] = max(length, longest.get(variant.cube, 0.0))
        if isinstance(variant.cube, CubeSpec):
            note = cube_file.mean_note(variant.cube.cube, variant.cube.mean_g_m3)
            notes += [note] if note else []
            notes += _held(variant, variant.cube)
    found = []
    for cube, length in longest.items():
        period = cube.lattice.period_m
        if length > period:
            found.append(
                f"the longest path is {length / period:.2f} periods of the {period:g} m cube: "
                "averages along it vary less from ray to ray than in open air; a larger grid or "
                "voxel_m mends that"
            )
    return found + notes


def _held(variant: PlannedVariant, cube: CubeSpec) -> list[str]:
    """Returns a note on the part of rays that a bounded cube holds, if it does not hold all."""
    lattice, rays, how = cube.lattice, variant.sample, variant.orientation
    if not lattice.bounded:
        return []
    start = lattice.placed(lattice.turned(np.array(variant.scene.camera.position_m), how))
    step = lattice.turned(rays.direction, how)
    enter, leave = lattice.crossed(np.broadcast_to(start, step.shape), step, rays.length)
    part = float((leave - enter).sum() / rays.length.sum())
    if part > ALL_HELD:
        return []
    held = f"the cube holds {100 * part:.2g} % of the rays' length"
    return [f"{cube.cube.path}: {held}; the rest is the scene's mean air"]


def _rescaled(plan: Plan) -> list[str]:
    """Returns a note where each of many realisations is rescaled to one standard deviation."""
    random = [variant.cube.random for variant in plan.variants if variant.cube is not None]
    exact = any(one is not None and (one.exact or one.temperature_exact) for one in random)
    if plan.realizations < MANY or not exact:
        return []
    text = f"each of the {plan.realizations} realisations is rescaled to the standard deviation"
    return [f'{text} given, and lacks the scatter of open air; sigma_of = "ensemble" keeps it']


def _saved_without(plan: Plan) -> list[str]:
    """Returns a note where a cube is saved without the eddies larger than it."""
    cubes = [variant.cube for variant in plan.variants if variant.saved is not None]
    if not any(isinstance(cube, LargeScalesSpec) for cube in cubes):
        return []
    return ["the saved cube is without large_scales, which have no voxels"]


def _idle_wind(plan: Plan) -> list[str]:
    """Returns a note on wind that moves nothing, since all pixels are taken at once."""
    flows = [variant.scene.atmosphere.fluctuations for variant in plan.variants]
    blows = any(flow is not None and any(flow.wind_m_s) for flow in flows)
    if (
        not blows
        or plan.frames
        or any(variant.needs.times_s is not None for variant in plan.variants)
    ):
        return []
    how = 'a sensor that takes its pixels at times of their own, as kind = "raster-scan" does'
    return [f"wind_m_s moves nothing here; it is for {how}"]


def _continued(plan: Plan) -> list[str]:
    """Returns notes on measured spectra that do not reach all waves of their cubes."""
    random = [variant.cube.random for variant in plan.variants if variant.cube is not None]
    notes = [beyond_table(one) for one in dict.fromkeys(random) if one is not None]
    return [note for note in notes if note]


def numerics(variant: PlannedVariant) -> dict[str, object]:
    """Returns the numerical settings of a variant by name, whether given or chosen."""
    specs = everything([variant.image])
    path = next((spec for spec in specs if isinstance(spec, TraceSpec)), None)
    return {
        "variant": variant.name,
        "tolerance": variant.scene.numerics.tolerance,
        "precision": variant.settled.precision,
        "moments": _planned(variant).moments,
        "cutoff_depth": round(variant.settled.cutoff, 3),
        "bounces": int(variant.image.sources.bounces),
        "ray_stride": 1 if path is None else path.stride,
        "frequencies": variant.image.spectrum.nodes_hz.shape[0],
    }


def fluctuations(variant: PlannedVariant) -> dict[str, float | None]:
    """Returns how humidity fluctuates in a variant's cube, whichever of it the scene gives.

    That is C_q^2 in g^2 m^-6 m^(-2/3), the standard deviation in per cent of the mean, and the
    outer scale that the cube stands for, in m. In even air the first two are 0; what is not known
    (of a cube from a file, or of a measured spectrum) is None.
    """
    if variant.cube is None:
        return dict(zip(_FLUCTUATIONS, (0.0, 0.0, None), strict=True))
    random = variant.cube.random
    if random is None:
        return dict.fromkeys(_FLUCTUATIONS)
    constant, _ = random.structure_constants(variant.air.absolute_humidity_g_m3)
    values = constant, 100 * random.sigma, random.meant_outer_scale_m
    return dict(zip(_FLUCTUATIONS, values, strict=True))


def _looked_at_m(variant: PlannedVariant) -> float:
    """Returns the longest ray to a target, or else to the ground, or else of all, m."""
    rays = variant.sample
    for nearest in (FIRST_TARGET, GROUND):
        seen = rays.length[rays.surface >= nearest]
        if len(seen):
            return float(seen.max())
    return variant.longest_m


def refraction(plan: Plan) -> Refraction | None:
    """Returns the estimate of refraction for the variant in which it scintillates most.

    It is made for the longest path to what is looked at. Returns None if no variant's air
    fluctuates at random.
    """
    found = []
    for variant in plan.variants:
        random = None if variant.cube is None else variant.cube.random
        if random is None:
            continue
        air = variant.scene.atmosphere.air
        constants = random.structure_constants(air.absolute_humidity_g_m3)
        constant = structure_constant_n(air, *constants)
        aperture = variant.needs.optics.aperture_m if variant.needs.optics else None
        highest = float(variant.image.spectrum.nodes_hz.array.max())
        found.append(estimate(constant, highest, _looked_at_m(variant), aperture))
    return max(found, key=lambda one: one.scintillation_db, default=None)


def as_json(plan: Plan, figure: bool = True) -> dict[str, object]:
    """Returns the plan as `thzcl plan --format json` prints it."""
    left = refraction(plan)
    return {
        "scenario": plan.scenario.name,
        "stages": [
            {"name": s.name, "needed": s.needed, "reason": s.reason} for s in stages(plan, figure)
        ],
        "memory_bytes": memory.needed(plan)[0],
        "voxel_segments": voxel_segments(plan),
        "frequencies_ghz": [round(float(f) / 1e9, 9) for f in plan.frequency_hz],
        "moments": moments(plan),
        "surrogate_error": expansion_error(plan),
        "numerics": [numerics(variant) for variant in plan.variants],
        "air": fluctuations(plan.variants[0]),
        "airs": [{"variant": one.name, **fluctuations(one)} for one in plan.variants],
        "sky": skies(plan),
        "materials": made_of(plan),
        "meshes": mesh_tables(plan),
        "refraction_left_out": None if left is None else left._asdict(),
        "warnings": warnings(plan, planned_errors(plan)),
    }
