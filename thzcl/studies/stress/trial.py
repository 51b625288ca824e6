"""Runs cases and judges them: what was measured, what it should be, and the error.

Of a quantity that is not zero.
"""

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

from thzcl import pipeline, scenario
from thzcl.clock import Progress
from thzcl.plan.checks import NumbersError
from thzcl.plugins import loader as plugins
from thzcl.results.result import Result
from thzcl.scenario import Scene, toml
from thzcl.sensor import Echoes, Image, Radiances
from thzcl.studies.stress.reference import Truth, truth

Array = NDArray[np.float64]
SINGLE, DOUBLE = "float32", "float64"

BASE: dict[str, Any] = {
    "camera": {
        "position_m": [0.3, -0.2, 2.1],
        "look_at_m": [9.3, 3.4, 4.0],
        "focal_length_mm": 30.0,
        "focal_plane_mm": [6.0, 4.0],
        "pixels": [3, 2],
    },
    "atmosphere": {
        "temperature_k": 290.0,
        "relative_humidity_percent": 70.0,
        "fluctuations": {"sigma_percent": 20.0, "voxel_m": 0.7, "grid": 16, "seed": 3},
    },
    "background": {"temperature_k": 310.0, "max_range_m": 30.0},
    "sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0},
    "output": {"save_field": True},
}


class Measurement(NamedTuple):
    """A number, what it should be, and how far off the worst of its kind is.

    Relative to what the case makes non-zero.
    """

    measured: float
    reference: float
    error: float


@dataclass(frozen=True)
class Run:
    """A case that was run."""

    scene: Scene
    result: Result

    @property
    def sight(self) -> Radiances | Echoes:
        """What reaches the pixels."""
        return self.result.variants[0].sight

    @property
    def radiances(self) -> Radiances:
        """The same, of a passive sensor."""
        return self.result.variants[0].radiances

    @property
    def image(self) -> Image:
        """What the sensor made of it."""
        image = self.result.variants[0].image
        if image is None:
            raise ValueError("the sensor failed")
        return image

    @cached_property
    def truth(self) -> Truth:
        """What should reach them."""
        cube = self.result.cubes[0] if self.result.cubes else None
        return truth(self.scene, self.sight.frequency_hz, cube)


Judge = Callable[[Run], Measurement]


@dataclass(frozen=True)
class Case:
    """Changes to the base scene, by dotted key, and what is to hold of the run: by name, a judge and its bounds.

    Bounds are by precision, and those that are named are run.
    """

    name: str
    changes: Mapping[str, Any]
    judges: Mapping[str, tuple[Judge, Mapping[str, float]]]

    @property
    def precisions(self) -> list[str]:
        """Those that any judge has a bound for."""
        return [
            p for p in (SINGLE, DOUBLE) if any(p in bounds for _, bounds in self.judges.values())
        ]


@dataclass(frozen=True)
class Outcome:
    """One line of the table; numbers are null in JSON where they are not finite."""

    case: str
    name: str
    measured: float
    reference: float
    error: float
    bound: float

    @property
    def passed(self) -> bool:
        """Whether the error is within the bound; what is not a number is not."""
        return self.error <= self.bound

    def record(self) -> dict[str, Any]:
        """For JSON."""
        numbers = {key: getattr(self, key) for key in ("measured", "reference", "error", "bound")}
        finite = {key: value if math.isfinite(value) else None for key, value in numbers.items()}
        return {"name": self.name} | finite | {"passed": self.passed}


def worst(measured: ArrayLike, reference: ArrayLike, scale: ArrayLike | None = None) -> Measurement:
    """The value that is farthest off, relative to `scale`, by default to the reference itself."""
    found, right = np.broadcast_arrays(
        np.asarray(measured, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.abs(found - right) / np.abs(
            right if scale is None else np.broadcast_to(scale, right.shape)
        )
    error = np.where(np.isnan(error), np.inf, error)
    at = np.unravel_index(int(error.argmax()), error.shape)
    return Measurement(float(found[at]), float(right[at]), float(error[at]))


def examine(
    cases: Iterable[Case], device: str | None = None, progress: Progress | None = None
) -> Iterator[Outcome]:
    """Runs the cases in each precision and judges them.

    Raises DeviceError without a usable device.
    """
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder) / "stress.toml"
        base.write_text(toml.dumps(BASE), encoding="utf-8")
        for case in cases:
            for precision in case.precisions:
                if progress:
                    progress(case.name)
                yield from _examine(case, precision, base, device)


def _examine(case: Case, precision: str, base: Path, device: str | None) -> Iterator[Outcome]:
    settings = {**case.changes, "numerics.precision": precision}
    scene = scenario.parse(scenario.read(base, settings), plugins.troubles).variants[0].scene
    try:
        run = Run(scene, pipeline.run(base, settings=settings, device=device, figure=False))
    except NumbersError:  # a number that is not finite: failed, whatever is asked
        run = None
    for name, (judge, bounds) in case.judges.items():
        if precision in bounds:
            found = Measurement(math.nan, math.nan, math.inf) if run is None else judge(run)
            yield Outcome(case.name, f"{case.name}: {name}, {precision}", *found, bounds[precision])
