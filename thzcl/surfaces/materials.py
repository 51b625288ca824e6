"""What surfaces are made of, as laws of reflection: from the tables of a scene to mirrors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from thzcl import files
from thzcl.air import permittivity
from thzcl.errors import FileError
from thzcl.graph import Values
from thzcl.scenario.materials import LAWS, Cover, Material, library
from thzcl.surfaces.fresnel import coherent_share, fresnel
from thzcl.surfaces.mirrors import Constant, Mirror, View

Array = NDArray[np.float64]
Locate = Callable[[str], Path]

FROM_GHZ = 100.0  # rows that begin there or above are used beyond their ends, to twice or half
BEYOND = 2.0
ROUNDING = 1e-9


@dataclass(frozen=True)
class Columns:
    """Quantities over frequency, from a file: `frequency_hz` (row,) ascends."""

    name: str  # of the file
    frequency_hz: Values
    quantities: tuple[tuple[str, Values], ...]

    def at(self, quantity: str, frequency_hz: Array) -> Array:
        """Returns a quantity at some frequencies, linear between rows, of the same shape."""
        values = dict(self.quantities)[quantity].array
        return np.asarray(np.interp(frequency_hz, self.frequency_hz.array, values))

    @property
    def names(self) -> tuple[str, ...]:
        """Returns the names of the quantities."""
        return tuple(name for name, _ in self.quantities)

    @property
    def range_ghz(self) -> tuple[float, float]:
        """Returns the lowest and the highest frequency, GHz."""
        hz = self.frequency_hz.array
        return float(hz[0]) / 1e9, float(hz[-1]) / 1e9


@dataclass(frozen=True)
class Substance:
    """A material without its roughness: rows of keys that hold at different frequencies.

    `table` holds what the file of its only row says.
    """

    name: str
    rows: tuple[Material, ...]
    table: Columns | None = None

    @property
    def by_permittivity(self) -> bool:
        """Returns whether it has a permittivity, rather than a reflectivity."""
        if self.table is not None:
            return "reflectivity" not in self.table.names
        return self.rows[0].reflectivity is None

    def permittivity(self, frequency_hz: Array, temperature_k: float) -> NDArray[np.complex128]:
        """Returns the permittivity at some frequencies, of the same shape."""
        if self.table is not None:
            real, imaginary = (
                self.table.at(name, frequency_hz) for name in ("permittivity_re", "permittivity_im")
            )
            return np.asarray(real + 1j * imaginary)
        found = np.empty(np.shape(frequency_hz), np.complex128)
        chosen = self._chosen(frequency_hz)
        for number, row in enumerate(self.rows):
            some = chosen == number
            if some.any():
                found[some] = _law(row, frequency_hz[some], temperature_k)
        return found

    def reflectivity(self, frequency_hz: Array) -> Array:
        """Returns the reflectivity of one that has no permittivity, of the same shape."""
        if self.table is not None:
            return self.table.at("reflectivity", frequency_hz)
        return np.full(np.shape(frequency_hz), self.rows[0].reflectivity)

    def _chosen(self, frequency_hz: Array) -> NDArray[np.intp]:
        """Returns the row that counts at some frequencies: the first that holds one, or nearest."""
        ghz = np.asarray(frequency_hz) / 1e9
        away = [_away(row.range_ghz, ghz) for row in self.rows]
        return np.asarray(np.argmin(away, axis=0))

    def beyond(self, frequency_hz: Array) -> tuple[str | None, str | None]:
        """Returns why it cannot be used at some frequencies, and what to tell of others.

        Each is None if there is nothing to say.
        """
        ghz = np.unique(np.asarray(frequency_hz)) / 1e9
        ranges = [self.table.range_ghz] if self.table else [row.range_ghz for row in self.rows]
        if None in ranges:
            return None, None
        known = [one for one in ranges if one is not None]
        words = " and ".join(f"{low:g} to {high:g} GHz" for low, high in known)
        away = np.min([_away(one, ghz) for one in known], axis=0)
        far = np.array([self.table is not None or not _stretches(known, one) for one in ghz])
        outside = away > 1 + ROUNDING
        if (outside & far).any():
            worst = ghz[outside & far][np.argmax(away[outside & far])]
            return f"{worst:g} GHz: known at {words}; give a law or a file that holds there", None
        if outside.any():
            worst = ghz[outside][np.argmax(away[outside])]
            return None, f"{worst:g} GHz: known at {words}; beyond, it is extrapolated"
        return None, None


def _away(span: tuple[float, float] | None, ghz: Array) -> Array:
    """Returns by what factor frequencies lie outside a range; 1 within it, and without one."""
    if span is None:
        return np.ones_like(ghz)
    return np.maximum(np.maximum(span[0] / ghz, ghz / span[1]), 1.0)


def _stretches(ranges: list[tuple[float, float]], ghz: float) -> bool:
    """Returns whether the range that counts at a frequency may be used there."""
    nearest = min(ranges, key=lambda one: float(_away(one, np.array(ghz))))
    away = float(_away(nearest, np.array(ghz)))
    return away <= 1 + ROUNDING or (nearest[0] >= FROM_GHZ and away <= BEYOND * (1 + ROUNDING))


def _law(row: Material, frequency_hz: Array, temperature_k: float) -> NDArray[np.complex128]:
    """Returns the permittivity by one row, of the frequencies' shape."""
    if row.model == "water":
        return permittivity.water(frequency_hz, temperature_k)
    if row.model == "ice":
        return permittivity.ice(frequency_hz, temperature_k)
    if row.model == "debye" and row.eps_inf and row.delta_eps and row.tau_ps:
        return permittivity.debye(frequency_hz, row.eps_inf, row.delta_eps, row.tau_ps)
    if row.model == "p2040" and row.a:
        return permittivity.building(frequency_hz, row.a, row.b or 0, row.c or 0, row.d or 0)
    if row.model == "conductor" and row.conductivity_s_m:
        return permittivity.conductor(frequency_hz, row.conductivity_s_m)
    assert row.permittivity is not None  # noqa: S101 (Material has exactly one of these)
    return np.full(np.shape(frequency_hz), complex(*row.permittivity))


