"""The versions of the software that a result depends on.

thzcl itself imports this, before a command can heed an interrupt: so it imports little.
"""

from __future__ import annotations

import sys
from functools import cache

VERSION = "0.1.0"
PACKAGES = ("numpy", "scipy", "pyopencl", "reikna", "pluggy", "pydantic", "h5netcdf")


def versions() -> dict[str, str]:
    """Returns the versions of thzcl, Python and the packages that numbers depend on."""
    import platform

    own = {"thzcl": VERSION, "python": platform.python_version()}
    # A loaded package knows its version; the metadata of others take milliseconds to find.
    loaded = {name: getattr(sys.modules.get(name), "__version__", None) for name in PACKAGES}
    return own | {name: known or _installed(name) for name, known in loaded.items()}


@cache
def _installed(name: str) -> str:
    """Returns the version of an installed package by its metadata."""
    from importlib.metadata import version

    return version(name)
