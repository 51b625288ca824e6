"""The conditions of an image in words (frequency, range, air), and the angles of its pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.composition import Part
from thzcl.air.mean import Air
from thzcl.scenario.scene import Camera
from thzcl.sensor import Echoes, Image, Radiances
from thzcl.surfaces.geometry import FIRST_TARGET

Array = NDArray[np.float64]
NEDT = "NEDT at the sensor"  # the fact about an image that tells its noise


def angles(camera: Camera) -> tuple[NDArray[Any], NDArray[Any]]:
    """Returns the angles of pixel columns, (x,), and rows, (y,), from the image centre, mrad.

    Angles of columns are positive to the right, angles of rows upwards.
    """
    (width, height), (columns, rows) = camera.focal_plane_mm, camera.pixels
    right = (np.arange(columns) + 0.5 - columns / 2) * width / columns
    up = (rows / 2 - np.arange(rows) - 0.5) * height / rows
    focal = camera.focal_length_mm
    return 1e3 * np.arctan2(right, focal), 1e3 * np.arctan2(up, focal)


def conditions(
    air: Air, model: str, sight: Radiances | Echoes, image: Image | None, realizations: int = 1
) -> tuple[str, ...]:
    """Returns frequency, range, air, weather, absorption model and noise, for a picture's titles.

    The range is the median length of the rays that meet a target, or of all rays if none does.
    """
    on_target = sight.target >= FIRST_TARGET
    lengths = sight.path_length[on_target if on_target.any() else ...].ravel()
    return (
        _band(sight.nodes_hz / 1e9),
        f"{np.partition(lengths, len(lengths) // 2)[len(lengths) // 2]:.3g} m",
        f"{air.temperature_k:.5g} K",
        f"{air.relative_humidity_percent:.3g} % RH",
        f"{air.absolute_humidity_g_m3:.3g} g/m³",
        f"{air.pressure_hpa:g} hPa",
        ", ".join(filter(None, map(_amount, air.parts[1:]))),
        "no gas" if model == "none" else f"air by {model}",
        noise(image) if image else "",
        "" if realizations == 1 else f"mean of {realizations} realisations",
    )


def _amount(part: Part) -> str:
    """Returns what is in the air beside the gas, with its first number that has a unit, if any.

    Nothing is said of none, as of rain of 0 mm/h.
    """
    for name, field in type(part.params).model_fields.items():
        value, told = getattr(part.params, name), field.json_schema_extra
        if isinstance(value, int | float) and isinstance(told, dict) and told.get("unit"):
            said = f"{part.name} {value:.4g} {told['unit']}".replace("m3", "m³")
            return said if value else ""
    return part.name


def noise(image: Image) -> str:
    """Returns what speckle and noise an image has in words: its sensor's own, or by its NEDT."""
    if image.caption or NEDT not in image.facts:
        return image.caption
    kelvin, unit = image.facts[NEDT]
    return f"NEDT {kelvin:.3g} {unit}"


def _band(ghz: Array) -> str:
    """Returns a frequency in words, or the band that several span, to a twentieth of its width."""
    if len(ghz) == 1:
        return f"{ghz[0]:g} GHz"
    step = 10.0 ** np.ceil(np.log10((ghz[-1] - ghz[0]) / 20))
    return f"{np.floor(ghz[0] / step) * step:g}-{np.ceil(ghz[-1] / step) * step:g} GHz"
