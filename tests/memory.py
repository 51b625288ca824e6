"""Peak memory of runs beside what their plans foretell.

`python tests/memory.py [NAME...]` runs scenes in processes of their own, and prints what the plan
says, the most that was resident, and whether that is at most 1.2 times the plan's and 200 MB.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
TIMES, BESIDE_MB = 1.2, 200.0
LONGEST_S = 280.0

BALL = """
[camera]
position_m = [-30, 0, 2]
look_at_m = [0, 0, 2]
focal_length_mm = 100
focal_plane_mm = [20, 20]
pixels = [400, 400]
[atmosphere]
temperature_k = 290
relative_humidity_percent = 50
[targets.ball]
kind = "mesh"
file = "ball.npz"
center_m = [0, 0, 2]
temperature_k = 300
material = "steel"
[background]
temperature_k = 280
[sensor]
kind = "passive-spectral"
frequency_ghz = [340, 650]
"""


def pixels(n: int) -> str:
    """Returns the setting of a square image."""
    return f"camera.pixels=[{n},{n}]"


BAND = 'sensor={kind="passive-broadband",center_ghz=650,bandwidth_ghz=60}'
WIND = "atmosphere.fluctuations.wind_m_s=[1,0,0]"
GRID = "atmosphere.fluctuations.grid="
SCENES: dict[str, tuple[str, ...]] = {
    "as shipped": ("slide",),
    "panels": ("figure6", pixels(700)),
    "many panels": ("figure7", pixels(150)),
    "large image": ("quick", pixels(1500)),
    "large cube": ("quick", pixels(64), f"{GRID}256"),
    "fluctuating temperature": (
        "quick",
        pixels(400),
        f"{GRID}256",
        "atmosphere.fluctuations.temperature_sigma_k=1",
        "sensor.frequency_ghz=[340,650,850]",
    ),
    "large scales": ("quick", pixels(1200), "atmosphere.fluctuations.large_scales=true"),
    "101 frequencies": (
        "quick",
        pixels(500),
        f"sensor.frequency_ghz={[600 + n for n in range(101)]}",
    ),
    "a band": (
        "quick",
        pixels(900),
        BAND,
    ),
    "float64": ("quick", pixels(900), 'numerics.precision="float64"'),
    "realisations": ("quick", pixels(1000), "numerics.realizations=5"),
    "compared models": ("quick", pixels(900), 'atmosphere.compare=["r24","p676-13"]'),
    "saved cube": ("quick", pixels(64), f"{GRID}256", "output.save_field=true"),
    "samples and optics": (
        "quick",
        pixels(500),
        "sensor.optics={aperture_m=0.3}", "camera.samples_per_pixel=4",
    ),
    "bistatic": ("figure8", pixels(400)),
    "speckle": ("active-noise", pixels(300)),
    "scan": ("raster", pixels(200)),
    "rain": ("rain", pixels(1000)),
    "rain's echo": ("rain-active", pixels(300)),
    "sky": ("outdoor", pixels(1000)),
    "mirrors": ("vehicle", pixels(500)),
    "mesh": ("ball.toml",),
    "sequence": ("quick", pixels(600), "sequence={rate_hz=10,frames=4}", WIND),
}  # fmt: skip


def ball(folder: Path) -> None:
    """Writes a scene with a ball of some 400,000 triangles."""
    n = 450
    around, up = np.meshgrid(np.linspace(0, 2 * np.pi, n), np.linspace(0, np.pi, n))
    points = np.stack([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)], -1)
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    faces = np.concatenate([np.stack(three, -1).reshape(-1, 3) for three in ((a, c, b), (b, c, d))])
    vertices, faces = points.reshape(-1, 3), faces[(faces[:, 0] >= 0)]
    np.savez(folder / "ball.npz", vertices=vertices, faces=faces)
    (folder / "ball.toml").write_text(BALL, encoding="utf-8")


def called(command: str, scene: str, *settings: str) -> list[str]:
    """Returns a command line."""
    options = [word for one in settings for word in ("--set", one)]
    return [sys.executable, "-m", "thzcl", command, scene, *options]


def measured(folder: Path, name: str) -> tuple[float, float]:
    """Returns what the plan of a scene says and what its run took at the most, MB."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    told = subprocess.run(
        [*called("plan", *SCENES[name]), "--format", "json"],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if told.returncode:
        raise SystemExit(f"{name}: {told.stderr}")
    command = [*called("run", *SCENES[name]), "-o", "out", "-q"]
    process = subprocess.Popen(command, cwd=folder, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{name}: exit {process.returncode}")
    return json.loads(told.stdout)["memory_bytes"] / 1e6, used.ru_maxrss * 1.024e-3


def main(names: list[str]) -> int:
    """Prints the memory of scenes; returns 1 if one took more than it may."""
    missed = 0
    with tempfile.TemporaryDirectory() as passing:
        folder = Path(passing)
        ball(folder)
        for name in names or SCENES:
            planned, taken = measured(folder, name)
            most = TIMES * planned + BESIDE_MB
            missed += taken > most
            word = "MORE" if taken > most else "fine"
            told = f"plan {planned:5.0f} MB, taken {taken:5.0f}, at most {most:5.0f}: {word}"
            print(f"{name:24} {told}", flush=True)
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
