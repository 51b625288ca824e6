"""Models to compare with: each as if it were the main one, and the main one as if it were alone."""

from __future__ import annotations

import json
import re
from collections import Counter
from copy import deepcopy

import h5netcdf
import numpy as np
import pytest
from conftest import ROOT
from scenes import ACTIVE, BROAD, DRIFTING, MOIST, run, scene, write
from test_air_tables import save
from test_pairs import bits

from thzcl import pipeline
from thzcl.errors import NumbersError, ScenarioError
from thzcl.graph import Values, evaluate
from thzcl.paths.specs import TraceSpec
from thzcl.plan import report
from thzcl.plan.compare import rivals
from thzcl.results.figure import picture
from thzcl.results.spread import DECIBELS, signal
from thzcl.scenario.atmosphere import Atmosphere
from thzcl.sensing import image
from thzcl.sensing.image import ComparedSpec
from thzcl.sensing.spectrum import Bands
from thzcl.studies.convergence.subject import Subject

OTHERS = ["p676-13", "r24"]
OPTICS = {"aperture_m": 0.03}
SPECTRAL = {"kind": "passive-spectral", "frequency_ghz": 650.0}
BISTATIC = ACTIVE | {"arrangement": "bistatic", "transmitter_m": [0.0, 5.0, 6.0]}
PAPER = BROAD | {"quadrature": "paper", "step_ghz": 20.0}
WARM = {"atmosphere__fluctuations__temperature_sigma_k": 1.0}
SCAN = {"kind": "raster-scan", "dwell_s": 0.02, "detector": SPECTRAL}
SKY = {"sky": {"profile": "us-standard"}, "background__environment": "sky"}
LOW = SPECTRAL | {"frequency_ghz": [220.0, 340.0]}  # where one sees beyond the scene's own air
CLIMATES = [
    {"name": name, "set": {"atmosphere.relative_humidity_percent": percent}}
    for name, percent in {"dry": 20.0, "wet": 95.0}.items()
]
# What may change where light goes, when it is taken, how it is weighed, or how it is computed.
FEATURES = {
    "plain": {},
    "two frequencies": {"sensor": SPECTRAL | {"frequency_ghz": [340.0, 650.0]}},
    "scan": {"atmosphere": DRIFTING, "sensor": SCAN},
    "optics": {"sensor": SPECTRAL | {"optics": OPTICS}},
    "band": {"sensor": PAPER},
    "active": {"sensor": ACTIVE},
    "bistatic": {"sensor": BISTATIC},
    "samples": {"camera__samples_per_pixel": 4},
    "thinned": {"numerics__ray_stride": 4},
    "realisations": {"numerics__realizations": 3},
    "warm": WARM,
    "float64": {"numerics__precision": "float64"},
    "tolerance": {"numerics__tolerance": 1e-4},
    "variants": {"variants": CLIMATES},
    "even": {"atmosphere": MOIST},
}
SENSORS = ("two frequencies", "scan", "optics", "band", "active", "bistatic")
PAIRS = [
    (one, other)
    for number, one in enumerate(FEATURES)
    for other in list(FEATURES)[number + 1 :]
    if not {one, other} <= {*SENSORS}  # which are one key, and are combined below
    and {one, other} not in ({"thinned", "scan"}, {"realisations", "even"}, {"warm", "even"})
]
COMBINED = {
    "scan of optics": {
        "atmosphere": DRIFTING,
        "sensor": SCAN | {"detector": SPECTRAL | {"optics": OPTICS}},
    },
    "scan of a band": {"atmosphere": DRIFTING, "sensor": SCAN | {"detector": PAPER}},
    "scan of two frequencies": {
        "atmosphere": DRIFTING,
        "sensor": SCAN | {"detector": SPECTRAL | {"frequency_ghz": [340.0, 650.0]}},
    },
    "bistatic scan": {"atmosphere": DRIFTING, "sensor": SCAN | {"detector": BISTATIC}},
    "bistatic optics": {"sensor": BISTATIC | {"optics": OPTICS}},
    "optics of a band": {"sensor": PAPER | {"optics": OPTICS}},
    "sky": SKY | {"sensor": LOW},
    "sky in even air": SKY | {"sensor": LOW, "atmosphere": MOIST},
    "sky in warm air": SKY | WARM | {"sensor": LOW},
    "sky of a band": SKY | {"sensor": PAPER | {"center_ghz": 220.0}},
    "warm scan of optics": {
        "atmosphere": DRIFTING
        | {"fluctuations": DRIFTING["fluctuations"] | {"temperature_sigma_k": 1.0}},
        "sensor": SCAN | {"detector": SPECTRAL | {"optics": OPTICS}},
    },
}


