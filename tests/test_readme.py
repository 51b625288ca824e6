"""The documents: their commands and examples run, and they show what there is."""

from __future__ import annotations

import re
import shlex
from typing import Annotated, Literal

import air_page
import gallery
import imagers
import keys
import pytest
import tomli
from conftest import ROOT
from pydantic import Field

from thzcl.commands.app import COMMANDS
from thzcl.scenario.scene import Scene
from thzcl.scenario.sensors import HOOK
from thzcl.scenario.source import shipped
from thzcl.scenario.table import Positive, Table, key
from thzcl.studies.stress.cases import cases

README = ROOT / "README.md"
SPEED = ROOT / "tests" / "bench" / "README.md"
RECORDS = ROOT / "thzcl" / "records" / "README.md"
PAGES = (README, gallery.PAGE, keys.PAGE, imagers.PAGE, SPEED, RECORDS, air_page.PAGE)
PICTURE = re.compile(r"!\[[^\]]+\]\(([^)]+)\)")
LINK = re.compile(r"(?<!!)\[[^\]]+\]\(([^)]+)\)")


def text(page):
    return page.read_text(encoding="utf-8")


def blocks(page, kind):
    return re.findall(rf"```{kind}\n(.*?)```", text(page), re.DOTALL)


def commands(page, start="thzcl "):
    lines = "".join(blocks(page, "sh")).splitlines()
    return [line for line in lines if line.startswith(start)]


def named(page):
    return str(page.relative_to(ROOT))


def run_all(listed, thzcl_command):
    """Runs commands in one folder, in order, as a reader would."""
    for command in listed:
        done = thzcl_command(*shlex.split(command)[1:])
        assert done.returncode == 0, f"{command}: {done.stderr}"


def test_two_commands_do_all_the_setting_up():
    run, test = commands(README, "python3 -m venv")
    assert run.endswith("thzcl run figure6")
    assert test.endswith("-m pytest")
    for command in (run, test):
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install ")


@pytest.mark.slow
def test_the_first_scene_runs_as_it_is_printed(thzcl_command, tmp_path):
    (scene,) = blocks(README, "toml")
    assert len(scene.splitlines()) <= 15
    (tmp_path / "box.toml").write_text(scene, encoding="utf-8")
    listed = commands(README)
    assert listed[0] == "thzcl run box.toml"
    run_all(listed, thzcl_command)
    assert (tmp_path / "box.png").is_file() and (tmp_path / "out" / "box.nc").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("page", [SPEED, RECORDS], ids=named)
def test_every_command_works(page, thzcl_command):
    listed = commands(page)
    assert listed
    run_all(listed, thzcl_command)


@pytest.mark.parametrize("code", blocks(README, "python"))
def test_every_python_example_works(code):
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102 (our own examples)


def test_readme_names_every_command():
    rows = re.findall(r"^\| (`thzcl .*?) \|", text(README), re.MULTILINE)
    told = [name for row in rows for name in re.findall(r"`thzcl ([a-z-]+)", row)]
    assert sorted(told) == sorted(COMMANDS)


def test_readme_names_every_sensor():
    table = text(README).partition("| `[sensor] kind` |")[2].partition("\n\n")[0]
    assert sorted(re.findall(r"^\| `([a-z-]+)`", table, re.MULTILINE)) == sorted(HOOK.built_ins)


def heading_anchor(heading):
    return re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_link_leads_somewhere(page):
    for link in LINK.findall(text(page)):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.is_file(), link
        if anchor:
            headings = re.findall(r"^#+ (.*)$", text(target), re.MULTILINE)
            assert anchor in map(heading_anchor, headings), link


def test_every_picture_is_shown_and_made_by_a_command_beside_it():
    shown = {}
    for page in PAGES:
        for picture in PICTURE.findall(text(page)):
            path = (page.parent / picture).resolve()
            assert path.parent == gallery.PICTURES and path.is_file(), picture
            shown[path.stem] = page
            assert gallery.COMMANDS[path.stem] in text(page), f"{picture} in {named(page)}"
    assert set(shown) == {path.stem for path in gallery.PICTURES.iterdir()} == set(gallery.COMMANDS)


def test_the_gallery_is_made_of_the_scenes():
    page = text(gallery.PAGE)
    assert page == gallery.page()
    for name in shipped():
        assert f"## {name}\n" in page and f"    thzcl run {name}\n" in page


def test_a_scene_speaks_in_the_gallery_for_itself():
    assert gallery.paragraphs("# One,\n# two.\n#\n# Three.\n\n# no more\n[camera]\n") == [
        "One, two.",
        "Three.",
    ]


def test_the_page_of_keys_is_made_of_the_models():
    """`python tests/keys.py` writes it."""
    assert text(keys.PAGE) == keys.page()


