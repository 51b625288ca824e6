"""The active imager, which records the echoes of a transmitter in decibels over its floor."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from thzcl.sensor import (
    Decibels,
    Echoes,
    FrequencyGHz,
    Image,
    Layer,
    Needs,
    Optics,
    Parameters,
    PathReturn,
    Sensor,
    User,
    View,
    hookimpl,
    noise,
    parameter,
    speckle,
)

Array = NDArray[np.float64]
_FIRST_TARGET = 2  # the flag of the first target in what pixels show
_RECEIVERS = ("noise_equivalent_power_w_rthz", "noise_figure_db")


class Active(Sensor):
    """An active imager with a narrow-band source and a dynamic range.

    It records P = P0 R T_out T_back: P0 is the power of the source, R the reflectivity of what a
    pixel shows, T_out and T_back the transmission of the turbulent air on the way out and back.
    Emission is left out, since a milliwatt in one mode is as bright as a body of 1e18 K. The image
    is in decibels over the floor, which lies `dynamic_range_db` below 1 mW (or `full_scale_w`).
    Pixels below the floor are at 0 dB, and flagged in `below_floor`. Such an imager made figures 8
    and 9 of O'Brien and Tofsted; theirs has neither noise nor speckle, and nor has this one unless
    they are asked for.

    If it is "monostatic", light goes out and back through the same voxels, so that each pixel is
    attenuated by exp(-2 tau). If it is "bistatic", light goes out from `transmitter_m`, and
    surfaces that face away from there or lie in shadow send nothing back. With
    `spreading = "lambert"` surfaces scatter evenly, and an aperture of area A at distance r
    collects R cos A / (pi r^2), cos being the cosine between ray and surface normal.

    Speckle: coherent light from rough surfaces has a contrast of 1 / sqrt(looks). Its grain is that
    of the aperture in [sensor.optics] (Goodman, Speckle Phenomena in Optics, 2007). With
    `illumination = "flood"` the aperture only receives, and powers an angle a apart correlate as
    (2 J1(x) / x)^2, x = pi D a / lambda. With "beam" one scanned beam lights and receives: the mean
    power is blurred by the fourth power of its amplitude, and the grain is finer. Speckle is drawn
    finely and averaged over the area of each pixel, unless `pixel = false`; the mean power counts
    as even within a pixel. Where that takes more than 2^25 samples, each pixel has a gamma law of
    its own. `looks` are averaged; `looks_from` says what makes them independent: time only where
    something moves, frequency only in steps of c / (2 depth) and more, polarization at most two.
    Without an aperture there is no grain, and `speckle_looks` is white from pixel to pixel.

    Noise: a receiver's `noise_equivalent_power_w_rthz` adds Gaussian noise of NEP sqrt(B) to the
    power. `noise_figure_db` adds circular Gaussian noise of k 290 K F B to the field s, so that
    |s + n|^2 is detected, look by look. B is `bandwidth_hz`, or 1 / (2 t) of `integration_time_s`
    or of the scan's dwell. With a noise figure, bandwidth and time together make B t samples of the
    noise, which are averaged. The layers `noise_power` and `snr` hold NEP sqrt(B) or k 290 K F B,
    and the ratio of the mean signal to it, without speckle.

    Rain, fog and snow: in front of a beam they send light back, which is part of power, speckle and
    ratios, and which the layer `path_return` tells. The beam is Gauss' of one mode, of the area A
    of one aperture (`aperture_m` here or in [sensor.optics]), focused at f = `focus_m`, which is
    the distance of the point that the camera looks at unless it is given. Over the power sent,
    there comes back the integral of beta G exp(-2 tau) along the ray, beta being the back-scatter,
    G = A / (r^2 + (A / lambda)^2 (1 - r / f)^2), and tau growing evenly to what it is where the ray
    ends. With `gate_m = [near, far]` only ranges from `near` before to `far` behind what a pixel
    shows are received, and where it shows nothing, from there about the focus. With
    `spreading = "none"`, which has no aperture, the echo of the air is that of a surface at the
    focus that would be as bright: pi f^2 / A times as much. Mean powers add. Under speckle the
    fields of drops and surfaces add within each look, as they do in looks of less than some 0.04
    ms, in which drops hardly move by a wavelength; slower looks average over the drops, and vary
    less. The light is scattered once, and of drops that are spheres: that of real flakes can be
    larger by orders of magnitude. A floodlight, or a transmitter elsewhere, lights the drops in a
    way that this formula does not hold for: with `illumination = "flood"` their echo is left out,
    and a note says so.

    Left out: phase noise and leakage of the source, clutter outside the beam, motion within a look,
    the receiver's own drift.

    Validation: echoes by closed forms (tests/test_active.py); contrast, gamma law, correlation and
    looks of a pixel against Goodman's integrals (tests/test_speckle.py); noise with every other
    feature against the oracle (tests/test_matrix.py). No active imager with all of power, noise,
    time and a measured ratio of signal to noise was found to compare with (scenarios/IMAGERS.md).
    """

    name = "active"
    contract = 1

    class Params(Parameters):
        """Parameters of the active imager."""

        at_most_one = (_RECEIVERS, ("speckle_looks", "looks"))
        used_by: ClassVar = {"aperture_m": User(("spreading", "illumination"), ("lambert", "beam"))}

        frequency_ghz: FrequencyGHz = parameter(help="frequency of the source", unit="GHz")
        source_power_w: float = parameter(
            1e-3, gt=0, le=1e9, unit="W", help="power of the source, on each pixel's spot"
        )
        dynamic_range_db: float = parameter(
            gt=0, le=300, unit="dB", help="from the largest power that it detects to the least"
        )
        full_scale_w: float = parameter(
            1e-3, gt=0, le=1e9, unit="W", help="the largest power that it detects"
        )
        arrangement: Literal["monostatic", "bistatic"] = parameter(
            "monostatic", help="where the source stands"
        )
        transmitter_m: tuple[float, float, float] | None = parameter(
            None, unit="m", help="place of a bistatic source [x, y, z]"
        )
        spreading: Literal["none", "lambert"] = parameter("none", help="of what surfaces reflect")
        aperture_m: float | None = parameter(
            None, gt=0, le=1e3, unit="m", help="diameter of the aperture, for spreading and a beam"
        )
        speckle_looks: float | None = parameter(
            None,
            ge=1,
            le=1e9,
            help="looks averaged, white where [sensor.optics] has no aperture; none: no speckle",
        )
        looks: int | None = parameter(
            None,
            ge=1,
            le=10_000,
            help="looks averaged, with the grain of [sensor.optics]; none: no speckle",
        )
        looks_from: Literal["time", "frequency", "polarization"] = parameter(
            "time", help="what makes looks independent"
        )
        illumination: Literal["flood", "beam"] = parameter(
            "flood", help="whether the whole scene is lit, or each pixel by the receiving beam"
        )
        focus_m: float | None = parameter(
            None,
            gt=0,
            le=1e6,
            unit="m",
            help="focus of the beam, for the echo of rain, fog and snow; by default look_at_m",
        )
        gate_m: tuple[float, float] | None = parameter(
            None,
            unit="m",
            help="ranges received [near, far], from what a pixel shows on (negative: before it)",
        )
        noise_equivalent_power_w_rthz: float | None = parameter(
            None,
            gt=0,
            le=1.0,
            unit="W/sqrt(Hz)",
            help="the receiver's NEP; none: no noise of power",
        )
        noise_figure_db: float | None = parameter(
            None, ge=0, le=100, unit="dB", help="the receiver's; none: no noise of the field"
        )
        bandwidth_hz: float | None = parameter(
            None, gt=0, le=1e12, unit="Hz", help="the receiver's; by default 1/(2 t)"
        )
        integration_time_s: float | None = parameter(
            None,
            gt=0,
            le=1e6,
            unit="s",
            help="time on a pixel; by default a scan's dwell",
        )
        optics: Optics | None = parameter(
            None, help="blur, and the grain of speckle; leave the table out for none"
        )

        @property
        def receiver(self) -> str | None:
            """Which key says how noisy the receiver is, or None."""
            return next((name for name in _RECEIVERS if getattr(self, name) is not None), None)

        @property
        def grained(self) -> bool:
            """Whether speckle has the grain of an aperture."""
            asked = self.looks is not None or self.speckle_looks is not None
            return asked and self.optics is not None and self.optics.aperture_m is not None

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
            others = self._beam_troubles(), self._speckle_troubles(), self._receiver_troubles()
            return found + [one for some in others for one in some]

        @property
        def beam_aperture_m(self) -> float | None:
            """The diameter of the aperture of the beam that lights and receives, or None."""
            if self.illumination != "beam":
                return None
            blurring = None if self.optics is None else self.optics.aperture_m
            width_m: float | None = self.aperture_m if blurring is None else blurring
            return width_m

        def _beam_troubles(self) -> list[Any]:
            """Returns what is wrong with the keys of a beam."""
            found = []
            if self.illumination != "beam":
                text = 'is that of illumination = "beam"; a floodlight has none'
                given = [name for name in ("focus_m", "gate_m") if getattr(self, name) is not None]
                return [self.trouble(name, text) for name in given]
            if self.beam_aperture_m is None:
                text = '"beam" needs an aperture_m, here or in [sensor.optics]'
                found.append(self.trouble("illumination", text))
            elif self.arrangement == "bistatic":
                text = '"beam" lights and receives from one place; a bistatic source is a "flood"'
                found.append(self.trouble("illumination", text))
            if self.aperture_m not in (None, self.beam_aperture_m):
                text = (
                    f"is {self.aperture_m:g} m, but optics.aperture_m {self.beam_aperture_m:g} m; "
                    "a beam has one aperture"
                )
                found.append(self.trouble("aperture_m", text))
            if self.gate_m is not None and not self.gate_m[0] < 0 <= self.gate_m[1]:
                text = "begins before what a pixel shows, near < 0, and ends there or behind"
                found.append(self.trouble("gate_m", f"{text}, far >= 0"))
            return found

        def _speckle_troubles(self) -> list[Any]:
            """Returns what is wrong with the keys of light and speckle."""
            found, given = [], self.model_fields_set
            aperture = None if self.optics is None else self.optics.aperture_m
            if self.looks is not None and aperture is None:
                text = "needs an aperture_m in [sensor.optics]; white speckle has speckle_looks"
                found.append(self.trouble("looks", text))
            if "looks_from" in given and self.looks is None:
                found.append(self.trouble("looks_from", "goes with looks; remove it"))
            elif self.looks_from == "polarization" and (self.looks or 1) > 2:
                found.append(self.trouble("looks", "polarization makes at most 2"))
            whole = self.speckle_looks is None or self.speckle_looks == int(self.speckle_looks)
            if not whole and (self.grained or self.noise_figure_db is not None):
                text = "must be whole where they have a grain, or a noise figure acts on each"
                found.append(self.trouble("speckle_looks", text))
            return found

        def _receiver_troubles(self) -> list[Any]:
            """Returns what is wrong with the keys of the receiver."""
            idle = [n for n in ("bandwidth_hz", "integration_time_s") if n in self.model_fields_set]
            if self.receiver is None and idle:
                text = f"is a matter of noise, but there is none: give {' or '.join(_RECEIVERS)}"
                return [self.trouble(idle[0], text)]
            if self.noise_equivalent_power_w_rthz is not None and len(idle) == 2:
                text = "is 1/(2 t) of integration_time_s; remove one"
                return [self.trouble("bandwidth_hz", text)]
            return []

    def needs(self, view: View) -> Needs:
        """Returns the need for echoes at one frequency, to a little below the floor.

        Raises ValueError if nothing says how wide the receiver's band is.
        """
        p = self.params
        time_s = None
        if p.receiver is not None:
            time_s = noise.pixel_time_s(p.integration_time_s, view.dwell_s)
            if p.bandwidth_hz is None and time_s is None:
                raise ValueError(
                    "bandwidth_hz: missing; give it or integration_time_s, or scan with "
                    "[sensor.detector]"
                )
        return Needs(
            frequency_hz=[p.frequency_ghz * 1e9],
            reflection=True,
            transmitter_m=p.transmitter_m,
            cutoff_depth=self._range_db() * np.log(10) / 20 + 2,
            gain=p.spreading,
            optics=p.optics,
            noise=self._looks() is not None or p.receiver is not None,
            integration_time_s=time_s,
            illumination=p.illumination,
            path_return=self._path_return(),
        )

    def _path_return(self) -> PathReturn | None:
        """Returns the beam by which the air sends light back, or None."""
        p = self.params
        if p.beam_aperture_m is None:
            return None
        return PathReturn(p.beam_aperture_m, p.focus_m, p.gate_m)

    def _range_db(self) -> float:
        """Returns the range from the source's power down to the floor, dB."""
        p = self.params
        return float(
            max(p.dynamic_range_db + 10 * np.log10(p.source_power_w / p.full_scale_w), 0.0)
        )

    def observe(self, sight: Echoes, rng: np.random.Generator) -> Image:
        """Returns the image in decibels over the floor, with the received power in W."""
        p = self.params
        signal = self._power_w(sight.returned[0])
        of_air = None if sight.path_return is None else self._power_w(sight.path_return[0])
        if of_air is not None:
            signal = signal + of_air
        grain = self._grain(sight) if p.grained else None
        power = self._received(signal, grain, sight, rng)
        floor = p.full_scale_w * 10 ** (-p.dynamic_range_db / 10)
        below = power < floor
        layers = {
            "received_power": Layer(power, "W", "received power"),
            "below_floor": Layer(
                below.astype(np.int8),
                "1",
                "whether the power is below the floor",
                flags=("above", "below"),
            ),
        }
        return Image(
            10 * np.log10(np.maximum(power, floor) / floor),
            unit="dB",
            quantity="power over the floor",
            layers=layers | self._echo_layers(of_air) | self._noise_layers(signal, sight),
            facts={
                "floor": (floor, "W"),
                "pixels below the floor": (100 * float(below.mean()), "%"),
                **self._echo_facts(of_air, signal),
                **self._facts(signal, grain, sight),
            },
            decibels=Decibels("received_power", floor),
            caption=self._caption(of_air),
        )

    def _power_w(self, returned: NDArray[Any]) -> Array:
        """Returns the power received of what comes back, W."""
        p = self.params
        # Blur leaves rounding on either side of 0.
        power = p.source_power_w * np.maximum(np.asarray(returned, dtype=np.float64), 0.0)
        if p.spreading == "lambert":  # what comes back is per area; the aperture has this one
            power *= np.pi / 4 * p.aperture_m**2
        return np.asarray(power)

    def _echo_layers(self, of_air: Array | None) -> dict[str, Layer]:
        """Returns the power that the air sends back, if a beam may bring any."""
        if of_air is None:
            return {}
        return {"path_return": Layer(of_air, "W", "mean power from rain, fog and snow")}

    def _echo_facts(self, of_air: Array | None, signal: Array) -> dict[str, tuple[float, str]]:
        """Returns the mean power that the air sends back, and its part of all, if it does."""
        if of_air is None or not of_air.any():
            return {}
        return {
            "echo of the air": (float(of_air.mean()), "W"),
            "echo of the air, of all power": (100 * float(of_air.sum() / signal.sum()), "%"),
        }

    def _looks(self) -> float | None:
        """Returns how many looks are averaged, or None where there is no speckle."""
        p = self.params
        looks: float | None = p.speckle_looks if p.looks is None else p.looks
        return looks

    def _grain(self, sight: Echoes) -> speckle.Grain:
        """Returns the grain of the speckle."""
        p = self.params
        grain: speckle.Grain = p.optics.grain(
            p.frequency_ghz * 1e9, sight.pixel_angle_rad, p.illumination
        )
        return grain

    def _received(
        self, signal: Array, grain: speckle.Grain | None, sight: Echoes, rng: np.random.Generator
    ) -> Array:
        """Returns the power that the receiver tells, W, with speckle and noise."""
        p, looks = self.params, self._looks()
        if p.noise_figure_db is None and grain is None:
            power = signal if looks is None else signal * rng.gamma(looks, 1 / looks, signal.shape)
        else:
            count, total = int(looks or 1), np.zeros(signal.shape)
            for _ in range(count):
                one = signal
                if grain is not None:
                    one = signal * grain.draw((signal.shape[0], signal.shape[1]), rng)
                elif looks is not None:
                    one = signal * rng.exponential(size=signal.shape)
                total += self._detected(one, count, sight, rng)
            power = total / count
        if p.noise_equivalent_power_w_rthz is not None:
            power = power + self._noise_w(sight) * rng.standard_normal(signal.shape)
        return power

    def _detected(self, power: Array, looks: int, sight: Echoes, rng: np.random.Generator) -> Array:
        """Returns the power of one look, with the noise of its field if there is any."""
        if self.params.noise_figure_db is None:
            return power
        samples = self._bandwidth_hz(sight) * (sight.integration_time_s or 0.0) / looks
        return noise.detected(power, self._noise_w(sight), rng, max(samples, 1.0))

    def _bandwidth_hz(self, sight: Echoes) -> float:
        """Returns the receiver's bandwidth, Hz."""
        bandwidth_hz: float | None = self.params.bandwidth_hz
        if bandwidth_hz is not None:
            return bandwidth_hz
        assert sight.integration_time_s is not None  # noqa: S101 (needs() says it)
        return noise.integrator_hz(sight.integration_time_s)

    def _noise_w(self, sight: Echoes) -> float:
        """Returns the noise power, W: NEP sqrt(B), or k 290 K F B."""
        p, bandwidth_hz = self.params, self._bandwidth_hz(sight)
        if p.noise_figure_db is not None:
            return noise.receiver_w(p.noise_figure_db, bandwidth_hz)
        return float(p.noise_equivalent_power_w_rthz * np.sqrt(bandwidth_hz))

    def _noise_layers(self, signal: Array, sight: Echoes) -> dict[str, Layer]:
        """Returns noise and ratio of signal to noise, if the receiver has noise."""
        if self.params.receiver is None:
            return {}
        watts = self._noise_w(sight)
        return {
            "noise_power": Layer(np.full(signal.shape, watts), "W", "noise power of the receiver"),
            "snr": Layer(signal / watts, "1", "mean signal power over noise power"),
        }

    def _facts(
        self, signal: Array, grain: speckle.Grain | None, sight: Echoes
    ) -> dict[str, tuple[float, str]]:
        """Returns the looks of speckle, the noise, and the ratio of signal to noise.

        SNR is the mean over the targets, or where there are none over the whole image.
        """
        found: dict[str, tuple[float, str]] = {}
        looks = self._looks()
        if looks is not None:
            found["looks"] = (float(looks), "1")
        if grain is not None:
            found["looks within a pixel"] = (grain.looks(), "1")
        if self.params.receiver is not None:
            on_target = sight.target >= _FIRST_TARGET
            mean = float(signal[on_target if on_target.any() else ...].mean())
            watts = self._noise_w(sight)
            found["noise power"] = (watts, "W")
            found["noise bandwidth"] = (self._bandwidth_hz(sight), "Hz")
            if sight.integration_time_s is not None:
                found["integration time"] = (sight.integration_time_s, "s")
            found["SNR"] = (mean / watts, "1")
        return found

    def _caption(self, of_air: Array | None) -> str:
        """Returns what speckle and noise the image has, in words, and which echo of the air."""
        words = self._noise_words()
        if of_air is None or not of_air.any():
            return words
        gate_m = self.params.gate_m
        if gate_m is None:
            return f"{words}, echo of the air"
        return f"{words}, echo of the air from {gate_m[0]:+g} to {gate_m[1]:+g} m"

    def _noise_words(self) -> str:
        """Returns what speckle and noise the image has, in words."""
        p, looks = self.params, self._looks()
        if looks is None and p.receiver is None:
            return "without speckle and receiver noise"
        speckled = "no speckle"
        if looks is not None:
            speckled = f"speckle of {looks:g} look{'' if looks == 1 else 's'}"
        noisy = "no receiver noise"
        if p.noise_figure_db is not None:
            noisy = f"noise figure {p.noise_figure_db:g} dB"
        elif p.receiver is not None:
            noisy = f"NEP {p.noise_equivalent_power_w_rthz:.3g} W/√Hz"
        return f"{speckled}, {noisy}"


@hookimpl
def register_sensors() -> list[type[Sensor]]:
    """Returns the sensor of this file."""
    return [Active]
