"""Makes scenarios/IMAGERS.md: imagers that exist, with thzcl's noise beside the one reported.

    python tests/imagers.py

What was published stands here, with its source; thzcl computes the rest. Nothing is fitted.
"""

from __future__ import annotations

import math
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, not an installed thzcl

from thzcl import pipeline
from thzcl.scenario.text import dumps

PAGE = Path(__file__).parents[1] / "scenarios" / "IMAGERS.md"
NETD = "NEDT at the sensor"  # the fact of passive images, K
INTRODUCTION = """# Imagers that exist

What thzcl makes of imagers and receivers whose parameters are published, beside the noise that
their makers report. Each row is a run of thzcl: a black wall without air, seen with the published
parameters. What is not published is assumed, and said below; nothing is fitted.

Reported noise holds all that a real instrument has: losses, drift of the gain, a NEP that is worst
at the edges of the band. A ratio below one is therefore to be expected, and one far above would be
a fault of thzcl or of the reading of what was published.
"""
BOUNDS = """## Bounds

Here a needed number is not published, or was not found, and what is assumed in its place decides
the result. These are no comparisons.
"""
MISSING = """## What could not be had

All numbers were read in abstracts; the bodies of the papers were out of reach. No active imager was
found whose abstract gives power, noise of the receiver, time and a measured signal-to-noise ratio
together, so that the kind is represented by a bound alone: imaging radars at 340 to 675 GHz,
cameras lit by quantum cascade lasers, and chips of silicon all tell some of the four. Of cooled
cameras for rooms the band, the efficiency and the dwell time are missing; the one cooled row
is a telescope for the cosmic background, far below thzcl's frequencies, with the same photons. For
the 150 GHz camera of Sayers et al. (2025, arXiv 2502.14607) no noise is reported that could be
compared; its makers say that photons limit it.
"""
MADE = "This page is made by `python tests/imagers.py`.\n"


@dataclass(frozen=True)
class Reading:
    """One way to read what was published: the sensor's table, and the wall before it."""

    sensor: dict[str, Any]
    scene_k: float
    name: str = ""  # told beside the result, where there are several


@dataclass(frozen=True)
class Imager:
    """An imager that exists: its noise as reported, and all that was needed to compute it."""

    name: str
    kind: str
    reported: float
    unit: str
    source: str
    published: str
    assumed: str
    readings: tuple[Reading, ...] = field(default_factory=tuple)


def _direct(low_ghz: float, high_ghz: float, time_s: float, **more: Any) -> dict[str, Any]:
    """Returns a direct detector of one mode with a flat band."""
    center, width = (low_ghz + high_ghz) / 2, high_ghz - low_ghz
    band = {"kind": "passive-broadband", "center_ghz": center, "bandwidth_ghz": width}
    return band | {"integration_time_s": time_s} | more


def _heterodyne(
    ghz: float, if_ghz: float, width_ghz: float, receiver_k: float, time_s: float, **more: Any
) -> dict[str, Any]:
    """Returns a radiometer for total power, without drift."""
    band = {"kind": "radiometer", "frequency_ghz": ghz, "if_center_ghz": if_ghz}
    noise = {"receiver_temperature_k": receiver_k, "integration_time_s": time_s}
    return band | {"if_bandwidth_ghz": width_ghz} | noise | more


