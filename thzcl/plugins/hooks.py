"""The one hook: a plugin module names its sensors."""

from __future__ import annotations

import pluggy

hookspec = pluggy.HookspecMarker("thzcl")


@hookspec
def register_sensors() -> list[type]:
    """The sensor classes of this module, each a subclass of thzcl.sensor.Sensor."""
    raise NotImplementedError
