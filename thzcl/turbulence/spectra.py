"""Turbulent fluctuations on a periodic cube, before any random number: spectra, variances, ranges.

A scalar whose structure function is C^2 r^(2/3) has Kolmogorov's spectrum, in cycles per metre,
Psi(xi) = 9.69e-3 C^2 xi^(-11/3) (Tatarskii 1971, "The effects of the turbulent atmosphere on wave
propagation"). With an outer scale L0 (von Karman) xi^2 becomes xi^2 + 1/L0^2. The cube is that of
O'Brien and Tofsted, equation (1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from thzcl.scenario.atmosphere import Atmosphere, Fluctuations
from thzcl.turbulence import large_scales
from thzcl.turbulence.lattice import Lattice
from thzcl.turbulence.spectrum_table import SpectrumTable

Array = NDArray[np.float64]

# Gamma(8/3) sin(pi/3) / (4 pi^2) is 0.0330054, for wave numbers in radians per metre. In cycles per
# metre it is multiplied by (2 pi)^(-2/3), which makes 9.6935e-3.
KOLMOGOROV = (
    math.gamma(8 / 3) * math.sin(math.pi / 3) / (4 * math.pi**2) * (2 * math.pi) ** (-2 / 3)
)
LOGNORMAL_FROM = 0.3  # relative sigma from which clipping a Gaussian at dry air would bias the mean
EXTRAPOLATED = 1e-3  # part of the variance that a spectrum's continuation may make without a note
RARE = 1e-6  # probability that a cube exceeds the range that a plan assumes


@dataclass(frozen=True)
class Turbulence:
    """Random fluctuations of humidity, relative to its mean, and of temperature, in kelvin.

    `sigma` is the standard deviation of humidity over the cube, before clipping or exponentiation.
    If `exact`, every realisation is rescaled to it; otherwise it is the expected value. Eddies
    larger than the cube add to it.
    `temperature_sigma_k` and `temperature_exact` say the same of temperature, and `correlation` is
    that of humidity with temperature. `outer_scale_m` is None for no outer scale.
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
    table: SpectrumTable | None = None  # a measured spectrum in place of Kolmogorov's
    large_scales: bool = False  # whether there are eddies larger than the cube too

    @property
    def unit_variance(self) -> float:
        """Returns the expected variance of the cube's field for C^2 = 1."""
        return variance(self.grid, self.voxel_m, self.outer_scale_m, self.table)

    @property
    def lattice(self) -> Lattice:
        """Returns the voxels of the periodic cube."""
        return Lattice.cubic(self.grid, self.voxel_m)

    @property
    def period_m(self) -> float:
        """Returns the edge of the cube, m."""
        return self.grid * self.voxel_m

    @property
    def meant_outer_scale_m(self) -> float | None:
        """Returns the outer scale that the cube stands for, m; None for a measured spectrum.

        Without an outer scale of its own, it is that of von Karman's air with the cube's variance
        and structure constant, 1.6 periods: 0.1537 C^2 L0^(2/3) is the variance of such air.
        """
        if self.table is not None or self.outer_scale_m is not None:
            return self.outer_scale_m
        shape = math.sqrt(math.pi) / 4 * math.gamma(1 / 3) / math.gamma(11 / 6)
        variance = self.unit_variance + (self.large_variance() if self.large_scales else 0.0)
        return float((variance / (KOLMOGOROV * 4 * math.pi * shape)) ** 1.5)

    @property
    def temperature_fluctuates(self) -> bool:
        """Returns whether temperature fluctuates, so that a second field is needed."""
        return self.temperature_sigma_k > 0

    def large_variance(self, reach_m: float | None = None) -> float:
        """Returns the expected variance of the eddies larger than the cube, for C^2 = 1.

        Within `reach_m` of a place at which they are 0 it is a bound, of the largest there.
        """
        waves = large_scales.spread(self.period_m, self.outer_scale_m)
        part = np.ones(len(waves.variance))
        if reach_m is not None:
            turns = 2 * math.pi * np.linalg.norm(waves.vector, axis=1) * reach_m
            part = np.minimum(turns**2, 4.0)
        return float(KOLMOGOROV * waves.variance @ part)

    def structure_constants(self, mean_g_m3: float) -> tuple[float, float]:
        """Returns C_q^2 in g^2 m^-6 m^(-2/3) and C_T^2 in K^2 m^(-2/3)."""
        return (
            self.sigma * mean_g_m3
        ) ** 2 / self.unit_variance, self.temperature_sigma_k**2 / self.unit_variance

    def neighbour_difference(self) -> float:
        """Returns the expected squared difference of delta between neighbouring voxels."""
        # At one voxel the periodic cube has 0.48 of the C^2 r^(2/3) of open air; with an outer
        # scale it has no more.
        return min(
            0.48 * self.sigma**2 / self.unit_variance * math.pow(self.voxel_m, 2 / 3),
            2 * self.sigma**2,
        )

    def humidity_span(self, large_sigma: float = 0.0) -> tuple[float, float]:
        """Returns the range of delta that a cube exceeds with probability 1e-6.

        `large_sigma` is the expected standard deviation of what larger eddies add to it.
        """
        z = self._rarest() * (1 if self.exact else 1.5)  # the sigma of one realisation scatters
        if large_sigma:
            reach = math.hypot(self.sigma * z, large_sigma * 1.5 * self._rarest())
            return max(-1.0, -reach), reach
        if self.lognormal:
            s = math.sqrt(math.log1p(self.sigma**2))
            return math.expm1(-s * z - s * s / 2), math.expm1(s * z - s * s / 2)
        return max(-1.0, -self.sigma * z), self.sigma * z

    def temperature_span(self) -> tuple[float, float]:
        """Returns the range of the departure from the mean, K, exceeded with probability 1e-6."""
        reach = self.temperature_sigma_k * self._rarest() * (1 if self.temperature_exact else 1.5)
        return -reach, reach

    def _rarest(self) -> float:
        """Returns the z, in sigmas, at which 2 N^3 Q(z) = 1e-6, for a cube of N^3 voxels."""
        low, high = 0.0, 40.0
        while high - low > 1e-6:
            z = (low + high) / 2
            expected = self.grid**3 * math.erfc(z / math.sqrt(2))
            low, high = (z, high) if expected > RARE else (low, z)
        return high


