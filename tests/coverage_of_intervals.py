"""Known truths by Monte Carlo: how often intervals of d', area and probability hold the truth.

    python tests/coverage_of_intervals.py [TRIALS]

Each trial draws 100 airs of a flat scene, half to learn and half to test, as `thzcl range` does. It
asks whether the nominal 95 % intervals hold the truth of the observer that was learnt.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.stats import f, gamma, norm

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, not an installed thzcl

from thzcl import metrics
from thzcl.studies.detection import intervals
from thzcl.studies.detection.observer import CELLS, HOTELLING, Training

SIZE, AIRS, FALSE_ALARM = 24, 100, 0.01
TRUTHS = ("d_prime", "area", "probability")


def disc():
    y, x = np.indices((SIZE, SIZE)) - SIZE / 2
    return (np.hypot(x, y) < 4.0).astype(float)


def red(variance):
    """Clutter that falls as k^-11/3, as path-averaged humidity's does."""
    k = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.fftfreq(SIZE))
    falling = np.where(k > 0, np.maximum(k, 1e-9) ** (-11 / 3), 0.0)
    return falling * variance / falling.mean()


def drawn(rng, spectrum):
    return np.fft.ifft2(np.fft.fft2(rng.normal(size=(SIZE, SIZE))) * np.sqrt(spectrum)).real


class Gaussian:
    """White noise of variance 1, and clutter of a known spectrum that all draws in an air share."""

    kind, active = HOTELLING, False

    def __init__(self, clutter, strength):
        self.clutter, self.signal = clutter, strength * disc()

    def air(self, rng):
        """Returns what all draws in one air share."""
        return drawn(rng, self.clutter)

    def image(self, rng, air, there):
        """Returns a draw of the noise in an air, with the target or without."""
        return air + rng.normal(size=(SIZE, SIZE)) + there * self.signal

    def truths(self, observer):
        """Returns what d', area and probability of an observer truly are."""
        spectrum = 1.0 + self.clutter
        d_prime = metrics.template_d_prime(observer.template, self.signal, spectrum)
        probability = norm.cdf(d_prime - norm.isf(FALSE_ALARM))
        return d_prime, norm.cdf(d_prime / np.sqrt(2)), probability


class Speckle:
    """Speckle of known looks, white from pixel to pixel: nothing else varies."""

    kind, active, looks = CELLS, True, 4

    def __init__(self, ratio):
        self.power, self.ratio = 1 + (ratio - 1) * disc() * 1.0, ratio

    def air(self, rng):
        """Returns what all draws in one air share."""
        del rng
        return 1.0

    def image(self, rng, air, there):
        """Returns a draw of the noise in an air, with the target or without."""
        return air * (self.power if there else 1.0) * rng.gamma(self.looks, 1 / self.looks,
                                                                (SIZE, SIZE))  # fmt: skip

    def truths(self, observer):
        """Returns what d', area and probability of an observer truly are."""
        on, off = (observer.template > 0) & (disc() > 0), (observer.template > 0) & (disc() == 0)
        assert not off.any() and (on == (disc() > 0)).all()  # the template is the target's cells
        shape, q = self.looks * on.sum(), self.ratio
        d_prime = (q - 1) / np.sqrt((1 + q**2) / 2 / shape)
        threshold = gamma.isf(FALSE_ALARM, shape)
        return d_prime, f.cdf(q, 2 * shape, 2 * shape), gamma.sf(threshold / q, shape)


def trial(world, seed):
    """The intervals of one trial, the truths, and what the threshold came from."""
    rng, training = np.random.default_rng(seed), Training()
    for _ in range(AIRS // 2):
        air, again = world.air(rng), rng.integers(2**63)
        there, gone = (world.image(np.random.default_rng(again), air, t) for t in (True, False))
        training.add(there, gone, world.image(rng, air, False))
    observer = training.observer(world.kind, random=not world.active)
    draws = intervals.draws_needed(AIRS // 2, FALSE_ALARM, observer.shared)
    tail = intervals.EMPIRICAL
    if draws is None:
        draws, tail = 4, intervals.GAMMA if world.active else intervals.NORMAL
    null, present = np.empty((2, AIRS // 2, draws))
    for row in range(AIRS // 2):
        air = world.air(rng)
        for out, there in ((null, False), (present, True)):
            out[row] = [observer.statistic(world.image(rng, air, there)) for _ in range(draws)]
    often = intervals.counts(AIRS // 2, seed)
    found = intervals.detect(null, present, FALSE_ALARM, tail, often, observer.sign)
    return found, world.truths(observer), tail


def held(world, trials):
    """How often each interval held its truth, the means of the truths, and the thresholds."""
    hits, truths, tails = Counter(), [], Counter()
    for seed in range(trials):
        found, known, tail = trial(world, seed)
        tails[tail] += 1
        truths.append(known)
        for name, truth in zip(TRUTHS, known, strict=True):
            _, low, high = getattr(found, name)
            hits[name] += low <= truth <= high
    return hits, np.mean(truths, axis=0), tails


WORLDS = {
    **{f"white noise, {s:g}": Gaussian(np.zeros((SIZE, SIZE)), s) for s in (0.15, 0.33, 0.5)},
    **{f"red clutter, {s:g}": Gaussian(red(1.0), s) for s in (0.3, 0.55, 0.8)},
    **{f"speckle, {q:g}": Speckle(q) for q in (1.1, 1.18, 1.27)},
}

if __name__ == "__main__":
    count = int(sys.argv[1]) if sys.argv[1:] else 200
    for label, world in WORLDS.items():
        hits, truths, tails = held(world, count)
        told = ", ".join(
            f"{n} {hits[n]} (truth {t:.3f})" for n, t in zip(TRUTHS, truths, strict=True)
        )
        print(f"{label}: of {count} trials {told}; thresholds {dict(tails)}", flush=True)