@dataclass(frozen=True)
class Covering:
    """A thin layer over a surface: what it lets through and what it scatters back, by frequency."""

    transmission: float
    scattering: float
    temperature_k: float | None
    table: Columns | None = None

    def at(self, frequency_hz: Array) -> tuple[Array, Array]:
        """Returns transmission and reflectivity, each of the frequencies' shape."""
        if self.table is not None:
            transmission = self.table.at("transmission", frequency_hz)
            return transmission, self.table.at("reflectivity", frequency_hz)
        shape = np.shape(frequency_hz)
        return np.full(shape, self.transmission), np.full(shape, self.scattering)

    def beyond(self, frequency_hz: Array) -> str | None:
        """Returns why it cannot be used at some frequencies, or None."""
        return None if self.table is None else _outside(self.table, frequency_hz)


def _outside(table: Columns, frequency_hz: Array) -> str | None:
    """Returns that some frequencies lie outside a file's, or None."""
    low, high = table.range_ghz
    ghz = np.asarray(frequency_hz) / 1e9
    away = _away((low, high), ghz)
    if not (away > 1 + ROUNDING).any():
        return None
    worst = ghz[np.argmax(away)]
    return f"{worst:g} GHz: {table.name} holds {low:g} to {high:g} GHz; give rows there"


@dataclass(frozen=True)
class Plain(Constant):
    """A rough surface that reflects the same part at every angle, under a cover."""

    cover: Covering | None = None


