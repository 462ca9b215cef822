from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from relmap import PointMapper
from relmap.core.arrays import Floats, Ints
from relmap.core.refinement.condensing import CondensedSegments
from relmap.core.refinement.joint import refine
from relmap.core.state.store import ObservationStore
from relmap.evaluation.run import run_mapper
from relmap.io.results import json_text
from relmap.plots.run import weak_places
from relmap.simulation import simulate_figure_eight
from tests.worlds import mapped, walk

Scans = list[tuple[Ints, Floats]]


def refined_of(scans: Scans, of: Ints, start: Floats) -> Any:
    store = ObservationStore()
    for ids, points in scans:
        store.append(ids, points)
    m = len(of)
    nobody = np.zeros(m, dtype=bool)
    rows = CondensedSegments().with_rest(store, nobody)
    return refine(rows, start, of == np.arange(m), of, nobody)


def test_residuals_are_about_one_where_noise_explains_all() -> None:
    mapper = mapped(walk(3, 1, sigma=0.05, iterations=400).scans)
    mapper.refine()
    (submap,) = mapper.refined
    assert submap.noise_m == pytest.approx(0.05, rel=0.1)
    assert 0.8 < np.median(submap.segments.residual) < 1.2
    assert submap.segments.residual.max() < 2
    assert len(submap.merges.residual) == 0


def test_a_bent_stretch_stands_out() -> None:
    world = walk(3, 1, sigma=0.02, iterations=400)
    scans = [(ids, points.copy()) for ids, points in world.scans]
    for _, points in scans[200:208]:
        points *= 1.03  # what no placement mends
    mapper = mapped(scans)
    mapper.refine()
    (submap,) = mapper.refined
    worst = submap.segments.first_iteration[np.argmax(submap.segments.residual)]
    assert worst == 200
    assert submap.segments.residual.max() > 3


def test_a_wrong_merge_stands_out() -> None:
    world = walk(3, 2, sigma=0.02, iterations=200)
    m = len(world.landmarks)
    seen = np.unique(np.concatenate([ids for ids, _ in world.scans]))
    # Landmark 20 turns up under two new numbers: one is truly it, the other its neighbour 21.
    scans: Scans = []
    for k, (ids, points) in enumerate(world.scans):
        late = k >= 128
        scans.append((np.where(late & (ids == 20), m, np.where(ids == 21, m + 1, ids)), points))
    start = np.vstack([world.landmarks, world.landmarks[[20, 21]]])
    of = np.arange(m + 2)
    of[m] = 20
    assert np.isin([20, 21], seen).all()
    merges = refined_of(scans, of, start).merges
    assert merges.landmark.tolist() == [20]
    assert merges.track.tolist() == [m]
    assert merges.residual[0] < 3
    of[m + 1] = 20
    merges = refined_of(scans, of, start).merges
    apart = dict(zip(merges.track.tolist(), merges.residual.tolist(), strict=True))
    assert apart[m + 1] > 10


def test_the_summary_lists_weak_places() -> None:
    log = simulate_figure_eight(iterations=300).log
    told = run_mapper(PointMapper(), log, "nearest", refine=True).result.summary["refinement"]
    assert told["noise_m"] == pytest.approx(0.05, rel=0.1)
    assert told["segments"] == 38
    assert len(told["weakest_segments"]) == 5
    worst = [place["residual"] for place in told["weakest_segments"]]
    assert worst == sorted(worst, reverse=True)
    json_text(told)
    assert run_mapper(PointMapper(), log, "nearest").result.summary["refinement"] is None


def test_rounding_is_not_a_weak_place() -> None:
    log = simulate_figure_eight(iterations=60, sigma=0.0).log
    result = run_mapper(PointMapper(), log, "nearest", refine=True).result
    told = result.summary["refinement"]
    assert told["noise_m"] < 1e-12
    assert told["weakest_segments"][0]["residual"] > 2
    assert all(len(places) == 0 for places in weak_places(result).values())
    told["noise_m"] = 0.05
    assert sum(map(len, weak_places(result).values())) > 0
