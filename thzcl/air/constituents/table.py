"""Absorption from a file: whatever model, or measurement, its author has put there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.constituent import (
    Constituent,
    File,
    Grid,
    OpticalProperties,
    Parameters,
    Span,
    file_parameter,
    hookimpl,
)

Array = NDArray[np.float64]
SAME_PRESSURE = 1e-3  # relative: pressures for which one table stands

GRID = Grid(
    "absorption",
    "1/m",
    axes=(("frequency_ghz", "GHz"), ("temperature_k", "K"), ("vapour_pressure_hpa", "hPa")),
    attributes=("pressure_hpa",),
    least=0.0,
)


class Tabulated(Constituent):
    """Moist air by a table of one's own, at one total pressure.

    The NetCDF-4 file that `model_file` names holds a variable
    absorption(frequency_ghz, temperature_k, vapour_pressure_hpa) in 1/m (or 1/km, dB/km), its three
    ascending coordinates, and the attribute pressure_hpa. Between the nodes it is a monotone cubic
    in frequency (Fritsch and Butland 1984), straight in temperature and a quadratic spline in
    vapour pressure. What would come out negative is 0.

    Validity: as far as the nodes reach, and at pressures to 0.1 % of the table's. Air whose
    humidity fluctuates may become dry: then the nodes of vapour pressure must begin at 0. An axis
    of one node holds that value alone.

    Validation: filled from MPM93, with nodes at a scene's frequencies and temperature, it gives
    MPM93's image to 1e-6 of the contrast (tests/test_constituents.py). Away from its nodes it is as
    good as they are dense: a line needs some ten nodes to its width.

    References: F. N. Fritsch, J. Butland (1984), "A method for constructing local monotone
    piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5, 300, doi:10.1137/0905021.
    """

    name = "table"
    contract = 1
    gas = True

    class Params(Parameters):
        """The file."""

        file: File = file_parameter(
            GRID,
            help="NetCDF file of absorption(frequency_ghz, temperature_k, vapour_pressure_hpa)",
        )

    def __init__(self, params: Any) -> None:
        super().__init__(params)
        from scipy.interpolate import PchipInterpolator

        arrays, axes = params.file.arrays, [name for name, _ in GRID.axes]
        self._ghz, self._kelvin, self._vapour = (arrays[name] for name in axes)
        ghz, values = _widened(self._ghz, arrays[GRID.variable], 0)
        self._by_frequency = PchipInterpolator(ghz, values, axis=0)

    @property
    def valid(self) -> tuple[Span, ...]:  # type: ignore[override]
        """Returns the ranges of the nodes, and that of the pressure."""
        pressure = self.params.file.attributes["pressure_hpa"]
        where = f"the nodes of {self.params.file.name}"
        return (
            Span("frequency_ghz", *_ends(self._ghz), where),
            Span("temperature_k", *_ends(self._kelvin), where),
            Span("vapour_hpa", *_ends(self._vapour), where),
            Span(
                "pressure_hpa",
                pressure * (1 - SAME_PRESSURE),
                pressure * (1 + SAME_PRESSURE),
                f"{self.params.file.name} is for {pressure:g} hPa",
            ),
        )

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns the absorption between the nodes."""
        from scipy.interpolate import make_interp_spline

        del pressure_hpa
        ghz, of_frequency = np.unique(frequency_hz / 1e9, return_inverse=True)
        rows = self._by_frequency(np.clip(ghz, *_ends(self._ghz)))  # (frequency, kelvin, vapour)
        vapour, rows = _widened(self._vapour, rows, 2)
        spline = make_interp_spline(vapour, rows, k=min(2, len(vapour) - 1), axis=2)
        at = spline(np.clip(vapour_hpa, *_ends(self._vapour)).ravel())  # (frequency, kelvin, state)
        kelvin, at = _widened(self._kelvin, at, 1)
        warm = np.clip(np.interp(temperature_k, kelvin, np.arange(len(kelvin))), 0, len(kelvin) - 1)
        below = np.minimum(warm.astype(np.int64), len(kelvin) - 2)
        f = of_frequency.reshape(frequency_hz.shape)
        state = np.arange(vapour_hpa.size).reshape(vapour_hpa.shape)
        colder, warmer = at[f, below, state], at[f, below + 1, state]
        return OpticalProperties(np.maximum(colder + (warm - below) * (warmer - colder), 0.0))

    def lines(
        self, temperature_k: float, pressure_hpa: float, vapour_hpa: float
    ) -> tuple[Array, float]:
        """Returns the nodes where absorption peaks, and the least step between nodes, in Hz."""
        hz, air = self._ghz * 1e9, (temperature_k, pressure_hpa, vapour_hpa)
        per_m = np.asarray(self.optics(hz, *map(np.asarray, air)).absorption)
        peaks = np.flatnonzero((per_m[1:-1] > per_m[:-2]) & (per_m[1:-1] >= per_m[2:])) + 1
        return hz[peaks], float(np.diff(hz).min()) if len(hz) > 1 else np.inf


def _ends(axis: Array) -> tuple[float, float]:
    return float(axis[0]), float(axis[-1])


def _widened(axis: Array, values: Array, number: int) -> tuple[Array, Array]:
    """Returns an axis and its values, with a second node of the same value if there is but one."""
    if len(axis) > 1:
        return axis, values
    return np.append(axis, axis + 1), np.repeat(values, 2, axis=number)


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [Tabulated]
