"""Runs, studies and reports that are stopped at random moments.

`python tests/killer.py --seed 1 --count 100` stops as many by INT, TERM or KILL. After INT and TERM
the exit code is 130, or 0 where the work was done before, and nothing is left but whole files; what
KILL leaves, the next run in that folder sweeps up. It prints what broke.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import h5py
from PIL import Image

SMALL = ("--set", "camera.pixels=[24,20]", "--set", "atmosphere.fluctuations.grid=32")
COMMANDS = (
    ("run", "quick", "-o", ".", "--report", *SMALL),
    ("study", "quick", "-o", "study", "--seeds", "6", *SMALL),
    ("report", "made/quick.nc", "-o", "page.html"),
)
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
LONGEST_S = 60.0
RUN = (sys.executable, "-m", "thzcl")


def begun(command: tuple[str, ...], folder: Path) -> subprocess.Popen[bytes]:
    """Starts a command in a folder."""
    return subprocess.Popen(
        (*RUN, *command),
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509 (no threads)
    )  # fmt: skip  (a shell in the background has its commands ignore it)


def strays(folder: Path) -> list[str]:
    """Returns the unfinished files and folders of thzcl beneath a folder."""
    return [str(path.relative_to(folder)) for path in folder.rglob(".thzcl-*")]


def partial(folder: Path) -> list[str]:
    """Returns the finished files beneath a folder that are not whole."""
    found = []
    for path in folder.rglob("[!.]*.*"):
        try:
            if path.suffix == ".nc":
                with h5py.File(path) as file:
                    file["target"][...]
            elif path.suffix == ".png":
                Image.open(path).load()
            elif path.suffix == ".json":
                json.loads(path.read_text(encoding="utf-8"))
            elif path.suffix == ".html" and "</html>" not in path.read_text(encoding="utf-8"):
                raise ValueError("no end")
        except (OSError, ValueError, KeyError) as error:
            found.append(f"{path.name}: {error}")
    return found


def search(seed: int, count: int) -> tuple[Counter[str], list[str]]:  # noqa: C901 (one loop, many checks)
    """Returns how many commands ended how, and what broke."""
    rng = random.Random(seed)  # noqa: S311 (no secret)
    ends: Counter[str] = Counter()
    broken: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        made = Path(place) / "made"
        subprocess.run((*RUN, *COMMANDS[0][:2], "-o", made, *SMALL), check=True,
                       capture_output=True)  # fmt: skip
        lasts: dict[tuple[str, ...], float] = {}
        for number in range(count):
            command, stop = rng.choice(COMMANDS), rng.choice(SIGNALS)
            folder = Path(place) / str(number)
            folder.mkdir()
            (folder / "made").symlink_to(made)
            if command not in lasts:
                start = time.monotonic()
                begun(command, folder).communicate()
                lasts[command] = time.monotonic() - start
                for path in folder.iterdir():
                    if path.is_file():
                        path.unlink()
            process = begun(command, folder)
            after = rng.random() * lasts[command]
            time.sleep(after)
            process.send_signal(stop)
            start = time.monotonic()
            told = process.communicate()[1].decode(errors="replace")
            took, code = time.monotonic() - start, process.returncode
            wrong = [*partial(folder)]
            if stop == signal.SIGKILL:
                again = begun(command, folder)
                text = again.communicate()[1].decode(errors="replace")
                if again.returncode:
                    wrong.append(f"the next ends with {again.returncode}: {text[-300:]}")
                wrong += partial(folder)
            elif code not in (0, 130) and not (code == -stop and "thzcl" not in told):
                wrong.append(f"exit code {code}")
            wrong += [f"left {name}" for name in strays(folder)]
            if "Traceback" in told:
                wrong.append(told[-500:])
            if took > LONGEST_S:
                wrong.append(f"took {took:.0f} s to end")
            ends[f"{stop.name} {code}"] += 1
            if wrong:
                broken.append(f"--- {number} {command[0]} {stop.name} at {after:.2f} s: {wrong}")
    return ends, broken


def main() -> None:
    """Stops commands, and prints what broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    asked = parser.parse_args()
    ends, broken = search(asked.seed, asked.count)
    print("\n".join(broken))
    print(dict(ends), f"{len(broken)} broken")
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
