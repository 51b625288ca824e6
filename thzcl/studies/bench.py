"""Throughput of every stage on this device.

And how much of what the device can do at most each reaches.
"""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import thzcl
from thzcl import pipeline
from thzcl.clock import Clock, Progress
from thzcl.plan.plan import Plan, VariantPlan, by_key
from thzcl.results.result import Result

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

COPIED = 2**27  # bytes a buffer: much more than any cache holds
RAYS, VOXELS_A_RAY = 2**18, 256  # of the kernel that only gathers
ABREAST = 64  # rays in one voxel: 8 pixels span 6 cm at the target, a voxel some 50
RANDOM = (1664525, 1013904223)  # Numerical Recipes' generator
FIELD_BYTES = 12  # a voxel: a half spectrum written and read, and the cube written; in float32


class Work(NamedTuple):
    """What one of our stages does: those of a run's clock that it is made of, and how much it does, in what unit.

    `bound` names the roofline, and `needed` is what the stage cannot do without, in that roofline's unit.
    """

    name: str
    stages: tuple[str, ...]
    unit: str
    amount: int
    bound: str = ""
    needed: int = 0


class Runs(NamedTuple):
    """Medians over runs of the same plan: seconds by stage and of the whole.

    And the last of the results.
    """

    seconds: dict[str, float]
    whole: float
    result: Result


