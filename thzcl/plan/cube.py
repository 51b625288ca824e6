"""What makes the air of a scene uneven: fluctuations drawn at random, or a cube from a file."""

from __future__ import annotations

from thzcl.air.mean import Air
from thzcl.scenario.atmosphere import Atmosphere, Fluctuations
from thzcl.scenario.document import Scenario
from thzcl.scenario.scene import Scene
from thzcl.turbulence import cube_file, spectrum_table
from thzcl.turbulence.cube_file import Asked, CubeFile
from thzcl.turbulence.spectra import Turbulence, turbulence

Source = CubeFile | Turbulence


def cube_source(
    scenario: Scenario, scene: Scene, air: Air, *, absorbs: bool, emits: bool
) -> tuple[Source | None, str]:
    """Returns what the cube is made from, or None and the reason why there is no cube.

    `absorbs` says whether anything in the air absorbs, `emits` whether its emission is seen: then
    even what absorbs alike everywhere shows its temperature. Raises FileError for files
    that cannot be used.
    """
    if not absorbs:
        return None, "air absorbs nothing: no field, no FFT"
    if scene.atmosphere.fluctuations is None:
        return None, "no [atmosphere.fluctuations]: no field, no FFT"
    source = _source(scenario, scene.atmosphere, scene.atmosphere.fluctuations, air)
    if source is None:
        return None, "fluctuations of size 0, or dry air: no field, no FFT"
    if not (air.varies or (emits and _is_warm(source))):
        return None, "what absorbs does not vary with the air: no field, no FFT"
    return source, ""


def _source(
    scenario: Scenario, atmosphere: Atmosphere, flow: Fluctuations, air: Air
) -> Source | None:
    """Returns what the cube is made from, or None where nothing fluctuates."""
    if flow.spectrum == "file" and flow.file is not None:
        periodic, pressure_hpa = flow.periodic, atmosphere.pressure_hpa
        asked = Asked(flow.voxel_m, periodic, flow.time_index, pressure_hpa)
        cube = cube_file.inspect(scenario.folder / flow.file, asked)
        cube_file.refuse_zero_mean(cube, air.absolute_humidity_g_m3)
        return cube
    table = None if flow.file is None else spectrum_table.read(scenario.locate(flow.file))
    drawn = turbulence(atmosphere, table)
    even = drawn is None or drawn.sigma == 0 or air.absolute_humidity_g_m3 == 0
    return None if drawn is None or (even and not drawn.temperature_fluctuates) else drawn


def _is_warm(source: Source) -> bool:
    """Returns whether temperature fluctuates too."""
    if isinstance(source, CubeFile):
        return source.temperature_span_k is not None
    return source.temperature_fluctuates
