"""Reports: one file, no request, all that is needed, and names that do no harm."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from scenes import scene, write
from test_range import target

import thzcl
from thzcl.errors import FileError
from thzcl.results import page
from thzcl.results.report import report

HOSTILE = '<script>alert("x")</script>&<img src=http://evil.example/x.png>'
QUICK = {"camera__pixels": [24, 18]}


class Reader(HTMLParser):
    """Collects what a page refers to, its elements and its texts."""

    def __init__(self):
        super().__init__()
        self.refers, self.tags, self.texts = [], [], []

    def handle_starttag(self, tag, attrs):  # noqa: D102 (HTMLParser's)
        self.tags.append(tag)
        self.refers += [value for name, value in attrs if name in ("src", "href", "action")]

    def handle_data(self, data):  # noqa: D102 (HTMLParser's)
        self.texts.append(data)


def read(text):
    reader = Reader()
    reader.feed(text)
    return reader


def checked(text):
    """A page that refers to nothing outside it and has one script, its own."""
    reader = read(text)
    assert all(value.startswith("data:image/png;base64,") for value in reader.refers)
    assert reader.tags.count("script") == 1 and "link" not in reader.tags
    assert "@import" not in text and "url(" not in text
    return reader, " ".join(reader.texts)


@pytest.fixture
def result(tmp_path, device):
    box = scene()["targets"]["box"]
    variants = [{"name": HOSTILE}, {"name": "cold", "set": {f"targets.{'b'}.temperature_k": 280.0}}]
    data = scene(**QUICK, targets={"b": box}, variants=variants, atmosphere__compare=["r24"])
    path = tmp_path / "out.nc"
    thzcl.run(write(tmp_path, data), device=device).save(path)
    return path


@pytest.fixture
def study(tmp_path, device):
    over = {"atmosphere.relative_humidity_percent": [-1.0, 30.0, 60.0],
            "targets.box.range_m": [20.0, 30.0]}  # fmt: skip
    source = write(tmp_path, scene(**QUICK))
    thzcl.study(source, tmp_path / "study", over=over, seeds=2, device=device)
    return tmp_path / "study"


def test_a_result_is_told_whole(result):
    reader, words = checked(report(result))
    assert reader.tags.count("img") == 1  # of both variants, in the same colours
    for word in ("optical depth", "CNR", "r24", "model", "surrogate", "left out", "thzcl run",
                 "relative_humidity_percent = 70.0", "humidity-field", "numpy"):  # fmt: skip
        assert word.lower() in words.lower(), word
    assert HOSTILE in words  # as text


def test_a_study_has_its_curve_heat_map_failures_and_table(study):
    text = report(study)
    reader, words = checked(text)
    assert "8 done, 4 failed" in words
    assert words.count("relative_humidity_percent: must be at least 0 %") >= 4
    assert reader.tags.count("svg") == 1 and reader.tags.count("polyline") == 1
    assert len(re.findall(r"background:rgba\(var\(--heat\)", text)) == 4
    assert 'class="sorts"' in text


def test_an_answer_about_range_has_its_curve(thzcl_command, tmp_path):
    source = write(tmp_path, target())
    asked = ("--target", "plate", "--ranges", "10,20,40", "--air", "10", "--seed", "1")
    assert thzcl_command("range", source, *asked, "-o", "r").returncode == 0
    done = thzcl_command("report", "r")
    assert done.stdout == "wrote r/report.html\n"
    reader, words = checked((tmp_path / "r" / "report.html").read_text(encoding="utf-8"))
    assert "polygon" in reader.tags and "340 GHz, mpm93" in words


def test_run_writes_a_report_on_demand(thzcl_json, tmp_path):
    told = thzcl_json("run", write(tmp_path, scene(**QUICK)), "--report", "--no-figure")
    assert told["files"] == ["scene.nc", "scene.html"]
    checked((tmp_path / "scene.html").read_text(encoding="utf-8"))


def test_what_is_nothing_to_report_on_is_refused(tmp_path, thzcl_command):
    with pytest.raises(FileError, match="neither a study nor an answer"):
        report(tmp_path)
    broken = tmp_path / "x-range.json"
    broken.write_text("{}", encoding="utf-8")
    with pytest.raises(FileError, match="is not as thzcl has written it"):
        report(tmp_path)
    (tmp_path / "no.nc").write_bytes(b"no")
    assert thzcl_command("report", "no.nc").returncode == 2
    assert thzcl_command("report", "no.nc", "-o", "x.pdf").returncode == 2


def test_ticks_are_round_and_few():
    for low, high in ((0.0, 1.0), (20.0, 90.0), (-3.2e-9, 4.1e-9), (271.3, 271.9)):
        found = page.ticks(low, high)
        assert 3 <= len(found) <= 8
        assert np.allclose(np.diff(found), found[1] - found[0])
        assert found[0] >= low - 1e-9 * (high - low) and found[-1] <= high + 1e-9 * (high - low)


def chromium(*arguments):
    options = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
               "--allow-file-access-from-files")  # fmt: skip
    command = [shutil.which("chromium"), *options, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)


@pytest.mark.browser
def test_pages_fit_a_phone_and_are_right_in_light_dark_and_print(result, study, tmp_path):
    assert shutil.which("chromium"), "needs Debian's chromium"
    for name, source in (("result", result), ("study", study)):
        path = tmp_path / f"{name}.html"
        path.write_text(report(source), encoding="utf-8")
        frame = tmp_path / "frame.html"
        frame.write_text(
            f'<body><iframe src="{path.name}" width="360" height="800"></iframe><script>'
            "onload = () => { const d = document.querySelector('iframe').contentDocument;"
            "document.body.textContent = 'wide ' + d.documentElement.scrollWidth + ' buttons '"
            " + d.querySelectorAll('th button').length }</script></body>",
            encoding="utf-8",
        )
        dumped = chromium("--dump-dom", frame.as_uri()).stdout
        found = re.search(r"wide (\d+) buttons (\d+)", dumped)
        assert found and int(found[1]) <= 360, dumped
        assert (int(found[2]) > 0) == (name == "study")
        shots = {}
        for kind, options in (
            ("light", ()),
            ("dark", ("--blink-settings=preferredColorScheme=0",)),
            ("plain", ()),
        ):
            file, shown = tmp_path / f"{name}-{kind}.png", path
            if kind == "plain":  # as it is where scripts are off
                shown = tmp_path / "plain.html"
                whole = path.read_text(encoding="utf-8")
                shown.write_text(re.sub(r"<script>.*</script>", "", whole, flags=re.DOTALL),
                                 encoding="utf-8")  # fmt: skip
            chromium(*options, "--window-size=900,1200", f"--screenshot={file}", shown.as_uri())
            shots[kind] = np.asarray(Image.open(file).convert("L"), float)
        assert shots["light"][-1, 0] > 240 and shots["dark"][-1, 0] < 40
        for shot in shots.values():  # ink against paper, in both
            assert np.ptp(shot) > 180
        assert shots["plain"].shape == shots["light"].shape
        assert np.mean(np.abs(shots["plain"] - shots["light"]) > 60) < 0.01
        printed = tmp_path / f"{name}.pdf"
        chromium(f"--print-to-pdf={printed}", path.as_uri())
        assert printed.read_bytes().startswith(b"%PDF") and printed.stat().st_size > 20_000


@pytest.mark.browser
def test_a_table_sorts_when_its_heading_is_pressed(study, tmp_path):
    text = report(study)
    press = (
        "<script>const t = document.querySelector('table.sorts'), n = [...t.querySelectorAll('th')]"
        ".findIndex(h => h.textContent === 'member'), b = t.querySelectorAll('th button')[n];"
        "const all = () => [...t.tBodies[0].rows].map(r => r.cells[n].textContent).join(' ');"
        "b.click(); const up = all(); b.click();"
        "document.body.textContent = 'up ' + up + ' down ' + all();</script></body>"
    )
    path = tmp_path / "pressed.html"
    path.write_text(text.replace("</body>", press), encoding="utf-8")
    dumped = chromium("--dump-dom", path.as_uri()).stdout
    up, down = re.search(r"up ([\d ]+) down ([\d ]+)", dumped).groups()
    numbers = [int(n) for n in up.split()]
    assert numbers == sorted(numbers) and len({*numbers}) == 12
    assert [int(n) for n in down.split()] == sorted(numbers, reverse=True)
