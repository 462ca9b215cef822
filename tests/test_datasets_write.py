"""The observation log as CSV, written: the same numbers come back, or no file is left."""

from __future__ import annotations

import gzip
import os
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from relmap.core.errors import RelmapError
from relmap.datasets import ObservationLog, open_log, write_observation_csv
from tests.logs import PLAIN, put


@st.composite
def logs(draw: st.DrawFn) -> ObservationLog:
    """Return any log that a file can hold: its first and last iteration have a row."""
    n = draw(st.integers(1, 30))
    steps = draw(st.lists(st.integers(0, 50), min_size=n, max_size=n))
    iteration = np.cumsum(steps).astype(np.int64)
    shape = (n, draw(st.sampled_from([2, 3])))
    points = draw(npst.arrays(np.float64, shape, elements=st.floats(-1e9, 1e9)))
    ids = None
    if draw(st.booleans()):
        some = st.lists(st.integers(0, 2**53 - 1), min_size=n, max_size=n, unique=True)
        hidden = draw(npst.arrays(np.bool_, n))
        ids = np.where(hidden, -1, np.array(draw(some), dtype=np.int64))
    return ObservationLog(
        points, iteration, np.arange(n), int(iteration[0]), int(iteration[-1]) + 1, ids
    )


@given(log=logs(), name=st.sampled_from(["log.csv", "log.csv.gz"]))
def test_written_values_are_read_back_exactly(folder: Path, log: ObservationLog, name: str) -> None:
    write_observation_csv(folder / name, log)
    back = open_log(folder / name)
    assert back.points_robot.tobytes() == log.points_robot.tobytes()
    assert back.iteration.tobytes() == log.iteration.tobytes()
    assert (back.ids is None) == (log.ids is None)
    if back.ids is not None and log.ids is not None:
        assert back.ids.tobytes() == log.ids.tobytes()
    assert (back.first_iteration, back.end_iteration) == (log.first_iteration, log.end_iteration)
    assert not list(folder.glob("*.part"))


def test_gzip_is_written_the_same_every_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = open_log(put(tmp_path, PLAIN))
    write_observation_csv(tmp_path / "a.csv.gz", log)
    monkeypatch.setattr(time, "time", lambda: 1e9)
    write_observation_csv(str(tmp_path / "b.csv.gz"), log)
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    assert gzip.decompress((tmp_path / "a.csv.gz").read_bytes()).startswith(b"iteration,x,y,z,id\n")


def test_many_rows_pass_the_batches(tmp_path: Path) -> None:
    n = 200_000
    points = np.random.default_rng(0).normal(0, 10, (n, 3))
    log = ObservationLog(points, np.arange(n) // 20, np.arange(n), 0, n // 20, np.arange(n))
    write_observation_csv(tmp_path / "log.csv", log)
    assert np.array_equal(open_log(tmp_path / "log.csv").points_robot, points)
    with (tmp_path / "log.csv").open("a") as file:
        file.write("1,2,x,4,5\n")
    with pytest.raises(RelmapError, match=rf"log\.csv: line {n + 2}, field y: 'x' is not a number"):
        open_log(tmp_path / "log.csv")


@pytest.mark.parametrize("name", ["none/log.csv", "folder", "file/log.csv.gz", "a\0b", "n" * 300])
def test_write_error_leaves_nothing_behind(tmp_path: Path, name: str) -> None:
    log = open_log(put(tmp_path, PLAIN))
    (tmp_path / "folder").mkdir()
    put(tmp_path, "", "file")
    with pytest.raises(RelmapError, match="cannot write") as caught:
        write_observation_csv(tmp_path / name, log)
    assert str(caught.value).isprintable()
    assert sorted(os.listdir(tmp_path)) == ["file", "folder", "observations.csv"]


def test_failed_write_keeps_the_earlier_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = put(tmp_path, PLAIN)
    log = open_log(path)

    def refuse(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(RelmapError, match="No space left"):
        write_observation_csv(path, log.between(2, 3))
    assert path.read_text() == PLAIN
    assert os.listdir(tmp_path) == ["observations.csv"]


@pytest.mark.parametrize("value", [np.nan, np.inf, 2e9])
def test_numbers_that_could_not_be_read_are_not_written(tmp_path: Path, value: float) -> None:
    log = ObservationLog(np.array([[0, 1.0], [value, 1]]), np.zeros(2, int), np.arange(2), 0, 1)
    with pytest.raises(RelmapError, match="observation 1 is not finite or out of range"):
        write_observation_csv(tmp_path / "log.csv", log)
    empty = ObservationLog(np.empty((0, 2)), np.empty(0, int), np.empty(0, int), 0, 1)
    with pytest.raises(RelmapError, match="no observation"):
        write_observation_csv(tmp_path / "log.csv", empty)
    assert not os.listdir(tmp_path)
