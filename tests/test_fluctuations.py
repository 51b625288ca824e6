"""A hygrometer's record, analysed: against SciPy and plain sums.

And against records of known structure constant.
"""

from __future__ import annotations

import math
import os
import zipfile

import hygrometer
import numpy as np
import pytest
import scipy.optimize
import scipy.signal
from hygrometer import RECORD, synthetic

from thzcl.__main__ import main
from thzcl.errors import RecordError
from thzcl.records import analysis, record
from thzcl.records.study import study

KEYS = (
    *("samples", "rate_hz", "duration_s", "gaps", "spikes", "wind_speed_m_s"),
    *("mean_g_m3", "sigma_g_m3", "sigma_percent", "slope", "slope_uncertainty"),
    *("inertial_range_cycles_per_m", "structure_constant_q"),
    *("structure_constant_q_from_structure_function", "structure_constant_t"),
    *("correlation_tq", "integral_scale_m", "outer_scale_m"),
)
DESPIKED = 2e-3  # relative: four samples of 18000 are spikes, and left out
BINNED = 0.03  # relative: the likelihood of each value against that of bins, other tapers
PATH = 0.05  # relative: what two fits of the analyser's path differ by at separations of a metre
DETECTED = 0.9  # of the spikes, which are 3 g/m3 and more


@pytest.fixture(scope="module")
def shipped():
    return study([RECORD])


@pytest.fixture(scope="module")
def plain():
    """The record as NumPy reads it: Ux, Uy, Uz, h2o, Ts and pressure."""
    columns = np.genfromtxt(RECORD, delimiter=",", skip_header=4, usecols=(2, 3, 4, 6, 7, 8)).T
    return dict(zip(("x", "y", "z", "h2o", "Ts", "kPa"), columns, strict=True))


def test_moments_and_wind_of_the_shipped_record(shipped, plain):
    assert shipped["samples"] == len(plain["h2o"]) == 18000
    assert (shipped["rate_hz"], shipped["duration_s"], shipped["gaps"]) == (20.0, 900.0, 0)
    assert shipped["mean_g_m3"] == pytest.approx(plain["h2o"].mean(), rel=DESPIKED)
    assert shipped["sigma_g_m3"] == pytest.approx(plain["h2o"].std(), rel=DESPIKED)
    assert shipped["sigma_percent"] == pytest.approx(
        100 * plain["h2o"].std() / plain["h2o"].mean(), rel=DESPIKED
    )
    # The magnitude of the mean vector; here the mean of the magnitudes is 40 % more.
    assert shipped["wind_speed_m_s"] == pytest.approx(
        math.hypot(*(plain[axis].mean() for axis in "xyz")), rel=DESPIKED
    )
    assert shipped["pressure_hpa"] == pytest.approx(10 * plain["kPa"].mean(), rel=1e-9)


def independent(shipped, signal):
    """Returns C^2, slope, and 1/L0 and roll-off in radians, by SciPy's tapers without any bins.

    Two-sided in radians, 0.1244 C^2 (k^2 + k0^2)^(-5/6) / (1 + (k c)^2) over a floor, by Whittle's
    likelihood up to half Nyquist's frequency.
    """
    signal = scipy.signal.detrend(signal)
    tapers = scipy.signal.windows.dpss(len(signal), 3, 5)
    frequency = np.fft.rfftfreq(len(signal), 1 / 20)
    density = 2 / 20 * np.mean(np.abs(np.fft.rfft(tapers * signal, axis=1)) ** 2, axis=0)
    speed = shipped["sweeping_speed_m_s"]
    inside = (frequency > 0) & (frequency < 5)
    k, values = (2 * np.pi * frequency / speed)[inside], (density * speed / 4 / np.pi)[inside]

    def mean(logs, slope=-5 / 3):
        constant, floor, bend, roll = np.exp(logs[:4])
        line = 0.1244 * constant * (k**2 + bend**2) ** (slope / 2) / (1 + (k * roll) ** 2)
        return line + floor

    def unlikely(logs):
        expected = mean(logs, *logs[4:])
        return np.sum(np.log(expected) + values / expected)

    how = {"method": "Nelder-Mead", "options": {"maxiter": 4000, "maxfev": 4000}}
    start = [-2.0, np.log(values.min()), np.log(0.06), np.log(0.05)]
    best = scipy.optimize.minimize(unlikely, start, **how).x
    free = scipy.optimize.minimize(unlikely, [*best, -5 / 3], **how).x
    constant, _, bend, roll = np.exp(best)
    return constant, free[4], bend, roll


