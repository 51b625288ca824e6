"""The pipeline from a scenario to its images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from thzcl import metrics
from thzcl.air.expansion import Expansion
from thzcl.clock import Clock, Progress
from thzcl.error.budget import Part, worst
from thzcl.errors import NumbersError, ScenarioError
from thzcl.graph import Held, Spec, evaluate, everything, peak
from thzcl.paths.specs import EmissionSpec, TraceSpec, served
from thzcl.plan import checks, report
from thzcl.plan.plan import Plan, make_plan
from thzcl.plan.variant import PlannedVariant
from thzcl.results import result as results
from thzcl.results import spread
from thzcl.results.conditions import angles, conditions
from thzcl.results.contents import Cube, ModelResult, VariantResult
from thzcl.results.versions import versions
from thzcl.scenario import document as documents
from thzcl.scenario.source import Scene
from thzcl.sensing.image import Compared, Recorded
from thzcl.turbulence.fields import AnyField, SavedCube
from thzcl.turbulence.orientation import ROTATIONS

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

COSTLY = (TraceSpec, EmissionSpec, *get_args(AnyField))  # what a result keeps for with_settings
HELD_SHARE = 0.25  # of the device's memory, that all results together may keep for that
USUAL_TOLERANCE = 1e-3  # error relative to the contrast that no scene needs to bear unsaid


@dataclass(frozen=True)
class Kept:
    """What a run leaves for others with other settings: its device, and what it traced there."""

    device: Device
    held: Held | None
    allow_outside: bool


@dataclass(frozen=True, repr=False)
class Result(results.Result):
    """The result of a run, from which others with other settings can be made."""

    kept: Kept | None = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """Returns the fields without what lies on a device: a copy traces anew."""
        return {**self.__dict__, "kept": None}

    def with_settings(
        self,
        settings: Mapping[str, Any],
        *,
        variants: Sequence[str] = (),
        figure: bool = True,
        progress: Progress | None = None,
    ) -> Result:
        """Returns the images of the same scene and air with other settings, as thzcl.run has them.

        Another frequency, absorption model, sensor, noise or surface temperature needs no new
        trace, nor does anything else that leaves rays and cube as they are; what does is traced
        anew, and `warnings` then say so and why. So is a result that was loaded, copied, made with
        keep = False or averaged over realizations. None takes a key away. `variants` picks some by
        name; by default they are those of this result. Raises what thzcl.run raises.

        >>> import thzcl
        >>> result = thzcl.run("quick", settings={"camera.pixels": [4, 3]})
        >>> result.with_settings({"sensor.frequency_ghz": 340}).variants[0].sight.frequency_hz
        array([3.4e+11])
        """
        return _again(self, settings, variants, figure=figure, progress=progress)


def prepare(
    source: documents.Source,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    *,
    allow_outside: bool = False,
    seed: int | None = None,
) -> Plan:
    """Returns the plan of a scenario, which is read and checked.

    `source`, `settings`, `variants` and `allow_outside` are those of `run`; `seed` is that of
    fluctuations which name none, in place of one that is drawn. Raises ScenarioError with every
    problem at once, or PluginFailure if a sensor fails.
    """
    document = documents.read(source, settings, seed)
    names = documents.chosen(variants)
    parsed = documents.parse(document, names, allow_outside=allow_outside)
    plan = make_plan(parsed)
    checks.together(document, plan)
    return plan


def run(
    source: documents.Source,
    *,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | Device | None = None,
    figure: bool = True,
    allow_outside: bool = False,
    progress: Progress | None = None,
    keep: bool = True,
) -> Result:
    """Returns the images of a scenario: a TOML file, a result, or the name of a shipped scene.

    It may also be the tables of a scene themselves, or a thzcl.Scene:

    >>> import thzcl
    >>> few = {"camera.pixels": [4, 3], "atmosphere.fluctuations.grid": 16}
    >>> result = thzcl.run("quick", settings=few)
    >>> result.variants[0].image.values.shape
    (3, 4)
    >>> result.save("quick.nc").name
    'quick.nc'

    `settings` changes keys ({"targets.box.temperature_k": 300.0}), `variants` picks some by name.
    `device` is a number, a part of a name, or a device that thzcl.open_device has opened. `figure`
    says whether a picture will be wanted, and `allow_outside` whether pictures and tables may lie
    outside the scenario's folder. Unless `keep` is False, what was traced stays on the device as
    long as the result lives, for Result.with_settings; in a quarter of the device's memory at most,
    where the oldest results give way. No file is written: see Result.save and
    Result.figure. Raises ScenarioError for bad input, DeviceError without a usable device,
    PluginFailure and NumbersError if a sensor fails.
    """
    clock = Clock(progress)
    with clock.stage("plan"):
        plan = prepare(source, settings, variants, allow_outside=allow_outside)
        _refuse_frames(plan)
    with clock.stage("device"):
        from thzcl.device.choose import open_device
        from thzcl.device.opencl import Device

        opened = device if isinstance(device, Device) else open_device(device)
    held = Held(COSTLY) if keep else None
    result = compute_images(plan, opened, clock, figure=figure, held=held)
    return replace(result, kept=Kept(opened, held, allow_outside))


def _refuse_frames(plan: Plan) -> None:
    """Raises ScenarioError for a scene that is a sequence."""
    if plan.frames:
        text = "[sequence] has frames, which are written as they come: call thzcl.sequence"
        raise ScenarioError([f"{plan.scenario.name}: {text}"])


def _again(
    first: Result,
    settings: Mapping[str, Any],
    variants: Sequence[str],
    *,
    figure: bool = True,
    progress: Progress | None = None,
) -> Result:
    """Returns the images of a result's scene with other settings, as Result.with_settings does."""
    kept = first.kept
    names = tuple(variant.name for variant in first.variants)
    scene = Scene(first.scenario_toml, Path(first.scenario_folder), first.scenario, names)
    if kept is None:
        asked: dict[str, Any] = {"settings": settings, "variants": variants, "figure": figure}
        return _told_anew(run(scene, **asked, progress=progress), "a file or a copy holds no paths")
    clock = Clock(progress)
    with clock.stage("plan"):
        plan = prepare(scene, settings, variants, allow_outside=kept.allow_outside)
        _refuse_frames(plan)
        why = _lacking(plan, kept)
    found = compute_images(plan, kept.device, clock, figure=figure, held=kept.held)
    return _told_anew(replace(found, kept=kept), why)