NEP = "noise_equivalent_power_w_rthz"
FET = _direct(100, 1500, 1.0, **{NEP: 42e-12})
HYMS = _heterodyne(60, 0.1, 0.01, 200, 0.3)
CLASS_GHZ = 1 / (13.1e12 * 0.48 * 1.380649e-23) * 1e-9  # 1 K/(13.1 K/pW) = efficiency k B
CLASS_K = 13.1 * 1.6 + 6.62607015e-34 * 38.4e9 / 1.380649e-23 / 2  # Rayleigh-Jeans to Planck
IMAGERS = (
    Imager(
        "CLASS, 40 GHz, transition-edge bolometers",
        "cooled direct",
        13.1e12 * 19e-18,
        "K",
        "Appel et al. 2019, On-sky performance of the CLASS Q-band telescope, arXiv 1811.08287",
        "38.4 GHz, optical loading 1.6 pW, 13.1 K/pW, optical efficiency 0.48, and a measured "
        "noise-equivalent power of 19 aW s^1/2: 0.249 mK in 1 s.",
        f"The band, {CLASS_GHZ:.1f} GHz, follows from calibration and efficiency. The load is an "
        f"even grey body of {CLASS_K:.1f} K, seen through cold optics. The bolometer's own noise "
        "is not in the abstract and left out.",
        (
            Reading(
                _direct(
                    38.4 - CLASS_GHZ / 2,
                    38.4 + CLASS_GHZ / 2,
                    1.0,
                    photon_noise=True,
                    optical_efficiency=0.48,
                ),
                CLASS_K,
            ),
        ),
    ),
    Imager(
        "Field-effect transistor of silicon, 0.1-1.5 THz, scanned",
        "uncooled direct",
        4.4,
        "K",
        "Cibiraite-Lukenskiene et al. 2020, Sensors 20, 4087, doi:10.3390/s20154087",
        "42 pW/Hz^0.5 (optical) over 0.1 to 1.5 THz, pixels of 1 mm at 1 mm/s, 4.4 K.",
        "One mode, an even response, no loss in the optics, 1 s a pixel. Whether the signal was "
        "chopped is not in the abstract: both are told.",
        (
            Reading(FET, 300.0, "staring"),
            Reading(FET | {"modulation": "chopped"}, 300.0, "chopped"),
        ),
    ),
    Imager(
        "SiGe chip with an amplifier before its detector, 147 GHz wide",
        "uncooled direct",
        0.31,
        "K",
        "An On-Chip Antenna-Coupled Preamplified D-Band to J-Band Total Power Radiometer Chip in "
        "130 nm SiGe BiCMOS, IEEE RFIC Symposium, abstract 1410",
        "An optical NEP of 23 fW/Hz^0.5, the least in the band, 147 GHz, 3.125 ms, 0.31 K.",
        "The NEP is the least of the band throughout, so that the computed noise is a lower bound. "
        "It was measured before a room and holds the photons already. The band is 146.5 to 293.5 "
        "GHz; where it lies changes nothing.",
        (Reading(_direct(146.5, 293.5, 3.125e-3, **{NEP: 23e-15}), 300.0),),
    ),
    Imager(
        "SiGe receiver with an amplifier before its detector, 165 GHz",
        "uncooled direct",
        0.35,
        "K",
        "D-Band Total Power Radiometer Performance Optimization in an SiGe HBT Technology, IEEE "
        "Trans. Microwave Theory Tech. 60, 813, 2012",
        "A noise temperature of 1645 K in 10 GHz, 3.125 ms, less than 0.35 K.",
        "Computed as a radiometer of one band of 10 GHz before 290 K, without drift. No "
        "independent test: the reported limit is that equation's result to 1 %.",
        (Reading(_heterodyne(165, 6, 10, 1645, 3.125e-3), 290.0),),
    ),
    Imager(
        "Hot-electron bolometer as a mixer, 300 GHz",
        "heterodyne",
        0.5,
        "K",
        "Fluctuation sensitivity of a superconducting hot-electron bolometric mixer (in Russian), "
        "HSE publication 210634099",
        "A noise temperature of 3800 K, 500 MHz, 1 s, 0.5 K once the drift of the gain had been "
        "reduced.",
        "The noise temperature is that of both sidebands, as is usual; 300 K; no drift, of which "
        "the abstract gives no figure.",
        (Reading(_heterodyne(300, 1, 0.5, 3800, 1.0), 300.0),),
    ),
    Imager(
        "HYMS, airborne sounder, 60 GHz",
        "heterodyne",
        0.3,
        "K",
        "Auriacombe et al. 2019, A novel airborne microwave sounder radiometer, 44th IRMMW-THz",
        "A noise temperature below 200 K (double-sideband), channels of 10 MHz, 300 ms, 0.3 K.",
        "200 K, before 290 K. The receiver separates its sidebands: both readings are told.",
        (
            Reading(HYMS, 290.0, "double-sideband"),
            Reading(HYMS | {"sideband": "single"}, 290.0, "single-sideband"),
        ),
    ),
)
LEKID = _direct(332.5, 367.5, 0.5, photon_noise=True)
FOURIER = {
    "kind": "active",
    "frequency_ghz": 600.0,
    "source_power_w": 56e-6,
    "dynamic_range_db": 100.0,
    NEP: 42e-12,
}
UNDECIDED = (
    Imager(
        "Camera of kinetic inductance detectors, 350 GHz",
        "cooled direct",
        0.1,
        "K",
        "Rowe et al. 2016, A passive THz video camera based on lumped element kinetic inductance "
        "detectors, arXiv 1511.06011",
        "350 GHz, 152 detectors, 2 frames a second, 0.1 K a frame, close to the background limit.",
        "A band of 35 GHz, one mode, cold optics, and a detector that stares for the whole frame. "
        "The array is scanned, for a dwell that the abstract does not tell: photons alone make 0.1 "
        "K in 0.3 ms. Only the least possible noise follows.",
        (
            Reading(LEKID, 300.0, "efficiency 1"),
            Reading(LEKID | {"optical_efficiency": 0.1}, 300.0, "efficiency 0.1"),
        ),
    ),
    Imager(
        "Fourier imager with a source of 56 uW, 600 GHz",
        "active",
        60.0,
        "dB",
        "600-GHz Fourier imaging based on heterodyne detection at the 2nd sub-harmonic (arXiv)",
        "56 uW, heterodyne detection, a dynamic range of 60 dB.",
        "Neither noise nor time of the receiver is in the abstract. All of the power on one "
        "detector with the 42 pW/Hz^0.5 of another transistor, used directly. Only the order of "
        "magnitude can be compared.",
        (
            Reading(FOURIER | {"integration_time_s": 0.01}, 300.0, "10 ms"),
            Reading(FOURIER | {"integration_time_s": 0.5}, 300.0, "500 ms"),
        ),
    ),
)