def test_spectrum_of_the_shipped_record(shipped, plain):
    constant, slope, _, _ = independent(shipped, plain["h2o"])
    assert shipped["structure_constant_q"] == pytest.approx(constant, rel=BINNED)
    assert shipped["slope"] == pytest.approx(slope, abs=2 * shipped["slope_uncertainty"])
    assert shipped["slope"] == pytest.approx(-5 / 3, abs=0.1)
    low, high = shipped["inertial_range_cycles_per_m"]
    assert high > 10 * low
    assert any("the response is slow" in note for note in shipped["notes"])  # an open path's mean


def test_structure_function_of_the_shipped_record(shipped, plain):
    """D(r) = C^2 r^(2/3) less what the outer scale and the analyser's path take off."""
    signal, speed = scipy.signal.detrend(plain["h2o"]), shipped["sweeping_speed_m_s"]
    low, high = (round(r * 20 / speed) for r in shipped["structure_function_range_m"])
    lags = np.unique(np.geomspace(low, high, 12).astype(int))
    separation = lags * speed / 20
    structure = np.array([np.mean((signal[lag:] - signal[:-lag]) ** 2) for lag in lags])
    found = shipped["structure_constant_q_from_structure_function"]
    constant, _, bend, roll = independent(shipped, plain["h2o"])
    lost = 2 * 0.1244 * constant * roll ** (2 / 3) * math.pi / (2 * math.sin(2 * math.pi / 3))
    bent = 1 - 0.393 * (bend * separation) ** (4 / 3)
    expected = np.mean((structure + 2 * lost) / bent / separation ** (2 / 3))
    assert found == pytest.approx(expected, rel=PATH)
    # In so light a wind the two agree to their scatter, and the report says how well.
    assert found == pytest.approx(shipped["structure_constant_q"], rel=0.15)
    assert shipped["agreement_percent"] == pytest.approx(
        100 * (found / shipped["structure_constant_q"] - 1)
    )


def test_temperature_of_the_shipped_record(shipped, plain):
    vapour_hpa = (
        plain["h2o"] * 461.525 * (plain["Ts"] + 273.15) * 1e-5
    )  # with Ts for T: an error of 0.5 % of 0.5 %
    kelvin = (plain["Ts"] + 273.15) / (1 + 0.32 * vapour_hpa / (10 * plain["kPa"]))
    assert shipped["mean_temperature_k"] == pytest.approx(kelvin.mean(), rel=1e-4)
    assert shipped["structure_constant_t"] == pytest.approx(
        independent(shipped, kelvin)[0], rel=BINNED
    )
    q, t = (scipy.signal.detrend(signal) for signal in (plain["h2o"], kelvin))
    assert shipped["correlation_tq"] == pytest.approx(np.corrcoef(q, t)[0, 1], abs=0.01)
    # In the inertial range, from SciPy's own cross-spectrum of segments.
    frequency, cross = scipy.signal.csd(q, t, 20.0, nperseg=2048)
    powers = [scipy.signal.welch(x, 20.0, nperseg=2048)[1] for x in (q, t)]
    low, high = (
        xi * shipped["sweeping_speed_m_s"] for xi in shipped["inertial_range_cycles_per_m"]
    )
    inside = (frequency >= low) & (frequency <= high)
    shares = [x[inside].sum() for x in (cross.real, *powers)]
    inertial = shares[0] / math.sqrt(shares[1] * shares[2])
    assert shipped["correlation_tq_inertial"] == pytest.approx(inertial, abs=0.04)
    assert shipped["uncertainty"]["correlation_tq_inertial"] < 0.04


