"""Checks a plan before anything is computed: its variants, its sensors and its memory."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from thzcl.device.opencl import Device
from thzcl.errors import ScenarioError
from thzcl.plan.memory import needed
from thzcl.plan.plan import Plan
from thzcl.plan.variant import PlannedVariant
from thzcl.scenario.document import Document
from thzcl.scenario.problems import Trouble
from thzcl.scenario.scene import Box, Mesh, Scene

_SAME = "to stand in one file; run them apart with --variant"
_ROOM = 1e3  # between the largest number and a sum of powers: spans are foreseen, not known
_AT_RANDOM = (
    "needs air that fluctuates at random ([atmosphere.fluctuations] with a sigma or structure "
    "constant above 0), or a sensor with noise"
)


def together(document: Document, plan: Plan) -> None:
    """Raises ScenarioError if a scene lacks what its sensor needs, or if variants do not agree."""
    troubles = []
    for variant in plan.variants:
        troubles += _of_sensor(variant) + _of_variants(plan.variants[0], variant)
        troubles += _of_powers(variant)
    troubles += _of_difference(plan)
    if troubles:
        raise ScenarioError(document.problems(troubles))


def _of_difference(plan: Plan) -> list[Trouble]:
    """Returns the reason why the difference of two images cannot be taken pixel by pixel."""
    names = plan.variants[0].scene.output.difference or ()
    cameras = [v.scene.camera for v in plan.variants if v.name in names]
    if len({(camera.focal_length_mm, camera.focal_plane_mm) for camera in cameras}) < 2:
        return []
    text = "the pixels of the two images lie at different angles; give both the same lens"
    return [Trouble(("output", "difference"), text)]


def _of_variants(first: PlannedVariant, variant: PlannedVariant) -> list[Trouble]:
    """Returns the reasons why two variants cannot be stored in one file."""
    found, scene = [], variant.scene
    if scene.camera.pixels != first.scene.camera.pixels:
        text = f"all variants must have the same pixels, {_SAME}"
        found.append(Trouble(("camera", "pixels"), text))
    realizations = scene.numerics.realizations
    if realizations != first.scene.numerics.realizations:
        text = "all variants must have as many; give it once"
        found.append(Trouble(("numerics", "realizations"), text))
    found += _of_sequence(first, variant)
    fixed = variant.cube is None or variant.cube.random is None
    if realizations > 1 and fixed and not variant.needs.noise:
        found.append(Trouble(("numerics", "realizations"), _AT_RANDOM))
    models, others = _models(first.scene), _models(scene)
    if models != others and (models[1:] or others[1:]):
        text = f"all variants must compare the same models in the same order, {_SAME}"
        found.append(Trouble(("atmosphere", "compare"), text))
    planes = first.image.spectrum.count, variant.image.spectrum.count
    if planes[0] != planes[1] or _recorder(variant) != _recorder(first):
        text = f"all variants must be of one kind, with as many frequencies, {_SAME}"
        found.append(Trouble(("sensor",), text))
    if scene.output != first.scene.output:
        found.append(Trouble(("output",), "is that of the one file of all variants; give it once"))
    if scene.output.save_field and _lie(variant) != _lie(first):
        text = f"all variants must have cubes of the same voxel_m, grid and orientation, {_SAME}"
        found.append(Trouble(("output", "save_field"), text))
    return found


def _of_sequence(first: PlannedVariant, variant: PlannedVariant) -> list[Trouble]:
    """Returns the reasons why frames of a variant cannot be taken one after the other."""
    sequence, needs = variant.scene.sequence, variant.needs
    if sequence != first.scene.sequence:
        return [Trouble(("sequence",), "is that of all variants; give it once")]
    if sequence is None:
        return []
    found = []
    flow = variant.scene.atmosphere.fluctuations
    still = variant.cube is None or flow is None or not any(flow.wind_m_s)
    if still and not needs.noise:
        text = "nothing changes from frame to frame: give [atmosphere.fluctuations] wind_m_s"
        found.append(Trouble(("sequence",), f"{text}, or a sensor with noise"))
    if variant.scene.numerics.realizations > 1:
        text = "and realizations exclude each other; remove one"
        found.append(Trouble(("sequence",), text))
    busy_s = _busy_s(variant)
    if busy_s * sequence.rate_hz > 1 + 1e-9:
        text = (
            f"a frame every {1 / sequence.rate_hz:.4g} s leaves no time for the {busy_s:.4g} s "
            f"that the sensor takes over one; give at most {math.floor(1e4 / busy_s) / 1e4:g}"
        )
        found.append(Trouble(("sequence", "rate_hz"), text))
    return found


def _busy_s(variant: PlannedVariant) -> float:
    """Returns how long a sensor takes over one image, s: all its dwells, or its integration."""
    needs = variant.needs
    if needs.times_s is None:
        return needs.integration_time_s or 0.0
    times = np.unique(np.asarray(needs.times_s, dtype=np.float64))
    return float(np.ptp(times) + (np.diff(times).min() if len(times) > 1 else 0.0))


def _models(scene: Scene) -> tuple[str, ...]:
    """Returns the names of the main model, and of those to compare with."""
    return scene.atmosphere.model, *scene.atmosphere.compare


def _recorder(variant: PlannedVariant) -> tuple[object, bool]:
    """Returns the kind of the sensor that records, within all that wrap it, and whether echoes."""
    sensor = variant.scene.sensor.model_dump()
    while isinstance(sensor.get("detector"), Mapping):
        sensor = sensor["detector"]
    return sensor["kind"], variant.needs.reflection


def _lie(variant: PlannedVariant) -> tuple[object, ...]:
    """Returns how a variant's cube lies in the world, and whether its temperature fluctuates."""
    cube = variant.cube
    if cube is None:
        return ()
    return cube.lattice, variant.orientation, cube.isothermal


