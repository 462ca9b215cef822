"""The interface of a figure: the paper's claim, and the finding of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from relmap.core.arrays import Floats
from relmap.io.files import atomic_write
from relmap.io.tables import csv_text

D = TypeVar("D")
Verdict = Literal["borne out", "partly borne out", "not borne out"]
Watch = Callable[[Sequence[Any]], Iterable[Any]]
"""Wraps the items of a long loop, for example to show progress; `iter` shows nothing."""


@dataclass(frozen=True, eq=False)
class Table:
    """Data for a CSV file: column names, and rows with a cell for each."""

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]

    def write(self, path: Path) -> None:
        """Write the table; raises `RelmapError` if the file cannot be written."""
        atomic_write(path, csv_text(self.columns, self.rows))


@dataclass(frozen=True, eq=False)
class Outcome:
    """The findings of a figure.

    `table`: the data of the picture. `value`: the number that the verdict mainly depends on; see
    `PaperFigure.unit`. `ours`: summary of the finding, in a sentence or two. `verdict`: computed by
    the figure's criterion. `more`: further files: suffix of the name, and a function that writes
    the file.
    """

    table: Table
    value: float
    ours: str
    verdict: Verdict
    more: Mapping[str, Callable[[Path], object]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class PaperFigure(Generic[D]):
    """One figure of the paper.

    `name`: its number, or a word for a figure that is not in the paper. `title`: short title.
    `claim`: the claim of the paper, paraphrased in one sentence. `criterion`: condition for the
    claim to be borne out. `unit`: meaning of the value of an outcome. `run`: does the runs and
    returns their data. Its arguments are whether small runs suffice, the path of real data, for the
    figure that needs them, and the progress wrapper; it raises `RelmapError` if the data are
    invalid. `judge`: returns the outcome of the data. `draw`: returns the picture of the data.
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
        """Prefix of the names of its files."""
        return f"figure{int(self.name):02d}" if self.name.isdigit() else self.name


def judged(*held: bool) -> Verdict:
    """Return the verdict on a claim from its parts."""
    if all(held):
        return "borne out"
    return "partly borne out" if any(held) else "not borne out"


def sentence(text: str) -> str:
    """Return a text as one line with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}.".replace("\n", " ")


def n_log_n(n: NDArray[Any]) -> Floats:
    """Return n log2 n, the bound of figures 12 and 15."""
    return np.asarray(n * np.log2(n), dtype=np.float64)