def test_integral_scale_of_the_shipped_record(shipped, plain):
    signal = scipy.signal.detrend(plain["h2o"])
    covariance = scipy.signal.correlate(signal, signal)[len(signal) - 1 :]
    zero = np.argmax(covariance < 0)
    steps = covariance[:zero].sum() / covariance[0] - 0.5
    assert shipped["integral_scale_m"] == pytest.approx(
        steps * shipped["wind_speed_m_s"] / 20, rel=0.02
    )


def test_the_command_prints_what_was_found(thzcl_command, thzcl_json):
    found = thzcl_json("fluctuations", RECORD)
    assert set(KEYS) <= found.keys()
    done = thzcl_command("fluctuations", RECORD)
    assert (
        done.returncode == 0
        and "C_q^2" in done.stdout
        and "Taylor's hypothesis is doubtful" in done.stdout
    )


@pytest.mark.slow
def test_known_structure_constants_are_recovered(tmp_path):
    """With noise, 1 % gaps and 0.1 % spikes: within 20 % for each seed, within 5 % in their mean.

    By both ways alike.
    """
    found = []
    for seed in range(20):
        path, missing, spiky = synthetic(tmp_path / f"{seed}.csv", seed)
        one = study([path])
        assert one["gaps"] == len(missing)
        assert DETECTED * len(spiky) <= one["spikes_by_column"]["h2o_g_m3"] <= len(spiky) + 2
        assert abs(one["slope"] + 5 / 3) < 3.5 * one["slope_uncertainty"]
        assert 50 < one["outer_scale_m"] < 200
        found.append(
            [one["structure_constant_q"], one["structure_constant_q_from_structure_function"]]
        )
    ratio = np.array(found) / 0.2
    assert np.abs(ratio - 1).max() < 0.2
    assert np.abs(ratio.mean(axis=0) - 1).max() < 0.07
    assert abs(ratio[:, 0].mean() - 1) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    "hard",
    [{"noise": 0.2}, {"outer_m": 30.0, "wind": 10.0}, {"outer_m": 30.0, "noise": 0.1, "wind": 5.0}],
)
def test_neither_noise_nor_a_short_outer_scale_biases_them(tmp_path, hard):
    """Noise of 10 % of sigma and more hides where the spectrum bends.

    In a strong wind the bend lies near the range.
    """
    found = [study([synthetic(tmp_path / "a.csv", seed, **hard)[0]]) for seed in range(20)]
    ratio = np.array([one["structure_constant_q"] for one in found]) / 0.2
    assert np.abs(ratio - 1).max() < 0.2
    assert abs(ratio.mean() - 1) < 0.05
    slopes, own = (np.array([one[key] for one in found]) for key in ("slope", "slope_uncertainty"))
    assert abs(slopes.mean() + 5 / 3) < 3 * math.sqrt(np.mean(own**2) / len(found))


def test_files_of_one_station_join(tmp_path, shipped):
    """In any order, where one begins as the other ends; and a gap between them is counted."""
    lines = RECORD.read_text().splitlines(keepends=True)
    parts = [tmp_path / "a.dat", tmp_path / "b.dat", tmp_path / "late.dat"]
    parts[0].write_text("".join(lines[:9004]))
    parts[1].write_text("".join(lines[:4] + lines[9004:]))
    parts[2].write_text("".join(lines[:4] + lines[9044:]))
    joined = study([parts[1], parts[0]])
    for key in KEYS:
        assert joined[key] == pytest.approx(shipped[key])
    assert study([parts[0], parts[2]])["gaps"] == 40
    parts[2].write_text("".join(lines[:4] + lines[15004:]))
    with pytest.raises(
        RecordError, match=r"late\.dat:5: column TIMESTAMP: 6000 of 18000 .*analyse the parts apart"
    ):
        study([parts[0], parts[2]])


