"""The choice of a device: which there are, which is meant, and whether it can build kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from thzcl.device import cache, linker, pocl, probe
from thzcl.device.info import DeviceInfo, raw_devices
from thzcl.device.opencl import Device
from thzcl.errors import DeviceError


def devices() -> list[DeviceInfo]:
    """Returns every device of every platform, in OpenCL's order."""
    return [info for _, info in raw_devices()]


def open_device(choice: str | int | None = None) -> Device:
    """Returns the chosen device, ready for kernels.

    `choice` is a number; or part of a platform's name, or of a device's name or kind; or
    "platform:part". Without one PoCL's CPU is taken, or else whatever there is. Raises DeviceError
    if there is no device, if the choice is not clear, or if the device's driver cannot build
    kernels.
    """
    found = raw_devices()
    kernels = cache.settle()
    if not found:
        pocl.refuse_without_memory()  # it shows no device then
        raise DeviceError(kernels.problem or "OpenCL sees no device; run `thzcl doctor`")
    info = chosen([info for _, info in found], None if choice is None else str(choice))
    raw = found[info.number][0]
    if info.platform == pocl.PLATFORM:
        pocl.give_name(raw)
        missing = kernels.problem or linker.prepare()
        if missing:
            raise DeviceError(missing)
        probe.prove(info)
        return Device(raw, info, kernels.note)
    return Device(raw, info)


def chosen(infos: list[DeviceInfo], choice: str | None = None) -> DeviceInfo:
    """Returns the device that is meant. Raises DeviceError if none or several fit."""
    if choice is None:
        return min(
            _without_older_pocl(infos), key=lambda i: (i.platform != pocl.PLATFORM, i.kind != "CPU")
        )
    listing = ", ".join(f"{info.number} ({info.platform}: {info.name})" for info in infos)
    numbered = {str(info.number): info for info in infos}
    if choice in numbered:
        return numbered[choice]
    if choice.isdecimal():
        raise DeviceError(f"there is no device {choice}; choose among {listing}")
    fitting = _without_older_pocl(_fitting(infos, choice.lower()))
    if len(fitting) != 1:
        found = "no device fits" if not fitting else "several devices fit"
        raise DeviceError(f'{found} "{choice}"; choose among {listing}')
    return fitting[0]


def _fitting(infos: Iterable[DeviceInfo], choice: str) -> list[DeviceInfo]:
    """Returns the devices that fit a text, by the first rule that any device fits.

    A platform's whole name comes before a part of one, and that before a device's name or kind,
    since PoCL names its devices after the processor's maker.
    """
    platform, _, part = choice.partition(":")
    rules: tuple[Callable[[DeviceInfo], bool], ...] = (
        lambda i: choice == i.platform.lower(),
        lambda i: choice in i.platform.lower(),
        lambda i: choice in f"{i.name} {i.kind}".lower(),
        lambda i: platform in i.platform.lower() and part in f"{i.name} {i.kind}".lower(),
    )
    for rule in rules[: None if ":" in choice else -1]:
        found = [info for info in infos if rule(info)]
        if found:
            return found
    return []


def _without_older_pocl(infos: Iterable[DeviceInfo]) -> list[DeviceInfo]:
    """Returns the devices but for those that a newer PoCL among them offers too."""
    infos = list(infos)
    newest: dict[str, tuple[int, ...]] = {}
    for info in infos:
        newest[info.kind] = max(newest.get(info.kind, ()), pocl.version(info.driver))
    return [
        i for i in infos if i.platform != pocl.PLATFORM or pocl.version(i.driver) == newest[i.kind]
    ]
