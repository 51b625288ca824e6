"""The result of a run: images and what led to them, as NetCDF file, xarray dataset.

Tables and pictures.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.files import Patient, write_whole
from thzcl.sensor import Echoes, Image, Radiances

if TYPE_CHECKING:
    import xarray

Array = NDArray[Any]
SPECTRAL = ("frequency", "y", "x")
PLANE = ("y", "x")


class Variable(NamedTuple):
    """A variable of the result file."""

    dims: tuple[str, ...]
    values: Array
    attrs: dict[str, Any]


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
class Result:
    """All that a run found out."""

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

    def save(self, path: str | Path) -> Path:
        """Writes the NetCDF-4 file, whole or not at all. Raises OSError."""
        path = Path(path)
        write_whole(path, self._write_netcdf)
        return path

    def figure(self, path: str | Path) -> Path:
        """Writes a PNG of the variants side by side, whole or not at all. Raises OSError."""
        from thzcl.results.figure import picture

        path = Path(path)
        write_whole(path, lambda part: picture(self, part))
        return path

    def to_xarray(self) -> xarray.Dataset:
        """The result as an xarray dataset, as it stands in the file. Needs the xarray package."""
        import xarray

        variables = {name: (v.dims, v.values, v.attrs) for name, v in self._variables().items()}
        coordinates = {name: (v.dims, v.values, v.attrs) for name, v in self._coordinates().items()}
        return xarray.Dataset(variables, coordinates, self.attributes())

    def attributes(self) -> dict[str, Any]:
        """Global attributes; structured ones as JSON."""
        return {
            "Conventions": "CF-1.11",
            "title": f"{self.scenario}: terahertz images",
            "source": f"thzcl {self.versions['thzcl']}",
            "scenario_name": self.scenario,
            "scenario_toml": self.scenario_toml,
            "scenario_folder": self.scenario_folder,
            "versions": json.dumps(self.versions),
            "device": self.device,
            "seed": np.int64(self.seed),
            "build_options": json.dumps(self.build_options),
            "seconds": json.dumps(self.seconds),
            "left_out": json.dumps(self.left_out),
            "warnings": json.dumps(self.warnings),
            "error_budget": json.dumps(self.error_budget),
            "voxel_segments": np.int64(self.voxel_segments),
            "grid_rotation": json.dumps(np.asarray(self.grid_rotation).tolist()),
        }

    def summary(self) -> dict[str, Any]:
        """What `thzcl run --format json` prints, less the files."""
        return {
            "scenario": self.scenario,
            "device": self.device,
            "seed": self.seed,
            "seconds": self.seconds,
            "left_out": list(self.left_out),
            "warnings": list(self.warnings),
            "error_budget": self.error_budget,
            "voxel_segments": self.voxel_segments,
            "variants": [self._variant_summary(v) for v in self.variants],
        }

    def _variant_summary(self, variant: VariantResult) -> dict[str, Any]:
        facts = variant.image.facts if variant.image else {}
        told = {name: {"value": value, "unit": unit} for name, (value, unit) in facts.items()}
        return {"name": variant.name, "targets": self._target_table(variant), "facts": told}

    def image_difference(self) -> Array | None:
        """The first named variant's image less the second's, (y, x), where asked for."""
        images = {v.name: v.image for v in self.variants}
        if self.difference is None:
            return None
        one, other = (images.get(name) for name in self.difference)
        return (
            None
            if one is None or other is None
            else np.asarray(one.values) - np.asarray(other.values)
        )

    def _target_table(self, variant: VariantResult) -> dict[str, dict[str, float | None]]:
        """Per target: pixels, contrast to the air and its spread in K, depth and transmission, over all frequencies.

        An active sensor has no contrast in kelvin; its depth and transmission are those of the way out and back.
        """
        sight = variant.sight
        flags = sight.target.ravel().astype(np.intp)
        pixels = np.bincount(flags, minlength=len(self.targets))
        seen = np.maximum(pixels, 1)

        def means(plane: Array) -> Array:
            return np.asarray(
                np.bincount(flags, weights=plane.ravel(), minlength=len(self.targets)) / seen
            )

        depth = means(sight.optical_depth.mean(axis=0))
        passed = means(np.exp(-sight.optical_depth).mean(axis=0))
        contrast = spread = None
        if isinstance(sight, Radiances):
            above = sight.brightness_temperature_contrast.mean(axis=0).ravel()
            contrast = means(above)
            spread = np.sqrt(means((above - contrast[flags]) ** 2))
        return {
            name: {
                "pixels": int(pixels[flag]),
                "mean_contrast_k": None if contrast is None else float(contrast[flag]),
                "std_k": None if spread is None else float(spread[flag]),
                "optical_depth": float(depth[flag]),
                "transmission": float(passed[flag]),
            }
            for flag, name in enumerate(self.targets)
            if pixels[flag]
        }

    def _repr_html_(self) -> str:
        """A short table for notebooks."""
        rows = [
            f"<tr><td>{v.name}</td><td>{target}</td><td>{values['pixels']}</td><td>{_kelvins(values['mean_contrast_k'])}</td>"
            f"<td>{values['transmission']:.3g}</td></tr>"
            for v in self.variants
            for target, values in self._target_table(v).items()
        ]
        head = "<tr><th>variant</th><th>target</th><th>pixels</th><th>contrast to air</th><th>transmission</th></tr>"
        return f"<h4>{self.scenario}</h4><p>{self.device}, seed {self.seed}</p><table>{head}{''.join(rows)}</table>"

    def _coordinates(self) -> dict[str, Variable]:
        frequencies = np.array([v.sight.frequency_hz for v in self.variants]) / 1e9
        same = bool((frequencies == frequencies[0]).all())
        dims, values = (
            (("frequency",), frequencies[0]) if same else (("variant", "frequency"), frequencies)
        )
        columns, rows = self.pixel_angles_mrad
        return {
            "variant": Variable(
                ("variant",), np.array([v.name for v in self.variants], dtype=object), {}
            ),
            "frequency" if same else "variant_frequency": Variable(
                dims, values, {"units": "GHz", "long_name": "frequency"}
            ),
            "y": Variable(
                ("y",), np.arange(len(rows)), {"units": "1", "long_name": "pixel row, 0 at the top"}
            ),
            "x": Variable(
                ("x",),
                np.arange(len(columns)),
                {"units": "1", "long_name": "pixel column, 0 at the left"},
            ),
            "y_angle": Variable(
                ("y",), rows, {"units": "mrad", "long_name": "angle above the image centre"}
            ),
            "x_angle": Variable(
                ("x",), columns, {"units": "mrad", "long_name": "angle right of the image centre"}
            ),
        }

    def _variables(self) -> dict[str, Variable]:
        sights = [v.sight for v in self.variants]
        passive = [sight for sight in sights if isinstance(sight, Radiances)]
        kind = np.result_type(*(sight.optical_depth for sight in sights))
        found = {
            **_radiometric(passive, kind),
            "optical_depth": _spectral(
                [(0.0, s.optical_depth) for s in sights], "1", _depth_name(sights[0]), kind
            ),
            "path_length": _shared(
                [s.path_length for s in sights], {"units": "m", "long_name": "length of the ray"}
            ),
            "target": _shared([s.target for s in sights], self._flags()),
            **_images(
                [v.image for v in self.variants if v.image is not None], len(self.variants), kind
            ),
        }
        difference = self.image_difference()
        if difference is not None and self.difference is not None:
            attrs = found["image"].attrs | {
                "long_name": f"{self.difference[0]} less {self.difference[1]}"
            }
            found["image_difference"] = Variable(PLANE, difference, attrs)
        return found | self._cubes()

    def _flags(self) -> dict[str, Any]:
        meanings = " ".join(name.replace(" ", "_") for name in self.targets)
        flags = np.arange(len(self.targets), dtype=np.int32)
        return {
            "long_name": "what the pixel shows",
            "flag_values": flags,
            "flag_meanings": meanings,
        }

    def _cubes(self) -> dict[str, Variable]:
        if not self.cubes:
            return {}
        axes = ("z_voxel", "y_voxel", "x_voxel")
        attrs = {
            "units": "g m-3",
            "long_name": "absolute humidity of the cube's voxels",
            "voxel_m": self.cubes[0].voxel_m,
        }
        found = {
            "absolute_humidity": _shared(
                [c.absolute_humidity_g_m3 for c in self.cubes], attrs, axes
            )
        }
        warmth = [c.air_temperature_k for c in self.cubes if c.air_temperature_k is not None]
        if len(warmth) == len(self.cubes):
            attrs = {
                "units": "K",
                "long_name": "air temperature of the cube's voxels",
                "voxel_m": self.cubes[0].voxel_m,
            }
            found["air_temperature"] = _shared(warmth, attrs, axes)
        return found

    def _write_netcdf(self, path: Path) -> None:
        import h5netcdf
        import h5py

        coordinates, variables = self._coordinates(), self._variables()
        with Patient(path) as kept, h5netcdf.File(kept, "w") as file:
            file.attrs.update(self.attributes())
            for variable in (*coordinates.values(), *variables.values()):
                for name, size in zip(variable.dims, variable.values.shape, strict=True):
                    if name not in file.dimensions:
                        file.dimensions[name] = size
            for name, variable in (coordinates | variables).items():
                kind = (
                    h5py.string_dtype()
                    if variable.values.dtype == object
                    else variable.values.dtype
                )
                stored = file.create_variable(name, variable.dims, kind, data=variable.values)
                stored.attrs.update(variable.attrs)


def _kelvins(value: float | None) -> str:
    return "" if value is None else f"{value:+.4g} K"


def _depth_name(sight: Radiances | Echoes) -> str:
    active = isinstance(sight, Echoes)
    return "optical depth, out and back" if active else "optical depth to the end of the ray"


def _radiometric(passive: list[Radiances], kind: Any) -> dict[str, Variable]:
    """Radiances and brightness temperatures, which an active sensor does not have."""
    if not passive:
        return {}
    contrast = "brightness_temperature_contrast"
    above = "brightness temperature above the mean air's"
    radiances = [(s.air_radiance[:, None, None], s.contrast) for s in passive]
    kelvins = [s.brightness_temperature_contrast for s in passive]
    airs = [s.air_temperature_k for s in passive]
    return {
        "radiance": _spectral(radiances, "W m-2 sr-1 Hz-1", "spectral radiance", kind),
        "brightness_temperature": _spectral(
            list(zip(airs, kelvins, strict=True)), "K", "brightness temperature", kind
        ),
        contrast: _spectral([(0.0, kelvin) for kelvin in kelvins], "K", above, kind),
    }


def _spectral(sums: list[tuple[Any, Array]], units: str, name: str, kind: Any) -> Variable:
    """One term and the other of each variant, added at once in the type that is stored."""
    stored = np.empty((len(sums), *sums[0][1].shape), kind)
    for (base, plane), out in zip(sums, stored, strict=True):
        np.add(base, plane, out=out, casting="same_kind")
    attrs = {"units": units, "long_name": name, "coordinates": "y_angle x_angle"}
    return Variable(("variant", *SPECTRAL), stored, attrs)


def _shared(
    values: list[Array], attrs: Mapping[str, Any], dims: tuple[str, ...] = PLANE
) -> Variable:
    """With a variant dimension only where the variants differ."""
    if all(v is values[0] or np.array_equal(v, values[0]) for v in values):
        return Variable(dims, values[0], dict(attrs))
    return Variable(("variant", *dims), np.stack(values), dict(attrs))


def _images(images: list[Image], variants: int, kind: Any) -> dict[str, Variable]:
    """The sensor's image and further layers, where every variant has them."""
    if len(images) != variants:
        return {}
    attrs = {
        "units": images[0].unit,
        "long_name": images[0].quantity,
        "coordinates": "y_angle x_angle",
    }
    found = {
        "image": Variable(
            ("variant", *PLANE), _stacked([image.values for image in images], kind), attrs
        )
    }
    for name, layer in images[0].layers.items():
        attrs = {"units": layer.unit, "long_name": layer.quantity, "coordinates": "y_angle x_angle"}
        found[name] = Variable(
            ("variant", *PLANE),
            _stacked([image.layers[name].values for image in images], kind),
            attrs,
        )
    return found


def _stacked(values: list[Array], kind: Any) -> Array:
    """Planes of real numbers at the precision of the arithmetic; others as they are."""
    return np.stack(
        values, dtype=kind if np.asarray(values[0]).dtype.kind == "f" else None, casting="same_kind"
    )
