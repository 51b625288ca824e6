"""What is looked at before anything is computed, and before it is believed: scenes, memory.

Numbers, what sensors return.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from thzcl import scenario
from thzcl.plan.plan import Plan, VariantPlan
from thzcl.plan import report as overview
from thzcl.plugins import loader as plugins
from thzcl.results.result import Result
from thzcl.scenario import Document, ScenarioError, Trouble
from thzcl.sensor import Echoes, Image, Layer, Radiances
from thzcl.surfaces.geometry import camera_frame, directions
from thzcl.turbulence.spectra import Turbulence

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

Sight = Radiances | Echoes


class NumbersError(Exception):
    """A sensor failed, or a number is not finite; `result` keeps what was computed before."""

    def __init__(self, text: str, result: Result) -> None:
        super().__init__(text)
        self.result = result


def together(document: Document, plan: Plan) -> None:
    """What the sensors ask of the scenes, and the variants of each other. Raises ScenarioError."""
    troubles = []
    first = plan.variants[0]
    for variant in plan.variants:
        scene = variant.scene
        troubles += (
            _transmitter_troubles(variant)
            if variant.needs.reflection
            else _temperature_troubles(scene)
        )
        if scene.camera.pixels != first.scene.camera.pixels:
            text = "all variants must have the same pixels, to stand in one file; run them apart with --variant"
            troubles.append(Trouble(("camera", "pixels"), text))
        if scene.numerics.realizations != first.scene.numerics.realizations:
            troubles.append(
                Trouble(
                    ("numerics", "realizations"), "all variants must have as many; give it once"
                )
            )
        if scene.numerics.realizations > 1 and (
            variant.field is None or not isinstance(variant.field.source, Turbulence)
        ):
            text = "needs air that fluctuates at random: [atmosphere.fluctuations] with a sigma or structure constant above 0"
            troubles.append(Trouble(("numerics", "realizations"), text))
        bands = [
            len(v.frequency_hz) if v.weights is None else len(v.weights) for v in (first, variant)
        ]
        if bands[0] != bands[1] or variant.needs.reflection != first.needs.reflection:
            text = "all variants must be of one kind, with as many frequencies, to stand in one file; use --variant"
            troubles.append(Trouble(("sensor",), text))
    if troubles:
        raise ScenarioError(document.problems(troubles))


def _temperature_troubles(scene: scenario.Scene) -> list[Trouble]:
    """A passive sensor sees the emission of everything: all must have temperatures."""
    found = []
    if scene.ground is not None and scene.ground.temperature_k is None:
        found.append(
            Trouble(
                ("ground", "temperature_k"), "missing; a passive sensor sees the ground's emission"
            )
        )
    for name, target in scene.targets.items():
        if target.temperature_k is None and getattr(target, "quantity", "") != "temperature":
            text = "missing; a passive sensor sees the target's emission"
            found.append(Trouble(("targets", name, "temperature_k"), text))
    return found


def _transmitter_troubles(variant: VariantPlan) -> list[Trouble]:
    """A transmitter stands in the open."""
    place, found = variant.needs.transmitter_m, []
    if place is None:
        return []
    if variant.scene.ground is not None and place[2] <= 0:
        found.append(
            Trouble(
                ("sensor",),
                f"the transmitter is at z = {place[2]:g} m, not above the ground; raise it",
            )
        )
    for name, target in variant.scene.targets.items():
        if isinstance(target, scenario.Box) and target.holds(place):
            found.append(
                Trouble(("sensor",), f'the transmitter stands inside the target "{name}"; move it')
            )
    return found


def memory(plan: Plan, device: Device) -> None:
    """Refuses what the device cannot hold, before anything is allocated. Raises ScenarioError."""
    total, largest = overview.memory(plan)
    advice = "lower grid, pixels, samples_per_pixel or the number of frequencies, or run variants apart with --variant"
    if total > device.memory_bytes:
        have = f"{device.info.name} has {device.memory_bytes / 2**30:.1f} GiB"
        raise ScenarioError(
            [f"{plan.scenario.name}: needs {total / 2**30:.1f} GiB, but {have}; {advice}"]
        )
    if largest > device.largest_buffer:
        have = f"{device.info.name} allows {device.largest_buffer / 2**30:.1f} GiB"
        raise ScenarioError(
            [
                f"{plan.scenario.name}: needs one array of {largest / 2**30:.1f} GiB, but {have}; {advice}"
            ]
        )


def finite(variant: VariantPlan, sight: Sight, so_far: Result) -> None:
    """No image with holes goes to a sensor.

    Raises NumbersError naming the first pixel that is not a number, and its ray.
    """
    planes = [sight.optical_depth, sight.returned if isinstance(sight, Echoes) else sight.contrast]
    if all(
        np.isfinite(plane.sum(dtype=np.float64)) or np.isfinite(plane).all() for plane in planes
    ):
        return
    bad = ~np.all([np.isfinite(plane).all(axis=0) for plane in planes], axis=0)
    row, column = (int(n) for n in np.argwhere(bad)[0])
    rows, columns = bad.shape
    middle = replace(
        variant.geometry,
        raster=replace(variant.geometry.raster, rows=rows, columns=columns, margin=0),
    )
    frame = camera_frame(variant.scene.camera, middle.raster)
    x, y, z = directions(replace(middle, frame=frame), np.array([row]), np.array([column]))[0]
    a, b, c = variant.scene.camera.position_m
    raise NumbersError(
        f"{variant.name}: {int(bad.sum())} pixels are not finite numbers; the first is row {row}, column {column}, whose ray "
        f"runs from ({a:g}, {b:g}, {c:g}) m along ({x:.6g}, {y:.6g}, {z:.6g}); please report the scene",
        so_far,
    )


def observe(variant: VariantPlan, sight: Sight, rng: np.random.Generator, so_far: Result) -> Image:
    """The sensor's image, checked. Raises NumbersError naming the plugin, the radiances kept."""

    def failed(reason: str) -> NumbersError:
        return NumbersError(
            f"{plugins.describe(variant.scene.sensor.kind)}, {variant.name}: {reason}", so_far
        )

    try:
        image = variant.sensor.observe(sight, rng)
    except (Exception, SystemExit) as error:  # whatever a stranger's sensor raises
        raise failed(f"{type(error).__name__}: {error}") from error
    if not isinstance(image, Image) or not all(
        isinstance(layer, Layer) for layer in image.layers.values()
    ):
        raise failed(f"returned {type(image).__name__} instead of an Image, and of Layers")
    shape = sight.target.shape
    planes = {"image": image.values} | {name: layer.values for name, layer in image.layers.items()}
    for name, values in planes.items():
        if np.shape(values) != shape:
            raise failed(f"returned {name} of shape {np.shape(values)}; the image has {shape}")
        if np.asarray(values).dtype.kind not in "fiub":
            raise failed(f"returned {name} whose values are not numbers")
        if not np.isfinite(values).all():
            raise failed(f"returned {name} with values that are not finite")
    return image
