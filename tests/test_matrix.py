"""Every pair of features on one small scene, against the slow oracle, or refused in words.

A wall slants across the whole view, so that nothing hides behind sampling of edges. The oracle
walks every ray through the saved cube by itself, at its own time and from its own place; it blurs
by Gauss and Hermite's rule, and knows no graph, no expansion and no kernel.
"""

from __future__ import annotations

import math
from copy import deepcopy
from functools import cache
from itertools import combinations

import numpy as np
import oracle
import pytest
from scenes import lens, run, write
from test_sky import slow_sky

from thzcl import pipeline
from thzcl.errors import ScenarioError

AIR_K, PRESSURE = 290.0, 1013.25
EVEN_M = 85.0  # 50 m above the wall, up to where the air is the scene's
WIND, DWELL_S = np.array([3.0, -2.0, 1.0]), 0.4
TRANSMITTER = [1.0, 4.0, 6.0]
BLUR_RAD = 0.04  # full width at half maximum, two pixels
LOOKS, NEP, BANDWIDTH_HZ = 4, 1e-12, 1e4
OTHER = "p676-13"  # the model that is compared
SEEDS = range(40, 70)  # of noise, where statistics are taken
PASSIVE = {"kind": "passive-spectral"}
ACTIVE = {"kind": "active", "dynamic_range_db": 200.0}
BAND = {"kind": "passive-broadband", "bandwidth_ghz": 30.0}
BAND |= {"quadrature": "paper", "paper_steps": "bins", "step_ghz": 10.0}
STEPS_HZ = np.array([-10e9, 0.0, 10e9])
SCENE = {
    "camera": {
        "position_m": [0.0, 0.0, 5.0],
        "look_at_m": [20.0, 0.0, 5.0],
        "focal_length_mm": 100.0,
        "focal_plane_mm": [8.0, 6.0],
        "pixels": [4, 3],
    },
    "atmosphere": {
        "temperature_k": AIR_K,
        "relative_humidity_percent": 70.0,
        "fluctuations": {"sigma_percent": 30.0, "voxel_m": 0.5, "grid": 32, "seed": 11},
    },
    "targets": {
        "wall": {
            "kind": "box",
            "center_m": [22.0, 0.0, 5.0],
            "size_m": [2.0, 60.0, 60.0],
            "yaw_deg": 25.0,
            "temperature_k": 320.0,
            "reflectivity": 0.3,
        }
    },
    "background": {"max_range_m": 90.0},
    "output": {"save_field": True},
    "numerics": {"noise_seed": 1, "ray_stride": 1, "error_budget": False},
}
FEATURES = (
    *("scan", "optics", "bistatic", "speckle", "noise", "samples", "thinning", "realisations"),
    *("bands", "temperature", "float64", "compare", "sky"),
)
PAIRS = list(combinations(FEATURES, 2))
ACTIVE_ALONE = {"bistatic", "speckle"}
CANNOT = {  # an active imager has one frequency, and light of one frequency alone is coherent
    ("bistatic", "bands"): "unknown key",
    ("speckle", "bands"): "unknown key",
}


def detector_of(has):
    """Returns the table of the sensor that records, and whether it is active."""
    active = bool(has & ACTIVE_ALONE)
    sensor = dict(ACTIVE if active else BAND if has & {"bands", "noise"} else PASSIVE)
    # The sky is as warm as moist air at 650 GHz, and the colder the lower the frequency.
    sensor["center_ghz" if sensor["kind"] == BAND["kind"] else "frequency_ghz"] = (
        410.0 if "sky" in has else 650.0
    )
    if "bistatic" in has:
        sensor |= {"arrangement": "bistatic", "transmitter_m": TRANSMITTER}
    if "speckle" in has:
        sensor |= {"speckle_looks": float(LOOKS)}
    if "noise" in has:
        sensor |= {"noise_equivalent_power_w_rthz": NEP if active else 1e-15}
        sensor |= {"bandwidth_hz": BANDWIDTH_HZ} if active else {}
    if "optics" in has:
        sensor["optics"] = {"blur_mrad": BLUR_RAD * 1e3, "pixel": False}
    return sensor, active


def samples_of(has):
    """Returns the rays of a pixel: some that lie close enough to be interpolated if asked for."""
    if "thinning" in has and "temperature" not in has:
        return 64
    if "optics" in has:
        return 36 if "samples" in has else 25
    return 4 if has & {"samples", "thinning"} else 1


def made(pair):
    """Returns the scene of two features, and whether it is active."""
    data, has = deepcopy(SCENE), set(pair)
    data["sensor"], active = detector_of(has)
    data["camera"]["samples_per_pixel"] = samples_of(has)
    air, numerics = data["atmosphere"]["fluctuations"], data["numerics"]
    if "scan" in has:
        air["wind_m_s"] = WIND.tolist()
        data["sensor"] = {"kind": "raster-scan", "dwell_s": DWELL_S, "detector": data["sensor"]}
    if "thinning" in has:
        numerics["ray_stride"] = 2
    if "realisations" in has:
        numerics["realizations"] = 2
        del data["output"]
    if "temperature" in has:
        air["temperature_sigma_k"] = 2.0
    if "float64" in has:
        numerics["precision"] = "float64"
    if "compare" in has:
        data["atmosphere"]["compare"] = [OTHER]
    if "sky" in has:
        data["sky"] = {"profile": "us-standard"}
        data["background"]["environment"] = "sky"
        air["sigma_percent"] = 60.0  # at 410 GHz half as opaque as at 650
    return data, active


