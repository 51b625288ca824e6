"""The closed loop: a transect through a generated cube.

Read back by the analysis that reads measured records.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import scene, write

from thzcl.errors import RecordError
from thzcl.records import inertial, spectrum, virtual
from thzcl.records.study import study_virtual

GRID, VOXEL_M, CONSTANT, SEEDS = 128, 0.5, 0.04, 16
ROUNDING = 1e-12


def air(seed, **more):
    turbulence = {"structure_constant_q": CONSTANT, "voxel_m": VOXEL_M, "grid": GRID, "seed": seed}
    return scene(atmosphere__fluctuations=turbulence | more)


def test_a_transect_follows_a_wave_exactly():
    """Through waves of any direction, at points between the voxels too."""
    n, (p, q) = 32, virtual.rise(32)
    z, y, x = np.meshgrid(*(np.arange(n),) * 3, indexing="ij")
    along = np.arange(2 * n * n) / 2
    for kx, ky, kz in ((1, 0, 0), (3, 5, 2), (-7, 15, 4), (15, -2, 0)):
        cube = np.cos(2 * np.pi * (kx * x + ky * y + kz * z) / n + 0.3)
        expected = np.cos(2 * np.pi * (kx + ky * p / n + kz * q / n) * along / n + 0.3)
        assert virtual.transect(cube) == pytest.approx(expected, abs=ROUNDING * n)


def test_a_transect_passes_every_row():
    for n in (16, 32, 64, 128, 256, 512):
        for climb in virtual.rise(n):
            assert math.gcd(climb, n) == 1
            assert 0.15 < climb / n < 0.5


def discrete():
    """C^2 and slope that the analysis finds in what the discrete field has along the transect.

    Its waves by their frequency along the line, without scatter: as many values as a record has.
    """
    k = np.fft.fftfreq(GRID, 1 / GRID)
    kz, ky, kx = np.meshgrid(k, k, k, indexing="ij")
    p, q = (climb / GRID for climb in virtual.rise(GRID))
    along = np.abs(kx + p * ky + q * kz) / math.hypot(1, p, q) / (GRID * VOXEL_M)
    xi = np.sqrt(kx**2 + ky**2 + kz**2) / (GRID * VOXEL_M)
    power = np.zeros_like(xi)
    power[xi > 0] = 9.6935e-3 * CONSTANT * xi[xi > 0] ** (-11 / 3) / (GRID * VOXEL_M) ** 3
    step = virtual.step_m(GRID, VOXEL_M)
    samples = GRID * GRID * virtual.STEPS_PER_VOXEL
    frequency = np.arange(1, samples // 2) / (samples * step)
    width = frequency[0]
    edges = np.append(frequency - width / 2, frequency[-1] + width / 2)
    density = np.histogram(along, edges, weights=power)[0] / width
    smooth = np.convolve(density, np.ones(5) / 5, "same")
    found = inertial.find(spectrum.binned(frequency, smooth), 1 / (2 * step))
    return found.structure_constant, found.slope


@pytest.mark.slow
def test_the_loop_closes(tmp_path):
    """C_q^2 is what the scene asks for, and the slope the discrete field's own.

    The field ends at its voxels: its spectrum steepens, which the analysis takes for a slow sensor.
    """
    constant, slope = discrete()
    assert 0.9 < constant / CONSTANT < 1.1
    found = [study_virtual(write(tmp_path, air(seed))) for seed in range(SEEDS)]
    ratios = np.array([one["structure_constant_q"] for one in found]) / CONSTANT
    slopes = np.array([one["slope"] for one in found]) - slope
    assert all(one["structure_constant_t"] is None for one in found)
    assert abs(ratios.mean() - 1) < 3 * ratios.std() / math.sqrt(SEEDS) + 0.03
    assert abs(slopes.mean()) < 0.12  # with a roll-off in the fit or without
    steep = ("the response is slow", "the spectrum steepens")
    assert all(any(text in note for note in one["notes"] for text in steep) for one in found)


@pytest.mark.slow
def test_temperature_and_correlation_close_too(tmp_path):
    found = [
        study_virtual(write(tmp_path, air(seed, structure_constant_t=0.02, correlation_tq=0.6)))
        for seed in range(8)
    ]
    correlation = [one["correlation_tq"] for one in found]
    assert abs(np.mean(correlation) - 0.6) < 3 * np.std(correlation) / math.sqrt(8) + 0.02
    ratio = [one["structure_constant_t"] / one["structure_constant_q"] for one in found]
    assert np.mean(ratio) == pytest.approx(0.5, rel=0.25)


def test_the_record_is_kept_where_asked_for(tmp_path, thzcl_json, thzcl_command):
    file = write(tmp_path, air(1))
    found = thzcl_json("fluctuations", "--virtual", file, "-o", "out")
    again = thzcl_json("fluctuations", found["files"][0])
    assert again["structure_constant_q"] == found["structure_constant_q"]
    assert found["files"][0] == "out/scene-virtual.csv"
    done = thzcl_command("fluctuations", "--virtual", "uniform")
    assert done.returncode == 2 and "its air does not fluctuate" in done.stderr
    for wrong in (("fluctuations",), ("fluctuations", "a.csv", "--virtual", "quick")):
        done = thzcl_command(*wrong)
        assert done.returncode == 2 and "give a hygrometer's FILE, or --virtual" in done.stderr


def test_air_that_no_record_is_made_of_is_refused(tmp_path):
    """A record takes one periodic cube, without larger eddies or a change by height."""
    flow = {"spectrum": "von-karman", "outer_scale_m": 300.0, "sigma_percent": 20.0, "grid": 16}
    large = {"temperature_k": 290.0, "relative_humidity_percent": 50.0}
    large["fluctuations"] = flow | {"voxel_m": 0.5, "seed": 1, "large_scales": True}
    file = write(tmp_path, scene(atmosphere=large))
    with pytest.raises(RecordError, match="without large_scales"):
        virtual.write(file, tmp_path)
