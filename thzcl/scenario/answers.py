"""What sensors answer, held to their contract before anybody relies on it."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.plugins.guard import Breach
from thzcl.sensor import Decibels, Image, Layer, Needs, Optics, PathReturn

Array = NDArray[np.float64]

# A netCDF name as its users guide has it: no "/", no control character, no blank at the end.
_NAME = re.compile(r"[A-Za-z0-9_\u0080-\U0010ffff][^/\x00-\x1f\x7f]{0,254}(?<! )")


def needs(asked: Any, pixels: tuple[int, int]) -> Needs:
    """Returns what a sensor asked for with arrays of float64 that nobody can change.

    `pixels` are the image's width and height. Raises Breach.
    """
    if not isinstance(asked, Needs):
        raise Breach(f"needs() returned {type(asked).__name__} instead of Needs")
    frequency_hz = _frequencies(asked.frequency_hz)
    finer = asked.finer
    if finer is not None:
        if not isinstance(finer, tuple | list) or len(finer) != 2:
            raise Breach("needs() gave a finer sum that is not frequencies and weights")
        nodes = _frequencies(finer[0])
        finer = nodes, _weights(finer[1], len(nodes))
    place = asked.transmitter_m
    if place is not None:
        x, y, z = _numbers(place, "a transmitter", (3,)).tolist()
        place = x, y, z
    if asked.gain not in ("none", "lambert"):
        raise Breach(f"needs() asked for the gain {asked.gain!r}; there are none and lambert")
    if asked.illumination not in ("flood", "beam"):
        raise Breach(f"needs() asked for {asked.illumination!r} light; there are flood and beam")
    if asked.optics is not None and not isinstance(asked.optics, Optics):
        raise Breach("needs() gave optics that are not thzcl.sensor.Optics")
    return replace(
        asked,
        frequency_hz=frequency_hz,
        weights=None if asked.weights is None else _weights(asked.weights, len(frequency_hz)),
        reflection=bool(asked.reflection),
        transmitter_m=place,
        cutoff_depth=_depth(asked.cutoff_depth),
        slant=bool(asked.slant),
        times_s=_times(asked.times_s, pixels),
        noise=bool(asked.noise),
        finer=finer,
        errors=_errors(asked.errors),
        integration_time_s=_time(asked.integration_time_s),
        passband=_passband(asked.passband, len(frequency_hz)),
        bounds_hz=_bounds(asked),
        notes=tuple(_text(note, "a note of needs()") for note in asked.notes),
        path_return=_path_return(asked),
    )


def _numbers(given: Any, what: str, shape: tuple[int, ...] | None = None) -> Array:
    """Returns finite numbers as an array of float64, a copy that is read-only."""
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise Breach(f"needs() gave {what} that is not made of numbers") from None
    if not np.isfinite(values).all():
        raise Breach(f"needs() gave {what} with values that are not finite")
    if shape is not None and values.shape != shape:
        raise Breach(f"needs() gave {what} of shape {values.shape} instead of {shape}")
    values.flags.writeable = False
    return values


def _frequencies(given: Any) -> Array:
    frequency_hz = _numbers(given, "a list of frequencies")
    rising = frequency_hz.ndim == 1 and frequency_hz.size and (np.diff(frequency_hz) > 0).all()
    if not rising or frequency_hz[0] <= 0:
        raise Breach("needs() asked for frequencies that are not a list of ascending numbers in Hz")
    return frequency_hz


def _weights(given: Any, count: int) -> Array:
    """Returns weights (band, frequency) whose rows can be normalised to 1."""
    rows = np.atleast_2d(_numbers(given, "a table of weights"))
    if rows.ndim != 2 or rows.shape[1] != count:
        raise Breach("needs() gave weights of another length than its frequencies")
    with np.errstate(all="ignore"):
        normalised = rows / rows.sum(axis=1, keepdims=True)
    if not len(rows) or not (rows.sum(axis=1) > 0).all() or not np.isfinite(normalised).all():
        raise Breach("needs() gave weights whose sum over a band is not above 0")
    return rows


def _depth(given: Any) -> float | None:
    if given is None:
        return None
    depth = float(given)
    if not depth > 0:
        raise Breach(f"needs() gave a cut-off at an optical depth of {depth:g}, not above 0")
    return depth


def _time(given: Any) -> float | None:
    if given is None:
        return None
    time_s = float(given)
    if not (time_s > 0 and np.isfinite(time_s)):
        raise Breach(f"needs() gave an integration time of {time_s:g} s, not above 0")
    return time_s


def _passband(given: Any, count: int) -> tuple[Array, Array] | None:
    """Returns widths and response, each (frequency,)."""
    if given is None:
        return None
    width_hz, response = given
    return _numbers(width_hz, "widths of frequencies", (count,)), _numbers(
        response, "a response", (count,)
    )


def _bounds(asked: Needs) -> Array | None:
    """Returns the lowest and the highest frequency of each band, (band, 2)."""
    if asked.bounds_hz is None:
        return None
    if asked.weights is None:
        raise Breach("needs() gave bounds of bands without weights")
    bounds = _numbers(asked.bounds_hz, "bounds of bands", (len(np.atleast_2d(asked.weights)), 2))
    if not (bounds[:, 0] < bounds[:, 1]).all() or bounds.min() < 0:
        raise Breach("needs() gave bounds of bands that do not ascend from 0 Hz or more")
    return bounds


def _path_return(asked: Needs) -> PathReturn | None:
    """Returns the beam by which the air sends light back."""
    beam = asked.path_return
    if beam is None:
        return None
    if not isinstance(beam, PathReturn):
        raise Breach("needs() gave a path return that is not a thzcl.sensor.PathReturn")
    lit = asked.reflection and asked.illumination == "beam" and asked.transmitter_m is None
    if not lit:
        raise Breach(
            "needs() asked for a path return without a beam that lights and receives at the camera"
        )
    lengths = {"an aperture": beam.aperture_m, "a focus": beam.focus_m}
    for what, given in lengths.items():
        if given is not None and not (float(given) > 0 and np.isfinite(float(given))):
            raise Breach(f"needs() gave {what} of {float(given):g} m, not above 0")
    gate_m = beam.gate_m
    if gate_m is not None:
        near, far = _numbers(gate_m, "a gate", (2,)).tolist()
        if not near < 0 <= far:
            raise Breach(f"needs() gave a gate from {near:g} to {far:g} m, which leaves out 0")
        gate_m = near, far
    focus_m = None if beam.focus_m is None else float(beam.focus_m)
    return PathReturn(float(beam.aperture_m), focus_m, gate_m)


def _times(given: Any, pixels: tuple[int, int]) -> Array | None:
    """Returns times (sample, y, x); an axis that all have in common may be of length 1."""
    if given is None:
        return None
    times_s = _numbers(given, "a table of times")
    width, height = pixels
    fits = times_s.ndim == 3 and times_s.shape[0] > 0
    if not fits or times_s.shape[1] not in (1, height) or times_s.shape[2] not in (1, width):
        due = f"(samples, {height}, {width})"
        raise Breach(f"needs() gave times of shape {times_s.shape} instead of {due}")
    return times_s


def _errors(given: Any) -> dict[str, tuple[float, str]]:
    """Returns known errors: part -> size and of what."""
    found = {}
    for part, (size, unit) in dict(given).items():
        number = float(size)
        if not (number >= 0 and np.isfinite(number)):
            raise Breach(f"needs() gave an error {part!r} that is not a finite size")
        found[_text(part, "needs() gave an error's name")] = number, _text(unit, f"{part!r}'s unit")
    return found


def image(
    made: Any, shape: tuple[int, ...], stored: np.dtype[Any], taken: Collection[str]
) -> Image:
    """Returns what a sensor recorded, (y, x), as arrays that are the caller's own.

    Real numbers are float64, so that differences and means are taken before the file rounds them to
    the type `stored`, in which they are finite too. Truth values become 0 and 1, whole numbers
    stay whole. Raises Breach.
    """
    if not isinstance(made, Image) or not isinstance(made.layers, Mapping):
        raise Breach(f"returned {type(made).__name__} instead of an Image, and of Layers")
    layers = {}
    for name, layer in made.layers.items():
        if not isinstance(layer, Layer):
            raise Breach(f"returned {type(layer).__name__} instead of a Layer as {name!r}")
        layers[_layer_name(name, taken)] = replace(
            layer,
            values=_plane(layer.values, f"layer {name!r}", shape, stored),
            unit=_text(layer.unit, f"the unit of layer {name!r}"),
            quantity=_text(layer.quantity, f"the quantity of layer {name!r}"),
            flags=_flags(layer, name),
        )
    return replace(
        made,
        decibels=_of_layer(made.decibels, layers),
        caption=_text(made.caption, "the image's caption"),
        mean_over_frequencies=bool(made.mean_over_frequencies),
        values=_plane(made.values, "image", shape, stored),
        unit=_text(made.unit, "the image's unit"),
        quantity=_text(made.quantity, "the image's quantity"),
        layers=layers,
        facts={
            _text(name, "a fact's name"): _fact(name, fact) for name, fact in made.facts.items()
        },
    )


def _flags(layer: Layer, name: str) -> tuple[str, ...]:
    """Returns the words of a layer of flags. Raises Breach if its values are none."""
    words = tuple(_text(word, f"a flag of layer {name!r}") for word in layer.flags)
    if not words:
        return ()
    if any(not word or len(word.split()) != 1 for word in words):
        raise Breach(f"returned layer {name!r} with flags that are not one word each")
    if not np.isin(layer.values, np.arange(len(words))).all():
        raise Breach(f"returned layer {name!r} with values that are none of its flags")
    return words


def _of_layer(given: Any, layers: Mapping[str, Layer]) -> Decibels | None:
    """Returns of which layer an image in decibels is made. Raises Breach if there is none."""
    if given is None:
        return None
    if not isinstance(given, Decibels) or given.layer not in layers:
        raise Breach("returned an image in decibels of a layer that it does not have")
    reference = float(given.reference)
    if not (reference > 0 and np.isfinite(reference)):
        raise Breach(f"returned an image in decibels over {reference:g}, which is not above 0")
    return Decibels(given.layer, reference)


def _plane(given: Any, what: str, shape: tuple[int, ...], stored: np.dtype[Any]) -> NDArray[Any]:
    if np.ma.is_masked(given):
        raise Breach(f"returned {what} with masked values; the file has none")
    if np.shape(given) != shape:
        raise Breach(f"returned {what} of shape {np.shape(given)}; the image has {shape}")
    values = np.asarray(given)
    if values.dtype.kind not in "fiub":
        raise Breach(f"returned {what} whose values are not numbers")
    if values.dtype.kind != "f":
        kind = np.dtype(np.int8) if values.dtype.kind == "b" else values.dtype.newbyteorder("=")
        return values.astype(kind)
    with np.errstate(over="ignore"):
        finite = np.isfinite(values.astype(stored)).all()
    if not finite:
        as_stored = f" as {stored}" if np.isfinite(values).all() else ""
        raise Breach(f"returned {what} with values that are not finite{as_stored}")
    return values.astype(np.float64)


def _layer_name(name: Any, taken: Collection[str]) -> str:
    text = _text(name, "a layer's name")
    if not _NAME.fullmatch(text) or len(text.encode()) > 255:
        raise Breach(f"returned a layer named {text!r}, which cannot name a netCDF variable")
    if text in taken:
        raise Breach(f"returned a layer named {text!r}, as the result file's own variable is")
    return text


def _text(given: Any, what: str) -> str:
    """Returns text that a file can hold."""
    if not isinstance(given, str):
        raise Breach(f"{what} is {type(given).__name__} instead of text")
    if "\x00" in given or given.encode(errors="ignore").decode() != given:
        raise Breach(f"{what} is {given!r}, which a file cannot hold")
    return str(given)


def _fact(name: Any, given: Any) -> tuple[float, str]:
    """Returns a fact's value and unit."""
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise Breach(f"returned a fact {name!r} that is not a value and a unit")
    number, unit = np.asarray(given[0]), given[1]
    if number.ndim or number.dtype.kind not in "fiub" or not np.isfinite(number):
        raise Breach(f"returned a fact {name!r} whose value is not a finite number")
    return float(number), _text(unit, f"the unit of fact {name!r}")
