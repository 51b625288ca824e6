"""The one door to other people's code: whatever goes wrong behind it comes out as one error."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

from thzcl.errors import PluginError, PluginFailure

Answer = TypeVar("Answer")
_in_progress: list[list[BaseException]] = []  # what the main thread's outermost call notes


class Breach(Exception):  # noqa: N818 (it says what happened)
    """A plugin does not keep its contract: the text says how."""


def call(
    owner: str,
    function: Callable[..., Answer],
    *arguments: Any,
    error: type[PluginError | PluginFailure] = PluginFailure,
    let: tuple[type[Exception], ...] = (),
) -> Answer:
    """Returns what a plugin's function returns for some arguments.

    `owner` says in words which plugin of which distribution it is. Raises `error`, which names it,
    for whatever the function raises, SystemExit and a KeyboardInterrupt of its own included; the
    exceptions in `let` pass through. A signal that the user sends still interrupts: what its
    handler raises is raised here, whatever the plugin makes of it.
    """
    with _signals() as interrupts:
        try:
            answer = function(*arguments)
        except BaseException as raised:
            if interrupts:
                raise interrupts[0] from None
            if isinstance(raised, let):
                raise
            raise error(f"{owner}: {_reason(raised)}") from raised
    if interrupts:  # the plugin has swallowed it
        raise interrupts[0]
    return answer


def _reason(raised: BaseException) -> str:
    """Returns what was raised in words; an exception whose text breaks has its type's name only."""
    name = type(raised).__name__
    try:
        text = str(raised)
    except Exception:  # noqa: BLE001 (a stranger's __str__)
        text = ""
    if isinstance(raised, Breach):
        return text
    return f"{name}: {text}" if text else name


@contextmanager
def _signals() -> Iterator[list[BaseException]]:
    """Yields the exceptions that handlers of signals raise meanwhile.

    Handlers run in the main thread alone, so that elsewhere there is nothing to tell apart. A call
    within a call has the list of the outer one.
    """
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    if _in_progress:
        yield _in_progress[0]
        return
    raised: list[BaseException] = []
    replaced: list[tuple[int, Callable[[int, FrameType | None], Any]]] = []
    _in_progress.append(raised)
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU):
            handler = signal.getsignal(number)
            if callable(handler):
                replaced.append((number, handler))
                signal.signal(number, _noting(handler, raised))
        yield raised
    finally:
        for replaced_number, own in replaced:
            signal.signal(replaced_number, own)
        _in_progress.clear()


def _noting(
    handler: Callable[[int, FrameType | None], Any], raised: list[BaseException]
) -> Callable[[int, FrameType | None], Any]:
    """Returns a handler that keeps what another one raises."""

    def noting(number: int, frame: FrameType | None) -> Any:
        try:
            return handler(number, frame)
        except BaseException as interrupt:
            raised.append(interrupt)
            raise

    return noting
