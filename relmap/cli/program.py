"""All verbs as one program."""

from __future__ import annotations

import errno
import io
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated, Any

import typer

from relmap import __version__
from relmap.cli import (
    compare,
    demo,
    evaluate,
    export,
    figures,
    localise,
    map,
    merge,
    resume,
    simulate,
    sweep,
)
from relmap.cli.console import INTERRUPTED
from relmap.cli.interrupt import interruptible
from relmap.core.errors import RelmapError

# typer exports the exception for a bad value, but not its base class for all usage errors.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]

BAD_INPUT = 2
UNHEARD = 1

_HELP = """Make maps from landmark detections or laser scans; odometry is optional.

Start with 'relmap demo', or go step by step:

\b
  relmap simulate figure-eight -o eight
  relmap map eight/observations.csv -o result
  relmap evaluate result --truth eight
"""

app = typer.Typer(
    name="relmap",
    help=_HELP,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(simulate.app, name="simulate")
for verb in (map, resume, localise, evaluate, merge, export, compare, sweep, figures, demo):
    app.command(verb.__name__.rpartition(".")[2], help=verb.HELP)(verb.command)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"relmap {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def run(arguments: Sequence[str]) -> int:
    """Run a command, and return its exit status; see `relmap.cli.main`."""
    _announce()
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        # Names of files may hold characters that the output's encoding does not.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with interruptible():
            command = typer.main.get_command(app)
            code = command.main(list(arguments), "relmap", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()
    except RelmapError as error:
        return _complain(str(error))
    except _UsageError as error:
        usage: Any = error
        message = usage.format_message().rstrip(".").replace("Value error, ", "")
        help_of = f"; see '{usage.ctx.command_path} --help'" if usage.ctx else ""
        return _complain(message + help_of)
    except MemoryError:
        return _complain("not enough memory")
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except OSError as error:
        if error.errno == errno.EPIPE:
            # The reader of the output has closed it; prevent Python from flushing to it at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return UNHEARD
        where = f": {error.filename}" if error.filename else ""
        return _complain(f"{error.strerror or error}{where}")
    if code == INTERRUPTED:
        typer.echo("relmap: interrupted", err=True)
    return int(code or 0)


class _Stderr(logging.Handler):
    """Reports the warnings of the library, and that it is compiling."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        typer.echo(f"relmap: {record.getMessage()}", err=True)


def _announce() -> None:
    # matplotlib warns in several lines if it cannot write into the home folder, but works.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    logging.getLogger("relmap.core.linalg.compiling").setLevel(logging.INFO)
    log = logging.getLogger("relmap")
    if not any(isinstance(handler, _Stderr) for handler in log.handlers):
        log.addHandler(_Stderr())


def _complain(message: str) -> int:
    line = " ".join(message.split())
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    with suppress(OSError):  # the disk may be full that the standard error is written to
        typer.echo(f"relmap: error: {shown}", err=True)
    return BAD_INPUT
