"""Storeys and rooms that look the same: not taken for one, or not without a word."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli.outcome import doubted
from relmap.cli.warned import leapt
from relmap.core.arrays import Floats
from relmap.core.readout import gaps
from relmap.datasets import ObservationLog
from relmap.evaluation.run import map_log
from tests.worlds import turn

NOISE_M, HEIGHT_M, STEP = 0.03, 3.0, 0.07


def house(rng: np.random.Generator, n_up: int) -> tuple[list[Floats], list[Floats]]:
    """Return the poses (k, 4, 4) and scans of two equal storeys.

    The robot goes round the lower one, climbs in `n_up` scans that show nothing, and goes round the
    upper one.
    """
    storey = rng.uniform([-9, -9, 0.2], [9, 9, 2.6], (120, 3))
    landmarks = np.concatenate([storey, storey + np.array([0.0, 0.0, HEIGHT_M])])
    level = np.repeat([0.0, 1.0], len(storey))
    risen = np.concatenate([np.zeros(90), np.arange(1, n_up + 1) / (n_up + 1), np.ones(90)])
    angles = STEP * np.concatenate([np.arange(90), np.full(n_up, 89), np.arange(89, 179)])
    poses, scans = [], []
    for angle, up in zip(angles, risen, strict=True):
        pose = np.eye(4)
        pose[:2, :2] = turn(angle + np.pi / 2)
        pose[:3, 3] = [5 * np.cos(angle), 5 * np.sin(angle), 1.2 + HEIGHT_M * up]
        local = (landmarks - pose[:3, 3]) @ pose[:3, :3]
        seen = (level == up) & (np.linalg.norm(local, axis=1) < 7) & (local[:, 0] > -1)
        poses.append(pose)
        scans.append(local[seen] + rng.normal(0, NOISE_M, (seen.sum(), 3)))
    return poses, scans


def mapped(
    poses: list[Floats], scans: list[Floats], rng: np.random.Generator | None
) -> PointMapper:
    """Map the scans, with odometry if `rng` is given."""
    mapper = PointMapper()
    for k, scan in enumerate(scans):
        motion = None
        if rng is not None and k:
            motion = np.linalg.inv(poses[k - 1]) @ poses[k]
            motion[:2, :2] = motion[:2, :2] @ turn(rng.normal(0, 0.01))
            motion[:3, 3] += rng.normal(0, 0.01, 3)
        mapper.update(scan, odometry=motion)
    mapper.finish()
    mapper.refine()
    return mapper


def trust_in(scans: list[Floats]) -> dict[str, Any]:
    log = ObservationLog.of_scans(scans, [np.full(len(scan), -1) for scan in scans])
    found: dict[str, Any] = map_log(log, PointMapper()).result.summary["association_trust"]
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_odometry_tells_storeys_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, scans = house(rng, 12)
    mapper = mapped(poses, scans, rng)
    z = mapper.map.positions[:, 2]
    assert np.ptp(z) > HEIGHT_M + 1.5
    assert len(z) > 100
    assert mapper.odometry.alike > 0


def test_storeys_taken_for_one_across_a_gap_are_reported() -> None:
    _, scans = house(np.random.default_rng(1), 12)
    trust = trust_in(scans)
    assert (trust["gaps"], trust["longest_gap"]) == (1, 12)
    assert trust["leaps"]["count"] == 0
    assert "places that look the same bridge 1 gap of up to 12 scans" in doubted(
        {"association_trust": trust}
    )


def test_a_leap_across_a_short_gap_is_a_warning() -> None:
    _, scans = house(np.random.default_rng(1), 12)
    leaps = trust_in(scans[:80] + scans[15:60])["leaps"]  # carried back
    assert (leaps["count"], leaps["steps"]) == (1, [[79, 80]])
    assert leaps["way_m"][0] == pytest.approx(7.9, abs=0.1)
    assert "the robot leaps 7.9 m from iteration 79 to 80:" in leapt(leaps)
    twice = leaps | {"count": 2}
    assert "from iteration 79 to 80, and 1 time more: unless" in leapt(twice)


def test_a_map_without_gaps_reports_none() -> None:
    poses, scans = house(np.random.default_rng(1), 12)
    mapper = mapped(poses[:80], scans[:80], None)
    found = gaps(mapper.engine, np.arange(80), mapper.trajectory[:, :3, 3])
    assert len(found.before) == 0


def test_a_robot_that_mostly_stands_still_does_not_leap() -> None:
    _, scans = house(np.random.default_rng(1), 12)
    rng = np.random.default_rng(2)
    still = [scans[0] + rng.normal(0, NOISE_M, scans[0].shape) for _ in range(200)]
    nothing = [np.empty((0, 3))] * 9
    trust = trust_in([*still, *scans[:20], *nothing, *scans[29:60]])
    assert (trust["gaps"], trust["longest_gap"]) == (1, 9)
    assert trust["leaps"]["count"] == 0


def test_from_one_log_to_the_next_there_is_no_leap() -> None:
    _, scans = house(np.random.default_rng(1), 12)
    mapper = PointMapper()
    logs = [
        ObservationLog.of_scans(part, [np.full(len(scan), -1) for scan in part])
        for part in (scans[:80], scans[20:60])
    ]
    map_log(logs[0], mapper)
    assert mapper.take_up(logs[1].points_robot[logs[1].iteration == 0])
    leaps = map_log(logs[1], mapper).result.summary["association_trust"]["leaps"]
    assert leaps["count"] == 0
