"""Mutated plugins, which thzcl must refuse in words or make do with: nothing else.

`python tests/fuzz_plugins.py --seed 1 --count 150` tries as many, each in processes of its own, and
prints what broke. A plugin is one of the examples, some of whose attributes, arguments, answers and
statements have been taken away, or replaced by what nobody meant.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import h5py
import numpy as np
from packages import plugin

TESTS = Path(__file__).parent
LONGEST_S = 60.0
CONTRACT = {0, 2, 3, 4}
BROKEN = ("Traceback", "a bug in thzcl", "LLVM ERROR", "terminate called", "Segmentation")
SMALL = ("--set", "camera.pixels=[12,10]", "--set", "atmosphere.fluctuations.grid=16")
# Kind of plugin: its source, its module, and the settings that put it into a scene.
PLUGINS = {
    "sensors": (
        TESTS / "example_sensor" / "example_dicke.py",
        'sensor={kind="dicke",frequency_ghz=340,reference_k=290,noise_k=0.1}',
    ),
    "constituents": (TESTS / "grey_dust" / "grey_dust.py", "atmosphere.dust={per_km=2.0}"),
}
NAMES = {"sensors": "dicke", "constituents": "dust"}
TABLES = {"sensors": "[sensor]", "constituents": "[atmosphere"}  # of a scene, with their keys
VALUES = (
    "None", "0", "1e300", "float('nan')", "float('inf')", "2**70", "True", "''", "'x'", "b'x'",
    "'\\x00'", "'mpm93'", "'\\ud800'", "[]", "[[]]", "{}", "()", "[1.0, None]", "object",
    "lambda *a: 1", "iter([1, 2])", "1j", "np.nan * np.ones((10, 12))", "np.ones((10, 12)) * 1j",
    "np.ones((3, 4, 5))", "np.ones(0)", "np.array(['a', 'b'])", "np.array([None, 1])",
    "np.ma.masked_all((10, 12))", "np.full((10, 12), np.inf)", "np.ones((10, 12), np.float16)",
    "np.ones((10, 12), bool)", "np.zeros((10, 12), 'datetime64[s]')", "np.ones((10, 12)).T",
    "'a' * 10**6", "type('Z', (), {})", "NotImplemented", "...", "range(10**9)",
    "np.broadcast_to(1.0, (10**5, 10**5))", "[1e12] * 100_000",
)  # fmt: skip
STATEMENTS = (
    "raise ValueError", "raise SystemExit(0)", "raise KeyboardInterrupt", "raise MemoryError",
    "raise type('É', (BaseException,), {'__str__': lambda s: 1 / 0})",
    "raise RecursionError",
    "raise StopIteration", "raise UnicodeDecodeError('utf-8', b'\\xff', 0, 1, 'x')",
    "raise OSError(28, 'No space left on device')", "raise UserWarning('\\ud800 [bold]x[/nope]')",
    "import nothing_of_that_name", "1 / 0", "(lambda f: f(f))(lambda f: f(f))",
    "print('word\\udcff'.encode('utf-8', 'surrogateescape'))", "print('rubbish {\"a\": 1}')",
    "import warnings; warnings.warn('beware')", "import warnings; warnings.simplefilter('error')",
    "np.seterr(all='raise')", "import os; os.chdir('/')", "import sys; sys.stdout.close()",
    "import sys; sys.exit('bye')", "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)",
    "import random; np.random.seed(0)", "import sys; sys.setrecursionlimit(60)",
    "import locale; locale.setlocale(locale.LC_ALL, 'C')", "import os; os.environ.clear()",
    "vars(self).clear()", "self.params.frequency_ghz = 5", "sight.optical_depth[:] = np.nan",
    "sight.brightness_temperature[0][:] = np.nan", "rng.bit_generator.state = None", "return",
    "del self.params", "type(self).name = 'active'", "temperature_k[...] = 0", "assert False",
    "import gc; gc.disable()", "import sys; sys.stderr = None", "import sys; sys.modules.clear()",
)  # fmt: skip
COMMANDS = ("run", "run", "run", "check", "plan", "manual", "list")


def mutated(source: str, rng: random.Random) -> tuple[str, str]:
    """Returns a plugin's text with one to three mutations, and what they were."""
    tree, told = ast.parse(source), []
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = [
            (node, name, child)
            for node in ast.walk(tree)
            for name, child in ast.iter_fields(node)
            if (isinstance(child, ast.expr) and isinstance(node, _HOLDERS))
            or (name == "body" and isinstance(child, list))
        ]
        node, name, child = rng.choice(places)
        if isinstance(child, ast.expr):
            new = rng.choice(VALUES)
            told.append(f"line {node.lineno}: {name} = {new}")
            setattr(node, name, ast.parse(new, mode="eval").body)
        elif rng.random() < 0.3 and len(child) > 1:
            gone = child.pop(rng.randrange(len(child)))
            told.append(f"line {gone.lineno} taken away")
        else:
            new = rng.choice(STATEMENTS)
            told.append(f"line {child[0].lineno}: before it, {new}")
            child[:0] = ast.parse(f"def f():\n  {new}").body[0].body  # type: ignore[attr-defined]
    imports = "import numpy as np\n" if "import numpy" not in source else ""
    return imports + ast.unparse(ast.fix_missing_locations(tree)) + "\n", "; ".join(told)


