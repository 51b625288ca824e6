"""From a command line to an exit code: every failure is a message, never a traceback."""

from __future__ import annotations

import copy
import sys
from typing import Any

import typer

from thzcl.commands.cli import app
from thzcl.commands.options import complain

INTERRUPTED = 130
_USAGE_ERROR: Any = typer.BadParameter.__mro__[2]  # ClickException, wherever this typer keeps it


def entry(arguments: list[str]) -> int:
    """Runs a command line and returns its exit code: 0, 2 bad input, 3 no device.

    4 numbers or plugin, 130 interrupted.
    """
    try:
        code = _only(arguments)(arguments, standalone_mode=False) or 0
        if sys.stdout:  # a shell may have closed it
            sys.stdout.flush()
    except typer.Exit as stop:
        code = stop.exit_code
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except BrokenPipeError:  # the reader has seen enough
        sys.stdout = None  # so that nothing is flushed into it at exit
        code = 0
    except _USAGE_ERROR as error:
        error.show()
        code = 2
    except Exception as error:  # noqa: BLE001 (those that are not explained are raised again)
        code = _explained(error)
    if code == INTERRUPTED:
        complain(["interrupted; nothing was left half-written"], code)
    return int(code)


def _only(arguments: list[str]) -> typer.Typer:
    """The app with the one command that is asked for, if it is one.

    Typer takes every command apart that it is given.
    """
    chosen = copy.copy(app)
    named = [
        c
        for c in app.registered_commands
        if c.callback and [c.name or c.callback.__name__] == arguments[:1]
    ]
    chosen.registered_commands = named or app.registered_commands
    return chosen


def _explained(error: Exception) -> int:
    """The message and exit code of an error that a user can do something about; others are ours.

    And raised.
    """
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return complain(
            [f"{place}{error.strerror or error}; choose another place, or make room"], 2
        )
    codes = {
        "ScenarioError": 2,
        "PluginError": 2,
        "UsageError": 2,
        "RecordError": 2,
        "DeviceError": 3,
        "NumbersError": 4,
        "SensorFailure": 4,
    }
    if type(error).__name__ not in codes:
        raise error
    return complain(getattr(error, "problems", [str(error)]), codes[type(error).__name__])