def turbulence(atmosphere: Atmosphere, table: SpectrumTable | None = None) -> Turbulence | None:
    """Returns the fluctuations that [atmosphere] asks for, or None if it asks for none at random.

    That is so in uniform air, and with a cube from a file. `table` is the measured spectrum that
    the scene names, or None. Raises ValueError for fluctuations without a seed or without voxels.
    """
    f = atmosphere.fluctuations
    if f is None or f.spectrum == "file":
        return None
    if f.voxel_m is None or f.seed is None:
        raise ValueError("random fluctuations need voxel_m and a seed, which reading a scene draws")
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
        exact=f.sigma_percent is not None and f.sigma_of == "cube",
        lognormal=_lognormal(f, sigma),
        temperature_sigma_k=math.sqrt((f.structure_constant_t or 0.0) * unit)
        if temperature is None
        else temperature,
        temperature_exact=temperature is not None and f.sigma_of == "cube",
        correlation=f.correlation_tq,
        table=table,
        large_scales=f.large_scales,
    )


def _lognormal(f: Fluctuations, sigma: float) -> bool:
    """Returns whether humidity is lognormal, which "auto" makes it from a sigma of 30 % on."""
    return f.distribution == "lognormal" or (f.distribution == "auto" and sigma >= LOGNORMAL_FROM)


def spectral_amplitude(
    grid: int, voxel_m: float, outer_scale_m: float | None, table: SpectrumTable | None = None
) -> Array:
    """Returns sqrt(Psi dxi^3) for C^2 = 1, by the square of the wave number on the cube's grid.

    In units of the lowest wave number, the squares on a cubic grid are the whole numbers from 0 to
    3 (grid/2)^2, which index the result. The mean, at 0, has no amplitude.
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


@lru_cache(maxsize=16)  # many variants have the same
def variance(
    grid: int, voxel_m: float, outer_scale_m: float | None, table: SpectrumTable | None = None
) -> float:
    """Returns the expected variance of the periodic cube's field for C^2 = 1.

    It is the sum of Psi dxi^3 over the wave vectors of the cube.
    """
    return float(_variances(grid, voxel_m, outer_scale_m, table).sum())


def _variances(
    grid: int, voxel_m: float, outer_scale_m: float | None, table: SpectrumTable | None
) -> Array:
    """Returns the variance of all waves of one frequency, by the square of their wave number."""
    # np.unique would import numpy.ma, which costs time at the start of every run.
    number = np.arange(-grid // 2, grid // 2)
    along = np.bincount(number**2)  # wave numbers by their square
    plane = np.bincount(np.add.outer(number**2, number**2).ravel())
    count = np.zeros(3 * (grid // 2) ** 2 + 1)
    for square in np.flatnonzero(along):
        count[square : square + len(plane)] += along[square] * plane
    return np.asarray(count * spectral_amplitude(grid, voxel_m, outer_scale_m, table) ** 2)


def beyond_table(turbulence: Turbulence) -> str | None:
    """Returns a note on waves of a cube that its measured spectrum does not reach, or None."""
    t, table = turbulence, turbulence.table
    if table is None:
        return None
    low, high = table.frequency[0], table.frequency[-1]
    variances = _variances(t.grid, t.voxel_m, t.outer_scale_m, table)
    xi = np.sqrt(np.arange(len(variances))) / t.period_m
    below, above = (float(variances[w].sum() / variances.sum()) for w in (xi < low, xi > high))
    if max(below, above) < EXTRAPOLATED:
        return None
    return (
        f"the measured spectrum holds from {low:.3g} to {high:.3g} cycles/m, and is continued by "
        f"its slopes over the cube's {xi[1]:.3g} to {xi[-1]:.3g} cycles/m: "
        f"{100 * below:.2g} % of the variance lie below it, {100 * above:.2g} % above"
    )