def comparing(changes, others=OTHERS):
    """Returns a scene of few pixels, in which models are compared."""
    small = {"camera__pixels": [8, 6], **deepcopy(changes)}
    return scene(**{"numerics__error_budget": False, **small}, atmosphere__compare=others)


def agrees(folder, data, main="mpm93", others=OTHERS):
    """Asserts that models beside each other are what each of them is alone."""
    together = run(folder, data)
    # What the main model's depth settles where the user has not.
    fixed = {"atmosphere.compare": None, "output.model_spread": None}
    alone = run(folder, data, settings=fixed)
    for one, other in zip(together.variants, alone.variants, strict=True):
        assert bits(one) == bits(other)
        assert np.array_equal(one.sight.optical_depth, other.sight.optical_depth)
        assert [model.name for model in one.compared] == others
        assert one.by_model(main)[0].name == main
    for number, model in enumerate(others):
        single = run(folder, data, settings=fixed | {"atmosphere.model": model})
        for one, other in zip(together.variants, single.variants, strict=True):
            compared = one.compared[number].sight
            due, found = signal(other.sight), signal(compared)
            assert found.shape == due.shape
            assert np.abs(found - due).max() < 1e-6 * np.abs(due).max()
            apart = np.exp(-compared.optical_depth) - np.exp(-other.sight.optical_depth)
            assert np.abs(apart).max() < 1e-6
            assert np.abs(due - signal(one.sight)).max() > 1e-3 * np.abs(due).max()
    return together


@pytest.mark.parametrize("name", [*FEATURES, *COMBINED])
def test_models_beside_each_other_are_what_each_is_alone(tmp_path, name):
    agrees(tmp_path, comparing((FEATURES | COMBINED)[name]))


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other"), PAIRS)
def test_so_they_are_with_any_two_features(tmp_path, one, other):
    changes = FEATURES[one] | FEATURES[other]
    if "atmosphere" in changes and any(name.startswith("atmosphere__") for name in changes):
        changes = {"atmosphere": changes.pop("atmosphere")} | changes
    agrees(tmp_path, comparing(changes))


@pytest.mark.parametrize("changes", [{}, WARM, FEATURES["scan"]])
@pytest.mark.parametrize(("main", "others"), [("none", ["mpm93", "r24"]), ("mpm93", ["none"])])
def test_a_model_that_needs_no_cube_takes_none_from_the_others(tmp_path, changes, main, others):
    """Nor does one that needs it change an image that does not."""
    data = comparing(changes, others)
    data["atmosphere"] |= {"model": main}
    agrees(tmp_path, data, main, others)


def test_rays_end_where_the_main_model_ends_them(tmp_path):
    """Its image stays as it is. By r24, which absorbs less, rays would go on."""
    deep = {"numerics__cutoff_depth": 1.0, "background__max_range_m": 900.0}
    together = run(tmp_path, comparing(deep)).variants[0]
    alone, single = (
        run(tmp_path, comparing(deep, []), settings={"atmosphere.model": model}).variants[0]
        for model in ("mpm93", "r24")
    )
    assert bits(together) == bits(alone)
    assert np.array_equal(together.sight.optical_depth, alone.sight.optical_depth)
    depth = together.compared[1].sight.optical_depth
    assert depth.max() < 0.9 * together.sight.optical_depth.max()
    assert depth.max() < 1.0 < single.sight.optical_depth.max()


