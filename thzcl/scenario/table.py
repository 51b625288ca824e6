"""What every table of a scenario shares: unknown keys are errors, numbers are finite.

Nothing changes after reading.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Annotated, Any, ClassVar, NamedTuple, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic.functional_validators import ModelWrapValidatorHandler

from thzcl.scenario.problems import Trouble, listed, refusal, shown, translate


class User(NamedTuple):
    """What makes use of a key: one of some `keys` of its table, if it has one of some `values`.

    Without values it is enough that one of those keys is given.
    """

    keys: tuple[str, ...]
    values: tuple[str, ...] = ()

    def uses(self, table: BaseModel) -> bool:
        """Returns whether the key is used in a table."""
        if self.values:
            return any(getattr(table, name) in self.values for name in self.keys)
        return any(name in table.model_fields_set for name in self.keys)

    def __str__(self) -> str:
        named = " or ".join(self.keys)
        if not self.values:
            return f"is used with {named} only; remove it, or give that"
        values = " or ".join(map(shown, self.values))
        return f"is used by {named} = {values} only; remove it or change {named}"


class Table(BaseModel):
    """A table of the scenario, or a plugin's parameters.

    Whatever is wrong with it is found at once and put into words: what pydantic finds, the groups
    of keys below, and, where its values are sound, its `troubles`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    # Groups of keys of which exactly one, or at most one, may be given.
    exactly_one: ClassVar[tuple[tuple[str, ...], ...]] = ()
    at_most_one: ClassVar[tuple[tuple[str, ...], ...]] = ()
    # Keys that only others make use of. One that no variant of a scenario uses is told of.
    used_by: ClassVar[Mapping[str, User]] = {}

    def troubles(self) -> list[Trouble]:
        """Returns what is wrong with this table's values taken together, each of them being sound.

        Tables override it where there is something to say.
        """
        return []

    def unused(self) -> list[Trouble]:
        """Returns keys of this table, and of those within it, that are given and do nothing."""
        found = [
            Trouble((name,), str(user))
            for name, user in self.used_by.items()
            if getattr(self, name) != type(self).model_fields[name].default and not user.uses(self)
        ]
        for name in type(self).model_fields:
            value = getattr(self, name)
            tables = value if isinstance(value, Mapping) else {"": value}
            for inner, table in tables.items():
                if isinstance(table, Table):
                    path = (name, inner) if inner else (name,)
                    found += [trouble.below(*path) for trouble in table.unused()]
        return found

    @staticmethod
    def trouble(name: str, text: str) -> Trouble:
        """Returns what is wrong with one key, for `troubles`."""
        return Trouble((name,), text)

    @model_validator(mode="wrap")
    @classmethod
    def _in_words(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        found = cls._misgrouped(data) if isinstance(data, Mapping) else []
        try:
            table = handler(data)
        except ValidationError as error:
            raise refusal(cls.__name__, found + translate(error, cls.model_fields, data)) from None
        if not found:
            found = table._sound_troubles()  # noqa: SLF001 (its own)
        if found:
            raise refusal(cls.__name__, found)
        return table

    @classmethod
    def _misgrouped(cls, data: Mapping[str, Any]) -> list[Trouble]:
        """Returns the groups of which no key, or more than one, is given."""
        found = []
        for group in (*cls.exactly_one, *cls.at_most_one):
            given = [name for name in group if name in data]
            if len(given) > 1:
                found.append(Trouble((given[-1],), f"give only one of {listed(group)}"))
            elif not given and group in cls.exactly_one:
                found.append(Trouble((), f"needs one of {listed(group)}"))
        return found

    def _sound_troubles(self) -> list[Trouble]:
        """Returns `troubles`; what a plugin's method raises is not taken for a user's mistake."""
        try:
            return list(self.troubles())
        except (ValueError, AssertionError) as error:  # pydantic would take these two for one
            raise RuntimeError(f"troubles() raised {type(error).__name__}: {error}") from error

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: Any, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Returns the JSON Schema, the groups of keys included."""
        schema = handler(core_schema)
        rules: list[dict[str, Any]] = [
            {"oneOf": [{"required": [name]} for name in group]} for group in cls.exactly_one
        ]
        for group in cls.at_most_one:
            rules += [{"not": {"required": list(pair)}} for pair in combinations(group, 2)]
        if rules:
            handler.resolve_ref_schema(schema)["allOf"] = rules
        return schema


def key(default: Any = ..., *, unit: str = "", help: str, **limits: Any) -> Any:  # noqa: A002
    """Returns a key of a table: its default (none: required), unit, meaning and limits.

    Limits are pydantic's: gt, ge, lt, le, min_length and so on.
    """
    return Field(
        default, description=help, json_schema_extra={"unit": unit} if unit else None, **limits
    )


Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]  # squares and cubes of it stay finite
Vector = tuple[Coordinate, Coordinate, Coordinate]
Positive = Annotated[float, Field(gt=0, le=1e12)]
LensMillimetres = Annotated[float, Field(ge=1e-6, le=1e9)]
Kelvin = Annotated[float, Field(ge=0, le=1e19)]
Fraction = Annotated[float, Field(ge=0, le=1)]
