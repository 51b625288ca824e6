"""Active images in rain, fog and snow: the echo of the air in each pixel, and its gate."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ACTIVE, MIRROR, facing, run, scene, write

from thzcl import pipeline
from thzcl.air.permittivity import water
from thzcl.errors import ScenarioError
from thzcl.plan import report
from thzcl.plugins.guard import Breach
from thzcl.scenario import answers
from thzcl.sensor import Needs, PathReturn

STANDARD = {"temperature_k": 293.15, "relative_humidity_percent": 44.0}
WARM = {"rain": {"rate_mm_h": 10.0, "temperature_k": 293.15}}
RAINY = STANDARD | WARM
WIDE, AREA = 0.3, np.pi * 0.15**2
BEAM = ACTIVE | {"dynamic_range_db": 150.0, "illumination": "beam", "aperture_m": WIDE}
LAMBERT = BEAM | {"spreading": "lambert"}
WIND = {"sigma_percent": 30.0, "voxel_m": 0.7, "grid": 32, "seed": 3, "wind_m_s": [2.0, 1.0, 0.0]}
ROUNDED = 2e-5  # of the echo, by float32 depths


def seen(folder, sensor=BEAM, atmosphere=RAINY, **changes):
    """Returns the one variant of a scene with ground, box and open air."""
    changes = {"camera__pixels": [8, 6], "sensor": sensor, "atmosphere": atmosphere, **changes}
    return run(folder, scene(**changes)).variants[0]


def backscatter(ghz=650.0, kelvin=293.15):
    """Returns the back-scatter of 10 mm/h, 1/m/sr, as a sum over other sizes of drops."""
    import miepython

    mm = np.geomspace(0.01, 10.0, 611)
    size = np.pi * mm * 1e-3 * ghz / 0.299792458
    index = np.sqrt(water(np.array([ghz * 1e9]), np.array([kelvin]))[0])
    back = np.asarray(miepython.efficiencies_mx(index.conjugate(), size)[2])
    density = 8000.0 * np.exp(-4.1 * 10.0**-0.21 * mm)
    flux = density * mm**3 * np.maximum(0.0, 9.65 - 10.3 * np.exp(-0.6 * mm))
    rate = np.pi / 6 * 3.6e-3 * np.trapezoid(flux, mm)
    section = np.pi / 4 * 1e-6 * mm**2
    return 10.0 / rate * np.trapezoid(density * section * back, mm) / (4 * np.pi)


def integral(beta, k, near, far, focus, ghz=650.0):
    """Returns the integral of beta G exp(-2 k r) by the rule of Gauss and Legendre, piece-wise."""
    if far <= near:
        return 0.0
    edges = np.linspace(near, far, 801)
    node, weight = np.polynomial.legendre.leggauss(8)
    r = (edges[:-1, None] + edges[1:, None] + np.diff(edges)[:, None] * node) / 2
    across = AREA * ghz / 0.299792458
    gain = AREA / (r**2 + across**2 * (1 - r / focus) ** 2)
    parts = gain * np.exp(-2 * k * r) * weight * np.diff(edges)[:, None] / 2
    return float(beta * parts.sum())


# --- what comes back ------------------------------------------------------------------------------


@pytest.mark.parametrize("own", [{"temperature_k": 293.15}, {}], ids=["warm", "wet bulb"])
@pytest.mark.parametrize("spreading", ["none", "lambert"])
def test_rain_is_as_bright_as_some_grey_wall(tmp_path, own, spreading):
    """650 GHz, 10 mm/h, an aperture of 0.3 m, 20 degrees Celsius, 44 %, as PHYSICS_NEXT has it."""
    due = {40.0: 8.1e-4, 80.0: 8.1e-3} if own else {40.0: 7.7e-4, 80.0: 7.7e-3}
    for distance, expected in due.items():
        air = STANDARD | {"rain": {"rate_mm_h": 10.0} | own}
        sensor = BEAM | {"spreading": spreading, "focus_m": distance}
        sight = run(tmp_path, facing(distance, sensor=sensor, atmosphere=air)).variants[0].sight
        back, twice = sight.path_return[0, 1, 1], sight.optical_depth[0, 1, 1]
        scale = np.pi * distance**2 if spreading == "lambert" else 1.0
        assert back * scale * np.exp(twice) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("sensor", [BEAM, LAMBERT], ids=["none", "lambert"])
@pytest.mark.parametrize("gate", [None, [-0.5, 0.5], [-5.0, 0.0]], ids=["open", "metre", "before"])
def test_pixels_receive_the_integral_along_their_rays(tmp_path, sensor, gate):
    """By quadrature, with Mie's theory by miepython; towards ground, box and open air."""
    keys = {} if gate is None else {"gate_m": gate}
    data = scene(camera__pixels=[8, 6], sensor=sensor | keys, atmosphere=RAINY)
    data["camera"]["look_at_m"] = [30.0, 8.0, 4.5]
    sight = run(tmp_path, data).variants[0].sight
    focus = float(np.linalg.norm(np.subtract(data["camera"]["look_at_m"], [1.0, -2.0, 4.0])))
    assert set(np.unique(sight.target)) == {0, 1, 2}
    beta, due = backscatter(), np.empty((6, 8))
    for place in np.ndindex(6, 8):
        length = float(sight.path_length[place])
        k = float(sight.optical_depth[(0, *place)]) / 2 / length
        about = length if sight.target[place] else focus
        near, far = (0.0, length) if gate is None else (about + gate[0], about + gate[1])
        due[place] = integral(beta, k, max(near, 0.0), min(far, length), focus)
    due *= 1 / AREA if sensor is LAMBERT else np.pi * focus**2 / AREA
    assert sight.path_return[0] == pytest.approx(due, rel=2e-3)


