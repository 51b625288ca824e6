"""The result file: NetCDF-4 after the CF conventions.

thzcl.sensor.RESERVED_NAMES lists the names of its variables and dimensions.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from thzcl.files import readable
from thzcl.results.contents import Array, Contents, Cube
from thzcl.results.patient import Patient
from thzcl.results.spread import signal
from thzcl.results.summary import of_variant
from thzcl.sensor import Echoes, Image, Layer, Radiances

MOST_LETTERS = 60_000  # of an attribute: HDF5 holds 64 KiB
REFERENCE = "reference"  # the attribute with what else a result needs that is read again
CHEAP_BYTES = 2**20  # of real numbers: to deflate as many takes some 50 ms
ON_SCALE = {"units_metadata": "temperature: on_scale"}
DIFFERENCE = {"units_metadata": "temperature: difference"}
PLANE = ("y", "x")
SPECTRAL = ("frequency", *PLANE)
VOXELS = ("z_voxel", "y_voxel", "x_voxel")


class Variable(NamedTuple):
    """A variable of the result file: names of its dimensions, values and attributes."""

    dims: tuple[str, ...]
    values: Array
    attrs: dict[str, Any]


def write(result: Contents, path: Path) -> None:
    """Writes the file of a result. Raises OSError if that fails."""
    import h5netcdf
    import h5py

    stored = coordinates(result) | variables(result)
    with Patient(path) as raw, h5netcdf.File(raw, "w") as file:
        file.attrs.update(attributes(result))
        for variable in stored.values():
            for name, size in zip(variable.dims, variable.values.shape, strict=True):
                if name not in file.dimensions:
                    file.dimensions[name] = size
        for name, (dims, values, attrs) in stored.items():
            kind = h5py.string_dtype() if values.dtype == object else values.dtype
            made = file.create_variable(name, dims, kind, data=values, **compression(values))
            made.attrs.update(attrs)


def compression(values: Array) -> dict[str, Any]:
    """Returns how values are stored: deflated where that is cheap.

    Whole numbers are flags and counts, which shrink to next to nothing.
    """
    kind, small = values.dtype.kind, values.nbytes <= CHEAP_BYTES
    if values.size < 2 or not (kind in "iu" or (kind == "f" and small)):
        return {}
    return {"compression": "gzip", "compression_opts": 1, "shuffle": True}


def attributes(result: Contents) -> dict[str, Any]:
    """Returns the global attributes; lists and tables among them are JSON."""
    scenario = readable(result.scenario)
    noise = {} if result.noise_seed is None else {"noise_seed": np.int64(result.noise_seed)}
    return {
        "Conventions": "CF-1.11",
        "title": f"{scenario}: terahertz images",
        "source": f"thzcl {result.versions['thzcl']}",
        "history": result.history,
        "scenario_name": scenario,
        "scenario_toml": result.scenario_toml,
        "scenario_folder": readable(result.scenario_folder),
        "versions": json.dumps(result.versions),
        "device": result.device,
        "seed": np.int64(result.seed),
        **noise,
        "build_options": json.dumps(result.build_options),
        "seconds": json.dumps(result.seconds),
        "left_out": json.dumps(result.left_out),
        "warnings": json.dumps(result.warnings),
        "error_budget": json.dumps(result.error_budget),
        "air": json.dumps(result.airs),
        "sky": json.dumps(result.skies),
        **_summary(result),
        REFERENCE: json.dumps(_reference(result)),
        "voxel_segments": np.int64(result.voxel_segments),
        "grid_rotation": json.dumps(_rotation(result.grid_rotations)),
    }


def _reference(result: Contents) -> dict[str, Any]:
    """Returns what else Result.load needs, most of it words."""
    passive = [one.sight for one in result.variants if isinstance(one.sight, Radiances)]
    return {
        "air": [
            {"temperature_k": one.air_temperature_k, "radiance": one.air_radiance.tolist()}
            for one in passive
        ],
        "pixels": [
            {
                "angle_rad": one.sight.pixel_angle_rad,
                "solid_angle": one.sight.pixel_solid_angle,
                "integration_time_s": one.sight.integration_time_s,
            }
            for one in result.variants
        ],
        "decibels": [_decibels(one.image) for one in result.variants],
        "targets": result.targets,
        "resolution_cells": [one.cell for one in result.variants],
        "conditions": result.conditions,
        "captions": [one.image.caption if one.image else "" for one in result.variants],
        "means": [bool(one.image and one.image.mean_over_frequencies) for one in result.variants],
    }


def _decibels(image: Image | None) -> tuple[str, float] | None:
    """Returns the layer that an image in decibels is made of and its reference, or None."""
    of = image.decibels if image else None
    return None if of is None else (of.layer, of.reference)


def _summary(result: Contents) -> dict[str, str]:
    """Returns what is told of targets and images, unless an attribute cannot hold it."""
    text = json.dumps([of_variant(variant, result) for variant in result.variants])
    return {"summary": text} if len(text) < MOST_LETTERS else {}


def _rotation(rotations: tuple[Array, ...]) -> Any:
    """Returns the rotation (3, 3) of the cube, or that of each variant's cube if they differ."""
    same = all(np.array_equal(one, rotations[0]) for one in rotations)
    return rotations[0].tolist() if same else [one.tolist() for one in rotations]


