"""A third party's sensors: written against the public contract alone."""

import numpy as np

from thzcl.sensor import FrequencyGHz, Image, Layer, Needs, Parameters, Sensor, hookimpl, parameter


class Dicke(Sensor):
    """A radiometer that compares the scene with a reference load.

    It records half the difference of the two, with the noise of both.
    """

    name = "dicke"
    contract = 1

    class Params(Parameters):
        """Its keys."""

        frequency_ghz: FrequencyGHz = parameter(help="centre frequency", unit="GHz")
        reference_k: float = parameter(gt=0, help="temperature of the load", unit="K")
        noise_k: float = parameter(0.0, ge=0, help="standard deviation of the noise", unit="K")

    def needs(self, view):
        """One frequency."""
        return Needs(frequency_hz=[self.params.frequency_ghz * 1e9], noise=self.params.noise_k > 0)

    def observe(self, sight, rng):
        """Half of scene less load."""
        kelvin = (sight.brightness_temperature[0] - self.params.reference_k) / 2
        noise = self.params.noise_k * rng.standard_normal(kelvin.shape)
        layers = {"noise": Layer(noise, "K", "noise of scene and load")}
        return Image(kelvin + noise, unit="K", quantity="half of scene less load", layers=layers)


class TwoBands(Sensor):
    """The ratio of two bands."""

    name = "two-bands"
    contract = 1

    class Params(Parameters):
        """Its keys."""

    def needs(self, view):
        """Sums over frequency; no spectrum."""
        weights = np.repeat(np.eye(2), 5, axis=1)
        return Needs(
            frequency_hz=np.concatenate([np.linspace(340, 360, 5), np.linspace(640, 660, 5)]) * 1e9,
            weights=weights,
        )

    def observe(self, sight, rng):
        """Transmissions' ratio."""
        return Image(
            np.exp(sight.optical_depth[0] - sight.optical_depth[1]),
            unit="1",
            quantity="ratio of transmissions",
        )


@hookimpl
def register_sensors():
    """Both."""
    return [Dicke, TwoBands]
