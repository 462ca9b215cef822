"""Places that look alike in part, taken for one: scans miss what should be in view."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from relmap import PointMapper
from relmap.cli.warned import missed, warned
from relmap.core.arrays import Floats
from relmap.core.readout import contradicted_at
from relmap.datasets import ObservationLog
from relmap.evaluation.run import map_log
from relmap.simulation import WorldSpec, simulate_world
from tests.worlds import turn

SIGMA_M, SCANS, AGAIN, NOTHING = 0.02, 160, 30, 12


def visit(
    landmarks: Floats, scans: int, rng: np.random.Generator, missing: float = 0.0
) -> list[Floats]:
    """Return scans of a robot on its way through landmarks, a fraction of which it does not see."""
    found = []
    for k in range(scans):
        local = (landmarks - [0.4 * k, 2 * np.sin(0.1 * k)]) @ turn(0.005 * k)
        seen = (np.linalg.norm(local, axis=1) < 8) & (local[:, 0] > -2)
        seen &= rng.random(len(local)) >= missing
        found.append(local[seen] + rng.normal(0, SIGMA_M, (seen.sum(), 2)))
    return found


@cache
def visited(alike: float, missing: float = 0.0, seed: int = 0) -> PointMapper:
    """Map a place, nothing for a while, and then only part of its first landmarks, and others."""
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform([-8, -10], [74, 10], (400, 2))
    others = np.where(rng.random((400, 1)) < alike, landmarks, rng.uniform(-10, 26, (400, 2)))
    first, again = (visit(at, n, rng, missing) for at, n in ((landmarks, SCANS), (others, AGAIN)))
    mapper = PointMapper()
    for points in [*first, *[np.empty((0, 2))] * NOTHING, *again]:
        mapper.update(points)
    mapper.finish()
    return mapper


def submaps_of(mapper: PointMapper) -> list[dict[str, Any]]:
    """Return what a summary has of submaps."""
    return [{"contradicted_at": at} for at in contradicted_at(mapper.engine)]


def test_places_that_look_alike_in_part_are_named() -> None:
    mapper = visited(0.7)
    mapper.refine()
    assert len(mapper.submaps) == 1  # taken for one
    (at,) = contradicted_at(mapper.engine)
    assert at is not None
    assert at < AGAIN + 20 or at >= SCANS + NOTHING
    assert f"iteration {at} (submap 0): places that look the same" in missed(submaps_of(mapper))


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_same_place_is_not(missing: float) -> None:
    mapper = visited(1.0, missing)
    mapper.refine()
    assert len(mapper.submaps) == 1
    assert contradicted_at(mapper.engine) == [None]
    assert not missed(submaps_of(mapper))


def test_nothing_is_named_before_refinement() -> None:
    assert contradicted_at(visited(0.7, seed=1).engine) == [None]


@pytest.mark.parametrize("robots", [1, 2])
def test_scans_that_mix_two_robots_are_mentioned(robots: int) -> None:
    """Only one of them is tracked; the scans of the other are taken in reverse."""
    worlds = [
        simulate_world(WorldSpec(length_m=100.0, iterations=80, seed=3 + k)) for k in range(robots)
    ]
    each = [[scan.points_robot for scan in world.log.scans()] for world in worlds]
    points = [
        np.concatenate(both) for both in zip(each[0], *(of[::-1] for of in each[1:]), strict=True)
    ]
    ids = [np.full(len(scan), -1) for scan in points]
    run = map_log(replace(ObservationLog.of_scans(points, ids), ids=None))
    said = "observations are of landmarks seen once or twice"
    assert (said in warned(run.result.summary)) == (robots == 2)
