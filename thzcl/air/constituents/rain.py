"""Rain: laws of drop sizes, what they come to on the ground, and the constituent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from thzcl.constituent import (
    Constituent,
    File,
    FileError,
    Grid,
    OpticalProperties,
    Parameters,
    Sizes,
    Span,
    file_parameter,
    hookimpl,
    parameter,
    sphere_optics,
    spread_sizes,
    water_permittivity,
    wet_bulb_temperature,
)

Array = NDArray[np.float64]

LEAST_MM, MOST_MM = 0.01, 10.0  # diameters of drops
LARGEST_MM = 30.0  # that a file may hold
LEAST_RATE = 0.01  # mm/h, below which a law is scaled as there: it returns ever more than its rate
COLDEST_K, HOTTEST_K = 233.15, 373.15  # between which water is liquid
WARNED_BELOW_K = 258.0

GRID = Grid("number_density", "1/m3/mm", axes=(("diameter_mm", "mm"),), least=0.0)


class Law(NamedTuple):
    """An exponential law, N = intercept exp(-slope R^-0.21 D): drops per m3 and mm of diameter.

    D is in mm, the rate R in mm/h and the slope in 1/mm.
    """

    intercept: float
    slope: float

    def density(self, rate_mm_h: float, diameter_mm: Array) -> Array:
        """Returns the number of drops per m3 and mm, as the law is printed."""
        falloff = np.exp(-self.slope * rate_mm_h**-0.21 * diameter_mm)
        return np.asarray(self.intercept * falloff)


LAWS = {
    "marshall-palmer": Law(8000.0, 4.1),  # Marshall and Palmer 1948
    "drizzle": Law(30000.0, 5.7),  # these three: Joss, Thams and Waldvogel 1968
    "widespread": Law(7000.0, 4.1),
    "thunderstorm": Law(1400.0, 3.0),
}


def raw_sizes(law: str, rate_mm_h: float) -> Sizes:
    """Returns the drops of a law as it is printed; they come to another rate than its own."""
    return spread_sizes(lambda mm: LAWS[law].density(rate_mm_h, mm), LEAST_MM, MOST_MM)


def fall_speed(diameter_mm: Array) -> Array:
    """Returns how fast drops fall in air at rest, m/s (Atlas, Srivastava and Sekhon 1973)."""
    return np.maximum(0.0, 9.65 - 10.3 * np.exp(-0.6 * diameter_mm))


def rain_rate(sizes: Sizes) -> float:
    """Returns how much rain drops of these sizes come to, mm/h."""
    flux = sizes.diameter_mm**3 * fall_speed(sizes.diameter_mm) * sizes.per_m3
    return float(np.pi / 6 * 3.6e-3 * flux.sum())


def scaled_sizes(law: str, rate_mm_h: float) -> Sizes:
    """Returns the drops of a law, their number scaled so that they come to the rate."""
    if rate_mm_h == 0:
        return Sizes(np.ones(1), np.zeros(1))
    at = max(rate_mm_h, LEAST_RATE)
    drops = raw_sizes(law, rate_mm_h)
    return Sizes(drops.diameter_mm, drops.per_m3 * (at / rain_rate(raw_sizes(law, at))))


def measured_sizes(file: File, rate_mm_h: float) -> Sizes:
    """Returns the drops of a file, their number scaled so that they come to the rate.

    Between the file's diameters their density is on straight lines, and 0 outside. Raises
    FileError for a file that holds no drops, or diameters that drops do not have.
    """
    diameter, density = file.arrays["diameter_mm"], file.arrays["number_density"]
    if diameter[0] <= 0 or diameter[-1] > LARGEST_MM:
        wrong = diameter[0] if diameter[0] <= 0 else diameter[-1]
        raise FileError(
            f"{file.name}: diameter_mm holds {wrong:g} mm; drops have up to {LARGEST_MM:g} mm, and "
            "more than 0: are the units right?"
        )
    if len(diameter) < 2:
        raise FileError(f"{file.name}: number_density at one diameter only; give two or more")

    def between(mm: Array) -> Array:
        return np.asarray(np.interp(mm, diameter, density))

    drops = spread_sizes(between, float(diameter[0]), float(diameter[-1]))
    own = rain_rate(drops)
    if not own > 0:
        raise FileError(f"{file.name}: number_density holds no drops that fall; give some")
    return Sizes(drops.diameter_mm, drops.per_m3 * (rate_mm_h / own))


class Rain(Constituent):
    """Rain of spherical drops, by Mie's theory.

    `rate_mm_h` is what falls: the number of drops is scaled so that it comes to that, with the
    speeds at which drops fall in air at rest. The laws as printed do not return their own rate;
    that of Marshall and Palmer, 10 mm/h, comes to 11.6. So scaled, "widespread" is the same law as
    "marshall-palmer". Below 0.01 mm/h the scale is that of 0.01 mm/h. With `drop_sizes = "file"`
    the sizes are those of a disdrometer: a NetCDF-4 file with number_density(diameter_mm), per m3
    and mm.

    Drops have the wet-bulb temperature of the air unless `temperature_k` says otherwise. Their
    permittivity is that of Rosenkranz (2015). Diameters reach from 0.01 to 10 mm.

    Validity: 1 to 1000 GHz, and drops that are liquid, from 233 to 373 K. Below 258 K there is
    hardly any rain, and a warning. Real drops are oblate: horizontal and vertical polarisation
    differ by 0.5 to 1.5 % in extinction above 94 GHz (ITU-R P.838-3). Which law of sizes holds is
    what matters most: at 650 GHz and 10 mm/h extinction is 4.3 dB/km in a thunderstorm's drops,
    7.3 in Marshall and Palmer's, 13.3 in drizzle's; `thzcl absorption` shows the spread.

    Validation: Mie's theory to 1e-9 of miepython and of 60-digit sums (tests/test_mie.py).
    Extinction, albedo, asymmetry and back-scatter of the printed law to 1e-4, 2e-5, 3e-5 and 6e-4
    of values computed with other code (tests/test_weather.py). Scaled as here, drops of Marshall
    and Palmer extinguish 13 to 17 % more than ITU-R P.838-3 at 10 to 25 mm/h and 225 to 355 GHz,
    with which measurements at 313 and 355 GHz agree (Ishii and others 2010, 2011).

    References: J. S. Marshall, W. McK. Palmer (1948), "The distribution of raindrops with size", J.
    Meteorol. 5, 165. J. Joss, J. C. Thams, A. Waldvogel (1968), "The variation of raindrop size
    distributions at Locarno", Proc. Int. Conf. Cloud Physics, 369. D. Atlas, R. C. Srivastava, R.
    S. Sekhon (1973), "Doppler radar characteristics of precipitation at vertical incidence", Rev.
    Geophys. 11, 1. P. W. Rosenkranz (2015), IEEE Trans. Geosci. Remote Sens. 53, 1387. G. Mie
    (1908), Ann. Phys. 330, 377.
    """

    name = "rain"
    contract = 1
    varies = False
    valid = (Span("frequency_ghz", 1.0, 1000.0, "what permittivity and sizes are good for"),)

    class Params(Parameters):
        """Rain: how much of it, and of which drops."""

        rate_mm_h: float = parameter(ge=0, le=300, unit="mm/h", help="rain rate, as a gauge has it")
        drop_sizes: Literal["marshall-palmer", "drizzle", "widespread", "thunderstorm", "file"] = (
            parameter("marshall-palmer", help="law of drop sizes, scaled to the rate")
        )
        file: File | None = file_parameter(
            GRID, None, help="NetCDF file of number_density(diameter_mm), per m3 and mm"
        )
        temperature_k: float | None = parameter(
            None, ge=COLDEST_K, le=HOTTEST_K, unit="K", help="of the drops; the air's wet bulb"
        )
        layer_top_m: float = parameter(
            2000.0, gt=0, le=20000, unit="m", help="height up to which it rains"
        )

        def troubles(self) -> list[Any]:
            """Returns what is wrong with the file that is or is not given."""
            if (self.drop_sizes == "file") == (self.file is not None):
                return []
            return [self.trouble("drop_sizes", '"file" and file = "..." go together')]

    def __init__(self, params: Any) -> None:
        super().__init__(params)
        self.layer_top_m = params.layer_top_m
        if params.file is None:
            self._sizes = scaled_sizes(params.drop_sizes, params.rate_mm_h)
        else:
            self._sizes = measured_sizes(params.file, params.rate_mm_h)

    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns absorption and scattering of the drops, at their temperature."""
        own = self._temperature(temperature_k, pressure_hpa, vapour_hpa)
        own = np.clip(own, COLDEST_K, HOTTEST_K)
        return sphere_optics(frequency_hz, own, water_permittivity, self._sizes)

    def notes(self, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array) -> Sequence[str]:
        """Returns that drops are too cold to be liquid."""
        coldest = float(np.min(self._temperature(temperature_k, pressure_hpa, vapour_hpa)))
        if coldest >= WARNED_BELOW_K:
            return ()
        return (f"drops of {coldest:.4g} K: below {WARNED_BELOW_K:g} K it hardly ever rains",)

    def _temperature(self, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array) -> Array:
        """Returns the drops' temperature, K."""
        if self.params.temperature_k is not None:
            return np.asarray(self.params.temperature_k)
        return wet_bulb_temperature(temperature_k, pressure_hpa, vapour_hpa)

    def alternatives(self) -> list[Parameters]:
        """Returns rain of the same rate by each law."""
        change = [{"drop_sizes": law, "file": None} for law in LAWS]
        return [self.params.model_copy(update=new) for new in change]


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [Rain]
