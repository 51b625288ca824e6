"""What constituents say and answer, held to their contract before anybody relies on it."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air.validity import ROUNDING, UNITS
from thzcl.constituent import Constituent, OpticalProperties, Parameters, Span
from thzcl.plugins.guard import Breach

Array = NDArray[np.float64]
SAME_SUM = 1e-9  # relative: parts that sum up to the absorption
LEAST_ORDERS = 49  # moments of a phase function
_ZERO = np.zeros(())


def check_class(kind: Any) -> None:
    """Raises Breach if what a class says of itself breaks the contract.

    What is a property is known only once there is an object.
    """
    if not isinstance(kind.gas, bool):
        raise Breach(f"its gas is {kind.gas!r}, not True or False")
    if isinstance(kind.varies, property) or isinstance(kind.valid, property):
        return
    _claims(kind.varies, kind.valid)


def claims(constituent: Constituent) -> tuple[bool, tuple[Span, ...]]:
    """Returns whether a constituent varies with the air, and where it is valid. Raises Breach."""
    return _claims(constituent.varies, constituent.valid)


def layer_top_m(constituent: Constituent) -> float:
    """Returns how far up the sky holds a constituent, m. Raises Breach."""
    top = constituent.layer_top_m
    if isinstance(top, bool) or not isinstance(top, int | float) or not top > 0:
        raise Breach(f"its layer_top_m is {top!r}, not a number of metres above 0")
    return float(top)


def _claims(varies: Any, valid: Any) -> tuple[bool, tuple[Span, ...]]:
    if not isinstance(varies, bool):
        raise Breach(f"its varies is {varies!r}, not True or False")
    if not isinstance(valid, tuple) or not all(isinstance(span, Span) for span in valid):
        raise Breach("its valid is not a tuple of thzcl.constituent.Span")
    for span in valid:
        bounds = span.least, span.most, *(span.warn or (span.least, span.most))
        numbers = len(bounds) == 4 and all(isinstance(bound, int | float) for bound in bounds)
        if span.quantity not in UNITS or not numbers or not span.least <= span.most:
            raise Breach(f"its {span} is no range of {', '.join(UNITS)}")
    return varies, valid


def checked(answer: Any, shape: tuple[int, ...]) -> OpticalProperties:
    """Returns an answer of optics() as float64 arrays of the state's shape. Raises Breach.

    Its parts and moments, which few ask for, are left as they are: see `parts` and `moments`.
    """
    if not isinstance(answer, OpticalProperties):
        raise Breach(f"optics() returned {type(answer).__name__} instead of OpticalProperties")
    absorption = _positive(answer.absorption, "absorption", shape, "1/m")
    own = answer.temperature_k
    return OpticalProperties(
        absorption,
        scattering=_positive(answer.scattering, "scattering", shape, "1/m"),
        legendre=answer.legendre,
        backscatter=_positive(answer.backscatter, "backscatter", shape, "1/m/sr"),
        temperature_k=None if own is None else _shaped(own, "temperature_k", shape),
        parts=answer.parts,
    )


def is_no_gas(found: OpticalProperties, air_k: Array) -> bool:
    """Returns whether optics are none that a gas can have."""
    own = found.temperature_k
    warm = own is not None and not np.allclose(own, air_k, rtol=ROUNDING, atol=0)
    return bool(warm or np.any(found.scattering) or np.any(found.backscatter))


def parts(found: OpticalProperties) -> dict[str, Array]:
    """Returns the parts of a checked absorption by name; none if there are none. Raises Breach."""
    given, absorption = found.parts, np.asarray(found.absorption)
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise Breach("optics() returned parts that are not arrays by name")
    apart, known = -absorption, {}
    for name, part in given.items():
        known[str(name)] = _shaped(part, f"part {name!r}", absorption.shape)
        apart = apart + known[str(name)]
    if not (np.abs(apart) <= SAME_SUM * absorption).all():
        raise Breach("optics() returned parts that do not sum up to the absorption")
    return known


def moments(found: OpticalProperties) -> Array:
    """Returns the moments of the phase function of checked optics, (order, *shape). Raises Breach.

    Where nothing is scattered they may be anything.
    """
    if found.legendre is None:
        raise Breach("optics() returned scattering without moments of its phase function")
    values = _numbers(found.legendre, "legendre")
    if values.ndim == 0 or len(values) < LEAST_ORDERS:
        orders = 0 if values.ndim == 0 else len(values)
        raise Breach(f"optics() returned {orders} moments; the least is {LEAST_ORDERS}")
    scattering = np.asarray(found.scattering)
    shape = np.broadcast_shapes(scattering.shape, np.shape(found.absorption))
    # The first axis is the order's, however few others there are.
    few = max(0, 1 + len(shape) - values.ndim)
    values = values.reshape(len(values), *(1,) * few, *values.shape[1:])
    values = _shaped(values, "legendre", (len(values), *shape))
    scatters = np.broadcast_to(scattering > 0, shape)
    if not (np.abs(values[0][scatters] - 1) <= SAME_SUM).all():
        raise Breach("optics() returned moments the first of which is not 1")
    if not (np.abs(values[:, scatters]) <= 1 + SAME_SUM).all():
        raise Breach("optics() returned moments that are not between -1 and 1")
    return values


def sentences(answer: Any) -> list[str]:
    """Returns an answer of notes(). Raises Breach."""
    if not isinstance(answer, Sequence) or not all(isinstance(text, str) for text in answer):
        raise Breach(f"notes() returned {answer!r}, not a list of sentences")
    return list(answer)


def others(answer: Any, kind: type[Parameters]) -> list[Parameters]:
    """Returns an answer of alternatives(), parameters of a kind. Raises Breach."""
    if not isinstance(answer, Sequence) or not all(isinstance(one, kind) for one in answer):
        raise Breach("alternatives() did not return a list of its Params")
    return list(answer)


def _positive(given: Any, what: str, shape: tuple[int, ...], unit: str) -> Array:
    """Returns a coefficient, which is finite and at least 0."""
    if isinstance(given, float) and given == 0.0:  # as most have it
        return _ZERO
    values = _numbers(given, what)
    if values.size:
        low, high = values.min(), values.max()
        if not -math.inf < low <= high < math.inf:
            raise Breach(f"optics() returned {what} with values that are not finite")
        if low < 0:
            raise Breach(f"optics() returned negative {what}: {low:g} {unit}")
    return _shaped(values, what, shape)


def _shaped(given: Any, what: str, shape: tuple[int, ...]) -> Array:
    values = _numbers(given, what)
    if values.shape == shape:
        return values
    try:
        return np.broadcast_to(values, shape)
    except ValueError:
        text = f"optics() returned {what} of shape {values.shape}; the state has {shape}"
        raise Breach(text) from None


def _numbers(given: Any, what: str) -> Array:
    try:
        values = np.asarray(given)
    except ValueError:  # lists of unlike lengths
        values = np.asarray(None)
    masks = sys.modules.get("numpy.ma")  # whose import takes longer than a plan
    if values.dtype.kind not in "fiu" or (masks and masks.is_masked(given)):
        raise Breach(f"optics() returned {what} that is not made of numbers")
    return values.astype(np.float64, copy=False)


def checked_lines(answer: Any) -> tuple[Array, float]:
    """Returns an answer of lines(): positions and width in Hz. Raises Breach."""
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise Breach("lines() did not return positions and a width")
    given, width = answer
    positions = _numbers(given, "lines") if np.size(given) else np.empty(0)
    ascending = positions.ndim == 1 and (np.diff(positions) >= 0).all()
    if not ascending or not np.isfinite(positions).all():
        raise Breach("lines() returned positions that are not a list of ascending numbers in Hz")
    if not isinstance(width, int | float | np.number) or not width > 0:
        raise Breach(f"lines() returned {width!r} as width, not a number above 0 in Hz")
    return positions, float(width)
