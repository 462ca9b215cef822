"""The single exception root of relmap."""

from __future__ import annotations

import difflib
from collections.abc import Collection


class RelmapError(Exception):
    """Input that relmap cannot use.

    The message is one line: what is wrong, where (file, line, field or argument), and what is
    expected.  The command line prints it unchanged and exits with status 2.
    """


def reason(error: Exception) -> str:
    """Return the message of a library's error for use in a line: printable and not too long."""
    line = " ".join(str(error).split()) or type(error).__name__
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    return plain if len(plain) <= 200 else f"{plain[:200]}..."


def brief(value: object) -> str:
    """Return a value for use in a line: never too long."""
    try:
        text = repr(value).replace("\n", " ")
    except (ValueError, RecursionError):
        return "a number with thousands of digits, or deeply nested"
    return text if len(text) <= 200 else f"{text[:200]}..."


def known_name(name: str, known: Collection[str], what: str) -> str:
    """Return a name if it is known.

    Raises `RelmapError` if it is unknown; suggests the closest name, or lists all.
    """
    if name in known:
        return name
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
    raise RelmapError(f"unknown {what} {brief(name)}; {hint}")
