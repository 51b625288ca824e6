"""Detection from samples of a statistic without and with the target, and how sure it is.

Samples are (air, draw): several draws of the noise in each air. Airs are independent, draws in one
air are not, since they share its clutter. Every interval is nominally of 95 % and comes from a
bootstrap that redraws airs, with all of their draws, without and with the target together, so that
it holds the threshold's own error. The spread of the replicates makes an interval on a scale on
which it hardly depends on the value (the probit's, Phi^-1), by Student's law for so many airs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
REPLICATES = 500
LEVEL = 0.975  # of each end
NULLS = 10  # null samples beyond the threshold that an empirical quantile needs
FARTHER = "farther than asked"  # the note of a range beyond all that were asked for
FEWEST_AIRS = 10
MOST_DRAWS = 256
_OF_A_LAW = 10**12  # as many samples as leave a law's own probabilities as they are
WIDER = 1.05  # replicates of a range: Student's law over the normal one, for 50 airs
EMPIRICAL, NORMAL, GAMMA = "empirical", "normal", "gamma"


class Estimate(NamedTuple):
    """A value with the ends of its interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Detection:
    """How well a target is detected at one range.

    `tail` says what the threshold comes from: "empirical" null samples, or a "normal" or "gamma"
    law, whose fit to the nulls has the probability `fit` (None for empirical). `probit` is the
    probability on the probit scale, and `replicates` (replicate,) are its own.
    """

    probability: Estimate
    d_prime: Estimate
    area: Estimate
    tail: str
    fit: float | None
    probit: float
    replicates: Array


def draws_needed(airs: int, false_alarm: float, shared: float) -> int | None:
    """Returns the draws of noise in each air after which nulls show a rate of false alarms.

    `shared` is the part of the statistic's variance that all draws in one air share. So many draws
    are worth airs * draws / (1 + (draws - 1) shared) independent samples (Kish 1965), of which
    NULLS / false_alarm are needed. Returns None if that takes more than MOST_DRAWS, or if the air
    alone limits them.
    """
    needed = NULLS / false_alarm
    room = airs - needed * shared
    if room <= 0:
        return None
    draws = max(1, math.ceil(needed * (1 - shared) / room - 1e-9))
    return draws if draws <= MOST_DRAWS else None


def counts(airs: int, seed: int) -> Array:
    """Returns how often each replicate holds each air, (replicate, air)."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(airs, np.full(airs, 1 / airs), REPLICATES).astype(np.float64)


def detect(
    null: Array, present: Array, false_alarm: float, tail: str, often: Array, sign: float = 1.0
) -> Detection:
    """Returns how well samples (air, draw) with the target are told from those without.

    `often` is what counts() returns. With a `sign` of -1 the target lowers the statistic.
    """
    samples = sign * null, sign * present
    if tail == EMPIRICAL:
        found = _empirical(*samples, false_alarm, np.ones((1, len(null))))
        again = _empirical(*samples, false_alarm, often)
    else:
        law = _normal if tail == NORMAL else _gamma
        found = law(_moments(samples, np.ones((1, len(null)))), false_alarm, sign)
        again = law(_moments(samples, often), false_alarm, sign)
    moments = _moments(samples, np.vstack([np.ones(len(null)), often]))
    d_prime, area = _strengths(moments)
    if tail == EMPIRICAL:
        area = _probit(_areas(*samples, np.vstack([np.ones(len(null)), often])), null.size)
    airs = len(null)
    wide = widening(airs)
    count = present.size if tail == EMPIRICAL else _OF_A_LAW
    z, zs = float(_probit(found, count)[0]), _probit(again, count)
    return Detection(
        _near_ends(_back(_interval(z, zs, wide), float(found[0])), airs),
        _interval(float(d_prime[0]), d_prime[1:], wide),
        _back(_interval(float(area[0]), area[1:], wide)),
        tail,
        None if tail == EMPIRICAL else _fit(null, tail),
        z,
        zs,
    )


def widening(airs: int) -> float:
    """Returns how many standard deviations of replicates an interval's half-width is."""
    from scipy.special import stdtrit

    return float(stdtrit(airs - 1, LEVEL) * math.sqrt(airs / (airs - 1)))


