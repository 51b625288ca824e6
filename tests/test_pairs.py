"""Where two features meet: faults that neither of them shows alone.

The right values are closed forms, or runs in which the features do not meet.
"""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import oracle
import pytest
from scenes import run, scene, write

from thzcl import pipeline
from thzcl.graph import evaluate
from thzcl.sensing.image import NoiseKey

HZ = 650e9
ACTIVE = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 120.0}
LAMBERT = ACTIVE | {"spreading": "lambert", "aperture_m": 0.3}
NO_AIR = {"temperature_k": 293.15, "relative_humidity_percent": 0.0, "model": "none"}
TOWARDS_X = {
    "position_m": [0.0, 0.0, 50.0],
    "look_at_m": [40.0, 0.0, 50.0],
    "focal_length_mm": 1000.0,
}


def received(result):
    """Returns the power at the receiver by pixel, W."""
    return result.variants[0].image.layers["received_power"].values


def box(near_m, size, y=0.0, **more):
    """Returns a box whose near face is at x = near_m, 50 m up."""
    center = [near_m + size[0] / 2, y, 50.0]
    return {"kind": "box", "center_m": center, "size_m": list(size)} | more


# --- bistatic and thinned --------------------------------------------------------------------

BISTATIC = {
    "camera": {
        "position_m": [0.0, 0.0, 5.0],
        "look_at_m": [30.0, 0.0, 5.0],
        "focal_length_mm": 100.0,
        "focal_plane_mm": [10.0, 10.0],
        "pixels": [64, 64],
    },
    "atmosphere": {
        "temperature_k": 290.0,
        "relative_humidity_percent": 50.0,
        "fluctuations": {"sigma_percent": 20.0, "voxel_m": 0.5, "grid": 64, "seed": 5},
    },
    "targets": {
        "a": {
            "kind": "box",
            "center_m": [30.0, 0.0, 5.0],
            "size_m": [1.0, 1.0, 1.0],
            "reflectivity": 0.5,
        }
    },
    "sensor": ACTIVE
    | {"dynamic_range_db": 80.0, "arrangement": "bistatic", "transmitter_m": [0.0, 5.0, 5.0]},
}


@pytest.mark.parametrize("shortcut", [{"tolerance": 1e-2}, {"ray_stride": 4}])
def test_thinned_rays_of_a_bistatic_imager(tmp_path, shortcut):
    """Nine tenths of the pixels meet nothing that is lit, and send back exactly nothing."""
    every = run(tmp_path, BISTATIC | {"numerics": {"ray_stride": 1}})
    thinned = run(tmp_path, BISTATIC | {"numerics": shortcut})
    right, power = received(every), received(thinned)
    assert thinned.voxel_segments < every.voxel_segments / 4
    assert 0.8 < np.mean(right == 0) < 1
    assert np.array_equal(power == 0, right == 0)
    assert rms(power - right) < 1e-2 * rms(right)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


# --- Lambert's law, samples and optics -------------------------------------------------------


