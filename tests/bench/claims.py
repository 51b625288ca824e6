"""What thzcl claims of its speed, each claim measured: a function a claim, giving records."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import processes
import rivals
import setting
from timing import Record, alternate, stages, tell

from thzcl import pipeline
from thzcl.device.opencl import Device
from thzcl.plan import memory
from thzcl.plan.plan import Plan
from thzcl.studies import bench as benchmark
from thzcl.turbulence.fields import AnyField

FIVE_GHZ = [640, 645, 650, 655, 660]
MANY_GHZ = [600 + i for i in range(101)]
TRACED = ("trace", "shading")
GATHERED = ("stages", "trace"), ("roofline", "gather-coherent")
QUIET = {"numerics.error_budget": False}


def planned(
    name: str, settings: Mapping[str, Any], variants: tuple[str, ...] = (setting.VARIANT,)
) -> Plan:
    return pipeline.prepare(name, QUIET | dict(settings), variants if name == "slide" else ())


def trace_alone(_device: Device, repeat: int) -> list[Record]:
    """Voxel segments a second, and what share that is of a kernel that only gathers."""
    found = benchmark.bench("slide", settings=QUIET, variants=(setting.VARIANT,), repeat=repeat)
    trace, gather = (
        next(row for row in found[kind] if row["name"] == name) for kind, name in GATHERED
    )
    gathered = f"{gather['voxels_per_second'] / 1e9:.3g} G voxels/s"
    note = f"{100 * trace['share']:.0f} % of a kernel that only gathers, {gathered}"
    return [
        Record(
            "trace of slide",
            trace["segments_per_second"] / 1e9,
            1.0,
            "G segments/s",
            at_least=True,
            note=note,
        )
    ]


def six_panels(device: Device, repeat: int) -> list[Record]:
    """Six panels at five frequencies from one trace, against 30 Numba loops, one for each."""
    name = "six panels at five frequencies, against 30 Numba loops"
    claim = Record(name, None, 10.0, "times faster", at_least=True, note="numba is not installed")
    if not rivals.has_numba():
        return [claim]
    ours = stages(planned("slide", {"sensor.frequency_ghz": FIVE_GHZ}, ()), device, *TRACED)
    one = setting.make(device, {"sensor.frequency_ghz": FIVE_GHZ})
    loops = [rivals.numba_march(one, absorption=one.absorption_at(f)) for f in range(len(FIVE_GHZ))]

    def theirs() -> None:
        for loop in loops:
            loop()

    seconds = alternate({"ours": ours, "theirs": theirs}, repeat)
    timed = "the loops of one panel timed, times six, surfaces' radiances not added"
    faster = 6 * seconds["theirs"] / seconds["ours"]
    return [claim._replace(measured=faster, note=f"trace and shading; {timed}")]


def linear(device: Device, repeat: int) -> list[Record]:
    """Time of trace and shading by the pixel and by the metre: at most in proportion."""
    sides = (256, 512, 1024, 2048)
    pixels = {n * n: planned("slide", {"camera.pixels": [n, n]}) for n in sides}
    # Upwards past the box, so that rays end where they are told to; 340 GHz is a window that 800 m
    # do not close.
    up = {"camera.look_at_m": [50, 40, 25], "sensor.frequency_ghz": 340}
    metres = {
        m: planned("slide", up | {"background.max_range_m": float(m)})
        for m in (50, 100, 200, 400, 800)
    }
    return [
        _straight("time by pixels, 256^2 to 2048^2", device, pixels, repeat),
        _straight("time by path, 50 to 800 m", device, metres, repeat),
    ]


def _straight(name: str, device: Device, plans: Mapping[int, Plan], repeat: int) -> Record:
    """Returns how much more than in proportion times grow from the smallest size on.

    It is less than 0 where fixed costs count.
    """
    taken = alternate(
        {str(size): stages(plan, device, *TRACED) for size, plan in plans.items()}, repeat
    )
    sizes, seconds = np.array(list(plans), dtype=np.float64), np.array(list(taken.values()))
    note = ", ".join(f"{size}: {1e3 * s:.3g} ms" for size, s in taken.items())
    growth = (seconds[1:] / seconds[0]) / (sizes[1:] / sizes[0]) - 1
    return Record(f"{name}: growth beyond proportion", float(growth.max()), 0.2, "1", note=note)


def many_frequencies(device: Device, repeat: int) -> list[Record]:
    """101 frequencies in the time of one and a half: spectral, and a band of them."""
    band = {
        "kind": "passive-broadband",
        "center_ghz": 650,
        "bandwidth_ghz": 100,
        "quadrature": "paper",
        "step_ghz": 1.0,
    }
    plans = {
        "one": planned("slide", {}),
        "101 frequencies": planned("slide", {"sensor.frequency_ghz": MANY_GHZ}),
        "a band of 101": planned("slide", {"sensor": band}),
    }
    seconds = alternate(
        {name: stages(plan, device, *TRACED) for name, plan in plans.items()}, repeat
    )
    counts = {name: f"{len(plan.frequency_hz)} frequencies" for name, plan in plans.items()}
    names = list(plans)[1:]
    return [
        Record(f"{n}, against one", seconds[n] / seconds["one"], 1.5, "times", note=counts[n])
        for n in names
    ]


def fluctuating_temperature(device: Device, repeat: int) -> list[Record]:
    """Emission along the path carries five frequencies abreast."""
    warm = {"atmosphere.fluctuations.temperature_sigma_k": 0.5}
    plans = {
        "one": planned("slide", warm),
        "five": planned("slide", warm | {"sensor.frequency_ghz": FIVE_GHZ}),
    }
    parts = ("path-emission", "shading")
    seconds = alternate(
        {name: stages(plan, device, *parts) for name, plan in plans.items()}, repeat
    )
    return [
        Record(
            "temperature fluctuates: 5 frequencies, against one",
            seconds["five"] / seconds["one"],
            2.5,
            "times",
        )
    ]


def field(device: Device, repeat: int) -> list[Record]:
    """A field against the two costly parts of one by SciPy and NumPy, and how it grows."""
    plans = {
        n: planned("slide", {"atmosphere.fluctuations.grid": n, "camera.pixels": [16, 16]})
        for n in (128, 256)
    }
    calls: dict[str, Callable[[], Any]] = {
        str(n): stages(plan, device, "humidity-field") for n, plan in plans.items()
    }
    parts = rivals.field_parts(128, 1)
    seconds = alternate(calls | {"SciPy and NumPy": lambda: void(parts())}, repeat)
    note = ", ".join(f"{name}: {1e3 * spent:.3g} ms" for name, spent in seconds.items())
    grown = seconds["256"] / seconds["128"] / (8 * math.log(256) / math.log(128))
    return [
        Record(
            "field of 128^3, against irfftn and normals",
            seconds["128"] / seconds["SciPy and NumPy"],
            2.0,
            "times",
            note=note,
        ),
        Record("field of 256^3: growth beyond N^3 log N from 128^3", grown - 1, 0.2, "1"),
    ]


def void(_: object) -> None:
    """Returns nothing, since what a call returns counts as its time."""


def uniform(device: Device, repeat: int) -> list[Record]:
    """Uniform air has no field and no trace, and pays for neither."""
    plans = {"uniform": planned("uniform", {}), "slide": planned("slide", {})}
    parts = ("humidity-field", "trace")
    seconds = alternate(
        {name: stages(plan, device, *parts) for name, plan in plans.items()}, repeat
    )
    cubes = [spec for spec in plans["uniform"].specs() if isinstance(spec, AnyField)]
    cube = sum(size for spec in cubes for size in spec.memory().held)
    saved = (memory.needed(plans["slide"])[0] - memory.needed(plans["uniform"])[0]) / 2**20
    return [
        Record(
            "uniform: field and trace, against slide's",
            seconds["uniform"] / seconds["slide"],
            0.05,
            "times",
        ),
        Record(
            "uniform: memory of the field",
            cube,
            0,
            "bytes",
            note=f"slide plans {saved:.0f} MiB more",
        ),
    ]


def ensemble(device: Device, repeat: int) -> list[Record]:
    """A hundred realisations of 128^3 voxels and 256 x 256 pixels."""
    name, count = "100 realisations of 128^3, 256 x 256 pixels", 100
    plan = planned("slide", {"numerics.realizations": count, "camera.pixels": [256, 256]})
    seconds = alternate({"all": stages(plan, device)}, min(repeat, 3))
    return [Record(name, count / seconds["all"], 8.0, "images/s", at_least=True)]


def whole_process(_device: Device, repeat: int) -> list[Record]:
    """`thzcl run slide --no-figure` warm, against a bare import of what it imports, and cold."""
    seconds = processes.measure(repeat)
    note = ", ".join(f"{name}: {spent:.2f} s" for name, spent in seconds.items())
    return [
        Record(
            "whole process, warm, against its bare imports",
            seconds["warm"] / seconds["imports"],
            2.8,
            "times",
            note=note,
        ),
        Record(
            "whole process, cold, against warm", seconds["cold"] / seconds["warm"], 3.0, "times"
        ),
    ]


CLAIMS = (
    trace_alone,
    six_panels,
    linear,
    many_frequencies,
    fluctuating_temperature,
    field,
    uniform,
    ensemble,
    whole_process,
)


def measure(device: Device, repeat: int, only: str = "") -> list[Record]:
    """Returns every claim's records, or those of functions whose name holds `only`."""
    found = []
    for claim in CLAIMS:
        if only in claim.__name__:
            tell(claim.__name__.replace("_", " "))
            found += claim(device, repeat)
    return found
