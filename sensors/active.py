"""The active imager, which records the echoes of a transmitter in decibels over its floor."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from thzcl.sensor import (
    Decibels,
    Echoes,
    FrequencyGHz,
    Image,
    Layer,
    Needs,
    Optics,
    Parameters,
    Sensor,
    User,
    View,
    hookimpl,
    parameter,
)


class Active(Sensor):
    """An active imager with a narrow-band source and a dynamic range.

    It records P = P0 R T_out T_back: P0 is the power of the source, R the reflectivity of what a
    pixel shows, T_out and T_back the transmission of the turbulent air on the way out and back.
    Emission is left out, since a milliwatt in one mode is as bright as a body of 1e18 K. The image
    is in decibels over the floor, which lies `dynamic_range_db` below 1 mW (or `full_scale_w`).
    Pixels below the floor are at 0 dB, and flagged in `below_floor`. Such an imager made figures 8
    and 9 of O'Brien and Tofsted.

    If it is "monostatic", light goes out and back through the same voxels, so that each pixel is
    attenuated by exp(-2 tau). If it is "bistatic", light goes out from `transmitter_m`, and
    surfaces that face away from there or lie in shadow send nothing back. With
    `spreading = "lambert"` surfaces scatter evenly, and an aperture of area A at distance r
    collects R cos A / (pi r^2), cos being the cosine between ray and surface normal. Coherent light
    from rough surfaces makes speckle; an average of `speckle_looks` looks leaves a contrast of
    1 / sqrt(looks).
    """

    name = "active"
    contract = 1

    class Params(Parameters):
        """Parameters of the active imager."""

        used_by: ClassVar = {"aperture_m": User(("spreading",), ("lambert",))}
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
            """Returns what is wrong with keys that belong together."""
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
        """Returns the need for echoes at one frequency, to a little below the floor."""
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
        """Returns the range from the source's power down to the floor, dB."""
        p = self.params
        return float(
            max(p.dynamic_range_db + 10 * np.log10(p.source_power_w / p.full_scale_w), 0.0)
        )

    def observe(self, sight: Echoes, rng: np.random.Generator) -> Image:
        """Returns the image in decibels over the floor, with the received power in W."""
        p = self.params
        power = p.source_power_w * np.asarray(sight.returned[0], dtype=np.float64)
        if p.spreading == "lambert":  # `returned` is per area; the aperture has this one
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
            decibels=Decibels("received_power", floor),
        )


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [Active]
