"""The passive broadband imager, which records power in a band with the noise of its detector."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from thzcl.sensor import (
    FrequencyGHz,
    Image,
    Layer,
    Needs,
    Optics,
    Parameters,
    Radiances,
    Sensor,
    User,
    View,
    bands,
    hookimpl,
    parameter,
    radiometry,
)


class PassiveBroadband(Sensor):
    """A passive imager of one broad band, with the noise of its detector.

    It records the power that reaches each pixel's detector: the radiance, weighted by the band's
    response, times a throughput. A single-mode detector has the throughput lambda^2 and takes one
    polarisation. In the Rayleigh-Jeans limit it would receive P = k_B T dnu from a body of
    temperature T; Planck's law is used throughout. With `throughput = "geometric"` the throughput
    is the area of the aperture times the solid angle of a pixel, in both polarisations. The antenna
    temperature is the power divided by that from a body of 1 K in the Rayleigh-Jeans limit.

    Noise is Gaussian, of standard deviation NEP sqrt(B). B is the frame rate, as in O'Brien and
    Tofsted, if each pixel has a detector of its own, which integrates over a frame. With
    `noise_bandwidth = "scanned"` one detector scans all pixels, and B is the frame rate times their
    number.

    `quadrature = "resolved"` finds frequencies adaptively until the lines within the band are
    resolved, for every length of path in the scene. "paper" takes O'Brien and Tofsted's steps of 25
    GHz: `paper_steps` says whether as the mean over the band's edges and the steps between them, by
    the trapezoid rule, or at the middles of the steps. The error of the sum is reported.
    """

    name = "passive-broadband"
    contract = 1

    class Params(Parameters):
        """Parameters of the passive broadband imager."""

        used_by: ClassVar = {
            "paper_steps": User(("quadrature",), ("paper",)),
            "step_ghz": User(("quadrature",), ("paper",)),
            "aperture_m": User(("throughput",), ("geometric",)),
            "frame_rate_hz": User(("noise_equivalent_power_w_rthz",)),
            "noise_bandwidth": User(("noise_equivalent_power_w_rthz",)),
        }
        center_ghz: FrequencyGHz | None = parameter(None, unit="GHz", help="middle of the band")
        bandwidth_ghz: FrequencyGHz | None = parameter(
            None, unit="GHz", help="width of the band; of a Gaussian, at half maximum"
        )
        response: str = parameter(
            "flat",
            help='"flat", "gaussian", or a CSV file of frequency in GHz and response, '
            "which then gives the band",
        )
        quadrature: Literal["resolved", "paper"] = parameter(
            "resolved", help="how the band is summed"
        )
        paper_steps: Literal["edges", "trapezoid", "bins"] = parameter(
            "edges", help="reading of the paper's steps"
        )
        step_ghz: float = parameter(25.0, gt=0, unit="GHz", help="the paper's steps")
        throughput: Literal["single-mode", "geometric"] = parameter(
            "single-mode", help="what each pixel collects"
        )
        aperture_m: float | None = parameter(None, gt=0, unit="m", help="diameter of the aperture")
        noise_equivalent_power_w_rthz: float = parameter(
            0.0, ge=0, unit="W/sqrt(Hz)", help="detector's NEP; 0: no noise"
        )
        frame_rate_hz: float = parameter(1.0, gt=0, unit="Hz", help="images a second")
        noise_bandwidth: Literal["frame-rate", "scanned"] = parameter(
            "frame-rate", help="what the NEP is multiplied by"
        )
        optics: Optics | None = parameter(None, help="blur; leave the table out for none")

        def troubles(self) -> list[Any]:
            """Returns what is wrong with keys that belong together."""
            found = []
            if self.response in ("flat", "gaussian") and (
                self.center_ghz is None or self.bandwidth_ghz is None
            ):
                found.append(self.trouble("response", "needs center_ghz and bandwidth_ghz"))
            elif self.response not in ("flat", "gaussian") and (
                self.center_ghz or self.bandwidth_ghz
            ):
                found.append(
                    self.trouble("response", "gives the band; remove center_ghz and bandwidth_ghz")
                )
            if self.throughput == "geometric" and self.aperture_m is None:
                found.append(self.trouble("throughput", '"geometric" needs aperture_m'))
            return found

    def needs(self, view: View) -> Needs:
        """Returns the need for the sum over the band that makes up the power.

        Its frequencies follow from the lines in the band, or are the paper's steps.
        """
        p = self.params
        band = self._band(view)
        resolved, finer = (bands.resolve(band, view, view.tolerance * part) for part in (1, 1e-2))
        used = (
            resolved
            if p.quadrature == "resolved"
            else bands.paper(band, p.step_ghz * 1e9, p.paper_steps)
        )
        error = resolved.error if used is resolved else bands.error(used, resolved, view)
        return Needs(
            frequency_hz=used.frequency_hz,
            weights=used.weights * self._mode(used.frequency_hz),
            optics=p.optics,
            noise=p.noise_equivalent_power_w_rthz > 0,
            finer=(finer.frequency_hz, finer.weights * self._mode(finer.frequency_hz)),
            errors={"band-quadrature": (error, "of what the shortest path lets through")},
        )

    def _band(self, view: View) -> bands.Band:
        """Returns the band with its response."""
        p = self.params
        if p.response in ("flat", "gaussian"):
            return bands.named(p.response, p.center_ghz * 1e9, p.bandwidth_ghz * 1e9)
        return bands.tabulated(view.table(p.response), p.response)

    def _mode(self, frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the throughput at each frequency, m2 sr: lambda^2 / 2 for a single mode.

        It is 1 for a geometric throughput, which does not depend on frequency.
        """
        if self.params.throughput == "single-mode":
            return np.asarray((radiometry.LIGHT_SPEED / frequency_hz) ** 2 / 2)
        return np.ones(len(frequency_hz))

    def observe(self, sight: Radiances, rng: np.random.Generator) -> Image:
        """Returns the antenna temperature in K, with the power in W, both with noise."""
        p = self.params
        collected = self._collected(sight)
        power = collected.sum() * sight.radiance[0]
        sigma = p.noise_equivalent_power_w_rthz * np.sqrt(p.frame_rate_hz * self._shares(sight))
        if sigma > 0:
            power = power + sigma * rng.standard_normal(power.shape)
        per_kelvin = (
            collected * 2 * radiometry.BOLTZMANN * (sight.nodes_hz / radiometry.LIGHT_SPEED) ** 2
        ).sum()
        antenna = power / per_kelvin
        return Image(
            antenna,
            unit="K",
            quantity="antenna temperature",
            layers={
                "received_power": Layer(power, "W", "received power"),
                "antenna_temperature": Layer(antenna, "K", "antenna temperature"),
            },
            facts=self._facts(sight, collected, sigma),
        )

    def _collected(self, sight: Radiances) -> NDArray[np.float64]:
        """Returns the weights, m2 sr Hz, that turn radiance at each node into power."""
        area = 1.0
        if self.params.throughput == "geometric":
            area = np.pi / 4 * self.params.aperture_m**2 * sight.pixel_solid_angle
        return np.asarray(np.asarray(sight.weights)[0] * area)

    def _shares(self, sight: Radiances) -> int:
        """Returns the number of pixels that share one detector."""
        return sight.target.size if self.params.noise_bandwidth == "scanned" else 1

    def _facts(
        self, sight: Radiances, collected: NDArray[np.float64], sigma: float
    ) -> dict[str, tuple[float, str]]:
        """Returns the noise, and the temperature difference that equals it (NEDT), K.

        The latter is given at the sensor, and for the targets behind the air in front of them.
        """
        if sigma == 0:
            return {}
        slope = (collected * radiometry.planck_slope(sight.nodes_hz, sight.air_temperature_k)).sum()
        facts = {
            "noise power": (float(sigma), "W"),
            "NEDT at the sensor": (float(sigma / slope), "K"),
        }
        on_target = sight.target >= 2
        if on_target.any():
            passed = float(np.exp(-sight.optical_depth[0][on_target]).mean())
            facts["NEDT at the targets"] = (float(sigma / slope / max(passed, 1e-300)), "K")
        return facts


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [PassiveBroadband]
