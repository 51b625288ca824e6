"""Heads as public files have them: loggers of six makes, rows of a record of known statistics.

The names, units and forms of rows are facts of the files that are named; the numbers are our own.
"""

from __future__ import annotations

import re
import zipfile

import numpy as np
import pytest
from other_records import VAPOUR, base

from thzcl.errors import RecordError
from thzcl.records.study import Asked, study

SAMPLES, RATE = 3000, 20.0
MEAN, SIGMA, CONSTANT = 9.0, 0.2205, 0.05  # g/m3, g/m3, g2 m-6 m-2/3, as of ok.csv


@pytest.fixture(scope="module")
def cells():
    """Columns of text by name: what a mast measures, stamps, and what stands beside them."""
    b = base(11)
    second, count = np.arange(SAMPLES) / RATE, np.arange(SAMPLES)
    share = b["q"] * VAPOUR * b["T"] * 1e-5 / b["p"]
    numbers = {
        "u": b["u"][0], "v": b["u"][1], "w": b["u"][2], "q": b["q"], "n": count, "0": 0 * second,
        "Ts": b["Ts"] - 273.15, "TsK": b["Ts"], "T": b["T"] - 273.15, "p": 0 * second + 100.0,
        "mmol/m3": b["q"] / 0.01801528, "sos": np.sqrt(402.7 * b["Ts"]),
        "mmol/mol": 1e3 * share, "ppb": 1e9 * share, "dry": 1e3 * share / (1 - share),
        "epoch": 1556301600 + second // 1, "second": second % 60, "1": 0 * second + 1,
        "ns": np.rint(second % 1 * 1e9), "ms": np.rint(second % 1 * 1e3),
        "hhmm": 159 + second // 60, "count": (53 + count) % 64, "248": 0 * second + 248,
        "some": 0 * second + 12.5,
    }  # fmt: skip
    whole = ("n", "0", "1", "epoch", "ns", "ms", "hhmm", "count", "248")
    text = {k: [f"{x:.{0 if k in whole else 5}f}" for x in v] for k, v in numbers.items()}
    return text | {
        "stamp": [f'"{s}"' for s in b["stamps"]],
        "digits": [re.sub(r"\D", "", s[:19]) + s[19:] for s in b["stamps"]],
        "micro": [f"{s}0000" for s in b["stamps"]],
        "NAN": ['"NAN"'] * SAMPLES, "DATA": ["DATA"] * SAMPLES, "day": ["1/1/2005"] * SAMPLES,
        "clock": [f"19:0{int(s // 60)}:{int(s % 60):02d}:{round(s % 1 * 1e3):03d}" for s in second],
    }  # fmt: skip


def campbell(names, units):
    """Returns the four lines of a TOA5 file: "TIMESTAMP" and "RECORD" come first."""
    titles, kinds = names.split(), units.split()
    rows = (["TOA5", "mast", "CR3000", "6843", "Std.22", "CPU:flux.CR3", "24006", "ts_data"],
            ["TIMESTAMP", "RECORD", *titles], ["TS", "RN", *kinds],
            ["", "", *["Smp"] * len(titles)])  # fmt: skip
    return [",".join(f'"{cell}"' for cell in row) for row in rows]


