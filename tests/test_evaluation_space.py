"""Figures of planes in space, on tables made by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.evaluation.space import Faces, doubled_area, judge_planes
from relmap.evaluation.truth import read_truth
from relmap.planes3d.files import read_result3d
from relmap.planes3d.table import Plane3dTable
from tests.hostile import FACES, SURFACES, TUM

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def table(*squares: tuple[list[float], float]) -> Plane3dTable:
    """Return level planes: the corner and the size of each."""
    n = len(squares)
    outline = [np.array(corner) + size * SQUARE for corner, size in squares]
    centre = np.array([each.mean(axis=0) for each in outline]).reshape(-1, 3)
    number, flat = np.arange(n), np.zeros(n)
    return Plane3dTable(
        plane=number,
        normal=np.tile([0.0, 0, 1], (n, 1)),
        offset=centre[:, 2],
        centre=centre,
        sd=flat,
        sd_normal=flat,
        sd_centre=flat,
        area_m2=np.array([size**2 for _, size in squares]),
        outline=outline,
        meets=[np.full(len(SQUARE), -1)] * n,
        observations=number,
        first_iteration=number,
        last_iteration=number,
        status=np.full(n, "static"),
        submap=np.zeros(n, dtype=np.int64),
    )


def faces(*corners: Floats, seen_m2: float = 1.0) -> Faces:
    n = len(corners)
    return Faces(np.arange(n), np.array(corners), np.full(n, seen_m2))


POSES = np.tile(np.eye(4), (3, 1, 1))


def test_planes_found_right_and_off() -> None:
    truth = faces(2 * SQUARE, 2 * SQUARE + np.array([0, 0, 5]), 2 * SQUARE + np.array([0, 0, 9]))
    mapped = table(([0, 0, 0.01], 2.0), ([0, 0, 5.03], 2.0), ([0, 0, 7.0], 2.0), ([9, 9, 9], 0.1))
    told = judge_planes(mapped, truth, POSES, POSES)
    assert told["plane_recall"] == pytest.approx(2 / 3)
    assert told["plane_precision"] == pytest.approx(2 / 3)
    assert told["plane_rmse_m"] == pytest.approx(np.sqrt((0.01**2 + 0.03**2) / 2))
    assert told["doubled_area"] == 0


def test_a_plane_lies_where_most_of_it_is() -> None:
    for x, precision in ((0.4, 1), (0.7, 0)):
        told = judge_planes(table(([x, 0, 0], 1.0)), faces(SQUARE), POSES, POSES)
        assert (told["plane_recall"], told["plane_precision"]) == (precision, precision)


def test_a_true_face_without_area_matches_nothing() -> None:
    told = judge_planes(table(([0, 0, 0], 1.0)), faces(0 * SQUARE, SQUARE), POSES, POSES)
    assert (told["plane_recall"], told["plane_precision"]) == (0.5, 1)


def test_what_was_hardly_seen_is_not_due() -> None:
    told = judge_planes(table(([0, 0, 0], 1.0)), faces(SQUARE, seen_m2=0.2), POSES, POSES)
    assert told["plane_recall"] is None
    assert told["plane_precision"] == 1


def test_the_map_is_aligned_by_its_poses() -> None:
    moved = POSES.copy()
    moved[:, :3, 3] = [3.0, -2.0, 1.0]
    told = judge_planes(table(([0, 0, 0], 1.0)), faces(SQUARE + np.array([3, -2, 1])), POSES, moved)
    assert told["plane_recall"] == 1


def test_doubled_area_counts_planes_on_one_another() -> None:
    assert doubled_area(table(([0, 0, 0], 1.0), ([0.5, 0, 0.02], 1.0))) == pytest.approx(0.5)
    assert doubled_area(table(([0, 0, 0], 1.0), ([0.5, 0, 0.2], 1.0))) == 0
    assert doubled_area(table()) is None
    high = table(([0, 0, 5], 1.0), ([0.5, 0, 5.02], 1.0))
    assert doubled_area(high) == pytest.approx(0.5)
    sides = np.array([1.0, -1.0])  # of a thin wall
    of_wall = replace(high, normal=high.normal * sides[:, None], offset=high.offset * sides)
    assert doubled_area(of_wall) == 0


def test_without_faces_only_doubled_area_is_known() -> None:
    assert judge_planes(table(([0, 0, 0], 1.0)), None, POSES, POSES) == {"doubled_area": 0}


def test_a_plane_that_is_long_and_thin_has_few_points() -> None:
    one = table(([0.0, 0, 0], 1.0))
    one.outline[0] = np.array([[0.0, 0, 0], [1e12, 0, 0], [1e12, 1e-9, 0]])
    assert doubled_area(one) == 0.0


def test_true_planes_may_have_any_numbers(tmp_path: Path) -> None:
    (tmp_path / "trajectory.tum").write_text(TUM)
    (tmp_path / "faces.csv").write_text(FACES.replace("\n1,1,", f"\n1,{2**63 - 1},"))
    found = read_truth(tmp_path, "planes3d").faces
    assert found.plane.tolist() == [0, 1]


def test_a_static_plane_without_a_centre_is_refused(tmp_path: Path) -> None:
    (tmp_path / "planes.csv").write_text(SURFACES.replace(",0,1,1,0.01", ",0,,1,0.01"))
    with pytest.raises(RelmapError, match="plane 1 is static, but its field y is empty"):
        read_result3d(tmp_path)


@pytest.mark.parametrize("x", ["0.9", "1e-320", "1e6", "0"])
def test_a_normal_has_length_1(tmp_path: Path, x: str) -> None:
    (tmp_path / "planes.csv").write_text(SURFACES.replace("\n1,1,0,0,", f"\n1,{x},0,0,"))
    with pytest.raises(RelmapError, match="plane 1 is static, but its normal is not of length 1"):
        read_result3d(tmp_path)
