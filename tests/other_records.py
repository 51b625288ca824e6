"""Records of other people's hygrometers, as they come: self-written, seeded, with known statistics.

Humidity is a Gaussian signal with the one-sided density A C^2 (xi^2 + L0^-2)^(-5/6) in cycles/m,
A = 2 x 0.1244 (2 pi)^(-2/3), so that D(r) = C^2 r^(2/3) in the inertial range. It is cut from a
series eight times as long (no period) and has no content above Nyquist's frequency. The right
values stand in data/other_records.json.
"""

from __future__ import annotations

import datetime as dt

import numpy as np
from scipy import linalg, signal, special

A = 2 * 0.1244 * (2 * np.pi) ** (-2 / 3)
MOLAR_MASS, GAS, VAPOUR = 18.01528, 8.314462, 461.525
HEAD = ["TIMESTAMP", "h2o (g/m3)", "Ux (m/s)", "Uy (m/s)", "Uz (m/s)", "Ts (C)", "press (kPa)"]
BARE = ["time_s", "h2o_g_m3", "Ux_m_s", "Uy_m_s"]


def field(seed, n, rate, wind, cq=0.05, outer=20.0, slope=-5 / 3):
    """Humidity less its mean: n samples at `rate` Hz, carried at `wind` m/s."""
    rng = np.random.default_rng(seed)
    total = 8 * n
    xi = np.fft.rfftfreq(total, 1 / rate) / wind
    if slope == -5 / 3:
        density = A * cq * (xi**2 + outer**-2) ** (-5 / 6)
    else:
        density = A * cq * np.maximum(xi, 1 / 200) ** slope
    normal = rng.standard_normal(len(xi)) + 1j * rng.standard_normal(len(xi))
    series = np.fft.irfft(np.sqrt(density / wind * rate * total / 2) * normal / np.sqrt(2), total)[
        :n
    ]
    return series - series.mean()


def gust(rng, n, sigma, width):
    return sigma * np.convolve(
        rng.standard_normal(n + width - 1), np.ones(width) / np.sqrt(width), "valid"
    )


def base(seed, n=3000, rate=20.0, wind=3.0, mean=9.0, temperature=293.15, pressure=1000.0):
    """What a mast measures: q g/m3, u m/s (3, n), T and sonic Ts K, stamps."""
    q = mean + field(seed, n, rate, wind)
    other = field(seed + 1000, n, rate, wind)
    rng = np.random.default_rng(seed + 2000)
    u = np.stack([wind + gust(rng, n, 0.3, 20), gust(rng, n, 0.3, 20), gust(rng, n, 0.2, 10)])
    t = temperature + 1.2 * (q - mean) + 0.4 * other
    sonic = t * (1 + 0.32 * q * VAPOUR * t * 1e-5 / pressure)
    start = dt.datetime(2024, 3, 7, 9, tzinfo=dt.UTC)
    when = [start + dt.timedelta(seconds=i / rate) for i in range(n)]
    stamps = [w.strftime("%Y-%m-%d %H:%M:%S.%f")[:-4] for w in when]
    return {
        "q": q,
        "u": u,
        "T": t,
        "Ts": sonic,
        "p": pressure,
        "when": when,
        "stamps": stamps,
        "n": n,
    }


def rows_of(columns, sep=",", dec="."):
    def cell(v):
        return v if isinstance(v, str) else f"{v:.4f}".replace(".", dec)

    return [sep.join(cell(c[i]) for c in columns) for i in range(len(columns[0]))]


