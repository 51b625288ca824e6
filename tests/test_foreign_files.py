"""Files that thzcl has written, and that something else has changed since: refused in words."""

from __future__ import annotations

import os

import pytest
from scenes import scene, write

from thzcl.commands.study import _parts
from thzcl.errors import FileError, UsageError
from thzcl.files import RECORD, read_json
from thzcl.results.report import report
from thzcl.studies.many.store import Store
from thzcl.studies.many.study import study

DEEP = "[" * 100_000
SPOILT = {
    "deep": DEEP,
    "long number": '{"seed": ' + "9" * 5000 + "}",
    "NUL": "\0",
    "not UTF-8": b"\xff\xfe{",
    "NaN": '{"state": NaN}',
    "empty": "",
}
OTHERS = {"list": "[]", "no keys": "{}", "other types": '{"seed": "x", "over": 3, "state": 3}'}


def spoil(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


@pytest.mark.parametrize("case", SPOILT)
def test_what_is_no_json_is_refused(tmp_path, case):
    spoil(tmp_path / "a.json", SPOILT[case])
    with pytest.raises(FileError, match=r"a\.json"):
        read_json(tmp_path / "a.json", RECORD)


@pytest.mark.parametrize("case", [*SPOILT, *OTHERS])
def test_a_spoilt_description_is_refused(tmp_path, case):
    for name, content in (("study.json", (SPOILT | OTHERS)[case]), ("index.csv", "member\n1\n")):
        spoil(tmp_path / name, content)
    with pytest.raises(FileError):
        report(tmp_path)
    with pytest.raises(UsageError):
        Store(tmp_path).described()


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "study.json")
    with pytest.raises(UsageError, match="a pipe"):
        Store(tmp_path).described()


@pytest.mark.parametrize("case", [*SPOILT, *OTHERS])
def test_a_spoilt_member_is_made_again(tmp_path, device, case):
    scenario, folder = write(tmp_path, scene(camera__pixels=[4, 4])), tmp_path / "study"
    asked = {"seeds": 1, "seed": 3, "device": device}
    study(scenario, folder, **asked)
    (member,) = (folder / "members").glob("*.json")
    index = (folder / "index.csv").read_text()
    spoil(member, (SPOILT | OTHERS)[case])
    study(scenario, folder, **asked)
    again = (folder / "index.csv").read_text()
    assert [row.split(",")[:3] for row in again.splitlines()] == [
        row.split(",")[:3] for row in index.splitlines()
    ]
    assert "done" in again


@pytest.mark.parametrize("text", ["1/\u00b2", "\u0663/\u0664", "9" * 5000 + "/2", "1/2/3", "1"])
def test_a_shard_is_two_plain_numbers(text):
    with pytest.raises(UsageError, match="--shard"):
        _parts(text)
