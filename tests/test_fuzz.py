"""Mutated scenes are refused in words, or computed; `tests/fuzz.py` tries more of them."""

from __future__ import annotations

import fuzz
import pytest


@pytest.mark.slow
@pytest.mark.parametrize("seed", [101, 102])
def test_mutated_scenes_are_refused_or_run(device, seed):
    ends, broken = fuzz.search(seed, 400, device)
    assert not broken, "\n".join(broken)
    assert ends["ran"] > 20
    assert ends["refused 2"] > 100
