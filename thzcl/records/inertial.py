"""The inertial range of a spectrum: level, slope, floor, bend and roll-off in one fit.

The density of a scalar whose structure function is C^2 r^(2/3) is, one-sided in cycles per metre,
2 * 0.1244 (2 pi)^(-2/3) C^2 xi^(-5/3), and two-sided in radians per metre 0.1244 C^2 k^(-5/3)
(Tatarskii 1971). The fitted density is

    L(xi) + s (L folded at Nyquist's frequency) + F,  L = A (xi^2 + b^2)^(p/2) / (1 + (c xi)^2)

with the outer scale 1/b (von Karman), a first-order sensor or tube of 2 pi tau U = c, a floor F of
white noise, and aliasing of a strength s between 0 (a filter before the sampling) and 1 (samples of
points): which of both a record is, is not known beforehand. Densities are fitted by maximum
likelihood (Whittle 1953), that is by their mean: the mean of a periodogram's logarithm would lie
44 % low. Each part is there only where the likelihood asks for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from thzcl.records.spectrum import CORRELATION, Binned
from thzcl.turbulence.spectrum_table import KOLMOGOROV_ALONG

Array = NDArray[np.float64]

KOLMOGOROV_SLOPE = -5 / 3
ONE_SIDED_CYCLES = KOLMOGOROV_ALONG  # 2 * 0.1244 (2 pi)^(-2/3)
# The relative departure of a bin from the line, beside its scatter: measured turbulence is
# intermittent.
TOLERATED = 0.15
# Of bins in the fitted range: expected are 1 on average, and three sigma at most.
MEAN_DEVIANCE, LARGEST_DEVIANCE = 1.5, 12.0
NARROWEST = 4.0  # ratio of the limits of an inertial range
DEPARTURE, DEVIATIONS = 0.12, 3.0  # of the slope from -5/3: beyond both it is not inertial
CLEARLY = 0.1  # departure from -5/3 of the lower part of a spectrum that steepens
STARTS = (1.0, 2.0, 4.0)  # of its lower end, where a part that is too steep is looked at again
SUREST = 0.06  # uncertainty of a slope below which a part of a spectrum is told from the rest
VAGUEST = 0.25  # uncertainty of a slope; beyond, it says nothing
# That where the range ends in a roll-off: the outer scale bends a slow probe's spectrum from -2 to
# -11/3 as a sensor bends turbulence's, and only the slope below tells them apart.
VAGUEST_ROLLED = 0.1
ABOVE_BEND = 2.0  # inverse outer scales, at which von Karman's density is 17 % below the line
WIDE = 20.0  # ratio of a fit's limits that is kept, if need be from below the bend
SHALLOWEST = -1.2  # slope of what a sensor rolls off
BELOW_ROLL = 0.5  # of 1/c, where a first-order sensor loses 20 % of the density
# What each part of a density must gain in twice the logarithm of the likelihood.
PENALTY = {"floor": 2.0, "fold": 2.0, "bend": 4.0, "roll": 14.0}
FLOORS: tuple[tuple[str, ...], ...] = ((), ("floor",), ("fold",))
IMAGES = 3  # of Nyquist's frequency, folded one by one; the rest as an integral
NEGLIGIBLE = 1e-3  # of the lowest density: no floor
BELOW_NYQUIST = 0.7  # of Nyquist's frequency: there the fit ends
FINE = 1e-6  # relative, of the fit: 3e-5 in the logarithm of the likelihood
STEPS = 3  # bins by which the ends of a range are moved


@dataclass(frozen=True)
class Fit:
    """A fitted density: level, slope and, where they are there, floor, bend and roll-off.

    `level` is A in squared units of the signal times m^(1 - p); `floor` F in squared units times m,
    `bend` b in cycles/m, `roll` c in m, `fold` s, 0 to 1; 0 where they are not there. `uncertainty`
    is that of the slope, `level_uncertainty` relative, one standard deviation each; `cost` is minus
    twice the logarithm of the likelihood; `nyquist`, in cycles/m, is where the line is folded.
    `mean_slope` is the slope over fits with and without a floor.
    """

    level: float
    slope: float
    floor: float
    bend: float
    roll: float
    uncertainty: float
    level_uncertainty: float
    cost: float
    fold: float = 0.0
    nyquist: float = math.inf
    mean_slope: float = 0.0
    bend_uncertainty: float = 0.0  # of its logarithm
    vagueness: float = 0.0  # the slope's largest uncertainty, of fits with and without a floor

    def line(self, xi: Array) -> Array:
        """Returns the density at spatial frequencies, without the floor."""
        bent = (xi**2 + self.bend**2) ** (self.slope / 2)
        return np.asarray(self.level * bent / (1 + (self.roll * xi) ** 2))

    def density(self, xi: Array) -> Array:
        """Returns the density at spatial frequencies."""
        found = self.line(xi) + self.floor
        return found + self.fold * self.folded(xi) if self.fold else found

    def folded(self, xi: Array) -> Array:
        """Returns what the line has beyond Nyquist's frequency, folded down to xi below it.

        The images up to 2 IMAGES times Nyquist's frequency are summed, the rest integrated.
        """
        images = 2 * self.nyquist * np.arange(1, IMAGES + 1)[:, None]
        found = (self.line(images - xi) + self.line(images + xi)).sum(axis=0)
        end = (2 * IMAGES + 1) * self.nyquist
        if self.slope < -1.05:
            found = found + self.line(np.array([end]))[0] * end / (-1 - self.slope) / self.nyquist
        return np.asarray(found)


@dataclass(frozen=True)
class Inertial:
    """The inertial range of a spectrum, and what was fitted in it.

    `limits` are in cycles/m; `structure_constant` is C^2, or None where there is no inertial range,
    and `reason` says why; `noise` is the floor, one-sided, in squared units of the signal times m;
    `bend` is 1/L0 in cycles/m of the von Karman spectrum that bends below the range, or 0;
    `roll_m` is 2 pi tau U of a slow sensor, or 0; `slope` is fitted freely, and its uncertainty is
    one standard deviation; `level_uncertainty` is C^2's by the likelihood, relative; `fitted` are
    the limits of the fit, and `fixed` the density with the slope held at -5/3; above `steepens`, in
    cycles/m, the spectrum is too steep, or it is 0; `whole` are the limits within which floor, bend
    and roll-off were fitted.
    """

    limits: tuple[float, float]
    structure_constant: float | None
    noise: float
    bend: float
    roll_m: float
    slope: float
    slope_uncertainty: float
    level_uncertainty: float
    fitted: tuple[float, float]
    fixed: Fit
    reason: str = ""
    steepens: float = 0.0
    whole: tuple[float, float] = (0.0, math.inf)

    def line(self, frequency: Array) -> Array:
        """Returns the density of the -5/3 line, without the noise."""
        return np.asarray(self.fixed.level * frequency**KOLMOGOROV_SLOPE)


def find(
    spectrum: Binned, nyquist: float, scatter: float = 1.0, lowest: float = 0.0
) -> Inertial | None:
    """Returns the inertial range of a spectrum, or None if no part of it is a power law.

    `nyquist` is in cycles/m; `scatter` says by how much turbulence that comes and goes makes
    densities scatter more than steady turbulence; `lowest` is the spatial frequency below which no
    range is offered, 1/height.
    """
    usable = replace(spectrum, nyquist=nyquist).part(0.0, BELOW_NYQUIST * nyquist)
    for part in _parts(usable):
        best = chosen(part, scatter)
        if best is not None and _fits(part, best, scatter):
            found = _inertial(part, best, scatter, lowest)
            steep = found.reason and (found.slope < KOLMOGOROV_SLOPE or best.roll)
            if not steep:
                return found
            starts = (0.0, *(times * found.fitted[0] for times in STARTS))
            above = [part.part(start, float(part.frequency[-1])) for start in starts]
            lower = (_before_steepening(p, scatter, lowest) for p in above)
            return next((one for one in lower if one is not None), found)
    return None


def _before_steepening(part: Binned, scatter: float, lowest: float) -> Inertial | None:
    """Returns the inertial range at the lower end of a part that is too steep as a whole, or None.

    A spectrum that is as steep throughout has none: the range's slope must be sure.
    """
    for stop in range(len(part.frequency) - STEPS, 5, -STEPS):
        lower = part.where(slice(0, stop))
        plain = _fit(lower, ("bend",), scatter, None)
        if plain is None or plain.slope < KOLMOGOROV_SLOPE - CLEARLY:
            continue  # too steep already, and a floor would make it steeper
        best = chosen(lower, scatter, rolls=(False,))
        if best is None or not _fits(lower, best, scatter):
            continue
        found = _inertial(lower, best, scatter, lowest)
        if found.slope_uncertainty > SUREST:
            continue
        if not found.reason and abs(found.slope - KOLMOGOROV_SLOPE) < CLEARLY:
            return replace(found, steepens=float(lower.frequency[-1]))
    return None


def _parts(spectrum: Binned) -> Iterator[Binned]:
    """Yields parts of a spectrum, down to the narrowest that is a range.

    First comes that in which a slope would be surest, by Fisher's information of a power law,
    sum n (ln xi - mean)^2: width counts, and the number of values.
    """
    logs, count = np.log(spectrum.frequency), spectrum.count
    ends = range(0, len(logs), STEPS)
    found = []
    for start, stop in product(ends, (len(logs) - last for last in ends)):
        if stop - start > 5 and logs[stop - 1] - logs[start] > math.log(NARROWEST):
            inside = slice(start, stop)
            mean = np.average(logs[inside], weights=count[inside])
            found.append((float(count[inside] @ (logs[inside] - mean) ** 2), start, stop))
    for _, start, stop in sorted(found, reverse=True):
        yield spectrum.where(slice(start, stop))


def chosen(
    part: Binned,
    scatter: float,
    slope: float | None = None,
    like: Fit | None = None,
    rolls: Sequence[bool] = (False, True),
) -> Fit | None:
    """Returns the likeliest fit, of those with and without floor, bend and roll-off.

    Its slope, level and uncertainties are means over the fits of one kind of ends, each by its
    likelihood (Akaike weights; Burnham and Anderson 2002, equation 4.9): whether there is a floor
    is seldom certain, and slope and floor stand for each other. `slope` is held where it is given;
    `like` has the bend, held as it is or left out (an outer scale need not bend as von Karman has
    it), and says whether there is a roll-off; `rolls` says what else is tried.
    """
    rolls = (bool(like.roll),) if like else rolls
    ends = [("bend",) * bent + ("roll",) * roll for bent in (not like, False) for roll in rolls]
    held = _bends(like) if like else [0.0]
    fits = []
    for end, floor, bend in product(dict.fromkeys(ends), FLOORS, held):
        fit = _fit(part, (*floor, *end), scatter, slope, bend)
        if fit is not None:
            fits.append((fit.cost + sum(PENALTY[name] for name in (*floor, *end)), end, fit))
    if not fits:
        return None
    least, end, best = min(fits, key=lambda one: one[0])
    same = [(math.exp((least - cost) / 2), fit) for cost, other, fit in fits if other == end]
    return _mean(best, same, NEGLIGIBLE * float(part.density.min()))


def _bends(like: Fit) -> list[float]:
    """Returns the bends that a fit above a bend tries: none, and what the bend's error leaves."""
    if not like.bend:
        return [0.0]
    factor = math.exp(like.bend_uncertainty)
    return [0.0, like.bend / factor, like.bend, like.bend * factor]