def test_each_ray_of_a_pixel_has_its_own_slant_and_distance(tmp_path):
    """256 rays a pixel, each of which brings P R cos D^2 / (4 r^2), by the oracle's geometry.

    Across one pixel of the slanting wall the distance changes by a third.
    """
    wall = {
        "kind": "box",
        "center_m": [4.0, 0.0, 50.0],
        "size_m": [0.5, 3.0, 1.0],
        "yaw_deg": 65.0,
        "reflectivity": 0.3,
    }
    camera = TOWARDS_X | {"focal_plane_mm": [800.0, 600.0], "pixels": [4, 3]}
    data = {
        "camera": camera | {"samples_per_pixel": 256},
        "atmosphere": NO_AIR,
        "background": {"max_range_m": 1000.0},
        "targets": {"w": wall},
        "sensor": LAMBERT,
    }
    found = received(run(tmp_path, data))
    lens = oracle.Camera(
        camera["position_m"], camera["look_at_m"], 1000.0, camera["focal_plane_mm"], (64, 48)
    )
    solid = oracle.Box(wall["center_m"], wall["size_m"], wall["yaw_deg"])
    c, s = math.cos(math.radians(65.0)), math.sin(math.radians(65.0))
    normals = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    origin, due = np.array(camera["position_m"]), np.zeros((48, 64))
    for row, column in np.ndindex(48, 64):
        direction = lens.ray(row, column)
        hit = solid.meet(origin, direction)
        if hit:
            cosine = abs(direction @ normals[hit[1]])
            due[row, column] = 1e-3 * 0.3 * cosine * 0.3**2 / (4 * hit[0] ** 2)
    due = due.reshape(3, 16, 4, 16).mean(axis=(1, 3))
    assert (due > 0).any() and (due == 0).any() and np.ptp(due[due > 0]) > 0.5 * due.max()
    assert found == pytest.approx(due, rel=1e-3, abs=1e-6 * due.max())


def test_a_pixel_that_half_shows_a_rough_wall_has_half_its_echo(tmp_path):
    """The wall's edge runs through the middle of the fourth column; behind it nothing is met."""
    data = {
        "camera": TOWARDS_X
        | {"focal_plane_mm": [4.0, 4.0], "pixels": [8, 8], "samples_per_pixel": 256},
        "atmosphere": NO_AIR,
        "background": {"max_range_m": 1000.0},
        "targets": {"w": box(40.0, (1.0, 2.0, 4.0), y=-0.99, reflectivity=0.3)},
        "sensor": LAMBERT,
    }
    row = received(run(tmp_path, data))[4] / (1e-3 * 0.3 * 0.3**2 / (4 * 40.0**2))
    assert row == pytest.approx([0, 0, 0, 0.5, 1, 1, 1, 1], abs=1e-3)


def test_optics_blur_rough_echoes_of_the_distance_that_they_come_from(tmp_path):
    """All that is seen of a wall at 40 m is divided by that distance, beside its edges too."""
    data = {
        "camera": TOWARDS_X | {"focal_plane_mm": [20.0, 4.0], "pixels": [40, 8]},
        "atmosphere": NO_AIR,
        "background": {"max_range_m": 1000.0},
        "targets": {"w": box(40.0, (0.1, 0.4, 5.0), y=0.2, reflectivity=0.3)},
    }
    blurred = {"optics": {"aperture_m": 0.3}}
    right = received(run(tmp_path, data | {"sensor": ACTIVE | blurred})) * 0.3**2 / (4 * 40.0**2)
    found = received(run(tmp_path, data | {"sensor": LAMBERT | blurred}))
    beside = (right > 1e-3 * right.max()) & (right < 0.1 * right.max())
    assert beside.sum() > 50
    assert np.abs(found - right).max() < 1e-3 * right.max()


# --- a scan through optics -------------------------------------------------------------------

SCANNED = {
    "camera": {
        "position_m": [0.0, 0.0, 50.0],
        "look_at_m": [0.0, 40.0, 50.0],
        "focal_length_mm": 100.0,
        "focal_plane_mm": [3.6, 3.6],
        "pixels": [8, 8],
    },
    "atmosphere": {
        "temperature_k": 293.15,
        "relative_humidity_percent": 44.0,
        "fluctuations": {
            "sigma_percent": 20.0,
            "voxel_m": 0.25,
            "grid": 64,
            "seed": 5,
            "wind_m_s": [2.0, 0.0, 0.0],
            "grid_orientation": "aligned",
        },
    },
    "targets": {
        "w": {
            "kind": "box",
            "center_m": [0.0, 40.5, 50.0],
            "size_m": [60.0, 1.0, 60.0],
            "temperature_k": 400.0,
        }
    },
    "numerics": {"error_budget": False},
}
DWELL_S = 5e-3


