"""Turbulent fluctuations on a periodic cube, before any random number: spectra, variances, ranges.

Kolmogorov's spectrum in cycles per metre is Psi(xi) = 9.69e-3 C^2 xi^(-11/3), of a scalar whose
structure function is C^2 r^(2/3); with an outer scale L0 (von Karman) xi^2 becomes xi^2 + 1/L0^2.
Tatarskii (1971), "The effects of the turbulent atmosphere on wave propagation"; the cube as in
O'Brien and Tofsted, equation (1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thzcl.scenario.atmosphere import Atmosphere, Fluctuations
from thzcl.turbulence.spectrum_table import SpectrumTable

Array = NDArray[np.float64]

# Gamma(8/3) sin(pi/3) / (4 pi^2) (2 pi)^(-2/3): 0.0330054 in radians per metre, 9.6935e-3 in cycles
# per metre.
KOLMOGOROV = (
    math.gamma(8 / 3) * math.sin(math.pi / 3) / (4 * math.pi**2) * (2 * math.pi) ** (-2 / 3)
)
LOGNORMAL_FROM = 0.3  # relative sigma from which clipping a Gaussian at dry air would bias the mean
RARE = 1e-6  # probability that a cube leaves the range that a plan counts on


@dataclass(frozen=True)
class Turbulence:
    """Fluctuations as they will be generated: relative to the mean for humidity, in kelvin for temperature.

    `sigma` is the standard deviation of the whole cube: exactly, if `exact`, of each realisation (before clipping or
    exponentiation), else in expectation. Temperature likewise. A cube from a file has `file` and nothing else of weight.
    """

    grid: int
    voxel_m: float
    seed: int
    outer_scale_m: float | None
    sigma: float
    exact: bool
    lognormal: bool
    temperature_sigma_k: float
    temperature_exact: bool
    correlation: float
    table: SpectrumTable | None = None  # in the place of Kolmogorov's spectrum

    @property
    def unit_variance(self) -> float:
        """Expected variance of the cube's field for C^2 = 1."""
        return variance(self.grid, self.voxel_m, self.outer_scale_m, self.table)

    @property
    def period_m(self) -> float:
        """Edge of the cube."""
        return self.grid * self.voxel_m

    @property
    def temperature_fluctuates(self) -> bool:
        """Whether a second field is needed."""
        return self.temperature_sigma_k > 0

    def structure_constants(self, mean_g_m3: float) -> tuple[float, float]:
        """C_q^2 in g^2 m^-6 m^(-2/3) and C_T^2 in K^2 m^(-2/3)."""
        return (
            self.sigma * mean_g_m3
        ) ** 2 / self.unit_variance, self.temperature_sigma_k**2 / self.unit_variance

    def neighbour_difference(self) -> float:
        """Expected square of the difference of delta between neighbouring voxels."""
        # Of the C^2 r^(2/3) of open air the periodic cube has 0.48 at one voxel; with an outer
        # scale, no more.
        return min(
            0.48 * self.sigma**2 / self.unit_variance * math.pow(self.voxel_m, 2 / 3),
            2 * self.sigma**2,
        )

    def humidity_span(self) -> tuple[float, float]:
        """The range of delta that a cube leaves with probability 1e-6."""
        z = self._rarest() * (1 if self.exact else 1.5)  # one realisation's own sigma scatters
        if self.lognormal:
            s = math.sqrt(math.log1p(self.sigma**2))
            return math.expm1(-s * z - s * s / 2), math.expm1(s * z - s * s / 2)
        return max(-1.0, -self.sigma * z), self.sigma * z

    def temperature_span(self) -> tuple[float, float]:
        """The range of the temperature's departure from the mean, K."""
        reach = self.temperature_sigma_k * self._rarest() * (1 if self.temperature_exact else 1.5)
        return -reach, reach

    def _rarest(self) -> float:
        """How many sigmas z are so rare that 2 N^3 Q(z) = 1e-6; by bisection."""
        low, high = 0.0, 40.0
        while high - low > 1e-6:
            z = (low + high) / 2
            expected = self.grid**3 * math.erfc(z / math.sqrt(2))
            low, high = (z, high) if expected > RARE else (low, z)
        return high


def turbulence(atmosphere: Atmosphere, table: SpectrumTable | None = None) -> Turbulence | None:
    """The fluctuations that an [atmosphere] asks to be generated; None for uniform air or a cube from a file.

    `table` is the measured spectrum that it names, if it does.
    """
    f = atmosphere.fluctuations
    if f is None or f.spectrum == "file" or f.voxel_m is None or f.seed is None:
        return None
    unit = variance(f.grid, f.voxel_m, f.outer_scale_m, table)
    mean = atmosphere.air.absolute_humidity_g_m3
    if f.sigma_percent is not None:
        sigma = f.sigma_percent / 100
    else:
        constant = table.structure_constant if table else f.structure_constant_q or 0.0
        sigma = math.sqrt(constant * unit) / mean if mean > 0 else 0.0
    temperature = f.temperature_sigma_k
    return Turbulence(
        grid=f.grid,
        voxel_m=f.voxel_m,
        seed=f.seed,
        outer_scale_m=f.outer_scale_m,
        sigma=sigma,
        exact=f.sigma_percent is not None,
        lognormal=_lognormal(f, sigma),
        temperature_sigma_k=math.sqrt((f.structure_constant_t or 0.0) * unit)
        if temperature is None
        else temperature,
        temperature_exact=temperature is not None,
        correlation=f.correlation_tq,
        table=table,
    )


def _lognormal(f: Fluctuations, sigma: float) -> bool:
    return f.distribution == "lognormal" or (f.distribution == "auto" and sigma >= LOGNORMAL_FROM)


def spectral_amplitude(
    grid: int, voxel_m: float, outer_scale_m: float | None, table: SpectrumTable | None = None
) -> Array:
    """sqrt(Psi dxi^3) for C^2 = 1 at each squared wave number in units of the lowest, 0 ... 3 (grid/2)^2; 0 at 0.

    On a cubic grid the squared wave number is a whole number, so that one table serves every spectrum.
    """
    lowest = 1 / (grid * voxel_m)
    xi2 = np.arange(3 * (grid // 2) ** 2 + 1) * lowest**2
    if outer_scale_m is not None:
        xi2 = xi2 + 1 / outer_scale_m**2
    amplitude = np.zeros(len(xi2))
    if table is None:
        psi = KOLMOGOROV * xi2[1:] ** (-11 / 6)
    else:
        psi = table.density_in_space(np.sqrt(xi2[1:])) / table.structure_constant
    amplitude[1:] = np.sqrt(psi * lowest**3)
    return amplitude


@lru_cache(maxsize=16)  # variants often have it in common
def variance(
    grid: int, voxel_m: float, outer_scale_m: float | None, table: SpectrumTable | None = None
) -> float:
    """Expected variance of the periodic cube's field for C^2 = 1.

    The sum of Psi dxi^3 over its wave vectors.
    """
    number = np.arange(
        -grid // 2, grid // 2
    )  # no np.unique here or where runs begin: it imports numpy.ma
    along = np.bincount(number**2)  # wave numbers by their square
    plane = np.bincount(np.add.outer(number**2, number**2).ravel())
    count = np.zeros(3 * (grid // 2) ** 2 + 1)
    for square in np.flatnonzero(along):
        count[square : square + len(plane)] += along[square] * plane
    return float(count @ spectral_amplitude(grid, voxel_m, outer_scale_m, table) ** 2)
