"""Textures of billboards: greyscale pictures and arrays, checked before they are trusted."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import FileError
from thzcl.files import PICTURE, digest, open_regular

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

Array = NDArray[np.float64]

MOST_PIXELS = 16_000_000
FORMATS = ("PNG", "TIFF")
DEEPEST = 65535  # white in a picture of 16 bits
# The lowest and the highest value of a texture's quantity, which are the limits of the keys
# temperature_k and reflectivity, and its unit.
QUANTITIES = {"temperature": (0.0, 1e19, " K"), "reflectivity": (0.0, 1.0, "")}


@dataclass(frozen=True)
class Texture:
    """Values from 0 to 1, row 0 at the top; the quantity is `low` at 0 and `high` at 1."""

    values: Array  # (height, width)
    low: float
    high: float


def read(path: Path, ends: tuple[float, float] | None, quantity: str) -> Texture:
    """Returns the texture in a file, whose quantity is "temperature", in K, or "reflectivity".

    A PNG or TIFF of 8 or 16 bit is scaled so that black and white have the values `ends`; a .npy
    file holds values of the quantity, and `ends` must be None. Raises FileError for a file that is
    missing, too large, broken, animated or of another kind, and for values beyond the quantity's
    limits.
    """
    return _read(path, digest(path, PICTURE), ends, quantity)


@lru_cache(maxsize=8)  # the variants of a scenario share their pictures
def _read(
    path: Path,
    content: str,  # noqa: ARG001 (a file that was changed is read again)
    ends: tuple[float, float] | None,
    quantity: str,
) -> Texture:
    """Returns what `read` describes, for a file whose bytes have the SHA-256 `content`."""
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
    """Raises FileError if a texture's values lie beyond the limits of its quantity."""
    least, most, unit = QUANTITIES[quantity]
    for value in (texture.low, texture.high):
        if not least <= value <= most:
            raise FileError(
                f"{path}: holds a {quantity} of {value:g}{unit}; "
                f"it must lie between {least:g} and {most:g}{unit}"
            )


def read_mask(path: Path, shape: tuple[int, int]) -> Array:
    """Returns a mask (height, width): 1 where the billboard is, 0 where rays pass it.

    Raises FileError for a file that cannot be used, or that has another shape than `shape`.
    """
    values = _array(path) if path.suffix == ".npy" else _picture(path)
    if values.shape != shape:
        own, image = (f"{columns} x {rows}" for rows, columns in (values.shape, shape))
        raise FileError(f"{path}: the mask has {own} pixels, the image {image}; make them equal")
    return np.asarray(values >= 0.5, dtype=np.float64)


def _picture(path: Path) -> Array:
    """Returns a picture in grey as values from 0 to 1, (height, width). Raises FileError."""
    from PIL import Image, UnidentifiedImageError

    # Pillow warns of odd metadata, and of large pictures, whose size is checked below.
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


def _check_size(path: Path, image: ImageFile) -> None:
    """Raises FileError for a picture of too many pixels, and for a file of several pictures."""
    if image.width * image.height > MOST_PIXELS:
        raise FileError(
            f"{path}: {image.width} x {image.height} pixels; "
            f"textures may have {MOST_PIXELS / 1e6:.0f} million"
        )
    pictures = getattr(image, "n_frames", 1)
    if pictures != 1:
        raise FileError(f"{path}: holds {pictures} pictures; give a file with one")


def _grey(path: Path, image: ImageFile) -> Array:
    """Returns the pixels of a picture in grey, from 0 to 1. Raises FileError for other pixels."""
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
    """Returns the plane of finite numbers in a .npy file. Raises FileError for any other file."""
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
