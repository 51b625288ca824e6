"""Snow: laws of the sizes of dry flakes, and the constituent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.constituent import (
    Constituent,
    OpticalProperties,
    Parameters,
    Sizes,
    Span,
    hookimpl,
    parameter,
    snow_permittivity,
    sphere_optics,
    spread_sizes,
    wet_bulb_temperature,
)

Array = NDArray[np.float64]

LEAST_MM, MOST_MM = 0.01, 20.0  # melted diameters
MELTING_K = 273.15
WARNED_ABOVE_K = 274.0
DENSITIES_G_CM3 = (0.05, 0.2)  # between which dry flakes mostly lie


class Law(NamedTuple):
    """An exponential law of melted diameters, N = n R^-a exp(-s R^-b D), per m3 and mm.

    D is in mm and the rate R, of melted water, in mm/h.
    """

    n: float
    a: float
    s: float
    b: float


LAWS = {
    "sekhon-srivastava": Law(2500.0, 0.94, 2.29, 0.45),  # 1970
    "gunn-marshall": Law(3800.0, 0.87, 2.55, 0.48),  # 1958
}


def flake_sizes(law: str, rate_mm_h: float, density_g_cm3: float) -> Sizes:
    """Returns the diameters of flakes as spheres of a density, by a law of melted diameters."""
    if rate_mm_h == 0:
        return Sizes(np.ones(1), np.zeros(1))
    n, a, s, b = LAWS[law]

    def melted(mm: Array) -> Array:
        with np.errstate(over="ignore"):  # hardly any snow has hardly any large flakes
            steepness = s * rate_mm_h**-b * mm
        return np.asarray(n * np.exp(-a * np.log(rate_mm_h) - steepness))

    found = spread_sizes(melted, LEAST_MM, MOST_MM)
    return Sizes(found.diameter_mm * density_g_cm3 ** (-1 / 3), found.per_m3)


class Snow(Constituent):
    """Dry snow, as spheres of ice in air, by Mie's theory.

    `rate_mm_h` is that of the melted water. The laws of melted diameters, from 0.01 to 20 mm, are
    used as they are printed. A flake of `density_g_cm3` is a sphere of the melted drop's mass, and
    has the permittivity of ice in air by Maxwell Garnett, ice being that of Maetzler (2006).

    Flakes have the wet-bulb temperature of the air, 273.15 K at most.

    Validity: 1 to 1000 GHz, dry flakes. Where the wet bulb is above 274 K snow melts, with a
    warning: wet flakes extinguish more. Flakes are no spheres, which matters more than anything
    else said here. Soft spheres extinguish too little (at 120 to 160 GHz measurements lie between
    them and ITU-R P.1817), and underrate back-scatter by orders of magnitude; take the back-scatter
    as a lower bound. Between 0.05 and 0.2 g/cm3 extinction doubles below 300 GHz; `thzcl
    absorption` shows the spread over densities and laws.

    Validation: Mie's theory to 1e-9 of miepython and of 60-digit sums (tests/test_mie.py).
    Extinction and asymmetry of 1 mm/h at 94 to 650 GHz to 2e-4 of values computed with other code
    (tests/test_weather.py). That says nothing of real flakes.

    References: R. S. Sekhon, R. C. Srivastava (1970), "Snow size spectra and radar reflectivity",
    J. Atmos. Sci. 27, 299. K. L. S. Gunn, J. S. Marshall (1958), "The distribution with size of
    aggregate snowflakes", J. Meteorol. 15, 452. C. Maetzler (2006), "Microwave dielectric
    properties of ice", in Thermal Microwave Radiation, IET. J. C. Maxwell Garnett (1904), Phil.
    Trans. R. Soc. A 203, 385.
    """

    name = "snow"
    contract = 1
    varies = False
    valid = (Span("frequency_ghz", 1.0, 1000.0, "what permittivity and sizes are good for"),)

    class Params(Parameters):
        """Snow: how much of it, and of which flakes."""

        rate_mm_h: float = parameter(
            ge=0, le=300, unit="mm/h", help="snow rate, as melted water in a gauge"
        )
        flakes: Literal["sekhon-srivastava", "gunn-marshall"] = parameter(
            "sekhon-srivastava", help="law of flake sizes"
        )
        density_g_cm3: float = parameter(
            0.1, ge=0.01, le=0.9, unit="g/cm3", help="density of a flake"
        )
        layer_top_m: float = parameter(
            2000.0, gt=0, le=20000, unit="m", help="height up to which it snows"
        )

    def __init__(self, params: Any) -> None:
        super().__init__(params)
        self.layer_top_m = params.layer_top_m
        self._sizes = flake_sizes(params.flakes, params.rate_mm_h, params.density_g_cm3)

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns absorption and scattering of the flakes, at their temperature."""
        wet_bulb = wet_bulb_temperature(temperature_k, pressure_hpa, vapour_hpa)

        def permittivity(hz: Array, kelvin: Array) -> NDArray[np.complex128]:
            return snow_permittivity(hz, kelvin, self.params.density_g_cm3)

        own = np.minimum(wet_bulb, MELTING_K)
        return sphere_optics(frequency_hz, own, permittivity, self._sizes)

    def notes(self, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array) -> Sequence[str]:
        """Returns that flakes melt."""
        warmest = float(np.max(wet_bulb_temperature(temperature_k, pressure_hpa, vapour_hpa)))
        if warmest <= WARNED_ABOVE_K:
            return ()
        return (
            f"a wet bulb of {warmest:.4g} K: above {WARNED_ABOVE_K:g} K snow melts as it falls",
        )

    def alternatives(self) -> list[Parameters]:
        """Returns as much snow by each law, of light and of dense flakes besides."""
        densities = {*DENSITIES_G_CM3, self.params.density_g_cm3}
        change = [
            {"flakes": law, "density_g_cm3": density}
            for law in LAWS
            for density in sorted(densities)
        ]
        return [self.params.model_copy(update=new) for new in change]


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [Snow]
