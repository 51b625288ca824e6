"""The active imager: echoes of a transmitter, in decibels over the floor."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from thzcl.sensor import (
    Echoes,
    FrequencyGHz,
    Image,
    Layer,
    Needs,
    Optics,
    Parameters,
    Sensor,
    View,
    hookimpl,
    parameter,
)


class Active(Sensor):
    """An active imager with a narrow-band source and a dynamic range.

    It records P = P0 R T_out T_back: the power of the source, the reflectivity of what a pixel
    shows, and the transmission of the air on the way out and back, through the same turbulent air.
    Emission is left out: a milliwatt in one mode is as bright as a body of 1e18 K. What it shows is
    decibels over its floor, so many decibels below 1 mW (or `full_scale_w`) as its dynamic range
    says; pixels below it are at 0 dB, and flagged in `below_floor`. O'Brien and Tofsted, figures 8
    and 9.

    "monostatic": out and back through the same voxels, exp(-2 tau), pixel by pixel. "bistatic": out
    from `transmitter_m`, and what is not lit from there, or lies in shadow, sends nothing back.
    With `spreading = "lambert"` surfaces scatter evenly, and an aperture at distance r collects R
    cos A / (pi r^2). `speckle_looks` averages of coherent light scattered by rough surfaces leave a
    contrast of 1 / sqrt(looks).
    """

    name = "active"
    contract = 1

    class Params(Parameters):
        """Parameters of the active imager."""

        frequency_ghz: FrequencyGHz = parameter(help="frequency of the source", unit="GHz")
        source_power_w: float = parameter(
            1e-3, gt=0, unit="W", help="power of the source, on each pixel's spot"
        )
        dynamic_range_db: float = parameter(
            gt=0, le=300, unit="dB", help="from the largest power that it detects to the least"
        )
        full_scale_w: float = parameter(
            1e-3, gt=0, unit="W", help="the largest power that it detects"
        )
        arrangement: Literal["monostatic", "bistatic"] = parameter(
            "monostatic", help="where the source stands"
        )
        transmitter_m: tuple[float, float, float] | None = parameter(
            None, unit="m", help="place of a bistatic source [x, y, z]"
        )
        spreading: Literal["none", "lambert"] = parameter("none", help="of what surfaces reflect")
        aperture_m: float | None = parameter(
            None, gt=0, unit="m", help="diameter of the aperture, for spreading"
        )
        speckle_looks: float | None = parameter(
            None, gt=0, help="looks averaged; leave it out for no speckle"
        )
        optics: Optics | None = parameter(
            None, help="blur, once speckle is averaged; leave the table out for none"
        )

        def troubles(self) -> list[Any]:
            """Keys that belong together."""
            found = []
            if (self.arrangement == "bistatic") != (self.transmitter_m is not None):
                found.append(
                    self.trouble(
                        "transmitter_m", 'goes with arrangement = "bistatic", and that with it'
                    )
                )
            if self.spreading == "lambert" and self.aperture_m is None:
                found.append(self.trouble("spreading", '"lambert" needs aperture_m'))
            return found

    def needs(self, view: View) -> Needs:  # noqa: ARG002 (the contract's)
        """Echoes at one frequency, as far as the dynamic range reaches, and a little farther."""
        p = self.params
        return Needs(
            frequency_hz=[p.frequency_ghz * 1e9],
            reflection=True,
            transmitter_m=p.transmitter_m,
            cutoff_depth=self._range_db() * np.log(10) / 20 + 2,
            gain=p.spreading,
            optics=p.optics,
            noise=p.speckle_looks is not None,
        )

    def _range_db(self) -> float:
        """From the source's power to the floor."""
        p = self.params
        return float(
            max(p.dynamic_range_db + 10 * np.log10(p.source_power_w / p.full_scale_w), 0.0)
        )

    def observe(self, sight: Echoes, rng: np.random.Generator) -> Image:
        """Decibels over the floor, with the power in W."""
        p = self.params
        power = p.source_power_w * np.asarray(sight.returned[0], dtype=np.float64)
        if p.spreading == "lambert":  # what comes back to an area, of which the aperture has some
            power *= np.pi / 4 * p.aperture_m**2
        if p.speckle_looks is not None:
            power *= rng.gamma(p.speckle_looks, 1 / p.speckle_looks, power.shape)
        floor = p.full_scale_w * 10 ** (-p.dynamic_range_db / 10)
        below = power < floor
        return Image(
            10 * np.log10(np.maximum(power, floor) / floor),
            unit="dB",
            quantity="power over the floor",
            layers={
                "received_power": Layer(power, "W", "received power"),
                "below_floor": Layer(
                    below.astype(np.int8), "1", "whether the power is below the floor"
                ),
            },
            facts={
                "floor": (floor, "W"),
                "pixels below the floor": (100 * float(below.mean()), "%"),
            },
        )


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """The sensor of this file."""
    return [Active]
