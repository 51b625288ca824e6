"""The result file: what it holds, in which form, and that it can be read by others."""

from __future__ import annotations

import errno
import itertools
import json
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5netcdf
import numpy as np
import pytest
from scenes import BROAD, run, scene, write
from thzcl.sensors.passive_spectral import PassiveSpectral

from thzcl import pipeline
from thzcl.air import radiometry
from thzcl.errors import FileError, NumbersError, ScenarioError
from thzcl.results import figure
from thzcl.results.netcdf import attributes, variables
from thzcl.results.rows import rows
from thzcl.sensor import RESERVED_NAMES, Layer

METHODS = ("write", "readinto", "seek", "truncate", "flush", "close")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    folder = tmp_path_factory.mktemp("two")
    data = scene(
        sensor__frequency_ghz=[650.0, 350.0],
        output={"save_field": True},
        variants=[
            {"name": "warm", "set": {}},
            {"name": "cold", "set": {"targets.box.temperature_k": 250.0}},
        ],
    )
    result = run(folder, data)
    return result, result.save(folder / "two.nc")


def test_the_file_holds_what_the_design_lists(two):
    result, path = two
    with h5netcdf.File(path) as file:
        spectral = ("variant", "frequency", "y", "x")
        for name, units in (
            ("radiance", "W m-2 sr-1 Hz-1"),
            ("brightness_temperature", "K"),
            ("brightness_temperature_contrast", "K"),
            ("optical_depth", "1"),
        ):
            assert file[name].dimensions == spectral
            assert file[name].shape == (2, 2, 12, 16)
            assert file[name].attrs["units"] == units
        assert file["image"].dimensions == ("variant", "y", "x")
        assert file["path_length"].dimensions == ("y", "x")
        assert file["path_length"].attrs["units"] == "m"
        target = file["target"]
        assert target.dimensions == ("y", "x")
        assert target.attrs["flag_values"].tolist() == [0, 1, 2]
        assert target.attrs["flag_meanings"] == "background ground box"
        assert file["frequency"][...].tolist() == [350.0, 650.0]
        assert file["frequency"].attrs["units"] == "GHz"
        assert [
            name if isinstance(name, str) else name.decode() for name in file["variant"][...]
        ] == ["warm", "cold"]
        assert file["absolute_humidity"].shape == (32, 32, 32)
        assert file["absolute_humidity"].attrs["voxel_m"] == 0.7
        assert file["x_angle"].attrs["units"] == "mrad"
        for name in (
            "scenario_toml",
            "versions",
            "device",
            "seed",
            "build_options",
            "seconds",
            "left_out",
            "warnings",
            "grid_rotation",
        ):
            assert name in file.attrs
        assert np.shape(json.loads(file.attrs["grid_rotation"])) == (3, 3)
        assert json.loads(file.attrs["seconds"])["trace"] > 0
        assert file.attrs["Conventions"].startswith("CF-")
    assert result.variants[0].name == "warm"


def test_what_is_stored_belongs_together(two):
    _, path = two
    with h5netcdf.File(path) as file:
        hz = file["frequency"][...][None, :, None, None] * 1e9
        radiance, kelvin = file["radiance"][...].astype(float), file["brightness_temperature"][...]
        contrast = file["brightness_temperature_contrast"][...]
        assert radiometry.brightness_temperature(hz, radiance) == pytest.approx(kelvin, rel=1e-6)
        assert kelvin - contrast == pytest.approx(290.0, abs=1e-4)
        assert file["image"][...] == pytest.approx(290 + contrast.mean(axis=1), abs=1e-4)


TREE = {"kind": "box", "center_m": [20, 2, 1], "size_m": [2, 2, 2], "temperature_k": 270.0}
CAR = TREE | {"center_m": [25, 3, 1]}


def test_variants_may_bring_targets_and_lenses_of_their_own(tmp_path):
    """A target has one flag in all variants, and angles are those of each variant's lens."""
    own = [
        {"targets.car": CAR},
        {"targets.tree": TREE, "camera.focal_length_mm": 60.0},
        {"targets": {"tree": TREE}},
    ]
    variants = [{"name": str(n), "set": keys} for n, keys in enumerate(own)]
    result = run(tmp_path, scene(variants=variants))
    shown = [set(variant["targets"]) for variant in result.summary()["variants"]]
    assert [one & {"box", "car", "tree"} for one in shown] == [
        {"box", "car"},
        {"box", "tree"},
        {"tree"},
    ]
    with h5netcdf.File(result.save(tmp_path / "own.nc")) as file:
        assert file["target"].attrs["flag_meanings"] == "background ground box car tree"
        assert [*np.unique(file["target"][1])] == [0, 1, 2, 4]
        angles = file["x_angle"]
        assert angles.dimensions == ("variant", "x") and angles.attrs["units"] == "mrad"
        assert np.tan(angles[0] / 1e3) == pytest.approx(2 * np.tan(angles[1] / 1e3))
    extents = {round(axes.images[0].get_extent()[1]) for axes in figure.picture(result).axes[:3]}
    assert len(extents) == 2


