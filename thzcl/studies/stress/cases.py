"""The cases: air that is deep, thin, cold, hot, wet, dry, near and far; surfaces from 0 K to 1e18 K; odd cameras.

Every bound is relative to a quantity that the case makes non-zero, and has its reason here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from thzcl.studies.stress import judges
from thzcl.studies.stress.trial import DOUBLE, SINGLE, Case, Judge

# A crossing is placed to a rounding or two of float32 (6e-8), and ten to ten thousand of them add
# up at random.
ROUNDED = {SINGLE: 1e-6, DOUBLE: 1e-12}
EMITTED = {
    SINGLE: 1e-6,
    DOUBLE: 1e-9,
}  # in float64 the polynomials of absorption in two variables are what limits
NOTHING = {SINGLE: 0.0, DOUBLE: 0.0}  # a difference of equals is exactly zero
NEGLIGIBLE = {SINGLE: 1.2e-7}  # exp(-16): what a ray past its cut-off may still show
RESOLVED = {SINGLE: 1e-5}  # of what the path lets through: what a band's quadrature is asked for
FITTED = {
    SINGLE: 1e-6,
    DOUBLE: 1e-6,
}  # humidity over its whole range: the polynomial of degree 16 is what limits
FAR = {SINGLE: 1e-6, DOUBLE: 1e-9}  # a million metres are known to 1e-10 m, the path has 30 m
STORED = {
    SINGLE: 1e-6,
    DOUBLE: 1e-9,
}  # of a contrast in kelvin; 290.000001 K itself is known to 6e-14 K

Judged = tuple[Judge, Mapping[str, float]]
DEPTH: Judged = (judges.depth, ROUNDED)
PASSED: Judged = (judges.passed, ROUNDED)
EVERYTHING: dict[str, Judged] = {"depth": DEPTH, "passed": PASSED}


def _within(bounds: Mapping[str, float]) -> dict[str, Judged]:
    """Depth and contrast within other bounds."""
    return {"depth": (judges.depth, bounds), "passed": (judges.passed, bounds)}


WARM: dict[str, Judged] = {
    "depth": (judges.depth, EMITTED),
    "emitted": (judges.emitted, EMITTED),
    "outside": (judges.outside, NOTHING),
}
DEEPEST = {"numerics.cutoff_depth": 1e9}  # no cut-off at all
AIR, FLUCTUATIONS, CAMERA = "atmosphere", "atmosphere.fluctuations", "camera"
LINES = (
    (183.31, 500.0),
    (556.936, 5.0),
    (752.033, 5.0),
    (987.927, 5.0),
)  # GHz, and m of air 10 deep and more
SOURCES = (0.0, 2.7, 3000.0, 1e6, 1e18)  # K
WALL = {
    "kind": "box",
    "center_m": [30.3, 0.0, 0.0],
    "size_m": [20.0, 200.0, 200.0],
    "temperature_k": 310.0,
}
LEVEL = {"camera.position_m": [0.3, -0.2, 2.1], "camera.look_at_m": [9.3, -0.2, 2.1]}


def cases() -> list[Case]:
    """Every case, in the order of the table."""
    return [
        *_saturated(),
        *_contrasts(),
        *_airs(),
        *_bands(),
        *_sizes(),
        *_cameras(),
        *_sensors(),
        *_warm(),
    ]


def _saturated() -> list[Case]:
    found = []
    for line, voxel in LINES:
        scene = _line(line, voxel)
        found.append(Case(f"{line:g} GHz saturated at 50 degC", scene | DEEPEST, {"depth": DEPTH}))
        warm = scene | DEEPEST | {f"{FLUCTUATIONS}.temperature_sigma_k": 3.0}
        found.append(Case(f"{line:g} GHz saturated, 3 K of fluctuation", warm, WARM))
    cut = _line(556.936, 0.05) | {"background.max_range_m": 12.0}
    found.append(Case("ray cut off at a depth of 16", cut, {"passed": (judges.passed, NEGLIGIBLE)}))
    bright = {"background.temperature_k": 1e18, "background.max_range_m": 1700.0}
    found.append(
        Case(
            "1e18 K behind a depth of 38",
            bright,
            {"depth": DEPTH, "faint": (judges.faint, ROUNDED)},
        )
    )
    return found


def _line(line: float, voxel: float) -> dict[str, Any]:
    return {
        f"{AIR}.temperature_k": 323.15,
        f"{AIR}.relative_humidity_percent": 100.0,
        f"{FLUCTUATIONS}.voxel_m": voxel,
        "background.max_range_m": 60 * voxel,
        "sensor.frequency_ghz": line,
    }


def _contrasts() -> list[Case]:
    thin = {
        "sensor.frequency_ghz": 1.0,
        f"{AIR}.pressure_hpa": 5.0,
        f"{AIR}.relative_humidity_percent": 1.0,
        "background.max_range_m": 0.03,
        f"{FLUCTUATIONS}.voxel_m": 1e-3,
    }
    equal = {
        "background.temperature_k": 290.0,
        "ground.temperature_k": 290.0,
        "targets.wall": WALL | {"temperature_k": 290.0, "reflectivity": 0.3},
        f"{CAMERA}.pixels": [16, 12],
    }
    microkelvin = {"targets.wall": WALL | {"temperature_k": 290.000001}}
    clear = {"atmosphere.model": "none", "targets.wall": WALL | {"temperature_k": 290.000001}}
    walls = [
        Case(f"target of {k:g} K", {"targets.wall": WALL | {"temperature_k": k}}, EVERYTHING)
        for k in SOURCES
    ]
    return [
        Case("depth of 1e-12", thin, {"depth": DEPTH}),
        Case("contrast of 1 microkelvin", microkelvin, {"passed": (judges.passed, STORED)}),
        Case("contrast of 1 microkelvin in clear air", clear, {"kelvin": (judges.warmth, STORED)}),
        Case("target, ground and air equal", equal, {"contrast": (judges.nothing, NOTHING)}),
        *walls,
    ]


def _airs() -> list[Case]:
    wet = {f"{AIR}.temperature_k": 330.0, f"{AIR}.relative_humidity_percent": 100.0} | DEEPEST
    changes: dict[str, dict[str, Any]] = {
        "1 GHz": {
            "sensor.frequency_ghz": 1.0,
            "background.max_range_m": 3e4,
            f"{FLUCTUATIONS}.voxel_m": 400.0,
        },
        "1780 GHz": {
            "sensor.frequency_ghz": 1780.0,
            "background.max_range_m": 0.1,
            f"{FLUCTUATIONS}.voxel_m": 0.01,
        },
        "humidity 0": {f"{AIR}.relative_humidity_percent": 0.0},
        "sigma 0": {f"{FLUCTUATIONS}.sigma_percent": 0.0},
        "sigma 1e-6 %": {f"{FLUCTUATIONS}.sigma_percent": 1e-6},
        "sigma 100 %": {f"{FLUCTUATIONS}.sigma_percent": 100.0},
        "sigma 100 %, saturated at 330 K": wet | {f"{FLUCTUATIONS}.sigma_percent": 100.0},
        "supersaturated, 300 %": {f"{AIR}.relative_humidity_percent": 300.0},
        "pressure 1 hPa": {f"{AIR}.pressure_hpa": 1.0, f"{AIR}.relative_humidity_percent": 4.0},
        "pressure 1100 hPa": {f"{AIR}.pressure_hpa": 1100.0},
        "220 K": {f"{AIR}.temperature_k": 220.0},
        "330 K": {f"{AIR}.temperature_k": 330.0},
    }
    limited = wet | {f"{FLUCTUATIONS}.sigma_percent": 300.0}
    return [
        *(Case(name, scene, EVERYTHING) for name, scene in changes.items()),
        Case(
            "sigma 100 %, humidity lognormal",
            changes["sigma 100 %"],
            {"logarithm": (judges.lognormal, {SINGLE: 1e-6})},
        ),
        Case("sigma 300 %, vapour limited to the total pressure", limited, _within(FITTED)),
    ]


def _bands() -> list[Case]:
    judged: dict[str, Judged] = {
        "transmission": (judges.band_transmission, RESOLVED),
        "contrast": (judges.band_contrast, RESOLVED),
    }
    sensor = {"kind": "passive-broadband", "center_ghz": 550.0, "bandwidth_ghz": 100.0}
    even = {"sensor": sensor, f"{FLUCTUATIONS}.sigma_percent": 0.0, f"{CAMERA}.pixels": [1, 1]}
    thin = even | {
        f"{AIR}.pressure_hpa": 1.0,
        f"{AIR}.relative_humidity_percent": 4.0,
        "background.max_range_m": 1000.0,
    }
    gaussian = sensor | {"center_ghz": 556.936, "bandwidth_ghz": 30.0, "response": "gaussian"}
    told: dict[str, Judged] = {"depth": (judges.band_depth, ROUNDED)}
    return [
        Case("100 GHz band through a micrometre", even | {"background.max_range_m": 1e-6}, told),
        Case(
            "Gaussian band, clear at its edges only",
            even | {"sensor": gaussian, "background.max_range_m": 100.0} | DEEPEST,
            told,
        ),
        Case("100 GHz band at 1 hPa, lines of a few MHz", thin, judged),
        Case(
            "100 GHz band around a saturated line", even | {"background.max_range_m": 200.0}, judged
        ),
    ]


def _sizes() -> list[Case]:
    needle = {f"{CAMERA}.focal_plane_mm": [_plane(0.01), 0.001]}
    far = {
        "sensor.frequency_ghz": 1.0,
        "background.max_range_m": 1e5,
        f"{FLUCTUATIONS}.voxel_m": 1000.0,
    }
    fine = {"background.max_range_m": 10.0, f"{FLUCTUATIONS}.voxel_m": 1e-3}
    return [
        Case("100 km through voxels of 1 km", far, EVERYTHING),
        Case(
            "1 mm through voxels of 1 mm",
            {"background.max_range_m": 1e-3, f"{FLUCTUATIONS}.voxel_m": 1e-3},
            EVERYTHING,
        ),
        Case("10 m through voxels of 1 mm, field of view 0.01 deg", fine | needle, EVERYTHING),
        Case("grid 16", {f"{FLUCTUATIONS}.grid": 16}, EVERYTHING),
        Case("grid 256", {f"{FLUCTUATIONS}.grid": 256}, {"depth": (judges.depth, {SINGLE: 1e-6})}),
        Case("camera 1000 km from the origin", _moved(1234567.89), _within(FAR)),
    ]


def _plane(degrees: float) -> float:
    """Width of the focal plane, mm, behind 30 mm of focal length."""
    return 60 * math.tan(math.radians(degrees / 2))


def _moved(metres: float) -> dict[str, Any]:
    return {
        f"{CAMERA}.position_m": [metres, -metres, 2.1],
        f"{CAMERA}.look_at_m": [metres + 9, -metres + 3.6, 4.0],
    }


def _cameras() -> list[Case]:
    corner = {
        f"{CAMERA}.position_m": [2.8, 1.4, 2.1],  # whole multiples of the voxel
        f"{CAMERA}.pixels": [3, 3],
        f"{CAMERA}.up": [0.0, 0.6, 0.8],
        f"{FLUCTUATIONS}.grid_orientation": "aligned",
    }
    looks = {
        "along an axis": [10.5, 1.4, 2.1],
        "against an axis": [-10.5, 1.4, 2.1],
        "along a face's diagonal": [10.5, 9.1, 2.1],
        "along the cube's diagonal": [10.5, 9.1, 9.8],
        "straight up": [2.8, 1.4, 12.1],
    }
    found = [
        Case(f"from a voxel's corner {name}", corner | {f"{CAMERA}.look_at_m": look}, EVERYTHING)
        for name, look in looks.items()
    ]
    row = {f"{CAMERA}.pixels": [4096, 1], f"{CAMERA}.focal_plane_mm": [6.0, 0.01]}
    wide = {f"{CAMERA}.pixels": [16, 2], f"{CAMERA}.focal_plane_mm": [_plane(170.0), 0.001]}
    return [
        *found,
        Case("image of 1 x 1", {f"{CAMERA}.pixels": [1, 1]}, EVERYTHING),
        Case("image of 4096 x 1", row, _within({SINGLE: 1e-6})),
        Case("field of view 170 deg", wide, EVERYTHING),
    ]


def _sensors() -> list[Case]:
    active = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 200.0}
    mirror = {
        "targets.wall": WALL
        | {"reflectivity": 1.0, "center_m": [760.3, 0.0, 0.0], "size_m": [20.0, 2e3, 2e3]}
    }
    quiet = {
        "kind": "passive-broadband",
        "center_ghz": 650.0,
        "bandwidth_ghz": 100.0,
        "noise_equivalent_power_w_rthz": 0.0,
    }
    even = {
        "sensor": quiet,
        "background.temperature_k": 290.0,
    }  # at one temperature, whatever humidity does
    return [
        Case(
            "dynamic range 200 dB, out and back through a depth of 17",
            mirror | LEVEL | {"sensor": active, "background.max_range_m": 900.0},
            {"decibels": (judges.decibels, ROUNDED)},
        ),
        Case("NEP 0", even, {"noise": (judges.noise, NOTHING)}),
    ]


def _warm() -> list[Case]:
    fine = {
        "background.max_range_m": 10.0,
        f"{FLUCTUATIONS}.voxel_m": 1e-3,
        f"{FLUCTUATIONS}.temperature_sigma_k": 2.0,
    }
    tiny = {"background.temperature_k": 290.0, f"{FLUCTUATIONS}.temperature_sigma_k": 1e-4}
    thin = {
        "background.temperature_k": 290.0,
        "sensor.frequency_ghz": 1.0,
        f"{AIR}.pressure_hpa": 5.0,
        f"{AIR}.relative_humidity_percent": 1.0,
        "background.max_range_m": 0.03,
        f"{FLUCTUATIONS}.voxel_m": 1e-3,
        f"{FLUCTUATIONS}.temperature_sigma_k": 1.0,
    }
    wild = {f"{FLUCTUATIONS}.temperature_sigma_k": 20.0, f"{FLUCTUATIONS}.correlation_tq": 0.5}
    return [
        Case("temperature fluctuating by 20 K", wild, WARM),
        Case("temperature fluctuating by 0.1 mK", tiny, WARM),
        Case("temperature fluctuating, 10 m through voxels of 1 mm", fine, WARM),
        Case(
            "temperature fluctuating, depth of 1e-12",
            thin,
            {"depth": (judges.depth, EMITTED), "emitted": (judges.faintly_emitted, EMITTED)},
        ),
    ]
