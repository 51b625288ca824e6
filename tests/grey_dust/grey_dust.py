"""A third party's constituent: written against the public contract alone."""

from thzcl.constituent import Constituent, OpticalProperties, Parameters, hookimpl, parameter


class GreyDust(Constituent):
    """Dust that absorbs alike at all frequencies, and has the air's temperature.

    The absorption coefficient is per_km, whatever the air: dust does not follow humidity.

    Validity: particles far larger than the wavelength, which do not scatter.

    Validation: the depth of a path is per_km times its length (tests/test_constituents.py).
    """

    name = "dust"
    contract = 1
    varies = False

    class Params(Parameters):
        """Its keys."""

        per_km: float = parameter(0.5, ge=0, unit="1/km", help="absorption")

    def optics(self, frequency_hz, temperature_k, pressure_hpa, vapour_hpa):
        """The same absorption everywhere."""
        return OpticalProperties(absorption=self.params.per_km / 1e3)


@hookimpl
def register_constituents():
    """It."""
    return [GreyDust]