ONE_FILE = {
    "sensors": ({"sensor": BROAD}, {}, "sensor: all variants must be of one kind"),
    "voxels": ({"atmosphere.fluctuations.voxel_m": 0.5}, {}, "[output] save_field: all variants"),
    "grids": ({"atmosphere.fluctuations.grid": 16}, {}, "[output] save_field: all variants"),
    "cubes": (
        {"atmosphere.fluctuations.grid_orientation": "aligned"},
        {},
        "[output] save_field: all variants must have cubes of the same voxel_m, grid and",
    ),
    "files": ({"output.figure_columns": 1}, {}, "output: is that of the one file"),
    "lenses": (
        {"camera.focal_length_mm": 60.0},
        {"difference": ["a", "b"]},
        "[output] difference: the pixels of the two images lie at different angles",
    ),
}


@pytest.mark.parametrize("name", ONE_FILE)
def test_what_one_file_cannot_hold_is_refused(tmp_path, name):
    own, output, words = ONE_FILE[name]
    variants = [{"name": "a", "set": {}}, {"name": "b", "set": own}]
    data = scene(output={"save_field": True} | output, variants=variants)
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(write(tmp_path, data))
    assert any(words in problem for problem in caught.value.problems), caught.value.problems
    assert pipeline.prepare(write(tmp_path, data), variants=["b"])


def test_a_scan_beside_a_focal_plane_is_of_one_kind(tmp_path):
    scan = {"kind": "raster-scan", "dwell_s": 1e-3, "detector": scene()["sensor"]}
    variants = [{"name": "still", "set": {}}, {"name": "scanned", "set": {"sensor": scan}}]
    assert pipeline.prepare(write(tmp_path, scene(variants=variants)))


def test_images_of_other_quantities_are_never_stored_as_one(tmp_path, monkeypatch):
    """A plugin's sensor may change its quantity with its parameters, which only its images say."""
    healthy = PassiveSpectral.observe

    def observe(sensor, sight, rng):
        unit = "K" if sensor.params.frequency_ghz == 650 else "mK"
        return replace(healthy(sensor, sight, rng), unit=unit)

    monkeypatch.setattr(PassiveSpectral, "observe", observe)
    variants = [{"name": f"{f}", "set": {"sensor.frequency_ghz": f}} for f in (340, 650)]
    with pytest.raises(NumbersError, match="in mK, brightness temperature in K"):
        run(tmp_path, scene(variants=variants))


def test_a_result_runs_the_variants_again_that_were_made(two, tmp_path):
    """Unless others are asked for; one of all variants runs all."""
    result, _ = two
    path = replace(result, variants=result.variants[1:]).save(tmp_path / "cold.nc")
    for names, due in (((), ["cold"]), (["warm"], ["warm"]), (["cold", "warm"], ["warm", "cold"])):
        plan = pipeline.prepare(path, variants=names)
        assert [variant.name for variant in plan.variants] == due
    plain = run(tmp_path, scene()).save(tmp_path / "other_name.nc")
    assert len(pipeline.prepare(plain).variants) == 1
    assert len(pipeline.prepare(two[1]).variants) == 2


def test_microkelvins_survive(tmp_path):
    result = run(
        tmp_path,
        scene(targets__box__temperature_k=290.000001, targets__box__reflectivity=0.0, ground=None),
    )
    path = result.save(tmp_path / "faint.nc")
    with h5netcdf.File(path) as file:
        box = file["target"][...] == 2
        contrast = file["brightness_temperature_contrast"][0, 0][box]
        depth = file["optical_depth"][0, 0][box].astype(float)
    assert box.sum() > 5
    assert contrast == pytest.approx(1e-6 * np.exp(-depth), rel=1e-4)


def test_xarray_sees_the_same(two):
    xarray = pytest.importorskip("xarray")
    result, path = two
    dataset = result.to_xarray()
    with xarray.open_dataset(path, engine="h5netcdf") as stored:
        assert set(stored.variables) == set(dataset.variables)
        assert stored["variant"].to_numpy().tolist() == ["warm", "cold"]
        for name in stored.data_vars:
            assert np.array_equal(stored[name], dataset[name])


