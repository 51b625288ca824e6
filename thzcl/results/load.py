"""Reads a result back from its file, with what the file holds of it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from thzcl.errors import FileError
from thzcl.files import RESULT, open_netcdf
from thzcl.results.contents import Array, Cube, ModelResult, VariantResult
from thzcl.results.netcdf import PLANE, REFERENCE, VOXELS
from thzcl.scenario.document import frozen
from thzcl.scenario.scene import Output
from thzcl.scenario.text import load as load_toml
from thzcl.sensor import Decibels, Echoes, Image, Layer, Radiances
from thzcl.turbulence.lattice import Lattice

# What a result's file holds of each pixel beside the sensor's image and its layers.
SEEN = frozenset(
    {
        *("radiance", "brightness_temperature", "brightness_temperature_contrast"),
        *("optical_depth", "path_length", "target", "image", "image_difference"),
    }
)


def fields(path: Path) -> dict[str, Any]:
    """Returns the fields of Contents of a result file. Raises FileError.

    Values are as exact as the file holds them. What it does not hold is NaN, or None: what returns
    to an active sensor, the contrast of radiance by models to compare with, cosines, and weights.
    """
    with open_netcdf(path, RESULT) as file:
        return _Stored(path, file).fields()


class _Stored:
    """An open result file."""

    def __init__(self, path: Path, file: Any) -> None:
        self.path, self.file = path, file
        if "scenario_toml" not in file.attrs or REFERENCE not in file.attrs:
            raise FileError(f"{path}: holds no whole result; give one that thzcl run has written")
        if "time" in file:
            raise FileError(f"{path}: holds the frames of a sequence; open it with xarray")
        self.text = {name: _text(value) for name, value in file.attrs.items()}
        self.reference = json.loads(self.text[REFERENCE])
        self.names = [_text(name) for name in file["variant"][...]]
        self.models = [_text(name) for name in file["model"][...]] if "model" in file else []

    def fields(self) -> dict[str, Any]:
        """Returns the fields of Contents."""
        text, count = self.text, len(self.names)
        tables = load_toml(text["scenario_toml"], str(self.path))
        output = Output.model_validate(frozen(tables.get("output", {})))
        rotation = np.array(json.loads(text["grid_rotation"]), dtype=float)
        angles = zip(self._each("x_angle", 1), self._each("y_angle", 1), strict=True)
        told = {name: json.loads(text[name]) for name in ("seconds", "versions", "error_budget")}
        several = {
            name: tuple(json.loads(text[stored]))
            for name, stored in (
                *(("build_options",) * 2, ("left_out",) * 2, ("warnings",) * 2),
                *(("airs", "air"), ("skies", "sky")),
            )
        }
        return {
            **told,
            **several,
            "scenario": text["scenario_name"],
            "scenario_toml": text["scenario_toml"],
            "scenario_folder": text["scenario_folder"],
            "variants": tuple(self._variants()),
            "targets": tuple(self.reference["targets"]),
            "pixel_angles_mrad": tuple(angles),
            "conditions": tuple(map(tuple, self.reference["conditions"])),
            "figure_columns": output.figure_columns,
            "limits": output.limits,
            "color_map": output.color_map,
            "picture_format": output.format,
            "width_mm": output.width_mm,
            "difference": output.difference,
            "grid_rotations": (rotation,) * count if rotation.ndim == 2 else tuple(rotation),
            "device": text["device"],
            "history": text.get("history", ""),
            "seed": int(text["seed"]),
            "noise_seed": int(text["noise_seed"]) if "noise_seed" in text else None,
            "voxel_segments": int(text["voxel_segments"]),
            "cubes": tuple(self._cubes()),
            "models": tuple(self.models),
            "spread_shown": output.model_spread,
        }

    def _variants(self) -> Iterator[VariantResult]:
        """Yields each variant."""
        summary = json.loads(self.text.get("summary", "[]"))
        facts = [
            {name: (one["value"], one["unit"]) for name, one in told["facts"].items()}
            for told in summary
        ] or [{} for _ in self.names]
        for number, name in enumerate(self.names):
            main, *others = self._models(number)
            cell = tuple(self.reference["resolution_cells"][number])
            image = self._image(number, facts[number])
            yield VariantResult(name, main.sight, image, tuple(others), cell)

    def _models(self, number: int) -> Iterator[ModelResult]:
        """Yields what reached the pixels of a variant by each model, that of the image first."""
        for row, model in enumerate(self.models or [""]):
            depth = self._of_model("optical_depth", number, row)
            planes = [plane for plane, one in enumerate(depth) if not np.isnan(one).all()]
            if planes:
                sight = self._sight(number, row, depth, planes)
                yield ModelResult(model, tuple(planes), sight)

    def _sight(self, number: int, row: int, depth: Array, planes: list[int]) -> Radiances | Echoes:
        """Returns what reached the pixels at those frequencies at which a model is valid."""
        length, target = (self._each(name, 2)[number] for name in ("path_length", "target"))
        told = self.reference["pixels"][number]
        kept = depth[planes], length, target, None, told["solid_angle"]
        angles = {
            "pixel_angle_rad": tuple(told["angle_rad"]),
            "integration_time_s": told["integration_time_s"],
        }
        hz = self._frequencies()[number][planes] * 1e9
        bounds = None
        if "frequency_bounds" in self.file:
            bounds = self._each("frequency_bounds", 2)[number][planes] * 1e9
        if "brightness_temperature_contrast" not in self.file:
            nothing = np.full(depth[planes].shape, np.nan)
            away = np.full(length.shape, np.nan)
            return Echoes(hz, *kept, hz, None, nothing, away, bounds_hz=bounds, **angles)
        air = self.reference["air"][number]
        kelvin = self._of_model("brightness_temperature_contrast", number, row)[planes]
        base = np.array(air["radiance"])[planes]
        radiance = self._each("radiance", 3)[number][planes]
        contrast = np.subtract(radiance, base[:, None, None], dtype=np.float64)
        if row:
            contrast = np.full(kelvin.shape, np.nan)  # the file has the image's own alone
        air_k = air["temperature_k"]
        sight = Radiances(hz, *kept, hz, None, contrast, base, air_k, bounds_hz=bounds, **angles)
        sight.__dict__["brightness_temperature_contrast"] = kelvin  # as stored
        return sight

    def _image(self, number: int, facts: Mapping[str, tuple[float, str]]) -> Image | None:
        """Returns the image of a variant with its layers, or None if there is none."""
        if "image" not in self.file:
            return None
        layers = {}
        for name, one in self.file.items():
            if name not in SEEN and one.ndim == 3 and self._is_plane(one):
                flags = tuple(_text(one.attrs.get("flag_meanings", "")).split())
                layers[name] = Layer(one[number], *self._told(name), flags)
        words, mean = self.reference["captions"][number], self.reference["means"][number]
        values, of = self.file["image"][number], self.reference["decibels"][number]
        decibels = None if of is None else Decibels(*of)
        return Image(values, *self._told("image"), layers, facts, decibels, words, mean)

    def _is_plane(self, variable: Any) -> bool:
        """Returns whether a variable of three dimensions is one over the pixels of variants."""
        shape = self.file["image"].shape
        return variable.shape == shape and "coordinates" in variable.attrs

    def _told(self, name: str) -> tuple[str, str]:
        """Returns the unit, which flags do not have, and the quantity of a variable."""
        attrs = self.file[name].attrs
        return _text(attrs.get("units", "1")), _text(attrs["long_name"])

    def _of_model(self, name: str, number: int, row: int) -> Array:
        """Returns a variable's values (frequency, y, x) by one model."""
        values = self.file[name]
        return np.asarray(values[row, number] if self.models else values[number])

    def _each(self, name: str, dimensions: int) -> list[Array]:
        """Returns the values for each variant of a variable that may be the same for all."""
        values = np.asarray(self.file[name][...])
        alike = values.ndim == dimensions
        return [values] * len(self.names) if alike else list(values)

    def _frequencies(self) -> list[Array]:
        """Returns the frequencies of each variant, GHz."""
        name = "variant_frequency" if "variant_frequency" in self.file else "frequency"
        return self._each(name, 1)

    def _cubes(self) -> Iterator[Cube]:
        """Yields the saved cubes."""
        if "absolute_humidity" not in self.file:
            return
        grams = self.file["absolute_humidity"]
        warmth = self.file.get("air_temperature")
        edges = np.broadcast_to(grams.attrs["voxel_m"], 3)
        shape = grams.shape[:-4:-1]
        first = [float(self.file[name][0]) for name in VOXELS[::-1]]
        corner = [one - edge / 2 for one, edge in zip(first, edges, strict=True)]
        periodic = np.broadcast_to(grams.attrs["periodic"], 3)
        ends = [None if one else count for one, count in zip(periodic, shape, strict=True)]
        # Three of each, which mypy cannot see.
        lattice = Lattice(shape, tuple(edges.tolist()), tuple(corner), tuple(ends))  # type: ignore[arg-type]
        several = grams.ndim == len((*VOXELS, *PLANE)) - 1
        for number in range(len(self.names) if several else 1):
            of_one = (slice(None),) if not several else (number,)
            kelvin = None if warmth is None else warmth[number if warmth.ndim == 4 else ...]
            yield Cube(grams[of_one], kelvin, lattice)


def _text(value: Any) -> str:
    """Returns an attribute or a name as text."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
