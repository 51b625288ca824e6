"""The scenes of a question about range: a target at each range, there and gone, in many airs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thzcl import metrics
from thzcl.errors import PluginFailure, ScenarioError, UsageError
from thzcl.graph import Spec, evaluate, everything, rewrite
from thzcl.plan import checks
from thzcl.plan.plan import Plan, join, make_plan
from thzcl.plan.refused import files_refused
from thzcl.plugins.names import suggest
from thzcl.scenario import document as documents
from thzcl.scenario import sensors
from thzcl.scenario.document import Document
from thzcl.scenario.scene import Mesh, Scene
from thzcl.sensing.image import Compared, ImageSpec, Recorded
from thzcl.sensor import RESERVED_NAMES, Echoes, Radiances
from thzcl.studies.many import placing
from thzcl.studies.many.members import spawned
from thzcl.surfaces.meshes import placed
from thzcl.turbulence.fields import FieldSpec

if TYPE_CHECKING:
    from thzcl.device.opencl import Device

Array = NDArray[np.float64]
Sight = Radiances | Echoes


class RangeRefusedError(ValueError):
    """A range at which the target cannot be asked about; the text says why."""


@dataclass(frozen=True)
class Base:
    """The scene that is asked about: one variant's data, the target, and the sensor's frequency.

    `key` is the dotted key of the frequency that `--frequency-ghz` sets, or None. If the target
    does not `move`, it stays where it is, whatever range is asked for.
    """

    document: Document
    target: str
    key: str | None
    allow_outside: bool
    moves: bool = True

    @classmethod
    def of(
        cls,
        document: Document,
        variants: tuple[str, ...],
        target: str,
        outside: bool,
        *,
        moves: bool = True,
    ) -> Base:
        """Returns the scene of one variant. Raises UsageError or ScenarioError."""
        scenes = documents.by_variant(document)
        chosen = variants or tuple(scenes)
        unknown = next((name for name in chosen if name not in scenes), None)
        if unknown is not None:
            raise UsageError(f"--variant {unknown}: no such variant ({suggest(unknown, scenes)})")
        if len(chosen) > 1:
            text = f"the scene has several variants; name one with --variant: {', '.join(scenes)}"
            raise UsageError(text)
        data = {k: v for k, v in scenes[chosen[0]].items() if k not in ("study", "sequence")}
        alone = replace(document, data=data)
        known = _scene(alone, outside).flagged
        if target not in known:
            raise UsageError(f"--target {target}: no such target ({suggest(target, known)})")
        if data.get("numerics", {}).get("realizations", 1) > 1:
            text = "[numerics] realizations is refused here: --air N is that"
            raise ScenarioError([f"{document.label}: {text}"])
        return cls(alone, target, _frequency_key(data["sensor"], "sensor"), outside, moves)

    @property
    def own_ghz(self) -> float | None:
        """Returns the sensor's one frequency as the scene has it, GHz; None if it has several."""
        value: Any = self.document.data
        for name in (self.key or "").split("."):
            value = value.get(name) if isinstance(value, Mapping) else None
        return float(value) if isinstance(value, int | float) else None

    def at(self, range_m: float, settings: Mapping[str, Any]) -> Document:
        """Returns the scene with the target at a range, and enough rays on it.

        Raises RangeRefusedError where that cannot be, or where the target overfills the picture.
        """
        data = self.document.data
        here = self._corners(self.document)
        name = self.mesh or self.target
        table = data["targets"][name]
        beside = here.mean(axis=0) - np.array(table["center_m"], float) if self.mesh else None
        try:
            moved = (
                placing.at_range(data["camera"], table, name, range_m, False, beside)
                if self.moves
                else {}
            )
        except ValueError as error:
            raise RangeRefusedError(str(error)) from None
        changes = moved | {"numerics.error_budget": False} | dict(settings)
        document = documents.changed(self.document, changes, {})
        scene = _scene(document, self.allow_outside)
        seen = placing.outline(scene.camera, self._corners(document))
        if self.moves and not seen.within:
            text = f"at {range_m:g} m {self.target} overfills the picture; give a longer range"
            raise RangeRefusedError(text)
        samples = placing.samples(scene.camera, seen)
        return documents.changed(document, {"camera.samples_per_pixel": samples}, {})

    @property
    def mesh(self) -> str | None:
        """Returns the name of the mesh that is the target, or that the target is a part of."""
        targets = self.document.data["targets"]
        name = self.target if self.target in targets else self._split()[0]
        return name if targets[name].get("kind") == "mesh" else None

    def _split(self) -> tuple[str, str]:
        """Returns the names of the mesh and of the part that the target is."""
        meshes = self.document.data["targets"]
        name = next(one for one in meshes if self.target.startswith(f"{one}."))
        return name, self.target.removeprefix(f"{name}.")

    def gone(self) -> dict[str, Any]:
        """Returns the setting that takes the target away."""
        if self.target in self.document.data["targets"]:
            return {f"targets.{self.target}": None}
        name, part = self._split()
        return {f"targets.{name}.parts.{part}.shown": False}

    def _corners(self, document: Document) -> Array:
        """Returns the corners of the target in a scene, (n, 3) in m."""
        scenario = documents.parse(document, allow_outside=self.allow_outside)
        targets = scenario.variants[0].scene.targets
        part = None if self.target in targets else self._split()[1]
        target = targets[self.mesh or self.target]
        if not isinstance(target, Mesh):
            return placing.corners(target)
        with files_refused(scenario):
            return placed(target, scenario.locate).box_m(part)

    def plan(self, document: Document) -> Plan:
        """Returns the plan of a scene. Raises ScenarioError or PluginFailure."""
        plan = make_plan(documents.parse(document, allow_outside=self.allow_outside))
        checks.together(document, plan)
        return plan


