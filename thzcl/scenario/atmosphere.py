"""The air of a scene: its mean state, and how it fluctuates."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from thzcl.air import humidity as humidities
from thzcl.air.composition import Part
from thzcl.air.mean import Air
from thzcl.scenario.constituents import parts
from thzcl.scenario.problems import Trouble
from thzcl.scenario.table import Table, User, Vector, key

NO_LOGNORMAL = (
    'is for Gaussian humidity; remove it, or set distribution = "gaussian" or a sigma below 30 %'
)
AirKelvin = Annotated[float, Field(ge=100, le=400)]


class Fluctuations(Table):
    """Turbulent fluctuations of humidity, and of temperature where a size is given for it."""

    at_most_one: ClassVar = (
        ("sigma_percent", "structure_constant_q"),
        ("temperature_sigma_k", "structure_constant_t"),
    )
    used_by: ClassVar = {
        "large_scales": User(("spectrum",), ("kolmogorov", "von-karman")),
        "sigma_of": User(("sigma_percent", "temperature_sigma_k")),
        "distribution": User(("spectrum",), ("kolmogorov", "von-karman", "table")),
        "grid": User(("spectrum",), ("kolmogorov", "von-karman", "table")),
        "periodic": User(("spectrum",), ("file",)),
        "time_index": User(("spectrum",), ("file",)),
        "correlation_tq": User(("temperature_sigma_k", "structure_constant_t")),
    }

    spectrum: Literal["kolmogorov", "von-karman", "table", "file"] = key(
        "kolmogorov", help='power spectrum; "table" reads a measured one, "file" a whole cube'
    )
    file: str | None = key(
        None,
        help="NetCDF file with absolute_humidity(z, y, x) in g/m3; or, for a table, CSV of spatial "
        "frequency in cycles/m and one-sided density along a line in (g/m3)^2 m",
    )
    sigma_percent: float | None = key(
        None, ge=0, le=300, unit="%", help="standard deviation of humidity over its mean"
    )
    structure_constant_q: float | None = key(
        None,
        ge=0,
        le=1e6,
        unit="g^2 m^-6 m^-2/3",
        help="C_q^2: the structure function of humidity is C_q^2 r^(2/3)",
    )
    outer_scale_m: float | None = key(
        None, ge=1e-4, le=1e7, unit="m", help="outer scale of the von Karman spectrum"
    )
    distribution: Literal["auto", "gaussian", "lognormal"] = key(
        "auto", help="gaussian (clipped at dry air) below a sigma of 30 %, lognormal from there on"
    )
    sigma_of: Literal["cube", "ensemble"] = key(
        "cube",
        help="whose standard deviations are given: cube rescales each cube to them exactly; with "
        "ensemble they are expectations, as structure constants are, and single cubes scatter",
    )
    large_scales: bool = key(
        False,
        help="eddies larger than the cube too, as plane waves in closed form; sigma and C^2 are "
        "those of the cube",
    )
    voxel_m: float | None = key(None, ge=1e-4, le=1e5, unit="m", help="edge of a voxel")
    grid: int = key(
        128, ge=16, le=512, help="voxels along an edge of the periodic cube, a power of two"
    )
    seed: int | None = key(
        None, ge=0, lt=2**63, help="seed of the random numbers; one is drawn and recorded if absent"
    )
    grid_orientation: Literal["oblique", "aligned"] | None = key(
        None,
        help="the cube's axes against the world's; oblique, but for a cube from a file aligned",
    )
    temperature_sigma_k: float | None = key(
        None, ge=0, le=50, unit="K", help="standard deviation of air temperature"
    )
    structure_constant_t: float | None = key(
        None, ge=0, le=1e6, unit="K^2 m^-2/3", help="C_T^2 of air temperature"
    )
    wind_m_s: Vector = key(
        (0.0, 0.0, 0.0), help="wind that carries the cube along, frozen [x, y, z]", unit="m/s"
    )
    periodic: tuple[bool, bool, bool] | None = key(
        None,
        help="whether a cube from a file repeats along x, y and z; as the file says, else x and y, "
        "and z too where it has no coordinates",
    )
    time_index: int | None = key(
        None, ge=0, help="which time of a cube from a file with several is taken, from 0"
    )
    correlation_tq: float = key(0.0, ge=-1, le=1, help="correlation of temperature and humidity")

    @property
    def orientation(self) -> Literal["oblique", "aligned"]:
        """Returns how the cube's axes lie against the world's.

        A cube from a file stands upright unless it is said otherwise.
        """
        if self.grid_orientation is not None:
            return self.grid_orientation
        return "aligned" if self.spectrum == "file" else "oblique"

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        found = []
        if self.grid & (self.grid - 1):
            text = f"must be a power of two from 16 to 512, not {self.grid}"
            found.append(self.trouble("grid", text))
        if self.spectrum == "von-karman" and self.outer_scale_m is None:
            found.append(Trouble((), 'spectrum = "von-karman" needs outer_scale_m'))
        if self.spectrum != "von-karman" and self.outer_scale_m is not None:
            text = 'is used by spectrum = "von-karman" only; remove it or change spectrum'
            found.append(self.trouble("outer_scale_m", text))
        if (self.spectrum in ("file", "table")) != (self.file is not None):
            text = 'spectrum = "file" or "table" and file = "..." go together'
            found.append(self.trouble("spectrum", text))
        if self.spectrum == "file" and (self.temperature_sigma_k or self.structure_constant_t):
            text = "a cube from a file brings its own temperature (air_temperature) or none"
            found.append(self.trouble("spectrum", text))
        if self.spectrum != "file" and self.voxel_m is None:
            found.append(Trouble((), "needs voxel_m, the edge of a voxel in m"))
        for name, least in (("temperature_sigma_k", 1e-9), ("structure_constant_t", 1e-18)):
            size = getattr(self, name)
            if size and size < least:  # the fit in temperature would lose all its digits
                found.append(self.trouble(name, f"must be 0 or at least {least:g}, not {size:g}"))
        return found + self._strength_troubles() + self._troubles_of_large_scales()

    def _troubles_of_large_scales(self) -> list[Trouble]:
        """Returns that eddies larger than the cube have no closed form in the air asked for."""
        if not self.large_scales:
            return []
        found = []
        if self.temperature_sigma_k or self.structure_constant_t:
            text = "is for air of one temperature; remove it, or let temperature not fluctuate"
            found.append(self.trouble("large_scales", text))
        if self.distribution == "lognormal":
            found.append(self.trouble("large_scales", NO_LOGNORMAL))
        return found

    def _strength_troubles(self) -> list[Trouble]:
        """Returns what is wrong with the keys that say how much humidity fluctuates.

        A cube from a file says it itself, and so does a table unless it is rescaled.
        """
        names = ("sigma_percent", "structure_constant_q")
        given = [name for name in names if getattr(self, name) is not None]
        if self.spectrum == "file" and given:
            return [self.trouble(given[0], "is given by the cube; remove it")]
        if self.spectrum == "table" and "structure_constant_q" in given:
            text = "is given by the table; remove it, or rescale with sigma_percent"
            return [self.trouble("structure_constant_q", text)]
        if self.spectrum not in ("file", "table") and not given and self.file is None:
            return [Trouble((), "needs one of sigma_percent, structure_constant_q or file")]
        return []


class AirProfile(Table):
    """Mean humidity and temperature by height, such as those over a warm or a moist ground."""

    file: str = key(
        min_length=1,
        help="CSV file: height_m or height_km, temperature_k or temperature_degc, and "
        "absolute_humidity_g_m3, relative_humidity_percent or vapour_pressure_hpa",
    )


def _optional(schema: dict[str, Any]) -> None:
    """Lets a scene leave out the temperature, which a profile can give."""
    schema["required"].remove("temperature_k")


class Atmosphere(Table):
    """The mean air, what is in it, and how it fluctuates.

    Any other key is the name of a constituent, whose parameters stand in its table.
    """

    # A key may begin with model_, which pydantic would like to keep for itself.
    model_config = Table.model_config | {
        "extra": "allow",
        "protected_namespaces": (),
        "json_schema_extra": _optional,
    }
    exactly_one: ClassVar = (("relative_humidity_percent", "absolute_humidity_g_m3"),)

    temperature_k: AirKelvin = key(help="mean air temperature", unit="K")
    pressure_hpa: float = key(1013.25, gt=0, le=2000, help="total pressure", unit="hPa")
    relative_humidity_percent: float | None = key(
        None, ge=0, le=1e6, unit="%", help="mean humidity relative to saturation over water"
    )
    absolute_humidity_g_m3: float | None = key(
        None, ge=0, le=1e6, unit="g/m3", help="mean absolute humidity"
    )
    model: str = key("mpm93", help="gas that absorbs, as `thzcl constituents` lists them")
    model_file: str | None = key(
        None, min_length=1, help='NetCDF file of a model that is a table, as "table"'
    )
    compare: tuple[str, ...] = key(
        (), help="other gases by which contrast and depth are told too; the image is model's"
    )
    fluctuations: Fluctuations | None = key(
        None, help="turbulence; leave the table out for uniform air"
    )

    profile: AirProfile | None = key(
        None, help="mean air by height; temperature and humidity may then be left out"
    )

    @property
    def air(self) -> Air:
        """Returns the mean air with its constituents, whose tables must be sound."""
        return self._of(self.model)

    @property
    def compared(self) -> dict[str, Air]:
        """Returns the same air by each model to compare with, by the model's name."""
        return {model: self._of(model) for model in self.compare}

    def _of(self, model: str) -> Air:
        """Returns the air whose gas is that of a model."""
        return self._holding(parts(model, self.model_file, self.model_extra or {}))

    def _holding(self, constituents: tuple[Part, ...]) -> Air:
        """Returns air of the mean state."""
        grams = self.absolute_humidity_g_m3
        if grams is None:
            vapour = humidities.vapour_pressure_from_relative(
                self.relative_humidity_percent, self.temperature_k
            )
            grams = float(humidities.absolute_humidity(vapour, self.temperature_k))
        return Air(constituents, self.temperature_k, self.pressure_hpa, grams)

    def troubles(self) -> list[Trouble]:  # noqa: D102 (Table's)
        found, flow = [], self.fluctuations
        if self.profile is not None and flow is not None:
            for odd, text in (
                (flow.spectrum == "file", "a cube from a file holds its own mean air by height"),
                (flow.large_scales, "does not go with fluctuations.large_scales"),
            ):
                if odd:
                    found.append(self.trouble("profile", f"{text}; remove one of the two"))
        vapour, total = self._holding(()).vapour_pressure_hpa, self.pressure_hpa
        if vapour <= total:
            return found
        names = ("relative_humidity_percent", "absolute_humidity_g_m3")
        given = next(name for name in names if getattr(self, name) is not None)
        text = f"makes a vapour pressure of {vapour:.4g} hPa, more than the total of {total:g} hPa"
        return [*found, self.trouble(given, f"{text}; lower it")]
