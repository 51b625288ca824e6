"""The stress cases: deep, thin, cold, hot, wet and dry air, extreme surfaces, odd cameras.

Every bound is relative to a quantity that the case makes non-zero. The comments give its reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from thzcl.studies.stress import judges, things
from thzcl.studies.stress.trial import DOUBLE, SINGLE, Case, Judge

Judged = tuple[Judge, Mapping[str, float]]
Changes = dict[str, Any]

# A crossing of a voxel's face is accurate to one or two roundings of float32 (6e-8), and the errors
# of ten to ten thousand crossings add up at random.
ROUNDED = {SINGLE: 1e-6, DOUBLE: 1e-12}
# In float64 the polynomials of absorption in two variables limit the accuracy.
EMITTED = {SINGLE: 1e-6, DOUBLE: 1e-9}
# Humidity covers its whole range, so that the polynomial of degree 16 limits the accuracy.
FITTED = {SINGLE: 1e-6, DOUBLE: 1e-6}
# In float64 a coordinate of 1e6 m is accurate to 1e-10 m, and the path has a length of 30 m.
FAR = {SINGLE: 1e-6, DOUBLE: 1e-9}
# The contrast is 1e-6 K, and in float64 290.000001 K itself is accurate to 6e-14 K.
STORED = {SINGLE: 1e-6, DOUBLE: 1e-9}
# The tolerance of a band's quadrature, relative to what passes the path.
RESOLVED = {SINGLE: 1e-5}
# The sky's layers of 25 m and more limit it, to some 0.01 K.
LAYERED = {SINGLE: 5e-5}
# What lies behind the cut-off depth of 16 could add exp(-16).
NEGLIGIBLE = {SINGLE: 1.2e-7}
# A difference of equals is exactly zero.
NOTHING = {SINGLE: 0.0, DOUBLE: 0.0}

AIR, FLUCTUATIONS, CAMERA, BACKGROUND = (
    "atmosphere",
    "atmosphere.fluctuations",
    "camera",
    "background",
)
DEEPEST = {"numerics.cutoff_depth": 1e9}  # no cut-off at all
# Centres of water lines in GHz, and edges of voxels in m, 60 of which have a depth of 10 or more.
LINES = ((183.31, 500.0), (556.936, 5.0), (752.033, 5.0), (987.927, 5.0))
SOURCES_K = (0.0, 2.7, 3000.0, 1e6, 1e18)
WALL = {
    "kind": "box",
    "center_m": [30.3, 0.0, 0.0],
    "size_m": [20.0, 200.0, 200.0],
    "temperature_k": 310.0,
}


def _within(bounds: Mapping[str, float]) -> dict[str, Judged]:
    """Returns the judges of depth and contrast in isothermal air, both with the same bounds."""
    return {"depth": (judges.depth, bounds), "passed": (judges.passed, bounds)}


DEPTH: dict[str, Judged] = {"depth": (judges.depth, ROUNDED)}
EVERYTHING = _within(ROUNDED)
WARM: dict[str, Judged] = {
    "depth": (judges.depth, EMITTED),
    "emitted": (judges.emitted, EMITTED),
    "outside": (judges.outside, NOTHING),
}


def cases() -> list[Case]:
    """Returns every case, in the order of the table."""
    return [
        *_saturated(),
        *_contrasts(),
        *_airs(),
        *_bands(),
        *_sizes(),
        *_cameras(),
        *_sensors(),
        *_warm(),
        *_skies(),
        *_things(),
    ]


def _saturated() -> list[Case]:
    """Returns the cases at the centres of water lines in saturated air, and of cut-off rays."""
    listed = []
    for line, voxel_m in LINES:
        scene = _line(line, voxel_m) | DEEPEST
        warm = scene | {f"{FLUCTUATIONS}.temperature_sigma_k": 3.0}
        listed.append(Case(f"{line:g} GHz saturated at 50 degC", scene, DEPTH))
        listed.append(Case(f"{line:g} GHz saturated, 3 K of fluctuation", warm, WARM))
    cut = _line(556.936, 0.05) | {f"{BACKGROUND}.max_range_m": 12.0}
    bright = {f"{BACKGROUND}.temperature_k": 1e18, f"{BACKGROUND}.max_range_m": 1700.0}
    past: dict[str, Judged] = {"passed": (judges.passed, NEGLIGIBLE)}
    faint = DEPTH | {"faint": (judges.faint, ROUNDED)}
    return [
        *listed,
        Case("ray cut off at a depth of 16", cut, past),
        Case("1e18 K behind a depth of 38", bright, faint),
    ]


def _line(line_ghz: float, voxel_m: float) -> Changes:
    """Returns the changes for a line in saturated air at 50 degC, through voxels of `voxel_m`."""
    return {
        f"{AIR}.temperature_k": 323.15,
        f"{AIR}.relative_humidity_percent": 100.0,
        f"{FLUCTUATIONS}.voxel_m": voxel_m,
        f"{BACKGROUND}.max_range_m": 60 * voxel_m,
        "sensor.frequency_ghz": line_ghz,
    }


THIN = {
    "sensor.frequency_ghz": 1.0,
    f"{AIR}.pressure_hpa": 5.0,
    f"{AIR}.relative_humidity_percent": 1.0,
    f"{BACKGROUND}.max_range_m": 0.03,
    f"{FLUCTUATIONS}.voxel_m": 1e-3,
}


def _contrasts() -> list[Case]:
    """Returns the cases of tiny, vanishing and enormous contrasts."""
    equal = {
        f"{BACKGROUND}.temperature_k": 290.0,
        "ground.temperature_k": 290.0,
        "targets.wall": WALL | {"temperature_k": 290.0, "reflectivity": 0.3},
        f"{CAMERA}.pixels": [16, 12],
    }
    microkelvin = {"targets.wall": WALL | {"temperature_k": 290.000001}}
    clear = microkelvin | {f"{AIR}.model": "none"}
    walls = {k: {"targets.wall": WALL | {"temperature_k": k}} for k in SOURCES_K}
    downpour = {f"{AIR}.rain": {"rate_mm_h": 300.0, "temperature_k": 290.0}}
    dense = {f"{AIR}.fog": {"liquid_water_g_m3": 5.0}}
    still = (judges.nothing, NOTHING)
    return [
        Case("depth of 1e-12", THIN, DEPTH),
        Case("contrast of 1 microkelvin", microkelvin, {"passed": (judges.passed, STORED)}),
        Case("contrast of 1 microkelvin in clear air", clear, {"kelvin": (judges.warmth, STORED)}),
        Case("rain of 300 mm/h as warm as all else", equal | downpour, {"contrast": still}),
        Case("depth of fog of 5 g/m3", dense, DEPTH),
        Case("target, ground and air equal", equal, {"contrast": (judges.nothing, NOTHING)}),
        *(Case(f"target of {k:g} K", scene, EVERYTHING) for k, scene in walls.items()),
    ]


def _airs() -> list[Case]:
    """Returns the cases of extreme frequencies, humidities, pressures and temperatures."""
    wild = {f"{FLUCTUATIONS}.sigma_percent": 100.0}
    wet = {f"{AIR}.temperature_k": 330.0, f"{AIR}.relative_humidity_percent": 100.0} | DEEPEST
    limited = wet | {f"{FLUCTUATIONS}.sigma_percent": 300.0}
    low = {
        "sensor.frequency_ghz": 1.0,
        f"{BACKGROUND}.max_range_m": 3e4,
        f"{FLUCTUATIONS}.voxel_m": 400.0,
    }
    high = {
        "sensor.frequency_ghz": 1780.0,
        f"{BACKGROUND}.max_range_m": 0.1,
        f"{FLUCTUATIONS}.voxel_m": 0.01,
    }
    changes: dict[str, Changes] = {
        "1 GHz": low,
        "1780 GHz": high,
        "humidity 0": {f"{AIR}.relative_humidity_percent": 0.0},
        "sigma 0": {f"{FLUCTUATIONS}.sigma_percent": 0.0},
        "sigma 1e-6 %": {f"{FLUCTUATIONS}.sigma_percent": 1e-6},
        "sigma 100 %": wild,
        "sigma 100 %, saturated at 330 K": wet | wild,
        "supersaturated, 300 %": {f"{AIR}.relative_humidity_percent": 300.0},
        "pressure 1 hPa": {f"{AIR}.pressure_hpa": 1.0, f"{AIR}.relative_humidity_percent": 4.0},
        "pressure 1100 hPa": {f"{AIR}.pressure_hpa": 1100.0},
        "220 K": {f"{AIR}.temperature_k": 220.0},
        "330 K": {f"{AIR}.temperature_k": 330.0},
    }
    logarithm: dict[str, Judged] = {"logarithm": (judges.lognormal, {SINGLE: 1e-6})}
    return [
        *(Case(name, scene, EVERYTHING) for name, scene in changes.items()),
        Case("sigma 100 %, humidity lognormal", wild, logarithm),
        Case("sigma 300 %, vapour limited to the total pressure", limited, _within(FITTED)),
    ]


def _bands() -> list[Case]:
    """Returns the cases of broad bands with narrow or saturated lines."""
    summed: dict[str, Judged] = {
        "transmission": (judges.band_transmission, RESOLVED),
        "contrast": (judges.band_contrast, RESOLVED),
    }
    depth: dict[str, Judged] = {"depth": (judges.band_depth, ROUNDED)}
    sensor = {"kind": "passive-broadband", "center_ghz": 550.0, "bandwidth_ghz": 100.0}
    gaussian = sensor | {"center_ghz": 556.936, "bandwidth_ghz": 30.0, "response": "gaussian"}
    even = {"sensor": sensor, f"{FLUCTUATIONS}.sigma_percent": 0.0, f"{CAMERA}.pixels": [1, 1]}
    through = {metres: even | {f"{BACKGROUND}.max_range_m": metres} for metres in (1e-6, 200.0)}
    edges = even | {"sensor": gaussian, f"{BACKGROUND}.max_range_m": 100.0} | DEEPEST
    narrow = even | {
        f"{AIR}.pressure_hpa": 1.0,
        f"{AIR}.relative_humidity_percent": 4.0,
        f"{BACKGROUND}.max_range_m": 1000.0,
    }
    return [
        Case("100 GHz band through a micrometre", through[1e-6], depth),
        Case("Gaussian band, clear at its edges only", edges, depth),
        Case("100 GHz band at 1 hPa, lines of a few MHz", narrow, summed),
        Case("100 GHz band around a saturated line", through[200.0], summed),
    ]


FINE = {f"{BACKGROUND}.max_range_m": 10.0, f"{FLUCTUATIONS}.voxel_m": 1e-3}


def _sizes() -> list[Case]:
    """Returns the cases of very small and very large voxels, cubes, ranges and coordinates."""
    needle = FINE | {f"{CAMERA}.focal_plane_mm": [_plane_mm(0.01), 0.001]}
    short = {f"{BACKGROUND}.max_range_m": 1e-3, f"{FLUCTUATIONS}.voxel_m": 1e-3}
    far = {
        "sensor.frequency_ghz": 1.0,
        f"{BACKGROUND}.max_range_m": 1e5,
        f"{FLUCTUATIONS}.voxel_m": 1000.0,
    }
    away = 1234567.89
    moved = {
        f"{CAMERA}.position_m": [away, -away, 2.1],
        f"{CAMERA}.look_at_m": [away + 9, -away + 3.6, 4.0],
    }
    small, large = ({f"{FLUCTUATIONS}.grid": grid} for grid in (16, 256))
    return [
        Case("100 km through voxels of 1 km", far, EVERYTHING),
        Case("1 mm through voxels of 1 mm", short, EVERYTHING),
        Case("10 m through voxels of 1 mm, field of view 0.01 deg", needle, EVERYTHING),
        Case("grid 16", small, EVERYTHING),
        Case("grid 256", large, {"depth": (judges.depth, {SINGLE: 1e-6})}),
        Case("camera 1000 km from the origin", moved, _within(FAR)),
    ]


def _plane_mm(degrees: float) -> float:
    """Returns the width in mm of the focal plane that has a field of view of `degrees`.

    The focal length is the 30 mm of the base scene.
    """
    return 60 * math.tan(math.radians(degrees / 2))


def _cameras() -> list[Case]:
    """Returns the cases of rays along voxel faces, and of extreme images and fields of view."""
    corner = {
        f"{CAMERA}.position_m": [2.8, 1.4, 2.8],  # whole multiples of the voxel, exactly
        f"{CAMERA}.pixels": [3, 3],
        f"{CAMERA}.up": [0.0, 0.6, 0.8],
        f"{FLUCTUATIONS}.grid_orientation": "aligned",
    }
    look_at_m = {
        "along an axis": [10.5, 1.4, 2.8],
        "against an axis": [-10.5, 1.4, 2.8],
        "along a face's diagonal": [10.5, 9.1, 2.8],
        "along the cube's diagonal": [10.5, 9.1, 10.5],
        "straight up": [2.8, 1.4, 12.8],
    }
    looks = {name: corner | {f"{CAMERA}.look_at_m": point} for name, point in look_at_m.items()}
    row = {f"{CAMERA}.pixels": [4096, 1], f"{CAMERA}.focal_plane_mm": [6.0, 0.01]}
    wide = {f"{CAMERA}.pixels": [16, 2], f"{CAMERA}.focal_plane_mm": [_plane_mm(170.0), 0.001]}
    return [
        *(Case(f"from a voxel's corner {name}", look, EVERYTHING) for name, look in looks.items()),
        Case("image of 1 x 1", {f"{CAMERA}.pixels": [1, 1]}, EVERYTHING),
        Case("image of 4096 x 1", row, _within({SINGLE: 1e-6})),
        Case("field of view 170 deg", wide, EVERYTHING),
    ]


def _sensors() -> list[Case]:
    """Returns the cases of an extreme dynamic range and of a noiseless detector."""
    mirror = {"reflectivity": 1.0, "center_m": [760.3, 0.0, 0.0], "size_m": [20.0, 2e3, 2e3]}
    echoes = {
        f"{CAMERA}.position_m": [0.3, -0.2, 2.1],
        f"{CAMERA}.look_at_m": [9.3, -0.2, 2.1],
        f"{BACKGROUND}.max_range_m": 900.0,
        "targets.wall": WALL | mirror,
        "sensor": {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 200.0},
    }
    quiet = {
        "kind": "passive-broadband",
        "center_ghz": 650.0,
        "bandwidth_ghz": 100.0,
        "noise_equivalent_power_w_rthz": 0.0,
    }
    # If everything has one temperature, the image is even, however humidity varies.
    even = {"sensor": quiet, f"{BACKGROUND}.temperature_k": 290.0}
    deep = "dynamic range 200 dB, out and back through a depth of 17"
    return [
        Case(deep, echoes, {"decibels": (judges.decibels, ROUNDED)}),
        Case("NEP 0", even, {"noise": (judges.noise, NOTHING)}),
    ]


def _warm() -> list[Case]:
    """Returns the cases of air whose temperature fluctuates."""
    level = {f"{BACKGROUND}.temperature_k": 290.0}
    by = {k: {f"{FLUCTUATIONS}.temperature_sigma_k": k} for k in (1e-4, 1.0, 2.0, 20.0)}
    wild = by[20.0] | {f"{FLUCTUATIONS}.correlation_tq": 0.5}
    faint: dict[str, Judged] = {
        "depth": (judges.depth, EMITTED),
        "emitted": (judges.faintly_emitted, EMITTED),
    }
    return [
        Case("temperature fluctuating by 20 K", wild, WARM),
        Case("temperature fluctuating by 0.1 mK", level | by[1e-4], WARM),
        Case("temperature fluctuating, 10 m through voxels of 1 mm", FINE | by[2.0], WARM),
        Case("temperature fluctuating, depth of 1e-12", THIN | level | by[1.0], faint),
    ]


def _skies() -> list[Case]:
    """Returns the cases of the sky, which layers of 25 m and look-ups limit."""
    clear = {
        "sky.profile": "us-standard",
        f"{BACKGROUND}.temperature_k": None,
        f"{BACKGROUND}.max_range_m": 200.0,
        "sensor.frequency_ghz": [94.0, 220.0],
        f"{FLUCTUATIONS}.voxel_m": 5.0,
    }
    dry = {"sky.profile": "subarctic-winter", f"{AIR}.temperature_k": 257.2}
    dry[f"{AIR}.relative_humidity_percent"] = 5.0
    horizon = {f"{CAMERA}.look_at_m": [9.3, -0.2, 2.15], f"{BACKGROUND}.max_range_m": 1e5}
    horizon[f"{CAMERA}.focal_plane_mm"] = [6.0, 0.2]
    wall = {"targets.wall": WALL | {"reflectivity": 0.5}, f"{BACKGROUND}.environment": "sky"}
    seen: dict[str, Judged] = {
        "depth": (judges.depth, {SINGLE: 1e-6}),
        "sky": (judges.sky, LAYERED),
    }
    return [
        Case("clear sky behind turbulent air", clear, seen),
        Case("sky of dry arctic air with an inversion", clear | dry, seen),
        Case("sky at the horizon, rays of a hundred kilometres", clear | horizon, seen),
        Case("wall that reflects half of the sky", clear | wall, seen),
        Case("sky behind air of fluctuating temperature", clear | _BY_A_KELVIN, seen),
    ]


MATERIAL, COVER = "materials.it", "targets.wall.cover"
# Near grazing angles the look-up of what metal reflects by the cosine limits it.
LOOKED_UP = {SINGLE: 4e-6}


def _things() -> list[Case]:
    """Returns the cases of materials, covers, mirrors and meshes."""
    seen: dict[str, Judged] = {"seen": (judges.sky, {SINGLE: 1e-6})}
    looked_up: dict[str, Judged] = {"seen": (judges.sky, LOOKED_UP)}
    calm = {f"{FLUCTUATIONS}.sigma_percent": 0.0, f"{BACKGROUND}.environment": 100.0}
    wall = calm | {"targets.wall": WALL | {"material": "it"}, "numerics.bounces": 0}
    grazing = calm | {
        f"{CAMERA}.look_at_m": [9.3, -0.2, 2.09],
        f"{CAMERA}.focal_plane_mm": [6.0, 0.04],
        f"{BACKGROUND}.max_range_m": 1e5,
        "sensor.frequency_ghz": 20.0,
        "ground": {"temperature_k": 300.0, "material": "it"},
    }
    below = calm | {
        f"{CAMERA}.look_at_m": [9.3, -0.2, 0.0],
        f"{CAMERA}.focal_plane_mm": [6.0, 1.0],
        "targets.wall": WALL,
        "ground": {"temperature_k": 300.0, "material": "it"},
        f"{MATERIAL}.reflectivity": 0.9,
        "numerics.bounces": 1,
    }
    metal, dielectric = {f"{MATERIAL}.permittivity": [1.0, 1e6]}, [4.0, 0.5]
    thick = {COVER: {"transmission": 1e-3, "reflectivity": 0.99, "temperature_k": 280.0}}
    thin = {COVER: {"transmission": 0.9999, "reflectivity": 1e-6, "temperature_k": 400.0}}
    level = {"temperature_k": 290.0, "material": "it"}
    equal = below | {
        "targets.wall": WALL | level,
        "ground": level,
        f"{COVER}": {"transmission": 0.3, "reflectivity": 0.4, "temperature_k": 290.0},
        f"{BACKGROUND}.environment": 290.0,
        f"{BACKGROUND}.temperature_k": 290.0,
    }
    mesh = {"kind": "mesh", "file": things.WALL_FILE, "temperature_k": 310.0}
    edges = {
        f"{CAMERA}.position_m": [0.0, 0.0, 0.0],
        f"{CAMERA}.look_at_m": [9.0, 0.0, 0.0],
        f"{CAMERA}.pixels": [33, 33],  # a ray through every other edge, and through vertices
        f"{CAMERA}.focal_plane_mm": [33 * 30.0 / 16, 33 * 30.0 / 16],
        f"{BACKGROUND}.max_range_m": 100.0,
        "targets.wall": mesh | {"center_m": [24.0, 0.0, 0.0], "scale": 32.0},
    }
    return [
        Case("ground at grazing angles", grazing | {f"{MATERIAL}.permittivity": dielectric}, seen),
        Case("metal ground at grazing angles", grazing | metal, looked_up),
        Case("cover over metal, both of which reflect most", wall | metal | thick, seen),
        Case("cover that takes a ten-thousandth", wall | metal | thin, seen),
        Case("wall seen in the ground", below, seen),
        Case(
            "materials, cover, bounce and air equal", equal, {"contrast": (judges.nothing, NOTHING)}
        ),
        Case("mesh whose edges and vertices lie on rays", edges, EVERYTHING),
    ]


_BY_A_KELVIN = {f"{FLUCTUATIONS}.temperature_sigma_k": 1.0}
