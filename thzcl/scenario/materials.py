"""What things are made of and covered with: tables of a scenario, and the materials shipped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import Field

from thzcl.plugins.names import suggest
from thzcl.scenario.problems import Trouble
from thzcl.scenario.table import Fraction, Kelvin, Positive, Table, User, key
from thzcl.scenario.text import load

LIBRARY = Path(__file__).with_name("materials.toml")
Frequency = Annotated[float, Field(gt=0, le=1e6)]
Finite = Annotated[float, Field(ge=-1e9, le=1e9)]
LAWS = ("water", "ice")  # that need no other key
_OF_MODEL = {
    "debye": ("eps_inf", "delta_eps", "tau_ps"),
    "p2040": ("a", "b", "c", "d"),
    "conductor": ("conductivity_s_m",),
}


class Material(Table):
    """What a surface is made of: a permittivity, or a reflectivity, and how rough it is."""

    exactly_one: ClassVar = (("permittivity", "model", "reflectivity", "file"),)
    used_by: ClassVar = {"slope": User(("roughness_mm",))}

    permittivity: tuple[Finite, Annotated[float, Field(ge=0, le=1e12)]] | None = key(
        None, help="relative permittivity [real part, imaginary part], the latter >= 0 for a loss"
    )
    model: str | None = key(
        None,
        help="law of permittivity: debye, p2040 or conductor, whose keys follow, or the name of a "
        "material that comes with thzcl, as `thzcl materials` lists them",
    )
    reflectivity: Fraction | None = key(
        None, help="power reflectivity at every angle; a mirror, unless roughness_mm scatters it"
    )
    file: str | None = key(
        None,
        min_length=1,
        help="CSV of frequency_ghz with permittivity_re and permittivity_im, or with reflectivity",
    )
    eps_inf: Annotated[float, Field(ge=1, le=1e6)] | None = key(
        None, help="permittivity far above all relaxations"
    )
    delta_eps: tuple[Annotated[float, Field(ge=0, le=1e6)], ...] | None = key(
        None, min_length=1, max_length=8, help="what each relaxation adds to the permittivity"
    )
    tau_ps: tuple[Annotated[float, Field(gt=0, le=1e9)], ...] | None = key(
        None, min_length=1, max_length=8, help="time of each relaxation", unit="ps"
    )
    a: Annotated[float, Field(gt=0, le=1e6)] | None = key(
        None, help="real part at 1 GHz; it is a f^b with f in GHz"
    )
    b: Annotated[float, Field(ge=-4, le=4)] | None = key(None, help="its exponent")
    c: Annotated[float, Field(ge=0, le=1e9)] | None = key(
        None, help="conductivity at 1 GHz; it is c f^d with f in GHz", unit="S/m"
    )
    d: Annotated[float, Field(ge=-10, le=10)] | None = key(None, help="its exponent")
    conductivity_s_m: Positive | None = key(None, help="conductivity of a metal", unit="S/m")
    range_ghz: tuple[Frequency, Frequency] | None = key(
        None,
        help="frequencies [lowest, highest] at which it is known; one that begins at 100 GHz or "
        "above is used from half to twice its ends, with a warning",
        unit="GHz",
    )
    roughness_mm: float | None = key(
        None,
        ge=0,
        le=1e3,
        help="rms height of its roughness, which scatters what it does not mirror; 0 if absent",
        unit="mm",
    )
    slope: Annotated[float, Field(gt=1e-3, le=1)] | None = key(
        None,
        help="rms slope of its roughness along each axis: what an active sensor with "
        'spreading = "lambert" sees of the mirrored part',
    )

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        found = []
        if self.model is not None and self.model not in _known():
            text = f'no model "{self.model}" ({suggest(self.model, _known())})'
            found.append(self.trouble("model", text))
        for model, names in _OF_MODEL.items():
            given = [name for name in names if getattr(self, name) is not None]
            if self.model == model:
                missing = [name for name in names if name not in given]
                text = f'missing: model = "{model}" needs it'
                found += [self.trouble(name, text) for name in missing]
            else:
                text = f'belongs to model = "{model}"; remove it, or give that model'
                found += [self.trouble(name, text) for name in given]
        if self.delta_eps and self.tau_ps and len(self.delta_eps) != len(self.tau_ps):
            text = f"{len(self.tau_ps)} values, but delta_eps has {len(self.delta_eps)}"
            found.append(self.trouble("tau_ps", f"{text}; give as many"))
        if self.range_ghz is not None and self.range_ghz[0] >= self.range_ghz[1]:
            text = f"must ascend, not {list(self.range_ghz)}"
            found.append(self.trouble("range_ghz", text))
        if self.permittivity is not None and abs(complex(*self.permittivity)) < 1e-3:
            text = "must not be 0; air has [1, 0]"
            found.append(self.trouble("permittivity", text))
        return found


def _known() -> tuple[str, ...]:
    """Returns the names that `model` may have."""
    return (*_OF_MODEL, *shipped())


@cache
def shipped() -> Mapping[str, Any]:
    """Returns the text of the library as nested tables, by the name of the material."""
    return load(LIBRARY.read_text(encoding="utf-8"), str(LIBRARY))


class Cover(Table):
    """A thin layer over a surface, such as cloth, paint or a pane, with light going to and fro.

    What it reflects is scattered evenly; what it lets through goes straight on.
    """

    exactly_one: ClassVar = (("transmission", "file"),)
    at_most_one: ClassVar = (("reflectivity", "file"),)

    transmission: Fraction | None = key(None, help="part of the power that passes")
    reflectivity: Annotated[float, Field(ge=0, lt=1)] = key(
        0.0, help="part of the power that is scattered back; the rest is absorbed"
    )
    temperature_k: Kelvin | None = key(
        None, help="temperature, needed wherever emission is seen", unit="K"
    )
    file: str | None = key(
        None, min_length=1, help="CSV of frequency_ghz, transmission and reflectivity"
    )

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        total = (self.transmission or 0.0) + self.reflectivity
        if total <= 1 + 1e-12:
            return []
        text = f"{self.transmission:g} and reflectivity = {self.reflectivity:g} sum to {total:g}"
        return [self.trouble("transmission", f"{text}; they must not exceed 1")]


@dataclass(frozen=True)
class Shipped:
    """A material that comes with thzcl: rows that hold at different frequencies, and their source.

    Of the rows that hold a frequency the first counts, else that whose range is the nearest.
    """

    name: str
    about: str
    uncertainty: str
    source: str
    rows: tuple[Material, ...]


@cache
def library() -> Mapping[str, Shipped]:
    """Returns the materials that come with thzcl, by name."""
    return {
        name: Shipped(
            name,
            table["about"],
            table["uncertainty"],
            table["source"],
            tuple(Material.model_validate(_tuples(row)) for row in table["rows"]),
        )
        for name, table in shipped().items()
    }


def _tuples(row: Mapping[str, Any]) -> dict[str, Any]:
    """Returns a row with tuples in place of lists, and floats in place of whole numbers."""
    return {
        name: tuple(map(float, value)) if isinstance(value, list) else value
        for name, value in row.items()
    }


def unknown(name: str | None, own: Mapping[str, Material]) -> str | None:
    """Returns what is wrong with the name of a material, or None if a scene knows it."""
    if name is None or name in own or name in library():
        return None
    text = f'no material "{name}" ({suggest(name, [*own, *library()])})'
    return f"{text}; `thzcl materials` lists those shipped, [materials.{name}] makes one"
