"""The interface of a figure: the paper's claim, and the finding of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.io.files import atomic_write
from relmap.io.tables import csv_text

D = TypeVar("D")
Verdict = Literal["borne out", "partly borne out", "not borne out"]
Watch = Callable[[Sequence[Any]], Iterable[Any]]
"""Yields the items of a long loop as they are, and may show progress; `iter` shows nothing."""


@dataclass(frozen=True, eq=False)
class Table:
    """Data as they go into a CSV file: names of columns, and rows with a cell for each."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def write(self, path: Path) -> None:
        """Write the table; a `RelmapError` says where the file cannot be written."""
        atomic_write(path, csv_text(self.columns, self.rows))


@dataclass(frozen=True, eq=False)
class Outcome:
    """The findings of a figure.

    Attributes
    ----------
    table : Table
        The data that are drawn.
    value : float
        The number on which the verdict depends most; see `PaperFigure.unit`.
    ours : str
        What was found, in a sentence or two.
    verdict : str
        Computed by the figure's criterion.
    more : mapping of str to callable
        Further files: the end of the name, and what writes the file of that path.
    """

    table: Table
    value: float
    ours: str
    verdict: Verdict
    more: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PaperFigure(Generic[D]):
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
    unit : str
        What the value of an outcome is.
    run : callable
        Does the runs and returns their data. It takes whether small ones are enough, where real
        data are, for the figure that needs them, and what wraps the long loop; it raises a
        `RelmapError` where the data cannot be used.
    judge : callable
        Returns the outcome of the data.
    draw : callable
        Returns the picture of the data.
    """

    name: str
    title: str
    claim: str
    criterion: str
    unit: str
    run: Callable[[bool, Path | None, Watch], D]
    judge: Callable[[D], Outcome]
    draw: Callable[[D], Figure]

    @property
    def heading(self) -> str:
        """Its heading."""
        return f"Figure {self.name}" if self.name.isdigit() else self.name.capitalize()

    @property
    def stem(self) -> str:
        """How the names of its files begin."""
        return f"figure{int(self.name):02d}" if self.name.isdigit() else self.name


def judged(*held: bool) -> Verdict:
    """Return the verdict on a claim of which each part held or did not."""
    if all(held):
        return "borne out"
    return "partly borne out" if any(held) else "not borne out"


def sentence(text: str) -> str:
    """Return a text as one line with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}.".replace("\n", " ")


def n_log_n(n: NDArray[Any]) -> NDArray[np.float64]:
    """Return n log2 n, the bound of figures 12 and 15."""
    return np.asarray(n * np.log2(n), dtype=np.float64)