LI_7200 = (
    "DATAH|Seconds|Nanoseconds|Sequence Number|Diagnostic Value|Date|Time|CO2 Absorptance|"
    "CO2 (mmol/m^3)|H2O (mmol/m^3)|H2O (g/m^3)|Total Pressure (kPa)|Head Pressure (kPa)|"
    "Aux 1 - U (m/s)|Aux 2 - V (m/s)|Aux 3 - W (m/s)|Aux 4 - SOS (m/s)|CO2 dry(umol/mol)|"
    "H2O (mmol/mol)|H2O dry(mmol/mol)|Dew Point (C)|Cell Temperature (C)|Flow Rate (slpm)|CHK"
)
CR23X = "TMSTAMP,RECNBR,Day_RTM,Hour_Minute_RTM,Seconds_RTM,Ux,Uy,Uz,Ts,co2,h2o,press,diag_csat"
HEADS = {  # head, columns, what else the user says
    "CSAT3, LI-7500 and a trace-gas laser that is off": (
        campbell("Ux Uy Uz co2 h2o n2o Ts press diag_csat t_hmp e_hmp",
                 "m/s m/s m/s mg/m^3 g/m^3 umol/mol C kPa unitless C kPa"),
        "stamp n u v w some q NAN Ts p 0 T some", ""),
    "two sonics, the first dead, LI-7500 and LI-7700": (
        campbell("UxRMY UyRMY UzRMY sosRMY UxCSAT UyCSAT UzCSAT TsCSAT diag_CSAT LI7500_H2O "
                 "press_LI7500 diag_LI7500 LI7700_CH4_dens",
                 "m/s m/s m/s m/s m/s m/s m/s C unitless mmol/m^3 kPa unitless mmol/m^3"),
        "stamp n NAN NAN NAN NAN u v w Ts count mmol/m3 p 248 some",
        "h2o=LI7500_H2O,Ux=UxCSAT,Uy=UyCSAT,Uz=UzCSAT,Ts=TsCSAT"),
    "LI-7500 with its maker's letters": (
        campbell("Ux Uy Uz Ts diag_sonic CO2_li H2O_li amb_press_li agc_li",
                 "m/s m/s m/s C arb mg/m^3 g/m^3 kPa %"),
        "stamp n u v w Ts 0 some q p some", ""),
    "seconds and nanoseconds beside the stamps": (
        campbell("milliseconds seconds nanoseconds CH4_77 amb_press_77 Ux Uy Uz Ts diag_csat h2o "
                 "press_li7500", "ms s ns ug/m^3 kPa m/s m/s m/s C unitless g/m^3 kPa"),
        "stamp n ms epoch ns some some u v w Ts 0 q p", ""),
    "EasyFlux": (
        campbell("Ux Uy Uz T_SONIC diag_sonic CO2_density H2O_density diag_irga T_SONIC_corr PA "
                 "CO2_sig_strgth H2O_sig_strgth",
                 "m/s m/s m/s degC arb mg/m^3 g/m^3 arb degC kPa arb arb"),
        "stamp n u v w Ts 0 some q 0 T p some some", ""),
    "CR23X, day of year and hours in columns": (
        ["TOACI1,CR23X,105,,,,,,,,,,", CR23X],
        "day n 1 hhmm second u v w Ts some q p 1", ""),
    "ICOS": (
        ["TIMESTAMP,U,V,W,T_SONIC,SA_DIAG_VALUE,CO2,H2O,GA_DIAG_CODE,PA"],
        "digits u v w TsK 0 some mmol/mol 0 p", "h2o=H2O:mmol/mol"),
    "Swiss FluxNet, units and instruments in names": (
        ["date,u_ms-1,v_ms-1,w_ms-1,t_sonic_degC,co2_ppb_qcl,h2o_ppb_qcl,sa_diag_1,press"],
        "micro u v w Ts some ppb 0 p", "h2o=h2o_ppb_qcl:ppb"),
}  # fmt: skip


def is_right(found):
    assert found["rate_hz"] == pytest.approx(RATE, rel=1e-4)
    assert found["gaps"] == found["spikes"] == 0
    assert found["mean_g_m3"] == pytest.approx(MEAN, abs=0.02)
    assert found["sigma_g_m3"] == pytest.approx(SIGMA, abs=0.0045)
    assert found["structure_constant_q"] == pytest.approx(CONSTANT, rel=0.2)
    assert found["correlation_tq"] == pytest.approx(0.955, abs=0.025)
    assert found["pressure_hpa"] == pytest.approx(1000)


@pytest.mark.parametrize("case", HEADS)
def test_heads_of_public_files_are_understood(tmp_path, cells, case):
    head, names, columns = HEADS[case]
    rows = zip(*(cells[name] for name in names.split()), strict=True)
    (tmp_path / "a.dat").write_text("\n".join([*head, *map(",".join, rows)]) + "\n")
    is_right(study([tmp_path / "a.dat"], asked=Asked(columns)))


def test_an_enclosed_analyser_with_its_biomet_beside_it(tmp_path, cells):
    """LI-7200: five humidities, the speed of sound, a clock with colons, and a second table."""
    names = ("DATA epoch ns n 1 day clock some some mmol/m3 q p some u v w sos some mmol/mol dry "
             "some some some n")  # fmt: skip
    rows = zip(*(cells[name] for name in names.split()), strict=True)
    about = "Model:\tLI-7200 Enclosed CO2/H2O Analyzer\nSN:\t72H-1\nTimezone:\tEtc/GMT-1\n"
    text = about + "\n".join([LI_7200.replace("|", "\t"), *map("\t".join, rows)]) + "\n"
    biomet = f"{about}DATAH\tDATE\tTIME\tTA_1_1_1(C)\nDATA\t2019-04-26\t19:00:00:000\t10.7\n"
    with zipfile.ZipFile(tmp_path / "a.ghg", "w") as archive:
        archive.writestr("a-biomet.data", biomet)
        archive.writestr("a.data", text)
        archive.writestr("a.metadata", "[Site]\n")
    found = study([tmp_path / "a.ghg"])
    is_right(found)
    assert any("Aux 4 - SOS (m/s), the speed of sound" in note for note in found["notes"])


