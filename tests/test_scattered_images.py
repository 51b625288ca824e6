"""Images in rain, fog and snow: what they take from light, and what they scatter and emit."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import ACTIVE, BROAD, DRIFTING, MOIST, run, scene, write

from thzcl import pipeline
from thzcl.air import radiometry, scattering, weather
from thzcl.air.composition import part
from thzcl.air.mean import Air
from thzcl.air.weather import Weather
from thzcl.errors import ScenarioError
from thzcl.plan import report

STANDARD = {"temperature_k": 293.15, "relative_humidity_percent": 44.0}
RAIN = {"rain": {"rate_mm_h": 10.0}}
WARM_RAIN = {"rain": {"rate_mm_h": 10.0, "temperature_k": 293.15}}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": [94.0, 220.0, 650.0]}
SKY = {"sky": {"profile": "us-standard"}, "background__environment": "sky"}


@pytest.fixture(autouse=True)
def nothing_remembered():
    """What tests make of rain is no other test's."""
    yield
    for function in (weather._kinds, weather._solve):  # noqa: SLF001
        function.cache_clear()


def image(folder, **changes):
    return run(folder, scene(**{"camera__pixels": [8, 6], "sensor": SPECTRAL, **changes}))


def air(table, kelvin=293.15, gas="none", vapour_g_m3=0.0):
    parts = (part(gas), *(part(name, values) for name, values in table.items()))
    return Air(parts, kelvin, 1013.25, vapour_g_m3)


# --- what is taken from light ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "kelvin", "factor"),
    [
        ({"rain": {"rate_mm_h": 10.0}}, 283.15, 0.898),
        ({"rain": {"rate_mm_h": 50.0}}, 283.15, 0.736),
        (
            {"fog": {"liquid_water_g_m3": 0.37, "droplets": "advection", "mode_radius_um": 10.0}},
            275.0,
            0.851,
        ),
    ],
)
def test_what_is_left_of_contrast_over_64_m(tmp_path, table, kelvin, factor):
    """At 650 GHz, as PHYSICS_NEXT has it; drops are as warm as the air, and the scene is black."""
    seen = {
        name: one | ({"temperature_k": kelvin} if name == "rain" else {})
        for name, one in table.items()
    }
    changes = {
        "atmosphere": {"temperature_k": kelvin, "relative_humidity_percent": 50.0, "model": "none"},
        "ground": None,
        "background__temperature_k": kelvin + 20.0,
        "background__max_range_m": 64.0,
        "targets": {},
        "sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0},
    }
    clear = image(tmp_path, **changes)
    falling = image(tmp_path, **changes | {"atmosphere": changes["atmosphere"] | seen})
    ratio = np.asarray(falling.variants[0].sight.contrast / clear.variants[0].sight.contrast)
    assert ratio == pytest.approx(np.full(ratio.shape, factor), abs=0.01)


@pytest.mark.parametrize("sensor", [SPECTRAL, ACTIVE, BROAD])
def test_nothing_that_falls_is_nothing_at_all(tmp_path, sensor):
    """Bit for bit, also below the top of a layer that there is not."""
    table = MOIST | {"rain": {"rate_mm_h": 0.0, "layer_top_m": 1.0}, "snow": {"rate_mm_h": 0.0}}
    data = scene(camera__pixels=[8, 6], sensor=sensor, atmosphere=table)
    none = run(tmp_path, data)
    plain = run(tmp_path, scene(camera__pixels=[8, 6], sensor=sensor, atmosphere=MOIST))
    assert np.array_equal(none.variants[0].image.values, plain.variants[0].image.values)
    plan = pipeline.prepare(write(tmp_path, data))
    told = {stage.name: stage for stage in report.stages(plan)}
    assert not told["scattering"].needed


