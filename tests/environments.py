"""Odd environments, in which thzcl must do its work or refuse it in words: nothing else.

`python tests/environments.py --seed 1 --count 90` runs commands in as many of them, and prints what
broke; `test_environments.py` tries a few. An environment is drawn from locales, widths and kinds of
terminals, homes, caches, streams, limits of the process, and users. Small full and read-only file
systems are mounted where the user may mount, and left out elsewhere.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

ROOT = Path(__file__).parents[1]
CONTRACT = {0, 2, 3, 4, 130}
LONGEST_S = 60.0
BROKEN = ("Traceback", "a bug in thzcl", "LLVM ERROR", "terminate called", "Segmentation")
NOBODY = 54321  # a user whom no machine knows
SMALL = ("--set", "camera.pixels=[12,10]", "--set", "atmosphere.fluctuations.grid=16")

COMMANDS = (
    ("run", "quick", "-o", "out", *SMALL),
    ("run", "quick", "-o", "out", *SMALL),
    ("run", "quick", "-o", "out", "--report", "--set", "camera.pixels=[12,10]"),
    ("run", "quick", "-o", "out", "--format", "json", *SMALL),
    ("run", "figure7", "-o", "out", "--variant", "40 m, 20 °C", *SMALL[:2]),
    ("study", "quick", "-o", "out/study", "--seeds", "2", *SMALL),
    ("plan", "figure7"),
    ("check", "figure9"),
    ("check", "nothere.toml"),
    ("absorption", "--frequency-ghz", "100:900:50", "--figure", "out/spectrum.png"),
    ("sensors", "active"),
    ("doctor",),
    ("devices",),
)
LOCALES: tuple[dict[str, str], ...] = (
    {},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"LC_ALL": "C.UTF-8"},
    {"LC_ALL": "tr_TR.UTF-8", "LANG": "xx_YY"},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1"},
)
COLUMNS = (None, "80", "20", "1", "0", "-5", "x", "100000")
TERMS = (None, "dumb", "xterm-256color", "", "unknown")
CACHES = ("XDG_CACHE_HOME", "POCL_CACHE_DIR", "MPLCONFIGDIR")
LIMITS: dict[str, tuple[int, int]] = {
    "4 GB": (resource.RLIMIT_AS, 4_000_000_000),
    "2 GB": (resource.RLIMIT_AS, 2_000_000_000),
    "1 GB": (resource.RLIMIT_AS, 1_000_000_000),
    "300 MB": (resource.RLIMIT_AS, 300_000_000),
    "500 MB of data": (resource.RLIMIT_DATA, 500_000_000),
    "24 files": (resource.RLIMIT_NOFILE, 24),
    "10 files": (resource.RLIMIT_NOFILE, 10),
    "files of 20 kB": (resource.RLIMIT_FSIZE, 20_000),
    "files of 2 MB": (resource.RLIMIT_FSIZE, 2_000_000),
    "a stack of 256 kB": (resource.RLIMIT_STACK, 256_000),
    "2 s": (resource.RLIMIT_CPU, 2),
    "4 processes": (resource.RLIMIT_NPROC, 4),
    "no locked memory": (resource.RLIMIT_MEMLOCK, 0),
}
GROUPS, GROUPS_MB = Path("/sys/fs/cgroup/memory"), (120, 160, 250, 400)
STREAMS = ("read", "closed", "full", "broken")


@dataclass
class Environment:
    """One environment, with the words that name it."""

    folder: Path
    command: tuple[str, ...]
    variables: dict[str, str] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    streams: tuple[str, str] = ("read", "read")  # stdout, stderr
    limit: str | None = None
    group: Path | None = None  # a control group with a limit of memory
    unknown: bool = False  # whether the user is one whom the machine does not know

    def run(self) -> str | None:
        """Returns what is wrong with how the command ended, or None."""
        with ExitStack() as stack:
            out, err = (stack.enter_context(_stream(kind)) for kind in self.streams)
            process = subprocess.Popen(
                [*self._prefix(), sys.executable, "-m", "thzcl", *self.command],
                cwd=self.folder,
                env=self.variables,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                preexec_fn=self._prepare,  # noqa: PLW1509 (there are no threads)
            )
            try:
                texts = process.communicate(timeout=LONGEST_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
                return f"did not end in {LONGEST_S:.0f} s"
        text = b"".join(one or b"" for one in texts).decode(errors="replace")
        if process.returncode not in CONTRACT:
            return f"exit {process.returncode}: {text[-600:]}"
        if any(word in text for word in BROKEN):
            return f"said: {text[-1500:]}"
        silent = self.streams == ("read", "read") and not text.strip()
        if process.returncode and silent:
            return f"exit {process.returncode} without a word"
        left = [str(path) for path in self.folder.rglob(".thzcl-*")]
        return f"left {', '.join(left)}" if left else None

    def _prefix(self) -> list[str]:
        if not self.unknown:
            return []
        return ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]

    def _prepare(self) -> None:
        """Closes streams and sets limits in the child, before it becomes thzcl."""
        if self.group is not None:
            (self.group / "cgroup.procs").write_text("0", encoding="ascii")
        if self.limit is not None:
            kind, most = LIMITS[self.limit]
            hard = resource.RLIM_INFINITY if kind == resource.RLIMIT_CPU else most
            resource.setrlimit(kind, (most, hard))
        for number, kind in enumerate(self.streams, start=1):
            if kind == "closed":
                os.close(number)


@contextmanager
def _stream(kind: str) -> Iterator[Any]:
    """Yields what a stream of the child is connected to."""
    if kind == "full":
        with Path("/dev/full").open("wb") as full:
            yield full
    elif kind == "broken":
        read, write = os.pipe()
        os.close(read)
        yield write
        os.close(write)
    else:
        yield subprocess.PIPE


class Places:
    """Folders of all kinds for caches and homes, below one folder; use as a context.

    `groups` are control groups by the megabytes that they allow, where the user may make some.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._mounted = folder, list[Path]()
        self.kinds: dict[str, Path] = {}
        self.groups: dict[int, Path] = {}

    def __enter__(self) -> Self:
        self.kinds = {
            "a file": self._folder / "file",
            "below a file": self._folder / "file" / "x",
            "not there": self._folder / "new" / "x",
            "impossible": Path("/proc/x"),
            "a device": Path("/dev/null"),
            "relative": Path("x"),
            "nothing": Path(),
        }
        self.kinds["a file"].touch()
        for kind, options in {
            "full": "size=200k",
            "no programs": "noexec",
            "small": "size=8m",
        }.items():
            self._mount(kind, options)
        if self._mount("read-only", "size=1m"):
            path = self.kinds["read-only"]
            subprocess.run(["mount", "-o", "remount,ro", path], check=True)  # noqa: S607 (whichever mount there is)
        for size in GROUPS_MB:
            path = GROUPS / f"thzcl-{os.getpid()}-{size}"
            with suppress(OSError):
                path.mkdir()
                (path / "memory.limit_in_bytes").write_text(f"{size}000000", encoding="ascii")
                self.groups[size] = path
        return self

    def _mount(self, kind: str, options: str) -> bool:
        path = self._folder / kind.replace(" ", "-")
        path.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"mode=777,{options}", "none", str(path)]
        done = subprocess.run(command, capture_output=True, check=False)
        if done.returncode == 0:
            self._mounted.append(path)
            self.kinds[kind] = path
        return done.returncode == 0

    def __exit__(self, *_: object) -> None:
        for path in self.groups.values():
            with suppress(OSError):  # the kernel keeps one while something runs in it
                path.rmdir()
        for path in self._mounted:
            subprocess.run(["umount", "-l", str(path)], check=False)  # noqa: S607 (whichever mount there is)


