"""The passive spectral imager: brightness temperature at one frequency or several."""

from __future__ import annotations

import numpy as np

from thzcl.sensor import (
    FrequenciesGHz,
    Image,
    Needs,
    Optics,
    Parameters,
    Radiances,
    Sensor,
    View,
    hookimpl,
    parameter,
)


class PassiveSpectral(Sensor):
    """A noiseless passive imager of infinitely narrow bands.

    It records the brightness temperature at each frequency, the spectral (single frequency) passive
    mode of O'Brien and Tofsted: the temperature of the black body whose Planck radiance equals that
    of the surface, attenuated, and of the air in front of it. With several frequencies the image is
    their mean; the result file keeps each.
    """

    name = "passive-spectral"
    contract = 1

    class Params(Parameters):
        """Parameters of the passive spectral imager."""

        frequency_ghz: FrequenciesGHz = parameter(help="frequency, or a list of them", unit="GHz")
        optics: Optics | None = parameter(None, help="blur; leave the table out for none")

    def needs(self, view: View) -> Needs:  # noqa: ARG002 (the contract's)
        """The given frequencies."""
        ascending = sorted({*np.atleast_1d(self.params.frequency_ghz)})
        return Needs(frequency_hz=np.array(ascending) * 1e9, optics=self.params.optics)

    def observe(self, sight: Radiances, rng: np.random.Generator) -> Image:  # noqa: ARG002 (as above)
        """Brightness temperature in kelvin, averaged over the frequencies."""
        return Image(
            sight.brightness_temperature.mean(axis=0), unit="K", quantity="brightness temperature"
        )


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """The sensor of this file."""
    return [PassiveSpectral]
