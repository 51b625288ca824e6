"""What must hold of every scene, tried on random ones."""

from __future__ import annotations

import tempfile
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import run, scene

SOME = settings(derandomize=True, deadline=None, max_examples=12, database=None)
FLOAT32 = (
    2e-6  # of the largest value: some hundred voxels' roundings, in depth and in its exponential
)

SCENES = st.fixed_dictionaries(
    {
        "camera__pixels": st.just([7, 5]),
        "camera__position_m": st.tuples(
            st.floats(-20, 20), st.floats(-20, 20), st.floats(2.5, 12)
        ).map(list),
        "atmosphere__temperature_k": st.floats(230, 320),
        "atmosphere__relative_humidity_percent": st.floats(0, 100),
        "atmosphere__fluctuations": st.fixed_dictionaries(
            {
                "sigma_percent": st.floats(0, 60),
                "voxel_m": st.floats(0.2, 5),
                "grid": st.just(16),
                "seed": st.integers(0, 2**32),
                "grid_orientation": st.sampled_from(["oblique", "aligned"]),
            }
        ),
        "ground__temperature_k": st.floats(200, 350),
        "ground__reflectivity": st.floats(0, 1),
        "targets__box__temperature_k": st.floats(0, 1000),
        "targets__box__yaw_deg": st.floats(0, 360),
        "background__environment": st.sampled_from(["air", "none"]),
        "sensor__frequency_ghz": st.floats(50, 1500),
    }
)


def seen(changes, **options):
    """The sight of a scene; the box is raised out of the way of cameras that would stand in it."""
    with tempfile.TemporaryDirectory() as folder:
        return (
            run(Path(folder), scene(targets__box__center_m=[25.0, 25.0, 1.0], **changes), **options)
            .variants[0]
            .radiances
        )


def with_numerics(changes, **numerics):
    return changes | {"numerics": numerics | {"error_budget": False}}


@given(SCENES)
@SOME
def test_isothermal_air_only_takes_away(changes):
    """Every pixel's contrast is its surface's own, times something from 0 to 1.

    Depths are positive and grow with length.
    """
    through = seen(with_numerics(changes))
    clear = seen(with_numerics(changes | {"atmosphere__model": "none"}))
    # Rays that the cut-off ended show nothing, where clear air shows what is behind.
    kept = through.target == clear.target
    share = np.divide(
        through.contrast,
        clear.contrast,
        out=np.zeros_like(clear.contrast),
        where=clear.contrast != 0,
    )
    assert (share[:, kept] >= 0).all()
    assert (share[:, kept] <= 1 + FLOAT32).all()
    assert (through.optical_depth >= 0).all()


@given(SCENES)
@SOME
def test_float32_agrees_with_float64(changes):
    single = seen(with_numerics(changes, precision="float32", cutoff_depth=1e9))
    double = seen(with_numerics(changes, precision="float64", cutoff_depth=1e9))
    assert np.array_equal(single.target, double.target)
    for name in ("contrast", "optical_depth", "path_length"):
        one, other = getattr(single, name), getattr(double, name)
        assert np.abs(one - other).max() <= FLOAT32 * np.abs(other).max(), name


@given(SCENES, st.floats(1.1, 3.0))
@SOME
def test_farther_is_deeper(changes, factor):
    """The same rays, let run farther where they met nothing."""
    near, far = (
        seen(with_numerics(changes | {"background__max_range_m": metres}, cutoff_depth=1e9))
        for metres in (30.0, 30.0 * factor)
    )
    assert (far.path_length >= near.path_length * (1 - FLOAT32)).all()
    assert (far.optical_depth >= near.optical_depth * (1 - FLOAT32)).all()


@given(SCENES, st.floats(0, 1))
@SOME
def test_reflectivity_mixes_emission_and_environment(changes, share):
    """A surface of reflectivity R is R times a mirror and 1 - R times a black body.

    Pixel by pixel.
    """
    own = [
        seen(
            with_numerics(changes | {"ground__reflectivity": r, "targets__box__reflectivity": r})
        ).contrast
        for r in (0.0, 1.0, share)
    ]
    mixed = (1 - share) * own[0].astype(float) + share * own[1].astype(float)
    assert np.abs(own[2] - mixed).max() <= FLOAT32 * max(np.abs(own[0]).max(), np.abs(own[1]).max())


