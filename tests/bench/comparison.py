"""Ours and theirs, the same rays through the same cube, timed in turn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba_march
import numpy as np
import rivals
import timing
from setting import OneLane, Setting, make
from timing import Record

from thzcl.device.opencl import Device

VOXELS_M = (0.5, 0.25, 0.1)
BEARABLE = 1e-3  # rms error of the contrast, relative to the largest
FASTER = {0.5: 1.2, 0.25: 1.2, 0.1: 1.2}  # than Numba, by voxel size
THINNED_FASTER = {0.5: 6.0, 0.1: 15.0}
STRIDES = (16, 8, 4, 2, 1)
EXACT, THINNED, PLAIN = (
    "thzcl, every ray",
    "thzcl, thinned",
    "thzcl's kernel, one work-item a pixel",
)
NUMPY, NUMBA_64, NUMBA_32, MITSUBA = (
    "NumPy, fixed steps",
    "Numba, float64",
    "Numba, float32",
    "Mitsuba 3",
)


def compare(device: Device, repeat: int) -> list[dict[str, Any]]:
    """Returns a table for each voxel size."""
    return [_table(device, voxel_m, repeat) for voxel_m in VOXELS_M]


def claims(tables: list[dict[str, Any]]) -> list[Record]:
    """Returns how much faster than Numba thzcl is: with every ray, and at a bearable error."""
    found = []
    for table in tables:
        rows = {row["name"]: row for row in table["methods"]}
        numba = [rows[name] for name in (NUMBA_64, NUMBA_32) if name in rows]
        for kind, key, bound in (
            ("every ray", "times_ours", FASTER),
            ("thinned", "times_ours_thinned", THINNED_FASTER),
        ):
            if table["voxel_m"] in bound:
                least = min((row[key] for row in numba), default=None)
                name, note = (
                    f"{kind}, {table['voxel_m']:g} m, against Numba",
                    "" if numba else "numba is not installed",
                )
                found.append(
                    Record(
                        name,
                        least,
                        bound[table["voxel_m"]],
                        "times faster",
                        at_least=True,
                        note=note,
                    )
                )
    return found


def _table(device: Device, voxel_m: float, repeat: int) -> dict[str, Any]:
    timing.tell(f"comparison at {voxel_m} m")
    settings = {"atmosphere.fluctuations.voxel_m": voxel_m}
    exact, thinned = make(device, settings), _thinned(device, settings)
    plain = make(OneLane(device.context.devices[0], device.info), settings)
    rays = {EXACT: exact, THINNED: thinned, PLAIN: plain}
    theirs = _rivals(exact)
    seconds = timing.alternate(
        {**{name: _once(one.trace) for name, one in rays.items()}, **_timed(theirs)}, repeat
    )
    seconds[NUMPY] *= rivals.PART
    errors = {name: one.error(np.exp(-one.depth(one.trace()))) for name, one in rays.items()}
    errors |= {
        name: exact.error(call() if name == MITSUBA else np.exp(-call()))
        for name, call in theirs.items()
    }
    segments = exact.segments()
    rows = [_row(name, seconds, errors, segments, thinned.path.stride) for name in seconds]
    missing = [name for name in (NUMBA_64, MITSUBA) if name not in seconds]
    return {
        "voxel_m": voxel_m,
        "rays": exact.rays,
        "segments": segments,
        "methods": rows,
        "not_installed": missing,
    }


def _thinned(device: Device, settings: dict[str, Any]) -> Setting:
    """Returns the setting of the widest stride whose measured error is bearable.

    Its polynomial is the one that goes with that tolerance.
    """
    for stride in STRIDES:
        one = make(
            device, settings | {"numerics.tolerance": BEARABLE, "numerics.ray_stride": stride}
        )
        if one.error(np.exp(-one.depth(one.trace()))) <= BEARABLE:
            return one
    raise ValueError("tracing every ray errs by more than can be borne")


def _rivals(exact: Setting) -> dict[str, Callable[[], np.ndarray]]:
    found = {NUMPY: rivals.numpy_march(exact)}
    if rivals.has_numba():
        found |= {
            NUMBA_64: rivals.numba_march(exact),
            NUMBA_32: rivals.numba_march(exact, np.float32),
        }
    if mitsuba_march.has_mitsuba():
        found[MITSUBA] = mitsuba_march.mitsuba_march(exact)
    return found


def _once(call: Callable[[], object]) -> Callable[[], None]:
    """Returns a call that returns nothing, since what a call returns counts as its time."""

    def timed() -> None:
        call()

    return timed


def _timed(calls: dict[str, Callable[[], np.ndarray]]) -> dict[str, Callable[[], None]]:
    return {name: _once(call) for name, call in calls.items()}


def _row(
    name: str, seconds: dict[str, float], errors: dict[str, float], segments: int, stride: int
) -> dict[str, Any]:
    """Returns a row of the comparison; `times_ours` is how many times as long as ours it takes.

    Mitsuba's time is that of as many samples as our error would need.
    """

    def scaled(other: str) -> float:
        more = (errors[name] / errors[other]) ** 2 if name == MITSUBA else 1.0
        return seconds[name] * more / seconds[other]

    notes = {
        THINNED: f"ray_stride {stride}, fewest moments for a tolerance of {BEARABLE:g}",
        NUMPY: f"steps of {rivals.STEP} voxels; "
        f"every {rivals.PART}th row timed, times {rivals.PART}",
        MITSUBA: f"{mitsuba_march.VARIANT}, {mitsuba_march.SAMPLES} samples a pixel; "
        "ratios for as many as equal error takes",
    }
    return {
        "name": name,
        "seconds": seconds[name],
        "segments_per_second": None
        if name in (THINNED, NUMPY, MITSUBA)
        else segments / seconds[name],
        "error": errors[name],
        "times_ours": scaled(EXACT),
        "times_ours_thinned": scaled(THINNED),
        "note": notes.get(name, ""),
    }
