"""Long kernels run in pieces, which an interrupt may part, and make the same image."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from scenes import run, scene

from thzcl.device import opencl

SCENES = {
    "trace": {},
    "bands": {"sensor": {"kind": "passive-broadband", "center_ghz": 650, "bandwidth_ghz": 20}},
    "emission": {"atmosphere__fluctuations__temperature_sigma_k": 2.0},
    "large eddies": {"atmosphere__fluctuations__large_scales": True},
    "thinned": {"numerics": {"ray_stride": 2}},
}


@pytest.mark.parametrize("case", SCENES)
def test_pieces_make_the_same_image(tmp_path, monkeypatch, device, case):
    data = scene(camera__pixels=[40, 37], **SCENES[case])
    whole = run(tmp_path, data, device=device)
    cut = []

    def noted(self, *arguments):
        cut.append(found := plain(self, *arguments))
        return found

    plain = opencl.Device.cut
    monkeypatch.setattr(opencl.Device, "cut", noted)
    monkeypatch.setattr(opencl, "AT_ONCE", 2e3)
    pieces = run(tmp_path, data, device=device)
    assert len({count for count, _ in cut}) > 1
    for name in ("contrast", "optical_depth"):
        one, other = (getattr(result.variants[0].sight, name) for result in (whole, pieces))
        assert np.array_equal(one, other)


def test_pieces_are_whole_groups_or_single_items(device):
    group, units = opencl.GROUP, device.units
    assert device.cut(1000.9, 10_000, group) == (1000 // group * group, group)
    assert device.cut(1e9, 10 * units * group, group) == (10 * units * group, group)
    assert device.cut(0.1, 10_000, group) == (units, 1)
    assert device.cut(1e9, 3, group) == (3, 1)


def test_an_interrupt_is_obeyed_before_the_next_piece(tmp_path, monkeypatch, device):
    calls = []

    def interrupted(self, *arguments):
        calls.append(arguments)
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        return plain(self, *arguments)

    plain = opencl.Device.cut
    monkeypatch.setattr(opencl.Device, "cut", interrupted)
    monkeypatch.setattr(opencl, "AT_ONCE", 2e3)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, scene(camera__pixels=[40, 37]), device=device)
    assert len(calls) == 2
