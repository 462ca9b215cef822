"""Links between scans in runs with gaps: scans without walls or beams, and logs just begun."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.core.arrays import Floats
from relmap.planes.linking import link_record, scan_links
from relmap.planes.linking.link_record import LinkRecord
from relmap.planes.linking.tying import Link
from relmap.planes.scans.observation import checked_planes
from relmap.segmentation import PlaneSegmenter
from tests.test_scan_links import CORNERS, cast

POSES = [(0.15 * k, 0.3 * np.sin(k / 5), 0.6 * np.sin(k / 7)) for k in range(14)]
EMPTY = SimpleNamespace(ends=np.empty((0, 2, 2)))


@pytest.fixture(scope="module")
def scans() -> list[tuple[object, Floats]]:
    """Return the walls and beams of scans of a room."""
    rng, segmenter = np.random.default_rng(5), PlaneSegmenter(view_rad=np.pi, range_m=20.0)
    points = [cast(CORNERS, pose) + rng.normal(0, 0.01, (361, 2)) for pose in POSES]
    return [(segmenter.fit(each).planes_, each) for each in points]


def fed(mapper: PlaneMapper, scans: list[tuple[object, Floats]]) -> PlaneMapper:
    for walls, beams in scans:
        mapper.update(walls, beams=beams)
    return mapper


def test_a_run_is_finished_before_the_log_that_was_begun_has_scans(
    scans: list[tuple[object, Floats]],
) -> None:
    mapper = fed(PlaneMapper(), scans[:6])
    mapper.take_up(*scans[0])
    mapper.finish()
    assert [submap.span for submap in mapper.submaps] == [(0, 6)]


def test_a_log_begun_twice_is_one(scans: list[tuple[object, Floats]]) -> None:
    mapper = fed(PlaneMapper(), scans[:6])
    for _ in range(2):
        mapper.finish()
        mapper.take_up(*scans[0])
    fed(mapper, scans[:6]).finish()
    np.testing.assert_array_equal(mapper.begun, [6])
    assert sorted(submap.span for submap in mapper.submaps) == [(0, 6), (6, 12)]


def test_a_log_begun_without_a_map_has_breaks(scans: list[tuple[object, Floats]]) -> None:
    mapper = PlaneMapper()
    mapper.take_up(*scans[0])
    far = SimpleNamespace(ends=np.array([[[9.0, -1.0], [9.0, 1.0]]]))
    mapper.update(far, beams=np.column_stack([np.full(9, 9.0), np.linspace(-1, 1, 9)]))
    fed(mapper, scans[:2]).finish()
    assert mapper.submaps[0].span == (1, 3)


def test_a_log_ends_with_empty_scans_before_another_begins(
    scans: list[tuple[object, Floats]],
) -> None:
    mapper = fed(PlaneMapper(), [*scans[:6], (EMPTY, np.empty((0, 2)))])
    mapper.update(EMPTY, beams=np.empty((0, 2)))
    mapper.take_up(*scans[0])
    fed(mapper, scans[:6]).finish()
    assert sorted(submap.span for submap in mapper.submaps) == [(0, 8), (8, 14)]


def test_odometry_into_the_first_scan_of_an_added_log_is_not_used(
    scans: list[tuple[object, Floats]],
) -> None:
    mapper = PlaneMapper()
    for log in range(2):
        for walls, beams in scans[:8]:
            mapper.update(walls, beams=beams, odometry=[0.15, 0.0, 0.0])
        if log == 0:
            mapper.finish()
            mapper.take_up(*scans[0])
    assert sorted(submap.span for submap in mapper.submaps) == [(0, 8), (8, 16)]
    mapper.finish()
    assert mapper.tied_at is None


def test_a_doubtful_motion_is_confirmed_by_a_scan_whose_beams_are_known(
    scans: list[tuple[object, Floats]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other scans come from a cloud, whose beams do not verify motions."""
    monkeypatch.setattr(scan_links, "SURE", 1000.0)  # each motion is doubtful
    cloud = [np.column_stack([points, points[:, :1]]) for _, points in scans]
    mapper = PlaneMapper()
    for k, (walls, beams) in enumerate(scans):
        mapper.update(walls, beams=cloud[k] if k % 3 == 2 else beams)
    assert [submap.span for submap in mapper.submaps] == [(0, len(scans))]


def test_a_link_into_an_empty_scan_leaves_other_empty_scans_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    links, seen = LinkRecord(1.0), checked_planes(EMPTY, np.ones((1, 2)))
    for k in range(5):
        if k in (0, 2):
            links.begin_submap()
        links.append(seen, np.zeros(3), k % 2 == 0, None, False)
    assert links.submaps.tolist() == [0, -1, 1, -1, 1]
    by_odometry = Link(2, 3, np.zeros(3), np.empty((0, 2), dtype=np.int64), False)
    monkeypatch.setattr(link_record, "judged_links", lambda *_: ([by_odometry], []))
    monkeypatch.setattr(link_record, "tied_across", lambda *_: None)
    links.tie()
    assert links.submaps.tolist() == [0, -1, 1, 1, 1]
