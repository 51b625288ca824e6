"""What is in the air joins every image: a third party's dust, and what the fit makes of it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import numpy as np
import oracle
import pytest
from packages import ODD, prepare
from scenes import ACTIVE, BROAD, DRIFTING, MIRROR, MOIST, facing, lens, run, scene, write

from thzcl import pipeline
from thzcl.air.composition import part
from thzcl.air.expansion import HIGHEST_DEGREE, fit
from thzcl.air.mean import Air
from thzcl.errors import ScenarioError
from thzcl.plan import report
from thzcl.turbulence.orientation import ROTATIONS

PER_KM = 0.5
ROUNDING = 1e-6  # of float32
BISTATIC = ACTIVE | {"arrangement": "bistatic", "transmitter_m": [1.0, 0.5, 1.2]}
SCAN = {"kind": "raster-scan", "timing": "raster", "dwell_s": 1e-2}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": [340.0, 650.0]}
BLURRED = {"optics": {"aperture_m": 10.0}}


# --- dust joins everything -----------------------------------------------------------------------

JOINS = {
    "even air": {"atmosphere": MOIST},
    "no gas": {"atmosphere": MOIST | {"model": "none"}},
    "turbulence": {},
    "float64": {"numerics": {"precision": "float64"}},
    "several frequencies": {"sensor": SPECTRAL},
    "band": {"sensor": BROAD},
    "optics": {"sensor": BROAD | BLURRED},
    "samples": {"camera__samples_per_pixel": 9},
    "scan": {"sensor": SCAN | {"detector": SPECTRAL}},
    "scan with optics": {"sensor": SCAN | {"detector": SPECTRAL | BLURRED}},
    "thinned": {"numerics": {"ray_stride": 2}},
    "tolerance": {"numerics": {"tolerance": 1e-3}},
    "active": {"sensor": ACTIVE},
    "active and bistatic": {"sensor": BISTATIC},
    "mean of realisations": {"numerics": {"realizations": 2}},
}


@pytest.mark.usefixtures("dust")
@pytest.mark.parametrize("case", JOINS)
def test_it_takes_its_share_of_every_image(tmp_path, case):
    """A wall 40 m away, so far across that all rays are of one length: exp(-k L), to 1e-6."""
    changes = {"atmosphere": DRIFTING, "camera__pixels": [5, 4]} | JOINS[case]
    changes["targets"] = {"wall": MIRROR | {"reflectivity": 0.2}}
    dusty = changes["atmosphere"] | {"dust": {"per_km": PER_KM}}
    clear, seen = (
        run(tmp_path, facing(40.0, **(changes | {"atmosphere": air}))).variants[0]
        for air in (changes["atmosphere"], dusty)
    )
    echoes = "active" in case
    length = clear.sight.path_length + (clear.sight.outgoing_length if echoes else 0.0)
    passed = np.exp(-PER_KM / 1e3 * length)
    depth = seen.sight.optical_depth.astype(float) - clear.sight.optical_depth
    assert np.exp(-depth) / passed == pytest.approx(1, rel=ROUNDING)
    before, after = (one.sight.returned if echoes else one.sight.contrast for one in (clear, seen))
    assert np.abs(before).min() > 0
    assert after == pytest.approx(before * passed, rel=ROUNDING)


@pytest.mark.usefixtures("dust")
@pytest.mark.parametrize("model", ["mpm93", "p676-13", "r24", "none"])
def test_it_emits_with_the_temperature_of_each_voxel(tmp_path, model):
    """The oracle's sum over the saved cube; without a gas, only temperature makes it uneven."""
    data = scene(
        camera__pixels=[6, 5],
        atmosphere__model=model,
        atmosphere__dust={"per_km": 20.0},
        atmosphere__fluctuations__temperature_sigma_k=2.0,
        output={"save_field": True},
    )
    result = run(tmp_path, data)
    assert result.error_budget["total"]["relative"] < 1e-5
    sight, cube, camera = result.variants[0].radiances, result.cubes[0], lens(data)
    origin, air = np.array(data["camera"]["position_m"]), oracle.planck(650e9, 290.0)
    surfaces = {0: (290.0, 0.0), 1: (285.0, 0.1), 2: (300.0, 0.2)}
    for row, column in np.ndindex(5, 6):
        far = float(sight.path_length[row, column])
        ray = origin, camera.ray(row, column), far, cube.voxel_m, ROTATIONS["oblique"]
        grams, metres = oracle.path(cube.absolute_humidity_g_m3.astype(float), *ray)
        kelvin, _ = oracle.path(cube.air_temperature_k, *ray)
        absorption = np.full(len(metres), 20e-3)
        if model != "none":
            absorption += oracle.absorption_per_m(650e9, kelvin, 1013.25, grams, model)
        t, r = surfaces[int(sight.target[row, column])]
        surface = (1 - r) * oracle.planck(650e9, t) + r * air
        source = np.array([oracle.planck(650e9, value) for value in kelvin])
        exact = oracle.transfer(absorption, metres, source, surface)
        scale = np.abs(source - air).max() + abs(surface - air)
        assert sight.contrast[0, row, column] == pytest.approx(exact - air, abs=scale * 3e-6)
        assert sight.optical_depth[0, row, column] == pytest.approx(absorption @ metres, rel=2e-6)


