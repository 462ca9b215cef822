"""Places that look alike are not taken for one after a stretch without landmarks."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.evaluation.metrics import majority_ids
from tests.worlds import aligned_rmse, purity_of, random_rotation

ROUND_M, VIEW_M, SIGMA_M = 180.0, 10.0, 0.03
BLIND_SCANS = 80


def in_plane(angle: float | Floats, radius_m: float | Floats) -> Floats:
    return np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle)], axis=-1)


def twin_places(seed: int) -> tuple[Floats, list[tuple[Floats, Ints]]]:
    """Return landmarks (n, 2) and scans of two rounds, with their true ids; some scans are empty.

    Six places on the way round have the same 14 landmarks, and 100 others lie anywhere near it.
    """
    rng, radius_m = np.random.default_rng(seed), ROUND_M / (2 * np.pi)
    place = rng.uniform(-4, 4, (14, 2))
    landmarks = [
        place @ random_rotation(2, 3.0, rng).T + in_plane(np.pi / 3 * k, radius_m) for k in range(6)
    ]
    angle, off_m = rng.uniform(0, 2 * np.pi, 100), rng.uniform(-9, 9, 100)
    points = np.vstack([*landmarks, in_plane(angle, radius_m + off_m)])
    n_scans = int(4 * ROUND_M)
    begins = rng.choice(np.arange(60, n_scans - 60 - BLIND_SCANS), 3, replace=False)
    scans = []
    for k in range(n_scans):
        t = 4 * np.pi * k / n_scans
        seen = (points - in_plane(t, radius_m)) @ np.array(
            [[-np.sin(t), -np.cos(t)], [np.cos(t), -np.sin(t)]]
        )
        is_blind = np.any((begins <= k) & (k < begins + BLIND_SCANS))
        ids = np.flatnonzero(np.linalg.norm(seen, axis=1) < (0 if is_blind else VIEW_M))
        rng.shuffle(ids)
        scans.append((seen[ids] + SIGMA_M * rng.standard_normal((len(ids), 2)), ids))
    return points, scans


@pytest.mark.parametrize("seed", [1, 3])
def test_a_place_that_looks_like_the_last_one_is_not_joined_to_it(seed: int) -> None:
    landmarks, scans = twin_places(seed)
    mapper = PointMapper()
    labels = np.concatenate([mapper.update(points) for points, _ in scans])
    mapper.finish()
    mapper.refine()
    found, ids = mapper.landmarks_of(labels), np.concatenate([ids for _, ids in scans])
    assert purity_of(found, ids) > 0.999
    (submap,) = mapper.submaps
    number, true_id = majority_ids(found, ids)[:2]
    id_of = dict(zip(number.tolist(), true_id.tolist(), strict=True))
    truth = landmarks[[id_of[one] for one in submap.landmark_ids.tolist()]]
    assert len(np.unique(truth, axis=0)) >= 0.8 * len(landmarks)
    assert aligned_rmse(submap.positions[:, :2], truth) < 2 * SIGMA_M
