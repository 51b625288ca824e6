"""Materials and covers: Fresnel, roughness, polarisation, mirrors, layers, and images."""

from __future__ import annotations

import math

import numpy as np
import oracle
import pytest
from scenes import ACTIVE, BROAD, MOIST, run, scene

from thzcl.air import permittivity, radiometry
from thzcl.errors import ScenarioError
from thzcl.graph import Values
from thzcl.scenario.materials import library
from thzcl.surfaces import mirrors
from thzcl.surfaces.fresnel import coherent_share, exchanged, fresnel, lobe
from thzcl.surfaces.materials import Covering, Face, Plain, Substance
from thzcl.surfaces.mirrors import Constant, Enclosure
from thzcl.surfaces.radiance import Emission, Reflecting

GHZ = np.array([94.0, 220.0, 340.0, 650.0])


def of(name, kelvin=293.15):
    return Substance(name, library()[name].rows).permittivity(GHZ * 1e9, kelvin)


# --- laws against published and independently computed values


@pytest.mark.parametrize(
    ("name", "kelvin", "expected"),
    [
        ("water", 293.15, [0.4152, 0.2865, 0.2338, 0.1777]),
        ("skin", 293.15, [0.350, 0.211, 0.161, 0.116]),
        ("ice", 263.15, [0.0792] * 4),
    ],
)
def test_reflectivity_at_normal_incidence(name, kelvin, expected):
    r_s, r_p = fresnel(of(name, kelvin), 1.0)
    assert r_s == pytest.approx(np.array(expected), abs=6e-4 if name == "skin" else 6e-5)
    assert r_s == pytest.approx(r_p, rel=1e-12)


@pytest.mark.parametrize(
    ("eps", "degrees", "expected"),
    [
        (permittivity.water(650e9, 293.15), 45, (0.29104, 0.08471)),
        (permittivity.water(650e9, 293.15), 75, (0.63397, 0.05930)),
        (permittivity.ice(650e9, 263.15), 45, (0.15740, 0.02477)),
    ],
)
def test_fresnel_by_polarisation(eps, degrees, expected):
    found = fresnel(eps, math.cos(math.radians(degrees)))
    assert np.array(found) == pytest.approx(np.array(expected), abs=1e-5)


def test_everything_is_reflected_at_grazing_incidence():
    for eps in (1.5, 4 + 1j, 1 + 1e6j, -3 + 0.1j):
        assert np.array(fresnel(eps, 0.0)) == pytest.approx(1.0, rel=1e-12)
    assert np.array(fresnel(1.0, np.linspace(0, 1, 5))).max() == 0


def test_a_glass_plate_reflects_no_p_light_at_brewsters_angle():
    cosine = math.cos(math.atan(2.0))
    assert fresnel(4.0, cosine)[1] == pytest.approx(0, abs=1e-30)


def test_metal_loses_what_hagen_and_rubens_say():
    hz, sigma = 650e9, 3.77e7
    expected = 4 * math.sqrt(math.pi * permittivity.VACUUM_F_M * hz / sigma)
    assert 1 - fresnel(permittivity.conductor(hz, sigma), 1.0)[0] == pytest.approx(
        expected, rel=2e-3
    )


def test_roughness_scatters_what_ament_says():
    found = coherent_share(0.05e-3, GHZ * 1e9, 1.0)
    assert found == pytest.approx(np.array([0.9619, 0.8085, 0.6018, 0.1563]), abs=1e-4)


def test_the_lobe_of_rough_facets_sends_back_all_that_it_reflects():
    """Over directions, sigma_0 / (4 pi cos) is a distribution of facets: its slopes sum to 1."""
    slope, theta = 0.2, np.linspace(0, math.pi / 2 - 1e-6, 200_001)
    cosine = np.cos(theta)
    facets = lobe(slope, cosine) / math.pi * 4 * cosine**6 * np.tan(theta) / cosine**2
    assert 2 * math.pi * np.trapezoid(facets, theta) == pytest.approx(1, rel=1e-6)