def test_a_resolved_band_has_the_main_models_frequencies(tmp_path):
    """They are close to those that another model would choose."""
    data = comparing({"sensor": BROAD})
    together = run(tmp_path, data).variants[0]
    alone = run(tmp_path, data, settings={"atmosphere.compare": None}).variants[0]
    assert bits(together) == bits(alone)
    for one in together.compared:
        assert np.array_equal(one.sight.nodes_hz, together.sight.nodes_hz)
        own = {"atmosphere.compare": None, "atmosphere.model": one.name}
        due = signal(run(tmp_path, data, settings=own).variants[0].sight)
        assert np.abs(signal(one.sight) - due).max() < 1e-4 * np.abs(due).max()


@pytest.mark.parametrize(
    ("changes", "path", "each"), [({}, "TraceSpec", 0), (WARM, "EmissionSpec", 1)]
)
def test_each_model_costs_one_fit_and_one_shading(tmp_path, device, changes, path, each):
    """And one more pass in air of fluctuating temperature. Without models there is nothing more."""
    runs = []
    for others in ([], OTHERS):
        plan, counted = pipeline.prepare(write(tmp_path, comparing(changes, others))), Counter()
        list(evaluate([plan.batch()], device, runs=counted))
        runs.append(counted)
    alone, together = runs
    more = {"ComparedSpec": 2, "ExpansionSpec": 2, "SumSpec": 2, "PixelsSpec": 2}
    more |= {path: 2 * each, "CarriedSpec" if each else "ShadeSpec": 2, "TrimmedSpec": 2 * each}
    assert together - alone == Counter({name: n for name, n in more.items() if n})
    assert alone["ComparedSpec"] == 0


def test_what_is_not_compared_is_not_planned(tmp_path):
    data = comparing({})
    plan = pipeline.prepare(write(tmp_path, data))
    bare = pipeline.prepare(write(tmp_path, data), {"atmosphere.compare": None})
    assert set(plan.alone().specs()) == set(bare.specs())
    assert not any(isinstance(spec, ComparedSpec) for spec in bare.specs())
    (path,) = (spec for spec in plan.specs() if isinstance(spec, TraceSpec))
    assert [len(fits) for fits in (path.serves, path.also)] == [1, 2]
    words = {stage.name: stage.reason for stage in report.stages(plan)}["surrogate"]
    assert words.startswith("mpm93, p676-13, r24 as polynomial of degree ")


def test_convergence_studies_the_main_model_alone(tmp_path, device):
    """Its times would be those of all models, and its errors those of one."""
    file = write(tmp_path, comparing({}))
    plan = Subject(file, {}, (), device).plan
    bare = pipeline.prepare(file, {"atmosphere.compare": None})
    assert plan.batch() == bare.batch()


# --- where a model is not valid --------------------------------------------------------------


def test_a_model_is_left_out_where_it_is_not_valid(tmp_path):
    """With a note; the file has no number there, and targets' means are over the rest."""
    sensor = SPECTRAL | {"frequency_ghz": [340.0, 850.0]}
    result = run(tmp_path, comparing({"sensor": sensor}))
    due = run(tmp_path, comparing({"sensor": SPECTRAL | {"frequency_ghz": 340.0}}))
    assert 'scene: compare = "r24" is left out at 1 of 2 frequencies: 850 GHz: "r24" holds ' in (
        " ".join(result.warnings)
    )
    alone = due.variants[0].compared[1]
    one = result.variants[0].compared[1]
    assert (one.name, one.planes) == ("r24", (0,))
    assert np.abs(signal(one.sight) - signal(alone.sight)).max() < 1e-6
    found = result.to_xarray()
    for name in ("optical_depth", "brightness_temperature_contrast"):
        assert found[name].dims == ("model", "variant", "frequency", "y", "x")
        missing = np.isnan(found[name]).all(("y", "x")).sel(variant="scene")
        assert missing.values.tolist() == [[False, False], [False, False], [False, True]]
    models = result.summary()["variants"][0]["models"]
    assert [models[name]["frequency_ghz"] for name in models] == [[340, 850], [340, 850], [340]]
    assert models["r24"]["targets"]["box"]["mean_contrast_k"] == pytest.approx(
        due.summary()["variants"][0]["models"]["r24"]["targets"]["box"]["mean_contrast_k"]
    )


