"""Links that another explanation rivals: doors along a corridor repeat."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.evaluation import metrics
from relmap.planes import registration
from relmap.planes.links import credible_m
from relmap.planes.observation import checked_planes
from relmap.planes.placement import STILL, PlanarMotion, place
from relmap.planes.rivals import rivalled
from relmap.planes.tracks import PlaneTracks
from relmap.simulation.visibility import seen_walls

DOORS_M = 1.4
ROW = np.array([[[3.0, 0.2 + DOORS_M * k], [3.0, 1.2 + DOORS_M * k]] for k in range(-20, 40)])
"""Panels that stand alike along a wall."""
MARKED = np.concatenate([ROW, [[[2.0, -1.0], [2.2, -0.4]], [[2.5, 2.1], [2.1, 2.6]]]])
"""The same with something before them that does not repeat."""


def seen(y: float, walls: np.ndarray = ROW) -> Any:
    """Return what a robot at x = 0 sees."""
    return seen_walls(walls - [0.0, y], 8.0, 0.9)


def tracks_of(walls: np.ndarray) -> PlaneTracks:
    """Return the tracks of all that is seen from the origin."""
    first = checked_planes(seen(0.0, walls))
    tracks = PlaneTracks.begun(np.arange(len(first)), first)
    tracks.corner_at = np.where(first.static[..., None], first.ends, np.nan)
    return tracks


@pytest.mark.parametrize(("walls", "expected"), [(ROW, True), (MARKED, False)])
def test_panels_that_stand_alike_rival_one_another(walls: np.ndarray, expected: bool) -> None:
    tracks, later = tracks_of(walls), checked_planes(seen(0.7, walls))
    found = place(tracks, later, STILL)
    assert found is not None
    assert rivalled(tracks, later, STILL, found, np.inf) == expected


def test_a_rival_that_no_robot_makes_is_none() -> None:
    tracks, later = tracks_of(ROW), checked_planes(seen(0.1))
    usual = PlanarMotion(0.0, np.array([0.0, -0.1]))
    found = place(tracks, later, usual)
    assert found is not None
    assert rivalled(tracks, later, usual, found, np.inf)
    for few in (0.0, 0.1):
        assert not rivalled(tracks, later, usual, found, few)


def test_what_is_credible_is_told_by_usual_surprises() -> None:
    assert credible_m(np.full(5, 0.1)) == np.inf
    few = np.concatenate([np.full(30, 0.1), [9.0]])
    assert credible_m(few) == pytest.approx(0.3)


@pytest.mark.parametrize("checked", [True, False])
def test_long_steps_along_doors_break_rather_than_go_wrong(
    checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A step that is as long as doors are apart looks like none."""
    if not checked:
        monkeypatch.setattr(registration, "rivalled", lambda *_: False)
    y = np.cumsum(np.tile([1.5, 1.3, 1.2, 1.6], 6))
    poses = np.tile(np.eye(4), (len(y), 1, 1))
    poses[:, 1, 3] = y
    mapper = PlaneMapper()
    for at in y.tolist():
        mapper.update(seen(at))
    mapper.finish()
    wrong = [
        len(metrics.wrong_steps(submap.poses, poses[slice(*submap.span)]))
        for submap in mapper.submaps
    ]
    assert (sum(wrong) == 0) == checked


def test_wrong_steps_are_those_off_by_far() -> None:
    truth = np.tile(np.eye(4), (6, 1, 1))
    truth[:, 0, 3] = np.arange(6)
    poses = truth.copy()
    poses[3:, 0, 3] += 0.31
    poses[5] = poses[5] @ [[0.9, -0.436, 0, 0], [0.436, 0.9, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    assert metrics.wrong_steps(poses, truth).tolist() == [3, 5]
    assert metrics.wrong_steps(truth, truth).tolist() == []
    assert metrics.wrong_steps(truth[:1], truth[:1]).tolist() == []