class Drawing:
    """Draws the oddities of one environment."""

    def __init__(self, rng: random.Random, folder: Path, places: Places) -> None:
        kept = {"PATH", "VIRTUAL_ENV", "HOME"}
        variables = {name: value for name, value in os.environ.items() if name in kept}
        variables |= {"PYTHONPATH": str(ROOT), "TMPDIR": str(folder / "passing")}
        # Python itself keeps modules that a limit has cut off, and breaks down on them later.
        variables["PYTHONDONTWRITEBYTECODE"] = "1"
        self.made = Environment(folder, rng.choice(COMMANDS), variables)
        self._rng = rng
        self._places = {kind: str(path) for kind, path in places.kinds.items()}
        self._groups = places.groups
        ways = [self._locale, self._terminal, self._home, self._cache, self._cache, self._cache]
        ways += [self._passing, self._streams, self._limit, self._group, self._unknown]
        for way in rng.sample(ways, rng.choice((1, 2, 2, 3, 4, 5))):
            way()

    def _set(self, name: str, value: str | None) -> None:
        """Sets a variable, or unsets it."""
        self.made.variables.pop(name, None)
        if value is not None:
            self.made.variables[name] = value
        self._tell(f"{name} {'unset' if value is None else repr(value)}")

    def _tell(self, words: str) -> None:
        self.made.words.append(words)

    def _locale(self) -> None:
        for name, value in self._rng.choice(LOCALES).items():
            self._set(name, value)

    def _terminal(self) -> None:
        self._set("COLUMNS", self._rng.choice(COLUMNS))
        self._set("TERM", self._rng.choice(TERMS))

    def _home(self) -> None:
        self._set("HOME", self._rng.choice([None, *self._places.values()]))

    def _cache(self) -> None:
        self._set(self._rng.choice(CACHES), self._rng.choice([*self._places.values()]))

    def _passing(self) -> None:
        self._set("TMPDIR", self._rng.choice([*self._places.values()]))

    def _streams(self) -> None:
        self.made.streams = self._rng.choice(STREAMS), self._rng.choice(STREAMS)
        self._tell(f"streams {self.made.streams}")

    def _limit(self) -> None:
        self.made.limit = self._rng.choice(list(LIMITS))
        self._tell(f"at most {self.made.limit}")

    def _group(self) -> None:
        if self._groups:
            size, self.made.group = self._rng.choice(list(self._groups.items()))
            self._tell(f"a control group of {size} MB")

    def _unknown(self) -> None:
        if os.getuid() == 0 and shutil.which("setpriv"):
            self.made.unknown = True
            self._set("HOME", None)
            self._tell("an unknown user")


def search(seed: int, count: int, tell: Callable[[str], None] = lambda _: None) -> list[str]:
    """Returns a report of each of `count` environments in which something broke."""
    rng, broken = random.Random(seed), []  # noqa: S311 (no secret)
    with tempfile.TemporaryDirectory() as above, Places(Path(above)) as places:
        for number in range(count):
            folder = Path(above) / str(number)
            for name in ("out", "passing"):
                (folder / name).mkdir(parents=True)
            for path in (Path(above), folder, folder / "out", folder / "passing"):
                path.chmod(0o777)
            made = Drawing(rng, folder, places).made
            wrong = made.run()
            where = f"{number}: {' '.join(made.command)}; {'; '.join(made.words)}"
            tell(f"{where}: {'fine' if wrong is None else 'BROKEN'}")
            if wrong:
                broken.append(f"{where}\n    {wrong}")
    return broken


def main() -> int:
    """Tries environments, and prints what broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=90)
    given = parser.parse_args()
    broken = search(given.seed, given.count, lambda text: print(text, flush=True))
    print(f"{given.count} environments, {len(broken)} broken", *broken, sep="\n")
    return bool(broken)


if __name__ == "__main__":
    sys.exit(main())
