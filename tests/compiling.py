"""Compiles most of what is compiled on first use, once for all workers of the tests.

    python -m tests.compiling

The workers begin together, and without this each would compile the same.  It takes no longer than
mypy, which runs meanwhile.
"""

from __future__ import annotations

import shlex
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from tempfile import TemporaryDirectory

from relmap.cli import main

COMMANDS = """
simulate figure-eight --iterations 60 -o eight
map eight -o nearest
simulate figure-eight --iterations 450 -o long
map long -o known --association known
simulate world --noise stereo --space --sigma 0.03 --length 130 --iterations 90 -o stereo
map stereo -o stereo-map
simulate building --iterations 12 -o spots
map spots -o spots-map --variant planes
simulate building --beams 181 --sigma 0.01 --iterations 40 -o laser
map laser -o laser-map --variant planes
simulate storey --iterations 6 -o storey
map storey -o storey-map --variant planes3d
"""

if __name__ == "__main__":
    said = StringIO()
    with TemporaryDirectory() as folder, chdir(folder):
        for line in COMMANDS.strip().splitlines():
            with redirect_stdout(said), redirect_stderr(said):
                code = main(shlex.split(line))
            if code:
                raise SystemExit(f"relmap {line}\n{said.getvalue()}")