def test_a_layer_is_the_sum_of_its_bounces():
    passed, back, behind = 0.6, 0.15, 0.7
    down, up, lost = 1.0 * passed, back, 1 - passed - back
    of_surface, of_cover = 0.0, lost  # absorbed, which by Kirchhoff is the emissivity
    for _ in range(200):
        of_surface += down * (1 - behind)
        rising = down * behind
        up += rising * passed
        of_cover += rising * lost
        down = rising * back
    x = exchanged(behind, back)
    assert back + passed**2 * x == pytest.approx(up, rel=1e-14)
    assert passed * (1 - (1 - back) * x) == pytest.approx(of_surface, rel=1e-14)
    assert lost * (1 + passed * x) == pytest.approx(of_cover, rel=1e-14)
    assert up + of_surface + of_cover == pytest.approx(1, rel=1e-14)


def seen_k(behind, passed, cloth_k, room_k, body_k, ghz):
    """The brightness temperature of something under a cover, all of it rough."""
    hz = np.array([ghz * 1e9])
    law = Plain(behind, Covering(passed, 0.02, cloth_k))
    reflecting = Reflecting((law,), Values.of([0], np.int32))
    sources = Emission(Values.of([body_k]), reflecting, 290.0, Enclosure(room_k))
    radiance = sources.table(hz).sent[0] + radiometry.planck(hz, 290.0)
    return float(radiometry.brightness_temperature(hz, radiance)[0])


@pytest.mark.parametrize(
    ("skin", "passed", "cloth_k", "room_k", "ghz", "expected"),
    [(0.116, 0.5, 300.0, 293.0, 650.0, -3.754), (0.350, 0.8, 295.0, 80.0, 94.0, -95.63)],
)
def test_metal_beside_skin_under_cloth(skin, passed, cloth_k, room_k, ghz, expected):
    metal, body = (seen_k(part, passed, cloth_k, room_k, 305.0, ghz) for part in (0.99, skin))
    assert metal - body == pytest.approx(expected, abs=0.01)


# --- look-ups


@pytest.mark.parametrize("eps", [2.0, 6 + 0.3j, 4.5 + 2.9j, 300 + 300j])
@pytest.mark.parametrize("roughness_m", [0.0, 1e-4, 1e-3])
def test_look_ups_follow_the_laws(eps, roughness_m):
    from thzcl.scenario.materials import Material

    row = Material(permittivity=(complex(eps).real, complex(eps).imag))
    face = Face(Substance("it", (row,)), 290.0, roughness_m, True)
    hz, cosine = np.array([650e9]), np.linspace(0, 1, 20_001)
    laws = ("reflectivity", "polarization", "share")
    nodes = mirrors.by_cosine((face, Constant(0.3)), hz, laws=laws)
    for number, name in enumerate(laws):
        row = nodes[0, 0, number]
        found = np.interp(np.sqrt(cosine), np.linspace(0, 1, len(row)), row)
        assert np.abs(found - getattr(face, name)(hz, cosine)).max() < 3e-6


# --- images


def flat(**changes):
    """Glossy ground below a black dome, in clear air."""
    base = {
        "atmosphere": {"temperature_k": 290.0, "relative_humidity_percent": 70.0, "model": "none"},
        "ground": {"temperature_k": 300.0, "material": "floor"},
        "materials": {"floor": {"permittivity": [4.0, 1.0]}},
        "targets": {},
        "background__environment": 100.0,
        "camera__look_at_m": [30.0, 8.0, 0.0],
    }
    return scene(**(base | changes))


def rays(data):
    """The unit direction of every pixel's ray, (row, column, 3)."""
    from scenes import lens

    camera = lens(data)
    columns, rows = data["camera"]["pixels"]
    return np.array([[camera.ray(row, column) for column in range(columns)] for row in range(rows)])