def _lacking(plan: Plan, kept: Kept) -> str:
    """Returns why a plan must be traced anew, in words, if it must."""
    if plan.realizations > 1:
        return "means over realizations hold no paths"
    if kept.held is None:
        return "the first was made with keep = False"
    batch = plan.batch()
    lacking = served(batch, kept.held, kept.device).lacking
    if not lacking and {*map(_kin, kept.held.lost)} & {*map(_kin, everything(batch))}:
        lacking = "what was traced before had no room any more"
    return lacking or "the settings change the air, the rays, or what the air sends along them"


def _kin(spec: Spec) -> Spec:
    """Returns a key, which is equal for paths of the same rays through the same cube."""
    return spec.kin() if isinstance(spec, TraceSpec) else spec


def _told_anew(result: Result, why: str) -> Result:
    """Returns a result that tells among its warnings that its air was traced anew, if it was."""
    if not result.voxel_segments:
        return result
    return replace(result, warnings=(*result.warnings, f"the air was traced anew: {why}"))


def compute_images(
    plan: Plan, device: Device, clock: Clock, *, figure: bool = False, held: Held | None = None
) -> Result:
    """Returns the images of a plan, computed on an open device; `clock` measures the stages.

    `figure` says whether a picture will be wanted. What is `held` serves where it can, and what is
    traced is added to it, unless the plan has several realisations. Raises ScenarioError if the
    device's memory is too small, and NumbersError if a sensor fails.
    """
    checks.memory(plan, device)
    wanted: Iterable[tuple[Spec, ...]] = (plan.batch(n) for n in range(plan.realizations))
    if plan.realizations > 1:
        held = None
    if held is not None:
        batch = served(plan.batch(), held, device).specs
        left = device.memory_bytes - peak(batch)[0]
        held.make_room(batch, max(0, min(int(HELD_SHARE * device.memory_bytes), left)))
        wanted = [batch]
    batches = evaluate(wanted, device, clock, held=held)
    return images_of(plan, batches, device, clock, figure=figure)


def images_of(
    plan: Plan,
    batches: Iterator[tuple[Any, ...]],
    device: Device,
    clock: Clock,
    *,
    figure: bool = False,
) -> Result:
    """Returns the images of a plan, made of the values of its batches, which are computed here.

    `batches` may be an evaluation that goes on with other plans. Raises NumbersError if a sensor
    fails.
    """
    before = device.counters.segments
    first = [_Made.of(v, values) for v, values in _by_variant(plan, next(batches))]
    result = _result(plan, device, first, clock, figure)
    pairs = zip(plan.variants, first, strict=True)
    images = [_shown(v, made.recorded, made.compared, result) for v, made in pairs]
    _refuse_unlike(images, result)
    if plan.realizations > 1:
        images = _mean(plan, images, batches, clock, result)
    return replace(
        result,
        variants=tuple(images),
        error_budget=result.error_budget | spread.budget(images, len(result.targets)),
        voxel_segments=device.counters.segments - before,
    )


