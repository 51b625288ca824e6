"""Two hygrometers apart: from files, from a column, and virtual ones in a cube of known theory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from other_records import BARE, field, write
from scenes import scene
from scenes import write as write_scene

from thzcl.errors import RecordError
from thzcl.records import virtual
from thzcl.records.study import Asked, study, study_virtual

RATE, WIND, SAMPLES, APART = 10.0, 3.0, 6000, 10  # the second sensor stands 10 samples downwind
ROUNDING = 1e-12
NOISE = 0.05  # g/m3, of each sensor
GRID, VOXEL_M, CONSTANT = 32, 2.0, 0.01
SEPARATIONS = (0.5, 2.0, 5.0, 20.0)
SLACK = 2e-3  # relative, of sigma^2: samples of a transect and clipping at zero


@pytest.fixture(scope="module")
def downwind(tmp_path_factory):
    """Two files of one frozen field: the second sensor 3 m downwind; noise, and another mean."""
    folder, rng = tmp_path_factory.mktemp("pair"), np.random.default_rng(1)
    q = field(5, 4 * (SAMPLES + APART), 4 * RATE, WIND, cq=0.2, outer=60.0)[::4]  # of points
    time, u, v = np.arange(SAMPLES) / RATE, np.full(SAMPLES, WIND), np.zeros(SAMPLES)
    first = 9 + q[APART:] + NOISE * rng.standard_normal(SAMPLES)
    second = 11 + q[:-APART] + NOISE * rng.standard_normal(SAMPLES)
    write(folder / "first.csv", BARE, [time, first, u, v])
    write(folder / "second.csv", ["time_s", "h2o_g_m3"], [time, second])
    write(folder / "both.csv", [*BARE, "other"], [time, first, u, v, second])
    write(folder / "slow.csv", ["time_s", "h2o_g_m3"], [x[::2] for x in (time, second)])
    write(folder / "late.csv", ["time_s", "h2o_g_m3"], [time + 3600, second])
    stamps = [f"2024-03-07 09:{int(t) // 60:02d}:{t % 60:04.1f}" for t in time]
    write(folder / "dated.csv", ["TIMESTAMP", "h2o_g_m3"], [stamps, second])
    return folder, q


def pair_of(folder, name="second.csv", separation=3.0, **more):
    asked = Asked(second=(folder / name,), separations_m=(separation,), **more)
    return study([folder / "first.csv"], asked=asked)


def test_downwind_the_pair_is_the_field_itself_later(downwind):
    """Means and noise are taken off; the delay tells where the second sensor stands."""
    folder, q = downwind
    found = pair_of(folder)
    (pair,) = found["pairs"]
    assert pair["direction"] == "along"
    assert pair["lag_s"] == pytest.approx(APART / RATE, abs=0.5 / RATE)
    assert pair["along_wind_m"] == pytest.approx(3.0, abs=WIND / RATE)
    later, sooner = q[APART:] - q[APART:].mean(), q[:-APART] - q[:-APART].mean()
    assert pair["covariance_g2_m6"] == pytest.approx(np.mean(later * sooner), abs=0.01)
    difference = np.mean((later - sooner) ** 2)
    assert pair["structure_function_g2_m6"] == pytest.approx(difference, abs=0.02)
    assert pair["correlation"] == pytest.approx(
        np.mean(later * sooner) / later.std() / sooner.std(), abs=0.01
    )
    # Taylor's curve is the field's own along the wind.
    assert pair["taylor_structure_function_g2_m6"] == pytest.approx(difference, rel=0.05)
    assert pair["taylor_covariance_g2_m6"] == pytest.approx(pair["covariance_g2_m6"], abs=0.05)
    own = pair["uncertainty"]["structure_constant_q"]
    assert pair["structure_constant_q"] == pytest.approx(0.2, abs=3 * own)
    assert len(found["taylor"]["separation_m"]) == len(found["taylor"]["covariance_g2_m6"])


def test_a_column_of_the_same_file_gives_the_same(downwind):
    folder, _ = downwind
    asked = Asked("h2o_2=other:g/m3", separations_m=(3.0,))
    (column,) = study([folder / "both.csv"], asked=asked)["pairs"]
    (file,) = pair_of(folder)["pairs"]
    assert column["second"] == "other"
    for key in ("covariance_g2_m6", "structure_function_g2_m6", "correlation", "lag_s"):
        assert column[key] == pytest.approx(file[key])


def test_a_slower_second_sensor_is_set_beside_the_first_by_its_stamps(downwind):
    folder, _ = downwind
    (slow,), (file,) = (pair_of(folder, name)["pairs"] for name in ("slow.csv", "second.csv"))
    assert slow["samples"] == SAMPLES // 2
    assert slow["covariance_g2_m6"] == pytest.approx(file["covariance_g2_m6"], rel=0.05)
    assert slow["direction"] == "along"


def test_what_cannot_be_a_pair_is_refused(downwind):
    folder, _ = downwind
    for name, expected in (
        ("late.csv", r"late\.csv: begins \+3600 s from .*first\.csv and shares 0 s"),
        ("dated.csv", r"first\.csv: its stamps have no dates, those of the other sensor have"),
    ):
        with pytest.raises(RecordError, match=expected):
            pair_of(folder, name)
    for asked, expected in (
        (Asked(second=(folder / "second.csv",)), r"--separation-m: 0 given; expected 1: one for"),
        (Asked(separations_m=(2.0,)), r"--separation-m: 1 given; expected 0"),
        (Asked("h2o_2=other:g/m3"), r"0 given; expected 1: .*the column of role h2o_2"),
    ):
        with pytest.raises(RecordError, match=expected):
            study([folder / "both.csv"], asked=asked)


def test_a_delay_that_the_separation_cannot_explain_is_told(downwind):
    folder, _ = downwind
    found = pair_of(folder, separation=2.0)
    assert any("do the clocks agree?" in note for note in found["notes"])


def test_the_command_tells_pairs(downwind, thzcl_command):
    folder, _ = downwind
    pair = ("--second", folder / "second.csv", "--separation-m", "3")
    done = thzcl_command("fluctuations", folder / "first.csv", *pair, "-o", "out")
    assert done.returncode == 0 and "two sensors" in done.stdout and "along" in done.stdout
    assert "out/first-pairs.png" in done.stdout + done.stderr
    done = thzcl_command("fluctuations", folder / "first.csv", "--separation-m", "far")
    assert done.returncode == 2 and "expected a positive number of metres" in done.stderr


def test_a_shift_across_the_wind_follows_a_wave_exactly():
    n, (climb, _) = 16, virtual.rise(16)
    z, y, x = np.meshgrid(*(np.arange(n),) * 3, indexing="ij")
    across = np.array([-climb, n]) / math.hypot(climb, n)
    for kx, ky, kz in ((1, 0, 0), (3, 5, 2), (-7, 4, 4)):
        phase = 2 * np.pi * (kx * x + ky * y + kz * z) / n + 0.3
        moved = 2 * np.pi * 2.7 * (kx * across[0] + ky * across[1]) / n
        found = virtual.moved(np.cos(phase), 2.7)
        assert found == pytest.approx(np.cos(phase + moved), abs=ROUNDING * n)


def theory():
    """The discrete field's covariance at the separations, across a transect, in (g/m3)^2."""
    k = np.fft.fftfreq(GRID, 1 / GRID)
    kz, ky, kx = np.meshgrid(k, k, k, indexing="ij")
    period = GRID * VOXEL_M
    xi = np.sqrt(kx**2 + ky**2 + kz**2) / period
    power = np.zeros_like(xi)
    power[xi > 0] = 9.6935e-3 * CONSTANT * xi[xi > 0] ** (-11 / 3) / period**3
    climb, _ = virtual.rise(GRID)
    along = (GRID * ky - climb * kx) / math.hypot(climb, GRID) / period
    return np.array([np.sum(power * np.cos(2 * np.pi * along * r)) for r in SEPARATIONS])


