"""`thzcl doctor`: what is missing on this machine, and the command that mends it."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING, NamedTuple

from thzcl.errors import DONE, NO_DEVICE, DeviceError, PluginError

if TYPE_CHECKING:
    from thzcl.plugins.loader import Hook


class Finding(NamedTuple):
    """A subject that was looked at: whether it is fine, and what was seen or should be done."""

    subject: str
    fine: bool
    text: str


def doctor() -> int:
    """Look for what is missing on this machine, and name the command that mends it."""
    from thzcl.commands.tables import Column, Table, show

    findings = [_cache(), _linker(), *_devices(), *_plugins()]
    rows = tuple((one.subject, "fine" if one.fine else "AMISS", one.text) for one in findings)
    show(Table("", (Column(""), Column(""), Column("")), rows))
    return DONE if all(finding.fine for finding in findings) else NO_DEVICE


def _cache() -> Finding:
    from thzcl.device import cache

    folder = cache.kernel_folder()
    reason, subject = cache.fault(folder), "PoCL's kernel cache"
    if reason is None:
        return Finding(subject, True, f"{folder} can be written")
    mend = "mend: export POCL_CACHE_DIR=<a folder of yours>"
    return Finding(subject, False, f"{folder} {reason}; {mend}")


def _linker() -> Finding:
    from thzcl.device import linker

    missing = linker.prepare()
    return Finding("linker", missing is None, missing or f"{shutil.which('ld')}")


def _devices() -> list[Finding]:
    from thzcl.device.choose import chosen, devices, open_device

    found = devices()
    if not found:
        vendors = os.environ.get("OCL_ICD_VENDORS")
        text = (
            f"OCL_ICD_VENDORS={vendors} hides PoCL, which comes with pyopencl; "
            "mend: unset OCL_ICD_VENDORS"
            if vendors
            else "none is seen; mend: pip install 'pyopencl[pocl]' for PoCL on this CPU, "
            "or install your GPU's driver"
        )
        return [Finding("devices", False, text)]
    names = "; ".join(f"{info.number}: {info.name} ({info.platform})" for info in found)
    taken = (
        f"{chosen(found).number}, if --device names no other: the newest PoCL's CPU comes first, "
        "and a GPU is never chosen by default where there is a CPU"
    )
    seen = [Finding("devices", True, names), Finding("default device", True, taken)]
    try:
        info = open_device().info
    except DeviceError as error:
        return [*seen, Finding("first kernel", False, str(error))]
    seen.append(Finding("first kernel", True, f"built and run on {info.description}"))
    return [*seen, Finding("OpenCL library", True, info.library or "could not be told")]


def _plugins() -> list[Finding]:
    from thzcl.air.composition import HOOK as CONSTITUENTS
    from thzcl.scenario.sensors import HOOK as SENSORS

    return [finding for hook in (SENSORS, CONSTITUENTS) for finding in _of_kind(hook)]


def _of_kind(hook: Hook) -> list[Finding]:
    """Returns what is wrong with plugins of a kind, or else their names."""
    from thzcl.plugins.loader import load, origins

    known = origins(hook)
    findings = []
    for origin in known:
        try:
            load(hook, origin)
        except PluginError as error:
            mend = f"pip uninstall {origin.distribution}, or update it"
            subject = f"{hook.word} {origin.name}"
            findings.append(Finding(subject, False, f"{error}; mend: {mend}"))
    for name in sorted({origin.name for origin in known}):
        owners = [origin.distribution for origin in known if origin.name == name]
        if len(owners) > 1:
            text = f"claimed by {' and '.join(owners)}; mend: pip uninstall {owners[-1]}"
            findings.append(Finding(f"{hook.word} {name}", False, text))
    names = ", ".join(origin.name for origin in known)
    return findings or [Finding(f"{hook.word}s", True, names)]
