"""The result of a run, with methods that write, draw, convert and sum it up."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thzcl.files import write_whole
from thzcl.results import netcdf, summary
from thzcl.results.contents import Contents

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class Result(Contents):
    """The data of a run, with methods that write, draw, convert and sum them up."""

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Returns the result that a file holds, as exact as it holds it: in float32 mostly.

        What files do not hold is NaN, or None: what comes back to an active sensor before it is
        turned into an image, the contrast of radiance by models to compare with, cosines, and the
        weights of bands. Raises FileError.

        >>> import thzcl
        >>> path = thzcl.run("quick", settings={"camera.pixels": [4, 3]}).save("quick.nc")
        >>> thzcl.Result.load(path).variants[0].image.values.shape
        (3, 4)
        """
        from thzcl.results import load

        return cls(**load.fields(Path(path)))

    def save(self, path: str | Path) -> Path:
        """Writes the NetCDF-4 file, whole or not at all, and returns its path.

        Raises OSError if the file cannot be written.
        """
        path = Path(path)
        write_whole(path, lambda part: netcdf.write(self, part))
        return path

    def figure(self, path: str | Path, width_mm: int | None = None) -> Path:
        """Writes a picture of the variants side by side, whole or not at all; returns its path.

        The path ends in its format: .png, .pdf or .svg. `width_mm` is 88 or 180, one or two columns
        of a journal; by default what the scene says, or else the panels are as wide as suits a
        screen. Raises FileError for another ending, UsageError for another width, and OSError if
        the file cannot be written.
        """
        from thzcl.results.figure import checked_width, draw, picture_format

        path = Path(path)
        form = picture_format(path)
        width = checked_width(self.width_mm if width_mm is None else width_mm)
        write_whole(path, lambda part: draw(self, part, form, width))
        return path

    def plot(self) -> Figure:
        """Returns a picture of the variants side by side as a matplotlib figure."""
        from thzcl.results.figure import picture

        return picture(self, self.width_mm)  # type: ignore[no-any-return]

    @cached_property
    def _png(self) -> bytes:
        from io import BytesIO

        from thzcl.results.figure import draw

        file = BytesIO()
        draw(self, file, "png", self.width_mm)
        return file.getvalue()

    def _repr_png_(self) -> bytes | None:
        """Returns the picture for notebooks, which is drawn once; None if the sensor failed."""
        return self._png if all(variant.image for variant in self.variants) else None

    def to_xarray(self) -> xarray.Dataset:
        """Returns the contents of the result file as an xarray dataset.

        Raises ImportError if xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise ImportError("to_xarray needs xarray; install it: pip install xarray") from None
        data, coordinates = (
            {name: (v.dims, v.values, v.attrs) for name, v in variables.items()}
            for variables in (netcdf.variables(self), netcdf.coordinates(self))
        )
        return xarray.Dataset(data, coordinates, netcdf.attributes(self))

    def summary(self) -> dict[str, Any]:
        """Returns what `thzcl run --format json` prints, the names of files not included."""
        return summary.summary(self)

    def _repr_html_(self) -> str:
        """Returns the picture and a short table for notebooks."""
        return summary.html(self, self._repr_png_())

    def __repr__(self) -> str:
        """Returns the scene's name, and how many images of what size there are."""
        height, width = self.variants[0].sight.target.shape
        images = len(self.variants)
        count = f"{images} image{'' if images == 1 else 's'}"
        return f"<thzcl.Result of {self.scenario}: {count} of {width} x {height} pixels>"