def bench(
    source: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | None = None,
    allow_outside: bool = False,
    repeat: int = 7,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Runs a scenario `repeat` times, after once to warm up, and tells what each stage takes, as medians; arguments as run's.

    Times are wall times, in seconds, from a stage's start to the end of its last kernel. `stages` holds amounts, rates by
    the second and, where it is known what limits a stage, the `share` of the device's measured `roofline` that it reaches.
    Raises what run does.
    """
    tell = progress or (lambda _: None)
    plan = pipeline.prepare(source, settings, variants, allow_outside=allow_outside)
    from thzcl.device.choose import open_device

    opened = open_device(device)
    runs = repeated(plan, opened, repeat, tell)
    roofline = _roofline(opened, plan, repeat, tell)
    return {
        "scenario": plan.scenario.name,
        "device": runs.result.device,
        "repeat": repeat,
        **surroundings(),
        "stages": _stages(plan, runs, roofline),
        "roofline": list(roofline.values()),
    }


def surroundings() -> dict[str, Any]:
    """What a measured time belongs to: machine, commit (None outside a checkout) and versions."""
    return {
        "machine": {
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)),
            "system": platform.system(),
        },
        "commit": _commit(),
        "versions": pipeline.versions(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _commit() -> str | None:
    """The checkout's commit, with a plus where files differ from it."""
    root, git = Path(thzcl.__file__).parents[1], shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    ask = [git, "-C", str(root), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    answer = subprocess.run(ask, capture_output=True, text=True, check=False)  # noqa: S603 (no word of it is a user's)
    return answer.stdout.strip() or None


def repeated(plan: Plan, device: Device, repeat: int, tell: Progress = lambda _: None) -> Runs:
    """Runs a plan once to build its kernels, and then `repeat` times."""
    tell("warming up")
    result = pipeline.compute_images(plan, device, Clock())
    clocks, whole = [], []
    for number in range(repeat):
        tell(f"{plan.scenario.name}, {number + 1} of {repeat}")
        clock, start = Clock(), time.perf_counter()
        result = pipeline.compute_images(plan, device, clock)
        whole.append(time.perf_counter() - start)
        clocks.append(clock.seconds)
    return Runs(
        {name: statistics.median(c[name] for c in clocks) for name in clocks[0]},
        statistics.median(whole),
        result,
    )


def _works(plan: Plan, segments: int) -> list[Work]:
    """What the stages do whose throughput means something."""
    with_field = [v for v in plan.variants if v.field is not None]
    cubes = [
        same[0].field for same in by_key(with_field, lambda v: (v.field, v.precision)).values()
    ]
    voxels = [cube.source.grid**3 for cube in cubes if cube is not None]
    fields = [
        cube.source.grid**3 * (1 + cube.temperature_fluctuates)
        for cube in cubes
        if cube is not None
    ]
    raster = plan.variants[0].geometry.raster
    rays = raster.rays * len(by_key(plan.variants, lambda v: v.rays_key))
    shaded = [
        v for v in plan.variants if v.isothermal
    ]  # the others carry their radiance along the path
    pixels = sum(v.geometry.raster.rays * len(v.frequency_hz) for v in shaded)
    gathers = segments if len(shaded) == len(plan.variants) else 2 * segments
    return [
        Work(
            "field",
            ("humidity-field",),
            "voxels",
            sum(voxels),
            "memory-bandwidth",
            FIELD_BYTES * sum(fields),
        ),
        Work("surfaces", ("ground", "boxes", "billboards"), "rays", rays),
        Work(
            "trace",
            ("trace", "outgoing-path", "path-emission"),
            "segments",
            segments,
            "gather-coherent",
            gathers,
        ),
        Work(
            "shading",
            ("shading",),
            "pixel_frequencies",
            pixels,
            "memory-bandwidth",
            _shading_bytes(shaded),
        ),
    ]


def _shading_bytes(variants: Sequence[VariantPlan]) -> int:
    """Length, surface and moments of every ray read, depth and contrast written."""
    total = 0
    for v in variants:
        real, bands = (
            np.dtype(v.precision).itemsize,
            len(v.frequency_hz) if v.weights is None else len(v.weights),
        )
        moments = v.surrogate.moments if v.field is not None else 0
        total += v.geometry.raster.rays * (4 + real * (1 + moments + 2 * bands))
    return total


def _stages(
    plan: Plan, runs: Runs, roofline: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Every stage that the runs went through, and at last whole images."""
    found, left = [], dict(runs.seconds)
    for work in _works(plan, runs.result.voxel_segments):
        taken = [left.pop(stage) for stage in work.stages if work.amount and stage in left]
        if taken:
            seconds = sum(taken)
            bound = roofline.get(work.bound)
            share = (
                {}
                if bound is None
                else {"bound": work.bound, "share": work.needed / seconds / _rate(bound)}
            )
            found.append(_row(work.name, seconds, work.unit, work.amount) | share)
    found += [{"name": name, "seconds": seconds} for name, seconds in left.items()]
    return [*found, _row("image", runs.whole, "images", len(plan.variants))]


def flat(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Stages and roofline as rows of the same columns, with the units of their rates.

    What does not apply is empty.
    """
    rows = []
    for row in [*found["stages"], *found["roofline"]]:
        rates = [key for key in row if key.endswith("_per_second")]
        rate = (
            {"rate": row[rates[0]], "unit": rates[0].removesuffix("_per_second") + "/s"}
            if rates
            else {"rate": "", "unit": ""}
        )
        rows.append(
            {
                "name": row["name"],
                "seconds": row["seconds"],
                **rate,
                **{k: row.get(k, "") for k in ("share", "bound")},
            }
        )
    return rows


def _row(name: str, seconds: float, unit: str, amount: int) -> dict[str, Any]:
    return {"name": name, "seconds": seconds, unit: amount, f"{unit}_per_second": amount / seconds}


def _rate(row: Mapping[str, Any]) -> float:
    return next(float(value) for key, value in row.items() if key.endswith("_per_second"))


def _roofline(device: Device, plan: Plan, repeat: int, tell: Progress) -> dict[str, dict[str, Any]]:
    """What the device can do at most: copy memory, and where the scene has a cube.

    Read its voxels in two orders.
    """
    tell("memory bandwidth")
    rows = [_bandwidth(device, repeat)]
    traced = [v for v in plan.variants if v.field is not None]
    if traced and traced[0].field is not None:
        grid, precision = traced[0].field.source.grid, traced[0].precision
        diagonal = (1, (grid * grid + grid + 1) << (32 - 3 * (grid.bit_length() - 1)))
        for name, way, abreast in (("coherent", diagonal, ABREAST), ("random", RANDOM, 1)):
            tell(f"{name} gather")
            rows.append(_gather(device, f"gather-{name}", grid, precision, way, abreast, repeat))
    return {row["name"]: row for row in rows}


def _bandwidth(device: Device, repeat: int) -> dict[str, Any]:
    """Bytes read and written in a second by a copy."""
    program = device.build(("device/roofline",), "float32")
    one, other = (device.put(np.zeros(COPIED // 4, np.float32)) for _ in range(2))
    seconds = _timed(
        device,
        repeat,
        lambda: program.run("copy", COPIED // 4 // device.lanes("float32"), one, other),
    )
    return _row("memory-bandwidth", seconds, "bytes", 2 * COPIED)


def _gather(
    device: Device,
    name: str,
    grid: int,
    precision: str,
    way: tuple[int, int],
    abreast: int,
    repeat: int,
) -> dict[str, Any]:
    """Voxels read in a second by a kernel that does nothing else; `way` is from cell to cell."""
    program = device.build(("device/roofline",), precision)
    cube, out = device.put(np.zeros(grid**3), precision), device.empty((RAYS,), precision)
    size, log2_voxels = RAYS // device.lanes(precision), 3 * (grid.bit_length() - 1)
    factor, step = (np.uint32(number & 0xFFFFFFFF) for number in way)
    arguments = (
        cube,
        np.int32(log2_voxels),
        np.int32(abreast),
        factor,
        step,
        np.int32(VOXELS_A_RAY),
        out,
    )
    seconds = _timed(device, repeat, lambda: program.run("gather", size, *arguments))
    return _row(name, seconds, "voxels", RAYS * VOXELS_A_RAY)


def _timed(device: Device, repeat: int, enqueue: Any) -> float:
    """Median seconds from enqueue to finish, after once to warm up."""
    taken = []
    for _ in range(repeat + 1):
        start = time.perf_counter()
        enqueue()
        device.finish()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken[1:])
