"""The devices that OpenCL sees, and what is known of each before it is opened."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from thzcl.device import cache, library, pocl
from thzcl.device.binding import cl, start


@dataclass(frozen=True)
class DeviceInfo:
    """A device that OpenCL sees."""

    number: int
    platform: str
    name: str
    kind: str  # CPU, GPU or other
    driver: str
    memory_bytes: int
    library: str  # path of the shared library that serves the platform, or ""

    @property
    def description(self) -> str:
        """Returns the device's name with its driver's version and the name of its library."""
        told = self.driver, Path(self.library).name
        return f"{self.name} ({', '.join(filter(None, told))})"


def raw_devices() -> list[tuple[Any, DeviceInfo]]:
    """Returns every device of every platform, in OpenCL's order, with what is known of it.

    Raises DeviceError in a process that was forked after OpenCL had started.
    """
    start()
    cache.settle()
    pocl.set_environment()
    try:
        found = [device for platform in cl.get_platforms() for device in platform.get_devices()]
    except cl.Error:  # to OpenCL it is an error that there is no platform
        return []
    return [(device, _info(number, device)) for number, device in enumerate(found)]


def _info(number: int, device: Any) -> DeviceInfo:
    kinds = {cl.device_type.CPU: "CPU", cl.device_type.GPU: "GPU"}
    platform, version = device.platform, device.driver_version
    driver = " ".join(platform.version.partition(",")[0].removesuffix(version).split())
    return DeviceInfo(
        number=number,
        platform=platform.name,
        name=device.name.strip(),
        kind=next((name for flag, name in kinds.items() if device.type & flag), "other"),
        driver=f"{driver} {version}",
        memory_bytes=device.global_mem_size,
        library=library.path_of(platform.int_ptr),
    )
