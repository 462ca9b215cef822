"""The floor plan: which of the refined walls are drawn, joined, and their extent."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.core.errors import RelmapError
from relmap.planes.plan.plan_kernels import beams_on_walls
from relmap.planes.scans.beam_store import BeamStore
from relmap.planes.scans.beams import GivenBeams

ROOM = np.array(
    [
        [[4.0, -3.0], [4.0, 3.0]],
        [[4.0, 3.0], [-2.0, 3.0]],
        [[-2.0, 3.0], [-2.0, -3.0]],
        [[-2.0, -3.0], [4.0, -3.0]],
    ]
)
SCANS = 40
EARLY, LATE, ALWAYS = range(16), range(24, SCANS), range(SCANS)
OPEN, WHOLE = ["view", "view"], ["corner", "corner"]
Sight = tuple[list[list[float]], list[str], range]
"""Ends of a wall, their types, and in which scans it is seen."""


def returns(origin: Floats, walls: Floats) -> Floats:
    """Return where 720 beams from an origin end on walls (w, 2, 2)."""
    angle = np.deg2rad(np.arange(0.25, 360.0, 0.5))
    beam = np.column_stack([np.cos(angle), np.sin(angle)])
    along = walls[:, 1] - walls[:, 0]
    offset = walls[:, 0] - origin
    det = beam[:, :1] * along[:, 1] - beam[:, 1:] * along[:, 0]
    det[det == 0] = np.inf
    reach = (offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]) / det
    share = (offset[:, 0] * beam[:, 1:] - offset[:, 1] * beam[:, :1]) / det
    reach[(share < 0) | (share > 1) | (reach <= 0)] = np.inf
    least = reach.min(axis=1)
    hit = np.isfinite(least)
    return np.asarray(least[hit, None] * beam[hit])


def mapped(
    *sights: Sight,
    there: list[list[list[float]]] | None = None,
    before: list[list[list[float]]] | None = None,
    with_beams: bool = True,
) -> tuple[PlaneMapper, list[int]]:
    """Map a room in which more walls are seen, of which those told are there all the time.

    Those told as `before` are there instead in the first ten scans. Return the mapper, refined, and
    the number that each wall had when it was last seen.
    """
    mapper, last = PlaneMapper(), [-1] * len(sights)
    real, first = (
        np.concatenate([ROOM, np.array(walls or []).reshape(-1, 2, 2)])
        for walls in (there, before or there)
    )
    for k in range(SCANS):
        at = np.array([0.05 * k, 0.0])
        rows = [row for row, (_, _, when) in enumerate(sights) if k in when]
        ends = np.concatenate([ROOM, *(np.array([sights[row][0]]) for row in rows)]) - at
        kinds = [WHOLE] * len(ROOM) + [sights[row][1] for row in rows]
        seen = SimpleNamespace(ends=ends, end_type=np.array(kinds))
        beams = returns(at, first if k < 10 else real)
        found = mapper.update(seen, beams=beams if with_beams else None)
        for row, number in zip(rows, found[len(ROOM) :].tolist(), strict=True):
            last[row] = number
    mapper.finish()
    mapper.refine()
    return mapper, last


def status(mapper: PlaneMapper, number: int) -> str:
    planes = mapper.planes
    return str(planes.status[planes.plane == mapper.landmarks_of(np.array([number]))[0]][0])


def drawn(mapper: PlaneMapper) -> Floats:
    planes = mapper.planes
    return np.asarray(planes.ends[planes.status == "static"])


def on_line(mapper: PlaneMapper, x: float) -> Floats:
    """Return from where to where (n, 2) the drawn walls at an x go, upwards."""
    ends = drawn(mapper)
    there = np.abs(ends[:, :, 0] - x).max(axis=1) < 0.1
    return np.sort(np.sort(ends[there, :, 1], axis=1), axis=0)


def test_the_room_is_drawn_as_it_is() -> None:
    for with_beams in (True, False):
        mapper, _ = mapped(with_beams=with_beams)
        np.testing.assert_allclose(drawn(mapper), ROOM, atol=1e-9)
        assert len(mapper.map.positions) == 8


def test_a_wall_that_beams_go_through_is_not_drawn() -> None:
    """As for a person segmented as a wall."""
    person: Sight = ([[3.0, -1.0], [3.0, 1.0]], OPEN, EARLY)
    mapper, (number,) = mapped(person)
    assert status(mapper, number) == "unmapped"
    mapper, (number,) = mapped(person, there=[person[0]])
    assert status(mapper, number) == "static"
    mapper, (number,) = mapped(person, with_beams=False)
    assert status(mapper, number) == "static"


def test_nothing_is_drawn_where_beams_went_through_a_wall() -> None:
    """As a door that stood open, with wall on either side."""
    whole, right, left = (
        [[3.0, low], [3.0, high]] for low, high in ((-2, 2), (-2, -0.5), (0.5, 2))
    )
    sights = (whole, OPEN, range(4)), (right, OPEN, LATE), (left, OPEN, LATE)
    for before in (None, [whole]):  # it was shut in a quarter of the scans
        mapper, _ = mapped(*sights, there=[right, left], before=before)
        np.testing.assert_allclose(on_line(mapper, 3.0), [[-2.0, -0.5], [0.5, 2.0]], atol=0.15)
    mapper, _ = mapped(*sights, there=[whole])
    np.testing.assert_allclose(on_line(mapper, 3.0), [[-2.0, 2.0]], atol=0.15)


def test_a_wall_is_drawn_once() -> None:
    near, far = [[3.0, -1.5], [3.0, 0.5]], [[3.08, -1.0], [3.08, 1.5]]
    mapper, numbers = mapped((near, OPEN, EARLY), (far, OPEN, LATE), with_beams=False)
    assert len(np.unique(mapper.landmarks_of(np.array(numbers)))) == 1
    assert len(on_line(mapper, 3.04)) == 1
    # Seen in one scan they are two, of which one would be drawn on the other.
    mapper, numbers = mapped((near, OPEN, ALWAYS), (far, OPEN, ALWAYS), with_beams=False)
    assert len(np.unique(mapper.landmarks_of(np.array(numbers)))) == 2
    (lower, upper) = on_line(mapper, 3.04)
    assert lower[1] <= upper[0] + 0.051


def test_a_wall_ends_where_it_meets_another() -> None:
    """Seen too far, or not far enough."""
    for short in (-0.15, 0.15):
        wall = [[3.0, 1.0], [3.0, 3.0 - short]]
        mapper, _ = mapped((wall, OPEN, ALWAYS), with_beams=False)
        np.testing.assert_allclose(on_line(mapper, 3.0)[0, 1], 3.0, atol=1e-6)


def test_a_corner_parts_a_wall() -> None:
    """It goes on in the next room, but another wall begins there."""
    lower, upper = [[3.0, -2.0], [3.0, 0.0]], [[3.0, -0.1], [3.0, 2.0]]
    sights = (lower, ["view", "corner"], ALWAYS), (upper, OPEN, EARLY)
    mapper, _ = mapped(*sights, there=[lower, upper], with_beams=True)
    parts = on_line(mapper, 3.0)
    np.testing.assert_allclose(parts[0], [-2.0, 0.0], atol=0.15)
    assert np.linalg.norm(mapper.map.positions[:, :2] - [3.0, 0.0], axis=1).min() < 1e-6


def test_tracks_that_leave_their_line_moved() -> None:
    mapper = PlaneMapper()
    last = -1
    for k in range(SCANS):
        at = np.array([0.05 * k, 0.0])
        door = np.array([[[2.5 + 0.015 * k, -1.0], [2.5 + 0.015 * k, 1.0]]])
        ends = np.concatenate([ROOM, door]) - at
        seen = SimpleNamespace(ends=ends, end_type=np.array([WHOLE] * 4 + [OPEN]))
        last = int(mapper.update(seen, beams=returns(at, np.concatenate([ROOM, door])))[-1])
    mapper.finish()
    mapper.refine()
    assert status(mapper, last) == "dynamic"
    assert not ((drawn(mapper)[:, :, 0] > 2.3) & (drawn(mapper)[:, :, 0] < 3.3)).any()


def test_tables_of_walls_and_corners_agree(tmp_path: Path) -> None:
    person: Sight = ([[3.0, -1.0], [3.0, 1.0]], WHOLE, EARLY)
    mapper, (number,) = mapped(person)
    planes, corners = mapper.planes, mapper.landmarks
    at_ends = planes.corner[planes.status == "static"]
    assert set(at_ends[at_ends >= 0].tolist()) == set(mapper.map.landmark_ids.tolist())
    assert (corners.status == "static").sum() == len(mapper.map.landmark_ids) == 8
    assert (corners.status == "unmapped").sum() == 2
    assert len(mapper.map.covariances) == 8
    assert mapper.landmarks_of([number])[0] in planes.plane
    # A saved mapper knows the plan, and makes the same one again.
    mapper.save(tmp_path / "mapper.npz")
    again = PlaneMapper.load(tmp_path / "mapper.npz")
    np.testing.assert_array_equal(again.planes.ends, planes.ends)
    again.refine()
    np.testing.assert_array_equal(again.planes.ends, planes.ends)


def test_a_journal_keeps_beams(tmp_path: Path) -> None:
    at, person = np.zeros(2), np.array([[[3.0, -1.0], [3.0, 1.0]]])
    journal = tmp_path / "run.journal"
    mapper = PlaneMapper(journal=journal)
    for k in range(SCANS):
        walls = np.concatenate([ROOM, person]) if k in EARLY else ROOM
        seen = SimpleNamespace(
            ends=walls, end_type=np.array([WHOLE] * 4 + [OPEN] * (len(walls) - 4))
        )
        mapper.update(seen, beams=returns(at, ROOM))
    mapper.close()
    resumed = PlaneMapper.resume(journal)
    for each in (mapper, resumed):
        each.finish()
        each.refine()
    np.testing.assert_array_equal(resumed.planes.status, mapper.planes.status)
    assert "unmapped" in mapper.planes.status
    resumed.close()


def test_points_of_a_submap_lie_on_its_walls() -> None:
    mapper, _ = mapped()
    points = mapper.beams_of(0, 500).ends
    assert 250 < len(points) <= 500
    off = np.minimum(np.abs(points[:, 0] - 1.0), np.abs(points[:, 1]))
    assert (np.abs(np.maximum(np.abs(points[:, 0] - 1.0), np.abs(points[:, 1])) - 3.0) < 1e-5).all()
    assert off.max() <= 3.0 + 1e-5


def test_beams_are_stored_scan_by_scan() -> None:
    beams, none = BeamStore(), np.empty((0, 2, 2))
    laser, empty = np.array([[3.0, 4.0], [3.0, -4.0]]), np.empty((0, 2))
    for points in (np.array([[1.0, 2.0, 0.5]]), empty, laser):
        beams.append(GivenBeams.checked(points, np.array([1.0, 0.0])))
    assert [len(beams.of(scan, none)) for scan in range(3)] == [0, 0, 2]  # no order in a cloud
    assert beams.of(2, none).points.tolist() == laser[::-1].tolist()
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[0] = np.nan
    poses[2, :2, 3] = 10.0, 20.0
    origin, end, scan = beams.placed(poses, (0, 3), 100)
    assert scan.tolist() == [2, 2]
    assert origin.tolist() == [[11.0, 20.0]] * 2
    assert end.tolist() == [[13.0, 24.0], [13.0, 16.0]]
    many = GivenBeams.checked(np.ones((50_000, 3)), np.zeros(2))
    assert 1000 < len(many.points) <= 2000
    again = GivenBeams.from_bytes(many.to_bytes())
    np.testing.assert_array_equal(again.points, many.points)


@pytest.mark.parametrize("points", [np.zeros((3, 4)), np.array([[np.nan, 0.0]])])
def test_beams_that_cannot_be_are_refused(points: np.ndarray) -> None:
    mapper = PlaneMapper()
    with pytest.raises(RelmapError, match="beams"):
        mapper.update(SimpleNamespace(ends=ROOM), beams=points)
    assert mapper.n_iterations == 0


@pytest.mark.parametrize(
    ("end", "hits", "against"),
    [
        ([2.0, 0.52], [0, 1], [0, 0]),  # on it
        ([2.05, 0.52], [0, 1], [0, 0]),
        ([1.85, 0.52], [0, 0], [0, 1]),  # a little before
        ([1.5, 0.52], [0, 0], [0, 0]),  # something stands before it
        ([4.0, 0.52], [0, 0], [1, 0]),  # through it
        ([2.0, 1.5], [0, 0], [0, 0]),  # past its end
    ],
)
def test_evidence_of_a_beam_for_a_wall(
    end: list[float], hits: list[int], against: list[int]
) -> None:
    """One metre of wall at x = 2, seen from its front; counts of its two halves."""
    cells, walls = np.arange(1025), np.zeros(1024, np.int64)
    grid = np.array([-1.0, -1.0]), np.array([32, 32]), cells, walls, 0.25
    lines = np.array([[2.0, 0.0]]), np.array([[-1.0, 0.0]]), np.array([0.0]), np.array([0, 20])
    beam = np.zeros((1, 2)), np.array([end])
    found = beams_on_walls(beam, lines, grid, 0.08, 0.28)
    assert found[0].reshape(2, 10).sum(axis=1).tolist() == hits
    assert found[1].reshape(2, 10).sum(axis=1).tolist() == against


def test_a_beam_at_the_very_end_of_a_wall_is_not_evidence_for_the_next_one() -> None:
    """Its place is rounded up to that of the stretch after the last."""
    grid = np.array([-1.0, -1.0]), np.array([8, 8]), np.arange(65), np.zeros(64, np.int64), 0.25
    lines = np.zeros((2, 2)), np.array([[0.0, 1.0]] * 2), np.array([-50.0, 9.0])
    beam = np.array([[-1e-18, 0.5]]), np.array([[-1e-18, 0.0]])
    hits, _, _ = beams_on_walls(beam, (*lines, np.array([0, 1000, 1001])), grid, 0.08, 0.28)
    assert np.flatnonzero(hits).tolist() == [999]


def test_a_beam_of_any_length_is_followed_over_the_walls_only() -> None:
    """A laser may report a large distance where it sees nothing."""
    grid = np.array([-1.0, -1.0]), np.array([8, 8]), np.arange(65), np.zeros(64, np.int64), 0.25
    lines = np.zeros((1, 2)), np.array([[0.0, 1.0]]), np.array([-0.5]), np.array([0, 20])
    begins = np.array([[0.01, 0.6], [0.01, 0.6], [-1e9, 0.6], [0.3, 9.0]])
    ends = np.array([[0.01, -1e9], [1e9, 1e9], [1e9, 0.5], [-1e9, 9.0]])
    hits, against, _ = beams_on_walls((begins, ends), lines, grid, 0.08, 0.28)
    assert (hits.sum(), against.tolist().index(1), against.sum()) == (0, 10, 1)