def coordinates(result: Contents) -> dict[str, Variable]:
    """Returns the coordinates: variants, frequencies in GHz, pixels and their angles in mrad."""
    names = np.array([variant.name for variant in result.variants], dtype=object)
    columns, rows = (list(angles) for angles in zip(*result.pixel_angles_mrad, strict=True))
    models = np.array(result.models, dtype=object)
    return {
        **({"model": Variable(("model",), models, {})} if result.models else {}),
        "variant": Variable(("variant",), names, {}),
        **_frequencies(result),
        "y": _coordinate("y", np.arange(len(rows[0])), "1", "pixel row, 0 at the top"),
        "x": _coordinate("x", np.arange(len(columns[0])), "1", "pixel column, 0 at the left"),
        "y_angle": _shared(rows, _attrs("mrad", "angle above the image centre"), ("y",)),
        "x_angle": _shared(columns, _attrs("mrad", "angle right of the image centre"), ("x",)),
    }


def _frequencies(result: Contents) -> dict[str, Variable]:
    """Returns one axis of frequencies in GHz, or one for each variant if they differ."""
    values = np.array([variant.sight.frequency_hz for variant in result.variants]) / 1e9
    bounds = _bounds(result)
    name = "frequency" if bounds is None else "mean frequency of the band"
    kind = "radiation" if bounds is None else "sensor_band_central_radiation"
    attrs = _attrs("GHz", name) | {"standard_name": f"{kind}_frequency"}
    found = {}
    if (values == values[0]).all():
        found["frequency"] = Variable(("frequency",), values[0], attrs)
    else:
        found["variant_frequency"] = Variable(("variant", "frequency"), values, attrs)
    if bounds is not None:
        edges = _shared(list(bounds), {}, ("frequency", "bounds"))
        if "frequency" in found and edges.dims[0] == "frequency":
            attrs["bounds"] = "frequency_bounds"  # CF knows bounds of axes, with the axis' unit
        else:
            edges.attrs.update(_attrs("GHz", "lowest and highest frequency of the band"))
        found["frequency_bounds"] = edges
    return found


def _bounds(result: Contents) -> Array | None:
    """Returns the lowest and highest frequencies of bands, GHz, (variant, frequency, 2).

    Returns None where a variant has single frequencies, or a sensor that does not tell.
    """
    bounds = [v.sight.bounds_hz for v in result.variants if v.sight.bounds_hz is not None]
    return np.array(bounds) / 1e9 if len(bounds) == len(result.variants) else None


def _coordinate(dimension: str, values: Array, units: str, name: str) -> Variable:
    """Returns a coordinate along one dimension."""
    return Variable((dimension,), values, _attrs(units, name))


def _attrs(units: str, name: str) -> dict[str, str]:
    """Returns the attributes of a variable with a unit."""
    return {"units": units, "long_name": name}


