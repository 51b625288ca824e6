"""`thzcl` and `python -m thzcl`."""

from __future__ import annotations

import _thread
import io
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from thzcl.errors import DONE, FAILED, INTERRUPTED, explained

LONGEST_IMPORT_S = 1.0  # for which an interrupt waits
SOON_S = 0.02  # after which it is sent again


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line, that of the process if none is given, and returns its exit code.

    Every failure is a message on stderr and an exit code, never a traceback.
    """
    # NumPy's matrices here are small, but its threads would go on spinning on the cores that the
    # kernels need. A setting of the user's own stays.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _occupy_standard_files()
    try:
        with _ended_as_interrupted(), _any_letter_printed():
            from thzcl.commands.app import call

            code = call(sys.argv[1:] if arguments is None else arguments)
            if sys.stdout is not None:
                sys.stdout.flush()
    except BaseException as error:  # noqa: BLE001 (also an interrupt, and a library's sys.exit)
        code = DONE if _nobody_reads(error) else _complained(error)
    _give_up_broken_streams()
    return code


def _nobody_reads(error: BaseException) -> bool:
    """Returns whether an error says no more than that the reader of stdout has seen enough.

    Where rich meets that while it prints, it raises SystemExit.
    """
    return isinstance(error, BrokenPipeError) or isinstance(error.__context__, BrokenPipeError)


def _complained(error: BaseException) -> int:
    """Says what is wrong, and returns the exit code."""
    code, lines = explained(error) or (FAILED, [_report(error)])
    if code == INTERRUPTED:
        # An interrupt within exec() of a text, as dataclasses have it, leaves a mark for which
        # `python -m` ends itself by a signal, handled or not. The next exec() clears the mark.
        exec("")  # noqa: S102
    with suppress(OSError, ValueError):  # nobody can be told
        for line in lines:
            print(line, file=sys.stderr)
    return code


def _report(error: BaseException) -> str:
    """Returns what to say of an error that nobody foresaw."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    return (
        f"a bug in thzcl, or in what it is built on: {type(error).__name__}: {error} "
        f"({place.filename}, line {place.lineno}); please report it, with command and scene"
    )


def _occupy_standard_files() -> None:
    """Opens what a shell has closed of the standard files.

    Else the next file would take its number, and libraries would print into a result.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


@contextmanager
def _ended_as_interrupted() -> Iterator[None]:
    """Has what would end the process end a command as Ctrl-C does: with nothing left half written.

    That is a batch system's TERM, a terminal that closes, and a limit on processor time. Within an
    import all of them, and Ctrl-C, wait a little: extension modules end the process if one of their
    calls is interrupted while they are set up.
    """
    begun: list[float] = []
    later: list[threading.Timer] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        begun.append(time.monotonic())
        if not _imports(frame) or begun[-1] - begun[0] > LONGEST_IMPORT_S:
            raise KeyboardInterrupt
        later.append(threading.Timer(SOON_S, os.kill, (os.getpid(), number)))
        later[-1].start()

    replaced: dict[signal.Signals, Any] = {}
    usual = signal.SIG_DFL, signal.default_int_handler
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGXCPU):
            if signal.getsignal(number) in usual:
                replaced[number] = signal.signal(number, interrupt)
    except ValueError:  # in a thread, whose process has signals of its own
        yield
        return
    try:
        with _dropped_none():
            yield
    finally:
        for timer in later:
            timer.cancel()
        for number, before in replaced.items():
            if signal.getsignal(number) is interrupt:
                signal.signal(number, before)


@contextmanager
def _dropped_none() -> Iterator[None]:
    """Has an interrupt sent again that came within a destructor, where Python would drop it."""
    remark = sys.unraisablehook

    def dropped(what: sys.UnraisableHookArgs) -> None:
        if what.exc_type is KeyboardInterrupt:
            threading.Timer(SOON_S, _thread.interrupt_main).start()
        else:
            remark(what)

    sys.unraisablehook = dropped
    try:
        yield
    finally:
        sys.unraisablehook = remark


def _imports(frame: FrameType | None) -> bool:
    """Returns whether a module is being imported where a signal came."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


@contextmanager
def _any_letter_printed() -> Iterator[None]:
    """Has letters that a stream's encoding lacks printed as escapes, instead of an error."""
    streams = [s for s in (sys.stdout, sys.stderr) if isinstance(s, io.TextIOWrapper)]
    before = [stream.errors for stream in streams]
    for stream in streams:
        stream.reconfigure(errors="backslashreplace")
    try:
        yield
    finally:
        for stream, errors in zip(streams, before, strict=True):
            with suppress(OSError, ValueError):  # it flushes first, which may fail
                stream.reconfigure(errors=errors)


def _give_up_broken_streams() -> None:
    """Drops streams that cannot be written to.

    Else the interpreter would try once more at its end, and exit with a code of its own.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            setattr(sys, name, None)


if __name__ == "__main__":
    sys.exit(main())
