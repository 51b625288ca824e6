"""The judges of stress cases: each measures the worst pixel, relative to a non-zero quantity."""

from __future__ import annotations

import math

import numpy as np

from thzcl.error.twin import planck
from thzcl.studies.stress.trial import Measurement, Run, worst
from thzcl.studies.stress.truth import BandTruth, absorption, band, ray_ends


def depth(run: Run) -> Measurement:
    """Judges the optical depth of every ray, relative to itself."""
    return worst(run.sight.optical_depth, run.truth.optical_depth)


def passed(run: Run) -> Measurement:
    """Judges the part of a surface's contrast that reaches the camera: exp(-depth)."""
    surface = run.truth.surface
    return worst(run.radiances.contrast / surface, run.truth.contrast / surface, 1.0)


def faint(run: Run) -> Measurement:
    """Judges a contrast of which next to nothing is left, by minus its logarithm, the depth."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = -np.log(run.radiances.contrast.astype(np.float64) / run.truth.surface)
    return worst(depths, run.truth.optical_depth)


def emitted(run: Run) -> Measurement:
    """Judges the contrast of a path that emits, relative to the largest contrast on the path."""
    most = np.maximum(-run.truth.coldest, run.truth.warmest)
    return worst(run.radiances.contrast / most, run.truth.contrast / most, 1.0)


def sky(run: Run) -> Measurement:
    """Judges what is seen of a sky, relative to the air's radiance."""
    air = run.radiances.air_radiance[:, None, None]
    return worst(run.radiances.contrast / air, run.truth.contrast / air, 1.0)


def faintly_emitted(run: Run) -> Measurement:
    """Judges the contrast of thin air, relative to the most that the air can emit.

    That is the largest contrast on the path times 1 - exp(-depth).
    """
    largest = np.maximum(-run.truth.coldest, run.truth.warmest)
    most = largest * -np.expm1(-run.truth.optical_depth)
    return worst(run.radiances.contrast / most, run.truth.contrast / most, 1.0)


def outside(run: Run) -> Measurement:
    """Judges how far a contrast lies outside the range of those on its path, over that range."""
    low, high, contrast = run.truth.coldest, run.truth.warmest, run.radiances.contrast
    beyond = np.maximum(np.maximum(low - contrast, contrast - high), 0)
    return worst(beyond / (high - low), 0.0, 1.0)


def nothing(run: Run) -> Measurement:
    """Judges the largest contrast, in W m-2 sr-1 Hz-1, which should be 0."""
    return worst(np.abs(run.radiances.contrast).max(), 0.0, 1.0)


def warmth(run: Run) -> Measurement:
    """Judges the contrast in brightness temperature, K, of a surface in clear air."""
    kelvin = ray_ends(run.scene).temperature_k - run.scene.atmosphere.temperature_k
    return worst(run.radiances.brightness_temperature_contrast[0], kelvin)


def decibels(run: Run) -> Measurement:
    """Judges echoes in dB over the floor, relative to the dynamic range.

    They should be the dynamic range less twice the depth in dB.
    """
    sensor = run.scene.sensor.model_dump()
    loss = 2 * run.truth.optical_depth[0] * 10 / math.log(10)
    return worst(run.image.values, sensor["dynamic_range_db"] - loss, sensor["dynamic_range_db"])


def band_transmission(run: Run) -> Measurement:
    """Judges the mean transmission of a band."""
    left = np.exp(-run.sight.optical_depth[0].astype(np.float64))
    return worst(left, _band(run).transmission)


def band_contrast(run: Run) -> Measurement:
    """Judges the contrast of a band, relative to the air's radiance in the band."""
    return worst(run.radiances.contrast[0] / run.radiances.air_radiance[0], _band(run).contrast)


def _band(run: Run) -> BandTruth:
    """Returns what a flat band brings to a single mode, whose throughput is wavelength squared."""
    sensor = run.scene.sensor.model_dump()
    middle, half = sensor["center_ghz"] * 1e9, sensor["bandwidth_ghz"] / 2 * 1e9
    return band(run.scene, middle - half, middle + half, power=-2.0)


def band_depth(run: Run) -> Measurement:
    """Judges the depth of a band's mean transmission through uniform air.

    The expected depth is that of a sum over the frequencies of the run.
    """
    hz, air_k = run.sight.nodes_hz, run.scene.atmosphere.temperature_k
    per_m = absorption(run.scene, hz, run.scene.atmosphere.air.absolute_humidity_g_m3, air_k)
    tau = np.multiply.outer(per_m, ray_ends(run.scene).length_m)
    shares = np.asarray(run.sight.weights)[0] * planck(hz, air_k)
    shares, least = shares / shares.sum(), tau.min(axis=0)
    left = np.tensordot(shares, np.exp(least - tau), 1)
    lost = np.tensordot(shares, -np.expm1(least - tau), 1)
    # The logarithm is taken of the sum that is the smaller part of 1, which has more digits.
    logarithm = np.where(lost < 0.5, np.log1p(-np.minimum(lost, 0.5)), np.log(left))
    return worst(run.sight.optical_depth[0], least - logarithm)


def lognormal(run: Run) -> Measurement:
    """Judges the mean and the standard deviation of the logarithm of humidity over its mean.

    With s^2 = ln(1 + sigma^2) they should be -s^2 / 2 and s.
    """
    air, grams = run.scene.atmosphere, run.result.cubes[0].absolute_humidity_g_m3
    fluctuations = air.fluctuations
    percent = fluctuations.sigma_percent if fluctuations else None
    s = math.sqrt(math.log1p(((percent or 0.0) / 100) ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log(grams.astype(np.float64) / air.air.absolute_humidity_g_m3)
        moments = logarithm.mean(), logarithm.std()
    return worst(moments, (-s * s / 2, s))


def noise(run: Run) -> Measurement:
    """Judges the spread of an even scene's antenna temperature, relative to its mean."""
    values = run.image.values
    return worst(1 + np.ptp(values) / values.mean(), 1.0)