def test_without_scattering_it_is_an_absorber(tmp_path, monkeypatch):
    """Bit for bit: albedo 0 and the air's temperature is what any grey absorber does."""
    from thzcl.air.constituents import rain
    from thzcl.constituent import OpticalProperties

    def grey(self, frequency_hz, *_):  # noqa: ARG001
        return OpticalProperties(np.full(np.shape(frequency_hz), 2e-3))

    def split(self, frequency_hz, *_):  # noqa: ARG001
        zero = np.zeros(np.shape(frequency_hz))
        kelvin = np.full(zero.shape, 290.0)
        return OpticalProperties(zero + 2e-3, zero, temperature_k=kelvin)

    found = []
    for optics in (grey, split):
        weather._kinds.cache_clear()  # noqa: SLF001
        monkeypatch.setattr(rain.Rain, "optics", optics)
        pipeline_air = MOIST | {"temperature_k": 290.0, **RAIN}
        found.append(image(tmp_path, atmosphere=pipeline_air).variants[0].sight.contrast)
    assert np.array_equal(*found)


# --- what is scattered and emitted ----------------------------------------------------------------


@pytest.mark.parametrize("table", [WARM_RAIN, {"fog": {"liquid_water_g_m3": 0.5}}])
@pytest.mark.parametrize("gas", ["none", "mpm93"])
def test_within_one_temperature_nothing_shows(tmp_path, table, gas):
    """Exactly, whatever scatters: black at the air's temperature, and drops as warm as that."""
    atmosphere = STANDARD | table | {"model": gas}
    same = {"atmosphere": atmosphere, "ground": {"temperature_k": 293.15, "reflectivity": 0.0}}
    box = {"targets__box__temperature_k": 293.15, "background__environment": "air"}
    found = image(tmp_path, **same, **box).variants[0].sight.contrast
    assert not found.any()


@pytest.mark.parametrize(
    ("top_m", "length_m", "deficit"), [(1000.0, 64.0, 0.676), (300.0, 500.0, 16.03)]
)
def test_a_level_ray_lacks_what_the_sky_does_not_send(monkeypatch, top_m, length_m, deficit):
    """At z = 0, 94 GHz, 288.2 K, gas of 0.35 dB/km, black ground, space above: PHYSICS_NEXT A.

    Rain of the printed law, 8.17 dB/km with an albedo of 0.492 and an asymmetry of 0.279.
    """
    per_m = 1 / 4342.944819
    hz, kelvin = np.array([94e9]), 288.2
    k_e, albedo = np.array([8.17 * per_m]), 0.492
    moments = scattering.henyey_greenstein(np.array([0.279]))
    kind = weather.Kind(k_e * (1 - albedo), k_e * albedo, moments, np.array([kelvin]), top_m)
    monkeypatch.setattr(weather, "falling", lambda *_: [kind])
    monkeypatch.setattr(Air, "absorption", lambda *_: k_e + 0.35 * per_m)
    space = radiometry.planck_difference(hz, 2.725, kelvin)
    monkeypatch.setattr(
        weather, "_bounds", lambda *_: scattering.Bounds(space, np.zeros(1), np.zeros(1))
    )
    one = Weather(air({}, kelvin))
    source = one.source(hz, np.array([-1e-9]), np.zeros(1))
    depth = (k_e + 0.35 * per_m) * length_m
    added = source[0, 0] * length_m * scattering.mean_transmission(depth)[0]
    found = radiometry.brightness_temperature_contrast(hz, np.array([added]), kelvin)[0]
    assert -found == pytest.approx(deficit, rel=0.01)


