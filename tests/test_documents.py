"""The documents are true: their blocks run as written, print what they show, and links resolve."""

from __future__ import annotations

import re
import runpy
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import chdir, redirect_stdout
from io import StringIO
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import relmap
from relmap.cli import main
from tests.commands import run_process, unrendered

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LINKED = [*DOCUMENTS, ROOT / "ARCHITECTURE.md", ROOT / "CONTRIBUTING.md"]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^]]*\]\(([^)\s]+)\)")
CLAIM = (
    "Unless odometry is given, no motion or pose estimate enters the map: scans are registered by "
    "matching landmarks, and probability is used in weights, in registration under large noise, "
    "and in the optional refinement."
)
NOT_RUN = {
    "pip install .": "installs into the environment of the tests",
    "relmap demo": "is run, exactly so, by test_cli_shell.test_demo",
}
"""Lines of shell blocks that are not run, and why."""


class Block(NamedTuple):
    """A fenced block, and the text block that follows it at once: what it prints."""

    language: str
    text: str
    shown: str | None


def blocks(document: Path) -> Iterator[Block]:
    text = document.read_text(encoding="utf-8")
    found = list(BLOCK.finditer(text))
    for match, after in zip_longest(found, found[1:]):
        follows = after is not None and after[1] == "text"
        if after is not None and follows:
            follows = not text[match.end() : after.start()].strip()
        yield Block(match[1], match[2], after[2] if after is not None and follows else None)


def in_shell(text: str) -> str:
    """Run a block, up to the first failure; return what it prints.

    A line of relmap is run as its console script does, but in this process: it starts at once.
    """
    printed, other = "", ""
    for line in text.splitlines():
        if line.startswith("relmap ") and line not in NOT_RUN:
            printed += _others(other) + _relmap(line)
            other = ""
        elif line not in NOT_RUN:
            other += f"{line}\n"
    return printed + _others(other)


def _relmap(line: str) -> str:
    with redirect_stdout(StringIO()) as printed:
        assert main(shlex.split(line)[1:]) == 0, line
    return printed.getvalue()


def _others(lines: str) -> str:
    done = run_process(["/bin/sh", "-e", "-c", lines])
    assert done.returncode == 0, f"{lines}{done.stderr}"
    return done.stdout


def in_python(text: str, names: dict[str, Any]) -> str:
    """Run a block with the names that the blocks before left; return what it prints."""
    Path("block.py").write_text(text, encoding="utf-8")
    with redirect_stdout(StringIO()) as printed:
        names |= runpy.run_path("block.py", names)
    return printed.getvalue()