def variables(result: Contents) -> dict[str, Variable]:
    """Returns the data variables, among them those that the sensors add."""
    sights = [variant.sight for variant in result.variants]
    passive = [sight for sight in sights if isinstance(sight, Radiances)]
    kind = np.result_type(*(sight.optical_depth for sight in sights))
    active = isinstance(sights[0], Echoes)
    depth = "optical depth, out and back" if active else "optical depth to the end of the ray"
    length = {"units": "m", "long_name": "length of the ray"}
    images = [variant.image for variant in result.variants if variant.image is not None]
    several = len(sights[0].frequency_hz) > 1
    found = {
        **_radiometric(passive, kind),
        **(_contrast(result, kind) if passive else {}),
        "optical_depth": _by_model(result, _depth, _pixel_attrs("1", depth), kind),
        "path_length": _shared([sight.path_length for sight in sights], length),
        "target": _shared([sight.target for sight in sights], _flags(result.targets)),
        **(_images(images, kind, several) if len(images) == len(sights) else {}),
    }
    return found | _difference(result, found) | _cubes(result.cubes)


def _radiometric(passive: list[Radiances], kind: Any) -> dict[str, Variable]:
    """Returns radiances and brightness temperatures, which an active sensor does not have."""
    if not passive:
        return {}
    radiances = [(s.air_radiance[:, None, None], s.contrast) for s in passive]
    absolute = [(s.air_temperature_k, s.brightness_temperature_contrast) for s in passive]
    standard = {"standard_name": "brightness_temperature"}
    return {
        "radiance": _spectral(radiances, "W m-2 sr-1 Hz-1", "spectral radiance", {}, kind),
        "brightness_temperature": _spectral(
            absolute, "K", "brightness temperature", ON_SCALE | standard, kind
        ),
    }


def _contrast(result: Contents, kind: Any) -> dict[str, Variable]:
    """Returns the contrast of a passive sensor's pixels."""
    attrs = _pixel_attrs("K", "brightness temperature above the mean air's") | DIFFERENCE
    return {"brightness_temperature_contrast": _by_model(result, signal, attrs, kind)}


def _depth(sight: Radiances | Echoes) -> Array:
    """Returns the optical depth, (frequency, y, x)."""
    return sight.optical_depth


def _by_model(
    result: Contents, of: Callable[[Radiances | Echoes], Array], attrs: dict[str, Any], kind: Any
) -> Variable:
    """Returns a variable (variant, frequency, y, x), for each model where several are compared.

    `of` gives its values for what reached the pixels of one image. They are NaN where a model is
    not valid.
    """
    models = result.models or ("",)
    planes = of(result.variants[0].sight).shape
    stored = np.full((len(models), len(result.variants), *planes), np.nan, kind)
    for number, variant in enumerate(result.variants):
        for one in variant.by_model(models[0]):
            stored[models.index(one.name), number, list(one.planes)] = of(one.sight)
    if result.models:
        return Variable(("model", "variant", *SPECTRAL), stored, attrs)
    return Variable(("variant", *SPECTRAL), stored[0], attrs)


def _spectral(
    sums: list[tuple[Any, Array]], units: str, name: str, more: dict[str, str], kind: Any
) -> Variable:
    """Returns a variable (variant, frequency, y, x), the sum of two terms for each variant.

    The sums are formed in the type `kind`, in which they are stored.
    """
    stored = np.empty((len(sums), *sums[0][1].shape), kind)
    for (base, plane), out in zip(sums, stored, strict=True):
        np.add(base, plane, out=out, casting="same_kind")
    return Variable(("variant", *SPECTRAL), stored, _pixel_attrs(units, name) | more)


def _pixel_attrs(units: str, name: str) -> dict[str, Any]:
    """Returns the attributes of a variable over the pixels."""
    return {"units": units, "long_name": name, "coordinates": "y_angle x_angle"}


def _shared(
    values: list[Array], attrs: Mapping[str, Any], dims: tuple[str, ...] = PLANE
) -> Variable:
    """Returns a variable that has the dimension variant only if the variants' values differ."""
    if all(v is values[0] or np.array_equal(v, values[0]) for v in values):
        return Variable(dims, values[0], dict(attrs))
    return Variable(("variant", *dims), np.stack(values), dict(attrs))