def _scene(document: Document, allow_outside: bool) -> Scene:
    """Returns the scene of a document's only variant. Raises ScenarioError."""
    return documents.parse(document, allow_outside=allow_outside).variants[0].scene


def _frequency_key(sensor: Mapping[str, Any], path: str) -> str | None:
    """Returns the key that is the frequency of a sensor, or else of its detector."""
    known = sensors.sensor_class(sensor["kind"]).Params.model_fields
    for name in ("frequency_ghz", "center_ghz"):
        if name in known:
            return f"{path}.{name}"
    inner = sensor.get("detector")
    return _frequency_key(inner, f"{path}.detector") if isinstance(inner, Mapping) else None


@dataclass(frozen=True)
class Pair:
    """Plans of a scene with the target and without it, at one range and frequency."""

    range_m: float
    frequency_ghz: float
    present: Plan
    absent: Plan

    @classmethod
    def of(cls, base: Base, range_m: float, ghz: float | None, more: Mapping[str, Any]) -> Pair:
        """Returns the plans of a range and a frequency (None: the sensor's own)."""
        settings = dict(more)
        if ghz is not None and base.key is not None:
            settings[base.key] = ghz
        there = base.at(range_m, settings)
        gone = documents.changed(there, base.gone(), {})
        plans = base.plan(there), base.plan(gone)
        spectrum = plans[0].variants[0].image.spectrum
        middle = float(np.mean(spectrum.planes(spectrum.nodes_hz.array))) / 1e9
        named = base.own_ghz if ghz is None else ghz
        return cls(range_m, middle if named is None else named, *plans)

    @property
    def random(self) -> bool:
        """Returns whether the air is another in another realisation."""
        cube = self.present.variants[0].cube
        return cube is not None and cube.random is not None

    @property
    def noisy(self) -> bool:
        """Returns whether the sensor draws random numbers."""
        return self.present.variants[0].needs.noise

    @property
    def active(self) -> bool:
        """Returns whether the sensor sees echoes."""
        return self.present.variants[0].needs.reflection

    def specs(self) -> list[Spec]:
        """Returns the specs of both images, each with what compared models see."""
        one, other = self.present.variants[0], self.absent.variants[0]
        return [one.image, *one.compared, other.image, *other.compared]


def joined(pairs: list[Pair]) -> list[Pair]:
    """Returns pairs whose equal paths are one: frequencies share their traces."""
    plans = iter(join(plan for pair in pairs for plan in (pair.present, pair.absent)))
    return [replace(pair, present=next(plans), absent=next(plans)) for pair in pairs]


@dataclass(frozen=True)
class Scenes:
    """What reached the pixels in one air, with and without the target, by one model.

    `whole` is the image's spec, which says by which sensor and from which seed it is made.
    """

    model: str
    present: Sight
    absent: Sight
    whole: ImageSpec

    def image(self, sight: Sight, draw: int) -> Array:
        """Returns the linear image (y, x) that the sensor makes in one draw of its noise.

        Draws are numbered; the same one on other radiances has the same random numbers.
        """
        sensor = sensors.make(self.whole.sensor.model_dump())
        rng = replace(self.whole.noise, frame=draw).generator()
        stored = np.dtype(self.whole.precision)
        return metrics.linear(sensors.observe(sensor, sight, rng, stored, RESERVED_NAMES))[0]


