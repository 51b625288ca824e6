"""Textures of billboards: greyscale pictures and arrays, checked before they are trusted."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import FileError
from thzcl.files import PICTURE, open_regular

Array = NDArray[np.float64]

MOST_PIXELS = 16_000_000
FORMATS = ("PNG", "TIFF")
DEEPEST = 65535  # white of a picture of 16 bits
# Lowest and highest value, and unit, of what a texture can show: the limits of the keys
# temperature_k and reflectivity.
QUANTITIES = {"temperature": (0.0, 1e19, " K"), "reflectivity": (0.0, 1.0, "")}


@dataclass(frozen=True)
class Texture:
    """Values from 0 to 1 (row 0 at the top), and the quantity's value at both ends."""

    values: Array  # (height, width)
    low: float
    high: float


def read(path: Path, ends: tuple[float, float] | None, quantity: str) -> Texture:
    """Returns the texture that a file holds, of the "temperature" in K or the "reflectivity".

    A PNG or TIFF of 8 or 16 bit is mapped to `ends`, the values of black and of white; a .npy has
    values of its own. Raises FileError for a file that is missing, too large, broken, animated or
    of another kind, and for values beyond the quantity's limits.
    """
    return _read(path, _changed(path), ends, quantity)


@lru_cache(maxsize=8)  # the variants of a scenario share their pictures
def _read(
    path: Path,
    changed: int,  # noqa: ARG001 (it tells a file from what it was before)
    ends: tuple[float, float] | None,
    quantity: str,
) -> Texture:
    if path.suffix == ".npy":
        if ends is not None:
            raise FileError(f"{path}: an array has its own values; remove range")
        values = _array(path)
        low, high = float(values.min()), float(values.max())
        texture = Texture((values - low) / ((high - low) or 1.0), low, high)
    elif ends is None:
        raise FileError(f"{path}: a picture needs range = [value of black, value of white]")
    else:
        texture = Texture(_picture(path), *ends)
    _check_limits(path, texture, quantity)
    return texture


def _check_limits(path: Path, texture: Texture, quantity: str) -> None:
    least, most, unit = QUANTITIES[quantity]
    for value in (texture.low, texture.high):
        if not least <= value <= most:
            raise FileError(
                f"{path}: holds a {quantity} of {value:g}{unit}; "
                f"it must lie between {least:g} and {most:g}{unit}"
            )


def read_mask(path: Path, shape: tuple[int, int]) -> Array:
    """Returns a mask: 1 where the billboard is, 0 where one sees past it. Raises FileError."""
    values = _array(path) if path.suffix == ".npy" else _picture(path)
    if values.shape != shape:
        own, image = (f"{columns} x {rows}" for rows, columns in (values.shape, shape))
        raise FileError(f"{path}: the mask has {own} pixels, the image {image}; make them equal")
    return np.asarray(values >= 0.5, dtype=np.float64)


def _changed(path: Path) -> int:
    """Returns when a picture was last changed, in ns. Raises FileError if it cannot be opened."""
    with open_regular(path, PICTURE) as file:
        return os.fstat(file.fileno()).st_mtime_ns


def _picture(path: Path) -> Array:
    """Returns a greyscale picture as values from 0 to 1, (height, width). Raises FileError."""
    from PIL import Image, UnidentifiedImageError

    # Warnings are of odd metadata, and of sizes that are held to a stricter limit here.
    with open_regular(path, PICTURE) as file, warnings.catch_warnings(action="ignore"):
        try:
            with Image.open(file, formats=FORMATS) as image:
                _check_size(path, image)
                image.load()
                return _grey(path, image)
        except (FileError, MemoryError):
            raise
        except UnidentifiedImageError:
            raise FileError(f"{path}: not a sound PNG or TIFF; save it again") from None
        except Exception as error:  # noqa: BLE001 (a damaged file leads Pillow to any error)
            raise FileError(
                f"{path}: not a sound PNG or TIFF ({_short(error)}); save it again"
            ) from None


def _check_size(path: Path, image: Any) -> None:
    if image.width * image.height > MOST_PIXELS:
        raise FileError(
            f"{path}: {image.width} x {image.height} pixels; "
            f"textures may have {MOST_PIXELS / 1e6:.0f} million"
        )
    pictures = getattr(image, "n_frames", 1)
    if pictures != 1:
        raise FileError(f"{path}: holds {pictures} pictures; give a file with one")


def _grey(path: Path, image: Any) -> Array:
    if image.mode in ("1", "L", "LA", "P", "RGB", "RGBA"):
        return np.asarray(image.convert("L"), dtype=np.float64) / 255
    if image.mode not in ("I", "I;16", "I;16B"):
        raise FileError(f"{path}: pixels of kind {image.mode}; give 8 or 16 bit greyscale")
    values = np.asarray(image)
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > DEEPEST:
        raise FileError(
            f"{path}: pixels of {low} to {high}, of a scale that the file does not tell; "
            f"give 16 bit greyscale (0 to {DEEPEST}), or a .npy in the quantity's own unit"
        )
    return values.astype(np.float64) / DEEPEST


def _array(path: Path) -> Array:
    """Returns the plane of finite numbers that a .npy holds. Raises FileError."""
    with open_regular(path, PICTURE) as file, warnings.catch_warnings(action="ignore"):
        try:
            values: Any = np.load(file, allow_pickle=False)
        except Exception as error:  # noqa: BLE001 (a damaged head leads NumPy to any error)
            raise FileError(
                f"{path}: not a sound .npy array ({_short(error)}); save it with numpy.save"
            ) from None
    if not isinstance(values, np.ndarray):
        raise FileError(f"{path}: an archive of arrays (.npz); save one array with numpy.save")
    if values.ndim != 2 or values.dtype.kind not in "fiu" or not 0 < values.size <= MOST_PIXELS:
        raise FileError(
            f"{path}: shape {values.shape} and type {values.dtype}; "
            f"it must be a plane of numbers, at most {MOST_PIXELS / 1e6:.0f} million"
        )
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise FileError(f"{path}: holds values that are not finite; mend them")
    return array


def _short(error: Exception) -> str:
    """Returns the first line of a library's error, of at most 100 letters."""
    return (str(error).splitlines() or [type(error).__name__])[0][:100]
