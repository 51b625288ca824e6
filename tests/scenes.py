"""Small scenes for the tests, as dictionaries that become TOML files."""

from __future__ import annotations

from copy import deepcopy

import oracle

from thzcl import pipeline
from thzcl.scenario.text import dumps

PLAIN = {
    "camera": {
        "position_m": [1.0, -2.0, 4.0],
        "look_at_m": [30.0, 8.0, 1.0],
        "focal_length_mm": 30.0,
        "focal_plane_mm": [12.0, 9.0],
        "pixels": [16, 12],
    },
    "atmosphere": {
        "temperature_k": 290.0,
        "relative_humidity_percent": 70.0,
        "fluctuations": {"sigma_percent": 20.0, "voxel_m": 0.7, "grid": 32, "seed": 3},
    },
    "ground": {"temperature_k": 285.0, "reflectivity": 0.1},
    "targets": {
        "box": {
            "kind": "box",
            "center_m": [25.0, 7.0, 1.0],
            "size_m": [3.0, 4.0, 2.0],
            "yaw_deg": 30.0,
            "temperature_k": 300.0,
            "reflectivity": 0.2,
        }
    },
    "background": {"max_range_m": 90.0},
    "sensor": {"kind": "passive-spectral", "frequency_ghz": 650.0},
}

ACTIVE = {"kind": "active", "frequency_ghz": 650.0, "dynamic_range_db": 100.0}
BROAD = {"kind": "passive-broadband", "center_ghz": 650.0, "bandwidth_ghz": 100.0}
MOIST = {"temperature_k": 290.0, "relative_humidity_percent": 70.0}
DRIFTING = MOIST | {
    "fluctuations": PLAIN["atmosphere"]["fluctuations"] | {"wind_m_s": [2.0, 1.0, 0.0]}
}
MIRROR = {
    "kind": "box",
    "center_m": [41.0, 0.0, 1.2],
    "size_m": [2.0, 40.0, 40.0],
    "temperature_k": 300.0,
    "reflectivity": 1.0,
}


def scene(**changes):
    """Returns PLAIN with keys changed ("camera.pixels" as camera__pixels); None removes one."""
    data = deepcopy(PLAIN)
    for name, value in changes.items():
        *tables, last = name.split("__")
        node = data
        for table in tables:
            node = node.setdefault(table, {})
        if value is None:
            node.pop(last, None)
        else:
            node[last] = value
    return data


def lens(data):
    """Returns the oracle's camera of a scene."""
    camera = data["camera"]
    keys = ("position_m", "look_at_m", "focal_length_mm", "focal_plane_mm", "pixels")
    return oracle.Camera(*(camera[key] for key in keys), camera.get("up", (0, 0, 1)))


def write(folder, data, name="scene"):
    """Returns the path of a TOML file with the data."""
    file = folder / f"{name}.toml"
    file.write_text(dumps(data), encoding="utf-8")
    return file


def run(folder, data, **options):
    """Returns the result of running the data."""
    return pipeline.run(write(folder, data), **options)


def facing(distance, **changes):
    """Returns a scene of a wall across the line of sight, so far away, in uniform air."""
    wall = MIRROR | {"center_m": [distance + 1.0, 0.0, 1.2]}
    base = {
        "camera__position_m": [0.0, 0.0, 1.2],
        "camera__look_at_m": [40.0, 0.0, 1.2],
        "camera__pixels": [3, 3],
        "camera__focal_length_mm": 30000.0,
        "atmosphere__fluctuations": None,
        "ground": None,
        "targets": {"wall": wall},
    }
    return scene(**(base | changes))