@pytest.mark.usefixtures("dust")
def test_a_cube_that_light_does_not_see_is_left_out(tmp_path):
    """That of humidity for dust alone, and that of temperature for echoes from dust alone."""
    alone = {"atmosphere__model": "none", "atmosphere__dust": {}}
    warm = {"atmosphere__fluctuations__temperature_sigma_k": 2.0}
    for changes, needed in (
        (alone, False),
        (alone | warm, True),
        (alone | warm | {"sensor": ACTIVE}, False),
        (alone | warm | {"atmosphere__dust": {"per_km": 0.0}}, False),
        ({"atmosphere__dust": {}}, True),
    ):
        plan = pipeline.prepare(write(tmp_path, scene(**changes)))
        assert (plan.variants[0].cube is not None) == needed
        (field,) = [one for one in report.stages(plan) if one.name == "humidity-field"]
        nothing = changes.get("atmosphere__dust") == {"per_km": 0.0}
        why = "air absorbs nothing" if nothing else "what absorbs does not vary"
        assert needed or why in field.reason


@pytest.mark.usefixtures("dust")
def test_it_costs_no_moment_and_is_named(tmp_path):
    clear, dusty = (
        pipeline.prepare(write(tmp_path, scene(**more)))
        for more in ({}, {"atmosphere__dust": {"per_km": PER_KM}})
    )
    assert report.moments(dusty) <= report.moments(clear)
    (stage,) = [one for one in report.stages(dusty) if one.name == "surrogate"]
    assert stage.reason.startswith("mpm93 + dust as polynomial")


@pytest.mark.usefixtures("dust")
def test_variants_may_differ_in_it(tmp_path):
    """One of them has none, another a table of another value; the path is one."""
    data = facing(40.0, atmosphere=DRIFTING | {"dust": {"per_km": PER_KM}})
    data["variants"] = [
        {"name": "thin", "set": {}},
        {"name": "thick", "set": {"atmosphere.dust.per_km": 5.0}},
    ]
    thin, thick = run(tmp_path, data).variants
    depth = thick.sight.optical_depth - thin.sight.optical_depth
    assert depth[0] == pytest.approx(4.5e-3 * thin.sight.path_length, rel=1e-5)


