"""The app: from a command line to the one command that it names, and to an exit code."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from inspect import getdoc
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from thzcl.errors import BAD_INPUT, DONE

# In the order of the help, each with an example for its own. Each is a function in a module of its
# name beside this one, which is imported only when the command is asked for.
COMMANDS = {
    "run": "thzcl run figure6 --set camera.pixels=[128,128] -o out",
    "check": "thzcl check figure6 --set atmosphere.temperature_k=290",
    "plan": 'thzcl plan figure6 --variant "(c) 273 K"',
    "absorption": "thzcl absorption --frequency-ghz 340,650 --relative-humidity-percent 50",
    "fluctuations": "thzcl fluctuations record.csv --height-m 3 --scene air.toml -o out",
    "study": "thzcl study quick -o weather --over atmosphere.temperature_k=280:300:5",
    "range": "thzcl range lookout --target person --ranges 40:160:20 --air 40",
    "report": "thzcl report figure6.nc",
    "convergence": "thzcl convergence quick --knobs ray_stride -o out",
    "stress": "thzcl stress --device 0",
    "bench": "thzcl bench figure6 --repeat 3",
    "sensors": "thzcl sensors radiometer",
    "constituents": "thzcl constituents p676-13",
    "materials": "thzcl materials steel",
    "new-sensor": "thzcl new-sensor my-sensor",
    "new-constituent": "thzcl new-constituent my-dust",
    "scenarios": "thzcl scenarios figure6 > mine.toml",
    "new": "thzcl new mine.toml --from figure6",
    "schema": "thzcl schema > thzcl.schema.json",
    "devices": "thzcl devices --format json",
    "doctor": "thzcl doctor",
}
COMPLETION = "_THZCL_COMPLETE"  # of the environment, in which a shell's completion asks
LOCAL = "local"  # the address of a cluster that is started here; typer has no optional values
# What typer raises for a command line that makes no sense.
USAGE_ERROR: Any = typer.BadParameter.__base__


class Command(TyperCommand):
    """A command with an option that may stand without its value."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Reads a command line, on which `--dask` may stand without an address."""
        following = [*args[1:], ""][: len(args)]
        pairs = zip(args, following, strict=True)
        filled = [f"{a}={LOCAL}" if a == "--dask" and "://" not in b else a for a, b in pairs]
        return super().parse_args(ctx, filled)


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


def _imported(command: str) -> Any:
    """Imports a command's module, and returns the command as typer makes it of its function."""
    name = command.replace("-", "_")
    function = getattr(import_module(f"thzcl.commands.{name}"), name)
    alone = typer.Typer(add_completion=False, rich_markup_mode=None)
    alone.command(
        command,
        cls=Command,
        short_help=_first_paragraph(function),  # which typer would cut otherwise
        epilog=f"\b\nExample:\n  {COMMANDS[command]}",  # \b: lines as they are
    )(function)
    return typer.main.get_command(alone)


def _first_paragraph(function: Callable[..., Any]) -> str:
    """Returns the beginning of a function's docstring, as one line."""
    return " ".join((getdoc(function) or "").partition("\n\n")[0].split())


app = typer.Typer(
    cls=Group,
    help="What will this terahertz imager see, through this air?",
    no_args_is_help=True,
    rich_markup_mode=None,  # which would cut long options, and take "[sensor]" for markup
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
