"""The sky of a variant: from the scene's table to what is seen, and what users are told of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, profile, radiometry, sky, validity
from thzcl.air.mean import Air
from thzcl.air.profile import Profile
from thzcl.air.sky import Column
from thzcl.errors import RangeError, ScenarioError
from thzcl.plan.refused import files_refused
from thzcl.scenario.document import Scenario
from thzcl.scenario.scene import Box, Mesh, Scene
from thzcl.surfaces import meshes
from thzcl.surfaces.estimate import SampledRays
from thzcl.surfaces.geometry import BACKGROUND, FIRST_TARGET, GROUND
from thzcl.surfaces.mirrors import Mirror
from thzcl.surfaces.radiance import Emission, Sources
from thzcl.surfaces.sky import RISE_M, Behind, Sky, highest_m, layer_top_m, sky_of

Array = NDArray[np.float64]

ELEVATIONS_DEG = (90.0, 60.0, 45.0, 30.0, 20.0, 10.0, 5.0, 3.0, 1.0, 0.0)  # that a plan tells
LOWEST_DEG = 3.0  # from where on the effect of uniform air is told
TOLD_K = 1.0  # what would change by more without a sky is told
ALIKE = 0.02  # of pressure: a scene and a profile that differ by less are of one height
SPARSE_HPA = 50.0  # a profile that ends below lacks a part of the sky
COARSE_M = 100.0  # layers of an estimate
FREQUENCIES = 8  # that a plan tells, and that are looked at for notes


def above(
    scenario: Scenario, scene: Scene, air: Air, ground_law: Mirror | None = None
) -> Sky | None:
    """Returns the sky that a scene asks for, over ground that reflects by a law, or None.

    Raises ScenarioError for a profile that cannot be used, and where the air is not known up there.
    """
    if scene.sky is None:
        return None
    with files_refused(scenario):
        meshes_top_m = meshes.top_m(scene, scenario.locate)
        highest = highest_m(scene, meshes_top_m)
        top_m = highest + RISE_M
        rows = _profile(scenario, scene, top_m)
    if top_m >= rows.top_m:
        text = f"[sky] profile: ends at {rows.top_m:g} m, below the scene's {top_m:g} m"
        raise ScenarioError([f"{scenario.name}: {text}; bring the scene down"])
    layer = layer_top_m(air)
    if layer <= highest:
        words = f"a layer of the air ends at {layer:g} m, but the scene reaches {top_m - RISE_M:g}"
        raise ScenarioError([f"{scenario.name}: [sky]: {words} m; bring the scene down"])
    found = sky_of(scene, air, rows, ground_law, meshes_top_m)
    try:
        _refuse_beyond(found.column)
    except RangeError as error:
        raise ScenarioError([f"{scenario.name}: [sky]: {error}"]) from None
    return found


def _profile(scenario: Scenario, scene: Scene, top_m: float) -> Profile:
    """Returns the profile that a scene names, which must reach above `top_m`."""
    asked = scene.sky
    if asked is None or asked.file is None:
        return profile.shipped("us-standard" if asked is None else asked.profile)
    return profile.read(scenario.locate(asked.file), top_m)


def _refuse_beyond(column: Column) -> None:
    """Raises RangeError where a gas does not hold what the air becomes in a column."""
    state = column.at(sky.levels(column))._asdict()
    for part in column.air.parts:
        if composition.constituent_class(part.name).gas:
            limited = composition.made(part).limited
            composition.refuse(part, validity.ranges(limited, **state))


def table(sources: Sources, frequency_hz: Array) -> dict[str, Any] | None:
    """Returns the sky by elevation as a camera sees it, as `thzcl plan` prints it, or None."""
    found = _sky(sources)
    if found is None:
        return None
    column, hz = found.column, _some(frequency_hz)
    sine = np.sin(np.radians(ELEVATIONS_DEG))
    contrast, depth = sky.seen_above(column, hz, sine, column.scene_m)
    warmer, moister, denser = column.departure()
    return {
        "profile": column.profile.name,
        "seen_in": list(sources.sky_views()),
        "seen_from_m": column.scene_m,
        "even_air_to_m": column.even_m,
        "departure_k": round(warmer, 3),
        "vapour_ratio": float(f"{moister:.4g}"),
        "pressure_ratio": float(f"{denser:.4g}"),
        "even_air_k": float(f"{even_air_k(column, hz):.3g}"),
        "elevation_deg": list(ELEVATIONS_DEG),
        "frequency_ghz": [round(float(f) / 1e9, 9) for f in hz],
        "brightness_temperature_k": np.round(_kelvin(column, hz, contrast), 3).tolist(),
        "zenith_depth": [float(f"{tau:.5g}") for tau in depth[:, 0]],
    }


def _sky(sources: Sources) -> Sky | None:
    """Returns the sky that is seen, or None."""
    if not isinstance(sources, Emission) or not sources.sky_views():
        return None
    if isinstance(sources.behind, Behind):
        return sources.behind.sky
    return sources.surroundings if isinstance(sources.surroundings, Sky) else None


def _some(frequency_hz: Array) -> Array:
    """Returns at most FREQUENCIES frequencies, evenly taken."""
    picked = np.linspace(0, len(frequency_hz) - 1, min(len(frequency_hz), FREQUENCIES))
    return np.asarray(frequency_hz[np.round(picked).astype(int)])


def _kelvin(column: Column, frequency_hz: Array, contrast: Array) -> Array:
    """Returns brightness temperatures of contrasts (frequency, ...) to the scene's air, K."""
    air_k, hz = column.air.temperature_k, frequency_hz[:, None]
    above_air = radiometry.brightness_temperature_contrast(hz, contrast, air_k)
    return np.asarray(air_k + above_air)


