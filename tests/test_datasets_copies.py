"""Points of a sensor that is stuck, while odometry goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from relmap.core.arrays import Ints
from relmap.datasets import ObservationLog
from relmap.datasets.copies import without_copies
from relmap.evaluation.metrics import majority_ids
from relmap.evaluation.run import map_log
from tests.test_odometry_ids import landmarks, rounds
from tests.worlds import aligned_rmse

STUCK = range(121, 161)


def stuck(log: ObservationLog) -> ObservationLog:
    """Return a log in which a scan is repeated for a while."""
    scans = list(log.scans())
    for k in STUCK:
        scans[k] = scans[STUCK[0] - 1]
    ids: list[Ints] = [np.asarray(scan.ids) for scan in scans]
    again = ObservationLog.of_scans([scan.points_robot for scan in scans], ids)
    return replace(again, odometry=log.odometry)


def test_a_stuck_sensor_does_not_shorten_the_map() -> None:
    """The map was 16 m off."""
    log = stuck(rounds())
    result = map_log(log).result
    kept = ~np.isin(log.iteration, STUCK)
    of, label, _ = majority_ids(result.tracks.landmark, log.ids[kept])
    true = dict(zip(of.tolist(), label.tolist(), strict=True))
    found = np.flatnonzero(result.mapped)
    ids = [true[label] for label in result.landmarks.landmark[found].tolist()]
    assert len(set(ids)) > 30
    assert aligned_rmse(result.landmarks.position[found, :2], landmarks()[ids]) < 0.1


def test_only_copies_that_odometry_contradicts_are_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = stuck(rounds())
    assert log.odometry is not None
    assert not np.isin(without_copies(log).iteration, STUCK).any()
    assert "40 of 500 scans repeat the one before" in caplog.text
    rests = log.odometry.copy()
    rests[STUCK] = np.eye(4)
    rests[STUCK[-1]] = np.nan
    for odometry in (None, rests):
        assert len(without_copies(replace(log, odometry=odometry)).rows) == len(log.rows)