def _mean(best: Fit, same: list[tuple[float, Fit]], least: float) -> Fit:
    """Returns a fit with the slope, the level and the uncertainties of weighted fits.

    The level is that at the slope held, or else the best fit's own. A floor below `least` is none.
    """
    weights = np.array([w for w, _ in same])
    weights /= weights.sum()
    slopes, levels = (np.array([getattr(f, n) for _, f in same]) for n in ("slope", "level"))
    slope = float(weights @ slopes)
    own = weights @ [f.uncertainty**2 for _, f in same] + weights @ (slopes - slope) ** 2
    relative = weights @ [f.level_uncertainty**2 for _, f in same]
    if np.ptp(slopes) == 0:  # held
        level = float(weights @ levels)
        relative += weights @ (levels / level - 1) ** 2
        floor, fold = (float(weights @ [getattr(f, n) for _, f in same]) for n in ("floor", "fold"))
        floor = floor if floor > least else 0.0
        best = replace(best, level=level, floor=floor, fold=fold)
    return replace(
        best,
        mean_slope=slope,
        uncertainty=math.sqrt(own),
        level_uncertainty=math.sqrt(relative),
        vagueness=max(f.uncertainty for _, f in same),
    )


def _fit(
    part: Binned,
    kind: tuple[str, ...],
    scatter: float,
    slope: float | None,
    bend: float = 0.0,
) -> Fit | None:
    """Returns the likeliest density of a kind, or None if there is none.

    The kind names the parts that are there, of floor, fold, bend and roll. `bend` is held where the
    kind has none.

    The deviance of a bin, 2 n (d/m - 1 - ln d/m), is a sum of squares to minimise.
    """
    from scipy import optimize

    xi, weight = part.frequency, part.count / (CORRELATION * scatter)
    middle = float(np.exp(np.average(np.log(xi), weights=weight)))
    names = [*(() if slope is not None else ("slope",)), *kind]

    def fit_of(x: Array) -> Fit:
        own = dict(zip(names, x[1:], strict=True))
        p = own.get("slope", slope)
        level = math.exp(x[0]) * middle ** -float(p)  # type: ignore[arg-type]
        parts = {n: math.exp(own[n]) for n in ("floor", "bend", "roll") if n in own}
        floor, roll = parts.get("floor", 0.0), parts.get("roll", 0.0)
        fold = float(own.get("fold", 0.0))
        own_bend = parts.get("bend", bend)
        return Fit(level, float(p), floor, own_bend, roll, 0.0, 0.0, 0.0, fold, part.nyquist)  # type: ignore[arg-type]

    def residuals(x: Array) -> Array:
        ratio = part.density / fit_of(x).density(xi)
        return np.asarray(
            np.sign(ratio - 1) * np.sqrt(np.maximum(2 * weight * (ratio - 1 - np.log(ratio)), 0))
        )

    start = {"slope": KOLMOGOROV_SLOPE, "floor": math.log(0.3 * part.density[-3:].min())}
    start |= {"fold": 0.5, "bend": math.log(2 * xi[0]), "roll": -math.log(xi[-1] / 3)}
    level = math.log(float(np.interp(middle, xi, part.density)))
    lows = {"slope": -8.0, "fold": 0.0, "floor": start["floor"] - 12, "bend": math.log(xi[0] / 8),
            "roll": -math.log(8 * xi[-1])}  # fmt: skip
    # A roll-off is one of a power law that turbulence may have, and not half of a steeper one.
    shallowest = SHALLOWEST if "roll" in kind else 1.0
    highs = {"slope": shallowest, "fold": 1.0, "floor": math.log(part.density.max()),
             "bend": math.log(xi[-1] / NARROWEST),
             "roll": -math.log(xi[0] * NARROWEST)}  # fmt: skip
    try:
        found = optimize.least_squares(
            residuals,
            np.array([level, *(min(max(start[n], lows[n]), highs[n]) for n in names)]),
            bounds=(
                [level - 30, *(lows[n] for n in names)],
                [level + 30, *(highs[n] for n in names)],
            ),
            max_nfev=60,
            ftol=FINE,
            xtol=FINE,
        )
    except (ValueError, FloatingPointError):
        return None
    free = [n for n, (x, name) in enumerate(zip(found.x[1:], names, strict=True), start=1)
            if lows[name] + 1e-3 < x < highs[name] - 1e-3]  # fmt: skip
    return _with_errors(fit_of(found.x), found, [0, *free], names)