def even_air_k(column: Column, frequency_hz: Array) -> float:
    """Returns the most by which the sky changes because the scene's air is even, K.

    It is that from 3 degrees above the horizon on, as the camera sees it, against air that is
    blended into the profile from the camera upwards.
    """
    sine = np.sin(np.radians([deg for deg in ELEVATIONS_DEG if deg >= LOWEST_DEG]))
    even, blended = (
        _kelvin(one, frequency_hz, sky.seen_above(one, frequency_hz, sine, one.scene_m)[0])
        for one in (column, replace(column, even_m=0.0))
    )
    return float(np.abs(even - blended).max())


def notes(scene: Scene, sources: Sources, frequency_hz: Array) -> list[str]:
    """Returns what to tell of a sky that is given."""
    if scene.sky is None:
        return []
    if not isinstance(sources, Emission):
        return ["[sky] is not used: an active sensor sees echoes alone"]
    found, seen = [], sources.sky_views()
    environment = scene.background.environment
    if environment != "sky" and _reflects(sources):
        which = f'"{environment}"' if isinstance(environment, str) else f"{environment:g}"
        text = f"[sky] is seen behind the scene alone: surfaces reflect environment = {which}"
        found.append(f'{text}; [background] environment = "sky" lets them reflect it')
    if environment == "sky" and scene.background.temperature_k is not None:
        text = "the sky is seen in surfaces alone: [background] temperature_k wins behind the scene"
        found.append(f"{text}; remove it to see the sky there")
    if not seen:
        return [*found, "[sky] is seen nowhere in this scene"]
    return found + _of_column(_sky(sources), _some(frequency_hz))


def _reflects(sources: Emission) -> bool:
    """Returns whether a surface reflects anything."""
    return any(one.view != "behind" and getattr(one, "value", 1.0) for one in _mirrors(sources))


def _mirrors(sources: Emission) -> tuple[Any, ...]:
    return sources.reflecting.mirrors


def _of_column(found: Sky | None, frequency_hz: Array) -> list[str]:
    """Returns what to tell of the column of air above a scene."""
    if found is None:
        return []
    told, column = [], found.column
    _, moister, denser = column.departure()
    if abs(denser - 1) > ALIKE:
        profile_hpa = column.air.pressure_hpa / denser
        text = f"the scene's pressure is {column.air.pressure_hpa:g} hPa, that of the sky's profile"
        text += f" at {column.scene_m:g} m {profile_hpa:.4g} hPa"
        told.append(f"{text}: heights count from z = 0; set pressure_hpa or another profile")
    if moister < sky.DRIEST:
        text = f"the scene's air is drier than {sky.DRIEST:g} of the profile's"
        told.append(f"{text}: the sky's is blended into {sky.DRIEST:g} of it")
    rows = column.profile
    if rows.pressure_hpa.array[-1] > SPARSE_HPA:
        top, hpa = rows.top_m / 1e3, rows.pressure_hpa.array[-1]
        told.append(f"the sky's profile ends at {top:g} km, {hpa:.3g} hPa: no air is taken above")
    changed = even_air_k(column, frequency_hz)
    if changed > TOLD_K:
        text = f"the scene's air, even up to {column.even_m:g} m, changes the sky"
        told.append(f"{text} by up to {changed:.2g} K from {LOWEST_DEG:g} degrees on")
    return told