@pytest.mark.parametrize("degrees", [None, 0.0, 30.0, 90.0])
def test_ground_of_a_material_is_seen_by_angle_and_polarisation(tmp_path, degrees):
    data = flat(camera__polarization_deg=degrees)
    found = run(tmp_path, data).variants[0].radiances.contrast[0]
    d = rays(data)
    down = d[..., 2] < -0.05
    r_s, r_p = fresnel(4 + 1j, -d[..., 2])
    part = (r_s + r_p) / 2
    if degrees is not None:
        position, look_at = (np.array(data["camera"][k]) for k in ("position_m", "look_at_m"))
        ahead = (look_at - position) / np.linalg.norm(look_at - position)
        right = np.cross(ahead, [0, 0, 1])
        right /= np.linalg.norm(right)
        up = np.cross(right, ahead)
        angle = math.radians(degrees)
        e = math.cos(angle) * right + math.sin(angle) * up
        e = e - (d @ e)[..., None] * d
        s = np.cross([0.0, 0.0, 1.0], d)
        q = (e * s).sum(-1) ** 2 / (e * e).sum(-1) / (s * s).sum(-1)
        part = r_s * q + r_p * (1 - q)
    hz = 650e9
    own, around, air = (oracle.planck(hz, k) for k in (300.0, 100.0, 290.0))
    expected = (1 - part) * own + part * around - air
    assert np.abs(found - expected)[down].max() < 2e-6 * air
    assert down.sum() > 50


def test_water_is_at_the_temperature_of_what_is_made_of_it(tmp_path):
    by_k = []
    for kelvin in (278.0, 308.0):
        data = flat(ground={"temperature_k": kelvin, "material": "water"}, materials=None)
        found = run(tmp_path, data).variants[0].radiances.contrast[0]
        d = rays(data)
        part = sum(fresnel(permittivity.water(650e9, kelvin), -d[..., 2])) / 2
        own, around, air = (oracle.planck(650e9, k) for k in (kelvin, 100.0, 290.0))
        expected = (1 - part) * own + part * around - air
        down = d[..., 2] < -0.05
        assert np.abs(found - expected)[down].max() < 2e-6 * air
        by_k.append(part[down])
    assert np.abs(by_k[1] - by_k[0]).min() > 1e-3


def test_a_rough_mirror_splits_what_it_sees(tmp_path):
    """The mirrored share sees the sky of its own elevation, the rest the mean of what is around."""
    ground = {"temperature_k": 285.0, "material": "plate"}
    base = {
        "sky": {"profile": "us-standard"},
        "background__environment": "sky",
        "sensor": {"kind": "passive-spectral", "frequency_ghz": 94.0},
        "targets": {},
        "ground": ground,
    }
    found = {}
    for roughness in (0.0, 0.3, 30.0):
        data = scene(**base, materials={"plate": {"reflectivity": 0.9, "roughness_mm": roughness}})
        found[roughness] = run(tmp_path, data).variants[0].radiances.contrast[0]
    plain = scene(**(base | {"ground": {"temperature_k": 285.0, "reflectivity": 0.9}}))
    rough = run(tmp_path, plain).variants[0].radiances.contrast[0]
    d = rays(plain)
    down = d[..., 2] < -0.1
    assert found[30.0][down] == pytest.approx(rough[down], rel=1e-5)
    share = coherent_share(0.3e-3, 94e9, -d[..., 2])
    expected = share * found[0.0] + (1 - share) * rough
    assert found[0.3][down] == pytest.approx(expected[down], rel=2e-5)
    assert np.abs(found[0.0] - rough)[down].min() > 0.01 * np.abs(rough).max()


BOX = scene()["targets"]["box"]
HALL = {
    "numerics": {"bounces": 1},
    "targets": {
        "box": {k: v for k, v in BOX.items() if k != "reflectivity"}
        | {"material": "steel", "temperature_k": 290.0},
        "cloth": {
            **BOX,
            "center_m": [22.0, 9.0, 1.0],
            "temperature_k": 290.0,
            "cover": {"transmission": 0.4, "reflectivity": 0.1, "temperature_k": 290.0},
        },
    },
    "ground": {"temperature_k": 290.0, "material": "wet"},
    "materials": {"wet": {"model": "water", "roughness_mm": 0.2}},
    "background__environment": 290.0,
    "atmosphere": MOIST | {"fluctuations": scene()["atmosphere"]["fluctuations"]},
}


