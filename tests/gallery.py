"""Makes scenarios/README.md, the gallery, and the pictures that the documents show.

    python tests/gallery.py                       the page
    python tests/gallery.py figure7 raster ...    these pictures anew, and the page

The words of the page are the comments at the top of the scenes.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, not an installed thzcl

from thzcl.scenario.source import shipped

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "scenarios"
PAGE, PICTURES = SCENES / "README.md", SCENES / "gallery"
RECORD = "tests/data/hygrometer_20hz_2012-06-07_1245.dat"
SPECTRUM = "thzcl absorption --relative-humidity-percent 50 --frequency-ghz"
# Each picture in scenarios/gallery, and the command that makes it, run in the checkout.
COMMANDS = {
    **{name: f"thzcl run {name}" for name in shipped()},
    "figure5": f"{SPECTRUM} 100:1000:1 --figure figure5.png",
    "attenuation-temperature": f"{SPECTRUM} 350,650,850 --temperature-k 253.15:313.15:1 "
    "--figure attenuation-temperature.png",
    "models": "thzcl absorption --validation --figure models.png",
    "lookout-range": "thzcl range lookout --target person --frequency-ghz 340,650,"
    "850 --probability 0.95 --ranges 40:160:20 --air 40 --seed 1",
    "figure6-convergence": "thzcl convergence figure6",
    "figure7-convergence": "thzcl convergence figure7",
    **{
        f"{Path(RECORD).stem}-{kind}": f"thzcl fluctuations {RECORD} -o out"
        for kind in ("time", "wind-run", "spectrum")
    },
}
INTRODUCTION = """# Gallery

The scenes that come with thzcl, each with the picture that its command makes. `thzcl scenarios`
lists them, `thzcl new` copies `quick`, and every file here can be copied and changed:
[KEYS.md](KEYS.md) tells every key. The subject of figures 7 to 9 is a phantom, drawn by
[phantom.py](phantom.py), since the paper's own is not public. [IMAGERS.md](IMAGERS.md) has the
noise of imagers that exist beside thzcl's.
"""
ABSORPTION = """## Absorption

![Attenuation of moist and dry air from 100 to 1000 GHz](gallery/figure5.png)

    {figure5}

The paper's figure 5: air of 50 % relative humidity at 15 °C, and dry air. `--format csv` or `json`
prints the numbers.

![Attenuation at three frequencies against temperature](gallery/attenuation-temperature.png)

    {temperature}

The same at three frequencies against temperature, as in the slides.

Absorption is MPM93 (Liebe, Hufford and Cotton 1993) in float64. Two things to know. MPM93's printed
strengths of two water isotopologue lines, at 547.676 and 552.021 GHz, are about 10 and 81 times too
strong; `model = "mpm93-corrected"` uses the physical ones, which changes 650 GHz by -1.2 to -1.5 %
and 550 GHz by some -16 %. And MPM93 itself stands 6 to 21 % above ITU-R P.676 in the windows above
300 GHz: agreement is with the named model. [Which air is true](../thzcl/air/README.md) has four
models side by side.
"""
MADE = """This page is made of the comments at the top of the scenes by `python tests/gallery.py`;
`python tests/gallery.py figure7` makes a picture anew as well.
"""


def page() -> str:
    """The whole page."""
    order = sorted(shipped(), key=lambda name: (name not in ("quick", "uniform"), name))
    absorption = ABSORPTION.format(
        figure5=COMMANDS["figure5"], temperature=COMMANDS["attenuation-temperature"]
    )
    return "\n".join([INTRODUCTION, *map(scene, order), absorption, MADE])


def scene(name: str) -> str:
    """A scene's picture, its command, and what the comment at its top says."""
    said = "\n\n".join(
        textwrap.fill(part, 100, break_long_words=False, break_on_hyphens=False)
        for part in paragraphs((SCENES / f"{name}.toml").read_text(encoding="utf-8"))
    )
    picture = f"![{shipped()[name]}](gallery/{name}.png)"
    return f"## {name}\n\n{picture}\n\n    {COMMANDS[name]}\n\n{said}\n"


def paragraphs(toml: str) -> list[str]:
    """The paragraphs of the comment at the top of a scene, each in one line."""
    lines = []
    for line in toml.splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("#").strip())
    return [" ".join(part.split("\n")) for part in "\n".join(lines).split("\n\n")]


def draw(names: Iterable[str]) -> None:
    """Makes pictures anew, each by its command."""
    wanted: dict[str, list[str]] = {}
    for name in names:
        wanted.setdefault(COMMANDS[name], []).append(name)
    for command, pictures in wanted.items():
        print(command, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            words = [str(ROOT / word) if word == RECORD else word for word in shlex.split(command)]
            subprocess.run(
                [sys.executable, "-m", *words],
                cwd=folder,
                env=os.environ | {"PYTHONPATH": str(ROOT)},
                stdout=subprocess.DEVNULL,
                check=True,
            )
            for name in pictures:
                (made,) = Path(folder).rglob(f"{name}.png")
                shutil.copy(made, PICTURES / made.name)


if __name__ == "__main__":
    draw(sys.argv[1:])
    PAGE.write_text(page(), encoding="utf-8")
