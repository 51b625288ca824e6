"""Fog: sizes of droplets, visibility, and the constituent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, NamedTuple

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
    relative_humidity,
    sphere_optics,
    spread_sizes,
    water_permittivity,
)

Array = NDArray[np.float64]

KOSCHMIEDER = 2.61  # g/m3 m/um: 2/3 ln(1/0.02), for a contrast of 2 %
LEAST_MODES, MOST_MODES = 0.02, 30.0  # radii, in mode radii, that matter to mass and scattering
MOST_G_M3 = 10.0  # more liquid water than any cloud holds
WARNED_BELOW_PERCENT = 95.0


class Droplets(NamedTuple):
    """A modified gamma law, n(r) ~ r^a exp(-a r / r_m), and its usual mode radius r_m in um."""

    a: float
    mode_um: float

    def effective_um(self, mode_um: float) -> float:
        """Returns the effective radius: the mean of r^3 over that of r^2."""
        return mode_um * (self.a + 3) / self.a


KINDS = {"radiation": Droplets(6.0, 4.0), "advection": Droplets(3.0, 10.0)}


def droplet_sizes(droplets: str, mode_um: float, water_g_m3: float) -> Sizes:
    """Returns the sizes of droplets that hold some liquid water in a volume of air."""
    a, mode_mm = KINDS[droplets].a, 2e-3 * mode_um  # of diameter

    def density(mm: Array) -> Array:
        modes = mm / mode_mm
        return np.asarray((modes * np.exp(1 - modes)) ** a)

    found = spread_sizes(density, LEAST_MODES * mode_mm, MOST_MODES * mode_mm)
    return Sizes(found.diameter_mm, found.per_m3 * (water_g_m3 / found.water_g_m3))


def water_of_visibility(visibility_m: float, effective_um: float) -> float:
    """Returns the liquid water of fog in which one sees as far as that, g/m3.

    Visible light is extinguished by twice the droplets' cross-section, and contrast falls to 2 %
    over the visibility (Koschmieder 1924). That to which it falls to 5 %, the meteorological
    optical range, is 0.77 of it.
    """
    return KOSCHMIEDER * effective_um / visibility_m


class Fog(Constituent):
    """Fog of spherical droplets, by Mie's theory.

    `liquid_water_g_m3` or `visibility_m` says how much of it there is. Over the visibility contrast
    falls to 2 %: w = 2.61 r_eff / V, in g/m3, um and m. Droplets follow a modified gamma law, n(r)
    ~ r^a exp(-a r / r_m), those of "radiation" fog with a = 6 and r_m = 4 um, those of "advection"
    fog with a = 3 and r_m = 10 um, unless `mode_radius_um` says otherwise. Heavy radiation fog has
    0.063 g/m3 and one sees 250 m, heavy advection fog 0.37 g/m3 and 140 m.

    Droplets have the air's temperature, and the permittivity of Rosenkranz (2015).

    Validity: 1 to 1000 GHz, 233 to 373 K. Air below 95 % of relative humidity holds no fog for
    long, and there is a warning. The law and the mode are a fit to few measurements: for a given
    visibility the two kinds differ by a factor of three in liquid water, and so in extinction.
    By other published permittivities of water it differs by up to 11 %. Patches of fog are not
    modelled. Rayleigh's formula, as in ITU-R P.840, would be 10 % low at 650 GHz for a mode of 10
    um.

    Validation: Mie's theory to 1e-9 of miepython and of 60-digit sums (tests/test_mie.py).
    Extinction of 1 g/m3 at 94 to 650 GHz to 1e-4 of values computed with other code, by the
    permittivities of Liebe (1991) and of Rosenkranz (tests/test_weather.py). No measurement of fog
    in this range of frequencies was found to compare with.

    References: E. P. Shettle, R. W. Fenn (1979), "Models for the aerosols of the lower atmosphere
    and the effects of humidity variations on their optical properties", AFGL-TR-79-0214. H.
    Koschmieder (1924), "Theorie der horizontalen Sichtweite", Beitr. Phys. freien Atmos. 12, 33. P.
    W. Rosenkranz (2015), IEEE Trans. Geosci. Remote Sens. 53, 1387. G. Mie (1908), Ann. Phys. 330,
    377.
    """

    name = "fog"
    contract = 1
    varies = False
    valid = (
        Span("frequency_ghz", 1.0, 1000.0, "what permittivity and sizes are good for"),
        Span("temperature_k", 233.15, 373.15, "where water is liquid"),
    )

    class Params(Parameters):
        """Fog: how much of it, and of which droplets."""

        exactly_one: ClassVar = (("liquid_water_g_m3", "visibility_m"),)

        liquid_water_g_m3: float | None = parameter(
            None, ge=0, le=MOST_G_M3, unit="g/m3", help="liquid water in a volume of air"
        )
        visibility_m: float | None = parameter(
            None, gt=0, le=1e6, unit="m", help="how far one sees: contrast falls to 2 % over it"
        )
        droplets: Literal["radiation", "advection"] = parameter(
            "radiation", help="law of droplet sizes"
        )
        mode_radius_um: float | None = parameter(
            None, ge=0.1, le=100, unit="um", help="most frequent radius; 4 or 10, by droplets"
        )
        layer_top_m: float = parameter(
            200.0, gt=0, le=20000, unit="m", help="height up to which there is fog"
        )

        @property
        def mode_um(self) -> float:
            """Returns the most frequent radius, um."""
            return self.mode_radius_um or KINDS[self.droplets].mode_um

        @property
        def water_g_m3(self) -> float:
            """Returns the liquid water, g/m3."""
            if self.visibility_m is None:
                return self.liquid_water_g_m3 or 0.0
            effective = KINDS[self.droplets].effective_um(self.mode_um)
            return water_of_visibility(self.visibility_m, effective)

        def troubles(self) -> list[Any]:
            """Returns that one cannot see as little as that."""
            if self.water_g_m3 <= MOST_G_M3:
                return []
            text = (
                f"means {self.water_g_m3:.3g} g/m3 of liquid water, above {MOST_G_M3:g}; raise it"
            )
            return [self.trouble("visibility_m", text)]

    def __init__(self, params: Any) -> None:
        super().__init__(params)
        self.layer_top_m = params.layer_top_m
        self._sizes = droplet_sizes(params.droplets, params.mode_um, params.water_g_m3)

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns absorption and scattering of the droplets, at the air's temperature."""
        del pressure_hpa, vapour_hpa
        return sphere_optics(frequency_hz, temperature_k, water_permittivity, self._sizes)

    def notes(self, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array) -> Sequence[str]:
        """Returns that the air is too dry."""
        del pressure_hpa
        percent = float(np.min(relative_humidity(vapour_hpa, temperature_k)))
        if percent >= WARNED_BELOW_PERCENT:
            return ()
        return (
            f"at {percent:.3g} % relative humidity droplets of fog dry up; fog has 95 % or more",
        )

    def alternatives(self) -> list[Parameters]:
        """Returns as much fog, of each kind of droplets."""
        change = [{"droplets": kind, "mode_radius_um": None} for kind in KINDS]
        return [self.params.model_copy(update=new) for new in change]


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [Fog]
