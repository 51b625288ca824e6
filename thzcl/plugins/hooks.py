"""The hooks on which plugin modules name what they bring."""

from __future__ import annotations

import pluggy

hookspec = pluggy.HookspecMarker("thzcl")


@hookspec
def register_sensors() -> list[type]:
    """Returns the sensor classes of a module, each a subclass of thzcl.sensor.Sensor."""
    raise NotImplementedError


@hookspec
def register_constituents() -> list[type]:
    """Returns a module's classes of constituents, subclasses of thzcl.constituent.Constituent."""
    raise NotImplementedError
