"""Write the output of a benchmark into the documents, so that no figure is copied by hand.

    python benchmarks/document.py laser.py DATA

runs ``benchmarks/laser.py DATA`` and replaces its sections in README.md and docs/benchmarks.md.  A
section ``<!-- begin: laser.py -->`` to ``<!-- end: laser.py -->`` gets the whole output,
``<!-- begin: laser.py 2 -->`` the second table of it.  Each ends with the command and the commit.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from itertools import count
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "benchmarks.md")


def main() -> None:
    """Run a benchmark and write its output into its sections."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("benchmark", help="a file of this folder")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="of the benchmark")
    given = parser.parse_args()
    command = [sys.executable, str(ROOT / "benchmarks" / given.benchmark), *given.arguments]
    printed = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    # Folders of data have different names on different machines.
    options = ["DATA" if Path(word).is_dir() else word for word in given.arguments]
    source = measured_by(" ".join([given.benchmark, *options]))
    if not write_all(DOCUMENTS, given.benchmark, printed, source):
        parser.error(f"no document has a section for {given.benchmark}")


def measured_by(command: str) -> str:
    """Return the line below a table: the command and the commit that measured it."""
    git = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude=*"]
    commit = subprocess.run(git, stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    return f"Measured by `benchmarks/{command}` at {commit}."


def tables_in(printed: str) -> list[str]:
    """Return the markdown tables in an output, in order."""
    return [found[0].strip() for found in re.finditer(r"(?:^\|.*\n?)+", printed, re.MULTILINE)]


def write_all(documents: tuple[Path, ...], name: str, printed: str, source: str) -> int:
    """Replace the sections of a benchmark in all documents; return how many there are."""
    sections = {name: printed.strip()}
    sections |= {f"{name} {k}": table for k, table in zip(count(1), tables_in(printed))}
    return sum(
        write_section(path, section, f"{text}\n\n{source}")
        for path in documents
        for section, text in sections.items()
    )


def write_section(path: Path, name: str, text: str) -> int:
    """Replace the sections of this name; return how many there are."""
    begin, end = (re.escape(f"<!-- {which}: {name} -->\n") for which in ("begin", "end"))
    before = path.read_text(encoding="utf-8")
    section = re.compile(f"({begin}).*?({end})", re.DOTALL)
    after, replaced = section.subn(lambda found: f"{found[1]}\n{text}\n\n{found[2]}", before)
    path.write_text(after, encoding="utf-8")
    return replaced


if __name__ == "__main__":
    main()
