from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from relmap.cli import console, main
from relmap.cli.console import busy, lasting, tracked
from relmap.datasets import write_observation_csv
from relmap.simulation import simulate_figure_eight
from tests.commands import PATIENCE_S

pytestmark = pytest.mark.usefixtures("unrendered")

CURSOR_BACK = "\x1b[?25h"
"""Written to a terminal when a message has ended: show the cursor again."""


@pytest.fixture(autouse=True)
def interval_of_users(every_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Print lines of progress as often as for users, unlike in the other tests."""
    monkeypatch.setattr(console, "EVERY_S", every_s)


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[[], str]:
    """Pretend that stderr is a terminal and show progress early; return what reads stderr."""
    monkeypatch.setattr(console, "PATIENCE_S", 0.05)
    monkeypatch.setattr(Console, "is_terminal", property(lambda _: True))
    return lambda: capsys.readouterr().err


def wait_for(said: Callable[[], str]) -> None:
    """Work until progress is reported, however busy the machine is."""
    end = time.monotonic() + PATIENCE_S
    while "counting sheep" not in said():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_long_work_shows_progress(said: Callable[[], str]) -> None:
    with busy("counting sheep"):
        wait_for(said)


def test_short_work_shows_no_progress(
    said: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "PATIENCE_S", PATIENCE_S)
    with busy("counting sheep"):
        pass
    assert "counting sheep" not in said()


def test_long_loops_show_how_far_they_are(said: Callable[[], str]) -> None:
    for _ in tracked(range(10), 10, "counting sheep"):
        time.sleep(0.03)
    assert "counting sheep" in said()


def test_off_a_terminal_loops_print_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By a clock on which each item takes four seconds."""
    clock = [100.0]
    monkeypatch.setattr(console, "monotonic", lambda: clock[0])
    for _ in tracked(range(10), 10, "counting sheep"):
        clock[0] += 4.0
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "relmap: counting sheep: 3 of 10, about 28 s left",
        "relmap: counting sheep: 6 of 10, about 16 s left",
        "relmap: counting sheep: 9 of 10, about 4.0 s left",
    ]


@pytest.mark.parametrize(
    ("n", "compiling", "compile_s", "each_s", "told"),
    [
        (100, {0}, 30.0, 5.0, ["1 of 100", "3 of 100, about 8 min left"]),
        (
            900,
            {0, 1, 5, 9},
            20.0,
            0.1,
            [f"{k} of 900" for k in (1, 2, 6)] + ["10 of 900, about 89 s left"],
        ),
    ],
)
def test_the_time_to_compile_is_not_expected_of_every_step(
    n: int,
    compiling: set[int],
    compile_s: float,
    each_s: float,
    told: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By a clock on which some of the first steps take longer, because they compile."""
    clock = [100.0]
    monkeypatch.setattr(console, "monotonic", lambda: clock[0])
    for k in tracked(range(n), n, "counting sheep"):
        clock[0] += compile_s if k in compiling else each_s
        if k == max(compiling) + 3:
            break
    assert capsys.readouterr().err.splitlines() == [
        f"relmap: counting sheep: {line}" for line in told
    ]


def test_off_a_terminal_progress_is_printed_as_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "EVERY_S", 0.01)
    with busy("counting") as tell:
        tell("counting sheep")
        wait_for(lambda: capsys.readouterr().err)


@pytest.mark.parametrize(
    ("seconds", "told"), [(0.24, "0.2 s"), (44.4, "44 s"), (119.0, "119 s"), (600.0, "10 min")]
)
def test_times_are_printed_in_readable_form(seconds: float, told: str) -> None:
    assert lasting(seconds) == told


def test_work_that_fails_ends_its_message(said: Callable[[], str]) -> None:
    def fail() -> None:
        with busy("counting sheep"):
            wait_for(said)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert CURSOR_BACK in said()


def test_a_clock_that_goes_backwards_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log.csv"
    write_observation_csv(log, simulate_figure_eight(seed=3, iterations=20).log)
    journals = ["--journal", str(tmp_path / "usual.journal")]
    assert main(["map", str(log), "-o", str(tmp_path / "usual"), *journals]) == 0
    clock = itertools.count(1_700_000_000, -3600)
    monkeypatch.setattr(time, "time", lambda: float(next(clock)))
    monkeypatch.setattr(console, "EVERY_S", 0.0)
    monkeypatch.setattr(console, "PATIENCE_S", 0.0)
    journals = ["--journal", str(tmp_path / "run.journal")]
    capsys.readouterr()
    assert main(["map", str(log), "-o", str(tmp_path / "out"), *journals]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if "-" in line] == []  # no time that is negative
    assert main(["resume", str(tmp_path / "run.journal"), "-o", str(tmp_path / "again")]) == 0
    files = {path.name for path in (tmp_path / "usual").iterdir()} - {"summary.json", "report.html"}
    for name in files:
        usual = (tmp_path / "usual" / name).read_bytes()
        assert (tmp_path / "out" / name).read_bytes() == usual
        assert (tmp_path / "again" / name).read_bytes() == usual
