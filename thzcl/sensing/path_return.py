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

NODES, NODES_PER_UNIT = 20, 3.0  # of the integral: the least, and how many more a wide one has
OPAQUE = 20.0  # depth one way, behind which nothing is worth counting


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
    k in 1/m, both even along the ray, and 0 where `far_m` is not beyond `near_m`. With r = c + s
    sinh(u), c being where G is largest and s half the width of its peak, G dr = wavelength du /
    cosh(u), and what is left is smooth: the rule of Gauss and Legendre errs by 1e-8 at most.
    """
    beta, k, near, far, area, wavelength, focus = (
        np.asarray(given, dtype=np.float64)
        for given in (
            *(backscatter, extinction, near_m, far_m),
            *(aperture_m2, wavelength_m, focus_m),
        )
    )
    far = np.clip(far, near, near + OPAQUE / np.maximum(k, 1e-300))
    across = area / wavelength
    width = across / (1 + (across / focus) ** 2)
    middle = width * across / focus
    low, high = np.arcsinh((near - middle) / width), np.arcsinh((far - middle) / width)
    centre, half = (low + high) / 2, (high - low) / 2
    node, weight = np.polynomial.legendre.leggauss(_nodes(half))
    total = np.zeros(np.broadcast_shapes(centre.shape, k.shape))
    for place, share in zip(node, weight, strict=True):
        turned = np.exp(centre + half * place)
        rise = (turned - 1 / turned) / 2  # sinh(u), and below 1 / cosh(u)
        total += share * np.exp(-2 * k * (middle + width * rise)) * (2 / (turned + 1 / turned))
    return np.asarray(beta * wavelength * half * total)


def _nodes(half: Array) -> int:
    """Returns how many nodes serve for integrals over u whose ranges are twice `half` wide."""
    return int(np.ceil(NODES + NODES_PER_UNIT * 2 * float(half.max(initial=0.0))))


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
