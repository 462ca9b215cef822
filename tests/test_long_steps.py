"""Steps that are far longer than the others are listed: the robot may have been carried."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PlaneMapper
from relmap.datasets.scans import ScanLog
from relmap.evaluation.feeding import preparation
from relmap.evaluation.sources import log_of
from relmap.simulation import simulate_building
from tests.drives import odometry_of


@pytest.fixture(scope="module")
def log() -> ScanLog:
    return log_of(simulate_building(181, 0.01, sampling="laser", iterations=90))


@pytest.mark.parametrize(("left_out", "listed"), [(0, []), (2, []), (12, [35])])
def test_a_step_far_longer_than_the_others_is_listed(
    left_out: int, listed: list[int], log: ScanLog
) -> None:
    mapper = PlaneMapper()
    prepare = preparation(mapper, log)
    for k in [*range(35), *range(35 + left_out, 90)]:
        points = log.points_of(k)
        mapper.update(prepare(points), beams=points)
    mapper.finish()
    mapper.refine()
    assert [submap.n_scans for submap in mapper.submaps] == [90 - left_out]
    assert mapper.weak_links.tolist() == listed


@pytest.mark.parametrize(("confirmed", "listed"), [(True, []), (False, [35])])
def test_with_odometry_too_unless_that_confirms_it(
    confirmed: bool, listed: list[int], log: ScanLog
) -> None:
    """A robot that is carried does not turn its wheels."""
    scans, mapper = np.r_[:35, 47:90], PlaneMapper()
    assert log.poses is not None
    odometry = odometry_of(log.poses[scans])
    if not confirmed:
        odometry[35] = odometry[34]
    prepare = preparation(mapper, log)
    for k, motion in zip(scans.tolist(), odometry, strict=True):
        points = log.points_of(k)
        mapper.update(prepare(points), beams=points, odometry=motion)
    mapper.finish()
    assert [submap.n_scans for submap in mapper.submaps] == [78]
    assert mapper.weak_links.tolist() == listed