def _flags(targets: tuple[str, ...]) -> dict[str, Any]:
    """Returns the attributes of the variable `target`, with the name of each target."""
    return {
        "long_name": "what the pixel shows",
        "flag_values": np.arange(len(targets), dtype=np.int32),
        "flag_meanings": " ".join(name.replace(" ", "_") for name in targets),
    }


def _images(images: list[Image], kind: Any, several: bool) -> dict[str, Variable]:
    """Returns the sensors' images, and the layers that all images have, (variant, y, x).

    `several` says whether they are of several frequencies.
    """
    first = images[0]
    attrs = _pixel_attrs(first.unit, first.quantity)
    if several and all(image.mean_over_frequencies for image in images):
        attrs = attrs | {"comment": "mean over the sensor's frequencies"}
    planes = {"image": (attrs, [image.values for image in images])}
    for name in first.layers:
        if all(name in image.layers for image in images):
            values = [image.layers[name].values for image in images]
            planes[name] = (_layer_attrs([image.layers[name] for image in images]), values)
    return {
        name: Variable(("variant", *PLANE), _stacked(values, kind), attrs)
        for name, (attrs, values) in planes.items()
    }


def _layer_attrs(layers: list[Layer]) -> dict[str, Any]:
    """Returns the attributes of a sensor's layer; flags have meanings in place of a unit."""
    first = layers[0]
    attrs = _pixel_attrs(first.unit, first.quantity)
    flags = first.flags
    if not flags or any(layer.flags != flags for layer in layers):
        return attrs
    del attrs["units"]
    kind = np.result_type(*(np.asarray(layer.values) for layer in layers))
    return attrs | {
        "flag_values": np.arange(len(flags), dtype=kind),
        "flag_meanings": " ".join(flags),
    }


def _stacked(values: list[Array], kind: Any) -> Array:
    """Returns planes in one array: real numbers in the type `kind`, others in their own."""
    real = np.asarray(values[0]).dtype.kind == "f"
    return np.stack(values, dtype=kind if real else None, casting="same_kind")


def _difference(result: Contents, found: Mapping[str, Variable]) -> dict[str, Variable]:
    """Returns the difference of two images, if the scene asks for it."""
    values = result.image_difference()
    if values is None or result.difference is None:
        return {}
    attrs = _pixel_attrs(found["image"].attrs["units"], " less ".join(result.difference))
    if attrs["units"] == "K":
        attrs |= DIFFERENCE
    if "variant" in coordinates(result)["x_angle"].dims:
        del attrs["coordinates"]
    return {"image_difference": Variable(PLANE, values, attrs)}


def _cubes(cubes: tuple[Cube, ...]) -> dict[str, Variable]:
    """Returns the humidity and, if it fluctuates, the temperature of the saved cubes' voxels.

    Coordinates are the middles of voxels along the cube's own axes.
    """
    if not cubes:
        return {}
    lattice = cubes[0].lattice
    edges = lattice.voxel_m
    size: dict[str, Any] = {"voxel_m": edges[0] if len({*edges}) == 1 else np.array(edges)}
    size["periodic"] = np.array([count is None for count in lattice.filled], np.int8)
    humidity = _attrs("g m-3", "absolute humidity of the cube's voxels")
    humidity["standard_name"] = "mass_concentration_of_water_vapor_in_air"
    temperature = _attrs("K", "air temperature of the cube's voxels") | ON_SCALE
    temperature["standard_name"] = "air_temperature"
    grams = [cube.absolute_humidity_g_m3 for cube in cubes]
    found = {
        name: _coordinate(name, corner + (np.arange(count) + 0.5) * edge, "m", f"{name[0]} in cube")
        for name, count, corner, edge in zip(
            VOXELS, grams[0].shape, lattice.corner_m[::-1], lattice.voxel_m[::-1], strict=True
        )
    }
    found["absolute_humidity"] = _shared(grams, humidity | size, VOXELS)
    warmth = [cube.air_temperature_k for cube in cubes if cube.air_temperature_k is not None]
    if len(warmth) == len(cubes):
        found["air_temperature"] = _shared(warmth, temperature | size, VOXELS)
    return found