@unrendered()
@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_blocks_run_in_order_and_print_what_is_shown(document: Path, tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    with chdir(tmp_path):
        for language, text, shown in blocks(document):
            printed = ""
            if language == "sh":
                printed = in_shell(text)
                for folder in re.findall(r" -o (\S+)", text):
                    assert (tmp_path / folder).exists()
            elif language == "python":
                printed = in_python(text, names)
                assert printed or "print" not in text
            if shown is not None:
                assert printed == shown, text


def test_every_block_is_of_a_kind_that_is_run() -> None:
    kinds = [[block.language for block in blocks(document)] for document in DOCUMENTS]
    assert {language for found in kinds for language in found} == {"python", "sh", "text"}
    assert kinds[0].count("python") >= 2
    lines = [line for block in blocks(DOCUMENTS[0]) for line in block.text.splitlines()]
    assert {*NOT_RUN} <= {*lines}, "an exception is stale"


def test_readme_fits_on_a_few_screens() -> None:
    assert len(DOCUMENTS[0].read_text(encoding="utf-8").splitlines()) <= 150


def test_the_claim_is_the_same_everywhere() -> None:
    package = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    texts = {"pyproject.toml": package["description"]}
    for name in ("README.md", "ARCHITECTURE.md", "docs/concepts.md", "relmap/__init__.py"):
        texts[name] = " ".join((ROOT / name).read_text(encoding="utf-8").split())
    assert [name for name, text in texts.items() if CLAIM not in text] == []


def test_the_document_of_python_names_all_that_is_public() -> None:
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    names = {name for name in relmap.__all__ if not name.startswith("_")}
    assert {name for name in names if f"`{name}`" not in text} == set()


def anchors(document: Path) -> set[str]:
    """Return the names of the headings of a document, as forges make them."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("document", LINKED, ids=lambda path: path.name)
def test_links_resolve(document: Path) -> None:
    for link in LINK.findall(BLOCK.sub("", document.read_text(encoding="utf-8"))):
        if link.startswith(("https://", "http://")):
            continue
        name, _, anchor = link.partition("#")
        target = document.parent / name if name else document
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_pictures_are_small() -> None:
    pictures = list((ROOT / "docs" / "images").iterdir())
    assert pictures
    assert [path.name for path in pictures if path.stat().st_size > 150_000] == []


def test_tables_measured_by_a_benchmark_are_there() -> None:
    names = [
        name
        for document in DOCUMENTS
        for name in re.findall(r"<!-- begin: (\S+) -->\n\n\|", document.read_text(encoding="utf-8"))
    ]
    assert names.count("real.py") == 2
    assert all((ROOT / "benchmarks" / name).is_file() for name in names)


def options(*verb: str) -> tuple[str, set[str]]:
    """Return the help of a verb, and the options in it."""
    with redirect_stdout(StringIO()) as printed:
        assert main([*verb, "--help"]) == 0
    text = printed.getvalue()
    return text, {*re.findall(r"(?<![\w-])--[a-z][\w-]*", text.partition("\nOptions:")[2])}


def verbs() -> list[tuple[str, ...]]:
    found = re.findall(r"^  (\w[\w-]*)", options()[0].partition("\nCommands:")[2], re.M)
    worlds = options("simulate")[0].partition("\nCommands:")[2]
    of_simulate = re.findall(r"^  (\w[\w-]*)", worlds, re.M)
    return [*((name,) for name in found), *(("simulate", name) for name in of_simulate)]


def test_the_document_of_the_command_line_names_all_verbs_and_options() -> None:
    text = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    assert len(verbs()) > 10
    for verb in verbs():
        assert f"relmap {' '.join(verb)}" in text
        section = text.partition(f"`relmap {' '.join(verb)}`**")[2] if len(verb) > 1 else ""
        section = section or text.partition(f"\n## relmap {verb[0]}\n")[2]
        here = section.partition("\n## ")[0] + text.partition("\n## ")[0]
        missing = {name for name in options(*verb)[1] if not re.search(rf"`{name}\b", here)}
        assert missing == set(), verb


def test_the_document_of_the_command_line_names_no_other_option() -> None:
    text = (ROOT / "docs" / "command-line.md").read_text(encoding="utf-8")
    known = {name for verb in [(), *verbs()] for name in options(*verb)[1]}
    named = {*re.findall(r"(?<![\w-])--[a-z][\w-]*", text)}
    assert named <= known


@pytest.mark.usefixtures("in_process")
def test_the_comparison_with_a_real_log_runs(shared_data: Path, tmp_path: Path) -> None:
    """The command that the help of compare shows for a log with its truth."""
    for end in (".observations.csv.gz", "_ground_truth.txt", "_ground_truth_robot_path.txt"):
        source = shared_data / "mrpt-kf-slam" / f"kf-slam_demo{end}"
        shutil.copyfile(source, tmp_path / f"log{end}")
    (line,) = (line for line in options("compare")[0].splitlines() if "relmap compare log" in line)
    with chdir(tmp_path):
        printed = in_shell(f"{line.strip()} --methods relmap-points,batch")
    assert "wrote comparison.csv" in printed
    assert (tmp_path / "real" / "comparison.png").stat().st_size > 0
