"""The result of a run: written as NetCDF, drawn, handed to xarray, summed up."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from thzcl.files import write_whole
from thzcl.results import netcdf, summary
from thzcl.results.contents import Contents

if TYPE_CHECKING:
    import xarray


class Result(Contents):
    """All that a run found out, with what can be done with it."""

    def save(self, path: str | Path) -> Path:
        """Writes the NetCDF-4 file, whole or not at all. Raises OSError."""
        path = Path(path)
        write_whole(path, lambda part: netcdf.write(self, part))
        return path

    def figure(self, path: str | Path) -> Path:
        """Writes a picture of the variants side by side, whole or not at all.

        The path's ending says in which format: .png, .pdf or .svg. Raises FileError for another
        ending, and OSError.
        """
        from thzcl.results.figure import draw, picture_format

        path = Path(path)
        form = picture_format(path)
        write_whole(path, lambda part: draw(self, part, form))
        return path

    def to_xarray(self) -> xarray.Dataset:
        """Returns the result as xarray dataset, as it stands in the file. Needs xarray."""
        import xarray

        data, coordinates = (
            {name: (v.dims, v.values, v.attrs) for name, v in variables.items()}
            for variables in (netcdf.variables(self), netcdf.coordinates(self))
        )
        return xarray.Dataset(data, coordinates, netcdf.attributes(self))

    def summary(self) -> dict[str, Any]:
        """Returns what `thzcl run --format json` prints, less the files."""
        return summary.summary(self)

    def _repr_html_(self) -> str:
        """Returns a short table for notebooks."""
        return summary.html(self)
