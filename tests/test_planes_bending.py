"""A refined map that beams show to be bent is solved again with the link there."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.planes import PlaneMapper
from relmap.planes.linking.registration import PlaneRegistration
from relmap.planes.refinement import refining
from relmap.planes.refinement.refining import bent_steps
from relmap.planes.submaps.submap import WallSubmap
from relmap.planes.walls.history import PlaneHistory
from tests.test_planes_undetermined import along

BEHIND = np.array([[-3.0, 2.5], [-3.0, -2.5], [-1.0, -2.5]])
AHEAD = np.array([[3.0, -2.5], [5.0, -2.5], [5.0, 2.5]])
"""Two parts of a room; the walls of only one of them are found in each scan."""
PANEL = np.array([[1.5, 2.0], [0.7, 2.0]])
"""The only wall in common, found by the last scan before the step, and by all after it."""
STEP, STEP_M = 20, 0.05
TILT_RAD = np.deg2rad(2.0)
"""By how much the panel seems to turn at the step."""


def turned(line: Floats, angle: float) -> Floats:
    """Return a line turned about its middle."""
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray((line - line.mean(axis=0)) @ np.array([[c, s], [-s, c]]) + line.mean(axis=0))


@pytest.fixture
def mapper() -> PlaneMapper:
    """Return a map, not refined, of 40 scans on a straight path, whose links are right."""
    mapper, rng = PlaneMapper(), np.random.default_rng(0)
    points = np.concatenate([along(line, 0.05) for line in (BEHIND, AHEAD, PANEL)])
    for k in range(2 * STEP):
        lines = [BEHIND if k < STEP else AHEAD]
        if k >= STEP - 1:
            lines.append(turned(PANEL, TILT_RAD / 2 if k < STEP else -TILT_RAD / 2))
        ends = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
        n, at = len(ends), np.array([STEP_M * k, 0.0])
        seen = SimpleNamespace(
            ends=ends - at + rng.normal(0.0, 0.002, ends.shape),
            end_type=[["corner", "corner"]] * 2 + [["view", "view"]] * (n - 2),
            n_points=np.ones(n),
            noise=np.full(n, 0.003),
        )
        mapper.update(seen, beams=points - at + rng.normal(0.0, 0.01, points.shape))
    mapper.finish()
    assert len(mapper.submaps) == 1
    registration(mapper).links.motions[STEP] = 0.0, -STEP_M, 0.0
    return mapper


def registration(mapper: PlaneMapper) -> PlaneRegistration:
    found = mapper.engine.association.registration
    assert isinstance(found, PlaneRegistration)
    return found


def test_a_wall_that_is_taken_for_another_does_not_bend_a_refined_map(mapper: PlaneMapper) -> None:
    mapper.refine()
    [submap] = mapper.submaps
    assert submap.refined
    yaw = np.arctan2(submap.poses[:, 1, 0], submap.poses[:, 0, 0])
    assert np.abs(yaw - yaw[0]).max() < 0.1 * TILT_RAD


def test_beams_show_where_a_map_is_bent_but_not_a_link(mapper: PlaneMapper) -> None:
    scans, motions = registration(mapper).links.scans, mapper.history.motion
    poses = np.tile(np.eye(4), (2 * STEP, 1, 1))
    poses[:, 0, 3] = STEP_M * np.arange(2 * STEP)
    [submap] = mapper.submaps
    right = replace(submap, poses=poses)
    assert bent_steps(right, motions, scans).tolist() == []
    wrong = motions.copy()
    wrong[STEP, 0] += TILT_RAD
    assert bent_steps(right, wrong, scans).tolist() == []
    bend = np.eye(4)
    bend[:2, :2] = [[np.cos(TILT_RAD), -np.sin(TILT_RAD)], [np.sin(TILT_RAD), np.cos(TILT_RAD)]]
    bent = replace(submap, poses=np.concatenate([poses[:STEP], bend @ poses[STEP:]]))
    assert bent_steps(bent, motions, scans).tolist() == [STEP]
    beyond = bent.poses.copy()
    beyond[STEP - 1] = np.nan
    assert bent_steps(replace(bent, poses=beyond), motions, scans).tolist() == []


@pytest.mark.parametrize(
    ("left", "is_kept"),
    [([], True), ([STEP + 9], True), ([STEP], False), ([STEP + 8, STEP + 9], False)],
    ids=["straight", "one-left", "still-bent", "bent-elsewhere"],
)
def test_a_map_solved_again_is_kept_only_if_it_is_straighter(
    mapper: PlaneMapper, monkeypatch: pytest.MonkeyPatch, left: list[int], is_kept: bool
) -> None:
    found = iter([np.array([STEP, STEP + 5]), np.array(left, dtype=np.int64), np.array([], int)])
    monkeypatch.setattr(refining, "bent_steps", lambda *_: next(found))
    tried: list[list[int]] = []

    def straightened(history: PlaneHistory, *_: object) -> WallSubmap:
        tried.append(history.bent.tolist())
        return replace(submap, poses=submap.poses + len(tried))

    monkeypatch.setattr(refining, "straightened", straightened)
    [submap] = mapper.submaps
    mapper.refine()
    [refined] = mapper.submaps
    assert tried[0] == [STEP, STEP + 5]
    assert (len(tried) > 1) == (is_kept and len(left) > 0)
    assert np.array_equal(refined.poses, submap.poses + len(tried)) == is_kept
