"""Scattering by spheres, in float64 NumPy: efficiencies, and moments of the phase function.

G. Mie (1908), Ann. Phys. 330, 377, doi:10.1002/andp.19083300302, in the notation of C. F. Bohren
and D. R. Huffman (1983), "Absorption and Scattering of Light by Small Particles", chapter 4. The
logarithmic derivatives D_n(m x) and the ratios of psi_n are computed downwards, where they are
stable, and chi_n upwards.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

AT_ONCE = 200_000  # coefficients in an array: what the caches of a core hold
NODES_AT_ONCE = 256  # directions for which angular functions are kept


class Spheres(NamedTuple):
    """What spheres do to a wave: efficiencies over their cross-section (sphere,).

    `backscatter` is that of radar: 4 pi times the differential cross-section straight back.
    `legendre` (order, sphere) holds the means of P_l over the phase function.
    """

    extinction: Array
    scattering: Array
    backscatter: Array
    asymmetry: Array
    legendre: Array


def scatter(size: Array, index: Complex, orders: int = 0) -> Spheres:
    """Returns what spheres do to a wave, with the first `orders` moments of the phase function.

    `size` (sphere,) is pi D / lambda, above 0, and `index` (sphere,) the complex refractive index
    n + i k in air. Size parameters from 1e-6 to 1e4 lose no digits to speak of.
    """
    shape = size.shape
    found = Spheres(
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty(shape),
        np.empty((orders, *shape)),
    )
    for block in _blocks(size, np.abs(index)):
        x, m = size[block], index[block]
        a, b = coefficients(x, m)
        for array, values in zip(found, _efficiencies(x, a, b), strict=False):
            array[block] = values
        if orders:
            found.legendre[:, block] = _moments(a, b, orders)
    return found


def _blocks(size: Array, index: Array) -> Iterator[NDArray[np.intp]]:
    """Yields the numbers of spheres that are about as large, and not too many at once."""
    order = np.argsort(size)
    first = 0
    while first < len(order):
        x = size[order[first:]]
        count = int(np.searchsorted(x, 3.0 * x[0] + 2.0, side="right"))
        work = float(_terms(x[count - 1])) * max(1.0, float(index.max()))
        count = min(count, max(1, int(AT_ONCE / work)))
        yield order[first : first + count]
        first += count


def _terms(size: Array) -> NDArray[np.int64]:
    """Returns how many partial waves matter (Wiscombe 1980, Appl. Opt. 19, 1505, and some)."""
    return np.ceil(size + 4.3 * np.cbrt(size) + 4).astype(np.int64)


def _start(size: float) -> int:
    """Returns from where a downward recurrence has settled at all orders that matter."""
    return int(np.ceil(size + 8 * size ** (1 / 3) + 30))


def coefficients(x: Array, m: Complex) -> tuple[Complex, Complex]:
    """Returns Mie's a_n and b_n, (order, sphere), the first order being 1.

    They are equations 4.88 of Bohren and Huffman. All spheres have as many as the largest, those
    beyond their own being 0: there chi_n may be too large for a number.
    """
    own = _terms(x)
    n = np.arange(1, own.max() + 1)[:, None]
    slope = _log_derivatives(m * x, len(n))
    electric, magnetic = slope / m + n / x, slope * m + n / x
    with np.errstate(over="ignore", invalid="ignore"):
        psi, chi = _riccati_bessel(x, len(n))
        xi, behind = psi[1:] - 1j * chi[1:], psi[:-1] - 1j * chi[:-1]
        a = (electric * psi[1:] - psi[:-1]) / (electric * xi - behind)
        b = (magnetic * psi[1:] - psi[:-1]) / (magnetic * xi - behind)
    return np.where(n <= own, a, 0j), np.where(n <= own, b, 0j)


def _log_derivatives(z: Complex, count: int) -> Complex:
    """Returns D_n(z) = psi_n'(z) / psi_n(z) for n from 1 to `count`, (order, sphere)."""
    found = np.empty((count, *z.shape), dtype=np.complex128)
    derivative = np.zeros_like(z)
    inverse = 1 / z
    for n in range(max(_start(float(np.abs(z).max())), count + 1), 1, -1):
        over = n * inverse
        derivative = over - 1 / (derivative + over)
        if n - 2 < count:
            found[n - 2] = derivative
    return found


def _riccati_bessel(x: Array, count: int) -> tuple[Array, Array]:
    """Returns psi_n(x) = x j_n(x) and chi_n(x) = -x y_n(x) for n from 0 to `count`.

    psi_n is the product of ratios from psi_0 = sin x on, or from psi_-1 = cos x where that is
    larger, since a ratio to a number near 0 has lost its digits.
    """
    ratio = np.empty((count + 1, *x.shape))  # psi_n / psi_(n-1)
    last, inverse = np.zeros_like(x), 1 / x
    for n in range(max(_start(float(x.max())), count + 1), -1, -1):
        last = 1 / ((2 * n + 1) * inverse - last)
        if n <= count:
            ratio[n] = last
    sine, cosine = np.sin(x), np.cos(x)
    ratio[0] = np.where(np.abs(sine) >= np.abs(cosine), sine, cosine * ratio[0])
    psi: Array = np.multiply.accumulate(ratio, axis=0)
    chi = np.empty_like(psi)
    chi[0] = cosine
    chi[1] = cosine * inverse + sine
    for n in range(2, count + 1):
        chi[n] = (2 * n - 1) * inverse * chi[n - 1] - chi[n - 2]
    return psi, chi