def test_a_saved_cube_is_the_next_scenes_air(two, tmp_path):
    result, path = two
    data = scene(
        sensor__frequency_ghz=[650.0, 350.0],
        atmosphere__fluctuations={
            "spectrum": "file",
            "file": str(path),
            "grid_orientation": "oblique",  # as the cube lay that was saved
        },
        variants=[{"name": "warm", "set": {}}],
    )
    again = run(tmp_path, data)
    assert again.variants[0].radiances.optical_depth == pytest.approx(
        result.variants[0].radiances.optical_depth, rel=2e-6
    )


@pytest.mark.parametrize(
    ("shape", "fill", "expected"),
    [
        ((16,) * 3, -1.0, "negative"),
        ((16,) * 3, np.nan, "finite"),
    ],
)
def test_a_cube_that_cannot_be_used_is_refused(tmp_path, shape, fill, expected):
    from test_trace import write_cube

    write_cube(tmp_path / "cube.nc", np.full(shape, fill), 0.5)
    with pytest.raises(ScenarioError, match=expected):
        run(tmp_path, scene(atmosphere__fluctuations={"spectrum": "file", "file": "cube.nc"}))


def test_it_shows_itself_in_a_notebook(two):
    shown = replace(two[0], scenario="<b>")._repr_html_()
    assert "<table>" in shown and "box" in shown and " K</td>" in shown
    assert "<b>" not in shown and "&lt;b&gt;" in shown


LONG = "$5$ a name that goes on for much longer than a panel is wide " + "x" * 90


@pytest.mark.parametrize(
    ("pixels", "plane"), [([1, 1], [9.0, 9.0]), ([40, 1], [9.0, 0.3]), ([2, 40], [0.4, 9.0])]
)
def test_pictures_of_odd_shapes_fit_with_all_their_words(tmp_path, pixels, plane):
    """Long names are folded, "$" is no mathematics, and no letter is cut or lies on another."""
    changes = {"camera__pixels": pixels, "camera__focal_plane_mm": plane}
    several = {
        "numerics": {"realizations": 2},
        "variants": [
            {"name": LONG, "set": {}},
            {"name": "日本", "set": {"atmosphere.temperature_k": 280.0}},
        ],
    }
    for more in ({}, several):
        result = pipeline.run(write(tmp_path, scene(**changes, **more), "long_name_" * 9))
        drawn = picture(result)
        width, height = drawn.canvas.get_width_height()
        title = drawn.get_suptitle()
        assert title.replace("\n", "").replace(" ", "").startswith("long_name_" * 9 + ":650GHz")
        boxes = [drawn.texts[0].get_window_extent()]
        boxes += [axes.title.get_window_extent() for axes in drawn.axes if axes.title.get_text()]
        for box in boxes:
            assert box.x0 >= 0 and box.x1 <= width
            assert box.y0 >= 0 and box.y1 <= height
        for one, other in itertools.combinations(boxes, 2):
            assert not one.overlaps(other)