def airs(
    pairs: list[Pair], numbers: range, seed: int, device: Device
) -> Iterator[tuple[int, int, list[Scenes]]]:
    """Yields the number of an air and of a pair, and its scenes by each model, air by air.

    Pairs that stand in one air share its cube, and of those of one range their traces. Air that is
    not random is computed once.
    """
    groups: dict[float, list[int]] = {}
    for number, pair in enumerate(pairs):
        groups.setdefault(pair.range_m, []).append(number)
    for pair in pairs:
        for plan in (pair.present, pair.absent):
            checks.memory(plan, device)
    random = any(pair.random for pair in pairs)
    some = numbers if random else numbers[:1]
    batches = [[spec for n in group for spec in pairs[n].specs()] for group in groups.values()]
    held = _the_same_in_all_airs(spec for batch in batches for spec in batch)
    stream = evaluate(
        ((*_in_air(batch, spawned(seed, air), held), *held) for air in some for batch in batches),
        device,
    )
    kept: list[tuple[int, list[Scenes]]] = []
    for air in some:
        for group, specs in zip(groups.values(), batches, strict=True):
            values = iter(zip(specs, next(stream), strict=False))
            for number in group:
                its = spawned(seed, air)
                found = [_with_noise(one, its) for one in _scenes(pairs[number], values)]
                if random:
                    yield air, number, found
                else:
                    kept.append((number, found))
    for air in () if random else numbers:
        for number, found in kept:
            other = spawned(seed, air)
            yield air, number, [_with_noise(one, other) for one in found]


def _the_same_in_all_airs(wanted: Iterable[Spec]) -> list[Spec]:
    """Returns the specs that another air leaves as they are, and that others read.

    As part of every batch their values are held from air to air.
    """
    moving: set[Spec] = set()
    held: dict[Spec, None] = {}
    for spec in everything(wanted):  # inputs first
        if isinstance(spec, FieldSpec | ImageSpec) or any(one in moving for one in spec.inputs()):
            moving.add(spec)
            held |= dict.fromkeys(one for one in spec.inputs() if one not in moving)
    return list(held)


def _with_noise(one: Scenes, seed: int) -> Scenes:
    noise = replace(one.whole.noise, seed=seed)
    return replace(one, whole=replace(one.whole, noise=noise))


def _in_air(specs: list[Spec], seed: int, same: list[Spec]) -> tuple[Any, ...]:
    """Returns specs with another seed of the air and of the noise, which some do not depend on."""

    def change(spec: Any) -> Any:
        if isinstance(spec, FieldSpec):
            return replace(spec, turbulence=replace(spec.turbulence, seed=seed))
        if isinstance(spec, ImageSpec):
            return replace(spec, noise=replace(spec.noise, seed=seed))
        return spec

    return rewrite(specs, change, same)


def _scenes(pair: Pair, values: Iterator[tuple[Any, Any]]) -> list[Scenes]:
    """Returns the scenes of a pair by each model that is valid at all of its frequencies."""
    halves = []
    for plan in (pair.present, pair.absent):
        variant = plan.variants[0]
        spec, recorded = next(values)
        if recorded.image is None:
            raise PluginFailure(recorded.failure or "no image")
        others = [next(values)[1] for _ in variant.compared]
        sights = {variant.scene.atmosphere.model: recorded.sight}
        sights |= {one.model: _as_seen(one, recorded) for one in others if _whole(one, recorded)}
        halves.append((spec, sights))
    (spec, present), (_, absent) = halves
    return [
        Scenes(model, sight, absent[model], spec)
        for model, sight in present.items()
        if model in absent
    ]


def _whole(one: Compared, recorded: Recorded) -> bool:
    return len(one.planes) == len(recorded.sight.frequency_hz) and one.failure is None


def _as_seen(one: Compared, recorded: Recorded) -> Sight:
    """Returns what reached the pixels by a compared model, as the sensor takes it."""
    time_s, passband = recorded.sight.integration_time_s, recorded.sight.passband
    return replace(one.sight, integration_time_s=time_s, passband=passband)