def test_repeats_disorder_and_units(tmp_path):
    """Repeated and swapped rows are counted and mended.

    Mmol/m3 and columns named by hand give what g/m3 give.
    """
    path, _, _ = synthetic(tmp_path / "plain.csv", 1, gaps=0, spikes=0)
    lines = path.read_text().splitlines()
    rows = lines[1:]
    rows[100], rows[101] = rows[101], rows[100]
    rows.insert(500, rows[500])
    (tmp_path / "mixed.csv").write_text("\n".join([lines[0], *rows]))
    reference, mixed = study([path]), study([tmp_path / "mixed.csv"])
    assert (mixed["repeats"], mixed["out_of_order"]) == (1, 1)
    assert mixed["structure_constant_q"] == reference["structure_constant_q"]

    time, grams, x, y = np.loadtxt(path, delimiter=",", skiprows=1).T
    named = {"secs": time, "rho": grams / 0.01801528, "east": x, "north": y}
    other = hygrometer.write_csv(tmp_path / "named.csv", named)
    molar = study([other], "time=secs,h2o=rho:mmol/m3,Ux=east,Uy=north")
    assert molar["structure_constant_q"] == pytest.approx(
        reference["structure_constant_q"], rel=1e-4
    )


def test_a_licor_archive(tmp_path, shipped):
    """The .data part of a GHG archive: DATAH, tabs, seconds and nanoseconds apart."""
    plain = np.genfromtxt(RECORD, delimiter=",", skip_header=4, usecols=(2, 3, 4, 6, 7, 8))
    names = ("DATAH", "Seconds", "Nanoseconds", "H2O (mmol/m^3)", "Aux 1 - U (m/s)")
    names += ("Aux 2 - V (m/s)", "Aux 3 - W (m/s)", "Aux 4 - Ts (C)", "Pressure (kPa)")
    header = "\t".join(names)
    text = [f"Model:\tLI-7500A\nSN:\t75H-1\n{header}\n"]
    for at, (x, y, z, grams, celsius, kilopascal) in enumerate(plain):
        seconds, ticks = divmod(at, 20)
        values = (
            1339000000 + seconds,
            ticks * 50_000_000,
            round(grams / 0.01801528, 6),
            x,
            y,
            z,
            celsius,
            kilopascal,
        )
        text.append("\t".join(map(str, ("DATA", *values))) + "\n")
    with zipfile.ZipFile(tmp_path / "a.ghg", "w") as archive:
        archive.writestr("a.data", "".join(text))
        archive.writestr("a.metadata", "[Site]\n")
    found = study([tmp_path / "a.ghg"])
    for key in ("structure_constant_q", "structure_constant_t", "correlation_tq", "slope"):
        assert found[key] == pytest.approx(shipped[key], rel=1e-4)


def test_a_trend_is_in_sigma_and_not_in_the_structure_constant(tmp_path):
    path, _, _ = synthetic(tmp_path / "a.csv", 3, gaps=0, spikes=0)
    columns = np.loadtxt(path, delimiter=",", skiprows=1).T
    columns[1] += np.linspace(-2, 2, columns.shape[1])
    names = ("time_s", "h2o_g_m3", "Ux_m_s", "Uy_m_s")
    drifting = study(
        [hygrometer.write_csv(tmp_path / "b.csv", dict(zip(names, columns, strict=True)))]
    )
    steady = study([path])
    assert drifting["sigma_g_m3"] > 1.2 * steady["sigma_g_m3"]
    assert drifting["structure_constant_q"] == pytest.approx(
        steady["structure_constant_q"], rel=1e-3
    )


