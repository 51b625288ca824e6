"""The meshes and scenes of things: a vehicle under the sky, a person with a pistol."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from conftest import ROOT

import thzcl
from thzcl.surfaces import mesh_file, tree


@pytest.mark.parametrize("name", ["vehicle", "person"])
def test_the_meshes_are_those_that_the_script_makes(tmp_path, name):
    script = ROOT / "scenarios" / "solids.py"
    subprocess.run([sys.executable, str(script), str(tmp_path)], check=True)
    made, shipped = (
        mesh_file.read(folder / f"{name}.npz") for folder in (tmp_path, ROOT / "scenarios")
    )
    assert made.parts == shipped.parts
    assert np.array_equal(made.faces, shipped.faces) and np.array_equal(made.part, shipped.part)
    assert np.abs(made.vertices - shipped.vertices).max() < 2e-5
    assert 3000 < len(made.faces) < 12000


@pytest.mark.parametrize("name", ["vehicle", "person"])
def test_rays_cross_the_closed_meshes_an_even_number_of_times(name):
    """Whatever comes in goes out again."""
    read = mesh_file.read(ROOT / "scenarios" / f"{name}.npz")
    corners = read.vertices[read.faces]
    rng = np.random.default_rng(3)
    origin = np.array([-9.0, 3.0, 2.0])
    aim = corners[rng.integers(0, len(corners), 300)].mean(axis=1) + rng.normal(size=(300, 3)) / 99
    odd = 0
    for direction in aim - origin:
        a, b, c = (corners[:, k] - origin for k in range(3))
        u, v, w = (np.cross(p, q) @ direction for p, q in ((c, b), (a, c), (b, a)))
        inside = ((u > 0) & (v > 0) & (w > 0)) | ((u < 0) & (v < 0) & (w < 0))
        odd += int(inside.sum()) % 2
    assert odd == 0
    assert len(tree.grow(corners.min(axis=1), corners.max(axis=1)).boxes) > 1000


def test_the_pistol_is_seen_through_the_cloth():
    """By the sum of a layer's bounces, where the skin faces the camera and so reflects least."""
    result = thzcl.run(
        "concealed",
        settings={
            "sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0},
            "numerics.error_budget": False,
            "numerics.bounces": 0,  # else arms are seen in the flanks
            "camera.samples_per_pixel": 1,
        },
        figure=False,
    )
    sight = result.variants[0].radiances
    flags = {name: number for number, name in enumerate(result.targets)}
    pistol = sight.target == flags["person.pistol"]
    body = sight.target == flags["person.body"]
    passed = np.exp(-sight.optical_depth[0])
    kelvin = sight.brightness_temperature_contrast[0] / passed
    found = np.median(kelvin[pistol]) - kelvin[body].max()

    def seen(part):
        between = part / (1 - 0.02 * part)
        skin, cloth = 0.5 * (1 - 0.98 * between), 0.48 * (1 + 0.5 * between)
        return 12.0 * skin + 7.0 * cloth  # K above the room

    assert pistol.sum() > 100
    assert found == pytest.approx(seen(0.9936) - seen(0.11609), abs=0.02)


def test_steel_mirrors_the_cold_sky_at_94_ghz_only():
    result = thzcl.run(
        "vehicle",
        settings={"camera.pixels": [64, 36], "numerics.error_budget": False},
        variants=["(a)", "(d)"],
        figure=False,
    )
    flag = result.targets.index("vehicle.hood")
    cold, warm = (
        one.radiances.brightness_temperature_contrast[0][one.radiances.target == flag].mean()
        for one in result.variants
    )
    assert cold < -80 and 3 < warm < 15
