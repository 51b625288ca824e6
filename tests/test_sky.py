"""The sky: its solver against printed tables and a slow twin, and what is seen of it in images."""

from __future__ import annotations

import csv
import json
from functools import cache

import h5py
import numpy as np
import oracle
import pytest
from conftest import ROOT
from scenes import ACTIVE, BROAD, MOIST, run, scene, write
from test_constituents import SCAN
from test_mirrors import BOARD, STILL, WARM, picture

from thzcl import pipeline
from thzcl.air import composition, humidity, profile, radiometry, sky
from thzcl.air.mean import Air
from thzcl.air.sky import Column
from thzcl.errors import PluginFailure, ScenarioError
from thzcl.plan import report
from thzcl.surfaces.sky import Sky

GHZ = (94.0, 220.0, 340.0, 650.0)
HZ = np.array(GHZ) * 1e9
# Brightness temperatures (K) of the clear sky by frequency, at 0, 60 and 80 degrees from the
# zenith, and depths to the zenith: MPM93, plane-parallel, 2.725 K beyond. PHYSICS_NEXT, section D.
CLEAR = {
    "us-standard": (
        [(49.54, 88.12, 184.02), (184.10, 248.08, 284.88), (277.15, 285.94, 287.54)],
        (287.67, 287.94, 288.11),
        (0.1871, 1.060, 3.738, 26.59),
    ),
    "midlatitude-summer": (
        [(90.34, 151.02, 255.06), (259.73, 288.74, 293.56), (292.94, 293.68, 294.03)],
        (294.05, 294.13, 294.18),
        (0.3680, 2.239, 7.84, 54.6),
    ),
    "midlatitude-winter": (
        [(36.29, 65.20, 145.17), (137.89, 203.92, 265.47), (246.61, 268.50, 271.66)],
        (271.77, 271.99, 272.13),
        (0.1360, 0.709, 2.467, 17.65),
    ),
    "subarctic-winter": (
        [(24.19, 43.43, 102.49), (84.12, 138.27, 228.33), (187.72, 238.06, 257.59)],
        (257.68, 257.49, 257.30),
        (0.0883, 0.380, 1.292, 9.24),
    ),
    "tropical": (
        [(121.25, 191.60, 281.35), (284.64, 297.34, 299.10), (298.66, 299.20, 299.53)],
        (299.56, 299.63, 299.68),
        (0.528, 3.26, 11.3, 77.8),
    ),
}
STANDARD = {"temperature_k": 288.2, "pressure_hpa": 1013.0, "absolute_humidity_g_m3": 5.9}


def column(name="us-standard", **options):
    """The air of a profile alone, seen from its ground."""
    rows = profile.shipped(name)
    ground = rows.at(0.0)
    grams = float(humidity.absolute_humidity(ground.vapour_hpa, ground.temperature_k))
    state = float(ground.temperature_k), float(ground.pressure_hpa), grams
    return Column(Air((composition.part("mpm93"),), *state), rows, 0.0, **options)


def kelvin(above, hz, contrast):
    return radiometry.brightness_temperature(
        hz[:, None], contrast + radiometry.planck(hz, above.air.temperature_k)[:, None]
    )


def seen(above, hz, zenith_deg):
    contrast, depth = sky.seen_above(above, hz, np.cos(np.radians(zenith_deg)), 0.0)
    return kelvin(above, hz, contrast), depth


@pytest.mark.parametrize("name", CLEAR)
def test_the_clear_sky_is_that_of_the_table(name):
    """To 0.3 K by the task, and in fact to 0.03 K."""
    rows, last, depths = CLEAR[name]
    found, depth = seen(column(name, plane=True), HZ, np.array([0.0, 60.0, 80.0]))
    assert np.abs(found - np.array([*rows, last])).max() < 0.03
    assert depth[:, 0] == pytest.approx(depths, rel=2e-3)


def test_near_the_horizon_the_earth_is_round():
    """At 94 GHz plane-parallel errs by 1.1 K at 10 degrees and by 3 K at 5 degrees."""
    away, hz = np.array([80.0, 85.0]), HZ[:1]
    curved, plane = (seen(column(plane=flat), hz, away)[0][0] for flat in (False, True))
    assert curved[0] == pytest.approx(182.96, abs=0.03)
    assert plane - curved == pytest.approx([1.07, 3.0], abs=0.15)


