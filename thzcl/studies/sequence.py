"""Sequences: frames of frozen air that the wind carries along, written as they come."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from thzcl import metrics, pipeline
from thzcl.clock import Clock, Progress
from thzcl.errors import ScenarioError
from thzcl.files import write_whole
from thzcl.graph import evaluate
from thzcl.plan import checks
from thzcl.plan.plan import Plan
from thzcl.results import frames
from thzcl.results.contents import VariantResult
from thzcl.results.netcdf import PLANE, Variable
from thzcl.results.result import Result
from thzcl.scenario import document as documents
from thzcl.sensor import Layer
from thzcl.studies.ensemble import Ensemble, Running

if TYPE_CHECKING:
    from thzcl.device.opencl import Device


@dataclass(frozen=True)
class SequenceResult:
    """A sequence that was written: the mean of its frames, and its files.

    `mean` holds the mean images with variance, spread and scintillation index over time, and all
    that a run tells.
    """

    mean: Result
    frames: int
    files: tuple[Path, ...]


def is_sequence(source: documents.Source, settings: Mapping[str, Any] | None = None) -> bool:
    """Returns whether a scene has frames. Raises ScenarioError if it cannot be read."""
    return "sequence" in documents.read(source, settings).data


def sequence(
    source: documents.Source,
    path: str | Path,
    *,
    settings: Mapping[str, Any] | None = None,
    variants: Sequence[str] = (),
    device: str | Device | None = None,
    figure: bool = True,
    allow_outside: bool = False,
    progress: Progress | None = None,
) -> SequenceResult:
    """Computes the frames of a scene's [sequence], and writes them to a NetCDF file.

    Frame n is taken at n / rate_hz, when the wind has moved the air by U n / rate_hz. The file has
    the dimension `time` first, and mean, variance and scintillation index of the image over time;
    with `figure` the frames are shown in a GIF beside it. The other arguments are those of `run`.
    Memory does not grow with the number of frames. Files are written whole or not at all.
    """
    clock, path = Clock(progress), Path(path)
    with clock.stage("plan"):
        plan = pipeline.prepare(source, settings, variants, allow_outside=allow_outside)
    if not plan.frames:
        raise ScenarioError([f"{plan.scenario.name}: has no [sequence]; give it rate_hz, frames"])
    with clock.stage("device"):
        from thzcl.device.choose import open_device
        from thzcl.device.opencl import Device

        opened = device if isinstance(device, Device) else open_device(device)
    made: list[tuple[Result, frames.Shown]] = []
    write_whole(path, lambda part: made.append(_written(plan, opened, clock, part)))
    mean, shown = made[0]
    files = [path]
    if figure:
        with clock.stage("figure"):
            files.append(path.with_suffix(".gif"))
            write_whole(files[1], partial(frames.moving_picture, path, shown=shown))
    return SequenceResult(mean, plan.frames, tuple(files))


def _written(plan: Plan, device: Device, clock: Clock, path: Path) -> tuple[Result, frames.Shown]:
    """Writes the frames of a plan, and returns their mean and how they are to be shown."""
    over_time = [_OverTime() for _ in plan.variants]
    rate_hz = plan.variants[0].scene.sequence.rate_hz if plan.variants[0].scene.sequence else 1.0
    limits = _Limits()
    with frames.Writer(path, np.arange(plan.frames) / rate_hz) as file:
        for number, frame in enumerate(images(plan, device, clock)):
            clock.counted(number + 1, plan.frames)
            if number == 0:
                first = frame
            with clock.stage("file"):
                file.add(frame)
            for statistics, variant in zip(over_time, frame.variants, strict=True):
                statistics.add(variant)
            limits.add(frame)
        mean = replace(first, variants=tuple(one.mean() for one in over_time))
        with clock.stage("file"):
            file.finish(mean, _statistics(mean))
    image = first.variants[0].image
    assert image is not None  # noqa: S101 (images() raises where there is none)
    return mean, frames.Shown(limits.of(first), image.quantity, image.unit)


def images(plan: Plan, device: Device, clock: Clock) -> Iterator[Result]:
    """Yields each frame of a sequence as a result of its own.

    Raises ScenarioError if the device's memory is too small, and NumbersError if a sensor fails.
    """
    checks.memory(plan, device)
    stream = evaluate((plan.frame(number) for number in range(plan.frames)), device, clock)
    first = pipeline.images_of(plan, stream, device, clock)
    yield first
    for values in stream:
        yield pipeline.frame_of(plan, values, first)


class _OverTime:
    """Mean, variance and scintillation index of one variant's images over time."""

    def __init__(self) -> None:
        self._ensemble = Ensemble(by_pixel=False)
        self._linear = Running()

    def add(self, variant: VariantResult) -> None:
        """Adds a frame."""
        assert variant.image is not None  # noqa: S101 (images() raises where there is none)
        self._ensemble.add(variant)
        self._linear.add(metrics.linear(variant.image)[0])

    def mean(self) -> VariantResult:
        """Returns the mean with its statistics as layers."""
        mean = self._ensemble.mean()
        image = mean.image
        assert image is not None  # noqa: S101 (see above)
        square = np.square(self._linear.mean)
        index = np.divide(
            self._linear.variance, square, out=np.zeros_like(square), where=square > 0
        )
        quantity = "scintillation index: variance over time, over the square of the mean"
        layers = dict(image.layers) | {"scintillation_index": Layer(index, "1", quantity)}
        return replace(mean, image=replace(image, layers=layers))


class _Limits:
    """What is black and white in all frames: the ends of the frames' own stretches."""

    def __init__(self) -> None:
        self._ends: list[tuple[float, float]] = []

    def add(self, frame: Result) -> None:
        """Adds a frame."""
        values = np.stack([v.image.values for v in frame.variants if v.image is not None])
        low, high = np.percentile(values, frames.STRETCH_PERCENT)
        self._ends.append((float(low), float(high)))

    def of(self, first: Result) -> tuple[float, float]:
        """Returns the limits: those that the scene gives, or those of all frames."""
        if not isinstance(first.limits, str):
            return first.limits
        lows, highs = zip(*self._ends, strict=True)
        low, high = min(lows), max(highs)
        return low, high if low < high else low + 1.0


def _statistics(mean: Result) -> dict[str, Variable]:
    """Returns mean, variance and scintillation index of all images, (variant, y, x)."""
    shown = [variant.image for variant in mean.variants if variant.image is not None]
    first = shown[0]
    found = {
        "image_mean": Variable(
            ("variant", *PLANE),
            np.stack([image.values for image in shown]),
            {"units": first.unit, "long_name": f"mean {first.quantity} over time"},
        )
    }
    for name in ("image_variance", "scintillation_index"):
        layer = first.layers[name]
        found[name] = Variable(
            ("variant", *PLANE),
            np.stack([image.layers[name].values for image in shown]),
            {"units": layer.unit, "long_name": layer.quantity.replace("realisations", "time")},
        )
    return found
