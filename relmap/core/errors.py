"""The one exception root of relmap."""

from __future__ import annotations


class RelmapError(Exception):
    """Input that relmap cannot use.

    The message is one line: what is wrong, where (file, line, field or argument), and what would
    be right.  The command line prints it as it stands and exits with 2.
    """
