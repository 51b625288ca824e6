"""The air of a scene: constituents about one mean state, and the sum of what they absorb."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thzcl.air import composition, humidity, validity
from thzcl.air.composition import Part
from thzcl.errors import RangeError

Array = NDArray[np.float64]
Span = tuple[float, float]
NOWHERE: Span = (0.0, 0.0)


@dataclass(frozen=True)
class Air:
    """The mean air: its constituents, temperature, total pressure and absolute humidity."""

    parts: tuple[Part, ...]
    temperature_k: float
    pressure_hpa: float
    absolute_humidity_g_m3: float

    @property
    def vapour_pressure_hpa(self) -> float:
        """Returns the vapour pressure of the mean air, hPa."""
        return float(
            humidity.vapour_pressure_from_absolute(self.absolute_humidity_g_m3, self.temperature_k)
        )

    @property
    def relative_humidity_percent(self) -> float:
        """Returns the relative humidity of the mean air over water, per cent."""
        return float(humidity.relative_humidity(self.vapour_pressure_hpa, self.temperature_k))

    @property
    def most_vapour(self) -> float:
        """Returns the largest delta that the total pressure admits: that of vapour alone."""
        if self.absolute_humidity_g_m3 == 0:
            return 0.0
        return self.pressure_hpa / self.vapour_pressure_hpa - 1

    @property
    def names(self) -> str:
        """Returns the names of the constituents, as "mpm93 + dust"."""
        return " + ".join(part.name for part in self.parts)

    @property
    def varies(self) -> bool:
        """Returns whether what the air absorbs depends on humidity or temperature."""
        return any(composition.made(part).varies for part in self.parts)

    def located(self, locate: Callable[[str], Path]) -> Air:
        """Returns this air with the files of its constituents found, and read once.

        Raises FileError for files that cannot be used, and whatever `locate` raises.
        """
        parts = tuple(composition.located(part, locate) for part in self.parts)
        return replace(self, parts=parts)

    def without_nothing(self, frequency_hz: Array) -> Air:
        """Returns this air without what is no gas and does nothing, such as rain of 0 mm/h."""
        state = self.temperature_k, self.pressure_hpa, self.vapour_pressure_hpa
        kept = []
        for part in self.parts:
            if not composition.constituent_class(part.name).gas:
                found = composition.optical_properties(part, frequency_hz, *state)
                varies = composition.made(part).varies
                if not (varies or np.any(found.absorption) or np.any(found.scattering)):
                    continue
            kept.append(part)
        return self if len(kept) == len(self.parts) else replace(self, parts=tuple(kept))

    def absorption(self, frequency_hz: Any, delta: Any = 0.0, offset_k: Any = 0.0) -> Array:
        """Returns what the air takes from light, in 1/m of its power; the arguments broadcast.

        That is what it absorbs, and what is scattered where something falls: the extinction.

        `delta` is the humidity fluctuation rho / rho_mean - 1, at least -1. `offset_k` is the
        temperature's departure from the mean in kelvin, at constant total pressure. Vapour pressure
        is limited to the total pressure. A constituent that does not vary is asked for the mean air
        alone. Raises RangeError where a constituent is not valid, and PluginError or PluginFailure
        for one that cannot be used.
        """
        hz = np.asarray(frequency_hz, dtype=np.float64)
        kelvin, vapour = self._state(delta, offset_k)
        total = np.zeros(np.broadcast_shapes(hz.shape, np.shape(vapour)))
        for part in self.parts:
            state = (kelvin, vapour) if composition.made(part).varies else self._state(0.0, 0.0)
            of_part = composition.optical_properties(
                part, hz, state[0], self.pressure_hpa, state[1]
            )
            total += np.asarray(of_part.absorption)
            if np.any(of_part.scattering):
                total += np.asarray(of_part.scattering)
        return total

    def _state(self, delta: Any, offset_k: Any) -> tuple[Array, Array]:
        """Returns temperature in K and vapour pressure in hPa."""
        kelvin = self.temperature_k + np.asarray(offset_k, dtype=np.float64)
        vapour = humidity.vapour_pressure_from_absolute(
            self.absolute_humidity_g_m3 * (1 + np.asarray(delta)), kelvin
        )
        return np.asarray(kelvin), np.clip(vapour, 0.0, self.pressure_hpa)

    def lines(self) -> tuple[Array, float]:
        """Returns where the lines of all constituents stand, and the width of the narrowest, Hz."""
        state = self.temperature_k, self.pressure_hpa, self.vapour_pressure_hpa
        found = [composition.lines(part, *state) for part in self.parts]
        positions = np.sort(np.concatenate([np.empty(0), *(lines for lines, _ in found)]))
        return positions, min((width for lines, width in found if len(lines)), default=np.inf)

    def refuse_beyond(
        self,
        frequency_hz: Array | None = None,
        humidity_span: Span = NOWHERE,
        temperature_span: Span = NOWHERE,
    ) -> None:
        """Raises RangeError where a constituent does not hold the frequencies or what air becomes.

        The spans bound delta and the temperature's departure from the mean in K.
        """
        coldest = self.temperature_k + temperature_span[0]
        if coldest <= 0:
            text = f"the air's temperature would fall to {coldest:.4g} K"
            remedy = "lower temperature_sigma_k or structure_constant_t"
            raise RangeError(f"{text}; {remedy}", "temperature_k", coldest)
        for part, asked in self._asked(frequency_hz, humidity_span, temperature_span):
            composition.refuse(part, asked)

    def lacking(
        self, frequency_hz: Array, humidity_span: Span, temperature_span: Span
    ) -> str | None:
        """Returns in words why refuse_beyond() would raise, or None if it would not."""
        asked = self._asked(frequency_hz, humidity_span, temperature_span)
        found = (composition.lacking(part, ranges) for part, ranges in asked)
        return next(filter(None, found), None)

    def notes(self, frequency_hz: Array, humidity_span: Span, temperature_span: Span) -> list[str]:
        """Returns what to tell of constituents that extrapolate, or hardly occur in such air."""
        beyond = [
            note
            for part, asked in self._asked(frequency_hz, humidity_span, temperature_span)
            for note in validity.notes(part.name, composition.made(part).valid, asked)
        ]
        mean = self.temperature_k, self.pressure_hpa, self.vapour_pressure_hpa
        return beyond + [note for part in self.parts for note in composition.notes(part, *mean)]

    def _asked(
        self, frequency_hz: Array | None, humidity_span: Span, temperature_span: Span
    ) -> Iterator[tuple[Part, validity.Ranges]]:
        """Yields each constituent with the ranges for which the air asks it."""
        frequency = {} if frequency_hz is None else {"frequency_ghz": frequency_hz / 1e9}
        spans = np.array(humidity_span)[:, None], np.array(temperature_span)
        for part in self.parts:
            made = composition.made(part)
            kelvin, vapour = self._state(*(spans if made.varies else (0.0, 0.0)))
            state = {"temperature_k": kelvin, "vapour_hpa": vapour}
            pressure = {"pressure_hpa": self.pressure_hpa}
            yield part, validity.ranges(made.limited, **frequency, **state, **pressure)