def test_above_its_layer_nothing_falls(tmp_path):
    """Rays that look up meet no drops above the top."""
    up = {"camera__look_at_m": [30.0, -2.0, 33.0], "targets": {}, "ground": None}
    table = {"rain": WARM["rain"] | {"layer_top_m": 24.0}}
    sight = seen(tmp_path, BEAM | {"focus_m": 40.0}, STANDARD | table, **up).sight
    top_m = np.min(20.0 / np.sin(np.pi / 4))
    k = float(sight.optical_depth[0].mean()) / 2 / 90.0
    low, high = (integral(backscatter(), k, 0.0, top_m * c, 40.0) for c in (0.8, 1.3))
    scale = np.pi * 40.0**2 / AREA
    middle = sight.path_return[0, 2:4, 3:5]
    assert np.all((low * scale < middle) & (middle < high * scale))
    assert np.all(sight.path_return[0, 0] < sight.path_return[0, -1])  # steeper rays leave sooner


def test_the_image_and_its_ratios_have_it(tmp_path):
    noisy = LAMBERT | {"noise_figure_db": 15.0, "bandwidth_hz": 1e6}
    found = seen(tmp_path, noisy)
    layers, sight = found.image.layers, found.sight
    of_air = layers["path_return"].values
    assert of_air == pytest.approx(1e-3 * AREA * sight.path_return[0], rel=1e-6)
    signal = layers["snr"].values * layers["noise_power"].values
    assert signal == pytest.approx(1e-3 * AREA * sight.returned[0] + of_air, rel=1e-6)
    assert found.image.facts["echo of the air"] == (pytest.approx(of_air.mean()), "W")
    quiet = seen(tmp_path, LAMBERT)
    over = 10 ** (quiet.image.values / 10) * 1e-18
    assert over == pytest.approx(quiet.image.layers["received_power"].values, rel=1e-5)
    assert over == pytest.approx(signal, rel=1e-5)
    assert quiet.image.caption.endswith(", echo of the air")


def test_under_speckle_fields_add(tmp_path):
    """The contrast of one look is 1, where independent powers of equal means have 0.71."""
    sensor = BEAM | {"speckle_looks": 1.0}
    dim = MIRROR | {"reflectivity": 8.1e-4}
    changes = {"camera__pixels": [64, 64], "sensor": sensor, "atmosphere": RAINY}
    base = facing(40.0, **changes)
    base["targets"]["wall"] |= {"reflectivity": 8.1e-4, "center_m": dim["center_m"]}
    found = run(tmp_path, base).variants[0]
    shares = found.image.layers["path_return"].values / (
        1e-3 * found.sight.returned[0] + found.image.layers["path_return"].values
    )
    assert shares == pytest.approx(np.full(shares.shape, 0.5), abs=0.02)
    power = found.image.layers["received_power"].values
    assert power.std() / power.mean() == pytest.approx(1.0, abs=0.05)


