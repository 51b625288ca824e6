"""Throughput of every stage on this device, and how close each comes to what the device can do."""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

import thzcl
from thzcl import pipeline
from thzcl.clock import Clock, Progress
from thzcl.device.kernels import Kernels
from thzcl.graph import Spec, everything
from thzcl.paths.specs import EmissionSpec
from thzcl.plan.plan import Plan
from thzcl.results.result import Result
from thzcl.results.versions import versions
from thzcl.sensing.transfer import ShadeSpec
from thzcl.surfaces.ends import EndsSpec
from thzcl.surfaces.geometry import KINDS
from thzcl.turbulence.fields import AnyField

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

COPIED = 2**27  # bytes a buffer: much more than any cache holds
RAYS, VOXELS_A_RAY = 2**18, 256  # of the kernel that only gathers
ABREAST = 64  # rays in one voxel: 8 pixels span 6 cm at the target, a voxel some 50
RANDOM = (1664525, 1013904223)  # Numerical Recipes' generator
FIELD_BYTES = 12  # a voxel: a half spectrum written and read, and the cube written; in float32


@dataclass(frozen=True)
class CopyKernels(Kernels):
    """The kernel that only copies memory."""

    files: ClassVar = ("device/roofline",)


@dataclass(frozen=True)
class GatherKernels(CopyKernels):
    """The kernel that only gathers, in the packets of a trace and by the same instruction."""

    gathers = True


class Work(NamedTuple):
    """What one of our stages does: the parts of a run's clock that it is made of, and an amount.

    `bound` names the roofline; `needed` is the least that the stage must move, in its unit.
    """

    name: str
    stages: tuple[str, ...]
    unit: str
    amount: int
    bound: str = ""
    needed: int = 0


