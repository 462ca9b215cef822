"""``relmap figures``: the paper's figures, reproduced with relmap."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from relmap.cli.arguments import Out
from relmap.cli.console import busy, counted
from relmap.core.errors import RelmapError

if TYPE_CHECKING:
    from relmap.figures.base import Watch
    from relmap.figures.making import Made

T = TypeVar("T")

HELP = """Reproduce the paper's figures and check its claims.

NUMBER is 4 to 7 or 9 to 17; all of them by default. The others are sketches without results.
'crossing' is not in the paper: the errors of planes and of points over the noise.

\b
It writes into DIR
  index.html     all of them: the paper's claim, our figure and the verdict side by side
  figureNN.png   each as a picture
  figureNN.csv   the data behind it (for some also figureNN-*.csv, figure05.gif)
  verdicts.csv   figure, value and verdict

Figure 17 needs real data: the folder of Victoria Park, or its parent with the name victoria-park,
given with --data. Figures 14 and 15 measure run times: use an otherwise idle machine. Each figure
is written when it is done, and is kept if a later one fails or Ctrl-C ends the run.

\b
Examples:
  relmap figures -o figures --quick
  relmap figures 14 15 -o times
  relmap figures -o figures --data datasets
"""


def command(
    out: Out,
    numbers: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NUMBER ...]", help="Which figures; all by default."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Small runs: all figures in a few minutes.")
    ] = False,
    data: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Victoria Park's data, for figure 17.")
    ] = None,
) -> None:
    """Draw; the help text explains the arguments."""
    from relmap.figures.making import check_data, chosen_figures, make_figure, write_page
    from relmap.io.files import staged_folder

    figures = chosen_figures(numbers or [])
    check_data(figures, data)
    made: list[Made] = []
    for number, figure in enumerate(figures, 1):
        what = f"figure {figure.name}, {number} of {len(figures)}"
        with staged_folder(out) as staging, busy(what) as show:
            made.append(make_figure(figure, staging, quick, data, _counting(show, what)))
            if any(each.outcome for each in made):
                write_page(staging, made, quick)
        _say(made[-1])
    drawn = sum(each.outcome is not None for each in made)
    if not drawn:
        raise RelmapError("no figure could be made")
    typer.echo(f"wrote index.html and {counted(drawn, 'figure')} to {out}")


def _counting(show: Callable[[str], None], what: str) -> Watch:
    """Return a wrapper that shows the progress of a loop."""

    def watch(items: Sequence[T], /) -> Iterator[T]:
        for number, item in enumerate(items, 1):
            show(f"{what}: step {number} of {len(items)}")
            yield item

    return watch


def _say(made: Made) -> None:
    shown = made.figure.heading.lower()
    if made.outcome is None:
        typer.echo(f"relmap: {shown} is skipped: it {made.note}", err=True)
    else:
        typer.echo(f"{shown}: {made.outcome.verdict}. {made.outcome.ours}")
