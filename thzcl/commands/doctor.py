"""What is missing on this machine, and the command that mends it."""

from __future__ import annotations

import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from thzcl.device import linker


@dataclass(frozen=True)
class Finding:
    """One thing looked at: whether it is fine, and what was seen or should be done."""

    subject: str
    fine: bool
    text: str


def devices() -> list[dict[str, Any]]:
    """The devices that OpenCL sees. Raises DeviceError if there is none."""
    from thzcl.device import opencl as device

    found = [asdict(info) for info in device.devices()]
    if not found:
        raise device.DeviceError("OpenCL sees no device; run `thzcl doctor`")
    return found


def examine() -> list[Finding]:
    """Looks at everything that a run needs of the machine."""
    return [_cache(), *_linker(), *_devices(), *_sensors()]


def _cache() -> Finding:
    folder = Path(
        os.environ.get("POCL_CACHE_DIR")
        or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pocl"
    )
    above = next(path for path in (folder, *folder.parents) if path.exists())
    if os.access(above, os.W_OK):
        return Finding("PoCL's kernel cache", True, f"{folder} can be written")
    text = f"{folder} cannot be written, so that PoCL shows no device; mend: export POCL_CACHE_DIR=<a folder of yours>"
    return Finding("PoCL's kernel cache", False, text)


def _linker() -> list[Finding]:
    missing = linker.prepare()
    return [Finding("linker", missing is None, missing or f"{shutil.which('ld')}")]


def _devices() -> list[Finding]:
    from thzcl.device import opencl as device

    found = device.devices()
    vendors = os.environ.get("OCL_ICD_VENDORS")
    if not found and vendors:
        text = f"OCL_ICD_VENDORS={vendors} hides PoCL, which comes with pyopencl; mend: unset OCL_ICD_VENDORS"
        return [Finding("devices", False, text)]
    if not found:
        text = "none is seen; mend: pip install 'pyopencl[pocl]' for PoCL on this CPU, or install your GPU's driver"
        return [Finding("devices", False, text)]
    names = "; ".join(f"{info.number}: {info.name} ({info.platform})" for info in found)
    findings = [Finding("devices", True, names)]
    try:
        opened = device.open_device()
    except device.DeviceError as error:
        return [*findings, Finding("first kernel", False, str(error))]
    return [
        *findings,
        Finding("first kernel", True, f"built and run on {opened.info.name}, {opened.info.driver}"),
    ]


def _sensors() -> list[Finding]:
    from thzcl.plugins import loader as plugins

    findings = []
    for origin in plugins.origins():
        try:
            plugins.load(origin)
        except plugins.PluginError as error:
            findings.append(
                Finding(
                    f"sensor {origin.name}",
                    False,
                    f"{error}; mend: pip uninstall {origin.distribution}, or update it",
                )
            )
    known = plugins.origins()
    for name in sorted({origin.name for origin in known}):
        owners = [origin.distribution for origin in known if origin.name == name]
        if len(owners) > 1:
            text = f"claimed by {' and '.join(owners)}; mend: pip uninstall {owners[-1]}"
            findings.append(Finding(f"sensor {name}", False, text))
    names = ", ".join(origin.name for origin in known)
    return findings or [Finding("sensors", True, names)]
