"""What things are made of: which frequencies it is known at, and what it mirrors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import ScenarioError
from thzcl.graph import Values
from thzcl.scenario.document import Scenario
from thzcl.scenario.scene import Mesh, Scene
from thzcl.sensor import Needs
from thzcl.surfaces.geometry import Surface
from thzcl.surfaces.materials import Covering, Face
from thzcl.surfaces.mirrors import Mirror
from thzcl.surfaces.radiance import Sources

Array = NDArray[np.float64]
FREQUENCIES = 8  # that a plan tells


def follows(scene: Scene, surfaces: Sequence[Surface]) -> bool:
    """Returns whether mirrored rays are followed to the next surface.

    By default they are if something is made of a material and anything else, or a mesh, is there to
    be mirrored.
    """
    if scene.numerics.bounces is not None:
        return scene.numerics.bounces == 1
    if not any(isinstance(one.mirror, Face) for one in surfaces):
        return False
    if any(isinstance(one, Mesh) for one in scene.targets.values()):
        return True
    return len(scene.targets) + (scene.ground is not None) > 1


def refuse(
    scenario: Scenario, scene: Scene, surfaces: Sequence[Surface], needs: Needs, nodes_hz: Values
) -> None:
    """Raises ScenarioError for materials that are not known at the sensor's frequencies."""
    hz = nodes_hz.array
    problems = []
    for law in _laws(surfaces):
        if isinstance(law, Face):
            why = law.substance.beyond(hz)[0]
            if why is not None:
                problems.append(f"{_key(scene, law.substance.name)}: {why}")
        if isinstance(law.cover, Covering):
            why = law.cover.beyond(hz)
            problems += [] if why is None else [f"cover: {why}"]
    if needs.transmitter_m is not None and needs.gain == "lambert":
        sloped = [one for one in _laws(surfaces) if one.slope is not None]
        if sloped and isinstance(sloped[0], Face):
            text = "slope tells what comes back to where the light came from, not to another place"
            where = f"[materials.{sloped[0].substance.name}] slope"
            problems.append(f"{where}: {text}; remove it, or transmitter_m")
    if problems:
        raise ScenarioError([f"{scenario.name}: {one}" for one in dict.fromkeys(problems)])


def _laws(surfaces: Sequence[Surface]) -> list[Mirror]:
    """Returns the laws of surfaces, each once."""
    return list(dict.fromkeys(one.mirror for one in surfaces))


def _key(scene: Scene, name: str) -> str:
    """Returns the table of a scene that describes a material, or its name if it comes along."""
    return f"[materials.{name}]" if name in scene.materials else f'material "{name}"'


def notes(scene: Scene, sources: Sources, nodes_hz: Array) -> list[str]:
    """Returns what to tell of a scene's materials."""
    found, laws = [], sources.reflecting.mirrors
    used = {law.substance.name for law in laws if isinstance(law, Face)}
    for law in laws:
        if isinstance(law, Face):
            told = law.substance.beyond(nodes_hz)[1]
            found += [] if told is None else [f"{_key(scene, law.substance.name)}: {told}"]
    found += [
        f"[materials.{name}] is not used: nothing is made of it"
        for name in scene.materials
        if name not in used
    ]
    return list(dict.fromkeys(found + list(_of_sensor(scene, sources))))


def _of_sensor(scene: Scene, sources: Sources) -> Iterator[str]:
    """Yields what to tell of what a sensor sees of materials and polarisation."""
    laws = sources.reflecting.mirrors
    if scene.camera.polarization_deg is not None and not sources.reflecting.polarized:
        yield "[camera] polarization_deg is not used: no surface is made of a material"
    if sources.air_emits:
        if sources.bounces:
            yield "what surfaces mirror is seen through mean air, once mirrored, unpolarised"
        return
    if scene.numerics.bounces == 1:
        yield "[numerics] bounces is not used: an active sensor sees light that is reflected once"
    plain = [law for law in laws if isinstance(law, Face) and law.slope is None]
    if getattr(sources, "lambert", False) and plain:
        yield (
            'spreading = "lambert": mirrors send no light back; give [materials] roughness_mm and '
            "slope for what their facets do"
        )


def table(scene: Scene, sources: Sources, nodes_hz: Array) -> list[dict[str, Any]]:
    """Returns the materials of a scene as `thzcl plan` prints them.

    Each has its reflectivity at normal incidence and the share of it that is mirrored, by
    frequency.
    """
    picked = np.linspace(0, len(nodes_hz) - 1, min(len(nodes_hz), FREQUENCIES))
    hz = nodes_hz[np.round(picked).astype(int)]
    found: dict[str, dict[str, Any]] = {}
    for law in sources.reflecting.mirrors:
        if not isinstance(law, Face) or law.substance.name in found:
            continue
        upright = np.ones(1)
        found[law.substance.name] = {
            "material": law.substance.name,
            "of": "scene" if law.substance.name in scene.materials else "thzcl",
            "roughness_mm": law.roughness_m * 1e3,
            "frequency_ghz": [round(float(f) / 1e9, 9) for f in hz],
            "reflectivity": np.round(law.reflectivity(hz, upright), 6).tolist(),
            "mirrored_share": np.round(law.share(hz, upright), 6).tolist(),
        }
    return list(found.values())