def test_the_page_of_the_air_is_made_of_the_models():
    assert text(air_page.PAGE) == air_page.page()


def heading(path, table):
    """The heading of the section that tells the keys of a table."""
    if path in ("targets", "sensor", "sensor.detector"):
        place = "[targets.NAME]" if path == "targets" else "[sensor]"
        return f'{place} kind = "{table["kind"]}"'
    words = path.replace("sensor.detector", "sensor").split(".")
    if words[0] == "materials":  # by name
        del words[1]
    if words[0] == "targets":
        words.insert(1, "NAME")
        if words[2] == "parts":  # by name
            del words[3]
    return f"[{'.'.join(words)}]"


@pytest.mark.parametrize("name", shipped())
def test_every_key_of_a_shipped_scene_stands_on_the_page(name):
    sections = text(keys.PAGE).split("\n## ")[1:]
    told = {
        part.partition("\n")[0]: set(re.findall(r"^\| `(\w+)`", part, re.MULTILINE))
        for part in sections
    }

    def check(path, table):
        for word, value in table.items():
            if isinstance(value, dict):
                check(f"{path}.{word}", value)
            elif word != "kind":
                assert word in told[heading(path, table)], f"[{path}] {word}"

    scene = tomli.loads((ROOT / "scenarios" / f"{name}.toml").read_text(encoding="utf-8"))
    assert set(scene) - {"variants"} <= told["Tables"]
    for target in scene.pop("targets", {}).values():
        target.pop("bars", None)
        check("targets", target)
    for variant in scene.pop("variants", []):
        assert set(variant) <= told["[[variants]]"]
    for path, table in scene.items():
        check(path, table)


class Sample(Table):
    """A table with a key of each kind."""

    exactly_one = (("length_m", "count"),)

    length_m: float | None = key(None, gt=0, le=2e9, unit="m", help="a | b")
    count: int = key(3, ge=1, lt=2**63, help="how many")
    size_m: tuple[Positive, Positive] = key(help="edges", unit="m")
    form: Literal["flat", "round"] = key("flat", help="its form")
    either: Literal["air"] | Annotated[float, Field(ge=-0.5, le=400)] = key("air", help="or")
    several: float | tuple[float, ...] = key(help="one or more")
    on: bool = key(False, help="whether")
    file: str | None = key(None, help="a file")
    inner: Scene | None = key(None, help="another")


def test_a_table_is_told_with_units_defaults_and_limits():
    rows = list(keys.rows_of(Sample))
    assert rows == [
        ("`length_m`", "m", "none", "above 0, at most 2e9", "a | b"),
        ("`count`", "", "`3`", "whole, at least 1, below 2^63", "how many"),
        ("`size_m`", "m", "required", "2 values, each: above 0, at most 1e12", "edges"),
        ("`form`", "", '`"flat"`', '`"flat"`, `"round"`', "its form"),
        ("`either`", "", '`"air"`', '`"air"`; or -0.5 to 400', "or"),
        ("`several`", "", "required", "a number; or list, each: a number", "one or more"),
        ("`on`", "", "`false`", "`true`, `false`", "whether"),
        ("`file`", "", "none", "text", "a file"),
        ("`inner`", "", "none", "a table", "another"),
    ]
    section = keys.section("[sample]", "A sample.", Sample)
    assert "Give exactly one of `length_m` and `count`." in section
    assert r"| a \| b |" in section


def test_the_record_is_told_as_the_command_tells_it(thzcl_json):
    found = thzcl_json("fluctuations", ROOT / gallery.RECORD)
    page = " ".join(text(RECORDS).split())
    for part in (
        f"{found['wind_speed_m_s']:.2f} m/s",
        f"slope of {found['slope']:.2f} +- {found['slope_uncertainty']:.2f}",
        f"C_q^2 = {found['structure_constant_q']:.3f} g^2",
        f"says {found['structure_constant_q_from_structure_function']:.3f}, ",
        f"{found['agreement_percent']:+.1f} %",
        f"sweeping speed of {found['sweeping_speed_m_s']:.2f} m/s",
        f"by {found['sigma_percent']:.1f} % of its mean",
        f"correlation of {found['correlation_tq']:.2f} to temperature",
        f"{found['correlation_tq_inertial']:.2f} in the inertial range",
    ):
        assert part in page


def test_the_stiff_cases_on_the_page_are_those_that_there_are():
    rows = re.findall(r"^\| (.*): \w+ \| [-+\d.e]+ \| \S+ \| \S+ \|$", text(SPEED), re.MULTILINE)
    assert set(rows) == {case.name for case in cases() if case.judges}


def test_documents_hold_no_absolute_paths():
    for page in PAGES:
        assert not re.search(r"(?<![\w.])/(home|root|tmp|work|usr)/", text(page)), named(page)
