"""Noise of detectors and receivers: bandwidths, photons, system temperatures, and their facts.

Sensors use it as `thzcl.sensor.noise`. Powers are in W, temperatures in K, times in s. Nothing here
draws random numbers, but for `detected`.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from thzcl.air.radiometry import BOLTZMANN, PLANCK, photon_temperature

Array = NDArray[np.float64]

REFERENCE_K = 290.0  # to which noise figures are relative (IEEE)
CHOPPED = np.pi / np.sqrt(2)  # a square wave, of whose fundamental a lock-in amplifier keeps part
_KELVINS = 1025  # of the look-up of photon noise by temperature
_FIRST_TARGET = 2  # the flag of the first target in what pixels show


class Seen(Protocol):
    """What facts about noise need to know; thzcl.sensor.Radiances is one."""

    @property
    def target(self) -> NDArray[Any]:
        """Returns what each pixel shows, (y, x): 2 and up for targets."""

    @property
    def optical_depth(self) -> NDArray[Any]:
        """Returns the optical depth, (frequency, y, x)."""

    @property
    def brightness_temperature_contrast(self) -> Array:
        """Returns the brightness temperature less the air's, K, (frequency, y, x)."""


def integrator_hz(time_s: float) -> float:
    """Returns the noise bandwidth of an integrator over a time, 1 / (2 t), Hz."""
    return 1 / (2 * time_s)


def pixel_time_s(own_s: float | None, dwell_s: float | None) -> float | None:
    """Returns how long a detector integrates over a pixel: its own time, else a scan's dwell.

    Returns None if there is neither. Raises ValueError if its own time is longer than the dwell.
    """
    if own_s is None or dwell_s is None:
        return own_s if dwell_s is None else dwell_s
    if own_s > dwell_s * (1 + 1e-9):
        raise ValueError(
            f"integration_time_s: {own_s:g} s is longer than the {dwell_s:g} s for which the scan "
            "stays on a pixel; shorten it, or leave it out for the scan's time"
        )
    return own_s


def photon_nep_squared(
    kelvin: Array,
    frequency_hz: Array,
    width_hz: Array,
    modes: Array,
    response: Array,
    efficiency: float,
    optics_k: float | None,
) -> Array:
    """Returns the square of the photon noise, W^2/Hz of absorbed power, in the shape of `kelvin`.

    It is 2 int N (h nu)^2 m (1 + m) dnu (Zmuidzinas 2003, Appl. Opt. 42, 4989), with N `modes`, and
    m = r (eta n(scene) + (1 - eta) n(optics)) photons absorbed in each mode; over a time t the
    absorbed power varies by that over 2 t. `kelvin` is the scene's brightness temperature in the
    band. Frequencies, their widths in Hz, `modes` and `response` (1 at its peak) are (node,). The
    optics emit nothing if `optics_k` is None.
    """
    span = np.linspace(float(kelvin.min()), float(kelvin.max()), _KELVINS)
    own = 0.0 if optics_k is None else (1 - efficiency) * occupation(frequency_hz, optics_k)
    photons = response * (efficiency * occupation(frequency_hz, span[:, None]) + own)
    square = 2 * photons * (1 + photons) @ (modes * (PLANCK * frequency_hz) ** 2 * width_hz)
    return np.interp(kelvin, span, square)


def occupation(frequency_hz: Any, temperature_k: Any) -> Array:
    """Returns the photons in each mode, 1 / (exp(h nu / (k T)) - 1), which is 0 at 0 K."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(
            1 / np.expm1(photon_temperature(frequency_hz) / np.asarray(temperature_k))
        )


def receiver_w(noise_figure_db: float, bandwidth_hz: float) -> float:
    """Returns the noise power of a receiver, k 290 K F B, W."""
    return float(BOLTZMANN * REFERENCE_K * 10 ** (noise_figure_db / 10) * bandwidth_hz)


def system_k(receiver_k: float, scene_k: Any, sideband: str) -> Any:
    """Returns the system temperature of a heterodyne receiver, K.

    It is T_rec + T_A if both sidebands hold the signal ("double"), and 2 T_rec + T_A if one does
    ("single"); T_rec is the double-sideband receiver temperature.
    """
    return (receiver_k if sideband == "double" else 2 * receiver_k) + scene_k


def radiometer_k(
    system: Any,
    bandwidth_hz: float,
    time_s: float,
    gain_drift: float = 0.0,
    unbalance_k: Any | None = None,
) -> Array:
    """Returns the temperature noise of a radiometer, K (Dicke 1946, Rev. Sci. Instrum. 17, 268).

    A total-power radiometer has T_sys sqrt(1 / (B t) + (dG/G)^2). One that switches between scene
    and reference half the time each has sqrt((2 T_sys)^2 / (B t) + (dG/G)^2 (T_A - T_ref)^2), with
    T_A - T_ref as `unbalance_k`.
    """
    samples = bandwidth_hz * time_s
    if unbalance_k is None:
        return np.asarray(system * np.sqrt(1 / samples + gain_drift**2))
    return np.asarray(np.sqrt((2 * system) ** 2 / samples + (gain_drift * unbalance_k) ** 2))


def detected(power: Array, noise_w: float, rng: np.random.Generator, samples: float = 1.0) -> Array:
    """Returns the mean of |s + n|^2 over independent samples of noise in a signal's field.

    `power` is the signal's, and `noise_w` the mean power of the noise, which is circular and
    Gaussian; the mean is the sum of both, and its variance (2 P P_n + P_n^2) / samples (Goodman,
    Statistical Optics, 1985, section 2.9). `samples` is at least 1 and need not be whole.
    """
    real, imaginary = np.sqrt(noise_w / 2) * rng.standard_normal((2, *power.shape))
    total = (np.sqrt(samples * power) + real) ** 2 + imaginary**2
    if samples > 1:  # what the field's own direction does not take adds its power alone
        total = total + rng.gamma(samples - 1, noise_w, power.shape)
    return np.asarray(total / samples)


def facts(sight: Seen, noise_k: float) -> dict[str, tuple[float, str]]:
    """Returns what noise of `noise_k` means for a passive image.

    NEDT is the temperature difference that equals the noise, at the sensor and behind the air in
    front of the targets. SNR is the mean contrast of the targets to the air, as it arrives, over
    the noise; where there are no targets, that of the whole image.
    """
    found = {"NEDT at the sensor": (noise_k, "K")}
    on_target = sight.target >= _FIRST_TARGET
    some = on_target if on_target.any() else np.ones_like(on_target)
    if on_target.any():
        passed = float(np.exp(-sight.optical_depth[0][on_target]).mean())
        found["NEDT at the targets"] = (noise_k / max(passed, 1e-300), "K")
    contrast = float(np.abs(sight.brightness_temperature_contrast[0][some]).mean())
    return found | {"SNR": (contrast / noise_k, "1")}