class Runs(NamedTuple):
    """Medians over runs of one plan, in seconds: by stage and of the whole; and the last result."""

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
    """Runs a scenario once to warm up and then `repeat` times; returns what each stage takes.

    Times are medians of wall times, in seconds, from a stage's start to the end of its last kernel.
    `stages` holds amounts, amounts a second and, where it is known what limits a stage, the `share`
    of the device's measured `roofline` that it reaches. The other arguments are those of
    pipeline.run, and so are the errors that are raised.
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
    """Returns what times belong to: machine, versions, commit (None outside a checkout)."""
    return {
        "machine": {
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)),
            "system": platform.system(),
        },
        "commit": _commit(),
        "versions": versions(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _commit() -> str | None:
    """Returns the checkout's commit, with a plus where files differ from it."""
    root, git = Path(thzcl.__file__).parents[1], shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None
    ask = [git, "-C", str(root), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    # No word of the command is a user's.
    answer = subprocess.run(ask, capture_output=True, text=True, check=False)  # noqa: S603
    return answer.stdout.strip() or None


def repeated(plan: Plan, device: Device, repeat: int, tell: Progress = lambda _: None) -> Runs:
    """Runs a plan once to build its kernels, and then `repeat` times; returns the medians."""
    tell("warming up")
    result = pipeline.compute_images(plan, device, Clock())
    clocks, whole = [], []
    for number in range(repeat):
        tell(f"{plan.scenario.name}, {number + 1} of {repeat}")
        clock, start = Clock(), time.perf_counter()
        result = pipeline.compute_images(plan, device, clock)
        whole.append(time.perf_counter() - start)
        clocks.append(clock.seconds)
    seconds = {name: statistics.median(clock[name] for clock in clocks) for name in clocks[0]}
    return Runs(seconds, statistics.median(whole), result)


def _specs(plan: Plan) -> list[Spec]:
    """Returns the distinct specs that a run computes, those of all realisations."""
    return list(everything(spec for n in range(plan.realizations) for spec in plan.batch(n)))


def _works(specs: Sequence[Spec], segments: int) -> list[Work]:
    """Returns what the stages do whose throughput means something."""
    fields = [spec for spec in specs if isinstance(spec, AnyField)]
    voxels = [spec.lattice.voxels for spec in fields]
    moved = sum(
        FIELD_BYTES * spec.lattice.voxels * (1 if spec.isothermal else 2) for spec in fields
    )
    rays = sum(spec.geometry.raster.rays for spec in specs if isinstance(spec, EndsSpec))
    warm = any(isinstance(spec, EmissionSpec) for spec in specs)  # which reads two cubes
    shades = [spec for spec in specs if isinstance(spec, ShadeSpec)]
    shaded = sum(s.ends.geometry.raster.rays * s.spectrum.nodes_hz.shape[0] for s in shades)
    through = sum(map(_shading_bytes, shades))
    traces, copies = ("trace", "outgoing-path", "path-emission"), "memory-bandwidth"
    gathers = segments * (2 if warm else 1)
    return [
        Work("field", ("humidity-field",), "voxels", sum(voxels), copies, moved),
        Work("surfaces", KINDS, "rays", rays),
        Work("trace", traces, "segments", segments, "gather-coherent", gathers),
        Work("shading", ("shading",), "pixel_frequencies", shaded, copies, through),
    ]


def _shading_bytes(spec: ShadeSpec) -> int:
    """Returns the bytes that a shading reads and writes.

    It reads length, surface and moments of every ray, and writes depth and contrast.
    """
    real, rays = np.dtype(spec.ends.precision).itemsize, spec.ends.geometry.raster.rays
    return (4 + real) * rays + sum(spec.path.memory().held) + sum(spec.memory().held)


def _stages(
    plan: Plan, runs: Runs, roofline: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Returns every stage that the runs went through, and at last whole images."""
    found, left = [], dict(runs.seconds)
    for work in _works(_specs(plan), runs.result.voxel_segments):
        taken = [left.pop(stage) for stage in work.stages if work.amount and stage in left]
        if taken:
            seconds, share = sum(taken), {}
            if work.bound in roofline:
                reached = work.needed / seconds / _rate(roofline[work.bound])
                share = {"bound": work.bound, "share": reached}
            found.append(_row(work.name, seconds, work.unit, work.amount) | share)
    found += [{"name": name, "seconds": seconds} for name, seconds in left.items()]
    return [*found, _row("image", runs.whole, "images", len(plan.variants))]


def flat(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Returns stages and roofline as rows of the same columns; what does not apply is empty."""
    return [_flat(row) for row in (*found["stages"], *found["roofline"])]


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a row with its rate and that rate's unit in columns of their own."""
    rates = [key for key in row if key.endswith("_per_second")]
    rate, unit = "", ""
    if rates:
        rate, unit = row[rates[0]], rates[0].removesuffix("_per_second") + "/s"
    known = {"name": row["name"], "seconds": row["seconds"], "rate": rate, "unit": unit}
    return known | {key: row.get(key, "") for key in ("share", "bound")}


def _row(name: str, seconds: float, unit: str, amount: int) -> dict[str, Any]:
    return {"name": name, "seconds": seconds, unit: amount, f"{unit}_per_second": amount / seconds}


def _rate(row: Mapping[str, Any]) -> float:
    return next(float(value) for key, value in row.items() if key.endswith("_per_second"))


def _roofline(device: Device, plan: Plan, repeat: int, tell: Progress) -> dict[str, dict[str, Any]]:
    """Returns how fast the device copies memory and, for a cube, reads its voxels in two orders."""
    tell("memory bandwidth")
    rows = [_bandwidth(device, repeat)]
    cube = next((spec for spec in plan.specs() if isinstance(spec, AnyField)), None)
    if cube is not None:
        nx, ny, _ = cube.lattice.shape
        diagonal = 1, (nx * ny + nx + 1) << (32 - _log2_voxels(cube))
        for name, way, abreast in (("coherent", diagonal, ABREAST), ("random", RANDOM, 1)):
            tell(f"{name} gather")
            rows.append(_gather(device, f"gather-{name}", cube, way, abreast, repeat))
    return {row["name"]: row for row in rows}


def _log2_voxels(cube: AnyField) -> int:
    return cube.lattice.voxels.bit_length() - 1


def _bandwidth(device: Device, repeat: int) -> dict[str, Any]:
    """Returns the bytes that a copy reads and writes in a second."""
    program = device.build(CopyKernels(), "float32")
    one, other = (device.put(np.zeros(COPIED // 4, np.float32)) for _ in range(2))
    size, buffers = COPIED // 4 // program.lanes, {"from": one, "to": other}
    seconds = _timed(device, repeat, lambda: program.run("copy", size, **buffers))
    return _row("memory-bandwidth", seconds, "bytes", 2 * COPIED)


def _gather(
    device: Device, name: str, cube: AnyField, way: tuple[int, int], abreast: int, repeat: int
) -> dict[str, Any]:
    """Returns the voxels that a kernel reads in a second if it does nothing else.

    `way` holds factor and step from one voxel to the next, `abreast` is the number of rays in one.
    """
    precision = cube.precision
    program = device.build(GatherKernels(), precision)
    voxels, out = (
        device.put(np.zeros(cube.lattice.voxels), precision),
        device.empty((RAYS,), precision),
    )
    factor, step = (number & 0xFFFFFFFF for number in way)
    arguments = {"cube": voxels, "log2_voxels": _log2_voxels(cube), "abreast": abreast}
    arguments |= {"factor": factor, "step": step, "count": VOXELS_A_RAY, "out": out}
    size = RAYS // program.lanes
    seconds = _timed(device, repeat, lambda: program.run("gather", size, **arguments))
    return _row(name, seconds, "voxels", RAYS * VOXELS_A_RAY)


def _timed(device: Device, repeat: int, enqueue: Any) -> float:
    """Returns the median seconds from enqueue to finish, after once to warm up."""
    taken = []
    for _ in range(repeat + 1):
        start = time.perf_counter()
        enqueue()
        device.finish()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken[1:])