def computed(imager: Imager) -> list[float]:
    """Returns thzcl's noise of an imager (K), or its ratio of signal to noise (dB), by reading."""
    return [_run(reading) for reading in imager.readings]


def _run(reading: Reading) -> float:
    """Returns what a run of thzcl tells about a wall that fills the view, without air."""
    active = reading.sensor["kind"] == "active"
    surface = {"reflectivity": 1.0} if active else {"temperature_k": reading.scene_k}
    box = {"kind": "box", "center_m": [11.0, 0.0, 0.0], "size_m": [2.0, 20.0, 20.0]}
    scene = {
        "camera": {
            "position_m": [0.0, 0.0, 0.0],
            "look_at_m": [10.0, 0.0, 0.0],
            "focal_length_mm": 100.0,
            "focal_plane_mm": [1.0, 1.0],
            "pixels": [2, 2],
        },
        "atmosphere": {"temperature_k": 300.0, "relative_humidity_percent": 0.0, "model": "none"},
        "targets": {"wall": box | surface},
        "sensor": reading.sensor,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wall.toml"
        path.write_text(dumps(scene), encoding="utf-8")
        facts = pipeline.run(path, figure=False).variants[0].image.facts
    return 10 * math.log10(facts["SNR"][0]) if active else float(facts[NETD][0])


def page() -> str:
    """Returns the whole page."""
    parts = [INTRODUCTION, _table(IMAGERS, ratio=True), *map(_about, IMAGERS)]
    parts += [BOUNDS, _table(UNDECIDED, ratio=False), *map(_about, UNDECIDED)]
    return "\n".join([*parts, MISSING, MADE])


def _table(imagers: tuple[Imager, ...], ratio: bool) -> str:
    """Returns a row for each reading of each imager."""
    head = ["imager", "kind", "reported", "thzcl", *(["thzcl / reported"] if ratio else [])]
    rows = [head, ["---"] * len(head)]
    for imager in imagers:
        for reading, value in zip(imager.readings, computed(imager), strict=True):
            name = f", {reading.name}" if reading.name else ""
            row = [f"{imager.name}{name}", imager.kind]
            row += [_shown(imager.reported, imager.unit), _shown(value, imager.unit)]
            rows.append([*row, f"{value / imager.reported:.2f}"] if ratio else row)
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def _shown(value: float, unit: str) -> str:
    """Returns a value with its unit: 0.000249 K as 0.249 mK."""
    if unit == "K" and value < 0.01:
        return f"{value * 1e3:.3g} mK"
    return f"{value:.3g} {unit}"


def _about(imager: Imager) -> str:
    """Returns what was published of an imager, where, and what had to be assumed."""
    lines = [f"Published: {imager.published}", f"Assumed: {imager.assumed}"]
    text = [fill(line, 100, break_long_words=False) for line in [f"{imager.source}.", *lines]]
    return "\n\n".join([f"### {imager.name}", *text]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