@pytest.mark.parametrize(
    ("changes", "note"),
    [
        ({"sensor": PAPER | {"center_ghz": 780.0}}, 'GHz: "r24" holds up to 800 GHz'),
        ({"sensor": SPECTRAL | {"frequency_ghz": 850.0}}, '850 GHz: "r24" holds up to 800 GHz'),
    ],
)
def test_a_model_that_is_valid_nowhere_is_left_out_whole(tmp_path, changes, note):
    """A band that lies partly outside counts as outside."""
    result = run(tmp_path, comparing(changes))
    assert [one.name for one in result.variants[0].compared] == ["p676-13"]
    assert result.models == ("mpm93", "p676-13")
    (told,) = (one for one in result.warnings if "left out" in one)
    assert told.startswith('scene: compare = "r24" is left out: ')
    assert note in told
    alone = run(tmp_path, comparing(changes, ["r24"]))
    assert alone.models == ()
    assert "model" not in alone.to_xarray().dims
    assert "model" not in alone.error_budget
    assert "models" not in alone.summary()["variants"][0]


FOGGED = """
from thzcl.constituent import Constituent, OpticalProperties, Parameters, Span, hookimpl

class Odd(Constituent):
    name = "odd"
    contract, varies, gas = 1, True, True
    Params = Parameters
    valid = (Span("vapour_hpa", 0.0, 15.0, "as measured"),)

    def optics(self, frequency_hz, temperature_k, pressure_hpa, vapour_hpa):
        return OpticalProperties(1e-4 * vapour_hpa + 0 * temperature_k * frequency_hz)

@hookimpl
def register_constituents():
    return [Odd]
"""


def test_a_model_that_does_not_hold_the_cubes_air_is_left_out(tmp_path, odd):
    """As it is where the mean air lies outside. A main model is refused in both cases."""
    name = odd(FOGGED)
    for changes in ({}, {"atmosphere__relative_humidity_percent": 95.0}):
        result = run(tmp_path, comparing(changes, [name, "r24"]))
        assert result.models == ("mpm93", "r24")
        (note,) = (one for one in result.warnings if "left out" in one)
        assert f'compare = "{name}" is left out: ' in note
        assert f'hPa of vapour: "{name}" holds up to 15 hPa' in note
        with pytest.raises(ScenarioError, match="hPa of vapour"):
            run(tmp_path, comparing(changes, []), settings={"atmosphere.model": name})
    calm = comparing({"atmosphere__fluctuations__sigma_percent": 1.0}, [name])
    assert run(tmp_path, calm).models == ("mpm93", name)


def test_a_main_model_that_is_not_valid_is_refused(tmp_path):
    data = comparing({"sensor": SPECTRAL | {"frequency_ghz": 850.0}}, ["mpm93"])
    with pytest.raises(ScenarioError, match='850 GHz: "r24" holds up to 800 GHz'):
        run(tmp_path, data, settings={"atmosphere.model": "r24"})


def test_a_model_that_extrapolates_says_so(tmp_path):
    result = run(tmp_path, comparing({"sensor": SPECTRAL | {"frequency_ghz": 790.0}}))
    assert any('790 GHz: "r24" is stated to 780 GHz' in one for one in result.warnings)


