"""Placement of a scan by odometry and the few landmarks in view."""

from __future__ import annotations

import numpy as np
import pytest

from relmap.core.association.guiding import OdometryGuide
from relmap.core.association.placement import Placement

TRACK = np.array([[5.0, 1.0]])


def guide() -> tuple[OdometryGuide, Placement]:
    """Return a guide after a step of one metre, and where odometry places the tracks."""
    guide, step = OdometryGuide(), np.eye(4)
    step[0, 3] = 1.0
    guide.note(step)
    return guide, guide.predicted(2)


@pytest.mark.parametrize(("other_m", "n_matched"), [(0.15, 0), (0.5, 1)])
def test_a_detection_that_another_comes_near_corrects_no_odometry(
    other_m: float, n_matched: int
) -> None:
    by_odometry, guess = guide()
    points = guess.apply(TRACK) + np.array([[0.1, 0.0], [-other_m, 0.0]])
    found = by_odometry.placement(TRACK, points, noise_m=0.05, most_m=1.0)
    assert found.n_agreeing == n_matched
    assert (found.apply(TRACK)[0, 0] > guess.apply(TRACK)[0, 0]) == bool(n_matched)


@pytest.mark.parametrize(("sigmas", "is_wrong"), [(4.0, False), (9.0, True)])
def test_a_placement_far_beyond_the_noise_of_odometry_contradicts_it(
    sigmas: float, is_wrong: bool
) -> None:
    by_odometry, guess = guide()
    off_m = sigmas * by_odometry.sigma_at(TRACK)[0]
    placement = Placement(guess.R, guess.t + np.array([off_m, 0.0]), 3)
    assert by_odometry.contradicts(placement, TRACK, noise_m=1e-6) == is_wrong
