"""thzcl: what will this terahertz imager see, through this air?

import thzcl
result = thzcl.run("figure6")
"""

from pathlib import Path as _Path
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Straight from a checkout, the subpackages lie beside this one.
_root = _Path(__file__).parents[1]
if not _Path(__file__).with_name("sensors").is_dir() and (_root / "pyproject.toml").is_file():
    __path__.append(str(_root))

if TYPE_CHECKING:
    from thzcl.pipeline import run
    from thzcl.results.result import Result

__all__ = ["Result", "run"]


def __getattr__(name: str) -> Any:
    """Imports what is asked for, when it is asked for."""
    from importlib import import_module

    modules = {"run": "thzcl.pipeline", "Result": "thzcl.results.result"}
    if name not in modules:
        raise AttributeError(f"module 'thzcl' has no attribute {name!r}")
    return getattr(import_module(modules[name]), name)
