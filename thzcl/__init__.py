"""thzcl: what will this terahertz imager see, through this air?

import thzcl
result = thzcl.run("figure6")
"""

from pathlib import Path as _Path
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

# Straight from a checkout, the subpackages lie beside this one.
_root = _Path(__file__).parents[1]
if not _Path(__file__).with_name("sensors").is_dir() and (_root / "pyproject.toml").is_file():
    __path__.append(str(_root))

from thzcl.results import versions as _versions  # noqa: E402 (needs the path above)

__version__ = _versions.VERSION

if _TYPE_CHECKING:
    from thzcl.device.choose import open_device
    from thzcl.pipeline import Result, run
    from thzcl.scenario.source import Scene
    from thzcl.studies.detection.ranges import detection_range
    from thzcl.studies.many.study import study
    from thzcl.studies.sequence import sequence

__all__ = [
    "Result",
    "Scene",
    "detection_range",
    "open_device",
    "run",
    "sequence",
    "study",
]

_HOMES = {
    "Result": "thzcl.pipeline",
    "Scene": "thzcl.scenario.source",
    "detection_range": "thzcl.studies.detection.ranges",
    "open_device": "thzcl.device.choose",
    "run": "thzcl.pipeline",
    "sequence": "thzcl.studies.sequence",
    "study": "thzcl.studies.many.study",
}


def __getattr__(name: str) -> _Any:
    """Imports what is asked for, when it is asked for."""
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module 'thzcl' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """Returns the names that thzcl offers, imported already or not."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
