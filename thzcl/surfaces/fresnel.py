"""What smooth, rough and covered surfaces reflect, by angle and polarisation: plain formulas.

`cosine` is that of the angle between ray and surface normal, from 0 (grazing) to 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from thzcl.air.radiometry import LIGHT_SPEED

Array = NDArray[np.float64]


def fresnel(permittivity: ArrayLike, cosine: ArrayLike) -> tuple[Array, Array]:
    """Returns the power reflectivities R_s and R_p of a plane face (Fresnel 1823).

    R_s is for an electric field across the plane of incidence, R_p for one within it. The
    permittivity is relative to that of the air. A face of permittivity 1 reflects nothing, and any
    other everything at grazing incidence.
    """
    eps, c = np.asarray(permittivity, np.complex128), np.asarray(cosine, np.float64)
    root = np.sqrt(eps - (1 - c) * (1 + c))
    slow, fast = c.astype(np.complex128), eps * c
    return _squared(slow - root, slow + root), _squared(fast - root, fast + root)


def _squared(above: NDArray[np.complex128], below: NDArray[np.complex128]) -> Array:
    """Returns |above / below|^2, and 0 where both vanish: at grazing incidence upon nothing."""
    none = below == 0
    ratio = np.where(none, 0.0, above) / np.where(none, 1.0, below)
    return np.asarray(ratio.real**2 + ratio.imag**2)


def coherent_share(roughness_m: float, frequency_hz: ArrayLike, cosine: ArrayLike) -> Array:
    """Returns the part of the reflected power that is mirrored by a rough face, the rest scattered.

    exp(-(4 pi sigma cos(th) / wavelength)^2) for an rms height of sigma: Ament (1953), Toward a
    theory of reflection by a rough surface, Proc. IRE 41, 142, doi 10.1109/JRPROC.1953.274171.
    """
    hz, c = np.asarray(frequency_hz, np.float64), np.asarray(cosine, np.float64)
    phase = 4 * np.pi * roughness_m * hz / LIGHT_SPEED * c
    return np.asarray(np.exp(-(phase**2)))


def lobe(slope: float, cosine: ArrayLike) -> Array:
    """Returns pi times the quasi-specular f_r back to the sender, for a reflectivity of 1.

    f_r = exp(-tan(th)^2 / 2 s^2) / (8 pi s^2 cos(th)^6) in 1/sr, for an rms slope of s along each
    axis (Barrick 1968, in the form sigma_0 = 4 pi cos(th)^2 f_r; doi 10.1109/TAP.1968.1139220).
    """
    c = np.maximum(np.asarray(cosine, np.float64), 1e-6)  # there the exponential is 0
    steepness = (1 - c) * (1 + c) / c**2
    return np.asarray(np.exp(-steepness / (2 * slope**2)) / (8 * slope**2 * c**6))


def exchanged(reflectivity: ArrayLike, cover_reflectivity: ArrayLike) -> Array:
    """Returns x = R_b / (1 - R_b R_c), the light between a surface and its cover, all bounces.

    With the cover's transmission T_c and A_c = 1 - T_c - R_c, what is seen is L = R_eff E +
    a_s B_s + a_c B_c, where R_eff = R_c + T_c^2 x, a_s = T_c (1 - (1 - R_c) x) and
    a_c = A_c (1 + T_c x), which sum to 1.
    """
    one, back = np.asarray(reflectivity, np.float64), np.asarray(cover_reflectivity, np.float64)
    return np.asarray(one / (1 - one * back))
