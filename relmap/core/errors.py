"""The one exception root of relmap."""

from __future__ import annotations


class RelmapError(Exception):
    """Input that relmap cannot use.

    The message is one line: what is wrong, where (file, line, field or argument), and what would
    be right.  The command line prints it as it stands and exits with 2.
    """


def reason(error: Exception) -> str:
    """Return what an error of a library says as part of a line: printable, and not too long."""
    line = " ".join(str(error).split()) or type(error).__name__
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    return plain if len(plain) <= 200 else f"{plain[:200]}..."
