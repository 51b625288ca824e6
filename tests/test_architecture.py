"""Data flows one way, and so do imports."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest
from conftest import ROOT

# A module may import those that stand before it, in the flow's order, and none of those after.
FLOW = [
    "thzcl", "files", "linker", "processor", "clock", "absorption", "scenario", "radiometry", "bands", "sensor", "hookspecs",
    "plugins", "spectrum_table", "turbulence", "field_file", "texture", "geometry", "optics", "accuracy", "plan", "refraction",
    "overview", "device", "field", "trace", "emission", "thinning", "compute", "develop", "exposure", "ensemble", "reference",
    "budget", "figure", "result", "checks", "pipeline", "fluctuations", "convergence", "stress", "bench", "newsensor",
    "printing", "doctor", "options", "cli", "entry", "__main__",
]  # fmt: skip
STRANGERS = [
    ("turbulence/field", "paths/trace"),
    ("paths/trace", "turbulence/field"),
    ("result", "device"),
    ("figure", "device"),
    ("plan", "device"),
    ("overview", "device"),
]


def imports(path):
    """Every module that a file imports, anywhere in it, except for type checking alone."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    checking = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
    ]
    skipped = {id(inner) for node in checking for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def part(module):
    """The part of thzcl that a dotted name belongs to, or None."""
    words = module.split(".")
    if words[0] != "thzcl":
        return None
    return words[1] if len(words) > 1 and words[1] in FLOW else "thzcl"


def sources():
    for path in sorted((ROOT / "thzcl").rglob("*.py")):
        where = path.relative_to(ROOT / "thzcl").parts[0].removesuffix(".py")
        yield pytest.param(
            "thzcl" if where == "__init__" else where, path, id=str(path.relative_to(ROOT))
        )


@pytest.mark.parametrize(("name", "path"), list(sources()))
def test_imports_follow_the_flow(name, path):
    for module in imports(path):
        other = part(module)
        if other is not None and name not in (other, "thzcl"):
            assert FLOW.index(other) < FLOW.index(name), f"{name} imports {module}"
            assert (name, other) not in STRANGERS, f"{name} and {other} do not know each other"
        if module.split(".")[0] in ("pyopencl", "reikna"):
            assert name == "device", f"{name} imports {module}: only device.py may"


@pytest.mark.parametrize(
    "path", sorted((ROOT / "sensors").glob("*.py")), ids=lambda path: path.name
)
def test_sensors_import_the_contract_and_numpy_alone(path):
    """Beside the standard library."""
    for module in imports(path):
        if module.split(".")[0] not in sys.stdlib_module_names:
            assert module.startswith(("thzcl.sensor.", "numpy")), module


def test_the_top_level_holds_what_it_should():
    allowed = {
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "thzcl",
        "kernels",
        "sensors",
        "scenarios",
        "tests",
    }
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout: nothing says which files are the project's")
    tracked = subprocess.run(
        ["/usr/bin/env", "git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split("\n")
    tops = {name.split("/")[0] for name in tracked if name}
    assert {top for top in tops if not top.startswith(".")} <= allowed
