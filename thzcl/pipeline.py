"""The whole story: from a scenario to its images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thzcl.air.expansion import Expansion
from thzcl.clock import Clock, Progress
from thzcl.error.budget import Part, worst
from thzcl.errors import NumbersError
from thzcl.graph import evaluate
from thzcl.plan import checks, report
from thzcl.plan.plan import Plan, make_plan
from thzcl.plan.variant import PlannedVariant
from thzcl.results.conditions import angles, conditions
from thzcl.results.contents import Cube, VariantResult
from thzcl.results.result import Result
from thzcl.results.versions import versions
from thzcl.scenario import document as documents
from thzcl.sensing.image import Recorded
from thzcl.turbulence.fields import SavedCube
from thzcl.turbulence.orientation import ROTATIONS

if TYPE_CHECKING:
    from thzcl.device.opencl import Device


def prepare(
    source: str | Path,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    *,
    allow_outside: bool = False,
) -> Plan:
    """Reads and checks a scenario and plans its run.

    Raises ScenarioError with every problem at once, or PluginFailure.
    """
    document = documents.read(source, settings)
    parsed = documents.parse(document, variants, allow_outside=allow_outside)
    plan = make_plan(parsed)
    checks.together(document, plan)
    return plan


def run(
    source: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | Device | None = None,
    figure: bool = True,
    allow_outside: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Computes the images of a scenario: a TOML file, a result, or the name of a shipped scene.

    `settings` changes keys ({"targets.box.temperature_k": 300.0}), `variants` picks some by name,
    `device` is a number, part of a name, or a device that thzcl.open_device has opened; `figure`
    says whether a picture will be wanted; `allow_outside` lets pictures and tables lie outside the
    scenario's folder. Nothing is written: see Result.save and Result.figure. Raises ScenarioError
    for bad input, DeviceError without a usable device, PluginFailure and NumbersError if a sensor
    fails.
    """
    clock = Clock(progress)
    with clock.stage("plan"):
        plan = prepare(source, settings, variants, allow_outside=allow_outside)
    with clock.stage("device"):
        from thzcl.device.choose import open_device
        from thzcl.device.opencl import Device

        opened = device if isinstance(device, Device) else open_device(device)
    return compute_images(plan, opened, clock, figure=figure)


def compute_images(plan: Plan, device: Device, clock: Clock, *, figure: bool = False) -> Result:
    """Returns the images of a plan, on an open device; `clock` is told what each stage takes.

    Raises ScenarioError if the device's memory is too small, and NumbersError if a sensor fails.
    """
    checks.memory(plan, device)
    before = device.counters.segments
    batches = evaluate((plan.batch(n) for n in range(plan.realizations)), device, clock)
    first = [_Made.of(v, values) for v, values in _by_variant(plan, next(batches))]
    result = _result(plan, device, first, clock, figure)
    recorded = [_checked(made.recorded, result) for made in first]
    if plan.realizations > 1:
        recorded = _mean(plan, recorded, batches, clock, result)
    images = zip(plan.variants, recorded, strict=True)
    return replace(
        result,
        variants=tuple(VariantResult(v.name, one.sight, one.image) for v, one in images),
        voxel_segments=device.counters.segments - before,
    )


@dataclass(frozen=True)
class _Made:
    """What a run made of one variant."""

    recorded: Recorded
    expansion: Expansion
    saved: SavedCube | None
    notes: tuple[str, ...]
    errors: dict[str, Part]

    @classmethod
    def of(cls, variant: PlannedVariant, values: Iterator[Any]) -> _Made:
        """Sorts values of specs that are in the order of PlannedVariant.specs()."""
        made = [None if spec is None else next(values) for spec in variant.specs()]
        notes, saved, expansion, recorded, *errors = made
        parts = {name: part for found in errors for name, part in found.items()}
        return cls(recorded, expansion, saved, notes or (), parts)


def _by_variant(
    plan: Plan, values: Iterable[Any]
) -> Iterator[tuple[PlannedVariant, Iterator[Any]]]:
    """Yields each variant with an iterator that gives its own values next."""
    rest = iter(values)
    for variant in plan.variants:
        yield variant, rest


def _checked(recorded: Recorded, so_far: Result) -> Recorded:
    """Returns what was recorded. Raises NumbersError where there is no image."""
    if recorded.failure is not None:
        raise NumbersError(recorded.failure, so_far)
    return recorded


