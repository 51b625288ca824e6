"""Data flows one way through the house, and so do imports."""

from __future__ import annotations

import ast
import re
import subprocess
import sys

import pytest
from conftest import ROOT

# The rooms in the order of the flow. A room imports what stands above it, type-only imports and
# those within functions included.
ROOMS = (
    "device",
    "plugins",
    "air",
    "scenario",
    "turbulence",
    "surfaces",
    "paths",
    "sensing",
    "error",
    "plan",
    "results",
    "studies",
    "records",
    "commands",
)
LOOSE = {"__init__", "__main__", "clock", "errors", "files", "graph", "metrics", "pipeline"}
LOOSE |= {"sensor", "constituent"}  # the two public contracts
# What a loose module may know of the house; the others know no room.
KNOWN = {
    "sensor": {"air", "scenario", "sensing"},  # its contract offers tables, Planck and bands
    "constituent": {"air", "scenario"},  # its contract offers tables, and spheres by Mie
    "metrics": {"air", "sensing"},
    "pipeline": set(ROOMS) - {"records", "commands"},
    "__init__": {"device", "results", "scenario", "studies"},
    "__main__": {"commands"},
}
MOST_LOOSE = 10
PACKAGE = ROOT / "thzcl"


def imports(path):
    """Every module that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def module_of(name):
    """The module file, as dotted name below thzcl, that an imported name is or lies in."""
    words = name.split(".")[1:]
    for count in range(len(words), 0, -1):
        path = PACKAGE.joinpath(*words[:count])
        if path.with_suffix(".py").is_file() or (path / "__init__.py").is_file():
            return ".".join(words[:count])
    return "__init__"


def files():
    return sorted(path for path in PACKAGE.rglob("*.py") if "templates" not in path.parts)


def dotted(path):
    words = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(words[:-1] if words[-1] == "__init__" and len(words) > 1 else words)


def own_imports(path):
    return {module_of(name) for name in imports(path) if name.split(".")[0] == "thzcl"}


@pytest.mark.parametrize("path", files(), ids=dotted)
def test_rooms_import_what_stands_above_them(path):
    here = dotted(path).split(".")[0]
    for module in own_imports(path):
        there = module.split(".")[0]
        if there in LOOSE or there == here:
            continue
        if here in LOOSE:
            assert there in KNOWN.get(here, set()), f"{here} imports {module}"
        else:
            assert ROOMS.index(there) < ROOMS.index(here), f"{dotted(path)} imports {module}"


def test_every_room_stands_in_the_order():
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    assert rooms == set(ROOMS)
    loose = {path.stem for path in PACKAGE.glob("*.py")}
    assert loose == LOOSE
    assert len(loose) <= MOST_LOOSE


def test_no_modules_import_each_other():
    """Nor in a circle: imports within functions and for types alone count too."""
    edges = {dotted(path): own_imports(path) - {dotted(path)} for path in files()}
    done: set[str] = set()

    def visit(module, trail):
        assert module not in trail, " -> ".join([*trail, module])
        if module not in done:
            for other in sorted(edges.get(module, ())):
                visit(other, [*trail, module])
            done.add(module)

    for module in edges:
        visit(module, [])


@pytest.mark.parametrize("path", files(), ids=dotted)
def test_only_the_device_knows_opencl(path):
    known = {name.split(".")[0] for name in imports(path)}
    assert dotted(path).startswith("device") or not known & {"pyopencl", "reikna"}


def plugin_files():
    """The files of the built-in sensors and constituents, each with its public contract."""
    for path in sorted((ROOT / "sensors").glob("*.py")):
        yield path, "thzcl.sensor."
    for path in sorted((PACKAGE / "air" / "constituents").glob("*.py")):
        if re.search(r"^def register_constituents", path.read_text(encoding="utf-8"), re.MULTILINE):
            yield path, "thzcl.constituent."


@pytest.mark.parametrize(
    ("path", "contract"), list(plugin_files()), ids=lambda value: str(value)[-20:]
)
def test_plugins_import_the_contract_and_numpy_alone(path, contract):
    """Beside the standard library, and SciPy where a formula needs it."""
    for module in imports(path):
        if module.split(".")[0] not in sys.stdlib_module_names:
            assert module.startswith((contract, "numpy", "scipy.")), module


def test_kernels_lie_in_rooms_of_the_same_names():
    rooms = {path.name for path in (ROOT / "kernels").iterdir() if path.is_dir()}
    assert rooms - {"__pycache__"} <= set(ROOMS)
    assert not list((ROOT / "kernels").glob("*.cl"))


def test_the_top_level_holds_what_it_should():
    allowed = {"pyproject.toml", "README.md", "LICENSE"}
    allowed |= {"thzcl", "kernels", "sensors", "scenarios", "tests"}
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout: nothing says which files are the project's")
    command = ["/usr/bin/env", "git", "ls-files"]
    tracked = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    tops = {name.split("/")[0] for name in tracked.stdout.split("\n") if name}
    assert {top for top in tops if not top.startswith(".")} <= allowed
