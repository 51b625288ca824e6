"""A measured spectrum in place of a power law: from the density along a line to that in space.

In isotropic turbulence the three-dimensional density Phi follows from the two-sided density F along
a line: Phi(xi) = -(1 / (2 pi xi)) dF/dxi, in cycles per metre as in radians per metre (Tatarskii
1971, "The effects of the turbulent atmosphere on wave propagation"). F must fall everywhere, but a
measured density scatters and rises here and there. Where it rises, neighbouring values are pooled
into their means, which gives the closest falling sequence. A monotone cubic in the logarithms of
frequency and density runs through the pooled points.
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

# A scalar whose structure function is C^2 r^(2/3) has, along a line, the one-sided density
# 2 * 0.1244 (2 pi)^(-2/3) C^2 xi^(-5/3), in cycles per metre.
KOLMOGOROV_ALONG = math.gamma(5 / 3) * math.sin(math.pi / 3) / math.pi * (2 * math.pi) ** (-2 / 3)
FEWEST = 3  # rows of a table
ENDS = 4  # points at either end of the table that determine the slope beyond it
FLATTEST, STEEPEST = -0.05, -6.0  # limits of the slope beyond the table's ends, in log-log


@dataclass(frozen=True)
class SpectrumTable:
    """The one-sided density of absolute humidity along a line, (g/m3)^2 m.

    `density` belongs to the spatial frequencies of `frequency`, which ascend, in cycles/m.
    """

    frequency: tuple[float, ...]
    density: tuple[float, ...]

    @property
    def structure_constant(self) -> float:
        """Returns C_q^2 of the -5/3 law through the table's upper decade, (g/m3)^2 m^(-2/3).

        It is the mean, in logarithms, over the points of that decade.
        """
        x, y = self._points
        upper = x >= x[-1] - math.log(10)
        return float(np.exp(np.mean(y[upper] + 5 / 3 * x[upper])) / KOLMOGOROV_ALONG)

    @cached_property
    def _points(self) -> tuple[Array, Array]:
        """Returns the logarithms of frequency and of the pooled density, which falls throughout."""
        return pooled(np.log(self.frequency), np.log(self.density))

    @cached_property
    def _curve(self) -> tuple[Any, tuple[float, float]]:
        """Returns the monotone cubic through the points, and its slopes before and beyond them."""
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

        Both have shape (n,), as has `frequency` in cycles/m. The slope is never positive.
        """
        (curve, ends), (x, _) = self._curve, self._points
        asked = np.log(frequency)
        inside = np.clip(asked, x[0], x[-1])
        slope = np.where(
            asked < x[0], ends[0], np.where(asked > x[-1], ends[1], curve.derivative()(inside))
        )
        return np.exp(curve(inside) + slope * (asked - inside)), np.minimum(slope, 0.0)

    def density_in_space(self, frequency: Array) -> Array:
        """Returns the density in space, (g/m3)^2 m^3, which is never negative.

        It has shape (n,), as has `frequency` in cycles/m.
        """
        one_sided, slope = self.along(frequency)
        return np.asarray(-slope * one_sided / 2 / (2 * np.pi * frequency**2))


def pooled(x: Array, y: Array) -> tuple[Array, Array]:
    """Returns the falling sequence y(x) that is closest to the given one.

    Adjacent points between which y rises with x are replaced by their mean, until y falls
    throughout (pool adjacent violators: Ayer et al. 1955, Ann. Math. Statist. 26, 641).
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
    """Returns the spectrum in a CSV of frequency in cycles/m and one-sided density in (g/m3)^2 m.

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
