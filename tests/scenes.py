"""Small scenes for the tests, as dictionaries that become TOML files."""

from __future__ import annotations

from copy import deepcopy

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


def scene(**changes):
    """PLAIN with dotted keys changed ("camera.pixels" as camera__pixels).

    None removes a key or table.
    """
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


def write(folder, data, name="scene"):
    """The data as TOML file."""
    file = folder / f"{name}.toml"
    file.write_text(dumps(data), encoding="utf-8")
    return file


def run(folder, data, **options):
    """The result of running the data."""
    return pipeline.run(write(folder, data), **options)
