"""`thzcl` and `python -m thzcl`."""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress

OBJECTS = 100_000  # new ones between searches for garbage: imports make many, and no garbage


def main() -> None:
    """Runs the command line; every failure is a message and an exit code, never a traceback."""
    _set_up()
    try:
        from thzcl.commands.entry import entry

        code = entry(sys.argv[1:])
    except KeyboardInterrupt:  # before or after the command itself
        code = 130
    with suppress(OSError):  # whoever read it has gone
        for stream in filter(None, (sys.stdout, sys.stderr)):
            stream.flush()
    os._exit(
        code
    )  # all files are closed; taking interpreter, libraries and device apart would cost a tenth of a short run


def _set_up() -> None:
    """What would slow a command down that has the process to itself.

    A setting of the user's own stays.
    """
    gc.set_threshold(OBJECTS)
    # NumPy's matrices here are small, but its threads would go on spinning on the cores that the
    # kernels need.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Pydantic would ask every package in the environment whether it has a plugin for it.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")


if __name__ == "__main__":
    main()