def test_specs_hold_name_and_parameters(tmp_path, dust):
    """They are equal if these are, and mean the same in another process."""
    air = Air((part("mpm93"), part("dust", {"per_km": 1.0})), 290.0, 1000.0, 8.0)
    same = Air((part("mpm93"), part("dust", {"per_km": 1.0})), 290.0, 1000.0, 8.0)
    assert air == same and hash(air) == hash(same)
    assert air != Air((part("mpm93"), part("dust")), 290.0, 1000.0, 8.0)
    code = (
        "import pickle, sys; air = pickle.loads(bytes.fromhex(sys.argv[1]));"
        "print(float(air.absorption(650e9)))"
    )
    command = [sys.executable, "-c", code, pickle.dumps(air).hex()]
    done = subprocess.run(
        command, env=os.environ | dust, capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert float(done.stdout) == float(air.absorption(650e9))


# --- what it says of itself ----------------------------------------------------------------------


def test_what_does_not_vary_is_asked_for_the_mean_air_alone(tmp_path, odd):
    """Once for each frequency, however many states the fit looks at."""
    body = ODD.replace("contract = 1", "contract = 1\n    varies = False").replace(
        "return OpticalProperties", "assert np.size(vapour_hpa) == 1; return OpticalProperties"
    )
    plan = prepare(tmp_path, odd(body), atmosphere__fluctuations__temperature_sigma_k=1.0)
    assert report.moments(plan) > 0  # of the gas, for which many states are looked at


def test_one_that_extrapolates_is_told_and_one_that_varies_too_far_refused(tmp_path, odd):
    body = ODD.replace(
        "contract = 1",
        'contract = 1\n    valid = (Span("frequency_ghz", 1, 800, "words", warn=(1, 600)),'
        ' Span("vapour_hpa", 0, 25))',
    )
    name = odd(body)
    plan = prepare(tmp_path, name, atmosphere__fluctuations=None)
    (warning,) = report.warnings(plan, [0.0])
    assert warning.startswith(f'650 GHz: "{name}" is stated to 600 GHz')
    with pytest.raises(ScenarioError, match="fluctuations") as caught:
        prepare(tmp_path, name, atmosphere__fluctuations__sigma_percent=25.0)
    assert f"remove [atmosphere.{name}]" in str(caught.value)
    with pytest.raises(ScenarioError, match=r"frequency_ghz: 900 GHz.*from 1 up to 800 GHz \(word"):
        prepare(tmp_path, name, sensor__frequency_ghz=900.0)


def test_a_gas_of_somebody_elses_is_a_model(tmp_path, odd):
    """And is proposed where another one ends."""
    name = odd(ODD.replace("contract = 1", "contract = 1\n    gas = True"))
    plan = pipeline.prepare(write(tmp_path, scene(atmosphere__model=name)))
    assert plan.variants[0].air.names == name
    with pytest.raises(ScenarioError, match=f'"{name}" or "none"|"none" or "{name}"'):
        pipeline.prepare(write(tmp_path, scene(sensor__frequency_ghz=2000.0)))


def test_a_narrow_line_in_a_band_is_found_where_it_is_told(tmp_path, odd):
    """A line 1 MHz wide in 100 GHz takes what Lorentz's profile says, 1.2e-4 of the band.

    Bands are summed to 1e-5; a coarse rule passes such a line by.
    """
    strength, width = 1e6, 1e6  # 1/m Hz, half width in Hz
    line = f"{strength} / np.pi * {width} / ((frequency_hz - 657.3e9) ** 2 + {width}**2)"
    body = ODD.replace("absorption=1e-3", line).replace(
        "    def optics", f"    def lines(self, *_): return [657.3e9], {width}\n    def optics"
    )
    air = MOIST | {"model": "none", odd(body): {}}
    wall = {"wall": MIRROR | {"reflectivity": 0.0}}
    one, other = (
        run(tmp_path, facing(40.0, atmosphere=given, sensor=BROAD, targets=wall)).variants[0]
        for given in (air, MOIST | {"model": "none"})
    )
    lost = 1 - one.sight.contrast / other.sight.contrast
    assert lost[0, 1, 1] == pytest.approx(_equivalent_width(strength, width, 40.0) / 1e11, abs=1e-5)


def _equivalent_width(strength, width, metres):
    """The integral of 1 - exp(-k L) over frequency, Hz, on an even grid in arctan."""
    angle = (np.arange(200_000) + 0.5) / 200_000 * np.pi - np.pi / 2
    hz = width * np.tan(angle)
    jacobian = width / np.cos(angle) ** 2
    lost = -np.expm1(-strength / np.pi * width / (hz**2 + width**2) * metres)
    inside = np.abs(hz) < 50e9
    return float((lost * jacobian * inside).sum() * np.pi / 200_000)


# --- the fit -------------------------------------------------------------------------------------


def test_a_degree_is_raised_only_while_the_error_falls(odd):
    """A step of 1e-3 at some vapour pressure is no reason for sixteen moments."""
    step = "2e-3 + 1e-5 * vapour_hpa**2 * (1 + 1e-3 * (vapour_hpa > 11.0))"
    air = Air((part(odd(ODD.replace("1e-3", step))),), 290.0, 1013.25, 8.0)
    found = fit(air, np.array([650e9]), (-0.8, 0.8), tolerance=1e-9)
    assert 1 <= found.moments < 5
    best = min(
        fit(air, np.array([650e9]), (-0.8, 0.8), tolerance=1e-9, moments=n).error
        for n in range(1, HIGHEST_DEGREE + 1)
    )
    assert found.error <= 2.5 * best
    assert found.measured <= found.error < 1e-3
