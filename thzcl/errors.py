"""Every error that a user can do something about, with the exit code of a command that meets it.

0 done; 2 bad input; 3 no usable device or linker; 4 the numbers or a plugin failed; 130 interrupted.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

DONE, BAD_INPUT, NO_DEVICE, FAILED, INTERRUPTED = 0, 2, 3, 4, 130


class ThzclError(Exception):
    """An error with a message that says what to do about it."""

    exit_code: ClassVar[int] = BAD_INPUT

    @property
    def problems(self) -> tuple[str, ...]:
        """Returns the message, one line for each problem."""
        return (str(self),)


class ScenarioError(ThzclError):
    """A scenario cannot be used. Each problem is one line with place, value and remedy."""

    def __init__(self, problems: Sequence[str]) -> None:
        self._problems = tuple(dict.fromkeys(problems))
        super().__init__("\n".join(self._problems))

    @property
    def problems(self) -> tuple[str, ...]:
        """Returns the problems, each once."""
        return self._problems


class UsageError(ThzclError):
    """A command line makes no sense."""


class FileError(ThzclError, ValueError):
    """A file from outside cannot be read or used: the message holds file, place and remedy."""


class RecordError(ThzclError):
    """A hygrometer's record cannot be read or analysed."""


class PluginError(ThzclError):
    """A plugin is missing, or breaks its contract when it is loaded."""


class DeviceError(ThzclError):
    """There is no usable OpenCL device, or no linker for its kernels."""

    exit_code = NO_DEVICE


class PluginFailure(ThzclError):  # noqa: N818 (it says what happened)
    """A plugin broke while it worked."""

    exit_code = FAILED


class NumbersError(ThzclError):
    """An image is not finite, or its sensor failed; `result` keeps what was computed before."""

    exit_code = FAILED

    def __init__(self, text: str, result: Any) -> None:
        super().__init__(text)
        self.result = result
