"""What the air sends back to a focused beam: rain's echo before and beside the target's.

The beam is Gauss' of one mode, sent and received through the same aperture, and focused at a
distance. An aperture of area A = pi w0^2 sees single scatterers at r with a solid angle of G(r) =
A / (r^2 + (A / lambda)^2 (1 - r / f)^2), which is lambda^2 / (pi w^2(r)): at the focus A / r^2, as
far away, and at the lens no more than lambda^2 / A, where A / r^2 would have no bound. Powers of
many drops add; light is scattered once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SERIES_FROM = 40.0  # argument from which the exponential integral is its asymptotic series
TERMS = 24  # of that


def beam_gain(range_m: Any, aperture_m2: Any, wavelength_m: Any, focus_m: Any) -> Array:
    """Returns the solid angle, in sr, that a focused aperture sees from scatterers at a range."""
    r = np.asarray(range_m, dtype=np.float64)
    across = np.asarray(aperture_m2) / np.asarray(wavelength_m)
    return np.asarray(aperture_m2 / (r**2 + (across * (1 - r / np.asarray(focus_m))) ** 2))


def path_return(
    backscatter: Any,
    extinction: Any,
    near_m: Any,
    far_m: Any,
    aperture_m2: Any,
    wavelength_m: Any,
    focus_m: Any,
) -> Array:
    """Returns the power that comes back from the air between two ranges, over the power sent.

    It is the integral of beta G(r) exp(-2 k r), with `backscatter` beta in 1/m/sr and `extinction`
    k in 1/m, both even along the ray, and 0 where `far_m` is not beyond `near_m`. With p the root
    of 1 / G it is beta lambda Im of the integral of exp(-2 k r) / (r - p), a difference of two
    exponential integrals; without extinction a difference of two arctangents.
    """
    beta, k, near, far, area, wavelength, focus = (
        np.asarray(given, dtype=np.float64)
        for given in (
            *(backscatter, extinction, near_m, far_m),
            *(aperture_m2, wavelength_m, focus_m),
        )
    )
    far = np.maximum(near, far)
    across = area / wavelength
    curved = 1 + (across / focus) ** 2
    root = across * (across / focus + 1j) / curved
    found = np.angle(near - root) - np.angle(far - root)  # both lie below the real axis
    found = np.where(k > 0, (_tail(k, near, root) - _tail(k, far, root)).imag, -found)
    return np.asarray(beta * wavelength * np.maximum(found, 0.0))  # no less by rounding


def _tail(k: Array, r: Array, root: Any) -> Any:
    """Returns the integral of exp(-2 k s) / (s - root) for s from r on.

    It is exp(-2 k root) E_1(2 k (r - root)) (Abramowitz and Stegun 5.1.1), or by 5.1.51.
    """
    from scipy.special import exp1

    z = 2 * np.maximum(k, 1e-300) * (r - root)
    far = np.abs(z) > SERIES_FROM
    close = np.where(far, -1j, z)
    series, term = np.zeros_like(z), 1 / np.where(far, z, SERIES_FROM)
    step = -term
    for number in range(1, TERMS + 1):
        series = series + term
        term = term * number * step
    return np.exp(-2 * k * r) * np.where(far, series, np.exp(close) * exp1(close))


def gated(
    distance_m: Any, gate_m: tuple[float, float] | None = None, *, solid: Any = True
) -> tuple[Array, Array]:
    """Returns from which range to which the air's echo is received.

    `gate_m` are metres from `distance_m` on, negative before it; without a gate all is received.
    Behind what is `solid` there is nothing to receive.
    """
    distance = np.asarray(distance_m, dtype=np.float64)
    if gate_m is None:
        return np.zeros_like(distance), distance
    near, far = distance + gate_m[0], distance + gate_m[1]
    return np.maximum(near, 0.0), np.where(solid, np.minimum(far, distance), far)


def as_lambert(returned: Any, distance_m: Any, aperture_m2: Any, depth: Any) -> Array:
    """Returns the reflectivity of a rough surface that would send back as much from a distance.

    `returned` is over the power sent, and `depth` the optical depth one way: a Lambert surface
    sends back R A exp(-2 depth) / (pi r^2).
    """
    squared = np.asarray(distance_m, dtype=np.float64) ** 2
    return np.asarray(np.pi * returned * squared / aperture_m2 * np.exp(2 * np.asarray(depth)))
