"""What is measured of a case: of all its pixels the worst.

Relative to a quantity that the case makes non-zero.
"""

from __future__ import annotations

import math

import numpy as np

from thzcl.studies.stress import reference
from thzcl.studies.stress.trial import Measurement, Run, worst


def depth(run: Run) -> Measurement:
    """Optical depth of every ray, relative to itself."""
    return worst(run.sight.optical_depth, run.truth.optical_depth)


def passed(run: Run) -> Measurement:
    """The part of a surface's contrast that is left: exp(-depth)."""
    surface = run.truth.surface
    return worst(run.radiances.contrast / surface, run.truth.contrast / surface, 1.0)


def faint(run: Run) -> Measurement:
    """The depth that the contrast tells of, where next to nothing of it is left.

    Minus its logarithm.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        told = -np.log(run.radiances.contrast.astype(np.float64) / run.truth.surface)
    return worst(told, run.truth.optical_depth)


def emitted(run: Run) -> Measurement:
    """Contrast of air that emits along the path.

    Over the largest departure from the mean air's radiance on the way.
    """
    most = np.maximum(-run.truth.coldest, run.truth.warmest)
    return worst(run.radiances.contrast / most, run.truth.contrast / most, 1.0)


def faintly_emitted(run: Run) -> Measurement:
    """The same of thin air, over as much of it as the path can emit, 1 - exp(-depth).

    Where nothing else is seen.
    """
    most = np.maximum(-run.truth.coldest, run.truth.warmest) * -np.expm1(-run.truth.optical_depth)
    return worst(run.radiances.contrast / most, run.truth.contrast / most, 1.0)


def outside(run: Run) -> Measurement:
    """How far the contrast lies outside the range of the Planck radiances met on the way.

    Over that range.
    """
    low, high, seen = run.truth.coldest, run.truth.warmest, run.radiances.contrast
    return worst(np.maximum(np.maximum(low - seen, seen - high), 0) / (high - low), 0.0, 1.0)


def nothing(run: Run) -> Measurement:
    """The largest contrast, in W m-2 sr-1 Hz-1, where there should be none at all."""
    return worst(np.abs(run.radiances.contrast).max(), 0.0, 1.0)


def warmth(run: Run) -> Measurement:
    """Contrast in brightness temperature, K, of a surface in air that takes nothing away.

    Relative to the true one.
    """
    kelvin = reference.ends(run.scene).temperature_k - run.scene.atmosphere.temperature_k
    return worst(run.radiances.brightness_temperature_contrast[0], kelvin)


def decibels(run: Run) -> Measurement:
    """Echoes in dB over the floor: the dynamic range less twice the depth.

    In parts of the range.
    """
    sensor = run.scene.sensor.model_dump()
    loss = 2 * run.truth.optical_depth[0] * 10 / math.log(10)
    return worst(run.image.values, sensor["dynamic_range_db"] - loss, sensor["dynamic_range_db"])


def band_transmission(run: Run) -> Measurement:
    """Mean transmission of a band."""
    return worst(np.exp(-run.sight.optical_depth[0].astype(np.float64)), _band(run).transmission)


def band_contrast(run: Run) -> Measurement:
    """Contrast of a band, over its radiance."""
    return worst(run.radiances.contrast[0] / run.radiances.air_radiance[0], _band(run).contrast)


def band_depth(run: Run) -> Measurement:
    """Depth of a band's mean transmission through uniform air.

    At the frequencies that the run itself took.
    """
    hz, air_k = run.sight.nodes_hz, run.scene.atmosphere.temperature_k
    grams = np.asarray(run.scene.atmosphere.air.absolute_humidity_g_m3)
    tau = np.multiply.outer(
        reference.absorption(run.scene, hz, grams, air_k), reference.ends(run.scene).length_m
    )
    shares = np.asarray(run.sight.weights)[0] * reference.planck(hz, air_k)
    shares = shares / shares.sum()
    least = tau.min(axis=0)
    left, lost = (
        np.tensordot(shares, np.exp(least - tau), 1),
        np.tensordot(shares, -np.expm1(least - tau), 1),
    )
    # The smaller part of 1 has the digits.
    return worst(
        run.sight.optical_depth[0],
        least - np.where(lost < 0.5, np.log1p(-np.minimum(lost, 0.5)), np.log(left)),
    )


def lognormal(run: Run) -> Measurement:
    """Mean and spread of the logarithm of humidity over its mean: -s^2 / 2 and s.

    With s^2 = ln(1 + sigma^2).
    """
    sigma = (
        (run.scene.atmosphere.fluctuations.sigma_percent or 0.0) / 100
        if run.scene.atmosphere.fluctuations
        else 0.0
    )
    relative = (
        run.result.cubes[0].absolute_humidity_g_m3.astype(np.float64)
        / run.scene.atmosphere.air.absolute_humidity_g_m3
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log(relative)
        found = logarithm.mean(), logarithm.std()
    s = math.sqrt(math.log1p(sigma**2))
    return worst(found, (-s * s / 2, s))


def _band(run: Run) -> reference.BandTruth:
    sensor = run.scene.sensor.model_dump()
    low, high = (
        (sensor["center_ghz"] + sign * sensor["bandwidth_ghz"] / 2) * 1e9 for sign in (-1, 1)
    )
    return reference.band(run.scene, low, high, -2.0)  # a single mode collects lambda^2


def noise(run: Run) -> Measurement:
    """Spread over the pixels of an even scene's antenna temperature, over its mean."""
    values = run.image.values
    return worst(1 + np.ptp(values) / values.mean(), 1.0)