def _with_errors(fit: Fit, found: object, free: list[int], names: list[str]) -> Fit:
    """Returns a fit with its uncertainties, by Fisher's information of the free parameters.

    They grow where the bins scatter about the fit by more than they should.
    """
    jacobian = found.jac[:, free]  # type: ignore[attr-defined]
    cost = float(2 * found.cost)  # type: ignore[attr-defined]
    covariance = np.linalg.pinv(jacobian.T @ jacobian)
    excess = max(1.0, cost / max(len(jacobian) - len(free), 1))
    at = names.index("slope") + 1 if "slope" in names else -1
    own = covariance[free.index(at), free.index(at)] if at in free else 0.0
    bend = names.index("bend") + 1 if "bend" in names else -1
    vague = covariance[free.index(bend), free.index(bend)] if bend in free else 0.0
    return replace(
        fit,
        bend_uncertainty=min(math.sqrt(float(vague) * excess), math.log(3)),
        uncertainty=math.sqrt(float(own) * excess),
        level_uncertainty=math.sqrt(float(covariance[0, 0]) * excess),
        cost=cost,
    )


def _fits(part: Binned, fit: Fit, scatter: float) -> bool:
    """Returns whether bins follow a fit within their scatter and what is tolerated."""
    ratio = part.density / fit.density(part.frequency)
    weight = 1 / (CORRELATION * scatter / part.count + TOLERATED**2)
    deviance = 2 * weight * (ratio - 1 - np.log(ratio))
    return bool(deviance.mean() < MEAN_DEVIANCE and deviance.max() < LARGEST_DEVIANCE)