def test_drops_at_the_wet_bulb_take_what_is_told():
    """0.20 and 0.06 K at 650 GHz, 10 mm/h over 64 m at 50 and 80 % of 20 degrees Celsius.

    That is for the law as printed, which comes to 8.54 dB/km; scaled to its rate it is 7.34.
    """
    hz = np.array([650e9])
    for percent, printed in ((50.0, 0.20), (80.0, 0.06)):
        due = printed * 7.34 / 8.54
        vapour = 17.27 * percent / 100 * 1.0  # g/m3 at 293.15 K
        one = air(RAIN, 293.15, "mpm93", vapour)
        kind = weather.falling(one, hz)[0]
        own = radiometry.planck_difference(hz, kind.kelvin, 293.15)
        depth = one.absorption(hz) * 64.0
        added = kind.absorption * own * 64.0 * scattering.mean_transmission(depth)
        found = radiometry.brightness_temperature_contrast(hz, added, 293.15)[0]
        assert -found == pytest.approx(due, abs=0.006)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        SKY,
        {"sensor": BROAD | {"center_ghz": 220.0, "bandwidth_ghz": 40.0}},
        {"sensor": SPECTRAL | {"optics": {"aperture_m": 0.05}}},
        {"camera__samples_per_pixel": 4},
        {"numerics__precision": "float64"},
        SKY | {"sensor": BROAD | {"center_ghz": 220.0, "bandwidth_ghz": 40.0}},
    ],
    ids=["plain", "sky", "band", "optics", "samples", "float64", "sky and band"],
)
@pytest.mark.parametrize("warm", [False, True])
def test_images_are_those_of_their_twin(tmp_path, changes, warm):
    """Within rounding and what the budget's line says, in even, turbulent and unevenly warm air."""
    atmosphere = DRIFTING | RAIN
    if warm:
        flow = DRIFTING["fluctuations"] | {"temperature_sigma_k": 1.0}
        atmosphere = atmosphere | {"fluctuations": flow}
    found = image(tmp_path, atmosphere=atmosphere, **changes)
    budget = found.error_budget
    assert budget["scattering"]["rms"] < 0.05
    assert budget["arithmetic"]["rms"] < 2e-3
    assert "scattering" not in {one["stage"] for one in found.left_out}


def test_uneven_warmth_of_the_air_is_not_the_drops(tmp_path):
    """With a vanishing departure, unevenly warm air gives what isothermal air does."""
    flow = DRIFTING["fluctuations"]
    due = image(tmp_path, atmosphere=DRIFTING | RAIN)
    tiny = DRIFTING | RAIN | {"fluctuations": flow | {"temperature_sigma_k": 1e-6}}
    found = image(tmp_path, atmosphere=tiny)
    one, other = (r.variants[0].sight.brightness_temperature_contrast for r in (due, found))
    assert np.abs(one - other).max() < 1e-3


def test_compared_models_see_the_same_rain(tmp_path):
    changes = {"atmosphere": MOIST | RAIN | {"compare": ["r24"]}}
    both = image(tmp_path, **changes).variants[0]
    alone = image(tmp_path, atmosphere=MOIST | RAIN | {"model": "r24"}).variants[0]
    found, due = both.compared[0].sight.contrast, alone.sight.contrast
    assert np.abs(found - due).max() < 1e-6 * np.abs(due).max()


def test_what_would_not_show_is_left_out(tmp_path):
    """Below a millikelvin: light rain as warm as the air at 650 GHz, over 30 m."""
    faint = {"rain": {"rate_mm_h": 0.0005, "temperature_k": 290.0}}
    atmosphere = {"temperature_k": 290.0, "relative_humidity_percent": 50.0} | faint
    sensor = {"kind": "passive-spectral", "frequency_ghz": 650.0}
    found = image(tmp_path, atmosphere=atmosphere, sensor=sensor)
    assert "scattering" in {one["stage"] for one in found.left_out}


@pytest.mark.parametrize("sensor", [SPECTRAL, ACTIVE])
def test_a_scene_above_a_layer_is_refused(tmp_path, sensor):
    table = MOIST | {"fog": {"liquid_water_g_m3": 0.1, "layer_top_m": 3.0}}
    with pytest.raises(ScenarioError, match="a layer of the air ends at 3 m") as caught:
        pipeline.prepare(write(tmp_path, scene(atmosphere=table, sensor=sensor)))
    assert "raise layer_top_m" in str(caught.value)


def test_echoes_are_attenuated_both_ways(tmp_path):
    clear, wet = (
        image(tmp_path, sensor=ACTIVE, atmosphere=MOIST | table).variants[0].sight
        for table in ({}, RAIN)
    )
    per_m = weather.Weather(air(RAIN)).extinction(clear.nodes_hz)
    assert per_m > 1e-3
    shown = clear.target > 0
    apart = (wet.optical_depth - clear.optical_depth)[0][shown]
    assert apart == pytest.approx(2 * per_m[0] * clear.path_length[shown], rel=0.02)
