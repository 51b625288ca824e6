"""The wheel: what it installs, and that it works in an empty environment far from the checkout."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile

import pytest
from conftest import ROOT

MAPPED = ("kernels", "sensors", "scenarios")  # folders beside the package, installed within it
INSTALLED = {".py", ".typed", ".html", ".csv", ".cl", ".in", ".toml"}
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    hidden = shutil.ignore_patterns(".*", "__pycache__", "build", "*.egg-info")
    shutil.copytree(ROOT, source, ignore=hidden)
    command = [sys.executable, "-m", "build", "--wheel", "--outdir", str(folder), str(source)]
    subprocess.run(command, check=True, capture_output=True, cwd=folder)
    (made,) = folder.glob("*.whl")
    return made


def test_the_wheel_holds_one_package_and_its_data(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"thzcl"}
    for folder, installed in (("thzcl", ""), *((name, "thzcl/") for name in MAPPED)):
        files = [path for path in (ROOT / folder).rglob("*") if path.suffix in INSTALLED]
        assert files
        assert {f"{installed}{path.relative_to(ROOT)}" for path in files} <= set(names)
    for table in ("mpm93_water_lines", "p676_13_oxygen_lines", "r24_water_self_continuum"):
        assert f"thzcl/air/constituents/{table}.csv" in names
    assert not any("gallery" in name for name in names)


def test_the_wheel_works_in_an_empty_environment(wheel, tmp_path):
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "env")], check=True)
    python = tmp_path / "env" / "bin" / "python"
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", str(wheel)], check=True, capture_output=True
    )
    thzcl = tmp_path / "env" / "bin" / "thzcl"
    clean = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    done = subprocess.run(
        [thzcl, "run", "quick"],
        cwd=tmp_path,
        env=clean,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "quick.nc").exists() and (tmp_path / "quick.png").exists()
    where = subprocess.run(
        [python, "-c", "import thzcl.sensors, thzcl.kernels; print(thzcl.sensors.__file__)"],
        cwd=tmp_path, env=clean, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert str(tmp_path / "env") in where.stdout
