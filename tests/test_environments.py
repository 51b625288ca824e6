"""A few odd environments; `python tests/environments.py` tries many."""

from __future__ import annotations

import environments
import pytest


@pytest.mark.slow
def test_odd_environments_do_no_harm(monkeypatch):
    monkeypatch.setattr(environments, "LONGEST_S", 300.0)  # a busy machine is no hang
    broken = environments.search(seed=20, count=3)
    assert not broken, "\n".join(broken)
