"""The command line: one file per verb, errors as one line."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    `argv`: the arguments after the program name; by default those of this process. Returns the exit
    status: 0, 2 for bad input, 130 after Ctrl-C, 1 if the reader of the output has closed it.
    """
    try:
        # Loading the modules takes long, and Ctrl-C may be pressed meanwhile.
        from relmap.cli.program import run

        return run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        print("relmap: interrupted", file=sys.stderr)
        return 128 + signal.SIGINT
