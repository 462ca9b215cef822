"""The verdicts on the paper's figures, as a table of docs/benchmarks.md.

relmap figures -o DIR --data DATA
python benchmarks/figures.py DIR
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

from shared.tables import header, row

from relmap.figures.making import FIGURES


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="as `relmap figures` wrote it")
    folder = parser.parse_args().folder
    figures = {figure.name: figure for figure in FIGURES}
    header("figure", "claim", "finding", "the claim is")
    with (folder / "verdicts.csv").open(encoding="utf-8", newline="") as file:
        for found in csv.DictReader(file):
            name = found["figure"]
            row(name, figures[name].claim, found["finding"], found["verdict"])


if __name__ == "__main__":
    main()
