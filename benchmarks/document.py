"""Put what a benchmark prints into the documents: no figure there is copied by hand.

    python benchmarks/document.py laser.py DATA

runs ``benchmarks/laser.py DATA`` and replaces what stands in README.md and docs/benchmarks.md
between ``<!-- begin: laser.py -->`` and ``<!-- end: laser.py -->``.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
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
    if not sum(write_section(path, given.benchmark, printed) for path in DOCUMENTS):
        parser.error(f"no document has a section for {given.benchmark}")


def write_section(path: Path, name: str, text: str) -> bool:
    """Replace the sections of this name; return whether there are any."""
    begin, end = (re.escape(f"<!-- {which}: {name} -->\n") for which in ("begin", "end"))
    before = path.read_text(encoding="utf-8")
    section = re.compile(f"({begin}).*?({end})", re.DOTALL)
    after, count = section.subn(lambda found: f"{found[1]}\n{text.strip()}\n\n{found[2]}", before)
    path.write_text(after, encoding="utf-8")
    return count > 0


if __name__ == "__main__":
    main()