def _interval(value: float, replicates: Array, wide: float) -> Estimate:
    """Returns a value with the interval that its replicates give."""
    spread = wide * float(np.std(replicates, ddof=1)) if np.isfinite(replicates).all() else 0.0
    return Estimate(value, value - spread, value + spread)


def _back(interval: Estimate, value: float | None = None) -> Estimate:
    """Returns probabilities of an interval on the probit scale."""
    from scipy.special import ndtr

    middle, low, high = (float(ndtr(end)) for end in interval)
    return Estimate(middle if value is None else value, low, high)


def _near_ends(found: Estimate, airs: int) -> Estimate:
    """Returns the interval of a probability, one-sided near 0 and 1.

    So many airs without a miss leave a probability of at least 0.025^(1/airs) (Clopper and Pearson
    1934); no law that is fitted to them can say more.
    """
    least = (1 - LEVEL) ** (1 / airs)
    value, low, high = found
    if value >= 1 - 0.5 / airs:
        return Estimate(value, min(low, least), 1.0)
    if value <= 0.5 / airs:
        return Estimate(value, 0.0, max(high, 1 - least))
    return found


def _probit(probability: Array, count: int) -> Array:
    """Returns Phi^-1 of probabilities, none nearer to 0 or 1 than half a sample of `count`."""
    from scipy.special import ndtri

    return np.asarray(ndtri(np.clip(probability, 0.5 / count, 1 - 0.5 / count)))


class _Moments(NamedTuple):
    """Means and variances of the statistic without and with the target, (replicate,)."""

    null: Array
    present: Array
    null_variance: Array
    present_variance: Array


def _moments(samples: tuple[Array, Array], often: Array) -> _Moments:
    """Returns the moments of samples (air, draw), each air as often as (replicate, air) says."""
    means, variances = [], []
    for values in samples:
        centre = float(values.mean())
        away = values - centre
        total = often.sum(1)
        mean = often @ away.mean(1) / total
        square = often @ (away**2).mean(1) / total
        size = total * values.shape[1]
        means.append(centre + mean)
        variances.append(np.maximum(square - mean**2, 0.0) * size / (size - 1))
    return _Moments(*means, *variances)


