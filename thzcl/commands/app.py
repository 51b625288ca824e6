"""The app: from a command line to the one command that it names, and to an exit code."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from thzcl.errors import BAD_INPUT, DONE

# In the order of the help. Each is a function in a module of its own name beside this one, which
# is imported only when the command is asked for.
COMMANDS = (
    "run",
    "check",
    "plan",
    "absorption",
    "fluctuations",
    "study",
    "range",
    "report",
    "convergence",
    "stress",
    "bench",
    "sensors",
    "constituents",
    "materials",
    "new-sensor",
    "new-constituent",
    "scenarios",
    "new",
    "schema",
    "devices",
    "doctor",
)
COMPLETION = "_THZCL_COMPLETE"  # of the environment, in which a shell's completion asks
LOCAL = "local"  # the address of a cluster that is started here; typer has no optional values
# What typer raises for a command line that makes no sense.
USAGE_ERROR: Any = typer.BadParameter.__base__


class Command(TyperCommand):
    """A command whose help is printed as it is written."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Reads a command line, on which `--dask` may stand without an address."""
        following = [*args[1:], ""][: len(args)]
        pairs = zip(args, following, strict=True)
        filled = [f"{a}={LOCAL}" if a == "--dask" and "://" not in b else a for a, b in pairs]
        return super().parse_args(ctx, filled)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the help; "[sensor]" in it is no markup."""
        _escape(self)
        super().format_help(ctx, formatter)


class Group(TyperGroup):
    """All commands; a command's module is imported when the command is asked for."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands: Any = dict.fromkeys(COMMANDS)  # the names, also for "did you mean"

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 (typer's signature)
        """Returns the names of all commands."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002 (typer's signature)
        """Returns the command of that name, or None if there is none."""
        if cmd_name in COMMANDS and self.commands[cmd_name] is None:
            self.commands[cmd_name] = _imported(cmd_name)
        return self.commands.get(cmd_name)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the help of the whole app, for which every command is imported."""
        for name in COMMANDS:
            _escape(self.get_command(ctx, name))
        super().format_help(ctx, formatter)


def _imported(command: str) -> Any:
    """Imports a command's module, and returns the command as typer makes it of its function."""
    name = command.replace("-", "_")
    alone = typer.Typer(add_completion=False)
    alone.command(command, cls=Command)(getattr(import_module(f"thzcl.commands.{name}"), name))
    return typer.main.get_command(alone)


def _escape(command: Any) -> None:
    """Has rich print the texts of a command's help as they are."""
    from rich.markup import escape

    for item in (command, *command.params):
        if getattr(item, "help", None):
            item.help = escape(item.help)


app = typer.Typer(
    cls=Group,
    help="What will this terahertz imager see, through this air?",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(asked: bool) -> None:
    if asked:
        from thzcl.results.versions import VERSION

        print(f"thzcl {VERSION}")
        raise typer.Exit


@app.callback()
def _all_commands(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="show the version and exit"
        ),
    ] = False,
) -> None:
    # Typer makes a group of what has a callback.
    pass


def _parsed(command: Any, arguments: Sequence[str]) -> Any:
    """Returns the context of a command line.

    Raises what typer does, typer.Exit also where an option such as --show-completion has done all.
    """
    try:
        return command.make_context("thzcl", list(arguments))
    except SystemExit as stop:
        if isinstance(stop.__context__, BrokenPipeError):  # nobody reads the help any more
            raise
        raise typer.Exit(stop.code if isinstance(stop.code, int) else DONE) from None


def call(arguments: Sequence[str]) -> int:
    """Runs a command line, and returns its exit code.

    What the command raises is raised, but for a command line that makes no sense.
    """
    command = typer.main.get_command(app)
    if COMPLETION in os.environ:  # a shell asks what could follow
        with suppress(SystemExit):  # as which typer ends once it has answered
            command.main(list(arguments), "thzcl", COMPLETION, standalone_mode=False)
        return DONE
    try:
        with _parsed(command, arguments) as context:
            code = command.invoke(context)
    except typer.Exit as stop:
        return int(stop.exit_code)
    except USAGE_ERROR as error:
        with suppress(OSError, ValueError):  # nobody can be told
            error.show()
        return BAD_INPUT
    return DONE if code is None else int(code)
