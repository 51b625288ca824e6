"""The frequencies that a sensor sees: each for itself, or summed over bands."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.device.opencl import Device
from thzcl.graph import Values, frozen
from thzcl.paths import shade
from thzcl.paths.shade import Shaded
from thzcl.paths.trace import Paths
from thzcl.sensor import Needs
from thzcl.surfaces.radiance import Sources, Table

Array = NDArray[np.float64]


@frozen
class Frequencies:
    """Single frequencies."""

    nodes_hz: Values  # (frequency,)

    @property
    def count(self) -> int:
        """Returns how many planes an image has."""
        return self.nodes_hz.shape[0]

    def nodes_of(self, plane: int) -> Array:
        """Returns the frequencies that a plane is made of, (node,) in Hz."""
        return np.asarray(self.nodes_hz.array[plane : plane + 1])

    def only(self, planes: tuple[int, ...]) -> Frequencies:
        """Returns the frequencies of some planes alone."""
        return Frequencies(Values.of(self.nodes_hz.array[list(planes)]))

    def planes(self, values: Any) -> Any:
        """Returns values by frequency, (frequency, ...), as they are."""
        return values

    def asked(self) -> Array | None:
        """Returns None: there are no weights."""
        return None

    def sum_by_ray(self, values: Array) -> Array:
        """Returns values (ray, frequency) as they are."""
        return values

    def shade(
        self,
        device: Device,
        paths: Paths,
        coefficients: Array,
        sources: Sources,
        sent: Table,
        precision: str,
    ) -> Shaded:
        """Returns depth and contrast, (frequency, ray); `coefficients` (frequency, power), 1/m."""
        del sources
        return shade.shade(device, paths, coefficients, sent, precision)

    def mean_depth(self, depth: Array, sources: Sources) -> Array:
        """Returns the depth by frequency, (frequency, ray), as it is."""
        del sources
        return depth

    def faintest_depth(self, ratio: Array, absorption: Array) -> float:
        """Returns the depth, at the thinnest frequency, behind which nothing is worth its share.

        `ratio` (frequency,) is what surfaces send over what may be lost, `absorption` (frequency,)
        that of the mean air, 1/m.
        """
        seen = ratio > 0
        thinness = np.divide(
            absorption.min(), absorption, out=np.ones_like(absorption), where=absorption > 0
        )
        return float((np.log(ratio[seen]) * thinness[seen]).max())


@frozen
class Bands:
    """Sums over frequency, one for each band."""

    nodes_hz: Values  # (frequency,)
    given: Values  # (band, frequency): the weights as the sensor gave them

    @property
    def count(self) -> int:
        """Returns how many planes an image has."""
        return self.given.shape[0]

    @property
    def weights(self) -> Array:
        """Returns the weights with rows of sum 1, (band, frequency)."""
        return np.asarray(self.given.array / self.given.array.sum(axis=1, keepdims=True))

    def nodes_of(self, plane: int) -> Array:
        """Returns the frequencies that a plane is made of, (node,) in Hz."""
        return np.asarray(self.nodes_hz.array[self.given.array[plane] != 0])

    def only(self, planes: tuple[int, ...]) -> Bands:
        """Returns some of the bands alone, with the frequencies that they are made of."""
        given = self.given.array[list(planes)]
        used = (given != 0).any(axis=0)
        return Bands(Values.of(self.nodes_hz.array[used]), Values.of(given[:, used]))

    def planes(self, values: Any) -> Any:
        """Returns the bands' means of values by frequency, (frequency, ...) to (band, ...)."""
        return self.weights @ values

    def asked(self) -> Array | None:
        """Returns the weights as the sensor gave them, (band, frequency)."""
        return self.given.array

    def sum_by_ray(self, values: Array) -> Array:
        """Returns the bands' means of values (ray, frequency), (ray, band)."""
        return np.asarray(values @ self.weights.T)

    def shade(
        self,
        device: Device,
        paths: Paths,
        coefficients: Array,
        sources: Sources,
        sent: Table,
        precision: str,
    ) -> Shaded:
        """Returns depth and contrast, (band, ray); `coefficients` (frequency, power), 1/m."""
        weights = self.weights
        passing = sources.passing(weights, self.nodes_hz.array)
        return shade.shade_bands(device, paths, coefficients, sent, weights, passing, precision)

    def mean_depth(self, depth: Array, sources: Sources) -> Array:
        """Returns the depth of the bands' mean transmission, (band, ray).

        `depth` is (frequency, ray); neither thin nor deep air loses its digits.
        """
        rows = sources.passing(self.weights, self.nodes_hz.array)
        return np.array([_depth_of_mean(row, depth) for row in rows])

    def faintest_depth(self, ratio: Array, absorption: Array) -> float:
        """Returns the depth, at the thinnest frequency, behind which nothing is worth its share.

        `ratio` (band,) is what surfaces send over what may be lost.
        """
        del absorption
        return float(np.log(ratio).max())