def frame_of(plan: Plan, values: Iterable[Any], first: Result) -> Result:
    """Returns a frame of a sequence after the first, made of the values of Plan.frame.

    Raises NumbersError if a sensor fails.
    """
    rest = iter(values)
    images = tuple(
        _shown(v, next(rest), islice(rest, len(v.compared)), first) for v in plan.variants
    )
    return replace(first, variants=images)


@dataclass(frozen=True)
class _Made:
    """The values of one variant's specs.

    `saved` is the cube to be stored, `notes` are warnings about it, `errors` the parts of the error
    budget by name.
    """

    recorded: Recorded
    compared: tuple[Compared, ...]
    expansion: Expansion
    saved: SavedCube | None
    notes: tuple[str, ...]
    errors: dict[str, Part]

    def fits(self) -> list[float]:
        """Returns the errors of the expansions, that of the image first."""
        return [self.expansion.error, *(one.error for one in self.compared)]

    @classmethod
    def of(cls, variant: PlannedVariant, values: Iterator[Any]) -> _Made:
        """Returns the next values, which come in the order of PlannedVariant.specs(), by field."""
        made: list[Any] = [None if spec is None else next(values) for spec in variant.specs()]
        notes, saved, expansion, recorded, *others = made
        count = len(variant.compared)
        parts = {name: part for parts in others[count:] for name, part in parts.items()}
        return cls(recorded, tuple(others[:count]), expansion, saved, notes or (), parts)


def _by_variant(
    plan: Plan, values: Iterable[Any]
) -> Iterator[tuple[PlannedVariant, Iterator[Any]]]:
    """Yields each variant with an iterator whose next values are those of the variant's specs."""
    rest = iter(values)
    for variant in plan.variants:
        yield variant, rest


def _shown(
    planned: PlannedVariant, recorded: Recorded, compared: Iterable[Compared], so_far: Result
) -> VariantResult:
    """Returns an image and what reached its pixels. Raises NumbersError if one of them fails."""
    if recorded.image is None:
        raise NumbersError(recorded.failure or "no image", so_far)
    compared = tuple(compared)
    for one in compared:
        if one.failure:
            raise NumbersError(f"{planned.name}: {one.failure}", so_far)
    sight = recorded.sight
    middle = float(sight.frequency_hz.mean())
    cell = metrics.resolution_cell(planned.needs.optics, middle, planned.image.pixel_rad)
    return VariantResult(planned.name, sight, recorded.image, _models(compared), cell)


def _models(compared: Iterable[Compared]) -> tuple[ModelResult, ...]:
    """Returns what reached the pixels by the models to compare with."""
    return tuple(ModelResult(one.model, one.planes, one.sight) for one in compared)


def _refuse_unlike(variants: list[VariantResult], so_far: Result) -> None:
    """Raises NumbersError for images of several quantities, which one variable cannot hold."""
    images = [variant.image for variant in variants if variant.image is not None]
    kinds = dict.fromkeys(f"{image.quantity} in {image.unit}" for image in images)
    if len(kinds) > 1:
        text = f"the variants' images are of several kinds ({', '.join(kinds)})"
        raise NumbersError(f"{text}; run them apart with --variant", so_far)


def _mean(
    plan: Plan,
    first: list[VariantResult],
    batches: Iterator[tuple[Any, ...]],
    clock: Clock,
    so_far: Result,
) -> list[VariantResult]:
    """Returns each variant's mean over realisations, with variance, spread and percentiles.

    `first` holds the images of the first realisation.
    """
    from thzcl.plan.memory import by_pixel
    from thzcl.studies.ensemble import Ensemble

    keep = by_pixel(plan.realizations, len(first), first[0].sight.target.size)
    ensembles = [Ensemble(so_far.targets, by_pixel=keep) for _ in first]
    for number in range(plan.realizations):
        clock.counted(number + 1, plan.realizations)
        images = first
        if number > 0:
            values = iter(next(batches))
            images = [
                _shown(v, next(values), islice(values, len(v.compared)), so_far)
                for v in plan.variants
            ]
        for ensemble, image in zip(ensembles, images, strict=True):
            ensemble.add(image)
    return [ensemble.mean() for ensemble in ensembles]


