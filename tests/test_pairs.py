"""Landmarks that stand in pairs, closer than the noise, such as the two edges of a post."""

from __future__ import annotations

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats
from relmap.core.association.matching_kernels import matched_sample
from relmap.core.association.scale import spacing_of

SIGMA_M, APART_M, RANGE_M = 0.05, 0.06, 11.0


def pairs(rng: np.random.Generator, n: int, d: int) -> Floats:
    """Return n single landmarks, and as many with another beside them (3 n, d)."""
    places, beside = rng.uniform(0, 40, (2 * n, d)), rng.normal(size=(n, d))
    beside *= APART_M / np.linalg.norm(beside, axis=1, keepdims=True)
    return np.concatenate([places, places[:n] + beside])


@pytest.mark.parametrize("d", [2, 3])
def test_the_spacing_is_not_that_within_pairs(d: int) -> None:
    rng = np.random.default_rng(0)
    points = pairs(rng, 20, d)
    missed = np.zeros(len(points), dtype=np.int64)
    here = matched_sample(points, points, missed, len(points), np.inf, 0.1)[-1]
    alone = spacing_of(points[:40])
    for spacing_m in (spacing_of(points), here):
        assert alone / 8 < spacing_m <= alone
    few = points[:5]
    assert spacing_of(few) == matched_sample(few, few, missed[:5], 5, np.inf, 0.1)[-1]


@pytest.mark.parametrize("seed", range(3))
def test_pairs_do_not_break_a_run(seed: int) -> None:
    rng, mapper = np.random.default_rng(seed), PointMapper()
    landmarks = pairs(rng, 80, 2)
    for angle in np.linspace(0, 2 * np.pi, 60):
        yaw = angle + np.pi / 2 + 0.4 * rng.choice([-1, 1])
        c, s = np.cos(yaw), np.sin(yaw)
        at = [20 + 12 * np.cos(angle), 20 + 12 * np.sin(angle)]
        local = (landmarks - at) @ np.array([[c, -s], [s, c]])
        seen = (np.linalg.norm(local, axis=1) < RANGE_M) & (local[:, 0] > -3)
        local = local[seen & (rng.random(len(local)) > 0.1)]
        mapper.update(local + SIGMA_M * rng.normal(size=local.shape))
    mapper.finish()
    mapper.refine()
    assert mapper.tied_share > 0.95
    assert len(mapper.submaps) == 1
