"""`thzcl` and `python -m thzcl`."""

from __future__ import annotations

import sys


def main() -> None:
    """Runs the command line; every failure is a message and an exit code, never a traceback."""
    try:
        from thzcl.cli import entry

        sys.exit(entry(sys.argv[1:]))
    except KeyboardInterrupt:  # before or after the command itself
        sys.exit(130)


if __name__ == "__main__":
    main()
