"""The heterodyne radiometer, whose noise follows from its system temperature."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from thzcl.sensor import (
    FrequencyGHz,
    Image,
    Needs,
    Optics,
    Parameters,
    Radiances,
    Sensor,
    View,
    bands,
    hookimpl,
    noise,
    parameter,
    radiometry,
)


class Radiometer(Sensor):
    """A heterodyne radiometer, usually one receiver that is scanned over the scene.

    A local oscillator at `frequency_ghz` mixes the scene down to a band of `if_bandwidth_ghz`
    around `if_center_ghz`. With `sideband = "double"` both bands, below and above the oscillator,
    are received alike; with "single" only the one above. One mode and one polarisation are
    received. The image is the brightness temperature of what is received, as it reads after
    calibration with two black loads: the temperature whose Planck mean over the band is the
    radiance seen.

    Noise: white and Gaussian. A total-power radiometer has T_sys sqrt(1 / (B t) + (dG/G)^2); one
    that switches between scene and a reference load ("dicke") has
    sqrt((2 T_sys)^2 / (B t) + (dG/G)^2 (T_A - T_ref)^2) (Dicke 1946, Rev. Sci. Instrum. 17, 268).
    B is the intermediate-frequency band, t `integration_time_s` or the dwell of the scan around the
    sensor, and dG/G `gain_drift`, the gain's relative change between calibrations. T_sys is
    T_rec + T_A for two sidebands, and 2 T_rec + T_A for one; T_rec is the double-sideband receiver
    temperature in both, T_A the brightness temperature of each pixel.

    Left out: the drift's correlation from pixel to pixel, noise of the loads, standing waves, an
    unequal balance of the sidebands, losses before the receiver (enter T_rec as it is seen from the
    aperture).

    Validation: the equation to 1 % over a million pixels in each mode (tests/test_noise.py); three
    receivers that exist are met to 0.37 to 1.33 of what their makers report
    (scenarios/IMAGERS.md).
    """

    name = "radiometer"
    contract = 1

    class Params(Parameters):
        """Parameters of the radiometer."""

        frequency_ghz: FrequencyGHz = parameter(
            help="frequency of the local oscillator", unit="GHz"
        )
        if_center_ghz: float = parameter(
            gt=0, le=1e3, unit="GHz", help="middle of the intermediate-frequency band"
        )
        if_bandwidth_ghz: float = parameter(
            gt=0, le=1e3, unit="GHz", help="width of the intermediate-frequency band"
        )
        receiver_temperature_k: float = parameter(
            ge=0, le=1e8, unit="K", help="double-sideband receiver temperature"
        )
        sideband: Literal["double", "single"] = parameter(
            "double", help="whether both sidebands hold the signal, or the upper one alone"
        )
        integration_time_s: float | None = parameter(
            None,
            gt=0,
            le=1e6,
            unit="s",
            help="time on a pixel; by default a scan's dwell",
        )
        gain_drift: float = parameter(
            0.0, ge=0, lt=1, help="relative change of the gain between calibrations, rms"
        )
        switching: Literal["total-power", "dicke"] = parameter(
            "total-power", help="whether it switches between scene and a reference load"
        )
        reference_temperature_k: float | None = parameter(
            None,
            ge=0,
            le=1e4,
            unit="K",
            help="temperature of the reference load; by default the air's",
        )
        optics: Optics | None = parameter(None, help="blur; leave the table out for none")

        def troubles(self) -> list[Any]:
            """Returns what is wrong with keys that belong together."""
            found = []
            if self.if_center_ghz < self.if_bandwidth_ghz / 2:
                text = "reaches below 0 GHz: raise if_center_ghz, or lower it"
                found.append(self.trouble("if_bandwidth_ghz", text))
            elif self.frequency_ghz <= self.if_center_ghz + self.if_bandwidth_ghz / 2:
                text = "must lie above the intermediate-frequency band"
                found.append(self.trouble("frequency_ghz", text))
            if self.reference_temperature_k is not None and self.switching != "dicke":
                text = 'goes with switching = "dicke"; remove it'
                found.append(self.trouble("reference_temperature_k", text))
            return found

    def needs(self, view: View) -> Needs:
        """Returns the need for the sums over one or both sidebands, as one band.

        Raises ValueError if nothing says how long a pixel is taken.
        """
        p = self.params
        time_s = noise.pixel_time_s(p.integration_time_s, view.dwell_s)
        if time_s is None:
            raise ValueError("integration_time_s: missing; give it, or scan with [sensor.detector]")
        resolved, finer = (self._summed(view, view.tolerance * part) for part in (1, 1e-2))
        return Needs(
            frequency_hz=resolved.frequency_hz,
            weights=resolved.weights * _mode(resolved.frequency_hz),
            optics=p.optics,
            noise=True,
            bounds_hz=[self._bounds_hz()],
            finer=(finer.frequency_hz, finer.weights * _mode(finer.frequency_hz)),
            errors={"band-quadrature": (resolved.error, "of what the shortest path lets through")},
            integration_time_s=time_s,
        )

    def _centers_ghz(self) -> list[float]:
        """Returns the middles of the sidebands, GHz."""
        p, sides = self.params, (-1, 1) if self.params.sideband == "double" else (1,)
        return [p.frequency_ghz + side * p.if_center_ghz for side in sides]

    def _bounds_hz(self) -> tuple[float, float]:
        """Returns the lowest and the highest frequency that is received, Hz."""
        half, centers = self.params.if_bandwidth_ghz / 2, self._centers_ghz()
        return (centers[0] - half) * 1e9, (centers[-1] + half) * 1e9

    def _summed(self, view: View, tolerance: float) -> bands.Quadrature:
        """Returns the rule that sums over the sidebands."""
        width_hz = self.params.if_bandwidth_ghz * 1e9
        rules = [
            bands.resolve(bands.named("flat", center * 1e9, width_hz), view, tolerance)
            for center in self._centers_ghz()
        ]
        return bands.Quadrature(
            np.concatenate([rule.frequency_hz for rule in rules]),
            np.concatenate([rule.weights for rule in rules]),
            max(rule.error for rule in rules),
        )

    def observe(self, sight: Radiances, rng: np.random.Generator) -> Image:
        """Returns the brightness temperature in K, with noise."""
        p, kelvin = self.params, sight.brightness_temperature[0]
        system = noise.system_k(p.receiver_temperature_k, kelvin, p.sideband)
        unbalance = None
        if p.switching == "dicke":
            reference = p.reference_temperature_k
            unbalance = kelvin - (sight.air_temperature_k if reference is None else reference)
        time_s = sight.integration_time_s
        assert time_s is not None  # noqa: S101 (needs() says it)
        sigma = noise.radiometer_k(
            system, p.if_bandwidth_ghz * 1e9, time_s, p.gain_drift, unbalance
        )
        return Image(
            kelvin + sigma * rng.standard_normal(kelvin.shape),
            unit="K",
            quantity="brightness temperature",
            facts={
                "system temperature": (float(np.mean(system)), "K"),
                "integration time": (time_s, "s"),
                **noise.facts(sight, float(np.sqrt(np.mean(sigma**2)))),
            },
        )


def _mode(frequency_hz: Any) -> Any:
    """Returns the throughput of one mode in one polarisation, lambda^2 / 2, m2 sr."""
    return (radiometry.LIGHT_SPEED / frequency_hz) ** 2 / 2


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [Radiometer]
