"""What falls in the images of a plan: how much light it adds, and what is left out of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.air import mie, weather
from thzcl.air.mean import Air
from thzcl.air.radiometry import planck_slope
from thzcl.air.scattering import mean_transmission
from thzcl.air.weather import Weather

Array = NDArray[np.float64]

CELL_M = 1000.0  # radius of a rain cell whose end is told of
DEEP = 0.55  # depth over radius of the endless layer that scatters into rays as a cell does
BLUR, MISSING_K = 1e-3, 0.1  # of contrast, and of what a cell's end would change: told from here on
TARGET_M = 0.6  # half the width of a target, for what is scattered forward


class Rays(NamedTuple):
    """Some of a camera's rays: the sine of their elevation, and how long and high they are, m."""

    sine: Array
    length_m: Array
    height_m: Array  # mean of both ends

    @classmethod
    def of(cls, direction: Array, length_m: Array, start_m: float, most: int) -> Rays:
        """Returns at most so many of some rays, evenly taken."""
        some = np.linspace(0, len(length_m) - 1, min(len(length_m), most)).astype(int)
        sine, length = direction[np.unique(some), 2], length_m[np.unique(some)]
        return cls(sine, length, start_m + sine * length / 2)


def added(falling: Weather, air: Air, frequency_hz: Array, rays: Rays) -> Array:
    """Returns the radiance that weather adds to rays, (frequency, ray), W m-2 sr-1 Hz-1."""
    depth = air.absorption(frequency_hz)[:, None] * rays.length_m
    source = falling.source(frequency_hz, rays.sine, rays.height_m)
    return np.asarray(source * rays.length_m * mean_transmission(depth))


def notes(variants: Sequence[tuple[str, Weather | None, Air, Array, Rays]]) -> list[str]:
    """Returns what images in weather leave out, as far as it can be told: the worst of them.

    `variants` are name, what falls if light of it is followed, air, frequencies in Hz, and rays.
    """
    found = []
    blurs = [(_blur(air, hz, rays), name) for name, _, air, hz, rays in variants]
    most, name = max(blurs, default=(0.0, ""))
    if most > BLUR:
        text = f"what falls scatters up to {100 * most:.2g} % of a target's contrast forward"
        found.append(f"{name}: {text}, to beside it within its own width; that blur is left out")
    ends = [
        (_of_end(falling, air, hz, rays), name)
        for name, falling, air, hz, rays in variants
        if falling is not None
    ]
    most, name = max(ends, default=(0.0, ""))
    if most > MISSING_K:
        text = f"layers of what falls have no end: in a cell of {CELL_M / 1e3:g} km radius"
        found.append(f"{name}: {text} rays would bring up to about {most:.2g} K less")
    return found


def _blur(air: Air, frequency_hz: Array, rays: Rays) -> float:
    """Returns the most that is scattered within a target's own angle, of its contrast.

    Light of single scattering at a distance s from a target comes from directions that are off by
    up to the angle at which the target is seen from there.
    """
    kinds = weather.falling(air, frequency_hz)
    length = float(rays.length_m.max(initial=0.0))
    if not kinds or not length:
        return 0.0
    node, weight = mie.gauss(16)
    distance, step = length * (1 + node) / 2, length * weight / 2
    cosine = np.cos(np.arctan(TARGET_M / np.maximum(distance, 1e-9)))
    whole = mie.legendre(cosine, weather.ORDERS + 1)  # (order, place)
    ends = np.concatenate([1 - cosine[None], whole[:-2] - whole[2:]]) / 2
    return float(
        max((kind.scattering * (step @ (kind.legendre.T @ ends).T)).max() for kind in kinds)
    )


def _of_end(falling: Weather, air: Air, frequency_hz: Array, rays: Rays) -> float:
    """Returns about how much less rays would bring in a cell of what falls, K.

    Light comes in from the sides there as it comes from above through a thinner layer.
    """
    if falling.column is None:
        return 0.0
    cell = replace(falling, highest_m=DEEP * CELL_M)
    few = Rays(*(one[:: max(1, len(one) // 8)] for one in rays))
    change = added(falling, air, frequency_hz, few) - added(cell, air, frequency_hz, few)
    unit = planck_slope(frequency_hz, air.temperature_k)
    return float((change.max(axis=1) / unit).max(initial=0.0))