def _inertial(part: Binned, best: Fit, scatter: float, lowest: float) -> Inertial:
    """Returns the inertial range within a fitted part; without C^2 if it is not inertial."""
    above = _above_bend(part, best)
    own = chosen(above, scatter, None, best) or best
    # Below the bend the law may be another, above it slope and bend stand for each other: the
    # larger uncertainty holds where there is a choice, and their mean square is told.
    vague = max(own.vagueness, best.vagueness)
    told = math.hypot(own.uncertainty, best.uncertainty) / math.sqrt(2)
    own = replace(own, vagueness=vague, uncertainty=told)
    fixed = chosen(above, scatter, KOLMOGOROV_SLOPE, best) or own
    whole = chosen(part, scatter, KOLMOGOROV_SLOPE, rolls=(bool(best.roll),))
    if whole is not None and whole.level_uncertainty > fixed.level_uncertainty:
        fixed = replace(fixed, level_uncertainty=whole.level_uncertainty)
    reason = _not_inertial(own)
    limits = _limits(above, own if reason else fixed, lowest)
    best, reason = own, reason or _narrow(own, limits)
    found = Inertial(
        limits=limits,
        structure_constant=None if reason else fixed.level / ONE_SIDED_CYCLES,
        noise=best.floor,
        bend=fixed.bend,
        roll_m=fixed.roll,
        slope=best.mean_slope,
        slope_uncertainty=best.uncertainty,
        level_uncertainty=fixed.level_uncertainty,
        fitted=(float(above.frequency[0]), float(above.frequency[-1])),
        fixed=own if reason else fixed,
        reason=reason,
        whole=(float(above.frequency[0]), float(above.frequency[-1])),
    )
    return found if reason or not fixed.roll else _below_roll(above, found)


