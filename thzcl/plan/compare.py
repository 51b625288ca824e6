"""Models to compare with: at which planes of an image each is valid, and what is told of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

from thzcl.air.expansion import possible
from thzcl.air.mean import NOWHERE, Air, Span
from thzcl.graph import Spec, Values, rewrite
from thzcl.paths.specs import TraceSpec
from thzcl.sensing.exposures import Beam, Exposure
from thzcl.sensing.image import ComparedSpec
from thzcl.sensing.spectrum import Spectrum


@dataclass(frozen=True)
class Rival:
    """The air by a model to compare with, the planes at which it is valid, and why not at others.

    `planes` are numbers of the image's planes; `why` is empty where the model is valid at all.
    """

    model: str
    air: Air
    planes: tuple[int, ...]
    why: str

    def within(
        self, spectrum: Spectrum, humidity_span: Span = NOWHERE, temperature_span: Span = NOWHERE
    ) -> Rival:
        """Returns the model with those of its planes at which it is valid for all of some air.

        The spans bound delta and the temperature's departure from the mean in K. A band that lies
        partly outside is left out whole.
        """
        spans = possible(self.air, humidity_span), temperature_span
        whys = {plane: self.air.lacking(spectrum.nodes_of(plane), *spans) for plane in self.planes}
        planes = tuple(plane for plane, why in whys.items() if why is None)
        why = next((why for why in whys.values() if why is not None), self.why)
        return replace(self, planes=planes, why=why)

    def note(self, count: int) -> str | None:
        """Returns what is told of an image of `count` planes, or None if nothing is left out."""
        missing = count - len(self.planes)
        if not missing:
            return None
        where = f" at {missing} of {count} frequencies" if self.planes else ""
        return f'compare = "{self.model}" is left out{where}: {self.why}'


def rivals(compared: Mapping[str, Air], spectrum: Spectrum) -> tuple[Rival, ...]:
    """Returns the models to compare with, at the planes at which they hold the mean air."""
    every = tuple(range(spectrum.count))
    return tuple(Rival(name, air, every, "").within(spectrum) for name, air in compared.items())


def beside(spec: ComparedSpec) -> ComparedSpec:
    """Returns a spec whose paths are those of what it is compared with, and settle nothing."""

    def change(one: Spec) -> Spec:
        return one.beside() if isinstance(one, TraceSpec) else one

    (found,) = rewrite([spec], change)
    return cast("ComparedSpec", found)


def in_planes(taken: list[Exposure], planes: tuple[int, ...]) -> list[Exposure]:
    """Returns exposures at some planes of the image alone."""

    def only(beam: Beam) -> Beam:
        return replace(beam, plane_hz=Values.of(beam.plane_hz.array[list(planes)]))

    return [one._replace(beam=only(one.beam), own=only(one.own)) for one in taken]
