"""The file and the moving picture of a sequence, written frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np

from thzcl.files import RESULT, open_netcdf
from thzcl.results import netcdf
from thzcl.results.contents import Array, Contents
from thzcl.results.netcdf import Variable
from thzcl.results.patient import Patient

STILL = ("path_length", "target", "absolute_humidity", "air_temperature", *netcdf.VOXELS)
MOST_MILLISECONDS = 65_535 * 10  # that a GIF can show a frame for
LEAST_PIXELS = 240  # on the shorter side of a shown panel
STRETCH_PERCENT = (0.1, 99.9)


class Writer:
    """A result file with the dimension `time` first, to which frames are added one by one.

    What does not change with time is that of the first frame.
    """

    def __init__(self, path: Path, times_s: Array) -> None:
        self._path, self._times = path, times_s
        self._raw: Any = None
        self._file: Any = None
        self._count = 0

    def __enter__(self) -> Self:
        import h5netcdf

        self._raw = Patient(self._path)
        self._file = h5netcdf.File(self._raw, "w")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self._file.close()
        self._raw.close()

    def add(self, frame: Contents) -> None:
        """Writes the next frame."""
        moving = {k: v for k, v in netcdf.variables(frame).items() if k not in STILL}
        if self._count == 0:
            self._begin(frame, moving)
        for name, variable in moving.items():
            self._file.variables[name][self._count] = variable.values
        self._count += 1

    def _begin(self, first: Contents, moving: dict[str, Variable]) -> None:
        every = netcdf.coordinates(first) | netcdf.variables(first)
        self._size("time", len(self._times))
        for variable in every.values():
            for name, size in zip(variable.dims, variable.values.shape, strict=True):
                self._size(name, size)
        attrs = {"units": "s", "long_name": "time from the first frame"}
        self._create("time", Variable(("time",), self._times, attrs))
        for name, variable in every.items():
            if name not in moving:
                self._create(name, variable)
        for name, (dims, values, attrs) in moving.items():
            created = self._file.create_variable(
                name,
                ("time", *dims),
                values.dtype,
                chunks=(1, *values.shape),
                **netcdf.compression(values),
            )
            created.attrs.update(attrs)

    def _size(self, name: str, size: int) -> None:
        if name not in self._file.dimensions:
            self._file.dimensions[name] = size

    def _create(self, name: str, variable: Variable) -> None:
        import h5py

        dims, values, attrs = variable
        kind = h5py.string_dtype() if values.dtype == object else values.dtype
        made = self._file.create_variable(
            name, dims, kind, data=values, **netcdf.compression(values)
        )
        made.attrs.update(attrs)

    def finish(self, result: Contents, more: dict[str, Variable]) -> None:
        """Writes what is known at the end: attributes of the whole, and further variables."""
        for name, variable in more.items():
            self._create(name, variable)
        self._file.attrs.update(netcdf.attributes(result))


class Shown(NamedTuple):
    """How frames are shown: what is black and white, and the image's quantity and unit."""

    limits: tuple[float, float]
    quantity: str
    unit: str


def moving_picture(source: Path, path: Path, shown: Shown) -> None:
    """Writes the frames of a result file as a GIF, variants side by side, with their times.

    It shows real time where that is slow enough for a GIF, whose frames last 0.02 s at least.
    """
    with open_netcdf(source, RESULT) as file:
        times = np.asarray(file["time"][...], np.float64)
        frames = _pictures(file["image"], times, shown)
        step = float(np.diff(times).mean()) if len(times) > 1 else 1.0
        lasting = min(max(round(100 * step) * 10, 20), MOST_MILLISECONDS)
        first = next(frames)
        first.save(
            path, format="GIF", save_all=True, append_images=frames, duration=lasting, loop=0
        )


def _pictures(images: Any, times: Array, shown: Shown) -> Iterator[Any]:
    """Yields each frame as a picture of 256 greys."""
    from PIL import Image, ImageDraw

    low, high = shown.limits
    for number, time_s in enumerate(times):
        grey = np.clip((np.asarray(images[number], np.float64) - low) / (high - low), 0, 1)
        panels = np.concatenate(list(np.round(255 * grey).astype(np.uint8)), axis=1)
        times_larger = max(1, -(-LEAST_PIXELS // min(images.shape[2:])))
        large = panels.repeat(times_larger, 0).repeat(times_larger, 1)
        picture = Image.new("L", (large.shape[1], large.shape[0] + 30), 255)
        picture.paste(Image.fromarray(large), (0, 0))
        unit = "" if shown.unit == "1" else f" {shown.unit}"
        lines = f"t = {time_s:.4g} s", f"black {low:.5g}{unit}, white {high:.5g}{unit}"
        text = ImageDraw.Draw(picture)
        for place, line in enumerate(lines):
            text.text((4, large.shape[0] + 2 + 13 * place), line, fill=0)
        yield picture