@given(SCENES)
@SOME
def test_splitting_voxels_changes_nothing(changes):
    """The same humidity on twice the grid, each voxel split in eight."""
    fluctuations = changes["atmosphere__fluctuations"]
    rng = np.random.default_rng(fluctuations["seed"])
    cube = rng.uniform(0, 8, (16, 16, 16))
    sights = []
    with tempfile.TemporaryDirectory() as folder:
        for times in (1, 2):
            fine = cube.repeat(times, 0).repeat(times, 1).repeat(times, 2)
            write_cube(Path(folder) / f"air{times}.nc", fine, fluctuations["voxel_m"] / times)
            air = {
                "spectrum": "file",
                "file": f"air{times}.nc",
                "grid_orientation": fluctuations["grid_orientation"],
            }
            data = with_numerics(changes | {"atmosphere__fluctuations": air}, cutoff_depth=1e9)
            data["atmosphere__relative_humidity_percent"] = 30.0
            data["atmosphere__temperature_k"] = 300.0
            placed = scene(targets__box__center_m=[25.0, 25.0, 1.0], **data)
            sights.append(run(Path(folder), placed).variants[0].radiances)
    one, other = sights
    assert one.optical_depth == pytest.approx(other.optical_depth, rel=FLOAT32)


def write_cube(path, humidity, voxel_m):
    with h5netcdf.File(path, "w") as file:
        file.dimensions = dict.fromkeys("zyx", len(humidity))
        stored = file.create_variable("absolute_humidity", tuple("zyx"), "f8", data=humidity)
        stored.attrs["voxel_m"] = voxel_m


@given(SCENES)
@SOME
def test_left_and_right_are_mirror_images(changes):
    """Uniform air, a scene reflected in the plane y = 0: the image is reflected too."""
    x, y, z = changes["camera__position_m"]
    even = changes | {"atmosphere__fluctuations": None}
    images = []
    for sign in (1, -1):
        mirrored = even | {
            "camera__position_m": [x, sign * y, z],
            "camera__look_at_m": [30.0, sign * 8.0, 1.0],
            "targets__box__yaw_deg": sign * changes["targets__box__yaw_deg"],
            "targets__box__center_m": [25.0, sign * 25.0, 1.0],
        }
        with tempfile.TemporaryDirectory() as folder:
            images.append(
                run(Path(folder), scene(**with_numerics(mirrored))).variants[0].radiances.contrast
            )
    assert np.abs(images[0] - images[1][..., ::-1]).max() <= FLOAT32 * np.abs(images[0]).max()


@given(SCENES, st.floats(0.1, 3.0))
@SOME
def test_what_the_path_emits_lies_between_what_it_meets(changes, sigma):
    """With temperature fluctuating and a black environment.

    No pixel is colder or warmer than all it can see.
    """
    air = changes["atmosphere__fluctuations"] | {"temperature_sigma_k": sigma}
    dark = {"ground__reflectivity": 0.0, "targets__box__reflectivity": 0.0}
    data = with_numerics(changes | dark | {"atmosphere__fluctuations": air}) | {
        "output": {"save_field": True}
    }
    with tempfile.TemporaryDirectory() as folder:
        result = run(Path(folder), scene(targets__box__center_m=[25.0, 25.0, 1.0], **data))
    warmth = result.cubes[0].air_temperature_k
    kelvin = [
        changes["ground__temperature_k"],
        changes["targets__box__temperature_k"],
        changes["atmosphere__temperature_k"],
    ]
    low, high = min(warmth.min(), *kelvin), max(warmth.max(), *kelvin)
    image = result.variants[0].radiances.brightness_temperature
    assert image.min() >= low - 1e-3
    assert image.max() <= high + 1e-3
