"""How a command ends: an exit code and a message, never a traceback, wherever it is printed to."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from conftest import ROOT
from scenes import scene, write

from thzcl.__main__ import main

COMMAND = f"{sys.executable} -m thzcl"
pytestmark = pytest.mark.slow  # nearly all start processes


def shell(line, folder, **environment):
    """The finished process of a line for the shell, its output as bytes.

    Output is buffered, as a user's is.
    """
    environment = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": ""} | environment
    return subprocess.run(
        ["/bin/sh", "-c", line], capture_output=True, cwd=folder, env=environment, check=False
    )


def test_main_returns_its_code_and_ends_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = (signal.getsignal(signal.SIGTERM), sys.stdout, sys.stdout.errors, sys.excepthook)
    assert main(["check", "quick"]) == 0
    assert "quick: sound, 1 image" in capsys.readouterr().out
    assert main(["check", "nothing.toml"]) == 2
    assert "nothing.toml: no such file" in capsys.readouterr().err
    assert main(["check"]) == 2
    assert main(["--help"]) == 0
    after = (signal.getsignal(signal.SIGTERM), sys.stdout, sys.stdout.errors, sys.excepthook)
    assert after == before


def test_main_works_in_a_thread(capsys):
    codes = []
    thread = threading.Thread(target=lambda: codes.append(main(["check", "quick"])))
    thread.start()
    thread.join()
    assert codes == [0]
    assert "sound" in capsys.readouterr().out


def test_what_was_registered_to_happen_at_exit_happens(tmp_path):
    code = (
        "import atexit, sys; from thzcl.__main__ import main;"
        "atexit.register(print, 'good bye'); sys.exit(main(['check', 'quick']))"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "good bye"


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (["check", "uniform"], {"app", "check", "options"}),
        (["new", "scene.toml"], {"app", "new"}),
        (["scenarios"], {"app", "scenarios", "tables", "terminal"}),
    ],
)
def test_only_the_command_that_is_asked_for_is_imported(tmp_path, arguments, allowed):
    code = (
        f"import sys; from thzcl.__main__ import main; code = main({arguments!r});"
        "print(code, *(name for name in sys.modules if name.startswith('thzcl.commands.')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=True,
    )
    code, *imported = done.stdout.splitlines()[-1].split()
    assert code == "0"
    assert {name.removeprefix("thzcl.commands.") for name in imported} == allowed


def test_help_imports_nothing_heavy(tmp_path):
    code = (
        "import sys; from thzcl.__main__ import main; main(['--help']);"
        "print({'numpy', 'pyopencl', 'pydantic'} & set(sys.modules))"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        check=True,
    )
    assert done.stdout.strip().endswith("set()")


def test_help_is_no_markup(monkeypatch, capsys):
    from thzcl.commands.new import new

    monkeypatch.setattr(new, "__doc__", "Write a [scene] of [bold]yours[/bold].")
    assert main(["--help"]) == main(["new", "--help"]) == 0
    assert capsys.readouterr().out.count("Write a [scene] of [bold]yours[/bold].") == 2


@pytest.mark.parametrize("raised", [ZeroDivisionError("oh"), SystemExit(0)])
def test_a_bug_is_a_message_and_4(monkeypatch, capsys, raised):
    import thzcl.commands.check as command

    def broken(_):
        raise raised

    monkeypatch.setattr(command, "changes", broken)
    assert main(["check", "quick"]) == 4
    error = capsys.readouterr().err
    assert f"a bug in thzcl, or in what it is built on: {type(raised).__name__}: {raised}" in error
    assert "test_main.py, line" in error
    assert "please report it" in error
    assert len(error.splitlines()) == 1


def test_an_interrupt_in_the_midst_of_an_import_ends_by_its_code(tmp_path):
    """Not by a signal, as Python would have it."""
    code = (
        "import sys; import thzcl.commands.check as command; from thzcl.__main__ import main;"
        "command.changes = lambda _: exec('raise KeyboardInterrupt');"
        "sys.exit(main(['check', 'quick']))"
    )
    (tmp_path / "interrupted.py").write_text(code, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"],
        capture_output=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert (done.returncode, done.stdout) == (130, b"")
    assert done.stderr == b"interrupted; nothing was left half-written\n"


INTERRUPTED = b"interrupted; nothing was left half-written\n"


@pytest.mark.parametrize(
    ("module", "then", "due"),
    [
        ("os.kill(os.getpid(), signal.SIGINT); time.sleep(0.1); print('set up')", "", b"set up\n"),
        ("os.kill(os.getpid(), signal.SIGTERM); time.sleep(60); print('never')", "", b""),
        ("", ("weakref.finalize(gone := Gone(), os.kill, os.getpid(), signal.SIGINT); del gone; "
         "time.sleep(0.1); print('never')"), b""),
    ],
    ids=["within a short import", "within a long import", "within a destructor"],
)  # fmt: skip
def test_an_interrupt_waits_for_imports_and_is_never_dropped(tmp_path, module, then, due):
    imports = "import os, signal, sys, time, weakref\n"
    (tmp_path / "slowly.py").write_text(imports + module, encoding="utf-8")
    code = (
        "import thzcl.commands.check as command\nfrom thzcl.__main__ import main\n"
        "class Gone: pass\n"
        f"def changes(_):\n    import slowly\n    {then}\n    time.sleep(0.1)\n    print('never')\n"
        "command.changes = changes\nsys.exit(main(['check', 'quick']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", imports + code],
        capture_output=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
        timeout=30,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, due, INTERRUPTED)


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&- >&- 2>&-"])
def test_closed_streams_change_no_exit_code(tmp_path, closed):
    assert shell(f"{COMMAND} run quick --no-figure {closed}", tmp_path).returncode == 0
    assert (tmp_path / "quick.nc").read_bytes()[1:4] == b"HDF"
    for wrong in ("check nothing.toml", "rum", "run quick --fast", ""):
        assert shell(f"{COMMAND} {wrong} {closed}", tmp_path).returncode == 2


def test_no_file_takes_the_place_of_a_closed_stream(tmp_path):
    """Else what a library prints would be written into it."""
    code = (
        "import os; from thzcl.__main__ import main; main(['check', 'quick']);"
        "file = open('told', 'w'); file.write(str(file.fileno()))"
    )
    shell(f'{sys.executable} -c "{code}" <&- >&- 2>&-', tmp_path)
    assert int((tmp_path / "told").read_text(encoding="ascii")) > 2


def test_full_streams(tmp_path):
    """What cannot be printed is an error on stdout, which holds data, and none on stderr."""
    for command in ("check quick", "scenarios", "absorption --frequency-ghz 340 --format csv"):
        done = shell(f"{COMMAND} {command} >/dev/full", tmp_path)
        assert done.returncode == 2
        assert done.stderr == b"No space left on device; make room, or choose another place\n"
    assert shell(f"{COMMAND} check nothing.toml 2>/dev/full", tmp_path).returncode == 2
    assert shell(f"{COMMAND} check quick 2>/dev/full", tmp_path).returncode == 0


@pytest.mark.parametrize(
    "command", ["absorption --frequency-ghz 1:1000:0.1 --format csv", "--help", "scenarios"]
)
def test_a_reader_that_stops_reading_is_no_error(tmp_path, command):
    done = shell(f"({COMMAND} {command}; echo $? >&2) | true", tmp_path)
    assert done.stderr == b"0\n"
    done = shell(f"({COMMAND} {command}; echo $? >&2) | head -1", tmp_path)
    assert done.stdout
    assert done.stderr == b"0\n"


def test_terminals_without_the_letters(tmp_path):
    """The degree sign in the names of variants, and the lines of tables and help."""
    done = shell(f"{COMMAND} plan figure7", tmp_path, PYTHONIOENCODING="ascii")
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"40 m, -10 \\xb0C" in done.stdout
    assert shell(f"{COMMAND} --help", tmp_path, PYTHONIOENCODING="ascii").returncode == 0


def test_names_without_the_letters(tmp_path):
    """Under a locale that is not UTF-8, in scene, messages, and files with what is in them."""
    import h5netcdf

    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    write(tmp_path, scene(camera__pixels=[8, 8]), "é")
    done = shell(f"{COMMAND} run é.toml", tmp_path, **plain)
    assert (done.returncode, done.stderr) == (0, b"")
    with h5netcdf.File(tmp_path / "é.nc") as file:
        assert file.attrs["scenario_name"] == "é"
    assert (tmp_path / "é.png").exists()
    done = shell(f"{COMMAND} run ü.toml", tmp_path, **plain)
    assert done.returncode == 2
    assert b"no such file" in done.stderr


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_exits_130_and_leaves_nothing(tmp_path, sent):
    scenario = write(
        tmp_path, scene(camera__pixels=[4000, 3000], background__max_range_m=2000.0, ground=None)
    )
    command = [sys.executable, "-m", "thzcl", "run", str(scenario), "-o", str(tmp_path / "out")]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60
        while not (tmp_path / "out").exists() and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(0.3)
        process.send_signal(sent)
        _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert errors == "interrupted; nothing was left half-written\n"
    assert list((tmp_path / "out").iterdir()) == []