@pytest.mark.parametrize("numerics", [{"bounces": 1}, {"bounces": 0, "precision": "float64"}])
@pytest.mark.parametrize("degrees", [None, 20.0])
@pytest.mark.parametrize(
    "sensor", [{"kind": "passive-spectral", "frequency_ghz": [340.0, 650.0]}, BROAD], ids=str
)
def test_at_one_temperature_nothing_is_seen(tmp_path, numerics, degrees, sensor):
    data = scene(
        **(HALL | {"numerics": numerics, "camera__polarization_deg": degrees, "sensor": sensor})
    )
    assert np.abs(run(tmp_path, data).variants[0].radiances.contrast).max() == 0


def warm_hall(**changes):
    """Things of several materials, temperatures and covers."""
    data = scene(**(HALL | changes))
    data["targets"]["box"]["temperature_k"] = 300.0
    data["targets"]["cloth"] |= {"temperature_k": 310.0, "reflectivity": 0.3}
    data["targets"]["cloth"]["cover"]["temperature_k"] = 301.0
    data["ground"]["temperature_k"] = 285.0
    return data


FEATURES = {
    "bounces": {},
    "no bounces": {"numerics": {"bounces": 0}},
    "polarised": {"camera__polarization_deg": 33.0},
    "a band": {"sensor": BROAD, "camera__polarization_deg": 33.0},
    "sky": {"sky": {"profile": "us-standard"}, "background__environment": "sky"},
    "warm air": {
        "atmosphere": MOIST
        | {"fluctuations": scene()["atmosphere"]["fluctuations"] | {"temperature_sigma_k": 1.0}},
        "camera__polarization_deg": 33.0,
    },
    "samples": {"camera__samples_per_pixel": 4},
    "a tolerance": {"numerics": {"tolerance": 1e-3, "bounces": 1}},
    "optics": {
        "sensor": {
            "kind": "passive-spectral",
            "frequency_ghz": 650.0,
            "optics": {"aperture_m": 0.1, "pixel": False},
        }
    },
    "echoes": {"sensor": ACTIVE, "camera__polarization_deg": 33.0},
    "echoes of rough things": {
        "sensor": ACTIVE | {"spreading": "lambert", "aperture_m": 0.1},
        "materials": {"wet": {"model": "water", "roughness_mm": 0.2, "slope": 0.3}},
    },
    "bistatic": {"sensor": ACTIVE | {"arrangement": "bistatic", "transmitter_m": [0.0, 3.0, 5.0]}},
}


@pytest.mark.parametrize("changes", FEATURES.values(), ids=FEATURES)
def test_the_budgets_twin_sees_the_same(tmp_path, changes):
    """It knows the laws themselves in float64, and no look-up."""
    budget = run(tmp_path, warm_hall(**changes)).error_budget
    assert budget["arithmetic"]["relative"] < 4e-6


def test_a_bounce_sees_the_next_thing_through_mean_air(tmp_path):
    """A mirror on the ground before a hot wall, against plain geometry."""
    wall = {
        "kind": "box",
        "center_m": [25.5, 0.0, 10.0],
        "size_m": [1.0, 60.0, 20.0],
        "temperature_k": 400.0,
        "reflectivity": 0.25,
    }
    data = scene(
        atmosphere=MOIST,
        camera__position_m=[0.0, 0.0, 4.0],
        camera__look_at_m=[12.0, 0.0, 0.0],
        targets={"wall": wall},
        ground={"temperature_k": 280.0, "material": "mirror"},
        materials={"mirror": {"reflectivity": 0.8}},
        background__environment=150.0,
        numerics={"bounces": 1},
    )
    found = run(tmp_path, data).variants[0].radiances.contrast[0]
    unfollowed = run(tmp_path, data, settings={"numerics.bounces": 0})
    d, hz = rays(data), 650e9
    grams = 0.70 * oracle.saturation_hpa(290.0) * 100 / 461.525 / 290.0 * 1e3
    per_m = oracle.absorption_per_m(hz, 290.0, 1013.25, grams)
    b = {k: oracle.planck(hz, k) for k in (150.0, 280.0, 290.0, 400.0)}
    to_ground = -4.0 / d[..., 2]
    x, onward = to_ground * d[..., 0], (25.0 - to_ground * d[..., 0]) / d[..., 0]
    ground = (d[..., 2] < 0) & (x < 25)
    assert (onward * -d[..., 2] < 20)[ground].all()  # all of them meet the wall
    of_wall = 0.75 * b[400.0] + 0.25 * b[150.0] - b[290.0]
    sent = 0.2 * (b[280.0] - b[290.0]) + 0.8 * of_wall * np.exp(-per_m * onward)
    expected = sent * np.exp(-per_m * to_ground)
    assert ground.sum() > 100
    assert np.abs(found - expected)[ground].max() < 3e-6 * np.abs(expected).max()
    around = 0.2 * (b[280.0] - b[290.0]) + 0.8 * (b[150.0] - b[290.0])
    plain = unfollowed.variants[0].radiances.contrast[0]
    expected = around * np.exp(-per_m * to_ground)
    assert np.abs(plain - expected)[ground].max() < 3e-6 * np.abs(expected).max()
    assert any("BOUNCES" in options for options in run(tmp_path, data).build_options)
    assert not any("BOUNCES" in options for options in unfollowed.build_options)