def _mean(
    plan: Plan,
    first: list[Recorded],
    batches: Iterator[tuple[Any, ...]],
    clock: Clock,
    so_far: Result,
) -> list[Recorded]:
    """Returns the mean over independent realisations of the air, with variance and spread."""
    from thzcl.studies.ensemble import Ensemble

    kept = [Ensemble() for _ in first]
    for number in range(plan.realizations):
        clock.counted(number + 1, plan.realizations)
        images = first if number == 0 else next(batches)
        for ensemble, one in zip(kept, images, strict=True):
            recorded = _checked(one, so_far)
            ensemble.add(recorded.sight, recorded.image)
    return [Recorded(*ensemble.mean(), None) for ensemble in kept]


def _result(plan: Plan, device: Device, made: list[_Made], clock: Clock, figure: bool) -> Result:
    """Returns everything but the images."""
    first, pairs = plan.variants[0], list(zip(plan.variants, made, strict=True))
    notes = dict.fromkeys(note for one in made for note in one.notes)
    left_out = [stage for stage in report.stages(plan, figure) if not stage.needed]
    errors = [one.expansion.error for one in made]
    return Result(
        scenario=plan.scenario.name,
        scenario_toml=plan.scenario.text,
        scenario_folder=str(plan.scenario.folder.resolve()),
        variants=tuple(VariantResult(v.name, one.recorded.sight, None) for v, one in pairs),
        targets=(
            "background",
            "ground",
            *max((v.scene.targets for v in plan.variants), key=len),
        ),
        pixel_angles_mrad=angles(first.scene.camera),
        conditions=tuple(
            conditions(v.scene.atmosphere.air, one.recorded.sight) for v, one in pairs
        ),
        figure_columns=first.scene.output.figure_columns,
        difference=first.scene.output.difference,
        grid_rotation=ROTATIONS[first.orientation],
        device=f"{device.info.name} ({device.info.driver})",
        seed=plan.scenario.seed,
        build_options=tuple(device.build_options),
        seconds=clock.seconds,
        left_out=tuple({"stage": stage.name, "reason": stage.reason} for stage in left_out),
        warnings=(*report.warnings(plan, errors), *notes, *_missed(pairs)),
        error_budget=_errors(pairs),
        voxel_segments=0,
        versions=versions(),
        cubes=_cubes(pairs),
    )


def _errors(pairs: list[tuple[PlannedVariant, _Made]]) -> dict[str, dict[str, Any]]:
    """Returns what is known of the errors made, by part.

    Of the fit and by the sensors' word, and as measured where that is wanted.
    """
    fit = max(made.expansion.measured for _, made in pairs)
    told = {"absorption-fit": (fit, "of the mean absorption")}
    for variant, _ in pairs:
        for part, error in variant.needs.errors.items():
            told[part] = max(error, told.get(part, error))
    known = {part: {"rms": size, "max": size, "unit": unit} for part, (size, unit) in told.items()}
    unit = pairs[0][0].image.sources.unit
    parts = worst(made.errors for _, made in pairs)
    return known | {
        name: {"rms": p.rms, "max": p.max, "unit": unit, "relative": p.relative}
        for name, p in parts.items()
    }


def _missed(pairs: list[tuple[PlannedVariant, _Made]]) -> list[str]:
    """Returns words on variants whose measured error is more than the tolerance."""
    found = []
    for variant, made in pairs:
        bearable, total = variant.scene.numerics.tolerance, made.errors.get("total")
        if bearable is not None and total is not None and total.relative > bearable:
            text = 'remove what [numerics] fixes, or set ray_stride = 1 and precision = "float64"'
            error = f"error of {total.relative:.1e} of the contrast, tolerance {bearable:g}"
            found.append(f"{variant.name}: {error}; {text}")
    return found


def _cubes(pairs: list[tuple[PlannedVariant, _Made]]) -> tuple[Cube, ...]:
    """Returns the saved cubes in the units of each variant's air, once if all are the same."""
    saved = [made.saved for _, made in pairs]
    if any(cube is None for cube in saved):
        return ()
    cubes = [Cube(*cube) for cube in saved if cube is not None]
    same = len({variant.saved for variant, _ in pairs}) == 1
    return tuple(cubes[:1] if same else cubes)