def _below_roll(part: Binned, found: Inertial) -> Inertial:
    """Returns a range with C^2 of its straight part alone: no sensor's law is known beyond."""
    found = replace(found, fitted=found.limits)
    constant = level_of(part, found)
    fixed = replace(found.fixed, level=constant * ONE_SIDED_CYCLES)
    return replace(found, structure_constant=constant, fixed=fixed)


def _above_bend(part: Binned, best: Fit) -> Binned:
    """Returns the bins above a spectrum's bend: below it no law says how the air shall be."""
    low = min(ABOVE_BEND * best.bend, float(part.frequency[-1]) / WIDE)
    return part.part(low, float(part.frequency[-1])) if best.bend else part


def _limits(part: Binned, fit: Fit, lowest: float) -> tuple[float, float]:
    """Returns the limits of a straight line within a fit: above the bend, above the floor, seen.

    A range whose limits would cross has none: both are the same then.
    """
    xi = part.frequency
    low = max(float(xi[0]), ABOVE_BEND * fit.bend, lowest)
    good = fit.line(xi) > fit.floor
    if fit.roll:
        good &= xi < BELOW_ROLL / fit.roll
    good &= xi >= low
    if not good.any():
        return low, low
    return float(xi[good][0]), float(xi[good][-1])


def _not_inertial(fit: Fit) -> str:
    """Returns why a slope is not that of an inertial range, or no text if it may be."""
    told = f"a slope of {fit.mean_slope:.3f} +- {fit.uncertainty:.3f}"
    if departs(fit.mean_slope, fit.vagueness):
        steep = fit.mean_slope < KOLMOGOROV_SLOPE
        cause = "a slow sensor, or a tube before it?" if steep else "noise, or no turbulence?"
        return f"{told}, where an inertial range has -1.667: {cause}"
    if fit.uncertainty > (VAGUEST_ROLLED if fit.roll else VAGUEST):
        slow = ", of a slow sensor perhaps" if fit.roll else ""
        return f"{told}, too uncertain to tell an inertial range{slow}"
    return ""