def test_a_band_is_left_out_whole_and_others_stay():
    """Of two bands, of which one reaches beyond 800 GHz; so does a node that weighs nothing."""
    hz = np.array([700e9, 750e9, 790e9, 850e9])
    bands = Bands(Values.of(hz), Values.of([[1.0, 2.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]))
    air = Atmosphere(temperature_k=290.0, relative_humidity_percent=50.0, compare=("r24",))
    (one,) = rivals(air.compared, bands)
    assert one.planes == (0,)
    assert one.note(2).startswith('compare = "r24" is left out at 1 of 2 frequencies: 850 GHz')
    rest = bands.only(one.planes)
    assert rest.nodes_hz.array.tolist() == hz[:3].tolist()
    assert rest.given.array.tolist() == [[1.0, 2.0, 1.0]]


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor": {"optics": OPTICS}},
        pytest.param(WARM, marks=pytest.mark.slow),
        pytest.param({"atmosphere": DRIFTING, "scan": True}, marks=pytest.mark.slow),
        pytest.param({"numerics__realizations": 2}, marks=pytest.mark.slow),
    ],
)
def test_what_is_left_of_a_model_is_as_it_would_be_alone(tmp_path, changes):
    """The other frequency changes how rays sample the beam, by little."""
    found = []
    for beyond in (850.0, 799.0):
        sensor = SPECTRAL | {"frequency_ghz": [340.0, beyond]} | changes.get("sensor", {})
        rest = {name: value for name, value in changes.items() if name not in ("sensor", "scan")}
        if "scan" in changes:
            sensor = SCAN | {"detector": sensor | {"optics": OPTICS}}
        result = run(tmp_path, comparing(rest | {"sensor": sensor}))
        found.append(result.variants[0].compared[1])
    few, all_of = found
    assert (few.planes, all_of.planes) == ((0,), (0, 1))
    due = signal(all_of.sight)[0]
    assert np.abs(signal(few.sight)[0] - due).max() < 2e-3 * np.abs(due).max()
    depth = few.sight.optical_depth[0]  # which changes at edges, where more rays mean a pixel
    assert depth == pytest.approx(all_of.sight.optical_depth[0], rel=0.05)


def test_what_is_no_number_fails_as_it_does_in_the_image(tmp_path, monkeypatch):
    """A file's NaN says that a model is left out, and nothing else."""
    whole = image._sight  # noqa: SLF001 (nothing else reaches it)

    def holed(spec, *seen):
        sight = whole(spec, *seen)
        if isinstance(spec, ComparedSpec):
            sight.contrast[0, 2, 3] = np.nan
        return sight

    monkeypatch.setattr(image, "_sight", holed)
    with pytest.raises(NumbersError, match='by "p676-13" 1 pixels are not finite') as caught:
        run(tmp_path, comparing({}))
    assert caught.value.exit_code == 4


# --- bad input -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"compare": ["r25"]}, 'compare.0: no constituent "r25" is installed (did you mean r24?)'),
        ({"compare": ["p676"]}, "did you mean p676-13?"),
        ({"compare": ["mpm93"]}, '"mpm93" is there already; name each model once'),
        ({"compare": ["r24", "r24"]}, 'compare.1: "r24" is there already'),
        ({"compare": "r24"}, "compare: must be a list"),
        ({"compare": [24]}, "compare.0: must be text"),
        ({"compare": ["table"]}, "model_file: missing"),
        ({"compare": ["r24"], "model_file": "a.nc"}, "is read by a model that is a table"),
        ({"compare": ["r24"], "table": {}}, "is the table of a gas that is not in use"),
        ({"model": "r25", "compare": ["r24"]}, 'model: no constituent "r25" is installed'),
    ],
)
def test_models_that_cannot_be_compared_are_refused(tmp_path, changes, text):
    data = scene()
    data["atmosphere"] |= changes
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, data))
    assert text in str(caught.value)


