"""A measured spectrum as a scene's air: from one dimension to three, and into the cube."""

from __future__ import annotations

import numpy as np
import pytest
from hygrometer import ONE_SIDED, RECORD
from scenes import scene, write

from thzcl import pipeline
from thzcl.errors import FileError, ScenarioError
from thzcl.plan import report
from thzcl.records import virtual
from thzcl.records.study import study
from thzcl.turbulence import cube as field
from thzcl.turbulence import spectrum_table
from thzcl.turbulence.spectrum_table import SpectrumTable

POWER_LAW = 1e-5  # relative: a straight line in log-log is met to the rounding of two constants
CUBIC = 0.03  # relative: a cubic's slope, with 12 points to a decade of a bending curve
FLOAT32 = 1e-5  # of sigma


def table(frequency, density):
    return SpectrumTable(tuple(map(float, frequency)), tuple(map(float, density)))


def test_kolmogorovs_spectrum_comes_back():
    """The density 2 * 0.1244 (2 pi)^(-2/3) C^2 xi^(-5/3) along a line gives that in space.

    It is 9.69e-3 C^2 xi^(-11/3), beyond the table's ends too.
    """
    xi = np.geomspace(0.02, 2, 25)
    found = table(xi, 0.3 * ONE_SIDED * xi ** (-5 / 3))
    asked = np.geomspace(0.002, 20, 41)
    assert found.density_in_space(asked) == pytest.approx(
        9.69315e-3 * 0.3 * asked ** (-11 / 3), rel=POWER_LAW
    )
    assert found.structure_constant == pytest.approx(0.3, rel=POWER_LAW)


def test_von_karmans_spectrum_comes_back():
    xi = np.geomspace(0.002, 2, 37)
    found = table(xi, ONE_SIDED * (xi**2 + 0.02**2) ** (-5 / 6))
    asked = np.geomspace(0.01, 1, 100)
    assert found.density_in_space(asked) == pytest.approx(
        9.69315e-3 * (asked**2 + 0.02**2) ** (-11 / 6), rel=CUBIC
    )


def test_what_scatters_is_never_negative_and_integrates_back():
    """The density in space, summed over the waves of one frequency along a line, gives it back."""
    rng = np.random.default_rng(2)
    xi = np.geomspace(0.01, 2, 25)
    density = ONE_SIDED * xi ** (-5 / 3) * rng.lognormal(0, 0.4, 25)
    assert np.any(np.diff(density) > 0)
    found = table(xi, density)
    fine = np.geomspace(0.001, 1000, 200_001)
    space = found.density_in_space(fine)
    assert space.min() >= 0
    ring = 2 * np.pi * fine * space
    pieces = np.diff(fine) * (ring[1:] + ring[:-1]) / 2
    back = 2 * np.append(np.cumsum(pieces[::-1])[::-1], 0)
    inside = (fine > 0.01) & (fine < 2)
    assert back[inside] == pytest.approx(found.along(fine[inside])[0], rel=2e-3)
    # Where three rows were pooled their mean stands in the middle.
    assert spectrum_table.pooled(np.arange(4.0), np.array([5.0, 1.0, 3.0, 0.0]))[1].tolist() == [
        5.0,
        2.0,
        0.0,
    ]


def cube(device, path, **fluctuations):
    base = {"voxel_m": 0.5, "grid": 32, "seed": 3}
    plan = pipeline.prepare(write(path, scene(atmosphere__fluctuations=base | fluctuations)))
    source = plan.variants[0].cube.turbulence
    return field.generate(device, source, "float32").delta.host(), source


def test_a_table_of_kolmogorovs_spectrum_makes_the_same_cube(device, tmp_path):
    xi = np.geomspace(0.05, 2, 20)
    np.savetxt(
        tmp_path / "s.csv", np.stack([xi, 0.3 * ONE_SIDED * xi ** (-5 / 3)], axis=1), delimiter=","
    )
    found, source = cube(device, tmp_path, spectrum="table", file="s.csv")
    expected, plain = cube(device, tmp_path, structure_constant_q=0.3)
    assert found == pytest.approx(expected, abs=FLOAT32 * float(expected.std()))
    assert source.structure_constants(10.0) == pytest.approx(
        (plain.sigma**2 * 100 / plain.unit_variance, 0), rel=POWER_LAW
    )
    rescaled, _ = cube(device, tmp_path, spectrum="table", file="s.csv", sigma_percent=15.0)
    assert rescaled.std() == pytest.approx(0.15, rel=1e-6)
    assert np.corrcoef(rescaled.ravel(), expected.ravel())[0, 1] > 1 - 1e-6


def test_waves_that_the_table_does_not_reach_are_told(tmp_path):
    """The note says how much they matter; a table that reaches them has none."""

    def notes(xi):
        rows = np.stack([xi, ONE_SIDED * xi ** (-5 / 3)], axis=1)
        np.savetxt(tmp_path / "s.csv", rows, delimiter=",")
        air = {"spectrum": "table", "file": "s.csv", "voxel_m": 0.5, "grid": 32, "seed": 3}
        plan = pipeline.prepare(write(tmp_path, scene(atmosphere__fluctuations=air)))
        found = report.warnings(plan, report.planned_errors(plan))
        return [note for note in found if "the measured spectrum holds" in note]

    (note,) = notes(np.geomspace(0.3, 0.9, 20))
    assert "from 0.3 to 0.9 cycles/m" in note and "the cube's 0.0625 to 1.73 cycles/m" in note
    waves = np.array(np.meshgrid(*3 * [np.arange(-16, 16)])).reshape(3, -1) / 16.0
    xi = np.linalg.norm(waves, axis=0)
    density = np.where(xi > 0, xi, np.inf) ** (-11 / 3)
    for words, part in ((" % of the variance lie below", xi < 0.3), (" % above", xi > 0.9)):
        told = float(note.split(words)[0].split()[-1])
        assert told == pytest.approx(100 * density[part].sum() / density.sum(), rel=0.06)
    assert notes(np.geomspace(0.05, 2, 20)) == []


