"""Planes in space that only the points of all scans together show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap.evaluation.space import Faces, judge_planes
from relmap.planes3d.gathering import gathered
from relmap.planes3d.sights import is_dynamic
from relmap.planes3d.submap import Submap
from relmap.segmentation.space import PatchSegmenter
from relmap.simulation.storey import simulate_storey
from tests.test_planes3d import mapped


def test_planes_that_no_scan_shows_by_itself_are_found() -> None:
    world = simulate_storey("lidar", 0.01, 20)
    mapper = mapped(world.scans)
    faces = Faces(world.plane_of, world.corners, world.seen_m2)

    def found() -> dict[str, float | None]:
        return judge_planes(mapper.planes, faces, mapper.trajectory, world.trajectory)

    before = found()["plane_recall"]
    mapper.refine()
    after = found()
    assert before < 0.9
    assert after["plane_recall"] == 1.0
    assert after["plane_precision"] == 1.0
    again = len(mapper.planes)
    mapper.refine()
    assert len(mapper.planes) <= again


def test_points_of_a_noisy_plane_are_found_once() -> None:
    # Nearly all points of a second region of the noisy floor lie beside the first one.
    rng, noise_m, part = np.random.default_rng(3), 0.02, Submap()
    for k in range(4):
        across = 4.0 + noise_m * rng.standard_normal(4000)
        wall = np.column_stack([across, rng.uniform(-3, 3, 4000), rng.uniform(-1, 2, 4000)])
        seen = PatchSegmenter(voxel_m=0.2).fit(wall).patches_
        up = 1.8 * noise_m * rng.standard_normal(375)
        floor = np.column_stack([rng.uniform(1, 3, 375), rng.uniform(-2, 0, 375), up])
        up = 0.3 * noise_m * rng.standard_normal(60) - 0.8
        step = np.column_stack([rng.uniform(1, 2, 60), rng.uniform(1, 2, 60), up])
        seen = replace(seen, loose=np.concatenate([floor, step]))
        still = np.eye(3), np.zeros(3)
        part.extend([k], [seen], [still], [np.arange(len(seen))])
    found = gathered(part, 10)
    points = np.zeros(len(found), dtype=np.int64)
    for seen, match in zip(found.seen, found.match, strict=True):
        np.add.at(points, match, seen.n_points)
    assert len(found) == 3
    assert points.min() >= 24


def test_points_of_a_plane_that_one_scan_shows_are_found_in_the_others() -> None:
    # One scan shows the side of a cupboard, 4.5 m away; voxels of its points are not flat.
    world = simulate_storey("depth", 0.01, 60, seed=20)
    mapper = mapped(world.scans)
    mapper.refine()
    faces = Faces(world.plane_of, world.corners, world.seen_m2)
    found = judge_planes(mapper.planes, faces, mapper.trajectory, world.trajectory)
    assert found["plane_recall"] == 1.0
    assert found["plane_precision"] == 1.0


@pytest.mark.parametrize(("through", "planes"), [(12, 2), (30, 1)])
def test_points_beside_a_plane_are_found_unless_many_looks_go_through_it(
    through: int, planes: int
) -> None:
    # Few scans show the wall by themselves, which twelve of 92 looks make dynamic until it is
    # found in more of them: as a tread of stairs, whose neighbours are found in all scans.
    rng, part = np.random.default_rng(4), Submap()
    for k in range(4):
        across = 4.0 + 0.01 * rng.standard_normal(4000)
        wall = np.column_stack([across, rng.uniform(-3, 3, 4000), rng.uniform(-1, 2, 4000)])
        seen = PatchSegmenter(voxel_m=0.2).fit(wall).patches_
        up = 0.5 + 0.01 * rng.standard_normal(200)
        ledge = np.column_stack([rng.uniform(3.7, 3.9, 200), rng.uniform(-1, 1, 200), up])
        seen = replace(seen, loose=ledge)
        part.extend([k], [seen], [(np.eye(3), np.zeros(3))], [np.arange(len(seen))])
    part.sights[0] = np.array([80, through])
    assert is_dynamic(part).tolist() == [True]
    assert len(gathered(part, 10) or part) == planes
