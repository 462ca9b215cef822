"""Merging the maps of two runs: what becomes of the ids of landmarks, and of their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Floats, positions_of
from relmap.core.geometry.alignment import fit_rigid
from relmap.evaluation.truth import read_truth
from relmap.io.results import read_result
from relmap.merging.tables import joined
from tests.commands import run_relmap, table
from tests.tables import landmark_table

pytestmark = pytest.mark.usefixtures("unrendered")


def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines()


def write_lines(path: Path, rows: list[list[str]]) -> None:
    path.write_text("".join(",".join(row) + "\n" for row in rows))


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs of one figure eight, mapped with ids that are numbers and with texts."""
    folder = tmp_path_factory.mktemp("named")
    run_relmap("simulate", "figure-eight", "-o", folder / "eight", "--iterations", "300")
    run_relmap("map", folder / "eight", "-o", folder / "eight-a", "--scans", "0:180")
    header, *rows = [row.split(",") for row in lines_of(folder / "eight" / "observations.csv")]
    known = ["--association", "known"]
    columns = ["--columns", "iteration=iteration,x=x,y=y,z=z,id=tree"]
    for name, first, end in (("a", 0, 180), ("b", 120, 300)):
        part = [row for row in rows if first <= int(row[0]) < end]
        write_lines(folder / f"{name}.csv", [header, *part])
        run_relmap("map", folder / f"{name}.csv", "-o", folder / f"ids-{name}", *known)
        texts = [[*row[:4], f"tree {row[4]}"] for row in part]
        write_lines(folder / f"{name}-text.csv", [[*header[:4], "tree"], *texts])
        text_log = folder / f"{name}-text.csv"
        run_relmap("map", text_log, "-o", folder / f"text-{name}", *known, *columns)
    return folder


def at_their_ids(merged: Path, truth: Path, ids: dict[int, int] | None) -> Floats:
    """Return the distances of mapped landmarks from the true places of their ids."""
    table, true = read_result(merged).landmarks, read_truth(truth)
    rows = np.isfinite(table.position[:, 0])
    own = [ids[k] if ids else k for k in table.landmark[rows].tolist()]
    places = true.landmarks_map[positions_of(true.landmark_ids, np.array(own))]
    R, t = fit_rigid(table.position[rows], places)
    assert len(set(own)) == len(own) > 50
    return np.asarray(np.linalg.norm(table.position[rows] @ R.T + t - places, axis=1))


def test_ids_and_their_names_survive(named: Path, tmp_path: Path) -> None:
    run_relmap("merge", named / "ids-a", named / "ids-b", "-o", tmp_path / "ids")
    assert at_their_ids(tmp_path / "ids", named / "eight", None).max() < 0.5
    seen = [read_result(named / f"ids-{name}").landmarks.observations.sum() for name in "ab"]
    assert read_result(tmp_path / "ids").landmarks.observations.sum() == sum(seen)
    run_relmap("merge", named / "text-a", named / "text-b", "-o", tmp_path / "text")
    names = table(tmp_path / "text" / "names.csv")
    ids = {int(row["landmark"]): int(row["name"].removeprefix("tree ")) for row in names}
    assert at_their_ids(tmp_path / "text", named / "eight", ids).max() < 0.5
    run_relmap("merge", named / "eight-a", named / "text-b", "-o", tmp_path / "half")
    merged = read_result(tmp_path / "half")
    named_ones = {int(row["landmark"]) for row in table(tmp_path / "half" / "names.csv")}
    alone = merged.landmarks.first_iteration > 200  # of the second map alone
    assert set(merged.landmarks.landmark[alone].tolist()) <= named_ones


def test_a_merged_map_with_names_is_merged_again(named: Path, tmp_path: Path) -> None:
    run_relmap("merge", named / "eight-a", named / "text-b", "-o", tmp_path / "half")
    run_relmap("merge", named / "text-a", tmp_path / "half", "-o", tmp_path / "again")
    names = [row["name"] for row in table(tmp_path / "again" / "names.csv")]
    assert len(set(names)) > 50


def test_ids_that_mean_other_landmarks_are_renumbered(
    named: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, *rows = [row.split(",") for row in lines_of(named / "b.csv")]
    others = [[*row[:4], str((int(row[4]) + 50) % 185)] for row in rows]
    write_lines(tmp_path / "b.csv", [header, *others])
    run_relmap("map", tmp_path / "b.csv", "-o", tmp_path / "b", "--association", "known")
    capsys.readouterr()
    run_relmap("merge", named / "ids-a", tmp_path / "b", "-o", tmp_path / "both")
    assert "ids mean different landmarks in them" in capsys.readouterr().out
    labels = read_result(tmp_path / "both").landmarks.landmark
    assert len(np.unique(labels)) == len(labels)


def test_positions_of_one_landmark_are_weighted_by_their_certainty() -> None:
    ones = np.ones((2, 3))
    a = landmark_table(0 * ones, sd=np.array([0.1, np.nan]), observations=np.array([1, 1]))
    b = landmark_table(ones, sd=np.array([0.3, 0.2]), observations=np.array([5, 3]))
    both = joined(a, b, np.array([[0, 0], [1, 1]]))
    np.testing.assert_allclose(both.position[:, 0], [0.1, 0.75])
    np.testing.assert_allclose(both.sd[0], np.hypot(0.9 * 0.1, 0.1 * 0.3))
    assert both.observations.tolist() == [6, 4]
