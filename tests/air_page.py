"""Makes thzcl/air/README.md: which absorption model is true, as far as it is known.

    python tests/air_page.py

Its numbers and sentences are those of `thzcl absorption --validation`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, not an installed thzcl

from thzcl.air import validation
from thzcl.air.validation import CLIMATES, MEASURED, MISSING, MODELS, WINDOWS_GHZ

PAGE = Path(__file__).parents[1] / "thzcl" / "air" / "README.md"
INTRODUCTION = """# Which air is true

Nobody can say. Four models of the gas come with thzcl that need no file, and in the windows between
lines of water, which are what an imager looks through, they differ by 7 to 23 %. That is more than
every numerical error of an image: over 64 m of saturated air of 2 °C, at 650 GHz, `mpm93` lets pass
0.42 and `r24` 0.50. `[atmosphere] compare = ["p676-13", "r24"]` tells by target what it would be by
other models, for little more time, and `[output] model_spread = true` shows it as an image.

`thzcl absorption --validation` prints this page, `thzcl absorption --model mpm93 --model r24` with
frequencies and air of your own compares any models there, and `thzcl constituents NAME` is a
model's manual page. All numbers here are for 1013.25 hPa.

![Four models in four climates, and their ratio to MPM93](../../scenarios/gallery/models.png)

    thzcl absorption --validation --figure models.png

## In the windows

Attenuation in dB/km, in the climates of the paper's figures 7 to 9. The spread is the largest less
the smallest, over the largest. `r24` ends at 800 GHz: above, too many lines are not in its list.
"""
READING = """At the centres of lines the models agree to some 5 %. Between lines they differ in what
stands for the continuum of water vapour, and in the wings of lines. The two `mpm93` differ from
each other by two lines only, at 547.7 and 552.0 GHz, whose printed strengths are wrong: by some 16
% at 550 GHz, and by 1.2 to 1.6 % at 650 GHz. `r24` is the lowest at 650 GHz, and in the cold from
140 GHz on; in hot and humid air up to 340 GHz it is `p676-13`.
"""
MEASUREMENTS = """## What was measured

What could be had are abstracts, and this is all that their words allow.
"""
CONTINUUM = """Podobedov et al. (2008, J. Quant. Spectrosc. Radiat. Transfer 109, 458,
doi:10.1016/j.jqsrt.2007.07.005) give numbers: a continuum of 3.83 (water with itself) and 0.185
(with nitrogen) (dB/km)/(kPa THz)^2 from 0.3 to 2.7 THz and 293 to 333 K, with exponents of 1/T of
8.8 and 5.7, beside lines of HITRAN 2004 that are cut off 3 THz away. At 650 GHz that is, in dB/km,
beside the continuum of `r24`, whose lines end 0.75 THz away, so that more is left to it (the
reference temperature is not in the abstract, and taken to be 296 K):
"""
AFTER = """`r24` has the larger one, as it must. How large it should be cannot be said without
the wings that Podobedov et al. summed. The other three models have a line at 1780 GHz for a
continuum, with which this one cannot be compared.

Could not be had:
"""
MADE = """This page is made by `python tests/air_page.py`.
"""


def page() -> str:
    """The whole page."""
    rows = validation.windows()
    tables = [
        f"### {climate.name}\n\n{_table(_head(), _windows(rows, climate.name))}"
        for climate in CLIMATES
    ]
    measured = _table(("published", "found", "says of the models"), MEASURED)
    continua = [
        (row["climate"], f"{row['measured_db_km']:.3g}", f"{row['r24_db_km']:.3g}")
        for row in validation.continua()
    ]
    numbers = _table(("climate", "Podobedov et al.", "`r24`"), continua)
    missing = "".join(f"- {what}\n" for what in MISSING)
    parts = (INTRODUCTION, *tables, READING, MEASUREMENTS, measured, CONTINUUM, numbers, AFTER)
    return "\n".join([*parts, missing, MADE])


def _head() -> tuple[str, ...]:
    return ("GHz", *(f"`{model}`" for model in MODELS), "spread")


def _windows(rows: list[dict[str, Any]], climate: str) -> list[tuple[str, ...]]:
    """The rows of one climate."""
    found = [row for row in rows if row["climate"] == climate]
    assert [row["frequency_ghz"] for row in found] == [*WINDOWS_GHZ]
    return [
        (
            f"{row['frequency_ghz']:g}",
            *("" if row[model] is None else f"{row[model]:.4g}" for model in MODELS),
            f"{row['spread_percent']:.0f} %",
        )
        for row in found
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
