"""No gas at all, for scenes without an atmosphere."""

from __future__ import annotations

from thzcl.constituent import Constituent, OpticalProperties, Parameters, hookimpl


class Nothing(Constituent):
    """No gas: it absorbs nothing, at any frequency and in any air.

    `model = "none"` shows what optics and sensor alone do. What else is in the air, as a table of
    [atmosphere] has it, still absorbs.

    Validity: everywhere; the air's temperature and humidity are kept, and mean nothing to light.

    Validation: a scene's contrast is that of its surfaces (tests/test_physics.py).
    """

    name = "none"
    contract = 1
    gas = True
    varies = False

    class Params(Parameters):
        """It has none."""

    def optics(
        self, frequency_hz: object, temperature_k: object, pressure_hpa: object, vapour_hpa: object
    ) -> OpticalProperties:
        """Returns an absorption of 0."""
        del frequency_hz, temperature_k, pressure_hpa, vapour_hpa
        return OpticalProperties(absorption=0.0, parts={"dry": 0.0, "vapour": 0.0})


@hookimpl
def register_constituents() -> list[type[Constituent]]:
    """Returns the constituent of this file."""
    return [Nothing]
