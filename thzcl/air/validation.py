"""What is known of which absorption model is true: all of them side by side, and measurements.

The models are compared in four climates and in the windows between lines of water. Of published
measurements there is what could be had, which are mostly the words of abstracts.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from thzcl.air import composition, humidity, spectrum
from thzcl.air.constituents import r24
from thzcl.air.spectrum import Record
from thzcl.constituent import DB_KM_PER_INVERSE_METRE

MODELS = (
    "mpm93",
    "mpm93-corrected",
    "p676-13",
    "r24",
)  # that need no parameters, the default first
PRESSURE_HPA = 1013.25


class Climate(NamedTuple):
    """One of the climates of O'Brien and Tofsted's figures 7 to 9."""

    temperature_k: float
    relative_humidity_percent: float

    @property
    def name(self) -> str:
        """Returns the climate in words."""
        return f"{self.temperature_k - 273.15:.0f} °C, {self.relative_humidity_percent:g} % RH"


CLIMATES = (Climate(263.15, 30), Climate(293.15, 44), Climate(316.15, 30), Climate(308.15, 90))
WINDOWS_GHZ = (94.0, 140.0, 220.0, 340.0, 410.0, 460.0, 500.0, 650.0, 680.0, 850.0, 940.0)
SPECTRUM_GHZ = np.arange(100.0, 1001.0)


class Measurement(NamedTuple):
    """A publication, what it found, and what that says of the models."""

    source: str
    found: str
    says: str


MEASURED = (
    Measurement(
        "Yang, Shutler and Grischkowsky 2011, Opt. Express 19, 8830",
        "0.2 to 2 THz by time-domain spectroscopy: weak lines as predicted and measured before; in "
        "the windows between them more attenuation",
        "That a sum over lines needs a continuum, which all of them have. It does not choose "
        "among them.",
    ),
    Measurement(
        "Yang, Mandehgar and Grischkowsky 2014, Opt. Express 22, 4388",
        "0.35 to 1 THz over 137 m: the continuum left beside a line shape of their own is "
        "significantly smaller than beside that of Van Vleck and Weisskopf cut off at 750 GHz",
        "That a continuum belongs to its line shape. r24 cuts its lines off at 750 GHz, and has "
        "to have the larger continuum; of its total this says nothing.",
    ),
    Measurement(
        "O'Hara and Grischkowsky 2018, IEEE Trans. Terahertz Sci. Technol. 8, 372",
        "450 to 1000 GHz: P.676-11 disagrees with HITRAN and with measurements, the more the "
        "higher frequency and vapour density are; its wings of lines and its continuum are blamed",
        "Against p676-13 above 450 GHz in moist air, as its water is made in the same way. The two "
        "mpm93 are made so too, and stand higher still, r24 lower; the abstract does not say "
        "whether the disagreement is upward.",
    ),
    Measurement(
        "Fox et al. 2024, Atmos. Meas. Tech. 17, 4957",
        "89 to 664 GHz from an aircraft, against two models: looking up, mean differences are "
        "close to the spectroscopic uncertainty or within it",
        "That the best models hold up to 664 GHz as well as they claim. The text that could be had "
        "does not name the two.",
    ),
)
MISSING = (
    (
        "Attenuations in dB/km of Yang et al. 2011 and 2014 and of O'Hara and Grischkowsky 2018: "
        "they are in figures and tables, and only abstracts were at hand."
    ),
    (
        "Slocum et al. 2013, 300 to 1500 GHz at several humidities and lengths of path: the text "
        "at hand breaks off before its coefficients."
    ),
    (
        "Hoshina et al. 2008, Koshelev et al. and Odintsova et al.: no text with numbers. Of "
        "Tretyakov et al. 2007, wet nitrogen at 100 to 210 GHz, the abstract has none."
    ),
)

# Podobedov et al. (2008), J. Quant. Spectrosc. Radiat. Transfer 109, 458,
# doi:10.1016/j.jqsrt.2007.07.005: what is left beside lines of HITRAN 2004 by Van Vleck and
# Weisskopf, cut off at 100 /cm, at 293 to 333 K; in (dB/km)/(kPa THz)^2, with exponents of 1/T.
SELF, NITROGEN = 3.83, 0.185
COLDEST_K, WARMEST_K = 293.0, 333.0
SELF_EXPONENT, NITROGEN_EXPONENT = 8.8, 5.7
REFERENCE_K = 296.0  # which the abstract does not state: 3 K more or less are 6 to 9 %
CONTINUUM = "continuum of water vapour at 650 GHz, by Podobedov et al. (2008) and of r24"


def spectra(ghz: Any = SPECTRUM_GHZ) -> dict[str, list[Record]]:
    """Returns the records of all models at some frequencies in GHz, by climate."""
    gases, found = [composition.part(name) for name in MODELS], {}
    for climate in CLIMATES:
        kelvin, moist = np.array([climate.temperature_k]), climate.relative_humidity_percent
        given = "relative_humidity_percent", moist
        states = spectrum.states(np.asarray(ghz), kelvin, PRESSURE_HPA, *given)
        rows, _ = spectrum.by_model(states, gases)
        found[climate.name] = rows
    return found


def windows() -> list[dict[str, Any]]:
    """Returns the attenuation in dB/km in each climate and window, in a column for each model.

    It is None where a model is not valid. `spread_percent` is the largest less the smallest, over
    the largest.
    """
    rows = []
    for climate, records in spectra(WINDOWS_GHZ).items():
        for ghz in WINDOWS_GHZ:
            found = {r["model"]: r["total_db_km"] for r in records if r["frequency_ghz"] == ghz}
            spread = 100 * (1 - min(found.values()) / max(found.values()))
            by_model = {model: found.get(model) for model in MODELS}
            row = {"climate": climate, "frequency_ghz": ghz, **by_model, "spread_percent": spread}
            rows.append(row)
    return rows


def continua(ghz: float = 650.0) -> list[dict[str, Any]]:
    """Returns the continuum of water vapour in dB/km as measured, and that of r24, by climate.

    Measured is that of Podobedov et al., with the absorption by nitrogen for that by air, in the
    climates whose temperatures they measured at. It stands beside lines that end 3 THz away, r24's
    beside lines that end 0.75 THz away, so that r24's has to be the larger.
    """
    rows = []
    for climate in CLIMATES:
        kelvin, percent = climate
        if not COLDEST_K <= kelvin <= WARMEST_K:
            continue
        vapour = float(humidity.vapour_pressure_from_relative(percent, kelvin))
        dry, warmth = PRESSURE_HPA - vapour, REFERENCE_K / kelvin
        own, foreign = SELF * warmth**SELF_EXPONENT, NITROGEN * warmth**NITROGEN_EXPONENT
        measured = (own * vapour + foreign * dry) * vapour / 100 * (ghz / 1e3) ** 2
        arguments = (np.array([x]) for x in (ghz, kelvin, dry, vapour))
        modelled = float(r24.water_continuum(*arguments)[0]) * DB_KM_PER_INVERSE_METRE / 1e3
        rows.append({"climate": climate.name, "measured_db_km": measured, "r24_db_km": modelled})
    return rows