def test_what_is_no_gas_is_not_compared(tmp_path, dust):  # noqa: ARG001 (installed)
    with pytest.raises(ScenarioError, match=r'compare.0: "dust" is no gas, and joins any model'):
        pipeline.prepare(write(tmp_path, scene(atmosphere__compare=["dust"])))
    joined = scene(atmosphere__compare=["r24"], atmosphere__dust={"per_km": 2.0})
    agrees(tmp_path, joined | {"numerics": {"error_budget": False}}, others=["r24"])


def test_variants_of_one_file_compare_the_same_models(tmp_path):
    changed = [{"name": "a", "set": {}}, {"name": "b", "set": {"atmosphere.model": "p676-13"}}]
    data = scene(variants=changed, atmosphere__compare=["r24"])
    with pytest.raises(ScenarioError, match="all variants must compare the same models"):
        pipeline.prepare(write(tmp_path, data))
    pipeline.prepare(write(tmp_path, data), {"atmosphere.compare": None})
    with pytest.raises(ScenarioError, match=r"model_spread: needs models to compare with"):
        pipeline.prepare(write(tmp_path, scene(output={"model_spread": True})))


def test_a_table_is_compared_by_its_file(tmp_path):
    """model_file serves it, whichever of the models it is."""
    save(tmp_path / "air.nc", [640.0, 650.0], [290.0], np.linspace(0.0, 40.0, 9))
    given = {"model_file": "air.nc", "compare": ["table"]}
    for tables in (given, {"compare": ["table"], "table": {"file": "air.nc"}}):
        data = scene(camera__pixels=[8, 6])
        data["atmosphere"] |= tables
        (one,) = run(tmp_path, data).variants[0].compared
        assert one.name == "table"
        assert np.isfinite(signal(one.sight)).all()


# --- what is told ----------------------------------------------------------------------------


def test_targets_are_told_by_model(tmp_path, capsys):
    """In JSON and as text; the image's own model comes first."""
    from thzcl.__main__ import main

    file = write(tmp_path, scene(atmosphere__compare=OTHERS, camera__pixels=[8, 6]))
    assert main(["run", str(file), "-o", str(tmp_path), "--no-figure", "--format", "json"]) == 0
    (variant,) = json.loads(capsys.readouterr().out)["variants"]
    assert list(variant["models"]) == ["mpm93", *OTHERS]
    assert variant["models"]["mpm93"]["targets"] == variant["targets"]
    passed = [
        variant["models"][name]["targets"]["box"]["transmission"] for name in variant["models"]
    ]
    assert passed == sorted(passed)
    assert main(["run", str(file), "-o", str(tmp_path), "--no-figure"]) == 0
    text = capsys.readouterr().out
    assert all(re.search(rf"box +{name} ", text) for name in ("mpm93", *OTHERS))
    with h5netcdf.File(tmp_path / "scene.nc") as stored:
        assert [name.decode() for name in stored["model"][:]] == ["mpm93", *OTHERS]
        shape = stored["brightness_temperature_contrast"].shape
        assert shape == (3, 1, 1, 6, 8)
        by_model = {name for name in stored.variables if "model" in stored[name].dimensions}
        assert by_model == {"model", "optical_depth", "brightness_temperature_contrast"}


@pytest.mark.parametrize("sensor", [SPECTRAL, ACTIVE])
def test_the_budget_tells_half_the_spread_of_the_targets(tmp_path, sensor):
    """It enters neither the total nor what is held against the tolerance."""
    data = scene(sensor=sensor, numerics={"tolerance": 1e-4})
    result = run(tmp_path, data, settings={"atmosphere.compare": OTHERS})
    alone = run(tmp_path, data)
    part, (variant,) = result.error_budget["model"], result.variants
    sights = [variant.sight, *(one.sight for one in variant.compared)]
    flags, halves = variant.sight.target, {}
    for flag in np.unique(flags):
        means = [float(signal(sight)[0][flags == flag].mean()) for sight in sights]
        halves[flag] = (max(means) - min(means)) / 2
    per_pixel = np.vectorize(halves.get)(flags)
    assert part["max"] == pytest.approx(max(halves.values()))
    assert part["rms"] == pytest.approx(np.sqrt((per_pixel**2).mean()))
    assert part["relative"] == pytest.approx(part["rms"] / np.abs(signal(variant.sight)).max())
    assert part["unit"] == result.error_budget["total"]["unit"]
    assert part["relative"] > 1e-4
    del result.error_budget["model"]
    assert result.error_budget == alone.error_budget
    assert result.warnings == alone.warnings


