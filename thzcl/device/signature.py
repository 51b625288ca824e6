"""What arguments a kernel takes, read from its source, so that they can be passed by name."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_KERNEL = re.compile(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(([^()]*)\)")
# Parameters that several kernels have in common, as a macro of such a name.
_SHARED = re.compile(r"#define\s+(\w+_PARAMETERS)\b((?:[^\n]*\\\n)*[^\n]*)")
_QUALIFIERS = {"__global", "__constant", "__local", "global", "constant", "local"}
_QUALIFIERS |= {"const", "restrict", "volatile"}


class Parameter(NamedTuple):
    """One parameter of a kernel: `type` is what it holds, or what it points to."""

    name: str
    type: str
    pointer: bool


def signatures(source: str) -> dict[str, tuple[Parameter, ...]]:
    """Returns the parameters of every kernel of a source text, in their order."""
    plain = _COMMENT.sub(" ", source)
    for name, shared in _SHARED.findall(plain):
        plain = re.sub(rf"(?<!#define )\b{name}\b", shared.replace("\\\n", " "), plain)
    return {
        name: tuple(_parameter(declared) for declared in inside.split(",") if declared.strip())
        for name, inside in _KERNEL.findall(plain)
    }


def _parameter(declared: str) -> Parameter:
    """Returns a parameter from its declaration."""
    words = [word for word in declared.replace("*", " * ").split() if word not in _QUALIFIERS]
    return Parameter(words[-1], words[0], "*" in words)


def check(kernel: str, parameters: Iterable[Parameter], passed: Iterable[str]) -> None:
    """Raises TypeError where names that are passed to a kernel are not those of its parameters."""
    wanted, given = {parameter.name for parameter in parameters}, set(passed)
    wrong = [f"takes no {name}" for name in sorted(given - wanted)]
    wrong += [f"lacks {name}" for name in sorted(wanted - given)]
    if wrong:
        raise TypeError(f"the kernel {kernel} {', '.join(wrong)}")
