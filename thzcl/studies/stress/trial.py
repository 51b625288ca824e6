"""Runs stress cases and judges them: a measured number, its reference and the error."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thzcl import pipeline
from thzcl.clock import Clock, Progress
from thzcl.device.choose import open_device
from thzcl.device.opencl import Device
from thzcl.errors import NumbersError
from thzcl.results.result import Result
from thzcl.scenario.scene import Scene
from thzcl.sensor import Echoes, Image, Radiances
from thzcl.studies.stress import things
from thzcl.studies.stress.truth import Truth, truth

Array = NDArray[np.float64]
SINGLE, DOUBLE = "float32", "float64"

BASE = """\
[camera]
position_m = [0.3, -0.2, 2.1]
look_at_m = [9.3, 3.4, 4.0]
focal_length_mm = 30.0
focal_plane_mm = [6.0, 4.0]
pixels = [3, 2]

[atmosphere]
temperature_k = 290.0
relative_humidity_percent = 70.0

[atmosphere.fluctuations]
sigma_percent = 20.0
voxel_m = 0.7
grid = 16
seed = 3

[background]
temperature_k = 310.0
max_range_m = 30.0

[sensor]
kind = "passive-spectral"
frequency_ghz = 650.0

[output]
save_field = true
"""


class Measurement(NamedTuple):
    """A measured number, its reference, and the error relative to a quantity that is not zero."""

    measured: float
    reference: float
    error: float


NOT_FINITE = Measurement(math.nan, math.nan, math.inf)


@dataclass(frozen=True)
class Run:
    """The scene and the result of a case."""

    scene: Scene
    result: Result

    @property
    def sight(self) -> Radiances | Echoes:
        """Returns what reached the pixels."""
        return self.result.variants[0].sight

    @property
    def radiances(self) -> Radiances:
        """Returns what reached the pixels of a passive sensor."""
        return self.result.variants[0].radiances

    @property
    def image(self) -> Image:
        """Returns the image. Raises ValueError if the sensor failed."""
        image = self.result.variants[0].image
        if image is None:
            raise ValueError("the sensor failed")
        return image

    @cached_property
    def truth(self) -> Truth:
        """Returns what should have reached the pixels."""
        cube = self.result.cubes[0] if self.result.cubes else None
        return truth(self.scene, self.sight.frequency_hz, cube)


Judge = Callable[[Run], Measurement]


@dataclass(frozen=True)
class Case:
    """A name, changes to the base scene by dotted key, and judges of its run with their bounds.

    The bounds of a judge are by precision. The case is run in each precision for which one of its
    judges has a bound.
    """

    name: str
    changes: Mapping[str, Any]
    judges: Mapping[str, tuple[Judge, Mapping[str, float]]]

    @property
    def precisions(self) -> list[str]:
        """Returns the precisions in which the case is run."""
        bounded = {precision for _, bounds in self.judges.values() for precision in bounds}
        return [precision for precision in (SINGLE, DOUBLE) if precision in bounded]


@dataclass(frozen=True)
class Outcome:
    """One row of the table: one judge's measurement of one case in one precision."""

    case: str
    judge: str
    precision: str
    measured: float
    reference: float
    error: float
    bound: float

    @property
    def name(self) -> str:
        """Returns the name of the row in the table."""
        return f"{self.case}: {self.judge}, {self.precision}"

    @property
    def passed(self) -> bool:
        """Returns whether the error is within the bound; NaN never passes."""
        return self.error <= self.bound

    def record(self) -> dict[str, Any]:
        """Returns the row for JSON, in which numbers that are not finite are null."""
        numbers = {key: getattr(self, key) for key in ("measured", "reference", "error", "bound")}
        finite = {key: value if math.isfinite(value) else None for key, value in numbers.items()}
        return {"name": self.name} | finite | {"passed": self.passed}


def worst(measured: ArrayLike, reference: ArrayLike, scale: ArrayLike | None = None) -> Measurement:
    """Returns the value with the largest error, relative to `scale` or else to the reference."""
    values, right = np.broadcast_arrays(
        np.asarray(measured, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    )
    relative_to = right if scale is None else np.broadcast_to(scale, right.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(values - right) / np.abs(relative_to)
    error = np.where(np.isnan(error), np.inf, error)
    at = np.unravel_index(int(error.argmax()), error.shape)
    return Measurement(float(values[at]), float(right[at]), float(error[at]))


def examine(
    cases: Iterable[Case], device: str | None = None, progress: Progress | None = None
) -> Iterator[Outcome]:
    """Runs cases in each of their precisions, all on one device, and yields their outcomes.

    `device` is a number or a part of a device's name. Raises DeviceError if no device is usable.
    """
    opened = open_device(device)
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder) / "stress.toml"
        base.write_text(BASE, encoding="utf-8")
        things.write_wall(base.parent)
        for case in cases:
            for precision in case.precisions:
                if progress:
                    progress(case.name)
                yield from _examine(case, precision, base, opened)


def _examine(case: Case, precision: str, base: Path, device: Device) -> Iterator[Outcome]:
    """Runs a case in one precision, and yields the outcome of each judge.

    All of them fail if the run fails because a number is not finite.
    """
    plan = pipeline.prepare(base, {**case.changes, "numerics.precision": precision})
    try:
        run = Run(plan.variants[0].scene, pipeline.compute_images(plan, device, Clock()))
    except NumbersError:
        run = None
    for name, (judge, bounds) in case.judges.items():
        if precision in bounds:
            measurement = NOT_FINITE if run is None else judge(run)
            yield Outcome(case.name, name, precision, *measurement, bounds[precision])