def departs(slope: float, uncertainty: float) -> bool:
    """Returns whether a slope is not that of an inertial range."""
    departure = abs(slope - KOLMOGOROV_SLOPE)
    return departure > DEPARTURE and departure > DEVIATIONS * uncertainty


def _narrow(fit: Fit, limits: tuple[float, float]) -> str:
    """Returns that a range is too narrow, or no text."""
    width = limits[1] / limits[0]
    if width >= NARROWEST:
        return ""
    rest = " before the response falls: a slow sensor?" if fit.roll else ""
    told = f"the spectrum is straight over a factor of {width:.2g} only"
    return f"{told}, and {NARROWEST:g} are due{rest}"


def level_of(spectrum: Binned, found: Inertial) -> float:
    """Returns C^2 of a spectrum of a part of the record, by the shape found for all of it.

    It is the level in the fitted range whose likelihood is largest, by one step of scoring.
    """
    part = spectrum.part(*found.fitted)
    if not len(part.frequency):
        return math.nan
    signal = found.fixed.density(part.frequency) - found.fixed.floor
    share = signal / (signal + found.fixed.floor)
    weight = part.count * share**2
    ratio = (part.density - found.fixed.floor) / signal
    return float(np.sum(weight * ratio) / np.sum(weight) * found.fixed.level / ONE_SIDED_CYCLES)


def like(spectrum: Binned, found: Inertial, scatter: float) -> Fit | None:
    """Returns the fit to another signal's spectrum in the same range, with the same kinds."""
    part = replace(spectrum, nyquist=found.fixed.nyquist).part(*found.whole)
    fit = chosen(part, scatter, KOLMOGOROV_SLOPE, found.fixed)
    if fit is None:
        return None
    constant = level_of(spectrum, as_inertial(found, fit))
    return replace(fit, level=constant * ONE_SIDED_CYCLES) if constant > 0 else None


def slope_of(spectrum: Binned, found: Inertial, scatter: float) -> tuple[float, float]:
    """Returns the free slope of a part of the record and its uncertainty, with the parts found."""
    part = replace(spectrum, nyquist=found.fixed.nyquist).part(*found.whole)
    kind = ("floor",) * bool(found.fixed.floor) + ("roll",) * bool(found.roll_m)
    fit = _fit(part, kind, scatter, None, found.bend)
    return (fit.slope, fit.uncertainty) if fit else (math.nan, math.inf)


def as_inertial(found: Inertial, fit: Fit) -> Inertial:
    """Returns a range with the fit of another signal in it, whose level is looked for."""
    return replace(found, fixed=fit)


def none(spectrum: Binned, nyquist: float, scatter: float) -> Inertial:
    """Returns what a spectrum without any power law has: a slope through all of it, no C^2."""
    part = spectrum.part(float(spectrum.frequency[0]), nyquist / 2)
    fit = _fit(part, (), scatter, None) or Fit(
        float(np.mean(part.density)), 0.0, 0.0, 0.0, 0.0, math.inf, math.inf, math.inf
    )
    low = float(part.frequency[0])
    reason = f"no part of the spectrum is a power law over a factor of {NARROWEST:g}"
    return Inertial(
        (low, low), None, 0.0, 0.0, 0.0, fit.slope, fit.uncertainty, fit.level_uncertainty,
        (low, float(part.frequency[-1])), fit, reason,
    )  # fmt: skip