def test_faces_see_the_share_of_their_tilt():
    """Means over the hemisphere, and over the sky's half before a wall, as radiances."""
    hz, above = np.array([94.0, 140.0, 220.0, 340.0, 650.0]) * 1e9, column()
    sine, weight = sky.tilted(np.array([1.0, 0.0]))
    assert weight.sum(axis=1) == pytest.approx([1.0, 1.0])
    up = sine > 0
    contrast = sky.seen_above(above, hz, sine[up], 0.0)[0]
    flat, wall = (contrast @ row[up] / row[up].sum() for row in weight)
    expected = {
        "flat": (flat, (79.8, 136.8, 225.1, 283.2, 287.85)),
        "wall": (wall, (128.9, 186.9, 254.0, 285.7, 287.98)),
    }
    for half, table in expected.values():
        assert kelvin(above, hz, half[:, None])[:, 0] == pytest.approx(table, abs=0.3)


@pytest.mark.parametrize("upward", [-1.0, -0.6, 0.0, 0.3, 0.9, 1.0])
def test_weights_of_a_face_are_those_of_its_cosine(upward):
    """Against random directions of a hemisphere, of a radiance that varies with elevation."""
    rng = np.random.default_rng(4)
    d = rng.normal(size=(2_000_000, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    normal = np.array([np.sqrt(1 - upward**2), 0.0, upward])
    cosine = np.maximum(d @ normal, 0.0)

    def law(sine):
        return np.where(sine > 0, np.exp(-0.2 / np.maximum(sine, 1e-9)), -0.4 * sine)

    sine, weight = sky.tilted(np.array([upward]))
    expected = 4 * (cosine * law(d[:, 2])).mean()
    assert weight[0] @ law(sine) == pytest.approx(expected, abs=2e-3)


def dense(ghz, kelvin, hpa, vapour, model):
    """dB/km of arrays of air at more than 0.7 hPa."""

    class Pressure(np.ndarray):
        """Compares as a whole."""

        def __lt__(self, other):
            return bool(np.asarray(self).min() < other)

    return sum(oracle.GASES[model](ghz, kelvin, hpa.view(Pressure), vapour))


@cache
def slow_rows():
    text = (ROOT / "thzcl" / "air" / "afgl_profiles.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    return [row for row in rows if row["profile"] == "us-standard"]


def slow_sky(hz, degrees, height_m, air_k, grams, scene_m, even_m, step_m=2.0, model="mpm93"):
    """Radiance of the sky in small steps along a straight ray over a round Earth.

    The scene's air, even up to a height, is blended into the US standard atmosphere.
    """
    rows = slow_rows()
    z, p, t = (
        np.array([float(row[key]) for row in rows])
        for key in ("height_km", "pressure_hpa", "temperature_k")
    )
    e = np.array([float(row["h2o_ppmv"]) for row in rows]) * 1e-6 * p
    z = z * 1e3
    steps = np.arange(0, 3e3, step_m), np.arange(3e3, 2e4, 10 * step_m), np.arange(2e4, 50e3, 50.0)
    edges = height_m + np.concatenate(steps)
    middle = (edges[1:] + edges[:-1]) / 2
    radius = 6371e3
    start = (radius + height_m) * np.sin(np.radians(degrees))
    b2 = ((radius + height_m) * np.cos(np.radians(degrees))) ** 2
    length = np.diff(np.sqrt(np.maximum((radius + edges) ** 2 - b2, 0.0)) - start)
    part = np.exp(-np.maximum(middle - scene_m, 0) / 1000)
    there_e = np.exp(np.interp(scene_m, z, np.log(e)))
    own_e = grams * 461.525 * air_k / 1e5
    kelvin = np.interp(middle, z, t) + (air_k - np.interp(scene_m, z, t)) * part
    hpa = np.exp(np.interp(middle, z, np.log(p)))
    vapour = np.exp(np.interp(middle, z, np.log(e))) * (own_e / there_e) ** part
    even = middle < even_m
    kelvin, hpa = np.where(even, air_k, kelvin), np.where(even, 1013.25, hpa)
    vapour = np.where(even, own_e, vapour)
    low = hpa > 1.0  # the twin takes numbers where lines are Doppler-broadened
    kelvin, hpa, vapour, length = kelvin[low], hpa[low], vapour[low], length[low]
    db_km = np.asarray(dense(hz / 1e9, kelvin, hpa, vapour, model))
    tau = db_km / 4342.9448 * length
    before = np.concatenate([[0.0], np.cumsum(tau)])
    source = 2 * oracle.H * hz**3 / oracle.C**2 / np.expm1(oracle.H * hz / oracle.K / kelvin)
    return (source * (np.exp(-before[:-1]) - np.exp(-before[1:]))).sum() + oracle.planck(
        hz, 2.725
    ) * np.exp(-before[-1])


LOOKING_UP = {
    "camera__position_m": [0.0, 0.0, 20.0],
    "camera__look_at_m": [10.0, 0.0, 24.0],
    "camera__focal_length_mm": 10.0,
    "camera__pixels": [3, 9],
    "atmosphere": {"temperature_k": 293.0, "absolute_humidity_g_m3": 4.0},
    "ground": None,
    "targets": {},
    "sky": {"profile": "us-standard"},
    "background": {"max_range_m": 400.0},
}


@pytest.mark.parametrize("ghz", GHZ)
def test_rays_that_meet_nothing_see_the_sky(tmp_path, ghz):
    """Uniform air up to 50 m above the camera or max_range_m, then the sky as seen from there."""
    data = scene(**LOOKING_UP, sensor__frequency_ghz=ghz)
    found = run(tmp_path, data)
    hz = ghz * 1e9
    camera = oracle.Camera(
        *(data["camera"][key] for key in ("position_m", "look_at_m")),
        *(data["camera"][key] for key in ("focal_length_mm", "focal_plane_mm", "pixels")),
        (0, 0, 1),
    )
    image = found.variants[0].radiances.brightness_temperature[0]
    length = found.variants[0].radiances.path_length
    tried = set()
    for row in range(9):
        up = camera.ray(row, 1)[2]
        if up <= 0:
            assert image[row, 1] == pytest.approx(293.0, abs=0.02)
            continue
        reached = min(400.0, 50.0 / up)
        tried.add(reached == 400.0)
        assert length[row, 1] == pytest.approx(reached, rel=1e-6)
        radiance = slow_sky(hz, np.degrees(np.arcsin(up)), 20.0, 293.0, 4.0, 20.0, 70.0)
        expected = oracle.brightness_temperature(hz, radiance)
        assert image[row, 1] == pytest.approx(expected, abs=0.02), (row, up)
    assert tried == {True, False}


FACE = {
    "kind": "box",
    "center_m": [10.0, 0.0, 1.0],
    "size_m": [2.0, 2.0, 2.0],
    "temperature_k": 288.2,
    "reflectivity": 0.2,
}


@pytest.mark.parametrize(
    ("position_m", "moved"),
    [([10.0, 0.0, 6.0], (42.0, 13.0, 1.0)), ([4.0, 0.0, 1.0], (16.0, 3.4, 0.25))],
    ids=["upwards", "wall"],
)
def test_what_a_face_reflects_of_the_sky(tmp_path, position_m, moved):
    """R = 0.2 at 94, 220 and 340 GHz, in kelvins: PHYSICS_NEXT, sections 0 and D."""
    data = scene(
        camera__position_m=position_m,
        camera__look_at_m=[10.0, 0.0, 1.0],
        camera__focal_length_mm=1000.0,
        camera__pixels=[2, 2],
        atmosphere=STANDARD,
        ground=None,
        targets={"face": FACE},
        sky={"profile": "us-standard"},
        sensor__frequency_ghz=[94.0, 220.0, 340.0],
    )
    black, under = (
        run(tmp_path, data, settings={"background.environment": kind})
        .variants[0]
        .radiances.brightness_temperature_contrast.mean(axis=(1, 2))
        for kind in ("air", "sky")
    )
    assert black == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert black - under == pytest.approx(moved, rel=0.04)


@pytest.mark.parametrize("air", [STANDARD, {"temperature_k": 272.2, "absolute_humidity_g_m3": 2.0}])
def test_the_sky_does_not_depend_on_the_longest_range(tmp_path, air):
    """To 0.05 K from 3 degrees on, by the rule of 50 m."""
    data = scene(**(LOOKING_UP | {"atmosphere": air}), sensor__frequency_ghz=[94.0, 220.0, 340.0])
    data["camera"] |= {"look_at_m": [10.0, 0.0, 22.5], "pixels": [1, 48]}
    up = np.array([oracle_ray(data, row)[2] for row in range(48)])
    images = [
        run(tmp_path, data, settings={"background.max_range_m": metres})
        .variants[0]
        .radiances.brightness_temperature[:, up > np.sin(np.radians(3.0)), 0]
        for metres in (50.0, 100.0, 300.0, 1000.0, 20000.0)
    ]
    assert np.ptp(images, axis=0).max() < 0.05


def oracle_ray(data, row):
    camera = data["camera"]
    keys = ("position_m", "look_at_m", "focal_length_mm", "focal_plane_mm", "pixels")
    return oracle.Camera(*(camera[key] for key in keys), (0, 0, 1)).ray(row, 0)


ISOTHERMAL = "height_m,pressure_hpa,temperature_k,relative_humidity_percent\n" + "".join(
    f"{z},{1013.25 * np.exp(-z / 8000):.6f},290,70\n" for z in range(0, 20001, 1000)
)


@pytest.mark.parametrize("atmosphere", [MOIST, STILL], ids=["even", "turbulent"])
def test_all_of_one_temperature_shows_nothing(tmp_path, atmosphere):
    """Exactly: at 557 GHz nothing from beyond the air gets through."""
    (tmp_path / "even.csv").write_text(ISOTHERMAL, encoding="utf-8")
    data = scene(
        atmosphere=atmosphere,
        ground__temperature_k=290.0,
        targets__box__temperature_k=290.0,
        background__environment="sky",
        sky={"profile": "file", "file": "even.csv"},
        sensor__frequency_ghz=556.936,
        camera__look_at_m=[30.0, 8.0, 5.0],
    )
    found = run(tmp_path, data).variants[0].radiances
    assert {0, 1, 2} == set(found.target.ravel().tolist())
    assert (found.contrast == 0.0).all()


def test_the_ground_is_seen_in_faces_that_look_down():
    """Black ground of the air's temperature, or a floor that reflects the sky itself."""
    from thzcl.surfaces.sky import Floor

    above, hz = column(), HZ[:1]
    air_k = above.air.temperature_k
    down = np.array([-1.0])
    near = Sky(above, None).scattered(hz, down, 0.0, air_k)
    assert near == 0.0
    warm = Sky(above, Floor(300.0, 0.0)).scattered(hz, down, 0.0, air_k)
    assert warm[0, 0] == pytest.approx(radiometry.planck_difference(hz, 300.0, air_k)[0])
    mirror = Sky(above, Floor(300.0, 1.0)).scattered(hz, down, 0.0, air_k)
    up = Sky(above, None).scattered(hz, -down, 0.0, air_k)
    assert mirror == pytest.approx(up)


UNDER = {"sky": {"profile": "us-standard"}, "background__environment": "sky"}
MANY = {"kind": "passive-spectral", "frequency_ghz": [94.0, 140.0, 220.0]}
OPTICS = {"aperture_m": 0.3}
PAIRS = {
    "even air": {"atmosphere": STANDARD},
    "turbulent air": {"atmosphere": STILL},
    "warm air": {"atmosphere": WARM},
    "several frequencies": {"atmosphere": STILL, "sensor": MANY},
    "several frequencies in warm air": {"atmosphere": WARM, "sensor": MANY},
    "a band": {"sensor": BROAD | {"center_ghz": 220.0, "bandwidth_ghz": 20.0}},
    "a band in warm air": {
        "atmosphere": WARM,
        "sensor": BROAD | {"center_ghz": 220.0, "bandwidth_ghz": 20.0},
    },
    "float64": {"numerics": {"precision": "float64"}},
    "samples": {"camera__samples_per_pixel": 4},
    "a stride": {"camera__pixels": [64, 48], "numerics": {"ray_stride": 2}},
    "a picture": {"targets__board": BOARD},
    "a picture in warm air": {"targets__board": BOARD, "atmosphere": WARM},
    "optics": {"sensor__optics": OPTICS, "camera__pixels": [12, 9]},
    "the sky behind alone": {"background__environment": "air"},
    "the sky in surfaces alone": {"background__temperature_k": 250.0},
    "no ground": {"ground": None},
}


@pytest.mark.parametrize("changes", PAIRS.values(), ids=PAIRS)
def test_the_sky_joins_every_feature(tmp_path, changes):
    """The budget's twin solves for each ray by itself, and knows no look-up."""
    picture(tmp_path)
    look = {"camera__look_at_m": [30.0, 8.0, 5.0], "sensor__frequency_ghz": 94.0}
    data = scene(**(look | UNDER | changes))
    found = run(tmp_path, data)
    assert found.error_budget["arithmetic"]["relative"] < 2e-6
    assert found.seconds["sky"] > 0


def test_the_budget_sees_a_sky_that_is_too_coarse(tmp_path, monkeypatch):
    from thzcl.surfaces import mirrors

    monkeypatch.setattr(mirrors, "FEWEST", 3)
    monkeypatch.setattr(mirrors, "MOST", 3)
    look = {"camera__look_at_m": [30.0, 8.0, 5.0], "sensor__frequency_ghz": 94.0}
    budget = run(tmp_path, scene(**(look | UNDER))).error_budget
    assert budget["arithmetic"]["relative"] > 1e-3


def test_a_scan_and_realisations_see_the_same_sky(tmp_path):
    """In air that fluctuates by next to nothing they see what a snapshot sees."""
    calm = STILL | {"fluctuations": STILL["fluctuations"] | {"sigma_percent": 1e-4}}
    wind = calm | {"fluctuations": calm["fluctuations"] | {"wind_m_s": [2.0, 1.0, 0.0]}}
    look = {"camera__look_at_m": [30.0, 8.0, 5.0], "sensor__frequency_ghz": 94.0}
    still = run(tmp_path, scene(**(look | UNDER), atmosphere=calm))
    passive = {"kind": "passive-spectral", "frequency_ghz": 94.0}
    scan = SCAN | {"detector": passive}
    for changes in (
        {"atmosphere": wind, "sensor": scan},
        {"atmosphere": calm, "numerics": {"realizations": 2}},
    ):
        found = run(tmp_path, scene(**(look | UNDER | changes)))
        a, b = (one.variants[0].radiances.brightness_temperature for one in (still, found))
        assert np.abs(a - b).max() < 2e-3


def test_an_active_sensor_does_not_see_the_sky(tmp_path):
    data = scene(sensor=ACTIVE, sky={"profile": "tropical"})
    found, plain = run(tmp_path, data), run(tmp_path, scene(sensor=ACTIVE))
    assert any("[sky] is not used" in note for note in found.warnings)
    assert (found.variants[0].image.values == plain.variants[0].image.values).all()
    assert "active sensor" in {o["stage"]: o["reason"] for o in found.left_out}["sky"]


def test_variants_have_skies_of_their_own(tmp_path):
    names = "tropical", "subarctic-winter"
    variants = [{"name": name, "set": {"sky.profile": name}} for name in names]
    data = scene(**LOOKING_UP, sensor__frequency_ghz=94.0, variants=variants)
    both = run(tmp_path, data)
    for one in both.variants:
        alone = run(tmp_path, data, variants=[one.name]).variants[0]
        assert (alone.radiances.contrast == one.radiances.contrast).all()
    first, second = (one.radiances.brightness_temperature.min() for one in both.variants)
    assert first > second + 5


def test_without_a_sky_nothing_of_it_is_done(tmp_path):
    found = run(tmp_path, scene())
    assert "sky" not in found.seconds
    assert "no [sky]" in {o["stage"]: o["reason"] for o in found.left_out}["sky"]
    assert not any("CEILING" in options for options in found.build_options)


# --- what else is in the air


@pytest.fixture
def lower(dust, monkeypatch):
    """Lets the layer of dust end at a height."""
    del dust  # it is installed
    kind = composition.constituent_class("dust")

    def ends_at(metres):
        monkeypatch.setattr(kind, "layer_top_m", metres)
        composition.layer_top_m.cache_clear()
        sky.levels.cache_clear()
        sky._layers.cache_clear()  # noqa: SLF001 (which a column's equal would find)

    yield ends_at
    ends_at(1000.0)


def dusty(**changes):
    air = STANDARD | {"dust": {"per_km": 0.5}}
    data = LOOKING_UP | {"sky": {"profile": "us-standard"}, "atmosphere": air} | changes
    return scene(**data, sensor__frequency_ghz=[94.0, 220.0])


@pytest.mark.parametrize("top_m", [1000.0, 300.0, 62.5])
def test_a_layer_adds_its_depth_up_to_its_top(tmp_path, lower, top_m):
    lower(top_m)
    (told,) = report.as_json(pipeline.prepare(write(tmp_path, dusty())))["sky"]
    (clear,) = report.as_json(pipeline.prepare(write(tmp_path, dusty(atmosphere=STANDARD))))["sky"]
    more = np.subtract(told["zenith_depth"], clear["zenith_depth"])
    assert more == pytest.approx(0.5e-3 * (top_m - 20.0), abs=1e-4)
    assert told["even_air_to_m"] == min(70.0, top_m)


@pytest.mark.parametrize("top_m", [1000.0, 45.0])
def test_rays_leave_the_scene_at_the_lowest_top(tmp_path, lower, top_m):
    """What is seen stays what the solver says for the camera."""
    lower(top_m)
    found = run(tmp_path, dusty(camera__pixels=[1, 9]))
    lengths = found.variants[0].radiances.path_length[:, 0]
    sine = np.array([oracle_ray(dusty(camera__pixels=[1, 9]), row)[2] for row in range(9)])
    up = sine > 0.2
    assert lengths[up] == pytest.approx((min(70.0, top_m) - 20.0) / sine[up], rel=1e-6)
    plan = pipeline.prepare(write(tmp_path, dusty()))
    above = plan.variants[0].image.sources.behind.sky.column
    hz = np.array([94e9, 220e9])
    expected = kelvin(above, hz, sky.seen_above(above, hz, sine[up], 20.0)[0])
    image = found.variants[0].radiances.brightness_temperature[:, up, 0]
    assert image == pytest.approx(expected, abs=2e-3)
    assert found.error_budget["arithmetic"]["relative"] < 2e-6


def test_a_scene_above_a_layer_is_refused(tmp_path, lower):
    lower(15.0)
    with pytest.raises(ScenarioError, match="a layer of the air ends at 15 m"):
        pipeline.prepare(write(tmp_path, dusty()))


@pytest.mark.parametrize("top_m", ["high", True, 0.0, -3.0, float("nan")])
def test_a_top_that_is_no_height_is_a_broken_contract(tmp_path, lower, top_m):
    lower(top_m)
    with pytest.raises(PluginFailure, match="layer_top_m"):
        pipeline.prepare(write(tmp_path, dusty()))


def test_another_gas_has_another_sky(tmp_path):
    """Zenith at 94 and 220 GHz in the US standard atmosphere: 49.5 and 184.1 K by MPM93."""
    data = scene(**(UNDER | {"atmosphere": STANDARD, "sensor__frequency_ghz": [94.0, 220.0]}))
    found = {}
    for model in ("mpm93", "p676-13", "r24"):
        data["atmosphere"] = STANDARD | {"model": model}
        (told,) = report.as_json(pipeline.prepare(write(tmp_path, data)))["sky"]
        found[model] = [row[0] for row in told["brightness_temperature_k"]]
    assert found["mpm93"] == pytest.approx([49.5, 184.1], abs=0.2)
    assert found["p676-13"] == pytest.approx([47.3, 169.9], abs=0.2)
    assert found["r24"] == pytest.approx([45.6, 161.5], abs=0.2)


# --- notes and warnings


def notes(folder, data):
    return " ".join(run(folder, data, settings={"numerics.error_budget": False}).warnings)


def test_a_sky_that_lacks_is_told_in_kelvins(tmp_path):
    """Where it would change what is seen by more than one kelvin, and only there."""
    clear = LOOKING_UP | {"sky": None}
    assert "no [sky]: outdoors, rays that meet nothing" in notes(
        tmp_path, scene(**clear, sensor__frequency_ghz=[94.0, 650.0])
    )
    assert "[sky]" not in notes(tmp_path, scene(**clear, sensor__frequency_ghz=650.0))
    given = clear | {"background": {"temperature_k": 30.0}}
    assert "[sky]" not in notes(tmp_path, scene(**given, sensor__frequency_ghz=94.0))
    assert "reflections in surfaces" in notes(tmp_path, scene(sensor__frequency_ghz=94.0))
    black = {"targets__box__reflectivity": 0.0, "ground__reflectivity": 0.0}
    assert "reflections" not in notes(tmp_path, scene(**black, sensor__frequency_ghz=94.0))
    none = {"background__environment": "none"}
    assert "reflections" not in notes(tmp_path, scene(**none, sensor__frequency_ghz=94.0))


def test_a_sky_in_one_place_only_is_told(tmp_path):
    behind = notes(tmp_path, scene(sky={"profile": "tropical"}, sensor__frequency_ghz=94.0))
    assert 'environment = "sky" lets them reflect it' in behind
    look = {"background__temperature_k": 250.0, "sensor__frequency_ghz": 94.0}
    assert "temperature_k wins" in notes(tmp_path, scene(**(UNDER | look)))
    high = {"atmosphere__pressure_hpa": 700.0, "sensor__frequency_ghz": 94.0}
    assert "the scene's pressure is 700 hPa" in notes(tmp_path, scene(**(UNDER | high)))


def test_a_plan_tells_the_sky_by_elevation(tmp_path, thzcl_command):
    data = scene(**(UNDER | {"atmosphere": STANDARD, "sensor__frequency_ghz": [94.0, 220.0]}))
    data["camera"]["position_m"][2] = 1.0
    (told,) = report.as_json(pipeline.prepare(write(tmp_path, data)))["sky"]
    at = told["elevation_deg"].index(90.0), told["elevation_deg"].index(10.0)
    found = np.array(told["brightness_temperature_k"])[:, at]
    assert found == pytest.approx(np.array([[49.54, 182.96], [184.10, 284.84]]), abs=0.1)
    assert told["zenith_depth"] == pytest.approx([0.1871, 1.060], rel=3e-3)
    assert told["seen_in"] == ["behind", "scattered"]
    text = thzcl_command("plan", write(tmp_path, data)).stdout
    assert "sky" in text
    assert "elevation" in text
    assert "49." in text
    plain = report.as_json(pipeline.prepare(write(tmp_path, scene())))
    assert plain["sky"] == []


# --- profiles in files

COLUMNS = "height_km,pressure_hpa,temperature_k,h2o_ppmv"


def as_file(name="us-standard"):
    """A shipped profile as a user's file."""
    rows = slow_rows() if name == "us-standard" else []
    return "\n".join([COLUMNS, *(",".join(row[key] for key in COLUMNS.split(",")) for row in rows)])


def with_profile(folder, text):
    (folder / "profile.csv").write_text(text, encoding="utf-8")
    return scene(
        **(LOOKING_UP | {"sky": {"profile": "file", "file": "profile.csv"}}),
        sensor__frequency_ghz=94.0,
    )


def test_a_file_holds_what_is_shipped(tmp_path):
    own = run(tmp_path, with_profile(tmp_path, as_file() + "\n"))
    shipped = run(tmp_path, scene(**LOOKING_UP, sensor__frequency_ghz=94.0))
    a, b = (one.variants[0].radiances.brightness_temperature for one in (own, shipped))
    assert a == pytest.approx(b, abs=1e-4)


@pytest.mark.parametrize(
    ("measure", "values"),
    [
        ("relative_humidity_percent", (50.0, 40.0)),
        ("vapour_pressure_hpa", (8.521, 4.924)),
        ("absolute_humidity_g_m3", (6.406, 3.788)),
    ],
)
def test_humidities_of_a_file_agree(tmp_path, measure, values):
    text = f"height_m,pressure_hpa,temperature_k,{measure}\n0,1013,288.2,{values[0]}\n"
    (tmp_path / "p.csv").write_text(f"{text}1000,899,281.7,{values[1]}\n", encoding="utf-8")
    hpa = profile.read(tmp_path / "p.csv").vapour_hpa.array
    assert hpa == pytest.approx([8.52, 4.43 if measure.startswith("rel") else 4.92], rel=0.02)


ROWS = ["0,1013,288.2,5000", "1,899,281.7,4000", "5,540,255.7,1000", "10,265,223.3,100"]
WRONG = {
    "a gap": ("1,,281.7,4000", "csv:3: pressure_hpa: a gap, not a number"),
    "a word": ("1,899,warm,4000", "csv:3: temperature_k: warm, not a number"),
    "NaN": ("1,899,nan,4000", "csv:3: temperature_k: not finite"),
    "a short line": ("1,899,281.7", "csv:3: 3 columns, the first line names 4"),
    "descending heights": ("-1,1100,281.7,4000", "csv:3: heights must ascend"),
    "equal heights": ("0,899,281.7,4000", "csv:3: heights must ascend"),
    "rising pressure": ("1,1014,281.7,4000", "csv:3: pressure must fall"),
    "degrees Celsius": ("1,899,8.5,4000", "csv:3: temperature_k outside 100 to 400 K"),
    "negative humidity": ("1,899,281.7,-1", "csv:3: humidity must not be negative"),
    "more vapour than air": ("1,899,281.7,2e6", "csv:3: more vapour than total pressure"),
}


@pytest.mark.parametrize("row", WRONG)
def test_a_profile_that_cannot_be_is_refused(tmp_path, thzcl_command, row):
    line, expected = WRONG[row]
    text = "\n".join([COLUMNS, ROWS[0], line, *ROWS[2:]])
    data = with_profile(tmp_path, text)
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, data))
    assert expected in str(caught.value)
    assert thzcl_command("check", write(tmp_path, data)).returncode == 2


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        (COLUMNS, "0 rows; a profile has two or more"),
        ("height_km,pressure_hpa,temperature_k", "csv:1: no column of humidity"),
        (COLUMNS + ",height_m", "csv:1: 2 columns of height"),
        ("height_km,temperature_k,h2o_ppmv", "csv:1: no column pressure_hpa"),
        ("\n".join([COLUMNS, *ROWS[1:]]), "csv:2: begins at 1000 m"),
        ("\n".join([COLUMNS, ROWS[0], "0.06,1005,288,5000"]), "csv:3: ends at 60 m, below"),
        ("\n".join([COLUMNS, ROWS[0], "11,230,217,50"]), "csv:3: a gap of more than 10 km"),
    ],
)
def test_a_file_that_is_no_profile_is_refused(tmp_path, text, expected):
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, with_profile(tmp_path, text)))
    assert expected in str(caught.value)


