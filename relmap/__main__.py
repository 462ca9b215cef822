"""``python -m relmap``: same as the command ``relmap``."""

from __future__ import annotations

from relmap.cli import main

if __name__ == "__main__":
    status = main()
    # If Ctrl-C came while a string was executed, as the compiler does, CPython notes it as
    # unhandled and would end itself by the signal; executing another string clears the note.
    exec("")
    raise SystemExit(status)
