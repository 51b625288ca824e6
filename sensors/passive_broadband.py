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
    noise,
    parameter,
    radiometry,
)

_SOURCES = ("noise_equivalent_power_w_rthz", "netd_k", "photon_noise")  # that make noise
_OF_NOISE = ("integration_time_s", "modulation", "optical_efficiency", "optics_temperature_k")


class PassiveBroadband(Sensor):
    """A passive imager of one broad band, with the noise of its detector.

    It records the power that reaches each pixel's detector: the radiance, weighted by the band's
    response, times a throughput. A single-mode detector has the throughput lambda^2 and takes one
    polarisation. In the Rayleigh-Jeans limit it would receive P = k_B T dnu from a body of
    temperature T; Planck's law is used throughout. With `throughput = "geometric"` the throughput
    is the area of the aperture times the solid angle of a pixel, in both polarisations. The antenna
    temperature is the power divided by that from a body of 1 K in the Rayleigh-Jeans limit.

    Noise: white and Gaussian, of standard deviation NEP sqrt(B). B is 1 / (2 t) where the detector
    integrates over a time t: `integration_time_s`, or the dwell of the scan around it. Without
    either, or with `noise_bandwidth = "frame-rate"`, B is the frame rate, as in O'Brien and
    Tofsted; "scanned" is the frame rate times the number of pixels. The NEP is that of absorbed
    power, of which the optics pass `optical_efficiency`, and all noise is divided by this: the
    received power is what the aperture collects. A published optical NEP is therefore entered with
    an efficiency of 1. `photon_noise` adds, in quadrature, what photons of the scene and of warm
    optics bring, bunching included (Zmuidzinas 2003, Appl. Opt. 42, 4989); the scene is taken as
    black at each pixel's brightness temperature in the band, which is exact without air. A NEP
    measured under load holds its photon noise already. `modulation = "chopped"` is a square wave
    and a lock-in amplifier: all noise times pi / sqrt(2). In place of all these, `netd_k` says the
    whole noise of one pixel within `netd_time_s` before a scene of `netd_temperature_k`.

    Left out: 1/f noise and drift, noise in common to pixels, saturation, the offset of what the
    optics emit, side lobes and stray light.

    Geometric throughput falls as the fourth power of the cosine towards the corners of the field; a
    warning says where a pixel collects less than one mode.

    `quadrature = "resolved"` finds frequencies adaptively until the lines within the band are
    resolved, for every length of path in the scene. "paper" takes O'Brien and Tofsted's steps of 25
    GHz: `paper_steps` says whether as the mean over the band's edges and the steps between them, by
    the trapezoid rule, or at the middles of the steps. The error of the sum is reported.

    Validation: noise of every reading over a million pixels, to 1 % in variance, and photon noise
    to 0.5 % (tests/test_noise.py); walls of 77 to 1000 K to 1e-6 (tests/test_broadband.py); one
    cooled and two uncooled detectors that exist are met to 0.35 to 0.85 of what their makers report
    (scenarios/IMAGERS.md).
    """

    name = "passive-broadband"
    contract = 1

    class Params(Parameters):
        """Parameters of the passive broadband imager."""

        used_by: ClassVar = {
            "paper_steps": User(("quadrature",), ("paper",)),
            "step_ghz": User(("quadrature",), ("paper",)),
            "aperture_m": User(("throughput",), ("geometric",)),
            **dict.fromkeys(("frame_rate_hz", "noise_bandwidth"), User(_SOURCES)),
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
        step_ghz: float = parameter(25.0, gt=0, le=1e3, unit="GHz", help="the paper's steps")
        throughput: Literal["single-mode", "geometric"] = parameter(
            "single-mode", help="what each pixel collects"
        )
        aperture_m: float | None = parameter(
            None, gt=0, le=1e3, unit="m", help="diameter of the aperture"
        )
        noise_equivalent_power_w_rthz: float = parameter(
            0.0, ge=0, le=1.0, unit="W/sqrt(Hz)", help="detector's NEP, of absorbed power; 0: none"
        )
        netd_k: float | None = parameter(
            None,
            gt=0,
            le=1e6,
            unit="K",
            help="noise-equivalent temperature difference, in place of a NEP",
        )
        netd_time_s: float | None = parameter(
            None, gt=0, le=1e6, unit="s", help="time of one pixel within which netd_k was measured"
        )
        netd_temperature_k: float = parameter(
            300.0,
            gt=0,
            le=1e4,
            unit="K",
            help="temperature of the scene before which it was measured",
        )
        integration_time_s: float | None = parameter(
            None,
            gt=0,
            le=1e6,
            unit="s",
            help="time on a pixel; by default a scan's dwell",
        )
        frame_rate_hz: float = parameter(1.0, gt=0, le=1e9, unit="Hz", help="images a second")
        noise_bandwidth: Literal["integration", "frame-rate", "scanned"] | None = parameter(
            None,
            help="1/(2 t), the frame rate, or that times the number of pixels; by default the "
            "first where a time is known, else the second",
        )
        optical_efficiency: float = parameter(
            1.0, gt=0, le=1, help="part of the collected power that the detector absorbs"
        )
        optics_temperature_k: float | None = parameter(
            None,
            ge=0,
            le=1e4,
            unit="K",
            help="temperature of what absorbs the rest; none: it emits nothing",
        )
        photon_noise: bool = parameter(False, help="add the noise of photons, bunching included")
        modulation: Literal["none", "chopped"] = parameter(
            "none", help="chopped: a square wave, with a lock-in amplifier"
        )
        optics: Optics | None = parameter(None, help="blur; leave the table out for none")

        @property
        def noisy(self) -> bool:
            """Whether the detector has noise."""
            given = self.netd_k is not None or self.noise_equivalent_power_w_rthz > 0
            return given or self.photon_noise

        def troubles(self) -> list[Any]:
            """Returns what is wrong with keys that belong together."""
            return [*self._band_troubles(), *self._noise_troubles(), *self._time_troubles()]

        def _noise_troubles(self) -> list[Any]:
            """Returns what is wrong with the keys that say how large the noise is."""
            given, found = self.model_fields_set, []
            if self.netd_k is not None:
                held = [
                    *("noise_equivalent_power_w_rthz", "photon_noise", "optical_efficiency"),
                    *("optics_temperature_k", "modulation"),
                ]
                found += [
                    self.trouble(name, "is part of netd_k, which is the whole noise; remove one")
                    for name in held
                    if name in given
                ]
            elif {"netd_time_s", "netd_temperature_k"} & given:
                found.append(self.trouble("netd_k", "missing; netd_time_s goes with it"))
            if self.netd_k is not None and self.netd_time_s is None and not found:
                found.append(self.trouble("netd_time_s", "missing; netd_k was measured within it"))
            if self.optics_temperature_k is not None and self.optical_efficiency == 1:
                text = "needs an optical_efficiency below 1: what absorbs nothing emits nothing"
                found.append(self.trouble("optics_temperature_k", text))
            idle = given & set(_OF_NOISE)
            if not set(_SOURCES) & given and idle:
                text = "is a matter of noise, but there is none: give a NEP, netd_k or photon_noise"
                found += [self.trouble(name, text) for name in sorted(idle)[:1]]
            elif self.optics_temperature_k is not None and not self.photon_noise:
                text = "is seen in the noise alone: set photon_noise = true, or remove it"
                found.append(self.trouble("optics_temperature_k", text))
            return found

        def _time_troubles(self) -> list[Any]:
            """Returns what is wrong with the keys that say how long a pixel integrates."""
            if self.integration_time_s is None:
                return []
            if self.noise_bandwidth in ("frame-rate", "scanned"):
                text = f'has no effect with noise_bandwidth = "{self.noise_bandwidth}"; remove one'
                return [self.trouble("integration_time_s", text)]
            rate = self.frame_rate_hz
            if "frame_rate_hz" in self.model_fields_set and self.integration_time_s * rate > 1:
                text = f"is longer than a frame at {rate:g} Hz; shorten one"
                return [self.trouble("integration_time_s", text)]
            return []

        def _band_troubles(self) -> list[Any]:
            """Returns what is wrong with the keys of band and throughput."""
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
        response = band.response(used.frequency_hz)
        width_hz = np.divide(
            used.weights, response, out=np.zeros_like(response), where=response > 0
        )
        return Needs(
            frequency_hz=used.frequency_hz,
            weights=used.weights * self._mode(used.frequency_hz),
            optics=p.optics,
            noise=p.noisy,
            integration_time_s=self._time_s(view) if p.noisy else None,
            passband=(width_hz, response / band.peak),
            bounds_hz=[[band.low_hz, band.high_hz]],
            notes=self._notes(view, (band.low_hz + band.high_hz) / 2),
            finer=(finer.frequency_hz, finer.weights * self._mode(finer.frequency_hz)),
            errors={"band-quadrature": (error, "of what the shortest path lets through")},
        )

    def _time_s(self, view: View) -> float | None:
        """Returns how long a pixel integrates, s, or None where the frame rate is read as that.

        Raises ValueError if the scan and the parameters do not fit together.
        """
        p = self.params
        time_s = noise.pixel_time_s(p.integration_time_s, view.dwell_s)
        if p.noise_bandwidth == "integration" and time_s is None:
            raise ValueError(
                'noise_bandwidth: "integration" needs integration_time_s, or a scan with its dwell'
            )
        if p.noise_bandwidth in ("frame-rate", "scanned"):
            return None
        unclear = view.dwell_s is not None and p.noise_bandwidth is None
        if unclear and "frame_rate_hz" in p.model_fields_set:
            raise ValueError(
                f"frame_rate_hz: the scan stays {view.dwell_s:g} s on a pixel; remove "
                'frame_rate_hz, or say with noise_bandwidth ("integration", "frame-rate" or '
                '"scanned") which of the two sets the noise'
            )
        return time_s

    def _notes(self, view: View, middle_hz: float) -> tuple[str, ...]:
        """Returns a warning where a geometric throughput is less than one mode."""
        p = self.params
        if p.throughput != "geometric":
            return ()
        across, down = view.pixel_angle_rad
        wavelength_m = radiometry.LIGHT_SPEED / middle_hz
        modes = np.pi / 4 * p.aperture_m**2 * across * down / wavelength_m**2
        if modes >= 1:
            return ()
        text = (
            f"a pixel collects {modes:.3g} lambda^2, which is less than one mode: no detector "
            'couples to that without loss; throughput = "single-mode", larger pixels or a larger '
            "aperture_m mend it"
        )
        return (text,)

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
        field = sight.off_axis_cosine**4 if p.throughput == "geometric" else 1.0
        power = collected.sum() * sight.radiance[0] * field
        facts = {}
        if p.noisy:
            sigma = self._sigma(sight, collected, field)
            power = power + sigma * rng.standard_normal(power.shape)
            facts = self._facts(sight, collected, sigma, field)
        per_kelvin = (
            field
            * (
                collected
                * 2
                * radiometry.BOLTZMANN
                * (sight.nodes_hz / radiometry.LIGHT_SPEED) ** 2
            ).sum()
        )
        antenna = power / per_kelvin
        return Image(
            antenna,
            unit="K",
            quantity="antenna temperature",
            layers={
                "received_power": Layer(power, "W", "received power"),
                "antenna_temperature": Layer(antenna, "K", "antenna temperature"),
            },
            facts=facts,
            caption="" if p.noisy else "without noise",
        )

    def _collected(self, sight: Radiances) -> NDArray[np.float64]:
        """Returns the weights, m2 sr Hz, that turn radiance at each node into central power."""
        area = 1.0
        if self.params.throughput == "geometric":
            area = np.pi / 4 * self.params.aperture_m**2 * sight.pixel_solid_angle
        return np.asarray(np.asarray(sight.weights)[0] * area)

    def _sigma(self, sight: Radiances, collected: NDArray[np.float64], field: Any) -> Any:
        """Returns the standard deviation of the received power's noise, W, by pixel or for all."""
        p = self.params
        if p.netd_k is not None:
            slope = radiometry.planck_slope(sight.nodes_hz, p.netd_temperature_k)
            return p.netd_k * (collected @ slope) * np.sqrt(p.netd_time_s / self._pixel_s(sight))
        square: Any = p.noise_equivalent_power_w_rthz**2
        if p.photon_noise:
            square = square + field * self._photons(sight)
        chopped = noise.CHOPPED if p.modulation == "chopped" else 1.0
        return chopped * np.sqrt(square * self._bandwidth_hz(sight)) / p.optical_efficiency

    def _photons(self, sight: Radiances) -> NDArray[np.float64]:
        """Returns the square of the photon noise in the middle of the field, W^2/Hz, (y, x)."""
        p, hz = self.params, sight.nodes_hz
        modes = np.ones(len(hz))
        if p.throughput == "geometric":
            area = np.pi / 4 * p.aperture_m**2 * sight.pixel_solid_angle
            modes = 2 * area * (hz / radiometry.LIGHT_SPEED) ** 2
        assert sight.passband is not None  # noqa: S101 (needs() asked for it)
        width_hz, response = sight.passband
        return noise.photon_nep_squared(
            sight.brightness_temperature[0],
            hz,
            width_hz,
            modes,
            response,
            p.optical_efficiency,
            p.optics_temperature_k,
        )

    def _bandwidth_hz(self, sight: Radiances) -> float:
        """Returns the bandwidth that the NEP is multiplied by, Hz."""
        if sight.integration_time_s is not None:
            return noise.integrator_hz(sight.integration_time_s)
        return 1 / self._pixel_s(sight)

    def _pixel_s(self, sight: Radiances) -> float:
        """Returns the time of one pixel, s: a frame's where it is not said otherwise."""
        if sight.integration_time_s is not None:
            return sight.integration_time_s
        pixels = sight.target.size if self.params.noise_bandwidth == "scanned" else 1
        return float(1 / (self.params.frame_rate_hz * pixels))

    def _facts(
        self, sight: Radiances, collected: NDArray[np.float64], sigma: Any, field: Any
    ) -> dict[str, tuple[float, str]]:
        """Returns the noise, its bandwidth, and the temperature difference that equals it (NEDT).

        Where noise varies from pixel to pixel, they are root mean squares.
        """
        slope = (collected * radiometry.planck_slope(sight.nodes_hz, sight.air_temperature_k)).sum()
        told = {
            "noise power": (float(np.sqrt(np.mean(np.square(sigma)))), "W"),
            "noise bandwidth": (self._bandwidth_hz(sight), "Hz"),
        }
        if sight.integration_time_s is not None:
            told["integration time"] = (sight.integration_time_s, "s")
        kelvin = float(np.sqrt(np.mean(np.square(sigma / (slope * field)))))
        return told | noise.facts(sight, kelvin)


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [PassiveBroadband]