def test_a_file_is_a_regular_one_of_bounded_size(tmp_path):
    data = with_profile(tmp_path, as_file())
    for name, expected in (("missing.csv", "No such file"), (".", "a folder")):
        data["sky"]["file"] = name
        with pytest.raises(ScenarioError, match=expected):
            pipeline.prepare(write(tmp_path, data))
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(5_000_000)
    data["sky"]["file"] = "large.csv"
    with pytest.raises(ScenarioError, match="larger than 4 MB"):
        pipeline.prepare(write(tmp_path, data))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"background__environment": "sky"}, '"sky" needs a sky'),
        ({"sky": {"profile": "file"}}, "go together"),
        ({"sky": {"profile": "tropical", "file": "a.csv"}}, "go together"),
        ({"sky": {"profile": "arctic"}}, "must be 'us-standard'"),
        ({"sky": {}}, "profile: missing"),
    ],
)
def test_a_sky_that_makes_no_sense_is_refused(tmp_path, changes, expected):
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, scene(**changes)))
    assert expected in str(caught.value)


def test_the_file_of_a_result_repeats_the_sky(tmp_path):
    data = scene(**LOOKING_UP, sensor__frequency_ghz=94.0)
    path = run(tmp_path, data).save(tmp_path / "one.nc")
    again = pipeline.run(path)
    with h5py.File(path) as file:
        kept = file["brightness_temperature"][...]
        assert "us-standard" in json.dumps(file.attrs["scenario_toml"])
    repeated = again.variants[0].radiances.brightness_temperature
    assert (repeated.astype(np.float32) == kept[0]).all()