def test_batches_of_an_hour_share_one_spectrum(tmp_path):
    """Two hours at 2 Hz: two batches, whose densities are averaged."""
    path, _, _ = synthetic(tmp_path / "a.csv", 5, samples=14400, rate=2.0, wind=1.0)
    found = analysis.analyse(record.load([path]))
    assert len(found.batches) == 2 == len(found.of_batches)
    assert found.inertial.structure_constant == pytest.approx(0.2, rel=0.2)


def test_without_temperature_there_is_none(thzcl_json, tmp_path):
    found = thzcl_json("fluctuations", synthetic(tmp_path / "a.csv", 0)[0])
    assert found["correlation_tq"] is found["structure_constant_t"] is None


def test_a_unit_that_only_the_size_tells_is_told(tmp_path):
    """760 is some barometer's millimetres of mercury, and a mountain's hectopascals."""
    time, grams, x, y = np.loadtxt(
        synthetic(tmp_path / "a.csv", 2, gaps=0, spikes=0)[0], delimiter=",", skiprows=1
    ).T
    warmth = 20 + np.random.default_rng(0).normal(0, 0.1, time.size)
    named = {"time": time, "h2o_g_m3": grams, "Ux_m_s": x, "Uy_m_s": y, "Ts": warmth}

    def found(pressure, columns=""):
        rows = named | {"press": np.full(time.size, pressure)}
        return study([hygrometer.write_csv(tmp_path / "b.csv", rows)], columns=columns)

    for pressure, unit, hpa in ((760.0, "hPa", 760.0), (99.0, "kPa", 990.0), (99e3, "Pa", 990.0)):
        record = found(pressure)
        notes = [note for note in record["notes"] if "by its size" in note]
        assert [note.split(";")[0] for note in notes] == [
            "column Ts names no unit: taken as degC by its size",
            f"column press names no unit: taken as {unit} by its size",
        ]
        assert "name it with --columns pressure=press:UNIT" in notes[1]
        assert record["pressure_hpa"] == pytest.approx(hpa)
    named_too = found(760.0, "pressure=press:mmHg,Ts=Ts:degC")
    assert named_too["pressure_hpa"] == pytest.approx(1013.25)
    assert not [note for note in named_too["notes"] if "by its size" in note]


def test_a_speed_and_flags_for_what_is_missing(tmp_path):
    """-9999 is a gap, blank lines end a file, units stand in brackets.

    What a mere speed means is told.
    """
    time, grams, x, y = np.loadtxt(
        synthetic(tmp_path / "a.csv", 2, gaps=0, spikes=0)[0], delimiter=",", skiprows=1
    ).T
    grams[100:110] = -9999 * 0.01801528
    named = {"Time (s)": time, "H2O (mmol/m3)": grams / 0.01801528, "wind_speed": np.hypot(x, y)}
    path = hygrometer.write_csv(tmp_path / "b.csv", named)
    path.write_text(path.read_text() + "\n\n")
    found = study([path])
    assert (found["samples"], found["gaps"]) == (18000, 10)
    assert found["structure_constant_q"] == pytest.approx(0.2, rel=0.2)
    assert any("speed without direction" in note for note in found["notes"])
    assert "column wind_speed names no unit: taken as m/s" in found["notes"]


def test_a_record_whose_name_is_not_utf8_is_drawn_and_written(tmp_path):
    name = os.fsdecode(b"b\xe9$x$.csv")
    synthetic(tmp_path / name, 1, samples=6000)
    call = ["fluctuations", str(tmp_path / name), "--height-m", "3", "-o", str(tmp_path / "out")]
    assert main([*call, "--scene", str(tmp_path / "air.toml")]) == 0
    assert "Record b\ufffd$x$.csv" in (tmp_path / "air.toml").read_text(encoding="utf-8")
    assert list((tmp_path / "out").glob("*.png"))