Spectrum = Frequencies | Bands


def _depth_of_mean(weights: Array, depth: Array) -> Array:
    """Returns the depth of the mean of exp(-depth), with weights of sum 1 along the first axis.

    Neither thin nor deep air loses its digits.
    """
    least = depth[weights > 0].min(axis=0).astype(np.float64)
    beyond = np.minimum(least - depth, 0.0)
    lost = np.tensordot(weights, -np.expm1(beyond), 1)
    # Of the two sums that which is the smaller part of 1 has the digits.
    small = np.log1p(-np.minimum(lost, 0.5))
    large = np.log(np.tensordot(weights, np.exp(beyond), 1))
    return np.asarray(least - np.where(lost < 0.5, small, large))


WIDEST = 1.2  # highest over lowest frequency of a band that is blurred with one point spread


@frozen
class Split:
    """Bands, and the parts of them that rays are seen in.

    Optics blur each part with a point spread of its own, since that is as wide as the wavelength.
    """

    whole: Spectrum
    parts: Spectrum
    band: tuple[int, ...]  # number of the band that each part belongs to

    @classmethod
    def of(cls, whole: Spectrum, *, blurred: bool) -> Split:
        """Returns the parts of wide bands that are blurred; other spectra are their own parts."""
        if not blurred or not isinstance(whole, Bands):
            return cls(whole, whole, ())
        cut = [_narrow(whole.nodes_hz.array, row) for row in whole.given.array]
        band = tuple(number for number, rows in enumerate(cut) for _ in rows)
        if len(band) == whole.count:
            return cls(whole, whole, ())
        rows = [row for rows in cut for row in rows]
        return cls(whole, Bands(whole.nodes_hz, Values.of(rows)), band)

    def parts_of(self, planes: tuple[int, ...]) -> tuple[int, ...]:
        """Returns the numbers of the parts of some bands."""
        if not self.band:
            return planes
        return tuple(part for part, band in enumerate(self.band) if band in planes)

    def only(self, planes: tuple[int, ...]) -> Split:
        """Returns some of the bands alone, with their parts."""
        whole, parts = self.whole.only(planes), self.parts.only(self.parts_of(planes))
        return Split(whole, parts, tuple(planes.index(b) for b in self.band if b in planes))

    def contrast(self, planes: NDArray[Any]) -> NDArray[Any]:
        """Returns the contrast of the bands from that of their parts, both (plane, ...)."""
        if not isinstance(self.whole, Bands) or not self.band:
            return planes
        return np.tensordot(self._shares(self.whole.weights), planes, 1)

    def depth(self, planes: NDArray[Any], sources: Sources) -> NDArray[Any]:
        """Returns the depth of the bands' mean transmission from that of their parts."""
        if not isinstance(self.whole, Bands) or not self.band:
            return planes
        passing = sources.passing(self.whole.weights, self.whole.nodes_hz.array)
        return np.array([_depth_of_mean(row, planes) for row in self._shares(passing)])

    def _shares(self, weights: Array) -> Array:
        """Returns what each part weighs in each band, (band, part), of weights (band, node)."""
        assert isinstance(self.parts, Bands)  # noqa: S101 (bands are cut into bands)
        inside = self.parts.given.array > 0
        mine = np.arange(len(weights))[:, None] == np.array(self.band)
        return np.asarray((weights @ inside.T) * mine)


def _narrow(nodes_hz: Array, weights: Array) -> list[Array]:
    """Returns a band's weights (node,) cut into parts that are no wider than WIDEST."""
    held = nodes_hz[weights > 0]
    low, high = float(held.min()), float(held.max())
    number = max(1, int(np.ceil(np.log(high / low) / np.log(WIDEST) - 1e-9)))
    if number == 1:
        return [weights]
    place = np.log(nodes_hz / low) / np.log(high / low) * number
    part = np.clip(place.astype(int), 0, number - 1)
    rows = [np.where(part == one, weights, 0.0) for one in range(number)]
    return [row for row in rows if row.any()]


def spectrum(needs: Needs) -> Spectrum:
    """Returns what a sensor asks for."""
    nodes = Values.of(needs.frequency_hz)
    if needs.weights is None:
        return Frequencies(nodes)
    return Bands(nodes, Values.of(np.atleast_2d(np.asarray(needs.weights, dtype=np.float64))))


def finer(needs: Needs) -> Spectrum | None:
    """Returns a sensor's bands summed far more finely, if it knows them."""
    if needs.finer is None:
        return None
    frequency_hz, weights = (np.asarray(values, dtype=np.float64) for values in needs.finer)
    return Bands(Values.of(frequency_hz), Values.of(np.atleast_2d(weights)))