@pytest.mark.parametrize(
    "seeds", [pytest.param(5, marks=pytest.mark.slow), pytest.param(30, marks=pytest.mark.long)]
)
def test_virtual_sensors_have_the_covariance_of_their_cube(tmp_path, seeds):
    """Over 30 seeds, 0.5 to 20 m apart, within four standard errors of the discrete theory."""
    found = []
    for seed in range(seeds):
        air = scene(
            atmosphere__fluctuations={
                "structure_constant_q": CONSTANT, "voxel_m": VOXEL_M, "grid": GRID, "seed": seed,
            }
        )  # fmt: skip
        one = study_virtual(write_scene(tmp_path, air), asked=Asked(separations_m=SEPARATIONS))
        assert [pair["separation_m"] for pair in one["pairs"]] == list(SEPARATIONS)
        found.append([pair["covariance_g2_m6"] for pair in one["pairs"]])
    covariance, expected = np.array(found), theory()
    error = covariance.std(axis=0, ddof=1) / math.sqrt(seeds)
    assert (np.abs(covariance.mean(axis=0) - expected) < 4 * error + SLACK * expected[0]).all()
    assert (np.abs(expected) > error).any()


def test_what_a_cube_lacks_of_small_eddies_is_told(tmp_path):
    """Half a metre apart in voxels of two: most of the difference is put back by the law."""
    air = scene(
        atmosphere__fluctuations={
            "structure_constant_q": CONSTANT, "voxel_m": VOXEL_M, "grid": 64, "seed": 1,
        }
    )  # fmt: skip
    found = study_virtual(write_scene(tmp_path, air), asked=Asked(separations_m=(0.5, 20.0)))
    near, far = found["pairs"]
    assert near["noise_g2_m6"] < 0 and far["separation_m"] == 20.0
    (note,) = (note for note in found["notes"] if "put back" in note)
    assert note.startswith("scene-virtual-0.5m.csv, 0.5 m away: ")


def test_virtual_sensors_stand_within_half_a_cube(tmp_path):
    air = scene(
        atmosphere__fluctuations={"structure_constant_q": CONSTANT, "voxel_m": 1.0, "grid": 16}
    )
    with pytest.raises(RecordError, match=r"repeats after 16 m; expected 8 m at most"):
        study_virtual(write_scene(tmp_path, air), asked=Asked(separations_m=(9.0,)))