@cache
def of_sky(hz, model):
    """Returns the radiance above the air's that a wall sees of the sky and of black ground.

    Directions e above the horizon have a share of 2 cos(e)^2 / pi de; the ground has the air's
    temperature.
    """
    grams = 0.7 * oracle.saturation_hpa(AIR_K) * 1e5 / 461.525 / AIR_K
    x, w = np.polynomial.legendre.leggauss(16)
    up, share = (x + 1) * math.pi / 4, w * math.pi / 4
    air = 5.0, AIR_K, grams, 5.0, EVEN_M
    above = [slow_sky(hz, math.degrees(e), *air, model=model) for e in up]
    return float((above - oracle.planck(hz, AIR_K)) @ (share * 2 / math.pi * np.cos(up) ** 2))


def nodes_of(detector):
    """Returns the frequencies of a sensor, Hz."""
    if "center_ghz" in detector:
        return detector["center_ghz"] * 1e9 + STEPS_HZ
    return np.array([detector["frequency_ghz"] * 1e9])


class Oracle:
    """The mean signal of pixels, ray by ray: contrast by frequency, or what comes back."""

    def __init__(self, data, active, cube, turn, model):
        self.data, self.active, self.cube, self.turn = data, active, cube, turn
        self.model = model
        self.camera = lens(data)
        wall = data["targets"]["wall"]
        self.box = oracle.Box(wall["center_m"], wall["size_m"], wall["yaw_deg"])
        detector = data["sensor"].get("detector", data["sensor"])
        self.detector = detector
        self.nodes = nodes_of(detector)

    def pixel(self, row, column):
        """Returns the mean over a pixel's rays, which are all taken at the pixel's own time."""
        time_s = (row * 4 + column) * DWELL_S if "detector" in self.data["sensor"] else 0.0
        total = sum(
            share * self.ray(row + down, column + right, time_s)
            for share, down, right in self.rays()
        )
        return np.asarray(total)

    def rays(self):
        """Yields the weight of a ray, and how far it lies from the pixel's centre, in pixels."""
        if "optics" in self.detector:
            x, w = np.polynomial.hermite_e.hermegauss(15)
            sigma = BLUR_RAD / math.sqrt(8 * math.log(2)) / 0.02  # in pixels of 20 mrad
            places = [
                (a, b, c, d) for a, c in zip(w, x, strict=True) for b, d in zip(w, x, strict=True)
            ]
            for a, b, down, right in places:
                yield a * b / w.sum() ** 2, sigma * down, sigma * right
            return
        side = math.isqrt(self.data["camera"].get("samples_per_pixel", 1))
        places = (np.arange(side) + 0.5) / side - 0.5
        for down in places:
            for right in places:
                yield 1 / side**2, down, right

    def ray(self, row, column, time_s):
        """Returns what one ray brings, by frequency."""
        origin, direction = np.array(self.camera.position), self.camera.ray(row, column)
        far = self.box.meet(origin, direction)[0]
        grams, kelvin, metres = self.air(origin, direction, far, time_s)
        if self.active:
            (hz,) = self.nodes
            depth = self.depth(hz, grams, kelvin, metres)
            out = depth
            if "transmitter_m" in self.detector:
                source = np.array(TRANSMITTER)
                way = origin + far * direction - source
                long = math.sqrt(way @ way)
                out = self.depth(hz, *self.air(source, way / long, long, time_s))
            return np.array([0.3 * math.exp(-depth - out)])
        return np.array([self.contrast(hz, grams, kelvin, metres) for hz in self.nodes])

    def air(self, origin, direction, far, time_s):
        """Returns vapour, temperature and length of the segments along a line."""
        place = origin - WIND * time_s
        way = (place, direction, far, self.cube.voxel_m, self.turn)
        grams, metres = oracle.path(self.cube.absolute_humidity_g_m3.astype(float), *way)
        kelvin = np.full(len(grams), AIR_K)
        if self.cube.air_temperature_k is not None:
            kelvin, _ = oracle.path(self.cube.air_temperature_k.astype(float), *way)
        return grams, kelvin, metres

    def absorption(self, hz, grams, kelvin):
        """Returns the absorption of segments, 1/m."""
        return oracle.absorption_per_m(hz, kelvin, PRESSURE, grams, self.model)

    def depth(self, hz, grams, kelvin, metres):
        """Returns the optical depth of segments."""
        return float(self.absorption(hz, grams, kelvin) @ metres)

    def contrast(self, hz, grams, kelvin, metres):
        """Returns the radiance above the mean air's, behind which the wall stands."""
        absorption = self.absorption(hz, grams, kelvin)
        source = [oracle.planck(hz, k) for k in kelvin]
        wall = 0.7 * oracle.planck(hz, 320.0) + 0.3 * oracle.planck(hz, AIR_K)
        if "sky" in self.data:
            wall += 0.3 * of_sky(hz, self.model)
        return oracle.transfer(absorption, metres, source, wall) - oracle.planck(hz, AIR_K)


