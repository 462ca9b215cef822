"""Matching of walls against brute force and scipy."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from relmap.planes.linking import guess_kernels, matching_kernels
from relmap.planes.linking.placement import STILL, PlaneTracks, place
from relmap.planes.scans.observation import checked_planes
from tests.kernels import callable_here
from tests.worlds import turn


def test_assignment_is_the_best_one() -> None:
    """Against scipy, for more rows than columns and fewer, with worthless pairs."""
    assigned, rng = callable_here(matching_kernels.assigned), np.random.default_rng(0)
    for _ in range(300):
        n, m = rng.integers(1, 9, 2)
        worth = np.where(rng.random((n, m)) < 0.5, rng.random((n, m)), 0.0)
        rows = assigned(worth)
        columns = np.flatnonzero(rows >= 0)
        assert len(np.unique(rows[columns])) == len(columns)
        assert (worth[rows[columns], columns] > 0).all()
        best = worth[linear_sum_assignment(-worth)].sum()
        np.testing.assert_allclose(worth[rows[columns], columns].sum(), best, atol=1e-12)


def test_tracks_are_carried_as_rigid_bodies() -> None:
    tracks, _ = tracks_of_a_room()
    yaw, t = 0.3, np.array([0.5, -0.2])
    R = turn(yaw)
    there = tracks.carried(np.array([yaw, *t]))
    np.testing.assert_allclose(there.ends, tracks.ends @ R.T + t, atol=1e-12)
    np.testing.assert_allclose(there.corner_at, tracks.corner_at @ R.T + t, atol=1e-12)
    np.testing.assert_allclose(there.normal, tracks.normal @ R.T, atol=1e-12)
    middle = there.ends.mean(axis=1)
    np.testing.assert_allclose((there.normal * middle).sum(axis=1), there.offset, atol=1e-12)
    there.missed += 1
    assert not tracks.missed.any()


def test_a_wide_jump_is_found() -> None:
    """As after scans were lost: a metre and a third of a right angle at once."""
    tracks, room = tracks_of_a_room()
    yaw, t = 0.5, np.array([0.8, -0.6])
    seen = checked_planes(Room(room @ turn(yaw).T + t))
    found = place(tracks, seen, STILL)
    motion, match = found
    np.testing.assert_allclose(motion, [yaw, *t], atol=1e-9)
    assert match.tracks.tolist() == match.walls.tolist() == [0, 1, 2]


def test_motions_that_turn_too_far_are_not_implied() -> None:
    tracks, room = tracks_of_a_room()
    seen = checked_planes(Room(room)).arrays
    every, near = (guess_kernels.implied(tracks.arrays, seen, reach) for reach in (np.inf, 0.5))
    assert (np.abs(every[:, 0]) > 0.5).any()
    np.testing.assert_array_equal(near, every[np.abs(every[:, 0]) < 0.5])


class Room:
    """Three walls of a room whose ends are all seen."""

    def __init__(self, ends: np.ndarray) -> None:
        self.ends = ends
        self.end_type = np.full((len(ends), 2), "corner")


def tracks_of_a_room() -> tuple[PlaneTracks, np.ndarray]:
    room = np.array(
        [[[4.0, -3.0], [4.0, 3.0]], [[4.0, 3.0], [-2.0, 3.0]], [[-3.0, -3.0], [4.0, -3.0]]]
    )
    seen = checked_planes(Room(room))
    tracks = PlaneTracks.begun(np.arange(3), seen)
    tracks.corner_at = seen.ends.copy()
    return tracks, room


def test_a_tiny_wall_does_not_rotate_the_scan() -> None:
    """A false long wall matched to a short and noisy track has almost no influence."""
    speck = np.array([[4.0, 1.0], [4.0, 1.1]])
    tracks, room = tracks_of_a_room()
    seen = checked_planes(Room(np.concatenate([room, speck[None]])))
    tracks = PlaneTracks.begun(np.arange(4), seen)
    tracks.corner_at[:3] = seen.ends[:3]
    tracks.sd[3] = 0.01
    # The wall through the speck is turned by 35 degrees and goes on for 3 m either way.
    along = np.array([np.sin(0.6), np.cos(0.6)])
    false = speck[0] + np.array([[-3.0], [3.0]]) * along
    scan = checked_planes(Room(np.concatenate([np.add(room, [0.0, -0.1]), false[None]])))
    found = place(tracks, scan, STILL)
    motion, match = found
    np.testing.assert_allclose(motion, [0.0, 0.0, -0.1], atol=0.01)
    assert set(match.tracks.tolist()) >= {0, 1, 2}