def _efficiencies(x: Array, a: Complex, b: Complex) -> tuple[Array, Array, Array, Array]:
    """Returns Q_ext, Q_sca, Q_back and g (Bohren and Huffman 4.61, 4.62, 4.82 and page 120)."""
    n = np.arange(1, len(a) + 1)[:, None]
    weight = 2 * n + 1.0
    extinction = 2 / x**2 * np.sum(weight * (a + b).real, axis=0)
    power = a.real**2 + a.imag**2 + b.real**2 + b.imag**2
    scattering = 2 / x**2 * np.sum(weight * power, axis=0)
    back = np.sum(weight * (1 - 2 * (n % 2)) * (a - b), axis=0)
    backscatter = (back.real**2 + back.imag**2) / x**2
    own = weight / (n * (n + 1)) * (a * np.conj(b)).real
    next_one = (n * (n + 2) / (n + 1.0))[:-1]
    next_one = next_one * (a[:-1] * np.conj(a[1:]) + b[:-1] * np.conj(b[1:])).real
    forward = 4 / x**2 * (own.sum(axis=0) + next_one.sum(axis=0))
    asymmetry = np.divide(forward, scattering, out=np.zeros_like(x), where=scattering > 0)
    return extinction, scattering, backscatter, asymmetry


def _moments(a: Complex, b: Complex, orders: int) -> Array:
    """Returns the moments of the phase functions of spheres, (order, sphere).

    Gauss' quadrature over the cosine is exact for them. The phase function goes as |S_1 + S_2|^2 +
    |S_1 - S_2|^2, and directions ahead and back have their angular functions in common.
    """
    terms = len(a)
    mu, weight = gauss(2 * ((terms + orders // 2 + 34) // 32 * 16))
    mu, weight = mu[len(mu) // 2 :], weight[len(mu) // 2 :]
    n = np.arange(1, terms + 1)[:, None]
    per_order = (2 * n + 1.0) / (n * (n + 1))
    plus, minus, sign = per_order * (a + b), per_order * (a - b), 2 * (n % 2) - 1
    total = np.zeros((orders, a.shape[1]))
    for first in range(0, len(mu), NODES_AT_ONCE):
        part = slice(first, first + NODES_AT_ONCE)
        summed, apart = _angular(mu[part], terms)
        ahead = _squared(plus, summed) + _squared(minus, apart)
        back = _squared(plus * sign, apart) + _squared(minus * sign, summed)
        polynomials = legendre(mu[part], orders) * weight[part]
        total[::2] += polynomials[::2] @ (ahead + back)
        total[1::2] += polynomials[1::2] @ (ahead - back)
    # A phase function that underflows is that of no scattering at all.
    return np.asarray(np.divide(total, total[0], out=np.zeros_like(total), where=total[0] > 0))


def _squared(amplitude: Complex, functions: Array) -> Array:
    """Returns |sum_n c_n f_n(mu)|^2, (direction, sphere)."""
    return np.asarray((functions.T @ amplitude.real) ** 2 + (functions.T @ amplitude.imag) ** 2)


def _angular(mu: Array, count: int) -> tuple[Array, Array]:
    """Returns pi_n + tau_n and pi_n - tau_n for n from 1 on, (order, direction).

    The recurrence is equation 4.47 of Bohren and Huffman.
    """
    pi = np.zeros((count + 1, len(mu)))
    pi[1] = 1.0
    for n in range(2, count + 1):
        pi[n] = ((2 * n - 1) * mu * pi[n - 1] - n * pi[n - 2]) / (n - 1)
    order = np.arange(1, count + 1)[:, None]
    tau = order * mu * pi[1:] - (order + 1) * pi[:-1]
    return pi[1:] + tau, pi[1:] - tau


@lru_cache(maxsize=64)
def gauss(count: int) -> tuple[Array, Array]:
    """Returns nodes from -1 to 1, ascending, and weights of Gauss' and Legendre's quadrature.

    They are read-only.
    """
    from scipy.special import roots_legendre

    nodes, weights = roots_legendre(count)
    for array in (nodes, weights):
        array.flags.writeable = False
    return nodes, weights


def legendre(mu: Array, orders: int) -> Array:
    """Returns Legendre's polynomials P_0, P_1, ... at some cosines, (order, *cosine)."""
    found = np.ones((orders, *mu.shape))
    if orders > 1:
        found[1] = mu
    for n in range(2, orders):
        found[n] = ((2 * n - 1) * mu * found[n - 1] - (n - 1) * found[n - 2]) / n
    return found
