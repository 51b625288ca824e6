"""The built-in sensors against the numbers that they stand for."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import oracle
import pytest
from scenes import run, scene

from thzcl import pipeline
from thzcl.air import radiometry
from thzcl.air.mean import Air
from thzcl.air.mpm93 import line_centers_ghz, line_width_ghz
from thzcl.errors import ScenarioError
from thzcl.sensing import bands
from thzcl.sensor import Radiances

ACTIVE = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 100.0}
CLIMATES = {
    (-10, 30): 0.64,
    (20, 44): 5.5,
    (43, 30): 11.6,
    (35, 90): 30.1,
}  # two-way loss over 40 m at 650 GHz, dB
MIRROR = {
    "kind": "box",
    "center_m": [41.0, 0.0, 1.2],
    "size_m": [2.0, 40.0, 40.0],
    "temperature_k": 300.0,
    "reflectivity": 1.0,
}


def facing(distance, **changes):
    """A wall across the line of sight, its face at a distance.

    Seen by a few pixels in uniform air.
    """
    wall = MIRROR | {"center_m": [distance + 1.0, 0.0, 1.2]}
    base = {
        "camera__position_m": [0.0, 0.0, 1.2],
        "camera__look_at_m": [40.0, 0.0, 1.2],
        "camera__pixels": [3, 3],
        "camera__focal_length_mm": 30000.0,
        "atmosphere__fluctuations": None,
        "ground": None,
        "targets": {"wall": wall},
    }
    return scene(**(base | changes))


# --- active
# ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [40.0, 80.0])
@pytest.mark.parametrize("climate", CLIMATES)
def test_two_way_losses_of_the_four_climates(tmp_path, climate, distance):
    """To 1 %; a mirror, 1 mW, and a range that reaches everything."""
    sensor = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 100.0}
    air = {"temperature_k": 273.15 + climate[0], "relative_humidity_percent": float(climate[1])}
    image = run(tmp_path, facing(distance, sensor=sensor, atmosphere=air)).variants[0].image
    loss = 100.0 - image.values[1, 1]
    assert loss == pytest.approx(CLIMATES[climate] * distance / 40, rel=0.01)


def test_what_dynamic_range_leaves_at_80_m_in_the_wettest_air(tmp_path):
    """80 dB keep a mirror 20 dB over the floor and a reflectivity of 0.2 12.8 dB.

    50 dB lose both.
    """
    air = {"temperature_k": 308.15, "relative_humidity_percent": 90.0}
    for reflectivity, over in ((1.0, 20.0), (0.2, 12.8)):
        wall = MIRROR | {"center_m": [81.0, 0.0, 1.2], "reflectivity": reflectivity}
        for decibels, expected in ((80.0, over), (50.0, 0.0)):
            sensor = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": decibels}
            image = (
                run(tmp_path, facing(80.0, sensor=sensor, atmosphere=air, targets={"wall": wall}))
                .variants[0]
                .image
            )
            assert image.values[1, 1] == pytest.approx(expected, abs=0.25)
            assert image.layers["below_floor"].values[1, 1] == (decibels == 50.0)


def test_monostatic_is_twice_the_one_way_depth_pixel_by_pixel(tmp_path):
    """The logarithm of P against the passive run's depth, to 1e-6.

    Through the same turbulent air.
    """
    passive = run(tmp_path, scene()).variants[0].radiances
    active = run(
        tmp_path,
        scene(sensor={"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 200.0}),
    ).variants[0]
    power = active.image.layers["received_power"].values
    for flag, reflectivity in ((1, 0.1), (2, 0.2)):
        here = passive.target == flag
        log = np.log(power[here] / (1e-3 * reflectivity))
        assert log == pytest.approx(-2 * passive.optical_depth[0][here], rel=1e-6)
    assert np.all(power[passive.target == 0] == 0)


def test_active_sensors_ask_for_no_temperatures(tmp_path):
    data = scene(
        sensor={"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 80.0},
        ground={"reflectivity": 0.1},
    )
    del data["targets"]["box"]["temperature_k"]
    result = run(tmp_path, data)
    assert "radiance" not in result.to_xarray()
    assert {"received_power", "below_floor"} <= set(result.to_xarray())


def test_a_bistatic_source_beside_the_camera_is_nearly_monostatic(tmp_path):
    sensor = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 200.0}
    mono = run(tmp_path, scene(sensor=sensor)).variants[0]
    beside = sensor | {"arrangement": "bistatic", "transmitter_m": [1.0, -2.0, 4.000001]}
    found = run(tmp_path, scene(sensor=beside)).variants[0]
    same = (mono.sight.target == found.sight.target) & (mono.sight.target > 0)
    assert (
        same.sum() > 0.95 * (mono.sight.target > 0).sum()
    )  # at grazing edges a micrometre decides
    assert found.sight.optical_depth[0][same] == pytest.approx(
        mono.sight.optical_depth[0][same], rel=1e-4
    )


def test_what_is_not_lit_sends_nothing_back(tmp_path):
    """The transmitter stands behind the box: its near side and its shadow on the ground are dark.

    The rest is lit.
    """
    data = scene(
        camera__pixels=[60, 45],
        sensor=ACTIVE | {"dynamic_range_db": 200.0, "arrangement": "bistatic", "transmitter_m": [40.0, 12.0, 6.0]},
    )  # fmt: skip
    found = run(tmp_path, data).variants[0]
    seen = run(tmp_path, scene(camera__pixels=[60, 45])).variants[0].radiances
    lens = oracle.Camera(
        *(
            data["camera"][k]
            for k in ("position_m", "look_at_m", "focal_length_mm", "focal_plane_mm", "pixels")
        )
    )
    box = oracle.Box((25.0, 7.0, 1.0), (3.0, 4.0, 2.0), 30.0)
    camera, transmitter = np.array([1.0, -2.0, 4.0]), np.array([40.0, 12.0, 6.0])
    lit = np.zeros((45, 60), dtype=bool)
    for row, column in np.ndindex(45, 60):
        if seen.target[row, column] == 0:
            continue
        point = camera + float(seen.path_length[row, column]) * lens.ray(row, column)
        way = point - transmitter
        distance = math.sqrt(way @ way)
        hit = box.meet(transmitter, way / distance)
        lit[row, column] = hit is None or hit[0] > distance * (1 - 1e-6)
    assert (lit == (found.image.layers["received_power"].values > 0)).mean() > 0.999
    assert lit.any() and (~lit & (seen.target == 1)).any() and (~lit & (seen.target == 2)).any()
    out = np.linalg.norm([25.0 - 40.0, 7.0 - 12.0, 1.0 - 6.0])
    assert abs(np.median(found.sight.outgoing_length[lit & (seen.target == 2)]) - out) < 5


def test_bistatic_depth_is_that_of_both_ways_through_shared_air(tmp_path):
    """The depth out and back is that of two cameras, one at each end, and theirs vary together.

    Each of five seeds takes three runs: bistatic, from the receiver, and from the transmitter. The
    two ways are at most 6 m apart in air whose eddies are larger.
    """
    base = {
        "camera__position_m": [0.0, 0.0, 1.2],
        "camera__look_at_m": [25.0, 0.0, 1.2],
        "camera__pixels": [1, 1],
        "camera__focal_length_mm": 1000.0,
        "ground": None,
        "targets": {"wall": MIRROR | {"center_m": [26.0, 0.0, 1.2]}},
        "numerics": {"precision": "float64", "error_budget": False},
        "atmosphere__fluctuations__voxel_m": 1.0,
    }
    transmitter = [0.0, 6.0, 1.2]
    bistatic = ACTIVE | {"arrangement": "bistatic", "transmitter_m": transmitter}
    both, back, out = (
        np.array(
            [
                run(tmp_path, scene(**(base | way), atmosphere__fluctuations__seed=seed))
                .variants[0]
                .sight.optical_depth.item()
                for seed in range(5)
            ]
        )
        for way in ({"sensor": bistatic}, {}, {"camera__position_m": transmitter})
    )
    assert both == pytest.approx(back + out, rel=1e-9)
    assert np.corrcoef(back, out)[0, 1] > 0.5


def test_lambertian_surfaces_spread_what_they_reflect(tmp_path):
    """P0 R cos A / (pi r^2), for a wall seen squarely and at 60 degrees."""
    sensor = ACTIVE | {"dynamic_range_db": 200.0, "spreading": "lambert", "aperture_m": 0.3}
    air = {"model": "none", "temperature_k": 290.0, "relative_humidity_percent": 0.0}
    for yaw, cosine in ((0.0, 1.0), (60.0, 0.5)):
        wall = MIRROR | {
            "size_m": [1e-3, 40.0, 40.0],
            "center_m": [40.0, 0.0, 1.2],
            "yaw_deg": yaw,
            "reflectivity": 0.5,
        }
        found = run(
            tmp_path, facing(40.0, sensor=sensor, atmosphere=air, targets={"wall": wall})
        ).variants[0]
        power = found.image.layers["received_power"].values[1, 1]
        area = math.pi / 4 * 0.3**2
        assert power == pytest.approx(1e-3 * 0.5 * cosine * area / (math.pi * 40.0**2), rel=1e-3)


def test_speckle_has_the_contrast_of_its_looks(tmp_path):
    sensor = ACTIVE | {"dynamic_range_db": 100.0, "speckle_looks": 4.0}
    found = run(tmp_path, facing(40.0, sensor=sensor, camera__pixels=[200, 200])).variants[0]
    power = found.image.layers["received_power"].values
    assert power.std() / power.mean() == pytest.approx(1 / math.sqrt(4), rel=0.02)
    assert power.mean() == pytest.approx(1e-3 * np.exp(-found.sight.optical_depth.mean()), rel=0.01)


# --- broadband
# -------------------------------------------------------------------------------------------------------------

BROAD = {"kind": "passive-broadband", "center_ghz": 650.0, "bandwidth_ghz": 100.0}
MILD = {"temperature_k": 293.15, "relative_humidity_percent": 44.0}


@pytest.mark.parametrize(
    ("changes", "expected", "within"),
    [
        ({}, 0.2105, 0.002),
        ({"quadrature": "paper"}, 0.185, 0.004),
        ({"quadrature": "paper", "paper_steps": "trapezoid"}, 0.197, 0.004),
        ({"quadrature": "paper", "paper_steps": "bins"}, 0.227, 0.004),
    ],
)
def test_mean_transmission_of_the_band(tmp_path, changes, expected, within):
    """80 m of uniform air at 20 degrees and 44 %: resolved.

    And the paper's quadratures at their own values (PHYSICS 4).
    """
    wall = MIRROR | {"center_m": [81.0, 0.0, 1.2], "reflectivity": 0.0, "temperature_k": 310.0}
    result = run(
        tmp_path, facing(80.0, sensor=BROAD | changes, atmosphere=MILD, targets={"wall": wall})
    )
    assert np.exp(-result.variants[0].sight.optical_depth[0, 1, 1]) == pytest.approx(
        expected, rel=within
    )
    error = result.error_budget["band-quadrature"]["relative"]
    assert (
        error < 1e-5 if not changes else error == pytest.approx(abs(0.2105 / expected - 1), rel=0.1)
    )


def test_a_resolved_band_is_the_integral(tmp_path):
    """Radiance over the band by brute force, of a warm wall behind 80 m of air.

    As power of a single mode.
    """
    found = run(
        tmp_path, facing(80.0, sensor=BROAD, atmosphere=MILD, numerics={"precision": "float64"})
    ).variants[0]
    hz = np.linspace(600e9, 700e9, 20001)
    grams = 0.44 * oracle.saturation_hpa(293.15) * 1e5 / (461.525 * 293.15)
    depth = oracle.absorption_per_m(hz, 293.15, 1013.25, grams) * 80.0
    air = np.array([oracle.planck(f, 293.15) for f in hz])
    # A mirror of surroundings at air temperature: its reflectivity is 1, so nothing differs from
    # air.
    assert np.abs(found.sight.contrast).max() == 0
    power = np.trapezoid((oracle.C / hz) ** 2 / 2 * air, hz)
    assert found.image.layers["received_power"].values[1, 1] == pytest.approx(power, rel=1e-6)
    wall = MIRROR | {"center_m": [81.0, 0.0, 1.2], "reflectivity": 0.0, "temperature_k": 310.0}
    warm = run(
        tmp_path,
        facing(
            80.0,
            sensor=BROAD,
            atmosphere=MILD,
            targets={"wall": wall},
            numerics={"precision": "float64"},
        ),
    )
    above = np.array([oracle.planck(f, 310.0) for f in hz]) - air
    expected = np.trapezoid((oracle.C / hz) ** 2 / 2 * (air + above * np.exp(-depth)), hz)
    assert warm.variants[0].image.layers["received_power"].values[1, 1] == pytest.approx(
        expected, rel=1e-6
    )


def test_single_mode_at_300_kelvin():
    """0.39 nW over 100 GHz, 1.38e-12 W/K, and so 21.7 K for 3e-11 W (PHYSICS 4)."""
    band = bands.named("flat", 650e9, 100e9)
    hz = np.linspace(band.low_hz, band.high_hz, 2001)
    modes = (radiometry.LIGHT_SPEED / hz) ** 2 / 2
    assert np.trapezoid(modes * radiometry.planck(hz, 300.0), hz) == pytest.approx(
        0.39e-9, rel=0.01
    )
    slope = np.trapezoid(modes * radiometry.planck_slope(hz, 300.0), hz)
    assert slope == pytest.approx(1.38e-12, rel=0.003)
    assert 3e-11 / slope == pytest.approx(21.7, abs=0.05)


def test_noise_of_a_million_pixels(tmp_path):
    """NEP sqrt(B), within 1 %; the same seed gives the same image.

    One detector for all pixels is as much noisier.
    """
    noisy = BROAD | {"noise_equivalent_power_w_rthz": 3e-12, "frame_rate_hz": 100.0}
    data = facing(40.0, sensor=noisy, camera__pixels=[1000, 1000])
    one, again = (run(tmp_path, data).variants[0].image for _ in range(2))
    power = one.layers["received_power"].values
    assert power.std() == pytest.approx(3e-11, rel=0.01)
    assert np.array_equal(power, again.layers["received_power"].values)
    assert one.facts["noise power"] == (pytest.approx(3e-11), "W")
    assert one.facts["NEDT at the sensor"][0] == pytest.approx(21.75, abs=0.1)
    passed = np.exp(
        -float(run(tmp_path, facing(40.0, sensor=BROAD)).variants[0].sight.optical_depth[0, 1, 1])
    )
    assert one.facts["NEDT at the targets"][0] == pytest.approx(21.75 / passed, rel=0.01)
    scanned = run(
        tmp_path,
        facing(40.0, sensor=noisy | {"noise_bandwidth": "scanned"}, camera__pixels=[300, 300]),
    )
    assert scanned.variants[0].image.layers["received_power"].values.std() == pytest.approx(
        3e-11 * 300, rel=0.02
    )
    quiet = run(
        tmp_path,
        facing(40.0, sensor=BROAD | {"noise_equivalent_power_w_rthz": 0.0}, camera__pixels=[9, 9]),
    )
    assert quiet.variants[0].image.values.std() < 1e-6
    assert not quiet.variants[0].image.facts


def test_antenna_temperature_and_geometric_throughput(tmp_path):
    """Both throughputs give nearly the same antenna temperature.

    A geometric one collects A Omega in two polarisations.
    """
    single = run(tmp_path, facing(40.0, sensor=BROAD)).variants[0]
    geometric = run(
        tmp_path, facing(40.0, sensor=BROAD | {"throughput": "geometric", "aperture_m": 0.3})
    ).variants[0]
    kelvin = single.image.values[1, 1]
    # Planck against Rayleigh-Jeans: x / (exp(x) - 1) with x = 0.108 at 650 GHz and 290 K.
    assert kelvin == pytest.approx(290.0 * 0.108 / math.expm1(0.108), rel=0.002)
    assert geometric.image.values[1, 1] == pytest.approx(kelvin, rel=0.002)
    solid_angle = (12.0 / 30000 / 3) * (9.0 / 30000 / 3)
    hz = np.linspace(600e9, 700e9, 1001)
    expected = (
        math.pi / 4 * 0.09 * solid_angle * np.trapezoid([oracle.planck(f, 290.0) for f in hz], hz)
    )
    assert geometric.image.layers["received_power"].values[1, 1] == pytest.approx(
        expected, rel=1e-5
    )


def test_responses(tmp_path):
    """A table that says flat is flat; a Gaussian is its integral."""
    (tmp_path / "flat.csv").write_text(
        "# any\nfrequency_ghz,response\n600,1\n650,1\n700,1\n", encoding="utf-8"
    )
    flat = (
        run(tmp_path, facing(80.0, sensor=BROAD, atmosphere=MILD))
        .variants[0]
        .sight.optical_depth[0, 1, 1]
    )
    table = {"kind": "passive-broadband", "response": "flat.csv"}
    found = (
        run(tmp_path, facing(80.0, sensor=table, atmosphere=MILD))
        .variants[0]
        .sight.optical_depth[0, 1, 1]
    )
    assert found == pytest.approx(flat, rel=1e-5)
    gaussian = run(
        tmp_path,
        facing(
            80.0, sensor=BROAD | {"response": "gaussian", "bandwidth_ghz": 40.0}, atmosphere=MILD
        ),
    )
    hz = np.linspace(590e9, 710e9, 20001)
    grams = 0.44 * oracle.saturation_hpa(293.15) * 1e5 / (461.525 * 293.15)
    passed = np.exp(-80.0 * oracle.absorption_per_m(hz, 293.15, 1013.25, grams))
    weight = 0.5 ** ((hz - 650e9) / 20e9) ** 2
    expected = (weight * passed).sum() / weight.sum()
    assert np.exp(-gaussian.variants[0].sight.optical_depth[0, 1, 1]) == pytest.approx(
        expected, rel=0.002
    )


def test_lines_of_thin_air_are_found():
    """1 hPa: lines a few MHz wide in a band of 100 GHz, against a brute sum at 50 kHz; unguided.

    They are missed.
    """
    air = Air("mpm93", 288.0, 1.0, 0.2)
    view = {
        "air_temperature_k": 288.0,
        "path_m": (10.0, 10.0),
        "absorption": air.absorption,
        "lines_hz": line_centers_ghz() * 1e9,
    }
    band = bands.named("flat", 650e9, 100e9)
    hz = np.linspace(600e9, 700e9, 2000001)
    absorbed = np.trapezoid(1 - np.exp(-10.0 * air.absorption(hz)), hz) / 100e9
    found, blind = (
        bands.resolve(band, SimpleNamespace(**view, line_width_hz=width))
        for width in (line_width_ghz(1.0) * 1e9, 1e12)
    )
    errors = [
        q.weights @ (1 - np.exp(-10.0 * air.absorption(q.frequency_hz))) / 100e9 - absorbed
        for q in (found, blind)
    ]
    assert absorbed > 5e-4
    assert abs(errors[0]) < 1e-8
    assert abs(errors[1]) > 0.9 * absorbed


def test_bands_of_fluctuating_temperature(tmp_path):
    """The sum over the band of separate frequencies, path emission included."""
    warm = {"atmosphere__fluctuations__temperature_sigma_k": 1.0, "camera__pixels": [6, 4]}
    band = run(tmp_path, scene(**warm, sensor=BROAD | {"quadrature": "paper"})).variants[0].sight
    single = (
        run(tmp_path, scene(**warm, sensor__frequency_ghz=[600.0, 625.0, 650.0, 675.0, 700.0]))
        .variants[0]
        .sight
    )
    weights = (oracle.C / single.frequency_hz) ** 2
    expected = np.einsum("f,fyx->yx", weights, single.contrast) / weights.sum()
    assert band.contrast[0] == pytest.approx(expected, rel=1e-4, abs=1e-6 * np.abs(expected).max())


# --- bad input
# -------------------------------------------------------------------------------------------------------------

REFUSED = {
    "empty band": (BROAD | {"bandwidth_ghz": 0.0}, "bandwidth_ghz: must be above 0 GHz"),
    "band below 0": (BROAD | {"center_ghz": 30.0}, "make a band of -20 to 80 GHz; it must lie above 0"),
    "negative NEP": (BROAD | {"noise_equivalent_power_w_rthz": -1.0}, "must be at least 0 W/sqrt(Hz)"),
    "no band": ({"kind": "passive-broadband"}, "needs center_ghz and bandwidth_ghz"),
    "two bands": ({"kind": "passive-broadband", "response": "x.csv", "center_ghz": 650.0}, "remove center_ghz"),
    "no table": ({"kind": "passive-broadband", "response": "no.csv"}, "no.csv: cannot be read"),
    "outside": ({"kind": "passive-broadband", "response": "../no.csv"}, "leads out of the scenario's folder"),
    "overlapping": ({"kind": "passive-broadband", "response": "back.csv"}, "its frequencies do not ascend"),
    "broken table": ({"kind": "passive-broadband", "response": "words.csv"}, "words.csv:3: not comma-separated numbers"),
    "geometric": (BROAD | {"throughput": "geometric"}, '"geometric" needs aperture_m'),
    "0 dB": (ACTIVE | {"dynamic_range_db": 0.0}, "must be above 0 dB, not 0"),
    "400 dB": (ACTIVE | {"dynamic_range_db": 400.0}, "must be at most 300 dB, not 400"),
    "transmitter in the box": (
        ACTIVE | {"arrangement": "bistatic", "transmitter_m": [25.0, 7.0, 1.0]},
        'the transmitter stands inside the target "box"',
    ),
    "transmitter below": (
        ACTIVE | {"arrangement": "bistatic", "transmitter_m": [0.0, 0.0, -1.0]},
        "not above the ground",
    ),
    "no transmitter": (ACTIVE | {"arrangement": "bistatic"}, "transmitter_m"),
    "no detector": ({"kind": "raster-scan", "dwell_s": 1.0}, "needs a table [sensor.detector]"),
    "bad detector": (
        {"kind": "raster-scan", "dwell_s": 1.0, "detector": {"kind": "passive-spectral", "frequency": 1.0}},
        "did you mean frequency_ghz?",
    ),
    "no dwell": ({"kind": "raster-scan", "detector": {"kind": "passive-spectral", "frequency_ghz": 650.0}}, "needs dwell_s"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused(tmp_path, case):
    (tmp_path / "back.csv").write_text("700,1\n600,1\n", encoding="utf-8")
    (tmp_path / "words.csv").write_text("frequency,response\n600,1\nlater,1\n", encoding="utf-8")
    sensor, expected = REFUSED[case]
    with pytest.raises(ScenarioError) as caught:
        run(tmp_path, scene(sensor=sensor))
    assert expected in str(caught.value)


def test_radiances_of_a_band_know_their_nodes(tmp_path):
    sight = run(tmp_path, facing(40.0, sensor=BROAD)).variants[0].radiances
    assert isinstance(sight, Radiances)
    assert sight.weights.shape == (1, len(sight.nodes_hz))
    assert sight.frequency_hz == pytest.approx(650e9, rel=0.02)
    assert dataclasses.is_dataclass(sight)


def test_figures_7_to_9_show_what_the_paper_says():
    """Active: figure 9 loses the wettest 80 m panel entirely, figure 8 none. Passive.

    Noise hides more, farther and wetter.
    """
    for name, lost in (("figure8", 0), ("figure9", 1)):
        result = pipeline.run(name)
        gone = [bool(v.image.layers["below_floor"].values.all()) for v in result.variants]
        assert sum(gone) == lost
        assert gone[-1] == bool(lost)
    seven = pipeline.run("figure7")
    strength = [
        v.sight.brightness_temperature_contrast[0].std() / v.image.facts["NEDT at the sensor"][0]
        for v in seven.variants
    ]
    assert strength[0] > strength[1] > strength[2] > strength[3]
    assert all(near > far for near, far in zip(strength[:4], strength[4:], strict=True))
    assert strength[0] > 0.8 and strength[7] < 0.01
