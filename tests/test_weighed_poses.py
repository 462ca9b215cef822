"""Poses fitted by the covariances of observations."""

from __future__ import annotations

import numpy as np

from relmap import range_bearing_covariances
from relmap.core.map.pose import weigh_poses
from relmap.core.state.kept import KeptObservations


def test_wrong_ids_turn_few_poses_that_are_fitted_by_covariances() -> None:
    """One in 45 was more than a metre off."""
    rng, n, off_m = np.random.default_rng(0), 15, []
    landmark = np.arange(n)
    for _ in range(500):
        bearing, range_m = rng.uniform(-1.0, 1.0, n), rng.uniform(8.0, 45.0, n)
        places = (range_m * [np.cos(bearing), np.sin(bearing)]).T
        bearing = bearing + 0.014 * rng.standard_normal(n)
        range_m = range_m + 0.15 * rng.standard_normal(n)
        seen = (range_m * [np.cos(bearing), np.sin(bearing)]).T
        places[:2] = rng.uniform(-180.0, 180.0, (2, 2))  # landmarks whose ids two others have
        kept = KeptObservations()
        kept.append(landmark, seen, 0, range_bearing_covariances(places, 0.15, 0.014))
        pose = np.eye(4)[None].copy()
        weigh_poses(np.array([0]), pose, kept, places, landmark)
        off_m.append(np.linalg.norm(pose[0, :2, 3]))
    assert np.mean(np.array(off_m) > 1.0) <= 0.004