# --- where nothing comes back ---------------------------------------------------------------------


@pytest.mark.parametrize("table", [{}, {"rain": {"rate_mm_h": 0.0}}])
def test_without_drops_a_beam_is_as_ever(tmp_path, table):
    found = seen(tmp_path, LAMBERT, STANDARD | table)
    assert not found.sight.path_return.any()
    assert not found.image.layers["path_return"].values.any()
    assert "echo of the air" not in {*found.image.facts, found.image.caption}
    flood = {k: v for k, v in LAMBERT.items() if k != "illumination"}
    plain = seen(tmp_path, flood, STANDARD)
    assert plain.sight.path_return is None
    assert np.array_equal(found.image.values, plain.image.values)


def test_the_plan_says_whether_there_is_an_echo(tmp_path):
    told = {}
    for name, sensor, air in (
        ("rain", BEAM, RAINY),
        ("dry", BEAM, STANDARD),
        ("flood", ACTIVE, RAINY),
    ):
        plan = pipeline.prepare(write(tmp_path, scene(sensor=sensor, atmosphere=air), name))
        stages = {stage.name: stage for stage in report.stages(plan)}
        told[name] = stages["scattering"], report.warnings(plan, [0.0])
    assert told["rain"][0].needed
    assert told["rain"][0].reason == "what falls sends light back to the beam"
    assert not told["dry"][0].needed and not told["flood"][0].needed
    assert 'illumination = "beam" has it' in "".join(told["flood"][1])
    assert "echo of rain" not in "".join(told["rain"][1] + told["dry"][1])


# --- where it meets other features ----------------------------------------------------------------


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera__samples_per_pixel": 4},
        {"numerics__precision": "float64"},
        {"numerics__ray_stride": 1, "atmosphere__fluctuations__temperature_sigma_k": 1.0},
    ],
    ids=["plain", "samples", "float64", "temperature"],
)
@pytest.mark.parametrize("gate", [None, [-2.0, 0.0]], ids=["open", "gate"])
def test_in_uneven_air_the_budget_tells_what_even_attenuation_costs(tmp_path, changes, gate):
    """The echo is that of the depth of its ray; the budget sums over voxels, and finds some %."""
    data = scene(camera__pixels=[8, 6], sensor=BEAM | ({} if gate is None else {"gate_m": gate}))
    data["atmosphere"] = RAINY | {"fluctuations": WIND}
    for key, value in changes.items():
        *tables, last = key.split("__")
        node = data
        for table in tables:
            node = node.setdefault(table, {})
        node[last] = value
    result = run(tmp_path, data)
    found, line = result.variants[0].sight.path_return, result.error_budget["scattering"]
    assert 0 < line["rms"] < 0.05 * found.max()
    told = [warning for warning in result.warnings if "which no setting changes" in warning]
    assert len(told) == (line["relative"] > 1e-3)


def test_scanned_and_moving_air_sends_back_what_it_does_at_each_time(tmp_path):
    """In a wind, a scan's echo is in every pixel that of an instant image of its own time."""
    air = RAINY | {"fluctuations": WIND | {"sigma_percent": 60.0}}
    scan = {"kind": "raster-scan", "dwell_s": 0.5, "detector": BEAM}
    moved = seen(tmp_path, scan, air).sight
    still = seen(tmp_path, BEAM, air).sight
    k = (moved.optical_depth / still.optical_depth - 1)[0]
    assert np.abs(k[0]).max() > 0.01
    later = moved.path_return[0] / still.path_return[0] - 1
    assert np.abs(later[0, 0]) < 1e-3 < np.abs(later).max()
    assert np.corrcoef(k.ravel()[1:], later.ravel()[1:])[0, 1] < -0.9


