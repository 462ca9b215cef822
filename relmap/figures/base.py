"""What every figure offers: the paper's claim, and what a run of this software says to it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, TypeVar

from matplotlib.figure import Figure

from relmap.io.files import atomic_write
from relmap.io.tables import csv_text

T = TypeVar("T")
Verdict = Literal["borne out", "partly borne out", "not borne out"]


class Watch(Protocol):
    """Yields the items of a long loop as they are, and may show how far it is."""

    def __call__(self, items: Sequence[T], /) -> Iterable[T]:
        """Wrap the items."""
        ...


def unwatched(items: Sequence[T], /) -> Iterable[T]:
    """Yield the items and show nothing."""
    return items


@dataclass(frozen=True, eq=False)
class Table:
    """Data as they go into a CSV file: names of columns, and rows with a cell for each."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def write(self, path: Path) -> None:
        """Write it; a `RelmapError` says where the file cannot be written."""
        atomic_write(path, csv_text(self.columns, self.rows))


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came out of the runs behind a figure.

    Attributes
    ----------
    draw : callable
        Returns the picture.
    table : Table
        The data that are drawn.
    value, unit : float, str
        The number that the verdict hangs on most, and what it is.
    ours : str
        What was found, in a sentence or two.
    verdict : str
        Computed by the figure's criterion.
    more : mapping of str to callable
        Further files: the end of the name, and what writes the file of that path.
    """

    draw: Callable[[], Figure]
    table: Table
    value: float
    unit: str
    ours: str
    verdict: Verdict
    more: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PaperFigure:
    """One figure of the paper.

    Attributes
    ----------
    name : str
        Its number, or the word that stands for a picture of ours.
    title : str
        What it shows, in a few words.
    claim : str
        What the paper says with it, in one sentence of our own.
    criterion : str
        When the claim counts as borne out.
    run : callable
        Does the runs: whether small ones are enough; where real data are, for the figure that needs
        them; what wraps the long loop.  It raises a `RelmapError` where the data cannot be used.
    """

    name: str
    title: str
    claim: str
    criterion: str
    run: Callable[[bool, Path | None, Watch], Outcome]

    @property
    def heading(self) -> str:
        """How it is called."""
        return f"Figure {self.name}" if self.name.isdigit() else self.name.capitalize()

    @property
    def stem(self) -> str:
        """How the names of its files begin."""
        return f"figure{int(self.name):02d}" if self.name.isdigit() else self.name


@dataclass(frozen=True, eq=False)
class Made:
    """A figure with what came out, or None where there is nothing, for the reason in `note`.

    `files` are what was written, by name; the picture is one of them.
    """

    figure: PaperFigure
    outcome: Outcome | None
    note: str = ""
    files: tuple[str, ...] = ()
    picture: bytes = b""


def judged(*held: bool) -> Verdict:
    """Return the verdict on a claim of which each part held or did not."""
    if all(held):
        return "borne out"
    return "partly borne out" if any(held) else "not borne out"


def sentence(text: str) -> str:
    """Return a text with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."
