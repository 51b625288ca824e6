"""A measured spectrum in the place of a power law: from density along a line to one in space.

Of isotropic turbulence the three-dimensional density Phi follows from the two-sided density F along
a line: Phi(xi) = -(1 / (2 pi xi)) dF/dxi, in cycles per metre as in radians per metre (Tatarskii
1971, "The effects of the turbulent atmosphere on wave propagation"). A measured density scatters
and rises here and there, which F must not: where values rise they are pooled into means (the
closest falling sequence), and a monotone cubic in log-log runs through what remains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.errors import FileError
from thzcl.files import read_table

Array = NDArray[np.float64]

# One-sided in cycles per metre, of a scalar whose structure function is C^2 r^(2/3): twice 0.1244
# (2 pi)^(-2/3) C^2 xi^(-5/3).
KOLMOGOROV_ALONG = math.gamma(5 / 3) * math.sin(math.pi / 3) / math.pi * (2 * math.pi) ** (-2 / 3)
FEWEST = 3  # rows
ENDS = 4  # points that make the slope beyond the table's end
FLATTEST, STEEPEST = -0.05, -6.0  # slope there


@dataclass(frozen=True)
class SpectrumTable:
    """One-sided density of absolute humidity along a line in (g/m3)^2 m, by frequency in cycles/m.

    Frequencies ascend.
    """

    frequency: tuple[float, ...]
    density: tuple[float, ...]

    @property
    def structure_constant(self) -> float:
        """Returns C_q^2 of the power law -5/3 through the upper decade, (g/m3)^2 m^(-2/3).

        It is the mean over the points of that decade, in logarithms.
        """
        x, y = self._points
        upper = x >= x[-1] - math.log(10)
        return float(np.exp(np.mean(y[upper] + 5 / 3 * x[upper])) / KOLMOGOROV_ALONG)

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        """Returns the logarithms of frequency and of density, which falls throughout."""
        return pooled(np.log(self.frequency), np.log(self.density))

    @cached_property
    def _curve(self) -> tuple[Any, tuple[float, float]]:
        """Returns the monotone cubic through the points, and the slopes before and beyond it."""
        from scipy.interpolate import PchipInterpolator

        x, y = self._points
        slopes = (
            float(np.polyfit(x[part], y[part], 1)[0])
            for part in (slice(None, ENDS), slice(-ENDS, None))
        )
        first, last = (min(max(slope, STEEPEST), FLATTEST) for slope in slopes)
        return PchipInterpolator(x, y), (first, last)

    def along(self, frequency: Array) -> tuple[Array, Array]:
        """Returns the smooth one-sided density along a line, (g/m3)^2 m, and its slope in log-log.

        Both are (n,), at frequencies (n,) in cycles/m; the slope is never positive.
        """
        (curve, ends), (x, _) = self._curve, self._points
        asked = np.log(frequency)
        inside = np.clip(asked, x[0], x[-1])
        slope = np.where(
            asked < x[0], ends[0], np.where(asked > x[-1], ends[1], curve.derivative()(inside))
        )
        return np.exp(curve(inside) + slope * (asked - inside)), np.minimum(slope, 0.0)

    def density_in_space(self, frequency: Array) -> Array:
        """Returns the density in space (n,), (g/m3)^2 m^3, at spatial frequencies in cycles/m.

        It is never negative.
        """
        one_sided, slope = self.along(frequency)
        return np.asarray(-slope * one_sided / 2 / (2 * np.pi * frequency**2))


def pooled(x: Array, y: Array) -> tuple[Array, Array]:
    """Returns the closest falling sequence y(x), by pooling adjacent violators.

    Where y rises with x, both are replaced by their means.
    """
    blocks: list[tuple[float, float, int]] = []
    for here, value in zip(x.tolist(), y.tolist(), strict=True):
        block = (here, value, 1)
        while blocks and blocks[-1][1] <= block[1]:
            a, b = blocks.pop(), block
            count = a[2] + b[2]
            block = (
                (a[0] * a[2] + b[0] * b[2]) / count,
                (a[1] * a[2] + b[1] * b[2]) / count,
                count,
            )
        blocks.append(block)
    return np.array([block[0] for block in blocks]), np.array([block[1] for block in blocks])


def read(path: Path) -> SpectrumTable:
    """Reads a CSV of spatial frequency in cycles/m and one-sided density in (g/m3)^2 m.

    Raises FileError for a file that holds no spectrum.
    """
    rows = read_table(path)
    if rows.shape[1] != 2 or len(rows) < FEWEST:
        raise FileError(
            f"{path}: {len(rows)} rows of {rows.shape[1]} columns; give {FEWEST} rows at least of "
            "spatial frequency and density"
        )
    frequency, density = rows.T
    if not ((rows > 0).all() and (np.diff(frequency) > 0).all()):
        raise FileError(
            f"{path}: spatial frequencies must be above 0 and ascend, densities be above 0; "
            "mend them"
        )
    if len(pooled(np.log(frequency), np.log(density))[0]) < 2:
        raise FileError(
            f"{path}: the density does not fall with spatial frequency; no isotropic field has "
            "such a spectrum, give one that falls"
        )
    return SpectrumTable(tuple(frequency.tolist()), tuple(density.tolist()))