def test_plain_things_compile_no_material(tmp_path):
    options = " ".join(run(tmp_path, scene()).build_options)
    for name in ("COSINE", "MIRRORED", "POLARIZED", "COVERED", "BOUNCES", "LAWS", "ACROSS"):
        assert name not in options


def test_an_active_sensor_sees_mirrors_as_its_spreading_says(tmp_path):
    """Without spreading all that is reflected comes back; rough, what is scattered and the lobe."""
    hz, sensor = 650e9, ACTIVE | {"dynamic_range_db": 300.0}
    material = {"permittivity": [4.0, 1.0], "roughness_mm": 0.05}
    shown = {}
    for name, changes in {
        "none": {},
        "rough": {"spreading": "lambert", "aperture_m": 0.1},
        "facets": {"spreading": "lambert", "aperture_m": 0.1, "slope": 0.4},
    }.items():
        slope = changes.pop("slope", None)
        data = flat(
            sensor=sensor | changes,
            materials={"floor": material | ({} if slope is None else {"slope": slope})},
        )
        shown[name] = run(tmp_path, data).variants[0].sight.returned[0].astype(float)
    d = rays(data)
    cosine, down = -d[..., 2], d[..., 2] < -0.05
    part = sum(fresnel(4 + 1j, cosine)) / 2
    share = coherent_share(0.05e-3, hz, cosine)
    assert shown["none"][down] == pytest.approx(part[down], rel=2e-6)
    length = 4.0 / cosine
    gain = cosine / (math.pi * length**2)
    rough = (1 - share) * part * gain
    assert shown["rough"][down] == pytest.approx(rough[down], rel=2e-5)
    upright = float(fresnel(4 + 1j, 1.0)[0])
    facets = rough + share * upright * lobe(0.4, cosine) * gain
    assert shown["facets"][down] == pytest.approx(facets[down], rel=2e-5)


def test_a_cover_over_a_picture_is_taken_level_by_level(tmp_path):
    """A billboard of even reflectivity under a cover is like a box face of that reflectivity."""
    np.save(tmp_path / "even.npy", np.full((4, 4), 0.6))
    board = {
        "kind": "billboard",
        "center_m": [20.0, 0.0, 4.0],
        "size_m": [40.0, 40.0],
        "facing_deg": 180.0,
        "image": "even.npy",
        "quantity": "reflectivity",
        "temperature_k": 310.0,
        "cover": {"transmission": 0.5, "reflectivity": 0.2, "temperature_k": 300.0},
    }
    camera = {"camera__position_m": [0.0, 0.0, 4.0], "camera__look_at_m": [20.0, 0.0, 4.0]}
    data = scene(targets={"it": board}, atmosphere=MOIST, **camera)
    one = run(tmp_path, data).variants[0].radiances.contrast[0]
    box = {
        "kind": "box",
        "center_m": [20.5, 0.0, 4.0],
        "size_m": [1.0, 40.0, 40.0],
        "temperature_k": 310.0,
        "reflectivity": 0.6,
        "cover": board["cover"],
    }
    other = run(tmp_path, scene(targets={"it": box}, atmosphere=MOIST, **camera))
    assert one == pytest.approx(other.variants[0].radiances.contrast[0], rel=1e-6)