def seen(folder, **parameters):
    """Returns the contrast, in K, that a scan through optics sees."""
    optics = {"aperture_m": 0.05, "pixel": False}
    detector = {"kind": "passive-spectral", "frequency_ghz": 650.0, "optics": optics}
    sensor = {"kind": "raster-scan", "detector": detector} | parameters
    result = run(folder, SCANNED | {"sensor": sensor})
    return result.variants[0].radiances.brightness_temperature_contrast[0]


def snapshot(folder, time_s):
    """Returns what is seen with all pixels taken at one time."""
    instant = {"integration_time_s": 2 * time_s, "samples": 1}
    return seen(folder, timing="focal-plane", **instant)


@pytest.mark.parametrize(
    "way",
    [
        {},
        pytest.param({"order": "columns"}, marks=pytest.mark.slow),
        pytest.param({"back_and_forth": True}, marks=pytest.mark.slow),
    ],
)
def test_a_scan_through_optics_blurs_the_air_of_each_pixels_own_time(tmp_path, way):
    """Four pixels, each against the snapshot of all rays at that pixel's time.

    A pixel's beam is wider than the frame: its rays lie in pixels taken up to 0.3 s apart.
    """
    number = np.arange(64).reshape(8, 8)
    if "back_and_forth" in way:
        number[1::2] = number[1::2, ::-1]
    if "order" in way:
        number = number.T
    scan = seen(tmp_path, dwell_s=DWELL_S, **way)
    wrong, still = [], snapshot(tmp_path, 1e-9)
    for place in ((1, 1), (1, 6), (6, 1), (6, 6)):
        own = snapshot(tmp_path, number[place] * DWELL_S)
        wrong.append(scan[place] - own[place])
    assert rms(wrong) < 0.02 * scan.std()
    assert rms(scan - still) > scan.std()  # which the air's motion across the scan is not


# --- thin things under optics ----------------------------------------------------------------

BAR_M = 0.004


def bar(folder, angle_deg, y, pitch_mrad):
    """Returns the flux of a bar at 40 m over the right one, and the budget's pixel-sampling.

    The camera is rolled by an angle; flux is summed along a row of pixels, or along a column where
    the bar lies more along rows.
    """
    angle, steep = math.radians(angle_deg), angle_deg > 45
    slant = math.sin(angle) if steep else math.cos(angle)
    count = 2 * round(16 / pitch_mrad / slant)
    pixels = [4, count] if steep else [count, 4]
    camera = TOWARDS_X | {
        "up": [0.0, math.sin(angle), math.cos(angle)],
        "focal_plane_mm": [n * pitch_mrad for n in pixels],
        "pixels": pixels,
    }
    data = {
        "camera": camera,
        "atmosphere": NO_AIR,
        "background": {"temperature_k": 293.15, "max_range_m": 100.0},
        "targets": {"b": box(40.0, (0.1, BAR_M, 20.0), y=y, temperature_k=400.0)},
        "sensor": {
            "kind": "passive-spectral",
            "frequency_ghz": 650.0,
            "optics": {"aperture_m": 0.3, "pixel": False},
        },
    }
    result = run(folder, data)
    contrast = result.variants[0].radiances.contrast[0]
    flux = (contrast[:, 2] if steep else contrast[2]).sum() * pitch_mrad * 1e-3
    due = (oracle.planck(HZ, 400.0) - oracle.planck(HZ, 293.15)) * BAR_M / 40.0 / slant
    return flux / due, result.error_budget["pixel-sampling"]["relative"]


@pytest.mark.parametrize(
    "angle_deg", [0.0, 60.0, *(pytest.param(a, marks=pytest.mark.slow) for a in (30.0, 90.0))]
)
def test_a_thin_bar_keeps_its_flux(tmp_path, angle_deg):
    """A bar of a third of lambda / D, wherever it lies, to 5 %; and the budget knows the rest."""
    for y in (0.001, 0.0047):
        flux, reported = bar(tmp_path, angle_deg, y, 0.5)
        assert flux == pytest.approx(1.0, abs=0.05)
        assert 1e-4 < reported < 0.05


