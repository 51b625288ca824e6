"""Kernels take their arguments by the names in their source, and families have their options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from conftest import ROOT

from thzcl.device import signature
from thzcl.device.kernels import Kernels
from thzcl.device.signature import Parameter

SOURCE = """
// __kernel void commented(int a)
/* kernel void out(int a, int b) */
static void helper(int a) { }
__kernel void one(__global const float *restrict out, __constant box *boxes, int n) { helper(n); }
kernel void two(
    uint2 seed,   // of two words, with a comma
    global char*kind, const volatile real  x) { }
__kernel void three() { }
"""
SUBTRACT = "__kernel void subtract(__global int *from, int less, __global int *to)"
BODY = "{ int i = get_global_id(0); to[i] = from[i] - less; }"


def test_signatures_are_read_from_the_source():
    found = signature.signatures(SOURCE)
    assert set(found) == {"one", "two", "three"}
    assert found["one"] == (
        Parameter("out", "float", True),
        Parameter("boxes", "box", True),
        Parameter("n", "int", False),
    )
    assert found["two"] == (
        Parameter("seed", "uint2", False),
        Parameter("kind", "char", True),
        Parameter("x", "real", False),
    )
    assert found["three"] == ()


@pytest.mark.parametrize("path", sorted((ROOT / "kernels").rglob("*.cl")), ids=lambda p: p.stem)
def test_every_kernel_of_the_house_is_read(path):
    source = path.read_text(encoding="utf-8")
    assert len(signature.signatures(source)) == source.count("__kernel void ")


@pytest.fixture
def subtract(device):
    program = device.compile(f"{SUBTRACT} {BODY}", [])
    return lambda **arguments: program.run("subtract", 16, **arguments)


def test_arguments_go_where_their_names_say_in_any_order(device, subtract):
    one, other = device.put(np.arange(16, dtype=np.int32)), device.put(np.zeros(16, np.int32))
    subtract(to=other, less=3, **{"from": one})
    assert np.array_equal(other.host(), np.arange(16) - 3)


def test_names_that_a_kernel_does_not_have_are_refused(device, subtract):
    one, other = (device.put(np.zeros(16, np.int32)) for _ in range(2))
    good = {"from": one, "less": 3, "to": other}
    launches = device.counters.launches
    with pytest.raises(TypeError, match="subtract takes no more, lacks less"):
        subtract(**{"more" if name == "less" else name: value for name, value in good.items()})
    with pytest.raises(TypeError, match=r"the kernel subtract lacks to$"):
        subtract(**{name: value for name, value in good.items() if name != "to"})
    with pytest.raises(TypeError, match="takes no also"):
        subtract(**good, also=1)
    with pytest.raises(TypeError, match="from of the kernel subtract: float32, not int32"):
        subtract(**good | {"from": device.put(np.zeros(16, np.float32))})
    with pytest.raises(TypeError):
        subtract(**good | {"less": one})
    assert device.counters.launches == launches


@dataclass(frozen=True)
class Family(Kernels):
    files: ClassVar = ("paths/nowhere",)

    moments: int
    counts: tuple[int, ...]
    cutoff: int | None = None
    motion: bool = False


def test_options_are_named_after_their_fields():
    assert Family(0, (3, 1)).options() == ["MOMENTS=0", "COUNTS=3,1"]
    assert Family(2, (1,), 16, True).options() == ["MOMENTS=2", "COUNTS=1", "CUTOFF=16", "MOTION"]
    assert Family(2, (1,)) == Family(2, (1,), None)
    with pytest.raises(TypeError):
        Family(2, (1,), moment=3)