@pytest.mark.parametrize("sensor", [SPECTRAL, ACTIVE])
def test_a_picture_can_show_how_far_the_models_differ(tmp_path, sensor):
    """Beside the image of each variant; in dB of the loss for echoes."""
    changes = {"sensor": sensor, "variants": CLIMATES, "output": {"model_spread": True}}
    result = run(tmp_path, comparing(changes))
    drawn = [axes for axes in picture(result).axes if axes.get_title()]
    titles = [axes.get_title().splitlines() for axes in drawn]
    assert [title[0] for title in titles] == ["dry", "dry", "wet", "wet"]
    assert titles[1][1] == titles[3][1] == "spread over mpm93, p676-13, r24"
    for number, variant in enumerate(result.variants):
        sights = [variant.sight, *(one.sight for one in variant.compared)]
        values = [signal(one) for one in sights]
        if sensor is ACTIVE:
            values = [10 / np.log(10) * one.optical_depth for one in sights]
        shown = np.asarray(drawn[2 * number + 1].images[0].get_array())
        assert shown == pytest.approx(np.ptp(values, axis=0)[0], abs=1e-5)
    quiet = run(tmp_path, comparing(changes), settings={"output.model_spread": False})
    assert len([axes for axes in picture(quiet).axes if axes.get_title()]) == 2


@pytest.mark.slow
def test_readme_tells_what_the_choice_does_to_the_papers_figures():
    """Each row of its table, from runs of the scenes as they are shipped."""
    told = (ROOT / "README.md").read_text(encoding="utf-8")
    cell = r" \| (-?[\d.]+)[^|]*"
    rows = re.findall(rf"^\| (.*?){cell}{cell}{cell}\|$", told, re.MULTILINE)
    table = {words: [float(number) for number in numbers] for words, *numbers in rows}
    settings = {"atmosphere.compare": OTHERS, "numerics.error_budget": False}
    six, nine = (
        pipeline.run(name, settings=settings, figure=False) for name in ("figure6", "figure9")
    )

    def by_model(result, variant, target, key):
        variants = {one["name"]: one for one in result.summary()["variants"]}
        models = variants[variant]["models"].values()
        return np.array([one["targets"][target][key] for one in models])

    cold, warm = "(a) 263 K", "(f) 278 K"
    box = by_model(six, cold, "box", "mean_contrast_k")
    ground = by_model(six, cold, "ground", "mean_contrast_k")
    due = {
        "figure 6: transmission to the box": by_model(six, cold, "box", "transmission"),
        "contrast of the box to the air, box of 263 K": box,
        "box of 278 K": by_model(six, warm, "box", "mean_contrast_k"),
        "contrast of the box to the ground, box of 263 K": box - ground,
    }
    first = "figure 9: loss out and back to the subject, "
    for climate in ("40 m, 20 °C, 44 % RH", "80 m, 43 °C, 30 % RH", "80 m, 35 °C, 90 % RH"):
        depth = by_model(nine, climate, "subject", "optical_depth")
        due[first + climate if climate.startswith("40") else climate] = DECIBELS * depth
    wettest = nine.variants[-1].by_model("mpm93")
    brightest = [10 * np.log10(float(one.sight.returned.max())) + 50 for one in wettest]
    due["its brightest pixel there, over the floor"] = np.array(brightest)
    assert set(due) <= set(table)
    for words, numbers in due.items():
        last = 10.0 ** -len(re.search(rf"{re.escape(words)} \| -?\d+\.(\d+)", told)[1])
        assert table[words] == pytest.approx(numbers, abs=0.6 * last), words