@pytest.mark.long
@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0, 90.0])
def test_a_thin_bar_keeps_its_flux_at_forty_places(tmp_path, angle_deg):
    """At worst to 5 %; the budget's line is within a factor of 2 of the root mean square."""
    found = np.array([bar(tmp_path, angle_deg, y, 0.25) for y in np.linspace(0, 0.01, 40)])
    assert np.abs(found[:, 0] - 1).max() < 0.05
    assert 0.5 < rms(found[:, 1]) / rms(found[:, 0] - 1) < 2


BISTATIC_LAMBERT = LAMBERT | {"arrangement": "bistatic", "transmitter_m": [0.0, 5.0, 6.0]}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": 650.0}


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [SPECTRAL, BISTATIC_LAMBERT])
def test_optics_need_no_samples_of_the_camera(tmp_path, sensor):
    """Thirty-six times the rays change it by 0.2 %; without a lattice edges err by 4 %."""
    data = scene(
        camera__pixels=[16, 12],
        camera__focal_length_mm=60.0,
        sensor=sensor | {"optics": {"aperture_m": 0.03}},
    )
    once, often = (
        run(tmp_path, data, settings={"camera.samples_per_pixel": n}).variants[0].sight
        for n in (1, 36)
    )
    one, many = (s.contrast if sensor is SPECTRAL else s.returned for s in (once, often))
    assert rms(one - many) < 3e-3 * np.abs(many).max()


# --- variants beside each other --------------------------------------------------------------

SMALL = {"camera.pixels": [16, 12], "atmosphere.fluctuations.grid": 32}


@pytest.mark.parametrize(("name", "traces"), [("figure6", 1), ("figure7", 2), ("figure8", 2)])
def test_variants_share_what_they_have_in_common(device, name, traces):
    """Figure 6 is one view in one air, figures 7 and 8 are two views in air of four climates."""
    plan, runs = pipeline.prepare(name, SMALL), Counter()
    list(evaluate([plan.batch()], device, runs=runs))
    assert len(plan.variants) in (6, 8)
    assert (runs["TraceSpec"], runs["FieldSpec"]) == (traces, 1)
    assert runs["ImageSpec"] == len(plan.variants)


@pytest.mark.parametrize("cutoff", [None, 1e3])
@pytest.mark.parametrize("name", ["figure6", "figure7", "figure8"])
def test_a_variant_alone_is_the_variant_among_others(name, cutoff):
    """It has the same bits, noise included.

    Depths behind the cut-off are as deep as the deepest cut-off of those that share the path, and
    have the same bits where the user fixed it.
    """
    settings = SMALL | ({} if cutoff is None else {"numerics.cutoff_depth": cutoff})
    together = pipeline.run(name, settings=settings, figure=False).variants
    for number in (0, 3, len(together) - 1):
        among = together[number]
        (alone,) = pipeline.run(
            name, settings=settings, variants=[among.name], figure=False
        ).variants
        assert alone.name == among.name
        assert bits(alone) == bits(among)
        depth, other = (one.sight.optical_depth for one in (alone, among))
        reached = depth < (cutoff or 10.0)
        assert np.array_equal(depth[reached], other[reached])
        assert reached.all() or (cutoff is None and (other >= depth).all())


def bits(variant):
    """Returns the bits of all that an image holds, but for the depth."""
    sight, image = variant.sight, variant.image
    signal = sight.returned if image.unit == "dB" else sight.contrast
    layers = [layer.values for layer in image.layers.values()]
    arrays = [signal, sight.path_length, sight.target, image.values, *layers]
    return [(one.dtype, one.shape, one.tobytes()) for one in arrays]


