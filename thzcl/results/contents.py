"""The results of a run as plain fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.sensor import Echoes, Image, Radiances
from thzcl.turbulence.lattice import Lattice

Array = NDArray[Any]


@dataclass(frozen=True)
class ModelResult:
    """What reached the pixels of one image by one absorption model.

    `planes` are the numbers of the image's frequencies at which the model is valid, which are all
    that `sight` holds.
    """

    name: str
    planes: tuple[int, ...]
    sight: Radiances | Echoes


@dataclass(frozen=True)
class VariantResult:
    """One image, and what reached its pixels; `image` is None if the sensor failed.

    `compared` holds what would have reached them by the models to compare with. `cell` is the size
    of a resolution cell in pixels (rows, columns).
    """

    name: str
    sight: Radiances | Echoes
    image: Image | None
    compared: tuple[ModelResult, ...] = ()
    cell: tuple[int, int] = (1, 1)

    def by_model(self, main: str) -> tuple[ModelResult, ...]:
        """Returns what reached the pixels by each model, that of the image first."""
        planes = tuple(range(len(self.sight.frequency_hz)))
        return ModelResult(main, planes, self.sight), *self.compared

    @property
    def radiances(self) -> Radiances:
        """Returns what reached the pixels of a passive sensor.

        Raises TypeError for an active sensor.
        """
        if isinstance(self.sight, Echoes):
            raise TypeError("an active sensor has no radiances, but echoes: see sight")
        return self.sight


@dataclass(frozen=True)
class Cube:
    """A saved cube of air, (z, y, x); its temperature in K is None if it does not fluctuate."""

    absolute_humidity_g_m3: Array
    air_temperature_k: Array | None
    lattice: Lattice

    @property
    def voxel_m(self) -> float:
        """Returns the edge of a voxel of a cube whose edges are alike, m."""
        return self.lattice.voxel_m[0]


@dataclass(frozen=True)
class Contents:
    """The data of a result, which can be written, drawn or summed up."""

    scenario: str
    scenario_toml: str
    scenario_folder: str
    variants: tuple[VariantResult, ...]
    targets: tuple[str, ...]  # names by flag: background, ground, then all variants' targets
    # of each variant: the angles of the columns and of the rows from the image centre
    pixel_angles_mrad: tuple[tuple[Array, Array], ...]
    conditions: tuple[tuple[str, ...], ...]  # each variant's frequency, range and air, in words
    figure_columns: int | None
    limits: str | tuple[float, float]  # of the picture: "panel", "shared", or both ends
    color_map: str  # of the images in the picture
    picture_format: str  # "png", "pdf" or "svg", where a command names the file
    width_mm: int | None  # of the picture in print; None on a screen
    difference: tuple[str, str] | None  # two variants, the difference of whose images is stored too
    grid_rotations: tuple[Array, ...]  # of each variant
    device: str
    seed: int
    noise_seed: int | None  # None where no image has noise
    build_options: tuple[str, ...]
    seconds: dict[str, float]
    left_out: tuple[dict[str, str], ...]
    warnings: tuple[str, ...]
    error_budget: dict[str, dict[str, Any]]
    voxel_segments: int
    versions: dict[str, str]
    cubes: tuple[Cube, ...] = ()  # one, or one for each variant
    models: tuple[str, ...] = ()  # where models are compared: their names, that of the images first
    spread_shown: bool = False  # whether pictures show how far the models differ
    airs: tuple[dict[str, Any], ...] = ()  # how humidity fluctuates in each variant
    skies: tuple[dict[str, Any], ...] = ()  # of the variants that see one, by elevation
    history: str = ""  # when and by what it was made

    def image_difference(self) -> Array | None:
        """Returns the first image of `difference` less the second, (y, x).

        Returns None if `difference` is None, or if one of the two images is missing.
        """
        if self.difference is None:
            return None
        images = {variant.name: variant.image for variant in self.variants}
        one, other = (images.get(name) for name in self.difference)
        if one is None or other is None:
            return None
        difference: Array = np.asarray(one.values) - np.asarray(other.values)
        return difference


def seen_at(one: VariantResult | ModelResult, number: int) -> VariantResult | ModelResult:
    """Returns a variant or a model at one of its frequencies or bands.

    The image of a sensor that sees them one by one is that of the frequency; others have one image
    of all.
    """
    if len(one.sight.frequency_hz) == 1:
        return one
    sight = at_frequency(one.sight, number)
    if not isinstance(one, VariantResult):
        return replace(one, sight=sight)
    image = one.image
    if image is None or not image.mean_over_frequencies or not isinstance(sight, Radiances):
        return replace(one, sight=sight)
    return replace(one, sight=sight, image=replace(image, values=sight.brightness_temperature[0]))


def at_frequency(sight: Radiances | Echoes, number: int) -> Radiances | Echoes:
    """Returns what reached the pixels at one of several frequencies or bands."""
    if len(sight.frequency_hz) == 1:
        return sight
    one = slice(number, number + 1)
    changes: dict[str, Any] = {
        "frequency_hz": sight.frequency_hz[one],
        "optical_depth": sight.optical_depth[one],
        "weights": None if sight.weights is None else sight.weights[one],
        "bounds_hz": None if sight.bounds_hz is None else sight.bounds_hz[one],
    }
    if isinstance(sight, Echoes):
        of_air = None if sight.path_return is None else sight.path_return[one]
        return replace(sight, **changes, returned=sight.returned[one], path_return=of_air)
    return replace(
        sight, **changes, contrast=sight.contrast[one], air_radiance=sight.air_radiance[one]
    )