def _strengths(moments: _Moments) -> tuple[Array, Array]:
    """Returns d' and the probit of the area, d' / sqrt 2."""
    change = moments.present - moments.null
    spread = np.sqrt((moments.null_variance + moments.present_variance) / 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        d_prime = np.where(change == 0, 0.0, change / spread)
    return d_prime, d_prime / np.sqrt(2)


def _normal(m: _Moments, false_alarm: float, sign: float) -> Array:
    """Returns probabilities of detection if the statistic has a normal law."""
    from scipy.special import ndtr, ndtri

    del sign
    threshold = m.null - ndtri(false_alarm) * np.sqrt(m.null_variance)
    with np.errstate(divide="ignore", invalid="ignore"):
        away = (m.present - threshold) / np.sqrt(m.present_variance)
    return np.asarray(ndtr(np.nan_to_num(away, nan=0.0)))


def _gamma(m: _Moments, false_alarm: float, sign: float) -> Array:
    """Returns probabilities of detection if the power has a gamma law (Goodman 2007)."""
    from scipy.special import gammainc, gammaincc, gammainccinv, gammaincinv

    with np.errstate(divide="ignore", invalid="ignore"):
        shape, other = m.null**2 / m.null_variance, m.present**2 / m.present_variance
        scale, its = m.null_variance / np.abs(m.null), m.present_variance / np.abs(m.present)
    if sign > 0:
        return np.asarray(gammaincc(other, gammainccinv(shape, false_alarm) * scale / its))
    return np.asarray(gammainc(other, gammaincinv(shape, false_alarm) * scale / its))


def _empirical(null: Array, present: Array, false_alarm: float, often: Array) -> Array:
    """Returns the parts of samples with the target above the nulls' quantile, (replicate,)."""
    order = np.argsort(null, axis=None)
    values, air = null.ravel()[order], order // null.shape[1]
    hits = np.empty(len(often))
    per_air = np.sort(present, axis=1)
    for number, weight in enumerate(often):
        below = np.cumsum(weight[air])
        place = int(np.searchsorted(below, (1 - false_alarm) * below[-1], side="left"))
        threshold = values[min(place, len(values) - 1)]
        above = (per_air > threshold).mean(1)
        hits[number] = weight @ above / weight.sum()
    return hits


def _areas(null: Array, present: Array, often: Array) -> Array:
    """Returns the areas under the ROC, the part of pairs that are in order, (replicate,)."""
    every = np.concatenate([null, present], axis=1)
    order = np.argsort(every, axis=None, kind="stable")
    air, column = np.divmod(order, every.shape[1])
    is_null = column < null.shape[1]
    found = np.empty(len(often))
    for number, weight in enumerate(often):
        each = weight[air]
        below = np.cumsum(each * is_null)
        pairs = (each * ~is_null) @ below
        found[number] = pairs / (below[-1] * (each * ~is_null).sum())
    return found


def _fit(null: Array, tail: str) -> float | None:
    """Returns how probable nulls as far from a law are: one sample of each air, that law fitted.

    It is by Shapiro and Wilk (1965) for a normal law. A gamma law's is that of Kolmogorov and
    Smirnov, which is too kind to a law that was fitted.
    """
    from scipy import stats

    values = null[:, 0]
    if np.ptp(values) == 0:
        return None
    if tail == NORMAL:
        return float(stats.shapiro(values).pvalue)
    mean, variance = values.mean(), values.var(ddof=1)
    law = stats.gamma(mean**2 / variance, scale=variance / mean)
    return float(stats.kstest(values, law.cdf).pvalue)


@dataclass(frozen=True)
class Reach:
    """The range at which a probability is reached; None where it is not known.

    `note` says "not reached" or "farther than asked" where that is the answer.
    """

    range_m: float | None
    low: float | None
    high: float | None
    note: str


def reach(range_m: Array, found: list[Detection], probability: float) -> Reach:
    """Returns the range up to which a target is detected with a probability.

    Probabilities are fitted on the probit scale by the nearest that do not rise with range
    (isotonic regression), and joined by lines over the logarithm of range. The interval is that of
    the bootstrap's replicates, in which an air is redrawn at all ranges together.
    """
    from scipy.special import ndtri

    estimates = np.array([one.probit for one in found])
    every = np.array([one.replicates for one in found]).T  # (replicate, range)
    wanted = float(ndtri(probability))
    middle = _crossing(range_m, estimates, wanted)
    spread = estimates + WIDER * (every - estimates)
    crossings = np.array([_crossing(range_m, one, wanted) for one in spread])
    low, high = np.quantile(crossings, [1 - LEVEL, LEVEL], method="nearest")
    note = "" if np.isfinite(middle) else "not reached" if middle < 0 else FARTHER
    known = [float(v) if np.isfinite(v) else None for v in (middle, low, high)]
    return Reach(known[0], known[1], known[2], note)


def _crossing(range_m: Array, probits: Array, wanted: float) -> float:
    """Returns where values fall below the one wanted; -inf or inf outside the ranges."""
    from scipy.optimize import isotonic_regression

    fitted = isotonic_regression(probits, increasing=False).x
    if fitted[0] < wanted:
        return -math.inf
    if fitted[-1] >= wanted:
        return math.inf
    last = int(np.flatnonzero(fitted >= wanted)[-1])
    part = (fitted[last] - wanted) / (fitted[last] - fitted[last + 1])
    ends = np.log(range_m[last : last + 2])
    return float(np.exp(ends[0] + part * (ends[1] - ends[0])))
