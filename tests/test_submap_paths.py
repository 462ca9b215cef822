"""The path in each submap of a run of points that broke: its file, its summary, its view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap import PlaneMapper, PointMapper
from relmap.cli import main
from relmap.io.files import read_tum
from tests.commands import load, unrendered
from tests.test_report import numbers, views

STEP_M = 0.1
FIRST, SECOND, THIRD = 30, 16, 6
"""Scans in each of three places."""
GAP = 20
"""Empty scans between two places."""


def scans() -> list[np.ndarray]:
    """Return three places, seen one after the other while the robot moves along x."""
    random, found = np.random.default_rng(0), list[np.ndarray]()
    for n in (FIRST, SECOND, THIRD):
        landmarks = random.uniform(-8, 8, (12, 2))
        found += [landmarks - [STEP_M * k, 0.0] for k in range(n)]
        found += [np.empty((0, 2))] * GAP
    return found[:-GAP]


@pytest.fixture(scope="module")
def mapper() -> PointMapper:
    mapper = PointMapper()
    for points in scans():
        mapper.update(points)
    mapper.finish()
    mapper.refine()
    return mapper


def is_straight(poses: np.ndarray) -> bool:
    """Return whether the poses (k, 4, 4) are those of a robot that moves along its x axis."""
    expected = np.tile(np.eye(4), (len(poses), 1, 1))
    expected[:, 0, 3] = STEP_M * np.arange(len(poses))
    return np.allclose(poses, expected, atol=1e-6)


def test_each_submap_has_a_path(mapper: PointMapper) -> None:
    begins = {0: FIRST, FIRST + GAP: SECOND, FIRST + SECOND + 2 * GAP: THIRD}
    assert len(mapper.submaps) == 3
    for submap, (iterations, poses) in zip(mapper.submaps, mapper.paths, strict=True):
        begin = submap.first_iteration
        np.testing.assert_array_equal(iterations, begin + np.arange(begins[begin]))
        assert is_straight(poses)
    first, poses = mapper.paths[0]
    known = np.isfinite(mapper.trajectory[:, 0, 0])
    np.testing.assert_array_equal(np.flatnonzero(known), first)
    np.testing.assert_array_equal(mapper.trajectory[known], poses)


def test_nothing_has_no_path() -> None:
    assert PointMapper().paths == PlaneMapper().paths == []


@unrendered()
def test_the_command_writes_the_paths_of_submaps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{k},{x!r},{y!r}" for k, each in enumerate(scans()) for x, y in each.tolist()]
    log, out = tmp_path / "observations.csv", tmp_path / "result"
    log.write_text("\n".join(["iteration,x,y", *rows]) + "\n")
    assert main(["map", str(log), "-o", str(out)]) == 0
    placed = f"{FIRST} of {FIRST + SECOND + THIRD + 2 * GAP} scans have a pose"
    apart = f"; 2 submaps could not be connected to the map, in which {placed}"
    assert apart in capsys.readouterr().out
    submaps = load(out / "summary.json")["submaps"]
    assert sorted(each["scans"] for each in submaps) == [THIRD, SECOND, FIRST]
    for each in submaps:
        assert each["metres"] == pytest.approx(STEP_M * (each["scans"] - 1))
    files = {path.name: len(read_tum(path)[0]) for path in out.glob("submap-*.tum")}
    assert files == {
        f"submap-{k}.tum": each["scans"]
        for k, each in enumerate(submaps)
        if k and each["scans"] >= 10
    }
    for view, each in zip(views((out / "report.html").read_text()), submaps, strict=True):
        assert len(numbers(view["iterations"], "<i4")) == each["scans"]
    # Mapped again in part, their files are out of date.
    assert main(["map", str(log), "-o", str(out), "--scans", "0:20"]) == 0
    assert not list(out.glob("submap-*.tum"))
