"""A tilted laser sees the floor at nearly the same distance everywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.datasets.laser import usable_beams

BEARING = np.deg2rad(np.arange(-90.0, 91.0))
FLOOR_M = 12.0


def down_a_corridor(floor_m: float = np.inf, long_m: float = 40.0) -> list[Floats]:
    """Return the ranges (181,) along a corridor of 2.4 m, every 0.4 m, up to its end."""
    rng = np.random.default_rng(0)
    scans = []
    for end_m in np.arange(long_m, 1.0, -0.4):
        ahead_m = min(end_m, floor_m * (1 + rng.uniform(-0.03, 0.03)))
        across, along = np.abs(np.sin(BEARING)), np.cos(BEARING)
        ranges = np.minimum(1.2 / np.maximum(across, 1e-3), ahead_m / np.maximum(along, 1e-3))
        scans.append(np.round(ranges + rng.normal(0, 0.01, len(ranges)), 2))
    return scans


def usable(scans: list[Floats], range_m: float = np.inf) -> tuple[Floats, float]:
    """Return the largest usable range of each scan, and the range below which beams are usable."""
    bearings = [BEARING] * len(scans)
    kept, limit_m = usable_beams(Path("a.log"), scans, bearings, range_m=range_m)
    pairs = zip(scans, kept, strict=True)
    return np.array([ranges[there].max() for ranges, there in pairs]), limit_m


def test_the_floor_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    farthest_m, limit_m = usable(down_a_corridor(FLOOR_M))
    assert 0.9 * FLOOR_M < limit_m < 0.98 * FLOOR_M
    assert farthest_m.max() < limit_m
    (said,) = [record.getMessage() for record in caplog.records]
    assert "as if the laser saw the floor" in said
    assert "60.6 % of the scans in motion see 11.4 to 12.3 m ahead" in said


def test_a_corridor_is_seen_to_its_end() -> None:
    farthest_m, limit_m = usable(down_a_corridor())
    assert limit_m == np.inf
    assert farthest_m.max() > 39.0


def test_walls_that_leave_the_range_of_a_laser_are_not_the_floor(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A laser that sees 12 m, as its log does not say: beams straight ahead return nothing."""
    wide_and_narrow = [(1 + k % 2 / 9) * ranges for k, ranges in enumerate(down_a_corridor())]
    usable([np.where(ranges < FLOOR_M, ranges, 0.0) for ranges in wide_and_narrow])
    (said,) = [record.getMessage() for record in caplog.records]
    assert "as if its range, which the log lacks, ended there" in said


def test_a_wall_before_a_robot_at_rest_is_a_wall() -> None:
    """It stands for most of the time, and at the end drives a little."""
    at_rest = [down_a_corridor(long_m=12.0)[0]] * 200
    farthest_m, limit_m = usable(at_rest + down_a_corridor(long_m=12.0)[:10])
    assert limit_m == np.inf
    assert farthest_m.max() > 11.9


def test_a_robot_that_rests_before_its_longest_view_does_not_see_the_floor() -> None:
    rng, scans = np.random.default_rng(1), down_a_corridor()
    at_rest = [scans[1] + rng.normal(0, 0.01, len(BEARING)) for _ in range(40)]
    farthest_m, limit_m = usable(at_rest + scans)
    assert limit_m == np.inf
    assert farthest_m.max() > 39.0


def test_the_end_of_the_range_is_not_the_floor() -> None:
    """What is seen ahead ends at the range of the laser, as at the floor."""
    scans = down_a_corridor(FLOOR_M)
    assert usable(scans, 1.05 * FLOOR_M)[1] == np.inf
    assert usable(scans, 1.5 * FLOOR_M)[1] < FLOOR_M
