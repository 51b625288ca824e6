"""Everything that a run found out, as plain fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.sensor import Echoes, Image, Radiances

Array = NDArray[Any]


@dataclass(frozen=True)
class VariantResult:
    """One image, and what it was made from; `image` is None where the sensor failed."""

    name: str
    sight: Radiances | Echoes
    image: Image | None

    @property
    def radiances(self) -> Radiances:
        """What reached the pixels of a passive sensor. Raises TypeError for an active one."""
        if isinstance(self.sight, Echoes):
            raise TypeError("an active sensor has no radiances, but echoes: see sight")
        return self.sight


@dataclass(frozen=True)
class Cube:
    """A saved cube, (z, y, x)."""

    absolute_humidity_g_m3: Array
    air_temperature_k: Array | None
    voxel_m: float


@dataclass(frozen=True)
class Contents:
    """What a result holds, before it is written, drawn or summed up."""

    scenario: str
    scenario_toml: str
    scenario_folder: str
    variants: tuple[VariantResult, ...]
    targets: tuple[str, ...]  # names by flag: background, ground, then the targets in file order
    pixel_angles_mrad: tuple[Array, Array]  # of the columns, of the rows, from the image centre
    conditions: tuple[tuple[str, ...], ...]  # of each variant's air and range, in words
    figure_columns: int | None
    difference: tuple[str, str] | None  # variants whose images' difference is stored too
    grid_rotation: Array
    device: str
    seed: int
    build_options: tuple[str, ...]
    seconds: dict[str, float]
    left_out: tuple[dict[str, str], ...]
    warnings: tuple[str, ...]
    error_budget: dict[str, dict[str, Any]]
    voxel_segments: int
    versions: dict[str, str]
    cubes: tuple[Cube, ...] = ()  # one, or one for each variant

    def image_difference(self) -> Array | None:
        """Returns the first named variant's image less the second's, (y, x), if asked for."""
        if self.difference is None:
            return None
        images = {variant.name: variant.image for variant in self.variants}
        one, other = (images.get(name) for name in self.difference)
        if one is None or other is None:
            return None
        difference: Array = np.asarray(one.values) - np.asarray(other.values)
        return difference


def readable(name: str) -> str:
    """Returns a file's name as UTF-8 has it, whatever the locale made of its bytes."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