def picture(result):
    """The matplotlib figure of a result; a font may lack letters."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")
        drawn = figure.picture(result)
        drawn.canvas.draw()
    return drawn


def test_a_picture_is_of_the_kind_that_its_name_says(two, tmp_path):
    result, _ = two
    starts = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml", "PNG": b"\x89PNG"}
    for ending, start in starts.items():
        assert result.figure(tmp_path / f"two.{ending}").read_bytes().startswith(start)
    for name in ("two.jpg", "two", "two.png.gz"):
        with pytest.raises(FileError, match=r"written as \.png, \.pdf or \.svg"):
            result.figure(tmp_path / name)
        assert not (tmp_path / name).exists()


STATISTICS = {"image_variance", "image_spread"}  # of an ensemble, thzcl's own
STATISTICS |= {f"image_percentile_{percent}" for percent in (5, 50, 95)}


def test_every_name_in_the_file_is_reserved(tmp_path):
    """Of every kind of scene; but the sensors' own layers are theirs."""
    fluctuating = {"atmosphere__fluctuations__temperature_sigma_k": 0.5}
    changed = [{"name": "a", "set": {}}, {"name": "b", "set": {"sensor.frequency_ghz": 350.0}}]
    scenes = [
        scene(
            **fluctuating,
            variants=changed,
            output={"save_field": True, "difference": ["a", "b"]},
        ),
        scene(numerics={"realizations": 2}, atmosphere__compare=["r24"]),
        scene(sensor={"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 80.0}),
        scene(sensor=BROAD),
    ]
    names = set()
    for number, data in enumerate(scenes):
        result = run(tmp_path, data)
        path = result.save(tmp_path / f"{number}.nc")
        own = set().union(*(variant.image.layers for variant in result.variants))
        with h5netcdf.File(path) as file:
            names |= {*file.variables, *file.dimensions} - (own - STATISTICS)
    assert names == RESERVED_NAMES - {
        "time",
        "image_mean",
        "scintillation_index",
    }  # of a sequence alone


def test_each_frequency_has_metrics_of_its_own(tmp_path):
    """As a run at that frequency alone; the file says that its image is a mean."""
    ghz = [220.0, 340.0, 650.0]
    several = run(tmp_path, scene(sensor__frequency_ghz=ghz))
    (variant,) = several.summary()["variants"]
    assert several.to_xarray()["image"].attrs["comment"] == "mean over the sensor's frequencies"
    for one, found in zip(ghz, variant["frequencies"], strict=True):
        alone = run(tmp_path, scene(sensor__frequency_ghz=one)).summary()["variants"][0]
        for target, values in alone["targets"].items():
            due = {name: value for name, value in values.items() if value is not None}
            assert {name: found["targets"][target][name] for name in due} == pytest.approx(due)
    contrasts = {found["targets"]["box"]["cnr"] for found in variant["frequencies"]}
    assert len(contrasts) == 3
    assert [row["cnr"] for row in rows(several, "mpm93") if row["target"] == "box"] == [
        found["targets"]["box"]["cnr"] for found in variant["frequencies"]
    ]


def test_names_are_stored_as_utf8_whatever_the_locale_made_of_them(two):
    result = replace(two[0], scenario="\udcc3\udca9", scenario_folder="/\udcff")
    stored = attributes(result)
    assert stored["scenario_name"] == "é"
    assert stored["title"] == "é: terahertz images"
    assert stored["scenario_folder"] == "/\ufffd"


def test_layers_that_not_all_variants_have_are_left_out(two):
    warm, cold = two[0].variants
    layer = Layer(warm.image.values, "K", "a layer")
    one = replace(warm, image=replace(warm.image, layers={"own": layer}))
    assert "own" not in variables(replace(two[0], variants=(one, cold)))
    assert "own" not in variables(replace(two[0], variants=(cold, one)))
    both = replace(cold, image=replace(cold.image, layers={"own": layer}))
    assert variables(replace(two[0], variants=(one, both)))["own"].dims == ("variant", "y", "x")


def test_python_users_get_a_result(tmp_path):
    import thzcl

    result = thzcl.run("quick", settings={"camera.pixels": [12, 8]})
    assert isinstance(result, thzcl.Result)
    assert result.variants[0].image.values.shape == (8, 12)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(AttributeError):
        thzcl.nothing  # noqa: B018


@pytest.fixture
def failing(monkeypatch):
    """Files whose nth call of a method raises."""

    def fail(method, number, error):
        opened = Path.open

        def spoilt(path, *arguments, **options):
            file, calls = opened(path, *arguments, **options), itertools.count(1)
            original = getattr(file, method)

            def call(*given):
                if next(calls) != number:
                    return original(*given)
                if method == "close":
                    file.close()
                raise error

            return SimpleNamespace(
                **{name: getattr(file, name) for name in METHODS} | {method: call}
            )

        monkeypatch.setattr(Path, "open", spoilt)

    return fail


@pytest.mark.parametrize("number", [1, 20, 60, 90])
def test_an_interrupt_amid_writing_leaves_nothing_and_no_crash(two, tmp_path, failing, number):
    """HDF5 writes most when it closes the file, and cannot bear an exception there."""
    failing("write", number, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        two[0].save(tmp_path / "two.nc")
    assert list(tmp_path.iterdir()) == []


def test_an_error_told_only_at_the_end_is_an_error(two, tmp_path, failing):
    """As of a quota on a network's disk."""
    failing("close", 1, OSError(errno.EDQUOT, "quota exceeded"))
    with pytest.raises(OSError, match="quota"):
        two[0].save(tmp_path / "two.nc")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("limits", "shown"),
    [("panel", 2), ("shared", 1), ([200.0, 300.0], 1)],
)
def test_panels_share_black_and_white_where_asked(tmp_path, limits, shown):
    """Two variants of other temperatures; the colour bars tell what is black and white."""
    changed = [
        {"name": name, "set": {"targets.box.temperature_k": kelvin}}
        for name, kelvin in (("a", 280.0), ("b", 380.0))
    ]
    result = run(tmp_path, scene(variants=changed, output={"limits": limits}))
    drawn = [ax.images[0].get_clim() for ax in figure.picture(result).axes if ax.images]
    assert len(set(drawn)) == shown
    if shown == 1 and limits != "shared":
        assert drawn[0] == (200.0, 300.0)
    if limits == "shared":
        both = np.concatenate([v.image.values.ravel() for v in result.variants])
        assert drawn[0] == pytest.approx(tuple(np.percentile(both, (0.1, 99.9))))


def test_limits_that_do_not_ascend_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"limits: must ascend"):
        run(tmp_path, scene(output={"limits": [300.0, 200.0]}))