def _result(plan: Plan, device: Device, made: list[_Made], clock: Clock, figure: bool) -> Result:
    """Returns the result without its images and without the number of voxels crossed."""
    first, pairs = plan.variants[0], list(zip(plan.variants, made, strict=True))
    notes = dict.fromkeys(note for one in made for note in one.notes)
    left_out = [stage for stage in report.stages(plan, figure) if not stage.needed]
    errors = [error for one in made for error in one.fits()]
    used = versions()
    held = {model.model for variant in plan.variants for model in variant.compared}
    models = [first.scene.atmosphere.model, *first.scene.atmosphere.compare]
    return Result(
        scenario=plan.scenario.name,
        scenario_toml=plan.scenario.text,
        scenario_folder=str(plan.scenario.folder.resolve()),
        variants=tuple(
            VariantResult(v.name, one.recorded.sight, None, _models(one.compared))
            for v, one in pairs
        ),
        targets=("background", "ground", *plan.scenario.targets),
        pixel_angles_mrad=tuple(angles(v.scene.camera) for v in plan.variants),
        conditions=tuple(
            conditions(
                v.scene.atmosphere.air,
                v.scene.atmosphere.model,
                one.recorded.sight,
                one.recorded.image,
                v.scene.numerics.realizations,
            )
            for v, one in pairs
        ),
        figure_columns=first.scene.output.figure_columns,
        limits=first.scene.output.limits,
        color_map=first.scene.output.color_map,
        picture_format=first.scene.output.format,
        width_mm=first.scene.output.width_mm,
        difference=first.scene.output.difference,
        grid_rotations=tuple(ROTATIONS[v.orientation] for v in plan.variants),
        device=device.info.description,
        seed=plan.scenario.seed,
        noise_seed=_noise_seed(plan),
        build_options=tuple(device.build_options),
        seconds=clock.seconds,
        left_out=tuple({"stage": stage.name, "reason": stage.reason} for stage in left_out),
        warnings=(
            *filter(None, [device.note]),
            *report.warnings(plan, errors),
            *notes,
            *_missed(pairs),
        ),
        error_budget=_errors(pairs),
        voxel_segments=0,
        versions=used,
        cubes=_cubes(pairs),
        models=tuple(name for name in models if name in {models[0], *held}) if held else (),
        spread_shown=first.scene.output.model_spread,
        airs=tuple({"variant": v.name, **report.fluctuations(v)} for v in plan.variants),
        skies=tuple(report.skies(plan)),
        history=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}: made by thzcl {used['thzcl']}",
    )


def _noise_seed(plan: Plan) -> int | None:
    """Returns the seed of the first image that has noise, or None if none has."""
    return next((v.image.noise.seed for v in plan.variants if v.needs.noise), None)


def _errors(pairs: list[tuple[PlannedVariant, _Made]]) -> dict[str, dict[str, Any]]:
    """Returns the errors of the images by part, for the result's error budget.

    They are that of the absorption fit, those that sensors know, and those that the error budget
    has measured. Of several variants the largest error counts.
    """
    fit = max(made.expansion.measured for _, made in pairs)
    sizes = {"absorption-fit": (fit, "of the mean absorption")}
    for variant, _ in pairs:
        for part, error in variant.needs.errors.items():
            sizes[part] = max(error, sizes.get(part, error))
    known = {part: {"rms": size, "max": size, "unit": unit} for part, (size, unit) in sizes.items()}
    first = pairs[0][0]
    unit = first.image.sources.unit + (", per m2" if first.needs.gain == "lambert" else "")
    parts = worst(made.errors for _, made in pairs)
    return known | {
        name: {"rms": p.rms, "max": p.max, "unit": unit, "relative": p.relative}
        for name, p in parts.items()
    }


def _missed(pairs: list[tuple[PlannedVariant, _Made]]) -> list[str]:
    """Returns a warning for each variant whose measured error is larger than can be borne.

    That is its tolerance, or USUAL_TOLERANCE where it names none. What is simplified of weather is
    told apart, since it is no part of the total.
    """
    remedies = {
        "total": 'remove what [numerics] fixes, or set ray_stride = 1 and precision = "float64"',
        "scattering": "that of rain, fog or snow in uneven air, which no setting changes",
    }
    found = []
    for variant, made in pairs:
        tolerance = variant.scene.numerics.tolerance
        for name, text in remedies.items():
            part = made.errors.get(name)
            if part is None or part.relative <= (tolerance or USUAL_TOLERANCE):
                continue
            error = f"error of {part.relative:.1e} of the contrast"
            if tolerance is not None:
                error += f", tolerance {tolerance:g}"
            found.append(f"{variant.name}: {error}; {text}")
    return found


def _cubes(pairs: list[tuple[PlannedVariant, _Made]]) -> tuple[Cube, ...]:
    """Returns the cubes to be stored, one for each variant, or one if they are all the same.

    Returns none unless every variant has one.
    """
    saved = [made.saved for _, made in pairs]
    if any(cube is None for cube in saved):
        return ()
    cubes = [Cube(*cube) for cube in saved if cube is not None]
    same = len({variant.saved for variant, _ in pairs}) == 1
    return tuple(cubes[:1] if same else cubes)
