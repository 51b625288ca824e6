"""What is in the air: the public contract between thzcl and its constituents, version 1.

A constituent is a class with a `name`, the version of the `contract` it was written for, its
parameters `Params`, a manual page as docstring, and `optics()`:

    from thzcl.constituent import Constituent, OpticalProperties, Parameters, hookimpl, parameter

    class Dust(Constituent):
        \"\"\"Grey dust.\"\"\"

        name = "dust"
        contract = 1
        varies = False

        class Params(Parameters):
            per_km: float = parameter(0.5, ge=0, unit="1/km", help="absorption")

        def optics(self, frequency_hz, temperature_k, pressure_hpa, vapour_hpa):
            return OpticalProperties(absorption=self.params.per_km / 1e3)

    @hookimpl
    def register_constituents():
        return [Dust]

A scene puts it into its air with a table [atmosphere.dust], whatever gas `model` chooses. A
constituent marked `gas = True` is one that `model` chooses. It never sees OpenCL, files or the
scene: it is a pure function of frequency and state, in float64. What gases that are sums over
spectral lines have in common stands at the end, and so does what falls as spheres. `thzcl
new-constituent NAME` writes a package around such a class that can be installed as it is.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import pluggy
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

from thzcl.air import particles
from thzcl.air.humidity import relative_humidity, wet_bulb_temperature
from thzcl.air.particles import Permittivity, Sizes, spread_sizes
from thzcl.air.permittivity import snow as snow_permittivity
from thzcl.air.permittivity import water as water_permittivity
from thzcl.errors import FileError
from thzcl.scenario.table import Table as Parameters
from thzcl.scenario.table import key as parameter

__all__ = [
    "CONTRACT",
    "DB_KM_PER_INVERSE_METRE",
    "Attenuation",
    "Constituent",
    "File",
    "FileError",
    "Grid",
    "OpticalProperties",
    "Parameters",
    "Permittivity",
    "Sizes",
    "Span",
    "file_parameter",
    "hookimpl",
    "line_blocks",
    "line_table",
    "moist_air",
    "parameter",
    "relative_humidity",
    "snow_permittivity",
    "sphere_optics",
    "spread_sizes",
    "water_permittivity",
    "wet_bulb_temperature",
]

CONTRACT = 1
DB_KM_PER_INVERSE_METRE = 1e4 / np.log(10.0)  # 4342.9448
Array = NDArray[np.float64]
hookimpl = pluggy.HookimplMarker("thzcl")

# Keys of [atmosphere], and the constituents of weather that thzcl brings along.
RESERVED_NAMES = frozenset(
    {
        *("temperature_k", "pressure_hpa", "relative_humidity_percent", "absolute_humidity_g_m3"),
        *("model", "model_file", "compare", "fluctuations", "profile", "rain", "fog", "snow"),
    }
)


@dataclass(frozen=True)
class OpticalProperties:
    """What a constituent does to light: numbers, or arrays that broadcast with the arguments.

    `absorption` and `scattering` are coefficients of power in 1/m, `backscatter` is in 1/m/sr.
    `legendre` holds the moments of the phase function, the means of P_l over it, along its first
    axis. `temperature_k` is that of the constituent, where it is not the air's. `parts` splits the
    absorption up by name, as into that of dry air and of vapour.

    What scatters, or has a temperature of its own, adds light to what is seen through it, in
    plane layers from the ground up to the constituent's `layer_top_m`.
    """

    absorption: ArrayLike
    scattering: ArrayLike = 0.0
    legendre: ArrayLike | None = None
    backscatter: ArrayLike = 0.0
    temperature_k: ArrayLike | None = None
    parts: Mapping[str, ArrayLike] | None = None


class Span(NamedTuple):
    """A range in which a constituent is valid, its ends included.

    `words` say what ends there. Outside of `warn`, where that is given, users are told what
    `beyond` says, or else that the absorption is an extrapolation. A value that misses an end by a
    billionth of it counts as inside.
    """

    quantity: Literal["frequency_ghz", "temperature_k", "pressure_hpa", "vapour_hpa"]
    least: float
    most: float
    words: str = ""
    warn: tuple[float, float] | None = None
    beyond: str = ""


@dataclass(frozen=True)
class Grid:
    """What a NetCDF-4 file holds for a constituent: a variable over axes, all with their units.

    `axes` are the names of the variable's dimensions with the units in which their coordinates
    arrive, in the order in which the array arrives; `attributes` are numbers that the variable or
    else the file carries as attributes of these names. Values outside of `least` to `most` are
    refused, in the unit in which they arrive.
    """

    variable: str
    unit: str
    axes: tuple[tuple[str, str], ...]
    attributes: tuple[str, ...] = ()
    least: float = -np.inf
    most: float = np.inf

    def __call__(self, schema: dict[str, Any]) -> None:
        """Adds nothing to a parameter's JSON Schema, in which it is a text."""