def due(data, active, folder, model="mpm93"):
    """Returns the oracle's signal, (y, x): of a band the mean weighted by one mode's throughput."""
    seeds = [data["atmosphere"]["fluctuations"]["seed"]]
    if data["numerics"].get("realizations", 1) == 2:
        seeds.append((seeds[0] + 0x9E3779B97F4A7C15) % 2**63)
    images = []
    for seed in seeds:
        alone = deepcopy(data) | {"output": {"save_field": True}}
        alone["numerics"].pop("realizations", None)
        alone["atmosphere"]["fluctuations"]["seed"] = seed
        result = run(folder, alone, figure=False)
        made_by = Oracle(data, active, result.cubes[0], result.grid_rotations[0], model)
        images.append(
            np.array([[made_by.pixel(row, column) for column in range(4)] for row in range(3)])
        )
    signal = np.mean(images, axis=0)
    if signal.shape[2] == 1:
        return signal[..., 0]
    weights = nodes_of(data["sensor"].get("detector", data["sensor"])) ** -2.0
    return signal @ (weights / weights.sum())


def seen(result):
    return signal(result.variants[0].sight)


def signal(sight):
    return np.asarray(sight.contrast[0] if hasattr(sight, "contrast") else sight.returned[0], float)


# A scan through optics takes the oracle a minute and a half.
LONG = {("scan", "optics"): pytest.mark.long}


@pytest.mark.slow
@pytest.mark.parametrize(
    "pair", [pytest.param(pair, marks=LONG.get(pair, ())) for pair in PAIRS], ids="-".join
)
def test_a_pair_of_features_is_the_oracles(tmp_path, pair):
    """Exactly but for float32, or within what optics and interpolation may lose."""
    data, active = made(pair)
    if pair in CANNOT:
        data["sensor"] = dict(data["sensor"]) | {"bandwidth_ghz": 30.0}
        with pytest.raises(ScenarioError, match=CANNOT[pair]):
            pipeline.prepare(write(tmp_path, data))
        return
    result = run(tmp_path, data, figure=False)
    right, found = due(data, active, tmp_path), seen(result)
    spread = right.std()
    assert spread > 2e-3 * np.abs(right).max()  # ten times what float32 may lose
    bound = 2e-4 * np.abs(right).max()
    if "optics" in pair:
        bound = 0.05 * spread
    if "thinning" in pair and not {"scan", "temperature"} & set(pair):
        bound = max(bound, 0.05 * spread)
    assert np.abs(found - right).max() < bound
    if "sky" in pair and not active:
        assert 5 * bound < 0.3 * abs(of_sky(410e9, "mpm93"))  # what the wall reflects
    if "compare" in pair:
        other = due(data, active, tmp_path, OTHER)
        compared = signal(result.variants[0].compared[0].sight)
        assert np.abs(compared - other).max() < bound < 0.1 * np.abs(other - right).max()
    if "scan" in pair:
        assert (
            np.abs(found - snapshot(tmp_path, data)).max() > 5 * bound
        )  # what a still camera sees
    drawn(tmp_path, data, pair, active, found)


def snapshot(folder, data):
    still = deepcopy(data)
    still["sensor"] = still["sensor"]["detector"]
    return seen(run(folder, still, figure=False))


def drawn(folder, data, pair, active, signal):
    """Asserts that speckle and noise are those of the signal, over many seeds."""
    if not {"speckle", "noise"} & set(pair):
        return
    images = []
    for seed in SEEDS:
        noisy = deepcopy(data)
        noisy["numerics"]["noise_seed"] = seed
        image = run(folder, noisy, figure=False).variants[0].image
        images.append(image.layers["received_power"].values)
    images = np.array(images)
    count = images.size
    mean = 1e-3 * signal if active else images.mean(axis=0)
    variance = np.zeros(signal.shape)
    if "speckle" in pair:
        variance = variance + mean**2 / LOOKS
    if "noise" in pair:
        time_s = DWELL_S if "scan" in pair else 0.5  # a frame at 1 Hz reads as 1 / (2 t)
        sigma = NEP * math.sqrt(BANDWIDTH_HZ) if active else 1e-15 / math.sqrt(2 * time_s)
        variance = variance + sigma**2
    if "realisations" in pair:
        variance = variance / 2  # means of two
    normal = (images - mean) / np.sqrt(variance)
    if active:
        assert abs(normal.mean()) < 5 / math.sqrt(count)
    assert (normal**2).mean() == pytest.approx(1.0, abs=5 * math.sqrt(8 / count))
