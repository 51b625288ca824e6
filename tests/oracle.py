"""Slow float64 twins of air, cubes, rays, boxes and what reaches the camera, written for clarity.

They share no code with the package, and leave bands, optics, billboards and echoes to tests of
their own. Sources: Liebe, Hufford and Cotton (1993), ITU-R P.676-13 and
Rosenkranz (2024, doi:10.21982/M81013) for absorption; Planck's law; O'Brien and Tofsted's equation
(2) for the radiance at the camera; plain geometry for the rest.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

TABLES = Path(__file__).parents[1] / "thzcl" / "air" / "constituents"
H, K, C = 6.62607015e-34, 1.380649e-23, 299792458.0


# --- absorption
# ------------------------------------------------------------------------------------------


@cache
def lines(name):
    with (TABLES / name).open(newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    return [[float(cell) for cell in row] for row in rows[1:]]


OXYGEN, WATER = lines("mpm93_oxygen_lines.csv"), lines("mpm93_water_lines.csv")


def attenuation_db_km(f, kelvin, pressure, e, corrected=False):
    """(dry, vapour) in dB/km: GHz, K, hPa in all, hPa of vapour; numbers or arrays."""
    theta, p = 300 / kelvin, pressure - e
    oxygen = 0.0
    for f0, a1, a2, a3, a4, a5, a6 in OXYGEN:
        s = 1e-6 * a1 / f0 * p * theta**3 * np.exp(a2 * (1 - theta))
        g = np.hypot(1e-3 * a3 * (p * theta ** (0.8 - a4) + 1.1 * e * theta), 25 * 0.6e-4)
        d = 1e-3 * (a5 + a6 * theta) * (p + e) * theta**0.8
        oxygen = oxygen + s * f * (
            (g - (f0 - f) * d) / ((f0 - f) ** 2 + g * g)
            + (g - (f0 + f) * d) / ((f0 + f) ** 2 + g * g)
        )
    g0 = 0.56e-3 * (p + e) * theta**0.8
    dry = np.maximum(oxygen, 0.0)
    dry = dry + 6.14e-5 * p * theta**2 * f * g0 / (f * f + g0 * g0)
    dry = dry + 1.40e-12 * p * p * theta**3.5 * f / (1 + 1.93e-5 * f**1.5)
    vapour = 0.0
    for f0, b1, b2, b3, b4, b5, b6 in WATER:
        abundance = {547.68: 0.00199983, 552.02: 0.000372}.get(round(f0, 2)) if corrected else None
        s = (
            (48.74 * abundance if abundance else b1)
            / f0
            * e
            * theta**3.5
            * np.exp(b2 * (1 - theta))
        )
        g = 1e-3 * b3 * (b4 * e * theta**b6 + p * theta**b5)
        if pressure < 0.7:
            g = 0.535 * g + np.sqrt(0.217 * g * g + (1.46e-6 * f0) ** 2 / theta)
        vapour = vapour + s * f * g * (1 / ((f0 - f) ** 2 + g * g) + 1 / ((f0 + f) ** 2 + g * g))
    return 0.1820 * f * dry, 0.1820 * f * vapour


def p676_db_km(f, kelvin, pressure, e):
    """(dry, vapour) in dB/km by ITU-R P.676-13, Annex 1; numbers or arrays."""
    h, p = 300 / kelvin, pressure - e

    def shape(f0, w, q):
        near = (w - q * (f0 - f)) / ((f0 - f) ** 2 + w * w)
        return f / f0 * (near + (w - q * (f0 + f)) / ((f0 + f) ** 2 + w * w))

    d = 5.6e-4 * (p + e) * h**0.8
    dry = 6.14e-5 / (d * (1 + (f / d) ** 2)) + 1.4e-12 * p * h**1.5 / (1 + 1.9e-5 * f**1.5)
    dry = f * p * h**2 * dry
    for f0, a1, a2, a3, a4, a5, a6 in lines("p676_13_oxygen_lines.csv"):
        w = np.hypot(1e-4 * a3 * (p * h ** (0.8 - a4) + 1.1 * e * h), 1.5e-3)
        q = 1e-4 * (a5 + a6 * h) * (p + e) * h**0.8
        dry = dry + 1e-7 * a1 * p * h**3 * np.exp(a2 * (1 - h)) * shape(f0, w, q)
    vapour = 0.0
    for f0, b1, b2, b3, b4, b5, b6 in lines("p676_13_water_lines.csv"):
        w = 1e-4 * b3 * (p * h**b4 + b5 * e * h**b6)
        w = 0.535 * w + np.sqrt(0.217 * w * w + 2.1316e-12 * f0**2 / h)
        vapour = vapour + 0.1 * b1 * e * h**3.5 * np.exp(b2 * (1 - h)) * shape(f0, w, 0.0)
    return 0.1820 * f * dry, 0.1820 * f * vapour


def by_speed(z, v):
    """The mean of 1 / (z + v x^2) over Maxwell's distribution of speeds x, by the trapezoid rule.

    That is 2 [1 - sqrt(pi) y w(iy)] / v with y = sqrt(z / v) and Faddeeva's w.
    """
    step = 1 / 64
    x = np.arange(step, 8, step)
    return 4 / math.sqrt(math.pi) * step * np.sum(x**2 * np.exp(-(x**2)) / (z + v * x**2))


def r24_db_km(f, kelvin, pressure, e):
    """(dry, vapour) in dB/km by Rosenkranz (2024); numbers alone."""
    rho = 18.01528 * e / (0.0831451 * kelvin)
    water = _r24_water(f, kelvin, pressure, 4.6152e-3 * rho * kelvin, rho)
    oxygen = _r24_oxygen(f, kelvin, pressure, 4.615228e-3 * rho * kelvin)
    nitrogen = 9.95e-14 * (pressure - e) ** 2 * f * f * (300 / kelvin) ** 3.22
    nitrogen *= (1 + 1 / (1 + (f / 450) ** 2)) / 2
    return 4.342944819 * (oxygen + nitrogen), 4.342944819 * water


def _r24_water(f, kelvin, pressure, e, rho):
    h, p = 296 / kelvin, pressure - e
    log, total = math.log(h), 0.0
    for row in lines("r24_water_lines.csv"):
        f0, s, b, wa, xwa, ws, xws, da, xda, ds, xds, aa, as_, va, xva, vs, xvs, ca, cs = row
        w0 = 1e-3 * (wa * p * h**xwa + ws * e * h**xws)
        w2 = 1e-3 * (va * p * h**xva + vs * e * h**xvs)
        d0 = da * p * (1 - aa * log) * h**xda + ds * e * (1 - as_ * log) * h**xds
        d0, d2 = 1e-3 * d0, 1e-3 * (ca * p + cs * e)
        for away in (f - f0 - d0, f + f0 + d0):
            if abs(away) >= 750:
                continue
            profile = w0 / (away**2 + w0**2)
            if va > 0 and away == f - f0 - d0 and abs(away) < 10 * w0:
                z = complex(w0 - 1.5 * w2, away + 1.5 * d2)
                profile = by_speed(z, complex(w2, -d2)).real
            profile -= w0 / (750**2 + w0**2)
            total += s * h**2.5 * math.exp(b * (1 - h)) * profile * (f / f0) ** 2
    nodes = [6.532e12 * c * h ** (n + 3) for _, c, n in lines("r24_water_self_continuum.csv")]
    j = min(int(f / 299.792458), 3)
    t, before = f / 299.792458 - j, nodes[abs(j - 1)]
    c = nodes[j] + t / 2 * (nodes[j + 1] - before)
    c += t**2 * (before - 2.5 * nodes[j] + 2 * nodes[j + 1] - nodes[j + 2] / 2)
    c += t**3 * (-before / 2 + 1.5 * nodes[j] - 1.5 * nodes[j + 1] + nodes[j + 2] / 2)
    continuum = (5.547e-10 * h**3 * p + c * e) * e * f * f
    return 1e-10 * rho / (2.9915075e-23 * math.pi) * total + continuum


def _r24_oxygen(f, kelvin, pressure, e):
    h, p = 300 / kelvin, pressure - e
    k, q, table = h - 1, 1e-3 * (p * h**0.754 + 1.2 * e * h), lines("r24_oxygen_lines.csv")
    a = [s * math.exp(-be * k) * h / f0**2 for f0, s, be, *_ in table]
    y = [0.99 * (row[4] + row[5] * k) for row in table]
    g = [row[6] + row[7] * k for row in table]
    band = range(1, 38)
    number = sum(a[i] for i in band)
    m = sum(a[i] * g[i] for i in band) / sum(a[i] ** 2 for i in band)
    bias = 0.56 * 1.584e-17 / 2
    bias += sum(a[i] * (table[i][3] + y[i] * table[i][0]) for i in range(38))
    u = 0.56 * q
    total = 1.584e-17 * u / (f * f + u * u)
    for i, (f0, _, _, w, *_, nu0, nu1) in enumerate(table):
        mixed = i in band
        first = q * (y[i] - (bias / (number * f0) if mixed else 0.0))
        second = 1 + q * q * (g[i] - a[i] * m if mixed else 0.0)
        width, center = w * q, f0 + q * q * (nu0 + nu1 * k)
        near = (width * second + (f - center) * first) / ((f - center) ** 2 + width**2)
        if i == 0 and abs(f - center) < 10 * width:
            v = 0.076 * width
            z = complex(width - 1.5 * v, f - center)
            near = (complex(1, first) * by_speed(z, v)).real
        far = (width * second - (f + center) * first) / ((f + center) ** 2 + width**2)
        total += a[i] * (near + far)
    return 1.6097e11 * p * (f * h) ** 2 * total


GASES = {"mpm93": attenuation_db_km, "p676-13": p676_db_km, "r24": r24_db_km}


def saturation_hpa(kelvin):
    theta = 300 / kelvin
    return 2.408e11 * theta**5 * math.exp(-22.644 * theta)


def absorption_per_m(frequency_hz, kelvin, pressure, grams, model="mpm93"):
    """1/m of air that holds so many g/m3 of vapour, which cannot be more than there is pressure.

    Numbers or arrays.
    """
    e = np.minimum(grams * 1e-3 * 461.525 * kelvin / 100, pressure)
    gas = np.vectorize(r24_db_km) if model == "r24" else GASES[model]
    return sum(gas(frequency_hz / 1e9, kelvin, pressure, e)) / (1e4 / math.log(10))


# --- radiance
# ------------------------------------------------------------------------------------------


def planck(frequency_hz, kelvin):
    if kelvin == 0:
        return 0.0
    x = H * frequency_hz / (K * kelvin)
    return 0.0 if x > 700 else 2 * H * frequency_hz**3 / C**2 / math.expm1(x)


def brightness_temperature(frequency_hz, radiance):
    return H * frequency_hz / K / math.log1p(2 * H * frequency_hz**3 / C**2 / radiance)


# --- geometry
# ------------------------------------------------------------------------------------------


@dataclass
class Camera:
    position: tuple
    look_at: tuple
    focal: float
    plane: tuple
    pixels: tuple
    up: tuple = (0, 0, 1)

    def ray(self, row, column):
        """Unit direction through the centre of a pixel, or through fractions of one."""
        position, look_at = np.array(self.position, float), np.array(self.look_at, float)
        forward = (look_at - position) / math.dist(look_at, position)
        right = np.cross(forward, self.up)
        right = right / math.sqrt(right @ right)
        up = np.cross(right, forward)
        (w, h), (nx, ny) = self.plane, self.pixels
        x, y = ((column + 0.5) / nx - 0.5) * w, (0.5 - (row + 0.5) / ny) * h
        direction = self.focal * forward + x * right + y * up
        return direction / math.sqrt(direction @ direction)


@dataclass
class Box:
    center: tuple
    size: tuple
    yaw: float = 0.0

    def meet(self, origin, direction):
        """Distance to the first face met, its axis and sign, or None. From inside.

        The face by which the ray leaves.
        """
        c, s = math.cos(math.radians(self.yaw)), math.sin(math.radians(self.yaw))
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        o, d = turn @ (origin - np.array(self.center)), turn @ direction
        best = None
        for axis in range(3):
            for sign in (-1, 1):
                if d[axis] == 0:
                    continue
                t = (sign * self.size[axis] / 2 - o[axis]) / d[axis]
                point = o + t * d
                others = [k for k in range(3) if k != axis]
                on_face = all(abs(point[k]) <= self.size[k] / 2 * (1 + 1e-13) for k in others)
                if t > 0 and on_face and (best is None or t < best[0]):
                    best = (t, axis, sign, point)
        return best


def stripe(box, hit, count):
    """Number of the stripe at a hit.

    From the left as seen from outside with z up (x to the right on top).
    """
    _, axis, sign, point = hit
    normal = np.zeros(3)
    normal[axis] = sign
    # Looking at the face, along -normal.
    rightward = np.array([sign, 0, 0]) if axis == 2 else np.cross(-normal, (0, 0, 1))
    k = int(np.argmax(np.abs(rightward)))
    fraction = (point[k] * rightward[k] + box.size[k] / 2) / box.size[k]
    return min(max(int(fraction * count), 0), count - 1)


# --- paths
# ------------------------------------------------------------------------------------------


def segments(origin, direction, length, n):
    """Returns each voxel crossed (x, y, z) of a periodic cube of n voxels an edge, and its length.

    All are in voxel units. Every crossing of every face is listed and sorted, so that nothing is
    accumulated; a ray in a face belongs to [i, i + 1).
    """
    cuts = [np.array([0.0, length])]
    for o, d in zip(origin, direction, strict=True):
        if d != 0:
            first, last = sorted((o, o + d * length))
            planes = np.arange(math.floor(first), math.ceil(last) + 1)
            cuts.append((planes - o) / d)
    t = np.unique(np.concatenate(cuts))
    t = t[(t >= 0) & (t <= length)]
    middles = (t[1:] + t[:-1]) / 2
    cells = np.floor(np.asarray(origin) + middles[:, None] * np.asarray(direction)).astype(int)
    # Along a direction of exactly 0 the middle lies where the origin does.
    return cells % n, np.diff(t)


def path(cube, origin, direction, length_m, voxel_m, rotation):
    """Values of a cube [z, y, x] along a ray of the world, and the metres spent in each."""
    n = cube.shape[0]
    o = np.mod(rotation @ np.asarray(origin) / voxel_m, n)
    cells, lengths = segments(o, rotation @ direction, length_m / voxel_m, n)
    return cube[cells[:, 2], cells[:, 1], cells[:, 0]], lengths * voxel_m


def transfer(absorption, metres, source, surface):
    """Equation (2): radiance at the camera, from the absorption.

    Length and Planck radiance of each segment, camera first.
    """
    radiance, transmission = 0.0, 1.0
    for k, ds, j in zip(absorption, metres, source, strict=True):
        radiance += transmission * j * -math.expm1(-k * ds)
        transmission *= math.exp(-k * ds)
    return radiance + transmission * surface


# --- field
# ------------------------------------------------------------------------------------------


def philox(counter, key):
    """Philox 4x32-10 of Salmon et al. (2011), of arrays of four words."""
    c = [np.asarray(word, dtype=np.uint64) for word in counter]
    k = [int(word) for word in key]
    low = np.uint64(0xFFFFFFFF)
    for _ in range(10):
        first, second = np.uint64(0xD2511F53) * c[0], np.uint64(0xCD9E8D57) * c[2]
        c = [
            (second >> np.uint64(32)) ^ c[1] ^ np.uint64(k[0]),
            second & low,
            (first >> np.uint64(32)) ^ c[3] ^ np.uint64(k[1]),
            first & low,
        ]
        k = [(k[0] + 0x9E3779B9) % 2**32, (k[1] + 0xBB67AE85) % 2**32]
    return c


def gaussian_fields(n, voxel_m, seed, psi):
    """Two real fields whose spectrum is psi(xi): Hermitian noise of unit variance, transformed.

    Arrays [z, y, x].
    """
    wave = np.rint(np.fft.fftfreq(n, 1 / n)).astype(int)
    kz, ky, kx = np.meshgrid(wave, wave, wave, indexing="ij")
    xi = np.sqrt(kx**2 + ky**2 + kz**2) / (n * voxel_m)
    amplitude = np.zeros(xi.shape)
    amplitude[xi > 0] = np.sqrt(psi(xi[xi > 0]) / (n * voxel_m) ** 3)
    # Of each pair k, -k one draws: that with 0 < x < n/2, and in the planes x = 0 and n/2 the
    # earlier in (z, y).
    x, y, z = kx % n, ky % n, kz % n
    mx, my, mz = -x % n, -y % n, -z % n
    in_plane = (x == 0) | (x == n // 2)
    mirrored = np.where(in_plane, (mz < z) | ((mz == z) & (my < y)), x > n // 2)
    own = (x == mx) & (y == my) & (z == mz)
    words = philox(
        [np.where(mirrored, a, b) for a, b in ((mx, x), (my, y), (mz, z))] + [np.zeros_like(x)],
        (seed % 2**32, seed >> 32),
    )
    fields = []
    for a, b in (words[:2], words[2:]):
        radius = np.sqrt(-2 * np.log((a.astype(float) + 0.5) / 2**32))
        angle = 2 * np.pi * b.astype(float) / 2**32
        real, imaginary = radius * np.cos(angle), radius * np.sin(angle)
        noise = np.where(
            own, real, (real + 1j * np.where(mirrored, -imaginary, imaginary)) / math.sqrt(2)
        )
        field = np.fft.ifftn(noise * amplitude) * n**3
        assert abs(field.imag).max() < 1e-9 * abs(field.real).max()
        fields.append(field.real)
    return fields


# --- noise
# ------------------------------------------------------------------------------------------


def photons(frequency_hz, kelvin):
    return 0.0 if kelvin == 0 else 1 / math.expm1(H * frequency_hz / (K * kelvin))


def photon_netd(low_hz, high_hz, scene_k, time_s, efficiency=1.0, optics_k=0.0, nep=0.0):
    """NETD in K of one mode: Zmuidzinas (2003), by the middles of 2000 steps."""
    step = (high_hz - low_hz) / 2000
    variance = slope = 0.0
    for number in range(2000):
        hz = low_hz + (number + 0.5) * step
        m = efficiency * photons(hz, scene_k) + (1 - efficiency) * photons(hz, optics_k)
        variance += (H * hz) ** 2 * m * (1 + m) * step / time_s
        warmer, colder = photons(hz, scene_k + 0.01), photons(hz, scene_k - 0.01)
        slope += H * hz * (warmer - colder) / 0.02 * step
    return math.sqrt(variance + nep**2 / (2 * time_s)) / efficiency / slope


def radiometer_netd(receiver_k, scene_k, bandwidth_hz, time_s, drift, single, reference_k=None):
    """Total power, or switched against a reference load where its temperature is given."""
    system = receiver_k * (2 if single else 1) + scene_k
    if reference_k is None:
        return math.hypot(system / math.sqrt(bandwidth_hz * time_s), system * drift)
    load = drift * (scene_k - reference_k)
    return math.hypot(2 * system / math.sqrt(bandwidth_hz * time_s), load)


# --- speckle
# ------------------------------------------------------------------------------------------


def pupil_points(count=200):
    """Returns places within a circle of diameter 1, on a square lattice."""
    x = (np.arange(count) + 0.5) / count - 0.5
    inside = np.hypot(x, x[:, None]) < 0.5
    return x, inside


def speckle_correlation(apart, beam):
    """Correlation of power at `apart` lambda / D: by sums over the pupil (Goodman 2007).

    Of a flood, the transform of the pupil; of a scanned beam, that of its autocorrelation squared.
    """
    x, inside = pupil_points()
    weight, place = inside.sum(axis=0).astype(float), x
    if beam:
        size = 2 * len(x) - 1
        spectrum = np.fft.rfft2(inside.astype(float), (2 * len(x), 2 * len(x)))
        overlap = np.fft.irfft2(spectrum**2, (2 * len(x), 2 * len(x)))[:size, :size]
        weight = (overlap**2).sum(axis=0)
        place = (np.arange(size) - len(x) + 1) / len(x)
    amplitude = (weight * np.cos(2 * math.pi * apart * place)).sum() / weight.sum()
    return amplitude**2


def looks_of_square(width, beam, steps=60):
    """Looks within a square of `width` lambda / D: the double integral, by sums (Goodman 2007)."""
    total = 0.0
    for u in (np.arange(steps) + 0.5) / steps:
        for v in (np.arange(steps) + 0.5) / steps:
            mu = speckle_correlation_at(math.hypot(u, v) * width, beam)
            total += 4 * (1 - u) * (1 - v) * mu / steps**2
    return 1 / total


_CORRELATIONS: dict = {}


def speckle_correlation_at(apart, beam):
    """The correlation, between places 0.01 lambda / D apart by a straight line."""
    if beam not in _CORRELATIONS:
        places = np.arange(0, 4.0, 0.01)
        _CORRELATIONS[beam] = places, [speckle_correlation(a, beam) for a in places]
    places, values = _CORRELATIONS[beam]
    return float(np.interp(apart, places, values))