_HOLDERS = (ast.Return, ast.keyword, ast.Assign, ast.AnnAssign, ast.Dict)


def command_of(chosen: str, kind: str, setting: str) -> tuple[str, ...]:
    """Returns the words of a command that meets a plugin of some kind."""
    if chosen == "list":
        return (kind,)
    if chosen == "manual":
        return (kind, NAMES[kind])
    words = ("quick", *SMALL, "--set", setting)
    return (chosen, *words, *(("-o", "out") if chosen == "run" else ()))


def unsound(folder: Path) -> list[str]:
    """Returns what is wrong with the files that a run has left."""
    found = [f"left {path.name}" for path in folder.rglob(".thzcl-*")]
    for path in folder.rglob("*.nc"):
        with h5py.File(path) as file:
            for name, kept in file.items():
                if kept.dtype.kind == "f" and not np.isfinite(kept[...]).all():
                    found.append(f"{name} of {path.name} is not finite")
    return found


def tried(rng: random.Random) -> tuple[str, str | None]:
    """Tries one mutant. Returns how it ended, and what broke, if something did."""
    kind = rng.choice(tuple(PLUGINS))
    source, setting = PLUGINS[kind]
    text, told = mutated(source.read_text(encoding="utf-8"), rng)
    words = command_of(rng.choice(COMMANDS), kind, setting)
    with tempfile.TemporaryDirectory() as place:
        installed = Path(place) / "installed"
        installed.mkdir()
        environment = plugin(
            installed, text, NAMES[kind], "odd_module", "odd-plugins", f"thzcl.{kind}"
        )
        try:
            done = subprocess.run(
                [sys.executable, "-m", "thzcl", *words], cwd=place, env=os.environ | environment,
                capture_output=True, text=True, errors="replace", timeout=LONGEST_S, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "hung", f"{kind}: {told}\n  {words}\n  did not end in {LONGEST_S:.0f} s"
        said = done.stdout + done.stderr
        wrong = [text for text in BROKEN if text in said] + unsound(Path(place))
        if done.returncode not in CONTRACT:
            wrong.append(f"exit code {done.returncode}")
        told_of = ("odd-plugins", NAMES[kind], TABLES[kind])
        if done.returncode and not any(word in said for word in told_of):
            wrong.append("does not say whose plugin it is")
    end = f"{words[0]} {done.returncode}"
    if not wrong:
        return end, None
    return end, f"{kind}: {told}\n  {words}\n  {', '.join(wrong)}\n  {done.stderr[-700:]}"


def main() -> None:
    """Tries mutants, and prints what broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=150)
    asked = parser.parse_args()
    rng = random.Random(asked.seed)  # noqa: S311 (no secret)
    ends: Counter[str] = Counter()
    broken = 0
    for number in range(asked.count):
        end, wrong = tried(rng)
        ends[end] += 1
        if wrong:
            broken += 1
            print(f"--- {number} {wrong}", flush=True)
    print(dict(ends), f"{broken} broken")
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