def lacking(scene: Scene, air: Air, sources: Sources, rays: SampledRays, hz: Array) -> list[str]:
    """Returns a warning where a sky is not given and would change what is seen by over a kelvin."""
    if scene.sky is not None or not isinstance(sources, Emission):
        return []
    per_m = air.absorption(hz)
    if not per_m.any():
        return []
    thinnest = int(np.argmin(per_m))
    worst = _seen_parts(scene, rays)
    worst = {what: (one, m) for what, (one, m) in worst.items() if one[1] > 0}
    if not worst:
        return []
    try:
        column = _usual(scene, air)
        changes = {
            what: _change_k(column, hz[thinnest], one) * np.exp(-per_m[thinnest] * metres)
            for what, (one, metres) in worst.items()
        }
    except (RangeError, ValueError):  # where the estimate's gas is not known there is no sky
        return []
    ghz = hz[thinnest] / 1e9
    remedies = {
        "rays that meet nothing": "add [sky] profile, or [background] temperature_k",
        "reflections in surfaces": 'add [sky] profile and environment = "sky"',
    }
    return [
        f"no [sky]: outdoors, {what} would be up to {change:.3g} K colder at {ghz:g} GHz; "
        f"{remedies[what]}"
        for what, change in changes.items()
        if change > TOLD_K
    ]


def _usual(scene: Scene, air: Air) -> Column:
    """Returns the US standard atmosphere above a scene, of MPM93 where its gas is a table."""
    kinds = [(part, composition.constituent_class(part.name).gas) for part in air.parts]
    limited = any("pressure_hpa" in composition.made(part).limited for part, gas in kinds if gas)
    if limited:
        gas = composition.part("mpm93")
        parts = (gas, *(part for part, is_gas in kinds if not is_gas))
        air = replace(air, parts=parts)
    camera_m = max(scene.camera.position_m[2], 0.0)
    return Column(air, profile.shipped("us-standard"), camera_m, finest_m=COARSE_M)


Part = tuple[str, float, float]  # "ray" or "face", what it weighs, its direction's vertical part


def _seen_parts(scene: Scene, rays: SampledRays) -> dict[str, tuple[Part, float]]:
    """Returns what would see most of a sky, and from how far it is seen, m."""
    found: dict[str, tuple[Part, float]] = {}
    surface, up = rays.surface, rays.direction[:, 2]
    open_air = (surface == BACKGROUND) & (up > 0)
    if scene.background.temperature_k is None and open_air.any():
        top = int(np.argmax(np.where(open_air, up, -1.0)))
        found["rays that meet nothing"] = ("ray", 1.0, float(up[top])), float(rays.length[top])
    if scene.background.environment != "air":
        return found
    facing: list[tuple[Part, float]] = []
    camera_m = scene.camera.position_m[2]
    if scene.ground is not None and (surface == GROUND).any():
        part = "face", scene.ground.reflectivity, 1.0
        facing.append((part, float(rays.length[surface == GROUND].min())))
    if (surface >= FIRST_TARGET).any():
        metres = float(rays.length[surface >= FIRST_TARGET].min())
        for one in scene.targets.values():
            if isinstance(one, Mesh):
                upward = 1.0
            else:
                top_m = one.center_m[2] + one.size_m[-1] / 2
                upward = 1.0 if isinstance(one, Box) and camera_m > top_m else 0.0
            facing.append((("face", _reflectivity(one), upward), metres))
    if facing:
        found["reflections in surfaces"] = max(facing, key=lambda one: one[0][1] * (1 + one[0][2]))
    return found


def _reflectivity(one: Any) -> float:
    """Returns the largest part that a target reflects."""
    if getattr(one, "quantity", "") == "reflectivity":
        return 1.0 if one.range is None else float(max(one.range))
    return 1.0 if one.material is not None else float(one.reflectivity)


def _change_k(column: Column, frequency_hz: float, one: Part) -> float:
    """Returns by how much colder something is under a sky than in air, K."""
    kind, weight, upward = one
    hz = np.array([frequency_hz])
    if kind == "ray":
        seen = sky.seen_above(column, hz, np.array([upward]), column.scene_m)[0][0, 0]
    else:
        seen = Sky(column, None).scattered(hz, np.array([upward]), column.scene_m, 0.0)[0, 0]
    air_k = column.air.temperature_k
    kelvin = radiometry.brightness_temperature_contrast(hz, np.array([weight * seen]), air_k)[0]
    return float(-kelvin)