def write(path, head, columns, sep=",", dec=".", middle=None, second=(), cut=0):
    rows = rows_of(columns, sep, dec)
    if middle is not None:
        rows.insert(len(rows) // 2, middle)
    text = "\n".join([sep.join(head), *second, *rows]) + "\n"
    path.write_text(text[:-cut] if cut else text, newline="")


def columns(b, q=None):
    """A usual record's columns."""
    return [
        b["stamps"],
        b["q"] if q is None else q,
        *b["u"],
        b["Ts"] - 273.15,
        np.full(b["n"], b["p"] / 10),
    ]


def overwritten(q, code, rows):
    cells = [f"{v:.4f}" for v in q]
    for i in rows:
        cells[i] = code
    return cells


def lagged(x, keep, first):
    """A first-order sensor's signal."""
    return signal.lfilter([1 - keep], [1, -keep], x, zi=[keep * first])[0]


def write_all(folder):
    """Writes all records into a folder."""
    b = base(11)
    write(folder / "ok.csv", HEAD, columns(b))
    _impossible(folder, b, columns(b))
    _spectra(folder)
    _units(folder, b, columns(b))
    _heads(folder, b, columns(b))
    _partial(folder, b, columns(b))


def _impossible(folder, b, usual):
    """Values that no hygrometer can mean; air and loggers that are not steady."""
    n = b["n"]
    write(
        folder / "overrange_7999.csv",
        HEAD,
        columns(b, overwritten(b["q"], "7999", range(500, 530))),
    )
    write(
        folder / "flag_minus_99_99.csv",
        HEAD,
        columns(b, overwritten(b["q"], "-99.99", range(500, 530))),
    )
    flagged, diagnosis, rng = b["q"].copy(), np.zeros(n), np.random.default_rng(5)
    for at in range(200, 2900, 300):
        flagged[at : at + 10] = 3 + 3 * rng.random(10)
        diagnosis[at : at + 10] = 16
    write(folder / "diag_flagged_rows.csv", [*HEAD, "diag_irga"], [*columns(b, flagged), diagnosis])
    write(folder / "mislabelled_mg.csv", [HEAD[0], "h2o (mg/m3)", *HEAD[2:]], usual)
    cold = base(21, temperature=273.15)
    write(
        folder / "supersaturated.csv",
        HEAD,
        columns(cold, overwritten(cold["q"] * 0.15 / 0.01801528, "", ())),
    )
    write(
        folder / "epoch_ms.csv",
        ["time", *HEAD[1:]],
        [[str(1709802000000 + 50 * i) for i in range(n)], *usual[1:]],
    )
    write(
        folder / "excel_days.csv",
        ["time", *HEAD[1:]],
        [[f"{45358.375 + i / 20.0 / 86400:.10f}" for i in range(n)], *usual[1:]],
    )

    # An analyser slower than its logger, air that wakes up, air that is not stationary.
    twice = np.repeat(np.arange(0, n, 2), 2)

    def doubled(x, noise=2e-5):
        return [f"{v:.6f}" for v in x[twice] + noise * rng.standard_normal(n)]

    write(
        folder / "stair_steps.csv",
        HEAD,
        [
            b["stamps"],
            doubled(b["q"]),
            *(doubled(u) for u in b["u"]),
            b["Ts"] - 273.15,
            np.full(n, 100.0),
        ],
    )
    calm, lively = field(71, 4500, 20.0, 3.0, cq=2e-5), field(72, 1500, 20.0, 3.0, cq=0.2)
    q = 9 + np.concatenate([calm, calm[-1] + lively - lively[0]])
    write(
        folder / "calm_then_lively.csv",
        BARE,
        [
            [f"{i / 20:.2f}" for i in range(6000)],
            [f"{v:.5f}" for v in q],
            ["3"] * 6000,
            ["0"] * 6000,
        ],
    )
    s = field(91, 5400, 20.0, 3.0, cq=1.0)
    window = np.hanning(241) / np.hanning(241).sum()
    strength = np.convolve(
        np.pad(np.where(np.arange(5400) < 3600, 0.1, 0.4), 120, mode="edge"), window, "valid"
    )
    write(
        folder / "intermittent.csv",
        BARE,
        [[f"{i / 20:.2f}" for i in range(5400)], 9 + strength * s, ["3"] * 5400, ["0"] * 5400],
    )
    hours = np.concatenate(
        [10.5 + field(51, 3600, 1.0, 1.0, outer=40.0), 7.5 + field(52, 3600, 1.0, 1.0, outer=40.0)]
    )
    write(
        folder / "two_hours.csv",
        BARE,
        [[str(i) for i in range(7200)], hours, ["1"] * 7200, ["0"] * 7200],
    )


def _spectra(folder):
    """Spectra that are not -5/3: a shallow one, a slow probe, a tube, noise of a limited band."""
    shallow = 12 + field(41, 9000, 20.0, 3.0, cq=0.2, slope=-1.5)
    write(
        folder / "slope_minus_1_5.csv",
        BARE,
        [[f"{v:.2f}" for v in np.arange(9000) / 20], shallow, ["3"] * 9000, ["0"] * 9000],
    )

    p = base(31, n=4500, rate=5.0, wind=8.0)
    y = lagged((p["q"] - 9) * 3, np.exp(-1 / (20 * 5.0)), 0.0)
    write(
        folder / "slow_probe.csv",
        HEAD[:6],
        [p["stamps"], [f"{9 + v:.7f}" for v in y], *p["u"], 15 + 1.3 * y],
    )
    s = field(81, 9000, 10.0, 5.0, outer=200.0)
    y = 9 + lagged(s, np.exp(-1 / 3.0), s[0])
    write(
        folder / "tube.csv",
        BARE,
        [[f"{i / 10:.1f}" for i in range(9000)], y, ["5"] * 9000, ["0"] * 9000],
    )
    white = np.fft.rfft(0.1 * np.random.default_rng(83).standard_normal(8 * 18000))
    white[np.fft.rfftfreq(8 * 18000, 1 / 20) > 3] = (
        0  # an analyser with a bandwidth of 3 Hz, logged at 20 Hz
    )
    y = (
        9
        + field(82, 18000, 20.0, 2.0, cq=0.002, outer=50.0)
        + np.fft.irfft(white, 8 * 18000)[:18000]
    )
    write(
        folder / "noise_below_3_hz.csv",
        BARE,
        [
            [f"{i / 20:.2f}" for i in range(18000)],
            [f"{v:.6f}" for v in y],
            ["2"] * 18000,
            ["0"] * 18000,
        ],
    )


def _units(folder, b, usual):
    """The same humidity in other units."""
    moles = b["p"] * 100 / (GAS * b["T"])
    fraction = b["q"] / MOLAR_MASS / moles
    for name, column, values in (
        ("mole_fraction_mmol_mol.csv", "h2o (mmol/mol)", fraction * 1e3),
        ("mixing_ratio_dry_mmol_mol.csv", "h2o_dry (mmol/mol)", 1e3 * fraction / (1 - fraction)),
        ("mole_fraction_ppm.csv", "h2o (umol/mol)", fraction * 1e6),
    ):
        write(
            folder / name,
            [HEAD[0], column, *HEAD[2:]],
            [b["stamps"], [f"{v:.5f}" for v in values], *usual[2:]],
        )
    celsius = b["T"] - 273.15
    saturation = 6.112 * np.exp(17.62 * celsius / (243.12 + celsius))
    humidity = 100 * b["q"] * VAPOUR * b["T"] * 1e-5 / saturation
    write(
        folder / "relative_humidity_only.csv",
        ["TIMESTAMP", "RH (%)", "T (C)", "wind_speed (m/s)"],
        [b["stamps"], humidity, celsius, b["u"][0]],
    )
    write(
        folder / "speed_of_sound.csv",
        [*HEAD[:5], "SOS (m/s)"],
        [b["stamps"], b["q"], *b["u"], np.sqrt(402.7 * b["Ts"])],
    )


def _heads(folder, b, usual):
    """Time and heads as loggers, spreadsheets and colleagues write them."""
    n = b["n"]
    sonic = b["Ts"] - 273.15
    write(folder / "no_time.csv", HEAD[1:], usual[1:])
    write(
        folder / "unnamed_time.csv",
        ["", "u_m/s", "v_m/s", "w_m/s", "T_degC", "H2O_g/m3"],
        [b["stamps"], *b["u"], sonic, b["q"]],
    )
    write(
        folder / "three_header_rows.csv",
        ["TIMESTAMP", "U_[S1]", "V_[S1]", "W_[S1]", "T_SONIC_[S1]", "H2O_CONC_[A1]"],
        [b["stamps"], *b["u"], b["Ts"], b["q"] / 0.01801528],
        second=(
            "[yyyy-mm-dd],[m+1_s-1],[m+1_s-1],[m+1_s-1],[K],[mmol+1 m-3]",
            "[L],[S1],[S1],[S1],[S1],[A1]",
        ),
    )
    write(
        folder / "us_date.csv",
        HEAD,
        [[w.strftime("%m/%d/%Y %H:%M:%S.%f")[:-4] for w in b["when"]], *usual[1:]],
    )
    write(
        folder / "german_date.csv",
        HEAD,
        [[w.strftime("%d.%m.%Y %H:%M:%S.%f")[:-4] for w in b["when"]], *usual[1:]],
    )
    write(
        folder / "date_and_time.csv",
        ["date", "time", *HEAD[1:]],
        [[s[:10] for s in b["stamps"]], [s[11:] for s in b["stamps"]], *usual[1:]],
    )
    write(
        folder / "time_zone.csv",
        HEAD,
        [[s.replace(" ", "T") + "+01:00" for s in b["stamps"]], *usual[1:]],
    )
    write(folder / "whole_seconds.csv", HEAD, [[s[:19] for s in b["stamps"]], *usual[1:]])
    write(folder / "semicolon_decimal_comma.csv", HEAD, usual, sep=";", dec=",")
    write(folder / "header_again.csv", HEAD, usual, middle=",".join(HEAD))
    write(folder / "blank_line.csv", HEAD, usual, middle="")
    write(folder / "last_line_cut.csv", HEAD, usual, cut=25)
    write(
        folder / "bracketed_instruments.csv",
        ["TIMESTAMP", "H2O [GAS1-A]", "U [SON1-A]", "V [SON1-A]", "W [SON1-A]", "T_SONIC [SON1-A]"],
        usual[:6],
    )
    write(
        folder / "array_names.csv",
        ["TIMESTAMP", "h2o(1)", "Ux(1)", "Uy(1)", "Uz(1)", "Ts(1)"],
        usual[:6],
    )
    write(
        folder / "two_columns.csv",
        ["time (s)", "h2o (g/m3)"],
        [[f"{i / 20:.2f}" for i in range(n)], b["q"]],
    )


def _partial(folder, b, usual):
    """Columns that cannot be used, two analysers, and a pause between two files."""
    n = b["n"]
    write(folder / "optional_unknown_unit.csv", [*HEAD[:5], "Ts (mV)", "press (kPa)"], usual)
    write(folder / "optional_all_nan.csv", HEAD, [*usual[:6], ["NAN"] * n])
    dead = 0.9 + 0.008 * np.random.default_rng(12).standard_normal(n)
    write(
        folder / "two_analysers.csv",
        ["TIMESTAMP", "H2O (g/m3)", "H2O2 (g/m3)", *HEAD[2:]],
        [b["stamps"], dead, b["q"], *usual[2:]],
    )
    pause = [
        *b["when"][: n // 2],
        *(w + dt.timedelta(seconds=10) for w in b["when"][n // 2 :]),
    ]
    later = [w.strftime("%Y-%m-%d %H:%M:%S.%f")[:-4] for w in pause]
    for name, part in (("pause_a.csv", slice(None, n // 2)), ("pause_b.csv", slice(n // 2, None))):
        write(folder / name, HEAD, [c[part] for c in (later, *usual[1:])])


def gusty(path, seed, n=6000, cq=0.15, outer=60.0, rate=10.0):
    """A frozen isotropic field carried past the sensor by a gusty wind: exact, by Cholesky.

    The humidity that the sensor meets is q(X(t)), X the path of the air that has passed, and q is
    Gaussian with the field's covariance between those points: no hypothesis of Taylor's is left.
    """
    rng, width = np.random.default_rng(99), 300
    shape = np.hanning(width) / np.linalg.norm(np.hanning(width))

    def gusts(sigma):
        return sigma * np.convolve(rng.standard_normal(n + width - 1), shape, "valid")

    u = np.stack([1.5 + gusts(0.9), gusts(0.9), gusts(0.3)])
    met = np.cumsum(u, 1) / rate
    k0 = 2 * np.pi / outer
    shape = np.sqrt(np.pi) / 2 * special.gamma(1 / 3) / special.gamma(5 / 6)
    variance = A * cq * outer ** (2 / 3) * shape
    r = np.geomspace(1e-5, 80 * outer, 8000)
    bessel = (k0 * r) ** (1 / 3) * special.kv(1 / 3, k0 * r)
    covariance = variance * 2 ** (2 / 3) / special.gamma(1 / 3) * bessel
    apart = np.sqrt(sum((x[:, None] - x[None]) ** 2 for x in met))
    matrix = np.interp(apart.ravel(), np.r_[0, r], np.r_[variance, covariance]).reshape(n, n)
    matrix[np.diag_indices(n)] = variance * (1 + 1e-9)
    root = linalg.cholesky(matrix, lower=True, overwrite_a=True, check_finite=False)
    q = 10 + root @ np.random.default_rng(seed).standard_normal(n)
    head = ["time_s", "h2o_g_m3", "Ux_m_s", "Uy_m_s", "Uz_m_s"]
    write(path, head, [np.arange(n) / rate, q, *u])
    return path
