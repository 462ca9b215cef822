"""The programs that measure speed, endurance and moving landmarks run, and print their tables."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from itertools import pairwise
from pathlib import Path

import pytest

from benchmarks.document import write_all
from tests.commands import run_process

ONE_THREAD = dict.fromkeys(
    [f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")], "1"
)
"""With these a benchmark need not start itself anew."""


Tables = dict[str, list[dict[str, str]]]
"""The rows of each table that is printed, by the line above it."""


def tables_in(printed: str) -> Tables:
    tables: Tables = {}
    blocks = [block.splitlines() for block in printed.strip().split("\n\n")]
    for title, lines in pairwise(blocks):
        if lines[0].startswith("|"):
            header, _, *rows = ([c.strip() for c in line.strip("|").split("|")] for line in lines)
            tables[title[-1]] = [dict(zip(header, cells, strict=True)) for cells in rows]
    return tables


def tables_of(repo_root: Path, child_env: dict[str, str], *command: str) -> Tables:
    """Run a benchmark that begins processes or measures time, in its own; return its tables."""
    program = str(repo_root / "benchmarks" / command[0])
    done = run_process([sys.executable, program, *command[1:]], env=child_env | ONE_THREAD)
    assert done.returncode == 0, done.stderr
    return tables_in(done.stdout)


@pytest.fixture
def tables_here(repo_root: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Tables]:
    """Return a function that runs a benchmark in this process, where all is loaded already."""

    def run(name: str, *arguments: str) -> Tables:
        program = str(repo_root / "benchmarks" / name)
        monkeypatch.syspath_prepend(repo_root / "benchmarks")
        monkeypatch.setattr("speed.on_one_core", lambda: None)
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        with redirect_stdout(StringIO()) as printed:
            runpy.run_path(program, run_name="__main__")
        return tables_in(printed.getvalue())

    return run


def test_speed_is_compared_with_frame_to_map(repo_root: Path, child_env: dict[str, str]) -> None:
    tables = tables_of(repo_root, child_env, "speed.py", "--quick")
    times = tables["Time of an iteration, median (mean), ms"]
    ratios = tables["Ratios"]
    plain, nearest = (
        float(times[0][name].split()[0]) for name in ("frame-to-map", ratios[0]["method"])
    )
    # The times are printed to a microsecond.
    assert float(ratios[0]["ratio of medians"]) == pytest.approx(nearest / plain, rel=0.1)


def test_endurance_reports_time_and_memory(repo_root: Path, child_env: dict[str, str]) -> None:
    tables = tables_of(repo_root, child_env, "endurance.py", "--iterations", "100")
    memory = tables["Memory, association known"]
    assert [int(row["iterations"]) for row in memory] == list(range(10, 101, 10))
    (times, *others) = tables.values()
    assert [row["association"] for row in times] == ["known", "nearest"]
    assert len(others) == 2
    # Nearly all landmarks that came into view are in the final table.
    assert int(times[0]["landmarks"]) == int(memory[-1]["landmarks seen"])


def test_drift_is_reported_for_both_runs(tables_here: Callable[..., Tables]) -> None:
    (rows,) = tables_here("drift.py", "--iterations", "300").values()
    assert [row["iterations"] for row in rows] == ["30", "300"] * 2
    assert all(float(row["RMSE [m]"]) < 1e-9 for row in rows)
    assert all(int(row["mapped"]) > 20 and row["submaps"] == "1" for row in rows)


def test_dynamics_judges_every_landmark(tables_here: Callable[..., Tables]) -> None:
    (rows,) = tables_here("dynamics.py", "--quick").values()
    assert [row["association"] for row in rows] == ["known", "nearest"] * 2
    for row in rows:
        for figure in ("precision (worst seed)", "recall (worst seed)"):
            assert 0.8 < float(row[figure].split()[0]) <= 1.0
        typical, largest = (row["comparisons / (n log2 n), median"], row["largest"])
        assert 0 < float(typical) <= float(largest)


BENCHMARKS = sorted((Path(__file__).parents[1] / "benchmarks").glob("[!_]*.py"))
HELP = """
import runpy, sys
for script in sys.argv[1:]:
    sys.path[0], sys.argv = script.rpartition("/")[0], [script, "--help"]
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as end:
        print(f"ended with {end.code}")
"""
"""One process for all, for it takes a second to load what they import."""


def test_every_benchmark_has_a_help_text(child_env: dict[str, str]) -> None:
    scripts = [str(script) for script in BENCHMARKS]
    done = run_process([sys.executable, "-c", HELP, *scripts], env=child_env | ONE_THREAD)
    assert done.returncode == 0, done.stderr
    texts = done.stdout.split("ended with 0\n")
    assert texts.pop() == ""
    for script, text in zip(BENCHMARKS, texts, strict=True):
        assert text.startswith(f"usage: {script.name}")


@pytest.mark.parametrize("script", BENCHMARKS, ids=lambda script: script.name)
def test_times_of_maps_are_processor_times_as_the_document_says(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    assert '["timing"]' not in text  # of a summary: wall time
    assert "perf_counter" not in text or "wall" in text or "clock" in text


def test_every_table_of_the_document_is_written_by_a_benchmark(repo_root: Path) -> None:
    text = (repo_root / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    section = re.compile(
        r"<!-- begin: ((\w+\.py)(?: \d+)?) -->\n(.*?)<!-- end: \1 -->\n", re.DOTALL
    )
    sections = section.findall(text)
    assert len({name for name, *_ in sections}) == len(sections)
    for name, script, content in sections:
        assert (repo_root / "benchmarks" / script).is_file()
        assert "\n|" in content, name
        assert f"Measured by `benchmarks/{script}" in content, name
    assert "\n|" not in section.sub("", text)


def test_the_output_of_a_benchmark_replaces_its_sections(tmp_path: Path) -> None:
    document = tmp_path / "benchmarks.md"
    sections = [f"<!-- begin: {name} -->\nold\n<!-- end: {name} -->" for name in ("a.py 2", "b.py")]
    document.write_text("\n\n".join(["# Benchmarks", *sections, ""]), encoding="utf-8")
    printed = "First\n\n| x |\n|---|\n| 1 |\n\nSecond\n\n| y |\n|---|\n| 2 |\n"
    assert write_all((document,), "a.py", printed, "Measured.") == 1
    replaced = "<!-- begin: a.py 2 -->\n\n| y |\n|---|\n| 2 |\n\nMeasured.\n\n<!-- end: a.py 2 -->"
    assert document.read_text(encoding="utf-8") == "\n\n".join(
        ["# Benchmarks", replaced, sections[1], ""]
    )
    assert write_all((document,), "c.py", printed, "Measured.") == 0