def test_files_over_frequency(tmp_path):
    rows = "frequency_ghz,permittivity_re,permittivity_im\n600,3,0.5\n700,5,1.5\n"
    (tmp_path / "glaze.csv").write_text(rows, encoding="utf-8")
    by_file = flat(materials={"floor": {"file": "glaze.csv"}})
    by_hand = flat(materials={"floor": {"permittivity": [4.0, 1.0]}})
    one, other = (run(tmp_path, d).variants[0].radiances.contrast for d in (by_file, by_hand))
    assert np.array_equal(one, other)
    cover = "frequency_ghz,transmission,reflectivity\n600,0.4,0.1\n700,0.6,0.3\n"
    (tmp_path / "cloth.csv").write_text(cover, encoding="utf-8")
    covers = {"file": "cloth.csv"}, {"transmission": 0.5, "reflectivity": 0.2}
    found = [
        run(tmp_path, scene(targets__box__cover=one | {"temperature_k": 295.0})) for one in covers
    ]
    one, other = (result.variants[0].radiances.contrast for result in found)
    assert one == pytest.approx(other, rel=1e-6)


# --- what is refused and told

REFUSED = {
    "unknown material": (
        {"targets__box__material": "steal", "targets__box__reflectivity": None},
        "did you mean steel?",
    ),
    "both": ({"targets__box__material": "steel"}, "give only one of reflectivity or material"),
    "far from its range": ({"ground__material": "vinyl-tile"}, "650 GHz: known at 1 to 40 GHz"),
    "wrong sign": ({"materials": {"m": {"permittivity": [4.0, -1.0]}}}, "must be at least 0"),
    "no law": ({"materials": {"m": {"roughness_mm": 1.0}}}, "needs one of permittivity"),
    "unknown model": ({"materials": {"m": {"model": "debie"}}}, "did you mean debye?"),
    "missing key": (
        {"materials": {"m": {"model": "debye", "eps_inf": 3.0, "tau_ps": [1.0]}}},
        "delta_eps: missing",
    ),
    "key of another model": (
        {"materials": {"m": {"model": "water", "tau_ps": [1.0]}}},
        'belongs to model = "debye"',
    ),
    "over one": (
        {"targets__box__cover": {"transmission": 0.7, "reflectivity": 0.4, "temperature_k": 1.0}},
        "must not exceed 1",
    ),
    "cover without a temperature": (
        {"targets__box__cover": {"transmission": 0.7}},
        "cover's emission",
    ),
    "no such file": ({"materials": {"m": {"file": "no.csv"}}, "ground__material": "m"}, "no.csv"),
}


@pytest.mark.parametrize(("changes", "words"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_is_refused_in_one_message(tmp_path, changes, words):
    if "ground__material" in changes:
        changes = changes | {"ground__reflectivity": None}
    with pytest.raises(ScenarioError) as refused:
        run(tmp_path, scene(**changes))
    assert len(refused.value.problems) == 1
    assert words in refused.value.problems[0]


def test_what_is_extrapolated_is_told(tmp_path):
    result = run(tmp_path, scene(ground={"temperature_k": 285.0, "material": "brick"}))
    assert any('material "brick": 650 GHz: known at' in one for one in result.warnings)


def test_of_two_rows_the_one_that_holds_then_the_nearer():
    brick = Substance("brick", library()["brick"].rows)
    by_row = [row.a for row in brick.rows]
    at = {ghz: brick.permittivity(np.array([ghz * 1e9]), 290.0)[0].real for ghz in (30, 60, 80)}
    assert at[30] == pytest.approx(by_row[0])
    assert at[80] == pytest.approx(by_row[1])
    assert brick.beyond(np.array([30e9])) == (None, None)
    assert brick.beyond(np.array([80e9]))[1] is not None
    assert brick.beyond(np.array([50e9]))[0] is not None  # 40 GHz is nearer, and ends there
    assert brick.beyond(np.array([661e9]))[0] is not None