def test_noise_is_a_matter_of_seed_name_realisation_and_frame_alone():
    """Each of them changes it, and the same four give it again."""
    keys = [NoiseKey(1, ""), NoiseKey(2, ""), NoiseKey(1, "a"), NoiseKey(1, "", 1)]
    keys.append(NoiseKey(1, "", 0, 1))
    drawn = [key.generator().normal(size=1000) for key in keys]
    assert np.abs(np.corrcoef(drawn) - np.eye(5)).max() < 0.15
    for key, numbers in zip(keys, drawn, strict=True):
        assert np.array_equal(key.generator().normal(size=1000), numbers)


def test_variants_of_other_names_have_other_noise(tmp_path):
    """Two variants differ in nothing but their names."""
    noisy = {
        "kind": "passive-broadband",
        "center_ghz": 650.0,
        "bandwidth_ghz": 100.0,
        "quadrature": "paper",
        "noise_equivalent_power_w_rthz": 3e-12,
        "frame_rate_hz": 100.0,
    }
    same = [{"name": name, "set": {}} for name in ("a", "b")]
    seeded = {"sensor": noisy, "numerics": {"noise_seed": 3}}
    data = scene(**seeded, atmosphere__fluctuations=None, variants=same)
    first, again = (run(tmp_path, data).variants for _ in range(2))
    one, other = (variant.image.values for variant in first)
    assert np.array_equal(one, again[0].image.values)
    noise = (one - one.mean()).ravel(), (other - other.mean()).ravel()
    assert abs(np.corrcoef(*noise)[0, 1]) < 0.3
    assert not np.array_equal(one, other)


CLIMATES = {"dry": 10.0, "wet": 100.0}  # relative humidity, %


def test_a_polynomial_is_the_same_alone_and_beside_longer_ones(tmp_path, device):
    """Dry air needs fewer terms than wet air, with which it shares its path."""
    key = "atmosphere.relative_humidity_percent"
    climates = [{"name": name, "set": {key: percent}} for name, percent in CLIMATES.items()]
    data = scene(variants=climates)
    plan, runs = pipeline.prepare(write(tmp_path, data)), Counter()
    wanted = tuple(variant.expansion for variant in plan.variants)
    ((dry, wet),) = evaluate([wanted], device)
    assert dry.moments < wet.moments
    list(evaluate([plan.batch()], device, runs=runs))
    assert runs["TraceSpec"] == 1
    together = run(tmp_path, data).variants
    for number, percent in enumerate(CLIMATES.values()):
        alone = run(tmp_path, scene(), settings={key: percent}).variants[0]
        assert bits(alone) == bits(together[number])
        depth, other = (one.sight.optical_depth for one in (alone, together[number]))
        assert np.array_equal(depth, other)


# --- opaque frequencies beside clear ones ----------------------------------------------------


def test_opaque_frequencies_take_no_surface_from_clear_ones(tmp_path):
    """More frequencies than one pass takes, of which the first end all rays before the box.

    At the others, rays that meet nothing are long enough for a cut-off.
    """
    opaque = [round(556.9 + 0.01 * n, 3) for n in range(8)]
    clear = [float(640 + 2 * n) for n in range(8)]
    sensor = {"kind": "passive-spectral", "frequency_ghz": clear}
    warm = {"atmosphere__fluctuations__temperature_sigma_k": 1.0, "background__max_range_m": 900.0}
    alone = run(tmp_path, scene(**warm, sensor=sensor))
    sensor = sensor | {"frequency_ghz": opaque + clear}
    beside = run(tmp_path, scene(**warm, sensor=sensor))
    contrast = alone.variants[0].radiances.contrast
    assert np.abs(contrast).max() > 0
    found = beside.variants[0].radiances.contrast[len(opaque) :]
    assert np.abs(found - contrast).max() < 1e-6 * np.abs(contrast).max()
    assert beside.error_budget["total"]["relative"] < 1e-6