@dataclass(frozen=True)
class File:
    """A file among the parameters of a constituent, named by its path from the scenario's folder.

    What the constituent's `params` hold has been read: `arrays` are those of the parameter's Grid
    by name, variable and axes, in its units, float64 and read-only; `attributes` its numbers.
    """

    name: str
    path: Path | None = None
    digest: str = ""  # SHA-256 of the file's bytes
    arrays: Mapping[str, Array] = field(default_factory=dict, compare=False, repr=False)
    attributes: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Returns how a text, as it stands in TOML, becomes a file."""
        del source, handler
        text = core_schema.str_schema(strict=True, min_length=1)
        return core_schema.no_info_after_validator_function(cls, text)


def file_parameter(holds: Grid, default: Any = ..., *, help: str) -> Any:  # noqa: A002
    """Returns a parameter that names a NetCDF-4 file: what that holds, and what it means.

    The parameter's type is File, or `File | None` with a default of None.
    """
    return Field(default, description=help, json_schema_extra=holds)


class Constituent(ABC):
    """Base of every constituent; `params` holds its validated table.

    `varies` says whether the optics depend on temperature or humidity: what does not costs no path
    moment, and is asked for the mean air alone. `gas` marks what [atmosphere] `model` chooses
    among. `valid` holds the ranges in which the optics may be asked for. `layer_top_m` says how far
    up the sky holds what is no gas, in m; it is asked for at the scene's air up to there. Both may
    be properties.
    """

    name: ClassVar[str]
    contract: ClassVar[int]
    Params: ClassVar[type[Parameters]]
    varies: bool = True
    gas: ClassVar[bool] = False
    valid: tuple[Span, ...] = ()
    layer_top_m: float = 1000.0

    def __init__(self, params: Any) -> None:
        self.params = params

    @abstractmethod
    def optics(
        self, frequency_hz: Array, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array
    ) -> OpticalProperties:
        """Returns the optics at frequencies above 0 and states of the air, all of which broadcast.

        `pressure_hpa` is the total pressure, vapour included. The arrays are read-only, and not
        spread out to their common shape: what depends on a few of them is computed once.
        """

    def lines(
        self, temperature_k: float, pressure_hpa: float, vapour_hpa: float
    ) -> tuple[ArrayLike, float]:
        """Returns where spectral lines stand, in Hz, ascending, and about how wide they are, in Hz.

        Sums over a band look for lines there that they could not see otherwise.
        """
        del temperature_k, pressure_hpa, vapour_hpa
        return (), np.inf

    def notes(self, temperature_k: Array, pressure_hpa: Array, vapour_hpa: Array) -> Sequence[str]:
        """Returns what to tell of it in air of some states, which broadcast; each in a sentence."""
        del temperature_k, pressure_hpa, vapour_hpa
        return ()

    def alternatives(self) -> Sequence[Parameters]:
        """Returns other parameters that might describe the same, as other laws of drop sizes do.

        Spectra show how far apart they are.
        """
        return ()


# --- gases that are sums over spectral lines -----------------------------------------------------


@dataclass(frozen=True)
class Attenuation:
    """The specific attenuation of dry air and of water vapour (lines and continuum), in dB/km.

    Both arrays have the shape to which the inputs broadcast.
    """

    dry_db_km: Array
    vapour_db_km: Array

    @property
    def total_db_km(self) -> Array:
        """Returns the specific attenuation of moist air, dB/km."""
        return self.dry_db_km + self.vapour_db_km

    @property
    def total_per_m(self) -> Array:
        """Returns the absorption coefficient of power, 1/m."""
        return np.asarray(self.total_db_km / DB_KM_PER_INVERSE_METRE)

    def optics(self) -> OpticalProperties:
        """Returns the absorption, in parts of dry air and of vapour."""
        return OpticalProperties(
            self.total_per_m,
            parts={
                "dry": self.dry_db_km / DB_KM_PER_INVERSE_METRE,
                "vapour": self.vapour_db_km / DB_KM_PER_INVERSE_METRE,
            },
        )


def moist_air(
    frequency_ghz: ArrayLike,
    temperature_k: ArrayLike,
    pressure_hpa: ArrayLike,
    vapour_hpa: ArrayLike,
) -> tuple[Array, Array, Array, Array]:
    """Returns frequency and state as float64 arrays that have the same number of axes.

    They are not spread out to their common shape: what depends on a few of them is computed once.
    `pressure_hpa` is the total pressure. Raises ValueError for a temperature that is not above 0 K,
    and for a vapour pressure outside 0 to the total pressure.
    """
    given = (frequency_ghz, temperature_k, pressure_hpa, vapour_hpa)
    arrays = [np.asarray(x, dtype=np.float64) for x in given]
    axes = max(x.ndim for x in arrays)
    f, t, p, e = (x.reshape((1,) * (axes - x.ndim) + x.shape) for x in arrays)
    if not np.all((t > 0) & (e >= 0) & (e <= p)):
        raise ValueError(
            "temperature must be above 0 K, and vapour pressure between 0 and the total pressure"
        )
    return f, t, p, e


@cache
def line_table(module: str, name: str) -> Array:
    """Returns the numbers of a CSV file, (line, column); its comments and header are skipped.

    The file of that name lies beside `module`, which is a constituent's own __file__. A comment
    begins with "#", and the first line that is none is the header.
    """
    text = Path(module).with_name(name).read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line and not line.startswith("#")][1:]
    return np.array([[float(cell) for cell in row.split(",")] for row in rows])


def line_blocks(table: Array, shape: tuple[int, ...]) -> Iterator[Array]:
    """Yields the columns of a line table, (column, line, 1, ...), block by block of lines.

    A block is small enough for the cache, and its columns broadcast against (line, *shape).
    """
    count = min(len(table), 1 + math.prod(shape) * len(table) // 50_000)
    for block in np.array_split(table, count):
        yield block.T.reshape(block.shape[1], -1, *(1,) * len(shape))


# --- what falls as spheres -----------------------------------------------------------------------


def sphere_optics(
    frequency_hz: Array, temperature_k: Array, permittivity: Permittivity, sizes: Sizes
) -> OpticalProperties:
    """Returns the optics of spheres of one substance by Mie's theory, at a temperature of theirs.

    `permittivity` is a function of frequency in Hz and temperature in K. Without any spheres the
    optics are those of nothing, and nothing is computed.
    """
    if not np.any(sizes.per_m3):
        return OpticalProperties(absorption=0.0)
    found = particles.spheres(frequency_hz, temperature_k, permittivity, sizes)
    return OpticalProperties(
        np.maximum(found.extinction - found.scattering, 0.0),
        scattering=found.scattering,
        legendre=found.legendre,
        backscatter=found.backscatter,
        temperature_k=temperature_k,
    )