def test_the_measured_spectrum_makes_measured_air(tmp_path):
    """A virtual hygrometer's record has the table's spectrum, where the table stands for the law.

    Along the transect that is the spectrum in space, summed over all waves of the cube by their
    frequency along it: what the voxels do not hold is missing in both.
    """
    study([RECORD], scene=tmp_path / "air.toml")
    text = (tmp_path / "air.toml").read_text(encoding="utf-8")
    kept = [
        line
        for line in text.splitlines()
        if not line.startswith(("outer_scale_m", "structure_constant_q", "spectrum ="))
    ]
    text = (
        "\n".join(kept)
        .replace('# spectrum = "table"', 'spectrum = "table"')
        .replace("# file =", "file =")
    )
    measured = np.loadtxt(tmp_path / "air-spectrum.csv", delimiter=",", skiprows=2, unpack=True)
    edges = np.geomspace(0.03, 0.9, 7)
    found = [transect_variance(write_seed(tmp_path, text, seed), edges) for seed in range(4)]
    ratio = np.mean(found, axis=0) / cube_variance(table(*measured), 128, 0.5, edges)
    # Four seeds' scatter: few large eddies lie in a cube, many small ones.
    assert ratio[:3] == pytest.approx(1, abs=0.2)
    assert ratio[3:] == pytest.approx(1, abs=0.06)


def transect_variance(path, edges):
    """Returns the variance of a virtual record between spatial frequencies, in cycles/m."""
    (record,) = virtual.write(path, path.parent)
    time, grams, wind = np.loadtxt(record, delimiter=",", skiprows=1, usecols=range(3), unpack=True)
    power = 2 / len(grams) ** 2 * np.abs(np.fft.rfft(grams - grams.mean())) ** 2
    frequency = np.fft.rfftfreq(len(grams), time[1] * wind[0])
    return np.histogram(frequency, edges, weights=power)[0]


def cube_variance(spectrum, grid, voxel_m, edges):
    """Returns the variance that a cube of a spectrum has along a transect, between frequencies."""
    along = np.array([grid, *virtual.rise(grid)], float)
    axis = np.fft.fftfreq(grid, voxel_m)
    waves = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)[1:]
    density = spectrum.density_in_space(np.linalg.norm(waves, axis=1))
    frequency = np.abs(waves @ (along / np.linalg.norm(along)))
    return np.histogram(frequency, edges, weights=density)[0] / (grid * voxel_m) ** 3


def write_seed(folder, text, seed):
    path = folder / f"seed{seed}.toml"
    path.write_text(text.replace("seed = 1", f"seed = {seed}"), encoding="utf-8")
    return path


WRONG = {
    "no such file": (None, "s.csv: cannot be read"),
    "one column": (
        "1\n2\n3\n",
        "3 rows of 1 columns; give 3 rows at least of spatial frequency and density",
    ),
    "too short": ("1,2\n2,1\n", "2 rows of 2 columns"),
    "negative": (
        "1,2\n2,-1\n3,1\n",
        "spatial frequencies must be above 0 and ascend, densities be above 0",
    ),
    "not ascending": ("1,3\n3,2\n2,1\n", "spatial frequencies must be above 0 and ascend"),
    "rising": ("1,1\n2,2\n3,3\n", "the density does not fall with spatial frequency"),
    "words": ("f,d\n1,3\nx,2\n", "s.csv:3: not comma-separated numbers"),
    "NaN": ("1,3\n2,nan\n3,1\n", "s.csv:2: not finite"),
}


def test_a_spectrum_is_read(tmp_path):
    (tmp_path / "s.csv").write_text("# measured\nfrequency,density\n0.1,30\n0.2,20\n0.4,5\n")
    assert spectrum_table.read(tmp_path / "s.csv") == table([0.1, 0.2, 0.4], [30, 20, 5])


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_spectrum_is_a_file_error(tmp_path, case):
    text, expected = WRONG[case]
    if text is not None:
        (tmp_path / "s.csv").write_text(text)
    with pytest.raises(FileError, match=expected.replace(".", r"\.")):
        spectrum_table.read(tmp_path / "s.csv")


@pytest.mark.parametrize("case", WRONG)
def test_each_wrong_table_has_its_message(tmp_path, case):
    text, expected = WRONG[case]
    if text is not None:
        (tmp_path / "s.csv").write_text(text)
    asked = {"spectrum": "table", "file": "s.csv", "voxel_m": 0.5, "grid": 32, "seed": 1}
    with pytest.raises(ScenarioError, match=expected.replace(".", r"\.")):
        pipeline.prepare(write(tmp_path, scene(atmosphere__fluctuations=asked)))


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"spectrum": "table"}, 'spectrum = "file" or "table" and file = "..." go together'),
        (
            {"spectrum": "table", "file": "s.csv", "structure_constant_q": 1.0},
            "is given by the table; remove it, or rescale",
        ),
        (
            {"spectrum": "file", "file": "s.nc", "sigma_percent": 1.0},
            "is given by the cube; remove it",
        ),
        ({}, "needs one of sigma_percent, structure_constant_q or file"),
    ],
)
def test_what_goes_with_what(tmp_path, more, expected):
    with pytest.raises(ScenarioError) as caught:
        pipeline.prepare(
            write(tmp_path, scene(atmosphere__fluctuations={"voxel_m": 0.5, "seed": 1} | more))
        )
    assert len(caught.value.problems) == 1 and expected in caught.value.problems[0]
