"""Mutated scenes are refused in words, or computed; `tests/fuzz.py` tries more of them."""

from __future__ import annotations

import fuzz
import fuzz_files
import pytest


@pytest.mark.slow
@pytest.mark.parametrize("seed", [101])
def test_mutated_scenes_are_refused_or_run(device, seed):
    ends, broken = fuzz.search(seed, 200, device)
    assert not broken, "\n".join(broken)
    assert ends["ran"] > 10
    assert ends["refused 2"] > 50


@pytest.mark.slow
@pytest.mark.parametrize("kind", fuzz_files.KINDS)
def test_damaged_files_and_odd_settings_are_refused_or_used(kind):
    ends, broken = fuzz_files.search(kind, 104, 30)
    assert not broken, "\n".join(broken)
    assert ends["refused"] > 2
