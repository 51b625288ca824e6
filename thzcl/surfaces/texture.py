"""Textures of billboards: greyscale pictures and arrays, checked before they are trusted."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_FILE = 64_000_000  # bytes
MOST_PIXELS = 16_000_000
FORMATS = ("PNG", "TIFF")


class TextureError(ValueError):
    """A texture cannot be used; the text says which, why and what to do."""


@dataclass(frozen=True)
class Texture:
    """Values from 0 to 1 (row 0 at the top), and the quantity's value at both ends."""

    values: Array  # (height, width)
    low: float
    high: float


def read(path: Path, ends: tuple[float, float] | None) -> Texture:
    """A texture from an 8 or 16 bit PNG or TIFF, mapped to `ends`, or from a .npy in the quantity's own unit.

    Raises TextureError for files that are missing, too large, broken, animated, or not of that kind.
    """
    return _read(path, _changed(path), ends)


@lru_cache(maxsize=8)  # the variants of a scenario share their pictures
def _read(path: Path, changed: int, ends: tuple[float, float] | None) -> Texture:  # noqa: ARG001 (what tells it apart)
    if path.suffix == ".npy":
        if ends is not None:
            raise TextureError(f"{path}: an array has its own values; remove range")
        values = _array(path)
        low, high = float(values.min()), float(values.max())
        return Texture((values - low) / ((high - low) or 1.0), low, high)
    if ends is None:
        raise TextureError(f"{path}: a picture needs range = [value of black, value of white]")
    return Texture(_picture(path), *ends)


def read_mask(path: Path, shape: tuple[int, int]) -> Array:
    """A mask: 1 where the billboard is, 0 where one sees past it. Raises TextureError."""
    _changed(path)
    values = _array(path) if path.suffix == ".npy" else _picture(path)
    if values.shape != shape:
        sizes = f"the mask has {values.shape[1]} x {values.shape[0]} pixels, the image {shape[1]} x {shape[0]}"
        raise TextureError(f"{path}: {sizes}; make them equal")
    return np.asarray(values >= 0.5, dtype=np.float64)


def _changed(path: Path) -> int:
    """When a file was last changed, if it is there and not too large."""
    try:
        found = path.stat()
    except OSError as error:
        raise TextureError(
            f"{path}: cannot be read: {error.strerror}; paths start from the scenario's folder"
        ) from None
    if found.st_size > LARGEST_FILE:
        raise TextureError(
            f"{path}: {found.st_size / 1e6:.0f} MB; textures may have {LARGEST_FILE / 1e6:.0f} MB"
        )
    return found.st_mtime_ns


def _picture(path: Path) -> Array:
    """A greyscale picture as values from 0 to 1."""
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", Image.DecompressionBombWarning
            )  # the limit below is stricter
            with Image.open(path, formats=FORMATS) as image:
                if image.width * image.height > MOST_PIXELS:
                    many = f"{image.width} x {image.height} pixels"
                    raise TextureError(
                        f"{path}: {many}; textures may have {MOST_PIXELS / 1e6:.0f} million"
                    )
                pictures = getattr(image, "n_frames", 1)
                if pictures != 1:
                    raise TextureError(f"{path}: holds {pictures} pictures; give a file with one")
                image.load()
                return _grey(path, image)
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise TextureError(f"{path}: not a sound PNG or TIFF ({error}); save it again") from None


def _grey(path: Path, image: Any) -> Array:
    if image.mode in ("1", "L", "LA", "P", "RGB", "RGBA"):
        return np.asarray(image.convert("L"), dtype=np.float64) / 255
    if image.mode in ("I", "I;16", "I;16B"):
        return np.asarray(image, dtype=np.float64) / 65535
    raise TextureError(f"{path}: pixels of kind {image.mode}; give 8 or 16 bit greyscale")


def _array(path: Path) -> Array:
    try:
        values: Any = np.load(path, allow_pickle=False, mmap_mode="r")
    except (OSError, ValueError, EOFError) as error:
        raise TextureError(
            f"{path}: not a sound .npy array ({error}); save it with numpy.save"
        ) from None
    if values.ndim != 2 or values.dtype.kind not in "fiu" or not 0 < values.size <= MOST_PIXELS:
        kind = f"shape {values.shape} and type {values.dtype}"
        raise TextureError(
            f"{path}: {kind}; it must be a plane of numbers, at most {MOST_PIXELS / 1e6:.0f} million"
        )
    array = np.asarray(values, dtype=np.float64)
    if not np.isfinite(array).all():
        raise TextureError(f"{path}: holds values that are not finite; mend them")
    return array
