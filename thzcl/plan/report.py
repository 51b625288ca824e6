"""A plan in figures and words: stages needed and left out, memory, voxels crossed.

And what a user should be warned of.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from thzcl.air.mpm93 import STATED_TO_GHZ
from thzcl.air.refraction import Refraction, estimate, structure_constant_n
from thzcl.plan.numerics import share_traced
from thzcl.plan.plan import DEPTH_CHECKED_EVERY, Group, Plan, VariantPlan, by_key, sample_rays
from thzcl.surfaces.geometry import ROTATIONS
from thzcl.turbulence.spectra import Turbulence


@dataclass(frozen=True)
class Stage:
    """One stage of the computation: whether it is needed, and why or why not."""

    name: str
    needed: bool
    reason: str


def stages(plan: Plan, figure: bool = True) -> list[Stage]:
    """Every stage that thzcl has, in order, with the reason for running it or leaving it out."""
    variants = plan.variants
    cubes = by_key((v for v in variants if v.field), lambda v: v.field)
    traced = [group for group in plan.groups if group.first.field and group.first.isothermal]
    warm = [v for v in variants if not v.isothermal]
    absorbing = [v for v in variants if v.scene.atmosphere.model != "none"]
    return [
        _stage(
            "surrogate", absorbing, _surrogate(plan), 'model = "none": air that absorbs nothing'
        ),
        _stage("humidity-field", cubes, _cubes(plan, len(cubes)), _no_field(variants[0])),
        _stage(
            "temperature-field",
            warm,
            "temperature fluctuates too",
            "air temperature does not fluctuate",
        ),
        _stage(
            "trace",
            traced,
            f"{_count(len(traced), 'trace')} of {_count(plan.moments, 'moment')} for {_images(variants)}{_thinned(traced)}",
            "path emission carries the depth along"
            if warm
            else "uniform air: the path's length is all that counts",
        ),
        _stage(
            "path-emission",
            warm,
            "temperature fluctuates",
            "isothermal air: emission follows from optical depth",
        ),
        *_surface_stages(variants),
        *_sensor_stages(variants),
        _stage("figure", figure, "a picture of every variant", "not asked for"),
    ]


def _surface_stages(variants: tuple[VariantPlan, ...]) -> list[Stage]:
    boxes, boards = (
        max(len(getattr(v.geometry, name)) for v in variants) for name in ("boxes", "billboards")
    )
    ground = any(v.scene.ground for v in variants)
    return [
        _stage(
            "ground", ground, "the scene has a ground", "no [ground]: no ground test in the kernel"
        ),
        _stage(
            "boxes",
            boxes,
            _count(boxes, "box", "boxes"),
            "no box targets: no box test in the kernel",
        ),
        _stage(
            "billboards",
            boards,
            _count(boards, "billboard"),
            "no billboards: no texture in the kernel",
        ),
    ]


def _sensor_stages(variants: tuple[VariantPlan, ...]) -> list[Stage]:
    sent = any(v.needs.transmitter_m is not None for v in variants)
    active = any(v.needs.reflection for v in variants)
    passive = (
        "monostatic: out and back through the same voxels"
        if active
        else "passive sensor: nothing is sent out"
    )
    blurred = [v for v in variants if v.needs.optics is not None]
    rays = max(v.geometry.raster.rays / math.prod(v.geometry.raster.pixels) for v in variants)
    return [
        _stage("outgoing-path", sent, "bistatic: from the transmitter to what is seen", passive),
        _stage(
            "optics", blurred, f"{rays:.3g} rays a pixel, the margin included", "no [sensor.optics]"
        ),
        _stage(
            "noise",
            any(v.needs.noise for v in variants),
            "drawn by the sensor, from the seed",
            "a noiseless sensor",
        ),
    ]


def _stage(name: str, needed: object, why: str, why_not: str) -> Stage:
    return Stage(name, bool(needed), why if needed else why_not)


def _surrogate(plan: Plan) -> str:
    fitted = f"MPM93 as polynomial of degree {plan.moments} in humidity"
    return f"{fitted}, error at most {plan.surrogate_error:.1e} of the mean absorption"


def _cubes(plan: Plan, number: int) -> str:
    times = f", {plan.realizations} times" if plan.realizations > 1 else ""
    return f"{_count(number, 'cube')} for {_images(plan.variants)}{times}"


def _thinned(groups: list[Group]) -> str:
    stride = max((group.stride for group in groups), default=1)
    return (
        f"; every {stride}th ray both ways and the edges, the rest interpolated"
        if stride > 1
        else ""
    )


def _no_field(variant: VariantPlan) -> str:
    atmosphere = variant.scene.atmosphere
    if atmosphere.model == "none":
        return "air absorbs nothing: no field, no FFT"
    if atmosphere.fluctuations is None:
        return "no [atmosphere.fluctuations]: no field, no FFT"
    return "fluctuations of size 0, or dry air: no field, no FFT"


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number} {one if number == 1 else many or one + 's'}"


def _images(variants: tuple[VariantPlan, ...]) -> str:
    return _count(len(variants), "image")


def voxel_segments(plan: Plan) -> int:
    """How many voxels the rays will cross over positive length, from a few thousand of them."""
    total = 0.0
    for group in plan.groups:
        field = group.first.field
        if field is None:
            continue
        rays = group.sample
        per_metre = (
            np.abs(rays.direction @ ROTATIONS[group.first.orientation].T).sum(axis=1)
            / field.source.voxel_m
        )
        voxels = rays.length * per_metre + 1
        checks = np.ceil((group.visible_m * per_metre + 1) / DEPTH_CHECKED_EVERY)
        voxels = np.minimum(voxels, checks * DEPTH_CHECKED_EVERY)
        total += (
            float(np.mean(voxels))
            * group.first.geometry.raster.rays
            * group.passes
            * _share_traced(group)
        )
    return round(total * plan.realizations)


def _share_traced(group: Group) -> float:
    """The part of the rays that is traced."""
    return share_traced(
        group.first.geometry.raster, group.first.surfaces, group.sample, group.stride
    )


def memory(plan: Plan) -> tuple[int, int]:
    """Bytes at the peak, and of the largest single array."""
    arrays = [list(_arrays(group)) for group in plan.groups]
    images = sum(
        len(v.frequency_hz) * 24 * math.prod(v.geometry.raster.pixels) for v in plan.variants
    )
    return max(sum(sizes) for sizes in arrays) + images, max(max(sizes) for sizes in arrays)


def _arrays(group: Group) -> Iterator[int]:
    """Bytes of what one group holds at a time."""
    first = group.first
    real = 4 if first.precision == "float32" else 8
    rays, count = first.geometry.raster.rays, len(first.frequency_hz)
    count = count if first.weights is None or not first.isothermal else len(first.weights)
    yield from (8 * rays, real * rays, real * rays, 4 * rays)
    yield from (real * rays * count,) * 2
    if first.field is None:
        return
    voxels = first.field.source.grid**3
    yield from (real * voxels,) * (1 if first.isothermal else 2)
    if first.isothermal:
        yield real * rays * group.moments
    if isinstance(
        first.field.source, Turbulence
    ):  # while it is made: spectrum, transform, and their copies
        yield from (4 * voxels,) * 3 if first.isothermal else (8 * voxels,) * 2


def warnings(plan: Plan) -> list[str]:
    """What a user should know before trusting the images."""
    found = []
    highest = plan.frequency_hz.max() / 1e9
    if highest > STATED_TO_GHZ:
        found.append(
            f"{highest:g} GHz: MPM93 is stated to {STATED_TO_GHZ:g} GHz; beyond, absorption is an extrapolation"
        )
    for group in plan.groups:
        field = group.first.field
        if field is None:
            continue
        period = field.source.grid * field.source.voxel_m
        periods = min(float(group.sample.length.max()), group.visible_m) / period
        if periods > 1:
            found.append(
                f"the longest path is {periods:.2f} periods of the {period:g} m cube: averages along it vary less from "
                "ray to ray than in open air; a larger grid or voxel_m mends that"
            )
    for variant in plan.variants:
        humidity = variant.scene.atmosphere.air.relative_humidity_percent
        if humidity > 100.5:
            found.append(
                f"{variant.name}: mean humidity is {humidity:.4g} % of saturation; clouds are not modelled"
            )
        if variant.surrogate.error > 1e-4:
            found.append(
                f"{variant.name}: the absorption polynomial errs by up to {variant.surrogate.error:.1e}; set a higher moments"
            )
    return list(dict.fromkeys(found))


def numerics(variant: VariantPlan) -> dict[str, object]:
    """The numerical settings of a variant, given or chosen."""
    return {
        "variant": variant.name,
        "tolerance": variant.scene.numerics.tolerance,
        "precision": variant.precision,
        "moments": variant.surrogate.moments,
        "cutoff_depth": round(variant.accuracy.cutoff, 3),
        "ray_stride": variant.stride,
        "frequencies": len(variant.frequency_hz),
    }


def refraction(plan: Plan) -> Refraction | None:
    """What refraction would add on the longest path of the variant where it would add most.

    None in even air.
    """
    found = []
    for variant in plan.variants:
        if variant.field is None or not isinstance(variant.field.source, Turbulence):
            continue
        air = variant.scene.atmosphere.air
        constant = structure_constant_n(
            air, *variant.field.source.structure_constants(air.absolute_humidity_g_m3)
        )
        aperture = variant.needs.optics.aperture_m if variant.needs.optics else None
        length = float(sample_rays(variant.geometry).length.max())
        found.append(estimate(constant, float(variant.frequency_hz.max()), length, aperture))
    return max(found, key=lambda one: one.scintillation_db, default=None)


def as_json(plan: Plan, figure: bool = True) -> dict[str, object]:
    """The plan as `thzcl plan --format json` prints it."""
    return {
        "scenario": plan.scenario.name,
        "stages": [
            {"name": s.name, "needed": s.needed, "reason": s.reason} for s in stages(plan, figure)
        ],
        "memory_bytes": memory(plan)[0],
        "voxel_segments": voxel_segments(plan),
        "frequencies_ghz": [round(float(f) / 1e9, 9) for f in plan.frequency_hz],
        "moments": plan.moments,
        "surrogate_error": plan.surrogate_error,
        "numerics": [numerics(variant) for variant in plan.variants],
        "refraction_left_out": None if (left := refraction(plan)) is None else left._asdict(),
        "warnings": warnings(plan),
    }
