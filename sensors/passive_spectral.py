"""The passive spectral imager, which records brightness temperature at single frequencies."""

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

    It records the brightness temperature at each frequency, as the passive, single-frequency mode
    of O'Brien and Tofsted does. That is the temperature of the black body whose Planck radiance
    equals what reaches the pixel: the attenuated radiance of a surface, and that of the air in
    front of it. With several frequencies the image is the mean of their brightness temperatures;
    the result file keeps each of them, and a picture shows up to six, each in a panel.

    Noise: none. It shows what there is to be seen, and serves to check numbers; detectors with
    noise are "passive-broadband" and "radiometer".

    Left out: a detector and its noise, the width of a band, throughput, side lobes and stray light.

    Validation: a slow float64 oracle that walks each ray by itself (tests/test_physics.py,
    tests/test_matrix.py).
    """

    name = "passive-spectral"
    contract = 1

    class Params(Parameters):
        """Parameters of the passive spectral imager."""

        frequency_ghz: FrequenciesGHz = parameter(help="frequency, or a list of them", unit="GHz")
        optics: Optics | None = parameter(None, help="blur; leave the table out for none")

    def needs(self, view: View) -> Needs:  # noqa: ARG002 (the contract's)
        """Returns the need for the radiance at the frequencies of the parameters."""
        ascending = sorted({*np.atleast_1d(self.params.frequency_ghz)})
        return Needs(frequency_hz=np.array(ascending) * 1e9, optics=self.params.optics)

    def observe(self, sight: Radiances, rng: np.random.Generator) -> Image:  # noqa: ARG002
        """Returns the brightness temperature in kelvin, averaged over the frequencies."""
        return Image(
            sight.brightness_temperature.mean(axis=0),
            unit="K",
            quantity="brightness temperature",
            caption="without noise",
            mean_over_frequencies=True,
        )


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [PassiveSpectral]
