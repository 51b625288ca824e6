"""The choice of a device: which there are, which is meant, and whether it can build kernels."""

from __future__ import annotations

from thzcl.device import linker, pocl, probe
from thzcl.device.opencl import Device, DeviceInfo, raw_devices
from thzcl.errors import DeviceError


def devices() -> list[DeviceInfo]:
    """Returns every device of every platform, in OpenCL's order."""
    return [info for _, info in raw_devices()]


def open_device(choice: str | None = None) -> Device:
    """Returns the chosen device, ready for kernels.

    `choice` is a number, or part of a name, platform or kind; without one PoCL's CPU is taken, or
    else whatever there is. Raises DeviceError if there is no device, if the choice is not clear,
    or if the device's driver cannot build kernels.
    """
    found = raw_devices()
    if not found:
        raise DeviceError("OpenCL sees no device; run `thzcl doctor`")
    info = _chosen([info for _, info in found], choice)
    raw = found[info.number][0]
    if info.platform == pocl.PLATFORM:
        pocl.give_name(raw)
        missing = linker.prepare()
        if missing:
            raise DeviceError(missing)
        probe.prove(info)
    return Device(raw, info)


def _chosen(infos: list[DeviceInfo], choice: str | None) -> DeviceInfo:
    """Returns the device that is meant. Raises DeviceError if none or several fit."""
    if choice is None:
        return min(infos, key=lambda info: (info.platform != pocl.PLATFORM, info.kind != "CPU"))
    listing = ", ".join(f"{info.number} ({info.name})" for info in infos)
    numbered = {str(info.number): info for info in infos}
    if choice in numbered:
        return numbered[choice]
    if choice.isdecimal():
        raise DeviceError(f"there is no device {choice}; choose among {listing}")
    fitting = [i for i in infos if choice.lower() in f"{i.platform} {i.name} {i.kind}".lower()]
    if len(fitting) != 1:
        found = "no device fits" if not fitting else "several devices fit"
        raise DeviceError(f'{found} "{choice}"; choose among {listing}')
    return fitting[0]
