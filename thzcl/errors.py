"""Every error that a user can do something about, with the exit code of a command that meets it.

The codes are 0 done, 2 bad input, 3 no usable device or linker, 4 the numbers or a plugin failed,
130 interrupted.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence
from typing import Any, ClassVar

DONE, BAD_INPUT, NO_DEVICE, FAILED, INTERRUPTED = 0, 2, 3, 4, 130

_ADVICE = {
    errno.ENOENT: "check the name",
    errno.ENOTDIR: "a folder in its path is a file; check the name",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ELOOP: "a link leads back to itself; mend the link",
    errno.EISDIR: "give a file, not a folder",
    errno.EEXIST: "a file stands in the way; move it, or choose another name",
    errno.EACCES: "change its permissions, or choose another place",
    errno.EPERM: "change its permissions, or choose another place",
    errno.EROFS: "choose another place",
    errno.ENOSPC: "make room, or choose another place",
    errno.EDQUOT: "make room, or choose another place",
    errno.EFBIG: "raise the limit on the size of files (ulimit -f), or choose another place",
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "close other programs, and try again",
    errno.EIO: "the disk or the network failed; try again, or choose another place",
}
_LESS = (
    "lower pixels, samples_per_pixel, grid or the number of frequencies, "
    "or run variants apart with --variant"
)


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


class RangeError(ThzclError, ValueError):
    """Air is asked for its optics where a constituent of it is not valid.

    `quantity` is what lies outside, as thzcl.constituent.Span has it, and `value` what it is.
    """

    def __init__(self, text: str, quantity: str, value: float) -> None:
        super().__init__(text)
        self.quantity, self.value = quantity, value


class RecordError(ThzclError):
    """A hygrometer's record cannot be read or analysed. Each problem is one line."""

    @property
    def problems(self) -> tuple[str, ...]:
        """Returns the message, one line for each problem."""
        return tuple(str(self).splitlines())


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


def advice(error: OSError) -> str:
    """Returns what a user can do about an error of the operating system, by its number."""
    return _ADVICE.get(error.errno or 0, "check the file and where it lies")


def explained(error: BaseException) -> tuple[int, tuple[str, ...]] | None:
    """Returns exit code and message, one line a problem, of an error that a user can act on.

    Returns None for any other error, which is a bug.
    """
    if isinstance(error, ThzclError):
        return error.exit_code, error.problems
    if isinstance(error, KeyboardInterrupt):
        return INTERRUPTED, ("interrupted; nothing was left half-written",)
    if isinstance(error, MemoryError):
        return BAD_INPUT, (_too_large(str(error)),)
    if isinstance(error, OSError):
        place = "" if error.filename is None else f"{error.filename}: "
        reason = error.strerror or str(error) or type(error).__name__
        if error.errno == errno.ENOMEM:
            return BAD_INPUT, (place + _too_large(reason),)
        return BAD_INPUT, (f"{place}{reason}; {advice(error)}",)
    return None


def _too_large(reason: str) -> str:
    """Returns the message for memory that was refused, for a reason that may be empty."""
    told = f" ({reason})" if reason else ""
    return f"too large for the memory that this process may use{told}; {_LESS}"