@dataclass(frozen=True)
class Face(Mirror):
    """A face of some substance, which mirrors a share of what it reflects and scatters the rest."""

    substance: Substance
    temperature_k: float
    roughness_m: float
    polarized: bool
    slope: float | None = None
    cover: Covering | None = None
    angular: ClassVar[bool] = True
    mirrored: ClassVar[bool] = True
    view: ClassVar[View] = "scattered"

    def reflectivity(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the reflectivity for unpolarised light, in the arguments' common shape."""
        across, within = self._both(frequency_hz, cosine)
        return (across + within) / 2

    def polarization(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns R_s - R_p in the arguments' common shape."""
        across, within = self._both(frequency_hz, cosine)
        return across - within

    def share(self, frequency_hz: Array, cosine: Array) -> Array:
        """Returns the mirrored share of what is reflected, in the arguments' common shape."""
        return coherent_share(self.roughness_m, frequency_hz, cosine)

    def _both(self, frequency_hz: Array, cosine: Array) -> tuple[Array, Array]:
        """Returns R_s and R_p in the arguments' common shape."""
        if not self.substance.by_permittivity:
            one = self.substance.reflectivity(frequency_hz)
            shape = np.broadcast_shapes(np.shape(frequency_hz), np.shape(cosine))
            return np.broadcast_to(one, shape), np.broadcast_to(one, shape)
        eps = self.substance.permittivity(frequency_hz, self.temperature_k)
        return fresnel(eps, cosine)


@dataclass(frozen=True)
class Workshop:
    """What makes laws of reflection from the keys of a scene's things.

    `own` are the scene's materials by name, `locate` returns the path of a file that they name, and
    `polarized` says whether the camera sees one polarisation.
    """

    own: Mapping[str, Material]
    locate: Locate
    polarized: bool
    air_k: float

    def law(
        self,
        material: str | None,
        reflectivity: float,
        cover: Cover | None,
        temperature_k: float | None,
    ) -> Mirror:
        """Returns the law of a surface. Raises FileError for a file that cannot be used."""
        covering = None if cover is None else self.covering(cover)
        if material is None:
            return Constant(reflectivity) if covering is None else Plain(reflectivity, covering)
        kelvin = self.air_k if temperature_k is None else temperature_k
        return replace(self.face(material), temperature_k=kelvin, cover=covering)

    def face(self, name: str) -> Face:
        """Returns a face of a material, at the temperature of the air and without a cover."""
        row = self.own.get(name) or Material(model=name)
        roughness_m = (row.roughness_mm or 0.0) / 1e3
        return Face(self._substance(name, row), self.air_k, roughness_m, self.polarized, row.slope)

    def _substance(self, name: str, row: Material) -> Substance:
        """Returns the substance that a table means, with its file read."""
        if row.file is not None:
            return Substance(name, (row,), _optical_columns(self.locate(row.file)))
        if row.model is not None and row.model in library():
            rows = library()[row.model].rows
            if row.range_ghz is not None and row.model in LAWS:
                rows = tuple(one.model_copy(update={"range_ghz": row.range_ghz}) for one in rows)
            return Substance(name, rows)
        return Substance(name, (row,))

    def covering(self, cover: Cover) -> Covering:
        """Returns a cover. Raises FileError for a file that cannot be used."""
        if cover.file is None:
            return Covering(cover.transmission or 0.0, cover.reflectivity, cover.temperature_k)
        table = _cover_columns(self.locate(cover.file))
        return Covering(0.0, 0.0, cover.temperature_k, table)


def _optical_columns(path: Path) -> Columns:
    """Returns a file of a material over frequency. Raises FileError."""
    read = _read(path)
    choices = ("permittivity_re", "permittivity_im"), ("reflectivity",)
    wanted = next((names for names in choices if all(name in read for name in names)), None)
    if wanted is None or len(read.keys() & {"permittivity_re", "reflectivity"}) > 1:
        text = "needs columns permittivity_re and permittivity_im, or reflectivity"
        raise FileError(f"{path}: {text}; name them in the first line")
    if "permittivity_im" in wanted:
        _refuse(path, read["permittivity_im"] >= 0, "permittivity_im must not be negative: a loss")
        size = np.hypot(read["permittivity_re"], read["permittivity_im"])
        _refuse(path, size >= 1e-3, "permittivity must not be 0")
    else:
        _refuse_fractions(path, read["reflectivity"], "reflectivity")
    return _columns(path, read, wanted)


def _cover_columns(path: Path) -> Columns:
    """Returns a file of a cover over frequency. Raises FileError."""
    read, wanted = _read(path), ("transmission", "reflectivity")
    for name in wanted:
        if name not in read:
            raise FileError(f"{path}: no column {name}; name it in the first line")
        _refuse_fractions(path, read[name], name)
    _refuse(path, read["reflectivity"] < 1, "reflectivity must be below 1")
    together = read["transmission"] + read["reflectivity"]
    _refuse(path, together <= 1 + 1e-12, "transmission and reflectivity exceed 1 together")
    return _columns(path, read, wanted)


def _read(path: Path) -> dict[str, Array]:
    """Returns the columns of a file over frequency. Raises FileError."""
    read = files.read_columns(path)
    if "frequency_ghz" not in read:
        raise FileError(f"{path}: no column frequency_ghz; name it in the first line")
    ghz = read["frequency_ghz"]
    _refuse(path, ghz > 0, "frequency_ghz must be above 0")
    _refuse(path, np.diff(ghz, prepend=0.0) > 0, "frequency_ghz must ascend; sort the rows")
    return read


def _refuse_fractions(path: Path, values: Array, name: str) -> None:
    """Raises FileError unless all values are from 0 to 1."""
    _refuse(path, (values >= 0) & (values <= 1), f"{name} must lie between 0 and 1")


def _refuse(path: Path, good: NDArray[np.bool_], words: str) -> None:
    """Raises FileError with the first row that is not good."""
    if not good.all():
        raise FileError(f"{path}: row {int(np.argmin(good)) + 1} of numbers: {words}")


def _columns(path: Path, read: Mapping[str, Array], wanted: tuple[str, ...]) -> Columns:
    """Returns the wanted columns."""
    hz = Values.of(read["frequency_ghz"] * 1e9)
    return Columns(path.name, hz, tuple((name, Values.of(read[name])) for name in wanted))


def faces(laws: tuple[Mirror, ...]) -> Iterator[Face]:
    """Yields one face for each substance and roughness among some laws."""
    seen = set()
    for law in laws:
        if isinstance(law, Face):
            one = law.substance, law.roughness_m, law.slope
            if one not in seen:
                seen.add(one)
                yield law


def mean_reflectivity(law: Mirror, frequency_hz: Array, points: int = 32) -> Array:
    """Returns the part of diffuse light that a face reflects, (frequency,): 2 int R(mu) mu dmu."""
    node, weight = np.polynomial.legendre.leggauss(points)
    mu = (node + 1) / 2
    rows = law.reflectivity(frequency_hz[:, None], mu)
    return np.asarray(rows @ (weight * mu))
