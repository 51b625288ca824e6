"""README: its commands run, its Python runs, and it shows what there is."""

from __future__ import annotations

import re
import shlex

import pytest
from conftest import ROOT

from thzcl.scenario.source import shipped

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, re.DOTALL)
COMMANDS = [
    line
    for kind, text in BLOCKS
    if kind == "sh"
    for line in text.splitlines()
    if line.startswith("thzcl ")
]
SETUP = [
    line
    for kind, text in BLOCKS
    if kind == "sh"
    for line in text.splitlines()
    if line.startswith("python3 -m venv")
]


def test_two_commands_do_all_the_setting_up():
    run, test = SETUP
    assert run.endswith("thzcl run figure6")
    assert test.endswith("-m pytest")
    for command in SETUP:
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install ")


def test_every_command_works(thzcl_command):
    """In one folder, in order, as a reader would."""
    assert len(COMMANDS) >= 5
    for command in COMMANDS:
        done = thzcl_command(*shlex.split(command)[1:])
        assert done.returncode == 0, f"{command}: {done.stderr}"


@pytest.mark.parametrize("code", [text for kind, text in BLOCKS if kind == "python"])
def test_every_python_example_works(code):
    exec(compile(code, "README.md", "exec"), {})  # noqa: S102 (our own examples)


def test_every_shipped_scene_and_picture_is_there():
    for name in shipped():
        assert f"`{name}`" in README
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).is_file(), picture
