"""Hygrometer records made for the tests: of known structure constant.

With what goes wrong in the field.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

RECORD = Path(__file__).parent / "data" / "hygrometer_20hz_2012-06-07_1245.dat"
# One-sided in cycles per metre; by Tatarskii's 0.1244 of the two-sided density in radians per
# metre.
FINER = 4  # a hygrometer takes points: what varies between them is folded into its spectrum
ONE_SIDED = (
    2 * math.gamma(5 / 3) * math.sin(math.pi / 3) / (2 * math.pi) * (2 * math.pi) ** (-2 / 3)
)


def signal(rng, samples, step_m, constant, outer_m):
    """A Gaussian signal (samples,) with a von Karman spectrum, cut from a longer, finer one.

    Not periodic, aliased.
    """
    long, step_m = 4 * FINER * samples, step_m / FINER
    frequency = np.fft.rfftfreq(long, step_m)
    density = ONE_SIDED * constant * (frequency**2 + outer_m**-2) ** (-5 / 6)
    density[0] = 0
    noise = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    return np.fft.irfft(noise * np.sqrt(density * long / step_m) / 2, long)[
        : samples * FINER : FINER
    ]


def write_csv(path, columns, missing=()):
    """A CSV with a header of columns (name to array), less the rows that are missing."""
    rows = np.delete(np.stack(list(columns.values()), axis=1), list(missing), axis=0)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.7g")
    return path


def synthetic(
    path,
    seed,
    samples=18000,
    constant=0.2,
    wind=3.0,
    rate=20.0,
    gaps=0.01,
    spikes=0.001,
    noise=0.01,
    outer_m=100.0,
):
    """Returns a CSV record with noise of the sensor (g/m3), gaps and spikes, and where they are.

    Where they are is told as two arrays of rows.
    """
    rng = np.random.default_rng(seed)
    humidity = (
        12
        + signal(rng, samples, wind / rate, constant, outer_m)
        + noise * rng.standard_normal(samples)
    )
    spoilt = 1 + rng.choice(samples - 2, round((gaps + spikes) * samples), replace=False)
    missing, spiky = np.split(spoilt, [round(gaps * samples)])
    humidity[spiky] += rng.choice([-1, 1], len(spiky)) * rng.uniform(3, 10, len(spiky))
    gusts = 0.1 * wind * rng.standard_normal((2, samples))
    columns = {
        "time_s": np.arange(samples) / rate,
        "h2o_g_m3": humidity,
        "Ux_m_s": 0.6 * wind + gusts[0],
        "Uy_m_s": 0.8 * wind + gusts[1],
    }
    return write_csv(path, columns, missing), missing, spiky