def test_optics_spread_the_echo_as_they_do_power(tmp_path):
    """Before even air behind a wall of one distance, blur changes nothing."""
    sensor = {k: v for k, v in BEAM.items() if k != "aperture_m"} | {"focus_m": 40.0}
    sharp = run(tmp_path, facing(40.0, sensor=BEAM | {"focus_m": 40.0}, atmosphere=RAINY))
    soft = run(
        tmp_path, facing(40.0, sensor=sensor | {"optics": {"aperture_m": WIDE}}, atmosphere=RAINY)
    )
    one, other = (result.variants[0].sight.path_return for result in (sharp, soft))
    assert other == pytest.approx(one, rel=1e-5)


def test_models_that_are_compared_have_their_own_gas(tmp_path):
    both = seen(tmp_path, BEAM, RAINY | {"compare": ["p676-13"]})
    alone = seen(tmp_path, BEAM, RAINY | {"model": "p676-13"})
    (other,) = both.compared
    assert other.sight.path_return == pytest.approx(alone.sight.path_return, rel=ROUNDED)
    assert np.abs(other.sight.path_return / both.sight.path_return - 1).max() > 0.01


def test_realizations_average_it(tmp_path):
    air = RAINY | {"fluctuations": WIND | {"sigma_percent": 60.0}}
    sights = [seen(tmp_path, BEAM, air, numerics={"realizations": count}).sight for count in (1, 3)]
    one, mean = (sight.path_return for sight in sights)
    assert mean.shape == one.shape
    assert 1e-4 < np.abs(mean / one - 1).max() < 0.3


def test_several_kinds_add(tmp_path):
    fog = {"fog": {"liquid_water_g_m3": 0.1}}
    alone = [seen(tmp_path, BEAM, STANDARD | one).sight for one in (WARM, fog)]
    both = seen(tmp_path, BEAM, RAINY | fog).sight
    assert (both.path_return < sum(one.path_return for one in alone)).all()  # each dims the other
    assert (both.path_return > 0.9 * sum(one.path_return for one in alone)).all()


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensor", "words"),
    [
        (ACTIVE | {"gate_m": [-0.5, 0.5]}, 'gate_m: is that of illumination = "beam"'),
        (ACTIVE | {"focus_m": 40.0}, 'focus_m: is that of illumination = "beam"'),
        (BEAM | {"gate_m": [0.5, 1.0]}, "gate_m: begins before what a pixel shows"),
        (BEAM | {"gate_m": [-1.0, -0.5]}, "gate_m: begins before what a pixel shows"),
        (BEAM | {"focus_m": 0.0}, "focus_m"),
        (ACTIVE | {"illumination": "beam"}, "illumination: .beam. needs an aperture_m"),
        (BEAM | {"optics": {"aperture_m": 0.2}}, "a beam has one aperture"),
        (
            BEAM | {"arrangement": "bistatic", "transmitter_m": [0.0, 5.0, 5.0]},
            "a bistatic source is a .flood.",
        ),
    ],
)
def test_beams_that_make_no_sense_are_refused(tmp_path, sensor, words):
    with pytest.raises(ScenarioError, match=words):
        pipeline.prepare(write(tmp_path, scene(sensor=sensor, atmosphere=RAINY)))


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"path_return": 0.3}, "not a thzcl.sensor.PathReturn"),
        ({"path_return": PathReturn(0.3), "illumination": "flood"}, "without a beam"),
        ({"path_return": PathReturn(0.3), "transmitter_m": (0.0, 0.0, 9.0)}, "without a beam"),
        ({"path_return": PathReturn(0.3), "reflection": False}, "without a beam"),
        ({"path_return": PathReturn(0.0)}, "an aperture of 0 m"),
        ({"path_return": PathReturn(0.3, -1.0)}, "a focus of -1 m"),
        ({"path_return": PathReturn(0.3, None, (1.0, 2.0))}, "leaves out 0"),
    ],
)
def test_sensors_ask_for_a_path_return_that_can_be(asked, words):
    common = {"frequency_hz": [650e9], "reflection": True, "illumination": "beam"}
    with pytest.raises(Breach, match=words):
        answers.needs(Needs(**(common | asked)), (8, 6))
