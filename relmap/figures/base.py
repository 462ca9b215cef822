"""What every figure offers: the paper's claim, and what a run of this software says to it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar

from relmap.io.files import atomic_write
from relmap.io.tables import csv_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    """Data as they go into a CSV file.

    Attributes
    ----------
    columns : sequence of str
    rows : sequence of sequences
        A cell for each column.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def write(self, path: Path) -> None:
        """Write it.

        Raises
        ------
        RelmapError
            Where the file cannot be written.
        """
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


class PaperFigure(Protocol):
    """One figure of the paper."""

    @property
    def name(self) -> str:
        """Its number, or the word that stands for a picture of ours."""
        ...

    @property
    def title(self) -> str:
        """What it shows, in a few words."""
        ...

    @property
    def claim(self) -> str:
        """What the paper says with it, in one sentence of our own."""
        ...

    @property
    def criterion(self) -> str:
        """When the claim counts as borne out."""
        ...

    def run(self, quick: bool, data: Path | None, watch: Watch = unwatched) -> Outcome:
        """Do the runs.

        Parameters
        ----------
        quick : bool
            Whether small runs are enough.
        data : Path or None
            Real data, for the figure that needs them.
        watch : callable, optional
            Wraps the long loop.

        Raises
        ------
        RelmapError
            Where the data cannot be used.
        """
        ...


def judged(*held: bool) -> Verdict:
    """Return the verdict on a claim of which each part held or did not."""
    if all(held):
        return "borne out"
    return "partly borne out" if any(held) else "not borne out"


def sentence(text: str) -> str:
    """Return a text with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."