@pytest.mark.parametrize(
    ("head", "names", "messages"),
    [
        (
            ["VC:904M BD:May 23 2013 SN:LGR-13-0171",
             "      Time,      [CH4]_ppm,   [H2O]_ppm,   [H2O]_ppm_sd,    GasP_torr,   GasT_C"],
            "micro some ppb some some some",
            ["expected columns of wind, .*there are Time"],
        ),
        (
            ["12/10/2016 00:00:00 0.004 3564172800.000 23:00:00 SPEC:H2O", "time, X1, Praw, Traw"],
            "epoch ppb some some",
            [r"a\.dat:2: expected a column of water vapour .*there are time, X1, Praw, Traw;",
             "expected columns of wind"],
        ),
        (
            campbell("UxRMY UyRMY UxCSAT UyCSAT LI7500_H2O", "m/s m/s m/s m/s mmol/m^3"),
            "stamp n NAN NAN u v mmol/m3",
            ["perhaps LI7500_H2O; name it with --columns h2o=NAME", "perhaps UxRMY or UxCSAT; "],
        ),
    ],
    ids=["Los Gatos: no wind", "Aerodyne: blanks below commas", "whose sonic?"],
)  # fmt: skip
def test_what_a_head_does_not_tell_is_asked_for(tmp_path, cells, head, names, messages):
    separator = "  " if "Praw" in head[-1] else ","
    rows = zip(*(cells[name] for name in names.split()), strict=True)
    (tmp_path / "a.dat").write_text("\n".join([*head, *map(separator.join, rows)]) + "\n")
    with pytest.raises(RecordError) as caught:
        study([tmp_path / "a.dat"])
    assert len(caught.value.problems) == len(messages)
    for problem, message in zip(caught.value.problems, messages, strict=True):
        assert re.search(message, problem)


def test_the_counter_of_a_diagnostic_word_is_no_flag(tmp_path, cells):
    """CSAT3 counts samples in its word's lower six bits; its flags are the upper four."""
    word = (53 + np.arange(SAMPLES)) % 64
    word[700:730] += 4096
    names = ("stamp", "n", "u", "v", "w", "q", "Ts", "p")
    rows = zip(*(cells[name] for name in names), map(str, word), strict=True)
    head = campbell("Ux Uy Uz h2o Ts press diag_csat", "m/s m/s m/s g/m^3 C kPa unitless")
    (tmp_path / "a.dat").write_text("\n".join([*head, *map(",".join, rows)]) + "\n")
    found = study([tmp_path / "a.dat"])
    (note,) = (note for note in found["notes"] if "diag_csat" in note)
    assert "in 30 samples: they are gaps in Ux" in note and "h2o" not in note
    assert found["gaps"] == 0


def test_a_humidity_without_a_unit_says_what_else_it_may_be(tmp_path, cells):
    names = ("micro", "u", "v", "w", "mmol/mol", "p", "T")
    rows = zip(*(cells[name] for name in names), strict=True)
    head = "timestamp,u,v,w,h2o,pressure,temperature"
    (tmp_path / "a.dat").write_text("\n".join([head, *map(",".join, rows)]) + "\n")
    notes = "\n".join(study([tmp_path / "a.dat"])["notes"])
    assert "h2o names no unit: taken as g/m3; if it is mmol/m3, mmol/mol or another" in notes
    is_right(study([tmp_path / "a.dat"], asked=Asked("h2o=h2o:mmol/mol")))


def test_a_stuck_instrument_is_a_gap(tmp_path, cells):
    """Ten seconds of one value are no air; a stair of two samples is."""
    q = [*cells["q"][:600], *[cells["q"][600]] * 240, *cells["q"][840:]]
    names = ("micro", "u", "v", "w")
    rows = zip(*(cells[name] for name in names), q, strict=True)
    (tmp_path / "a.csv").write_text("time,u,v,w,h2o_g_m3\n" + "\n".join(map(",".join, rows)) + "\n")
    found = study([tmp_path / "a.csv"])
    assert found["gaps"] == found["masked_by_column"]["h2o_g_m3"] == 240
    assert any("a.csv:602: column h2o_g_m3: 240 values" in n for n in found["notes"])
    rows = zip(
        *(cells[name] for name in names), [*q[:840], *[q[840]] * 900, *q[1740:]], strict=True
    )
    (tmp_path / "a.csv").write_text("time,u,v,w,h2o_g_m3\n" + "\n".join(map(",".join, rows)) + "\n")
    with pytest.raises(RecordError, match=r"a\.csv:602: .* 1140 values .*a stuck instrument"):
        study([tmp_path / "a.csv"])


def test_a_file_of_windows_letters(tmp_path, cells):
    """Units with a power of three and degrees in Latin letters, not UTF-8."""
    names = ("micro", "mmol/m3", "u", "v", "w", "Ts", "p")
    rows = zip(*(cells[name] for name in names), strict=True)
    head = "Zeit,h2o (mmol/m\u00b3),Ux (m/s),Uy (m/s),Uz (m/s),Ts (\u00b0C),Luftdruck (kPa)\n"
    (tmp_path / "a.csv").write_bytes((head + "\n".join(map(",".join, rows))).encode("latin-1"))
    is_right(study([tmp_path / "a.csv"]))
