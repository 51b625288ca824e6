"""What every table of a scenario shares: unknown keys are errors, numbers are finite.

Nothing changes after reading.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from thzcl.scenario.problems import Trouble


class Table(BaseModel):
    """A table of the scenario, or a sensor's parameters."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    # Groups of keys of which exactly one, or at most one, may be given.
    exactly_one: ClassVar[tuple[tuple[str, ...], ...]] = ()
    at_most_one: ClassVar[tuple[tuple[str, ...], ...]] = ()

    def troubles(self) -> list[Trouble]:
        """What is wrong with this table's values taken together.

        Overridden where there is something to say.
        """
        return []

    @staticmethod
    def trouble(name: str, text: str) -> Trouble:
        """What is wrong with one key, for troubles()."""
        return Trouble((name,), text)


def key(default: Any = ..., *, unit: str = "", help: str, **limits: Any) -> Any:  # noqa: A002 (what it is)
    """A key of a table: its default (none: required), unit, meaning, and pydantic's limits (gt.

    Ge, lt, le, ...).
    """
    return Field(
        default, description=help, json_schema_extra={"unit": unit} if unit else None, **limits
    )


Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Kelvin = Annotated[float, Field(ge=0, le=1e19)]
Fraction = Annotated[float, Field(ge=0, le=1)]