def _of_powers(variant: PlannedVariant) -> list[Trouble]:
    """Returns that the arithmetic does not hold the powers of humidity along a path, if so.

    A path has as many powers as the model needs, of those compared, that needs most.
    """
    expansions = (variant.expansion, *(one.expansion for one in variant.compared))
    planned = max((spec.planned() for spec in expansions), key=lambda one: one.moments)
    precision, reach = variant.settled.precision, max(map(abs, planned.humidity_span))
    room = math.log(float(np.finfo(precision).max) / (_ROOM * max(variant.longest_m, 1.0)))
    if planned.moments * math.log(max(reach, 1.0)) <= room:
        return []
    text = (
        f"in air of up to {reach + 1:.3g} times the mean humidity, powers of degree "
        f"{planned.moments} overflow {precision}; give at most {int(room / math.log(reach))}"
    )
    other = ', or precision = "float64"' if precision == "float32" else ""
    return [Trouble(("numerics", "moments"), text + other)]


def _of_sensor(variant: PlannedVariant) -> list[Trouble]:
    """Returns the problems that the sensor of a variant has with its scene."""
    if variant.needs.reflection:
        return _transmitter_troubles(variant)
    return _temperature_troubles(variant.scene)


def _temperature_troubles(scene: Scene) -> list[Trouble]:
    """Returns the problems of things without a temperature, whose emission a sensor sees."""
    found = []
    if scene.ground is not None and scene.ground.temperature_k is None:
        text = "missing; a passive sensor sees the ground's emission"
        found.append(Trouble(("ground", "temperature_k"), text))
    for name, target in scene.targets.items():
        if isinstance(target, Mesh):
            found += _mesh_troubles(name, target)
            continue
        if target.temperature_k is None and getattr(target, "quantity", "") != "temperature":
            text = "missing; a passive sensor sees the target's emission"
            found.append(Trouble(("targets", name, "temperature_k"), text))
        if target.cover is not None and target.cover.temperature_k is None:
            text = "missing; a passive sensor sees the cover's emission"
            found.append(Trouble(("targets", name, "cover", "temperature_k"), text))
    return found


def _mesh_troubles(name: str, mesh: Mesh) -> list[Trouble]:
    """Returns the parts of a mesh, and covers, that have no temperature."""
    found = []
    own = [(("targets", name), mesh.made_of(""))]
    parts = [(("targets", name, "parts", part), mesh.made_of(part)) for part in mesh.parts]
    for path, made in parts or own:
        if made.temperature_k is None and made.temperature is None:
            text = "missing; a passive sensor sees the target's emission"
            found.append(Trouble((*path, "temperature_k"), text))
        if made.cover is not None and made.cover.temperature_k is None:
            text = "missing; a passive sensor sees the cover's emission"
            found.append(Trouble((*path, "cover", "temperature_k"), text))
    return found


def _transmitter_troubles(variant: PlannedVariant) -> list[Trouble]:
    """Returns the problems of a transmitter that stands below the ground or inside a box."""
    place, found = variant.needs.transmitter_m, []
    if place is None:
        return []
    if variant.scene.ground is not None and place[2] <= 0:
        text = f"the transmitter is at z = {place[2]:g} m, not above the ground; raise it"
        found.append(Trouble(("sensor",), text))
    for name, target in variant.scene.targets.items():
        if isinstance(target, Box) and target.holds(place):
            text = f'the transmitter stands inside the target "{name}"; move it'
            found.append(Trouble(("sensor",), text))
    return found


def memory(plan: Plan, device: Device) -> None:
    """Raises ScenarioError if a plan needs more memory than the device has."""
    total, largest = needed(plan)
    advice = (
        "lower grid, pixels, samples_per_pixel or the number of frequencies, or run variants apart "
        "with --variant"
    )
    name = device.info.name
    if total > device.memory_bytes:
        need = f"needs {_told(total)}, but has {_told(device.memory_bytes)} on {name}"
        raise ScenarioError([f"{plan.scenario.name}: {need}; {advice}"])
    if largest > device.largest_buffer:
        need = (
            f"needs one array of {_told(largest)}, but {name} allows {_told(device.largest_buffer)}"
        )
        raise ScenarioError([f"{plan.scenario.name}: {need}; {advice}"])


def _told(size: int) -> str:
    """Returns a number of bytes in words."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**29 else f"{size / 2**20:.0f} MiB"
