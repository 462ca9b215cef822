"""Laser logs with faults of the sensor's settings: rounded ranges, a wrong field of view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from relmap.core.arrays import Floats
from relmap.datasets.bearing_scale import warn_of_bearings
from relmap.datasets.laser import Beams, laser_scans, points_of_laser
from relmap.datasets.rounding import spread_rounded
from relmap.datasets.scans import SensorView

LOG = Path("a.log")
BEARINGS = np.linspace(-np.pi / 2, np.pi / 2, 181)


def room(scans: int = 60, bearings_rad: Floats = BEARINGS) -> list[Floats]:
    """Return the ranges in a room of 12 by 8 m, from several places and in several directions."""
    rng, found = np.random.default_rng(0), list[Floats]()
    for _ in range(scans):
        at, angle = rng.uniform(-2, 2, 2), bearings_rad + rng.uniform(-np.pi, np.pi)
        ways = np.column_stack([np.cos(angle), np.sin(angle)])
        ranges = ((np.sign(ways) * [6, 4] - at) / ways).min(axis=1)
        found.append(ranges + rng.normal(0, 0.005, len(ranges)))
    return found


def round_room(scans: int = 60, radius_m: float = 30.0) -> list[Floats]:
    """Return the ranges in a round room, from places near its wall."""
    rng, found = np.random.default_rng(0), list[Floats]()
    for _ in range(scans):
        off_m, angle = radius_m - rng.uniform(0.8, 2.5), BEARINGS + rng.uniform(-1, 1)
        along = off_m * np.cos(angle)
        found.append(-along + np.sqrt(along**2 + radius_m**2 - off_m**2))
    return found


@pytest.mark.parametrize("scale", [0.95, 0.97, 1.0, 1.03, 1.05])
def test_bearings_wrong_by_a_factor_are_reported(
    scale: float, caplog: pytest.LogCaptureFixture
) -> None:
    ranges_m = room()
    warn_of_bearings(LOG, ranges_m, [scale * BEARINGS] * len(ranges_m))
    said = " ".join(caplog.messages)
    if scale == 1:
        assert not said
    else:
        percent, kind = round(100 * abs(scale - 1)), "wide" if scale > 1 else "narrow"
        assert f"as if all bearings were {percent} % too {kind}" in said


def test_curved_walls_are_not_taken_for_wrong_bearings(caplog: pytest.LogCaptureFixture) -> None:
    ranges_m = round_room()
    warn_of_bearings(LOG, ranges_m, [BEARINGS] * len(ranges_m))
    assert not caplog.messages


def test_few_beams_say_nothing_of_bearings(caplog: pytest.LogCaptureFixture) -> None:
    for n in 0, 1, 5:
        warn_of_bearings(LOG, [np.ones(n)] * 3, [np.zeros(n)] * 3)
    warn_of_bearings(LOG, [np.ones(100)] * 3, [np.linspace(0, 1e7, 100)] * 3)
    assert spread_rounded(LOG, []) == []
    assert not caplog.messages


@pytest.mark.parametrize("step_m", [0.06, 0.0625, 1 / 12, 0.1, 0.2])
def test_coarsely_rounded_ranges_are_spread(
    step_m: float, caplog: pytest.LogCaptureFixture
) -> None:
    true_m = room()
    given_m = [np.round(step_m * np.rint(ranges / step_m), 3) for ranges in true_m]
    spread_m = spread_rounded(LOG, given_m)
    assert f"ranges are rounded to {step_m:.3g} m" in caplog.text
    changed = np.concatenate(spread_m) - np.concatenate(given_m)
    assert np.abs(changed).max() <= step_m / 2 + 1e-4
    assert np.std(changed) == pytest.approx(step_m / np.sqrt(12), rel=0.05)
    again = np.concatenate(spread_rounded(LOG, given_m))
    np.testing.assert_array_equal(again, np.concatenate(spread_m))


@pytest.mark.parametrize("step_m", [0.0, 0.01, 0.05, 0.5])
def test_other_ranges_stay_as_they_are(step_m: float, caplog: pytest.LogCaptureFixture) -> None:
    given_m = [step_m * np.rint(ranges / step_m) if step_m else ranges for ranges in room()]
    assert spread_rounded(LOG, given_m) is given_m
    assert not caplog.messages


def test_points_of_rounded_ranges_keep_their_bearings() -> None:
    given_m = [0.1 * np.rint(10 * ranges) for ranges in room()]
    ways, stamps_s = np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)]), np.arange(60.0)
    points = [ranges[:, None] * ways for ranges in given_m]
    view = SensorView(view_rad=np.pi)
    by_points = points_of_laser(LOG, points, stamps_s, view)
    beams = [Beams(ranges, BEARINGS, (0.0, 0.0, 0.0)) for ranges in given_m]
    by_ranges = laser_scans(LOG, beams, np.inf, stamps_s, None)
    for one, other in zip(by_points.scans(), by_ranges.scans(), strict=True):
        np.testing.assert_allclose(one.points_robot, other.points_robot, atol=1e-9)
